//! Row-major products for the sizes of this network: no packing but for ragged columns and
//! transposed weights, single-threaded (the trainer splits the batch instead).

use super::simd_level;
use super::tile::{Strided, WIDTH, panel};
use std::cell::RefCell;

thread_local! {
    /// Padded or transposed right matrices, and a padded result.
    static BUFFERS: RefCell<(Vec<f32>, Vec<f32>)> = const { RefCell::new((Vec::new(), Vec::new())) };
}

/// `c[m,n] = a[m,k] b[k,n]`, added to what is in `c` when `accumulate`.
pub fn matmul(a: &[f32], b: &[f32], c: &mut [f32], [m, k, n]: [usize; 3], accumulate: bool) {
    assert!(a.len() >= m * k && b.len() >= k * n && c.len() >= m * n, "matrix sizes");
    if !accumulate {
        c[..m * n].fill(0.0);
    }
    product([m, k, n], Strided { data: a, row: k, column: 1 }, b, c);
}

/// `c[m,k] = a[m,n] b[k,n]^T`: the gradient of an input through the weights `b`.
pub fn matmul_nt(a: &[f32], b: &[f32], c: &mut [f32], [m, n, k]: [usize; 3], accumulate: bool) {
    assert!(a.len() >= m * n && b.len() >= k * n && c.len() >= m * k, "matrix sizes");
    if !accumulate {
        c[..m * k].fill(0.0);
    }
    let mut transposed = BUFFERS.with_borrow_mut(|b| std::mem::take(&mut b.0));
    transposed.clear();
    transposed.resize(n * k, 0.0);
    for (j, row) in b.chunks_exact(n).take(k).enumerate() {
        for (l, v) in row.iter().enumerate() {
            transposed[l * k + j] = *v;
        }
    }
    product([m, n, k], Strided { data: a, row: n, column: 1 }, &transposed, c);
    BUFFERS.with_borrow_mut(|b| b.0 = transposed);
}

/// `c[k,n] += a[m,k]^T b[m,n]`: the gradient of weights, accumulated.
pub fn matmul_tn(a: &[f32], b: &[f32], c: &mut [f32], [m, k, n]: [usize; 3]) {
    assert!(a.len() >= m * k && b.len() >= m * n && c.len() >= k * n, "matrix sizes");
    product([k, m, n], Strided { data: a, row: 1, column: k }, b, c);
}

/// `c[m,n] += a[m,k] b[k,n]`.
fn product([m, k, n]: [usize; 3], a: Strided, b: &[f32], c: &mut [f32]) {
    let (level, full) = (simd_level(), n - n % WIDTH);
    for at in (0..full).step_by(WIDTH) {
        panel::<2>(level, [m, k], a, &b[at..], n, &mut c[at..], n);
    }
    let rest = n - full;
    if rest == 0 {
        return;
    }
    // The last, narrower columns go through padded copies.
    BUFFERS.with_borrow_mut(|(_, padded)| {
        padded.clear();
        padded.resize((k + m) * WIDTH, 0.0);
        let (pb, pc) = padded.split_at_mut(k * WIDTH);
        for (p, b) in pb.chunks_exact_mut(WIDTH).zip(b.chunks(n)) {
            p[..rest].copy_from_slice(&b[full..n]);
        }
        panel::<2>(level, [m, k], a, pb, WIDTH, pc, WIDTH);
        for (p, c) in pc.chunks_exact(WIDTH).zip(c.chunks_mut(n)) {
            super::add(&p[..rest], &mut c[full..n]);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::check::random;

    #[test]
    fn the_three_products_agree_with_loops() {
        for [m, k, n] in [[7, 5, 11], [16, 64, 96], [13, 9, 64], [40, 33, 41], [1, 3, 32]] {
            let (a, b, g) = (random(m * k, 1), random(k * n, 2), random(m * n, 3));
            let mut c = vec![1.0; m * n];
            matmul(&a, &b, &mut c, [m, k, n], true);
            for (i, c) in c.iter().enumerate() {
                let v: f32 = (0..k).map(|l| a[i / n * k + l] * b[l * n + i % n]).sum();
                assert!((c - 1.0 - v).abs() < 1e-5);
            }
            let mut da = vec![9.0; m * k];
            matmul_nt(&g, &b, &mut da, [m, n, k], false);
            for (i, d) in da.iter().enumerate() {
                let v: f32 = (0..n).map(|j| g[i / k * n + j] * b[i % k * n + j]).sum();
                assert!((d - v).abs() < 1e-5);
            }
            let mut db = vec![0.5; k * n];
            matmul_tn(&a, &g, &mut db, [m, k, n]);
            for (i, d) in db.iter().enumerate() {
                let v: f32 = (0..m).map(|r| a[r * k + i / n] * g[r * n + i % n]).sum();
                assert!((d - 0.5 - v).abs() < 1e-5);
            }
        }
    }
}
