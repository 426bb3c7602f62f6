//! Row-major products for the sizes of this network, single-threaded (the trainer splits the batch
//! instead). The right matrix is packed into panels that stay in the innermost cache, the left one where
//! its columns are to be rows; sums go on in the result from one block of the depth to the next.

use super::tile::{Start, Strided, TALL, WIDTH, panel};
use super::transpose::transpose;
use super::{SimdLevel, simd_level};
use std::cell::RefCell;

/// Longest sum in one go: its packed panel fills three quarters of a cache of 32 kB.
const DEPTH: usize = 192;
/// With so few rows packing costs more than it saves.
const FEW: usize = 24;

/// Packed parts of the matrices, and a padded result.
#[derive(Default)]
struct Packed {
    left: Vec<f32>,
    right: Vec<f32>,
    result: Vec<f32>,
}

thread_local! {
    static PACKED: RefCell<Packed> = RefCell::default();
}

/// The right matrix `[depth, columns]`.
#[derive(Clone, Copy)]
enum Right<'a> {
    /// Row-major as it is.
    Rows(&'a [f32]),
    /// Row-major `[columns, depth]`, to be transposed.
    Columns(&'a [f32]),
}

/// `c[m,n] = a[m,k] b[k,n]`, added to what is in `c` when `accumulate`.
pub fn matmul(a: &[f32], b: &[f32], c: &mut [f32], [m, k, n]: [usize; 3], accumulate: bool) {
    assert!(a.len() >= m * k && b.len() >= k * n && c.len() >= m * n, "matrix sizes");
    let start = if accumulate { Start::Result } else { Start::Zero };
    let a = Strided { data: a, row: k, column: 1 };
    product(simd_level(), [m, k, n], a, Right::Rows(b), c, start);
}

/// `c[m,n] = bias[n] + a[m,k] b[k,n]`.
pub fn matmul_bias(a: &[f32], b: &[f32], bias: &[f32], c: &mut [f32], [m, k, n]: [usize; 3]) {
    assert!(a.len() >= m * k && b.len() >= k * n && c.len() >= m * n, "matrix sizes");
    assert!(bias.len() >= n, "bias");
    let a = Strided { data: a, row: k, column: 1 };
    product(simd_level(), [m, k, n], a, Right::Rows(b), c, Start::Row(bias));
}

/// `c[m,k] = a[m,n] b[k,n]^T`: the gradient of an input through the weights `b`.
pub fn matmul_nt(a: &[f32], b: &[f32], c: &mut [f32], [m, n, k]: [usize; 3], accumulate: bool) {
    assert!(a.len() >= m * n && b.len() >= k * n && c.len() >= m * k, "matrix sizes");
    let start = if accumulate { Start::Result } else { Start::Zero };
    let a = Strided { data: a, row: n, column: 1 };
    product(simd_level(), [m, n, k], a, Right::Columns(b), c, start);
}

/// `c[k,n] += a[m,k]^T b[m,n]`: the gradient of weights, accumulated.
pub fn matmul_tn(a: &[f32], b: &[f32], c: &mut [f32], [m, k, n]: [usize; 3]) {
    assert!(a.len() >= m * k && b.len() >= m * n && c.len() >= k * n, "matrix sizes");
    let a = Strided { data: a, row: 1, column: k };
    product(simd_level(), [k, m, n], a, Right::Rows(b), c, Start::Result);
}

/// The first `len` floats of a buffer that only grows; what is in them is anything.
fn room(buffer: &mut Vec<f32>, len: usize) -> &mut [f32] {
    if buffer.len() < len {
        buffer.resize(len, 0.0);
    }
    &mut buffer[..len]
}

/// `c[m,n] = start + a[m,k] b[k,n]`.
fn product(
    level: SimdLevel,
    [m, k, n]: [usize; 3],
    a: Strided,
    b: Right,
    c: &mut [f32],
    start: Start,
) {
    if m == 0 || n == 0 {
        return;
    }
    let blocks = k.div_ceil(DEPTH).max(1);
    let size = k.div_ceil(blocks).max(1);
    PACKED.with_borrow_mut(|packed| {
        for from in (0..k.max(1)).step_by(size) {
            let depth = size.min(k - from);
            let a = Strided { data: &a.data[(from * a.column).min(a.data.len())..], ..a };
            let a = pack_left(a, m, depth, &mut packed.left);
            for at in (0..n).step_by(WIDTH) {
                let width = WIDTH.min(n - at);
                let start = match start {
                    Start::Row(row) if from == 0 => Start::Row(&row[at..]),
                    Start::Zero if from == 0 => Start::Zero,
                    _ => Start::Result,
                };
                let (b, b_row) = match b {
                    Right::Rows(b) if m < FEW && width == WIDTH => (&b[from * n + at..], n),
                    _ => {
                        let to = room(&mut packed.right, depth * WIDTH);
                        pack_right(level, b, [from, at], [depth, width], [k, n], to);
                        (&*to, WIDTH)
                    }
                };
                if width == WIDTH {
                    rows(level, [m, depth], a, b, b_row, &mut c[at..], n, start);
                } else {
                    let padded = room(&mut packed.result, m * WIDTH);
                    ragged(level, [m, depth, width], a, b, padded, &mut c[at..], n, start);
                }
            }
        }
    });
}

/// The left matrix, and whether its tiles lie one after the other.
#[derive(Clone, Copy)]
struct Left<'a> {
    a: Strided<'a>,
    packed: bool,
}

