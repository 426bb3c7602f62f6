//! The noise schedule and the samplers of the diffusion.

use crate::{PolicyError, Prediction, Sampler};

/// Squared-cosine schedule (Nichol and Dhariwal 2021): `alpha_bar` of every step.
#[derive(Debug, Clone, PartialEq)]
pub struct Schedule {
    alpha_bar: Vec<f64>,
}

impl Schedule {
    /// Schedule of `steps` steps.
    pub fn squared_cosine(steps: usize) -> Self {
        let f = |i: usize| {
            let t = i as f64 / steps as f64;
            ((t + 0.008) / 1.008 * std::f64::consts::FRAC_PI_2).cos().powi(2)
        };
        let mut product = 1.0;
        let alpha_bar = (0..steps)
            .map(|i| {
                let beta = (1.0 - f(i + 1) / f(i)).min(0.999);
                product *= 1.0 - beta;
                product
            })
            .collect();
        Self { alpha_bar }
    }

    /// Steps K.
    pub fn len(&self) -> usize {
        self.alpha_bar.len()
    }

    /// True for a schedule without steps.
    pub fn is_empty(&self) -> bool {
        self.alpha_bar.is_empty()
    }

    /// Share of the signal's variance that is left at step `k`.
    pub fn alpha_bar(&self, k: usize) -> f64 {
        self.alpha_bar[k]
    }

    /// `count` steps from K-1 down to 0, evenly spaced and rounded; both ends are included (one
    /// step: only K-1).
    ///
    /// # Errors
    /// [`PolicyError::InferenceSteps`] unless `1 <= count <= K`.
    pub fn timesteps(&self, count: usize) -> Result<Vec<usize>, PolicyError> {
        let train = self.len();
        if count == 0 || count > train {
            return Err(PolicyError::InferenceSteps { inference: count, train });
        }
        Ok(spaced(train - 1, count))
    }

    /// Noisy trajectory at step `k`: `sqrt(ab) clean + sqrt(1 - ab) noise`.
    pub fn add_noise(&self, k: usize, clean: &[f32], noise: &[f32], noisy: &mut [f32]) {
        let (a, s) = self.roots(k);
        for ((y, x), n) in noisy.iter_mut().zip(clean).zip(noise) {
            *y = a * x + s * n;
        }
    }

    /// What the network shall predict at step `k`.
    pub fn target(&self, p: Prediction, k: usize, clean: &[f32], noise: &[f32], out: &mut [f32]) {
        let (a, s) = self.roots(k);
        for ((y, x), n) in out.iter_mut().zip(clean).zip(noise) {
            *y = match p {
                Prediction::Sample => *x,
                Prediction::Epsilon => *n,
                Prediction::V => a * n - s * x,
            };
        }
    }

    fn roots(&self, k: usize) -> (f32, f32) {
        let ab = self.alpha_bar[k];
        (ab.sqrt() as f32, (1.0 - ab).sqrt() as f32)
    }

    /// The sampler's steps.
    ///
    /// # Errors
    /// As [`Schedule::timesteps`].
    pub fn plan(
        &self,
        sampler: Sampler,
        prediction: Prediction,
        count: usize,
        clip: f64,
    ) -> Result<SamplingPlan, PolicyError> {
        let timesteps = self.timesteps(count)?;
        Ok(self.steps(sampler, prediction, &timesteps, clip))
    }

    /// The sampler's steps from step `level` down to 0, for a trajectory that is noised only that
    /// far; `1 <= count <= level + 1 <= K` is the caller's to keep.
    pub(crate) fn plan_below(
        &self,
        sampler: Sampler,
        prediction: Prediction,
        count: usize,
        level: usize,
        clip: f64,
    ) -> SamplingPlan {
        self.steps(sampler, prediction, &spaced(level, count), clip)
    }

    fn steps(&self, s: Sampler, p: Prediction, timesteps: &[usize], clip: f64) -> SamplingPlan {
        let steps = timesteps
            .iter()
            .enumerate()
            .map(|(i, &k)| {
                let previous = timesteps.get(i + 1).map_or(1.0, |&k| self.alpha_bar[k]);
                SamplingStep::new(s, p, k, self.alpha_bar[k], previous)
            })
            .collect();
        SamplingPlan { steps, clip: clip as f32 }
    }
}

/// `count` rounded numbers from `last` down to 0; one number: only `last`.
fn spaced(last: usize, count: usize) -> Vec<usize> {
    (0..count)
        .map(|i| {
            let part = if count == 1 { 0.0 } else { i as f64 / (count - 1) as f64 };
            (last as f64 * (1.0 - part)).round() as usize
        })
        .collect()
}

/// One step of a sampler, everything constant in it computed once:
/// `clean = clip(from_x x + from_out out)`, `x = keep_clean clean + keep_x x + sigma noise`.
#[derive(Debug, Clone, Copy)]
pub struct SamplingStep {
    /// The diffusion step, the network's time input.
    pub k: usize,
    from_x: f32,
    from_out: f32,
    keep_clean: f32,
    keep_x: f32,
    /// Standard deviation of fresh noise; zero for DDIM and in the last step.
    pub sigma: f32,
}

