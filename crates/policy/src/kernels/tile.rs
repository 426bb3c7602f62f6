//! The innermost product: up to 8 rows by 32 (or 16) columns, held in registers over the whole sum.

use super::SimdLevel;

/// Columns of a wide tile.
pub(crate) const WIDTH: usize = 32;

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

/// `c[rows, W * 16] += a[rows, depth] b[depth, W * 16]` for any number of rows, `W` 1 or 2; the rows
/// of `b` and `c` are contiguous and `b_row`, `c_row` apart.
pub(crate) fn panel<const W: usize>(
    level: SimdLevel,
    [rows, depth]: [usize; 2],
    a: Strided,
    b: &[f32],
    b_row: usize,
    c: &mut [f32],
    c_row: usize,
) {
    if rows == 0 || depth == 0 {
        return;
    }
    assert!((rows - 1) * a.row + (depth - 1) * a.column < a.data.len(), "left matrix");
    assert!((depth - 1) * b_row + W * 16 <= b.len(), "right matrix");
    assert!((rows - 1) * c_row + W * 16 <= c.len(), "result");
    let mut at = 0;
    while at < rows {
        let (a, c) = (a.from_row(at), &mut c[at * c_row..]);
        at += match rows - at {
            8.. => tile::<8, W>(level, depth, a, b, b_row, c, c_row),
            4.. => tile::<4, W>(level, depth, a, b, b_row, c, c_row),
            2.. => tile::<2, W>(level, depth, a, b, b_row, c, c_row),
            _ => tile::<1, W>(level, depth, a, b, b_row, c, c_row),
        };
    }
}

/// One tile of `R` rows; returns `R`. The sizes were checked by the caller.
#[inline]
fn tile<const R: usize, const W: usize>(
    level: SimdLevel,
    depth: usize,
    a: Strided,
    b: &[f32],
    b_row: usize,
    c: &mut [f32],
    c_row: usize,
) -> usize {
    match level {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the processor has the features; the panel's sizes were checked.
        SimdLevel::Avx512 => unsafe { x86::avx512::<R, W>(depth, a, b, b_row, c, c_row) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above. Four rows and 16 columns are what 16 registers hold.
        SimdLevel::Avx2 => unsafe {
            if R == 8 {
                x86::avx2::<4, W>(depth, a, b, b_row, c, c_row);
                x86::avx2::<4, W>(depth, a.from_row(4), b, b_row, &mut c[4 * c_row..], c_row);
            } else {
                x86::avx2::<R, W>(depth, a, b, b_row, c, c_row);
            }
        },
        _ => plain::<R, W>(depth, a, b, b_row, c, c_row),
    }
    R
}

fn plain<const R: usize, const W: usize>(
    depth: usize,
    a: Strided,
    b: &[f32],
    b_row: usize,
    c: &mut [f32],
    c_row: usize,
) {
    for r in 0..R {
        let c = &mut c[r * c_row..][..W * 16];
        for k in 0..depth {
            let v = a.data[r * a.row + k * a.column];
            for (c, b) in c.iter_mut().zip(&b[k * b_row..][..W * 16]) {
                *c += v * b;
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::Strided;
    use std::arch::x86_64::*;

    /// # Safety
    /// `R` rows, `depth` and `W * 16` columns lie within the slices as `panel` checks; AVX-512F.
    #[target_feature(enable = "avx512f")]
    pub unsafe fn avx512<const R: usize, const W: usize>(
        depth: usize,
        a: Strided,
        b: &[f32],
        b_row: usize,
        c: &mut [f32],
        c_row: usize,
    ) {
        // SAFETY: offsets stay within what the caller vouches for.
        unsafe {
            let (a_row, a_column, a) = (a.row, a.column, a.data.as_ptr());
            let (b, c) = (b.as_ptr(), c.as_mut_ptr());
            let mut sums = [[_mm512_setzero_ps(); W]; R];
            for k in 0..depth {
                let b = b.add(k * b_row);
                let mut row = [_mm512_setzero_ps(); W];
                for w in 0..W {
                    row[w] = _mm512_loadu_ps(b.add(16 * w));
                }
                for r in 0..R {
                    let v = _mm512_set1_ps(*a.add(r * a_row + k * a_column));
                    for w in 0..W {
                        sums[r][w] = _mm512_fmadd_ps(v, row[w], sums[r][w]);
                    }
                }
            }
            for r in 0..R {
                for w in 0..W {
                    let c = c.add(r * c_row + 16 * w);
                    _mm512_storeu_ps(c, _mm512_add_ps(_mm512_loadu_ps(c), sums[r][w]));
                }
            }
        }
    }

    /// # Safety
    /// As [`avx512`], with AVX2 and FMA.
    #[target_feature(enable = "avx2,fma")]
    pub unsafe fn avx2<const R: usize, const W: usize>(
        depth: usize,
        a: Strided,
        b: &[f32],
        b_row: usize,
        c: &mut [f32],
        c_row: usize,
    ) {
        // SAFETY: offsets stay within what the caller vouches for.
        unsafe {
            let (a_row, a_column, a) = (a.row, a.column, a.data.as_ptr());
            for w in 0..W {
                let (b, c) = (b.as_ptr().add(16 * w), c.as_mut_ptr().add(16 * w));
                let (mut low, mut high) = ([_mm256_setzero_ps(); R], [_mm256_setzero_ps(); R]);
                for k in 0..depth {
                    let b = b.add(k * b_row);
                    let (b0, b1) = (_mm256_loadu_ps(b), _mm256_loadu_ps(b.add(8)));
                    for r in 0..R {
                        let v = _mm256_set1_ps(*a.add(r * a_row + k * a_column));
                        low[r] = _mm256_fmadd_ps(v, b0, low[r]);
                        high[r] = _mm256_fmadd_ps(v, b1, high[r]);
                    }
                }
                for r in 0..R {
                    let c = c.add(r * c_row);
                    _mm256_storeu_ps(c, _mm256_add_ps(_mm256_loadu_ps(c), low[r]));
                    _mm256_storeu_ps(c.add(8), _mm256_add_ps(_mm256_loadu_ps(c.add(8)), high[r]));
                }
            }
        }
    }
}
