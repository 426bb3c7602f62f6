//! AdamW (Loshchilov and Hutter 2019) in place on flat parameters.

use super::dispatch;
use super::math::fma;

/// Settings of one step.
#[derive(Debug, Clone, Copy)]
pub struct AdamW {
    /// Learning rate.
    pub lr: f32,
    /// Decay of the mean of the gradient.
    pub beta1: f32,
    /// Decay of the mean of its square.
    pub beta2: f32,
    /// Decoupled weight decay.
    pub weight_decay: f32,
    /// Factor on the gradient (clipping).
    pub gradient_scale: f32,
    /// Steps taken including this one.
    pub step: u32,
}

dispatch! {
    /// One step: `theta = theta (1 - lr wd) - lr m_hat / (sqrt(v_hat) + 1e-8)`.
    pub fn adamw(a: AdamW, theta: &mut [f32], g: &[f32], m: &mut [f32], v: &mut [f32]) = body
}

#[inline(always)]
fn body<const FMA: bool>(a: AdamW, theta: &mut [f32], g: &[f32], m: &mut [f32], v: &mut [f32]) {
    let c1 = 1.0 / (1.0 - f64::from(a.beta1).powi(a.step as i32)) as f32;
    let c2 = 1.0 / (1.0 - f64::from(a.beta2).powi(a.step as i32)) as f32;
    let keep = 1.0 - a.lr * a.weight_decay;
    for (((t, g), m), v) in theta.iter_mut().zip(g).zip(m).zip(v) {
        let g = g * a.gradient_scale;
        *m = fma::<FMA>(a.beta1, *m, (1.0 - a.beta1) * g);
        *v = fma::<FMA>(a.beta2, *v, (1.0 - a.beta2) * g * g);
        *t = *t * keep - a.lr * (*m * c1) / ((*v * c2).sqrt() + 1e-8);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_steps_by_hand() {
        let (mut t, mut m, mut v) = ([0.5f32], [0.0f32], [0.0f32]);
        let (mut ht, mut hm, mut hv) = (0.5f64, 0.0f64, 0.0f64);
        for (step, g) in [0.3f32, -0.1, 0.7].into_iter().enumerate() {
            let step = step as u32 + 1;
            let a = AdamW {
                lr: 0.01,
                beta1: 0.9,
                beta2: 0.98,
                weight_decay: 0.1,
                gradient_scale: 0.5,
                step,
            };
            adamw(a, &mut t, &[g], &mut m, &mut v);
            let g = f64::from(g) * 0.5;
            hm = 0.9 * hm + 0.1 * g;
            hv = 0.98 * hv + 0.02 * g * g;
            let (mh, vh) =
                (hm / (1.0 - 0.9f64.powi(step as i32)), hv / (1.0 - 0.98f64.powi(step as i32)));
            ht = ht * (1.0 - 0.001) - 0.01 * mh / (vh.sqrt() + 1e-8);
        }
        assert!((f64::from(t[0]) - ht).abs() < 1e-6);
    }
}