impl SamplingStep {
    fn new(sampler: Sampler, prediction: Prediction, k: usize, ab: f64, previous: f64) -> Self {
        let (a, s) = (ab.sqrt(), (1.0 - ab).sqrt());
        let (from_x, from_out) = match prediction {
            Prediction::Sample => (0.0, 1.0),
            Prediction::Epsilon => (1.0 / a, -s / a),
            Prediction::V => (a, -s),
        };
        let (keep_clean, keep_x, sigma) = match sampler {
            Sampler::Ddim => {
                let to_noise = (1.0 - previous).sqrt() / s;
                (previous.sqrt() - to_noise * a, to_noise, 0.0)
            }
            Sampler::Ddpm => {
                let alpha = ab / previous;
                let clean = previous.sqrt() * (1.0 - alpha) / (1.0 - ab);
                let x = alpha.sqrt() * (1.0 - previous) / (1.0 - ab);
                (clean, x, ((1.0 - previous) / (1.0 - ab) * (1.0 - alpha)).sqrt())
            }
        };
        Self {
            k,
            from_x: from_x as f32,
            from_out: from_out as f32,
            keep_clean: keep_clean as f32,
            keep_x: keep_x as f32,
            sigma: sigma as f32,
        }
    }
}

/// A sampler made for one number of steps.
#[derive(Debug, Clone)]
pub struct SamplingPlan {
    /// From the noisiest to the clean end.
    pub steps: Vec<SamplingStep>,
    clip: f32,
}

impl SamplingPlan {
    /// Replaces `x` by the next less noisy trajectory, given the network's output for it. `noise` is
    /// called once per number when the step is random.
    pub fn advance(
        &self,
        step: &SamplingStep,
        x: &mut [f32],
        out: &[f32],
        mut noise: impl FnMut() -> f32,
    ) {
        for (x, out) in x.iter_mut().zip(out) {
            let clean = (step.from_x * *x + step.from_out * out).clamp(-self.clip, self.clip);
            *x = step.keep_clean * clean + step.keep_x * *x;
            if step.sigma > 0.0 {
                *x += step.sigma * noise();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cosine_values_and_spacing() {
        let s = Schedule::squared_cosine(100);
        // cos^2 form: alpha_bar follows f((i+1)/K)/f(0) until the last, capped beta.
        let f = |t: f64| ((t + 0.008) / 1.008 * std::f64::consts::FRAC_PI_2).cos().powi(2);
        for i in 0..99 {
            assert!((s.alpha_bar(i) - f((i + 1) as f64 / 100.0) / f(0.0)).abs() < 1e-12);
        }
        assert!((s.alpha_bar(99) / s.alpha_bar(98) - 0.001).abs() < 1e-9);
        assert_eq!(s.timesteps(10).unwrap(), [99, 88, 77, 66, 55, 44, 33, 22, 11, 0]);
        assert_eq!(s.timesteps(1).unwrap(), [99]);
        assert_eq!(s.timesteps(100).unwrap(), (0..100).rev().collect::<Vec<_>>());
        for bad in [0, 101] {
            assert!(matches!(
                s.timesteps(bad),
                Err(PolicyError::InferenceSteps { inference, train: 100 }) if inference == bad
            ));
        }
    }

    /// With a network that always knows the truth, every sampler and prediction ends on it.
    #[test]
    fn perfect_predictions_are_recovered() {
        let s = Schedule::squared_cosine(100);
        let clean = [0.3f32, -0.9, 0.05];
        for sampler in [Sampler::Ddim, Sampler::Ddpm] {
            for prediction in [Prediction::Sample, Prediction::Epsilon, Prediction::V] {
                for count in [1, 4, 10, 100] {
                    let plan = s.plan(sampler, prediction, count, 1.1).unwrap();
                    let mut x = [1.5f32, -0.2, 0.7];
                    let mut rng = crate::rng::stream(3, crate::rng::Stream::Sampler);
                    let mut noise =
                        || rand::Rng::sample::<f32, _>(&mut rng, rand_distr::StandardNormal);
                    for step in &plan.steps {
                        let (a, b) = s.roots(step.k);
                        let eps: Vec<f32> =
                            x.iter().zip(&clean).map(|(x, c)| (x - a * c) / b).collect();
                        let mut out = [0.0; 3];
                        s.target(prediction, step.k, &clean, &eps, &mut out);
                        plan.advance(step, &mut x, &out, &mut noise);
                    }
                    for (x, c) in x.iter().zip(&clean) {
                        assert!(
                            (x - c).abs() < 2e-3,
                            "{sampler:?} {prediction:?} {count}: {x} {c}"
                        );
                    }
                }
            }
        }
    }
}