/// Columns that stand for rows are gathered to `[tiles][depth][8]`; rows stay where they are.
fn pack_left<'a>(a: Strided<'a>, m: usize, depth: usize, to: &'a mut Vec<f32>) -> Left<'a> {
    if a.column == 1 {
        return Left { a, packed: false };
    }
    let to = room(to, m.div_ceil(TALL) * depth * TALL);
    for (t, tile) in to.chunks_exact_mut((depth * TALL).max(1)).enumerate() {
        let count = TALL.min(m - t * TALL);
        for (l, row) in tile.chunks_exact_mut(TALL).enumerate() {
            let from = &a.data[l * a.column + t * TALL * a.row..];
            if count == TALL && a.row == 1 {
                row.copy_from_slice(&from[..TALL]);
            } else {
                for (r, v) in row[..count].iter_mut().enumerate() {
                    *v = from[r * a.row];
                }
            }
        }
    }
    Left { a: Strided { data: to, row: 1, column: TALL }, packed: true }
}

/// Rows `from..from + depth` and columns `at..at + width` as `[depth][32]`, padded with zeros.
fn pack_right(
    level: SimdLevel,
    b: Right,
    [from, at]: [usize; 2],
    [depth, width]: [usize; 2],
    [k, n]: [usize; 2],
    to: &mut [f32],
) {
    if width < WIDTH {
        to.fill(0.0);
    }
    match b {
        Right::Rows(b) => {
            for (l, to) in to.chunks_exact_mut(WIDTH).enumerate() {
                let row = &b[(from + l) * n + at..];
                if width == WIDTH {
                    to.copy_from_slice(&row[..WIDTH]);
                } else {
                    to[..width].copy_from_slice(&row[..width]);
                }
            }
        }
        Right::Columns(b) => {
            transpose(level, [width, depth], &b[at * k + from..], k, to, WIDTH);
        }
    }
}

/// One panel over all rows.
#[allow(clippy::too_many_arguments)]
fn rows(
    level: SimdLevel,
    [m, depth]: [usize; 2],
    left: Left,
    b: &[f32],
    b_row: usize,
    c: &mut [f32],
    c_row: usize,
    start: Start,
) {
    if !left.packed {
        panel::<2, false>(level, [m, depth], left.a, b, b_row, c, c_row, start);
        return;
    }
    for at in (0..m).step_by(TALL) {
        let a = Strided { data: &left.a.data[at * depth..], ..left.a };
        let count = TALL.min(m - at);
        panel::<2, false>(level, [count, depth], a, b, b_row, &mut c[at * c_row..], c_row, start);
    }
}

/// The last, narrower columns, by way of a padded result.
#[allow(clippy::too_many_arguments)]
fn ragged(
    level: SimdLevel,
    [m, depth, width]: [usize; 3],
    left: Left,
    b: &[f32],
    padded: &mut [f32],
    c: &mut [f32],
    c_row: usize,
    start: Start,
) {
    rows(level, [m, depth], left, b, WIDTH, padded, WIDTH, Start::Zero);
    for (p, c) in padded.chunks_exact(WIDTH).zip(c.chunks_mut(c_row)) {
        for (j, (c, p)) in c.iter_mut().zip(&p[..width]).enumerate() {
            *c = p + match start {
                Start::Result => *c,
                Start::Zero => 0.0,
                Start::Row(row) => row[j],
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::{check::random, levels};

    const SIZES: [[usize; 3]; 8] = [
        [7, 5, 11],
        [16, 64, 96],
        [13, 9, 64],
        [40, 33, 41],
        [1, 3, 32],
        [256, 64, 9],
        [30, 500, 70],
        [40, 0, 40],
    ];

    /// Sum of `k` products of numbers within -1..1: what rounding may leave.
    fn close(a: f32, b: f32, k: usize) -> bool {
        (a - b).abs() < 1e-5 * (1.0 + k as f32 / 50.0)
    }

    #[test]
    fn the_three_products_agree_with_loops() {
        for [m, k, n] in SIZES {
            let (a, b, g) = (random(m * k, 1), random(k * n, 2), random(m * n, 3));
            let mut c = vec![1.0; m * n];
            matmul(&a, &b, &mut c, [m, k, n], true);
            let mut fresh = vec![f32::NAN; m * n];
            matmul_bias(&a, &b, &g[..n], &mut fresh, [m, k, n]);
            for (i, c) in c.iter().enumerate() {
                let v: f32 = (0..k).map(|l| a[i / n * k + l] * b[l * n + i % n]).sum();
                assert!(close(c - 1.0, v, k));
                assert!(close(fresh[i] - g[i % n], v, k));
            }
            let mut da = vec![9.0; m * k];
            matmul_nt(&g, &b, &mut da, [m, n, k], false);
            for (i, d) in da.iter().enumerate() {
                let v: f32 = (0..n).map(|j| g[i / k * n + j] * b[i % k * n + j]).sum();
                assert!(close(*d, v, n));
            }
            let mut db = vec![0.5; k * n];
            matmul_tn(&a, &g, &mut db, [m, k, n]);
            for (i, d) in db.iter().enumerate() {
                let v: f32 = (0..m).map(|r| a[r * k + i / n] * g[r * n + i % n]).sum();
                assert!(close(d - 0.5, v, m));
            }
        }
    }

    #[test]
    fn every_level_gives_the_same() {
        for [m, k, n] in SIZES {
            let (a, b) = (random(m * k, 1), random(k * n, 2));
            for columns in [false, true] {
                let mut results = Vec::new();
                for level in levels() {
                    let mut c = vec![f32::NAN; m * n];
                    let left = Strided { data: &a, row: k, column: 1 };
                    let right = if columns { Right::Columns(&b) } else { Right::Rows(&b) };
                    product(level, [m, k, n], left, right, &mut c, Start::Zero);
                    results.push(c);
                }
                for other in &results[1..] {
                    for (x, y) in results[0].iter().zip(other) {
                        assert!(close(*x, *y, k), "{m}x{k}x{n}: {x} {y}");
                    }
                }
            }
        }
    }
}
