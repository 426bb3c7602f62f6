//! Transposing in blocks that registers hold.

use super::SimdLevel;

/// `to[columns, rows] = from[rows, columns]^T`; the rows of `from` are `from_row` apart, those of `to`
/// `to_row`.
pub(crate) fn transpose(
    level: SimdLevel,
    [rows, columns]: [usize; 2],
    from: &[f32],
    from_row: usize,
    to: &mut [f32],
    to_row: usize,
) {
    if rows == 0 || columns == 0 {
        return;
    }
    assert!((rows - 1) * from_row + columns <= from.len(), "source");
    assert!((columns - 1) * to_row + rows <= to.len(), "result");
    let (mut full_rows, mut full_columns) = (0, 0);
    #[cfg(target_arch = "x86_64")]
    if level != SimdLevel::Baseline {
        (full_rows, full_columns) = (rows - rows % 8, columns - columns % 8);
        for r in (0..full_rows).step_by(8) {
            for c in (0..full_columns).step_by(8) {
                let (from, to) = (&from[r * from_row + c..], &mut to[c * to_row + r..]);
                // SAFETY: the processor has AVX2; both blocks of 8 by 8 lie within the sizes checked.
                unsafe { x86::eight_by_eight(from.as_ptr(), from_row, to.as_mut_ptr(), to_row) };
            }
        }
    }
    let _ = level;
    for r in 0..rows {
        let first = if r < full_rows { full_columns } else { 0 };
        for c in first..columns {
            to[c * to_row + r] = from[r * from_row + c];
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    /// # Safety
    /// Eight rows of eight values can be read and written; AVX2.
    #[target_feature(enable = "avx2")]
    pub unsafe fn eight_by_eight(from: *const f32, from_row: usize, to: *mut f32, to_row: usize) {
        // SAFETY: as the caller vouches for.
        unsafe {
            let row = |i: usize| _mm256_loadu_ps(from.add(i * from_row));
            let (mut pairs, mut fours) = ([_mm256_setzero_ps(); 8], [_mm256_setzero_ps(); 8]);
            for i in 0..4 {
                pairs[2 * i] = _mm256_unpacklo_ps(row(2 * i), row(2 * i + 1));
                pairs[2 * i + 1] = _mm256_unpackhi_ps(row(2 * i), row(2 * i + 1));
            }
            for i in [0, 4] {
                fours[i] = _mm256_shuffle_ps::<0x44>(pairs[i], pairs[i + 2]);
                fours[i + 1] = _mm256_shuffle_ps::<0xee>(pairs[i], pairs[i + 2]);
                fours[i + 2] = _mm256_shuffle_ps::<0x44>(pairs[i + 1], pairs[i + 3]);
                fours[i + 3] = _mm256_shuffle_ps::<0xee>(pairs[i + 1], pairs[i + 3]);
            }
            for i in 0..4 {
                let low = _mm256_permute2f128_ps::<0x20>(fours[i], fours[i + 4]);
                let high = _mm256_permute2f128_ps::<0x31>(fours[i], fours[i + 4]);
                _mm256_storeu_ps(to.add(i * to_row), low);
                _mm256_storeu_ps(to.add((i + 4) * to_row), high);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::{check::random, levels};

    #[test]
    fn rows_become_columns_on_every_level() {
        for [rows, columns] in [[8, 8], [16, 32], [10, 16], [5, 3], [19, 25], [1, 9]] {
            let (fr, tr) = (columns + 3, rows + 2);
            let from = random(rows * fr, 1);
            for level in levels() {
                let mut to = vec![7.0; columns * tr];
                transpose(level, [rows, columns], &from, fr, &mut to, tr);
                for c in 0..columns {
                    for r in 0..rows {
                        assert_eq!(to[c * tr + r], from[r * fr + c], "{level:?} {rows}x{columns}");
                    }
                    assert!(to[c * tr + rows..][..2].iter().all(|v| *v == 7.0), "beside it");
                }
            }
        }
    }
}
