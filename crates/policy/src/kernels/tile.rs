//! The innermost product: up to 8 rows by 32 (or 16) columns, held in registers over the whole sum.

use super::SimdLevel;

/// Columns of a wide tile.
pub(crate) const WIDTH: usize = 32;
/// Rows of a tall tile.
pub(crate) const TALL: usize = 8;

/// A matrix as a slice and the distances between its rows and columns.
#[derive(Clone, Copy)]
pub(crate) struct Strided<'a> {
    pub data: &'a [f32],
    pub row: usize,
    pub column: usize,
}

impl<'a> Strided<'a> {
    fn from_row(self, row: usize) -> Self {
        Self { data: &self.data[row * self.row..], ..self }
    }
}

/// What a product is added to.
#[derive(Clone, Copy)]
pub(crate) enum Start<'a> {
    /// What stands in the result already.
    Result,
    /// Nothing.
    Zero,
    /// One value per column, the same for all rows (a bias).
    Row(&'a [f32]),
}

/// `c[rows, W * 16] = start + a[rows, depth] b[depth, W * 16]` for any number of rows, `W` 1 or 2; the
/// rows of `b` and `c` are contiguous and `b_row`, `c_row` apart. With `AHEAD` the memory behind `b` is
/// brought into the cache on the way, for packed panels that are used one after the other.
#[allow(clippy::too_many_arguments)]
pub(crate) fn panel<const W: usize, const AHEAD: bool>(
    level: SimdLevel,
    [rows, depth]: [usize; 2],
    a: Strided,
    b: &[f32],
    b_row: usize,
    c: &mut [f32],
    c_row: usize,
    start: Start,
) {
    if rows == 0 {
        return;
    }
    if depth > 0 {
        assert!((rows - 1) * a.row + (depth - 1) * a.column < a.data.len(), "left matrix");
        assert!((depth - 1) * b_row + W * 16 <= b.len(), "right matrix");
    }
    assert!((rows - 1) * c_row + W * 16 <= c.len(), "result");
    if let Start::Row(row) = start {
        assert!(row.len() >= W * 16, "bias");
    }
    let right = Right { depth, b, b_row, start };
    let mut at = 0;
    while at < rows {
        // Each of the first two tiles brings one of the two cache lines of every row.
        let line = if AHEAD && at < 2 * TALL { depth * b_row + 2 * at } else { 0 };
        let (a, c) = (a.from_row(at), &mut c[at * c_row..]);
        at += match rows - at {
            8.. if AHEAD && line > 0 => tile::<8, W, true>(level, a, &right, c, c_row, line),
            8.. => tile::<8, W, false>(level, a, &right, c, c_row, 0),
            4.. => tile::<4, W, false>(level, a, &right, c, c_row, 0),
            2.. => tile::<2, W, false>(level, a, &right, c, c_row, 0),
            _ => tile::<1, W, false>(level, a, &right, c, c_row, 0),
        };
    }
}

/// What all tiles of a panel share.
struct Right<'a> {
    depth: usize,
    b: &'a [f32],
    b_row: usize,
    start: Start<'a>,
}

