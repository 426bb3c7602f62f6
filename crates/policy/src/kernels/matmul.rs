//! Row-major products on the `gemm` crate, single-threaded: the trainer splits the batch instead.

use gemm::Parallelism;

/// `c[m,n] = a[m,k] b[k,n]`, added to what is in `c` when `accumulate`.
pub fn matmul(a: &[f32], b: &[f32], c: &mut [f32], [m, k, n]: [usize; 3], accumulate: bool) {
    assert!(a.len() >= m * k && b.len() >= k * n && c.len() >= m * n, "matrix sizes");
    product([m, k, n], c, (a, 1, k as isize), (b, 1, n as isize), accumulate);
}

/// `c[m,k] = a[m,n] b[k,n]^T`: the gradient of an input through the weights `b`.
pub fn matmul_nt(a: &[f32], b: &[f32], c: &mut [f32], [m, n, k]: [usize; 3], accumulate: bool) {
    assert!(a.len() >= m * n && b.len() >= k * n && c.len() >= m * k, "matrix sizes");
    product([m, n, k], c, (a, 1, n as isize), (b, n as isize, 1), accumulate);
}

/// `c[k,n] += a[m,k]^T b[m,n]`: the gradient of weights, accumulated.
pub fn matmul_tn(a: &[f32], b: &[f32], c: &mut [f32], [m, k, n]: [usize; 3]) {
    assert!(a.len() >= m * k && b.len() >= m * n && c.len() >= k * n, "matrix sizes");
    product([k, m, n], c, (a, k as isize, 1), (b, 1, n as isize), true);
}

/// `c[m,n] (+)= a b` with the column and row strides of `a` and `b`; the sizes are checked above.
fn product(
    [m, k, n]: [usize; 3],
    c: &mut [f32],
    (a, a_cs, a_rs): (&[f32], isize, isize),
    (b, b_cs, b_rs): (&[f32], isize, isize),
    accumulate: bool,
) {
    // SAFETY: the callers checked that every index within the shapes and strides is in its slice;
    // `c` is borrowed exclusively.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            c.as_mut_ptr(),
            1,
            n as isize,
            accumulate,
            a.as_ptr(),
            a_cs,
            a_rs,
            b.as_ptr(),
            b_cs,
            b_rs,
            1.0,
            1.0,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::check::random;

    #[test]
    fn the_three_products_agree_with_loops() {
        let [m, k, n] = [7, 5, 11];
        let (a, b, g) = (random(m * k, 1), random(k * n, 2), random(m * n, 3));
        let mut c = vec![1.0; m * n];
        matmul(&a, &b, &mut c, [m, k, n], true);
        for i in 0..m {
            for j in 0..n {
                let v: f32 = (0..k).map(|l| a[i * k + l] * b[l * n + j]).sum();
                assert!((c[i * n + j] - 1.0 - v).abs() < 1e-5);
            }
        }
        let mut da = vec![9.0; m * k];
        matmul_nt(&g, &b, &mut da, [m, n, k], false);
        let v: f32 = (0..n).map(|j| g[2 * n + j] * b[3 * n + j]).sum();
        assert!((da[2 * k + 3] - v).abs() < 1e-5);
        let mut db = vec![0.5; k * n];
        matmul_tn(&a, &g, &mut db, [m, k, n]);
        let v: f32 = (0..m).map(|i| a[i * k + 4] * g[i * n + 6]).sum();
        assert!((db[4 * n + 6] - 0.5 - v).abs() < 1e-5);
    }
}
