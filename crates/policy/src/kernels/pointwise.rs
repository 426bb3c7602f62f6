//! Activations, biases, gates and sums over rows.

use super::dispatch;
use super::math::{self, dot, fma, gelu_slope, sigmoid};

dispatch! {
    /// `u[rows, n] += bias[n]`, then `y = gelu(u)`; `u` is kept for the backward pass.
    pub fn bias_gelu(u: &mut [f32], bias: &[f32], y: &mut [f32]) = bias_gelu_body
}

#[inline(always)]
fn bias_gelu_body<const FMA: bool>(u: &mut [f32], bias: &[f32], y: &mut [f32]) {
    for (u, y) in u.chunks_exact_mut(bias.len()).zip(y.chunks_exact_mut(bias.len())) {
        for ((u, y), b) in u.iter_mut().zip(y).zip(bias) {
            *u += b;
            *y = math::gelu::<FMA>(*u);
        }
    }
}

dispatch! {
    /// `x = gelu(x)` in place.
    pub fn gelu(x: &mut [f32]) = gelu_body
}

#[inline(always)]
fn gelu_body<const FMA: bool>(x: &mut [f32]) {
    for x in x {
        *x = math::gelu::<FMA>(*x);
    }
}

dispatch! {
    /// `g *= gelu'(u)` in place and `dbias += column sums of the result`.
    pub fn gelu_backward(u: &[f32], g: &mut [f32], dbias: &mut [f32]) = gelu_backward_body
}

#[inline(always)]
fn gelu_backward_body<const FMA: bool>(u: &[f32], g: &mut [f32], dbias: &mut [f32]) {
    for (u, g) in u.chunks_exact(dbias.len()).zip(g.chunks_exact_mut(dbias.len())) {
        for ((u, g), db) in u.iter().zip(g).zip(dbias.iter_mut()) {
            *g *= gelu_slope::<FMA>(*u);
            *db += *g;
        }
    }
}

dispatch! {
    /// `y = x sigmoid(x)`.
    pub fn silu(x: &[f32], y: &mut [f32]) = silu_body
}

#[inline(always)]
fn silu_body<const FMA: bool>(x: &[f32], y: &mut [f32]) {
    for (x, y) in x.iter().zip(y) {
        *y = x * sigmoid::<FMA>(*x);
    }
}

dispatch! {
    /// `g *= silu'(x)` in place.
    pub fn silu_backward(x: &[f32], g: &mut [f32]) = silu_backward_body
}

#[inline(always)]
fn silu_backward_body<const FMA: bool>(x: &[f32], g: &mut [f32]) {
    for (x, g) in x.iter().zip(g) {
        let s = sigmoid::<FMA>(*x);
        *g *= fma::<FMA>(x * s, 1.0 - s, s);
    }
}

dispatch! {
    /// `out[b, s, :] = x[b, s, :] + gate[b] * y[b, s, :]`; a sample's gate is the `d` values at `at`
    /// of its modulation (`stride` apart).
    pub fn gated_add(
        tokens: usize, d: usize, x: &[f32], y: &[f32], modulation: &[f32], stride: usize, at: usize,
        out: &mut [f32],
    ) = gated_add_body
}

#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn gated_add_body<const FMA: bool>(
    tokens: usize,
    d: usize,
    x: &[f32],
    y: &[f32],
    modulation: &[f32],
    stride: usize,
    at: usize,
    out: &mut [f32],
) {
    for (row, out) in out.chunks_exact_mut(d).enumerate() {
        let gate = &modulation[(row / tokens) * stride + at..][..d];
        let (x, y) = (&x[row * d..][..d], &y[row * d..][..d]);
        for (((o, x), y), g) in out.iter_mut().zip(x).zip(y).zip(gate) {
            *o = fma::<FMA>(*g, *y, *x);
        }
    }
}

dispatch! {
    /// Given `go = dL/dout` of [`gated_add`], writes `dy = go * gate` and the gate's gradient.
    pub fn gated_add_backward(
        tokens: usize, d: usize, go: &[f32], y: &[f32], modulation: &[f32], stride: usize, at: usize,
        dy: &mut [f32], dmodulation: &mut [f32],
    ) = gated_add_backward_body
}

