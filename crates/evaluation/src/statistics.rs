/// The value below which a share `p` (0..1) of the samples lies, linearly interpolated between the
/// neighbours; `None` without samples. Samples that are not numbers are left out.
pub fn percentile(samples: &[f64], p: f64) -> Option<f64> {
    let mut s: Vec<f64> = samples.iter().copied().filter(|v| !v.is_nan()).collect();
    if s.is_empty() {
        return None;
    }
    s.sort_by(f64::total_cmp);
    let at = p.clamp(0.0, 1.0) * (s.len() - 1) as f64;
    let (low, part) = (at.floor() as usize, at.fract());
    let high = (low + 1).min(s.len() - 1);
    Some(s[low] + (s[high] - s[low]) * part)
}

/// Wilson score interval of a success rate at 95 %: lower and upper bound, 0..1. Without trials it is
/// the whole range (E. B. Wilson, JASA 22, 1927).
pub fn wilson_interval(successes: usize, trials: usize) -> [f64; 2] {
    if trials == 0 {
        return [0.0, 1.0];
    }
    let z = 1.959_963_984_540_054;
    let n = trials as f64;
    let p = successes as f64 / n;
    let centre = p + z * z / (2.0 * n);
    let half = z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    let scale = 1.0 + z * z / n;
    [((centre - half) / scale).max(0.0), ((centre + half) / scale).min(1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;

    #[test]
    fn percentiles() {
        let s = [4.0, 1.0, 3.0, 2.0, f64::NAN];
        assert_eq!(percentile(&s, 0.0), Some(1.0));
        assert_eq!(percentile(&s, 0.5), Some(2.5));
        assert_eq!(percentile(&s, 1.0), Some(4.0));
        assert_eq!(percentile(&[], 0.5), None);
    }

    #[test]
    fn wilson_matches_published_values() {
        // 18 of 20: 0.699 to 0.972 (R, prop.test without continuity correction).
        let [low, high] = wilson_interval(18, 20);
        assert_abs_diff_eq!(low, 0.699, epsilon = 1e-3);
        assert_abs_diff_eq!(high, 0.972, epsilon = 1e-3);
        assert_eq!(wilson_interval(0, 0), [0.0, 1.0]);
        assert_eq!(wilson_interval(5, 5)[1], 1.0);
    }
}