/// One tile of `R` rows; returns `R`. The sizes were checked by the caller.
#[inline]
fn tile<const R: usize, const W: usize, const AHEAD: bool>(
    level: SimdLevel,
    a: Strided,
    right: &Right,
    c: &mut [f32],
    c_row: usize,
    line: usize,
) -> usize {
    match level {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the processor has the features; the panel's sizes were checked.
        SimdLevel::Avx512 => unsafe { x86::avx512::<R, W, AHEAD>(a, right, c, c_row, line) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above. Four rows and 16 columns are what 16 registers hold.
        SimdLevel::Avx2 => unsafe {
            if R == 8 {
                x86::avx2::<4, W, AHEAD>(a, right, c, c_row, line);
                x86::avx2::<4, W, false>(a.from_row(4), right, &mut c[4 * c_row..], c_row, 0);
            } else {
                x86::avx2::<R, W, false>(a, right, c, c_row, 0);
            }
        },
        _ => plain::<R, W>(a, right, c, c_row),
    }
    R
}

fn plain<const R: usize, const W: usize>(a: Strided, right: &Right, c: &mut [f32], c_row: usize) {
    for r in 0..R {
        let c = &mut c[r * c_row..][..W * 16];
        match right.start {
            Start::Result => {}
            Start::Zero => c.fill(0.0),
            Start::Row(row) => c.copy_from_slice(&row[..W * 16]),
        }
        for k in 0..right.depth {
            let v = a.data[r * a.row + k * a.column];
            for (c, b) in c.iter_mut().zip(&right.b[k * right.b_row..][..W * 16]) {
                *c += v * b;
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{Right, Start, Strided};
    use std::arch::x86_64::*;

    /// # Safety
    /// `R` rows, `depth` and `W * 16` columns lie within the slices as `panel` checks; AVX-512F.
    #[target_feature(enable = "avx512f")]
    pub unsafe fn avx512<const R: usize, const W: usize, const AHEAD: bool>(
        a: Strided,
        right: &Right,
        c: &mut [f32],
        c_row: usize,
        line: usize,
    ) {
        // SAFETY: offsets stay within what the caller vouches for; prefetching is allowed anywhere.
        unsafe {
            let (a_row, a_column) = (a.row, a.column);
            let (mut a, mut b) = (a.data.as_ptr(), right.b.as_ptr());
            let c = c.as_mut_ptr();
            let mut sums = [[_mm512_setzero_ps(); W]; R];
            for _ in 0..right.depth {
                let mut row = [_mm512_setzero_ps(); W];
                for w in 0..W {
                    row[w] = _mm512_loadu_ps(b.add(16 * w));
                }
                if AHEAD {
                    _mm_prefetch::<_MM_HINT_T0>(b.wrapping_add(line).cast());
                }
                for r in 0..R {
                    let v = _mm512_set1_ps(*a.add(r * a_row));
                    for w in 0..W {
                        sums[r][w] = _mm512_fmadd_ps(v, row[w], sums[r][w]);
                    }
                }
                a = a.wrapping_add(a_column);
                b = b.wrapping_add(right.b_row);
            }
            for r in 0..R {
                for w in 0..W {
                    let c = c.add(r * c_row + 16 * w);
                    let sum = match right.start {
                        Start::Result => _mm512_add_ps(_mm512_loadu_ps(c), sums[r][w]),
                        Start::Zero => sums[r][w],
                        Start::Row(row) => {
                            _mm512_add_ps(_mm512_loadu_ps(row.as_ptr().add(16 * w)), sums[r][w])
                        }
                    };
                    _mm512_storeu_ps(c, sum);
                }
            }
        }
    }

    /// # Safety
    /// As [`avx512`], with AVX2 and FMA.
    #[target_feature(enable = "avx2,fma")]
    pub unsafe fn avx2<const R: usize, const W: usize, const AHEAD: bool>(
        a: Strided,
        right: &Right,
        c: &mut [f32],
        c_row: usize,
        line: usize,
    ) {
        // SAFETY: as for `avx512`.
        unsafe {
            let (a_row, a_column) = (a.row, a.column);
            for w in 0..W {
                let (mut a, mut b) = (a.data.as_ptr(), right.b.as_ptr().add(16 * w));
                let c = c.as_mut_ptr().add(16 * w);
                let (mut low, mut high) = ([_mm256_setzero_ps(); R], [_mm256_setzero_ps(); R]);
                for _ in 0..right.depth {
                    let (b0, b1) = (_mm256_loadu_ps(b), _mm256_loadu_ps(b.add(8)));
                    if AHEAD {
                        _mm_prefetch::<_MM_HINT_T0>(b.wrapping_add(line).cast());
                    }
                    for r in 0..R {
                        let v = _mm256_set1_ps(*a.add(r * a_row));
                        low[r] = _mm256_fmadd_ps(v, b0, low[r]);
                        high[r] = _mm256_fmadd_ps(v, b1, high[r]);
                    }
                    a = a.wrapping_add(a_column);
                    b = b.wrapping_add(right.b_row);
                }
                for r in 0..R {
                    let c = c.add(r * c_row);
                    let (l, h) = match right.start {
                        Start::Result => (
                            _mm256_add_ps(_mm256_loadu_ps(c), low[r]),
                            _mm256_add_ps(_mm256_loadu_ps(c.add(8)), high[r]),
                        ),
                        Start::Zero => (low[r], high[r]),
                        Start::Row(row) => {
                            let row = row.as_ptr().add(16 * w);
                            (
                                _mm256_add_ps(_mm256_loadu_ps(row), low[r]),
                                _mm256_add_ps(_mm256_loadu_ps(row.add(8)), high[r]),
                            )
                        }
                    };
                    _mm256_storeu_ps(c, l);
                    _mm256_storeu_ps(c.add(8), h);
                }
            }
        }
    }
}