#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn gated_add_backward_body<const FMA: bool>(
    tokens: usize,
    d: usize,
    go: &[f32],
    y: &[f32],
    modulation: &[f32],
    stride: usize,
    at: usize,
    dy: &mut [f32],
    dmodulation: &mut [f32],
) {
    for (row, dy) in dy.chunks_exact_mut(d).enumerate() {
        let sample = (row / tokens) * stride + at;
        let gate = &modulation[sample..][..d];
        let dgate = &mut dmodulation[sample..][..d];
        if row % tokens == 0 {
            dgate.fill(0.0);
        }
        let (go, y) = (&go[row * d..][..d], &y[row * d..][..d]);
        for i in 0..d {
            dy[i] = go[i] * gate[i];
            dgate[i] = fma::<FMA>(go[i], y[i], dgate[i]);
        }
    }
}

dispatch! {
    /// `sums[n] += sum over rows of x[rows, n]`.
    pub fn column_sums(x: &[f32], sums: &mut [f32]) = column_sums_body
}

#[inline(always)]
fn column_sums_body<const FMA: bool>(x: &[f32], sums: &mut [f32]) {
    let _ = FMA;
    for row in x.chunks_exact(sums.len()) {
        for (s, v) in sums.iter_mut().zip(row) {
            *s += v;
        }
    }
}

dispatch! {
    /// `y += x`.
    pub fn add(x: &[f32], y: &mut [f32]) = add_body
}

#[inline(always)]
fn add_body<const FMA: bool>(x: &[f32], y: &mut [f32]) {
    let _ = FMA;
    for (y, x) in y.iter_mut().zip(x) {
        *y += x;
    }
}

/// Adds `row` to every row of `y[rows, n]`.
pub fn add_rows(row: &[f32], y: &mut [f32]) {
    for y in y.chunks_exact_mut(row.len()) {
        add(row, y);
    }
}

/// Copies `row` into every row of `y[rows, n]`.
pub fn fill_rows(row: &[f32], y: &mut [f32]) {
    for y in y.chunks_exact_mut(row.len()) {
        y.copy_from_slice(row);
    }
}

dispatch! {
    /// Sum of squares, in f64 over blocks of 4096.
    pub fn squared_norm(x: &[f32]) -> f64 = squared_norm_body
}

#[inline(always)]
fn squared_norm_body<const FMA: bool>(x: &[f32]) -> f64 {
    let mut total = 0.0;
    for c in x.chunks(4096) {
        total += f64::from(dot::<FMA>(c, c));
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::check;

    #[test]
    fn activation_gradients_match_differences() {
        let (u, b, w) = (check::random(24, 1), check::random(8, 2), check::random(24, 3));
        let run = |u: &[f32], b: &[f32]| {
            let (mut u, mut y) = (u.to_vec(), vec![0.0; 24]);
            bias_gelu(&mut u, b, &mut y);
            (check::dot(&y, &w), u)
        };
        let (_, kept) = run(&u, &b);
        let (mut g, mut db) = (w.clone(), vec![0.0; 8]);
        gelu_backward(&kept, &mut g, &mut db);
        check::gradient("u", &u, &g, |u| run(u, &b).0);
        check::gradient("bias", &b, &db, |b| run(&u, b).0);

        let mut g = w.clone();
        silu_backward(&u, &mut g);
        check::gradient("silu", &u, &g, |u| {
            let mut y = vec![0.0; 24];
            silu(u, &mut y);
            check::dot(&y, &w)
        });
    }

    #[test]
    fn gate_gradients_match_differences() {
        let (tokens, d) = (3, 4);
        let (x, y, m) = (check::random(24, 1), check::random(24, 2), check::random(20, 3));
        let w = check::random(24, 4);
        let run = |y: &[f32], m: &[f32]| {
            let mut out = vec![0.0; 24];
            gated_add(tokens, d, &x, y, m, 10, 2, &mut out);
            check::dot(&out, &w)
        };
        let (mut dy, mut dm) = (vec![0.0; 24], vec![0.0; 20]);
        gated_add_backward(tokens, d, &w, &y, &m, 10, 2, &mut dy, &mut dm);
        check::gradient("y", &y, &dy, |y| run(y, &m));
        check::gradient("modulation", &m, &dm, |m| run(&y, m));
    }
}
