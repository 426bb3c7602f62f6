//! Scalar functions that vectorise: everything is `inline(always)` into the dispatched kernels.

/// `a * b + c`, one rounding when the target has the instruction.
#[inline(always)]
pub fn fma<const FMA: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

/// `exp(x)` within 2e-7 relative for x in -87..88 (clamped outside): range reduction by powers of
/// two and a polynomial.
#[inline(always)]
pub fn exp<const FMA: bool>(x: f32) -> f32 {
    // Adding 1.5 * 2^23 rounds to an integer that sits in the low mantissa bits.
    const ROUND: f32 = 12_582_912.0;
    let x = x.clamp(-87.0, 88.0);
    let shifted = fma::<FMA>(x, std::f32::consts::LOG2_E, ROUND);
    let z = shifted - ROUND;
    let q = fma::<FMA>(z, -0.693_145_75, x);
    let q = fma::<FMA>(z, -1.428_606_8e-6, q);
    let mut p = fma::<FMA>(q, 0.001_394, 0.008_333_4);
    p = fma::<FMA>(q, p, 0.041_666_67);
    p = fma::<FMA>(q, p, 0.166_666_67);
    p = fma::<FMA>(q, p, 0.5);
    p = fma::<FMA>(q, p, 1.0);
    p = fma::<FMA>(q, p, 1.0);
    let exponent = shifted.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127) << 23;
    p * f32::from_bits(exponent)
}

#[inline(always)]
pub fn sigmoid<const FMA: bool>(x: f32) -> f32 {
    1.0 / (1.0 + exp::<FMA>(-x))
}

const GELU_A: f32 = 2.0 * 0.797_884_6;
const GELU_B: f32 = 0.044_715;

/// GELU in its tanh form, written as `u sigmoid(2 sqrt(2/pi) (u + 0.044715 u^3))`.
#[inline(always)]
pub fn gelu<const FMA: bool>(u: f32) -> f32 {
    u * sigmoid::<FMA>(GELU_A * u * fma::<FMA>(GELU_B, u * u, 1.0))
}

/// Derivative of [`gelu`].
#[inline(always)]
pub fn gelu_slope<const FMA: bool>(u: f32) -> f32 {
    let s = sigmoid::<FMA>(GELU_A * u * fma::<FMA>(GELU_B, u * u, 1.0));
    let inner = GELU_A * fma::<FMA>(3.0 * GELU_B, u * u, 1.0);
    fma::<FMA>(u * s * (1.0 - s), inner, s)
}

/// Sum in sixteen independent lanes.
#[inline(always)]
pub fn sum(x: &[f32]) -> f32 {
    let mut acc = [0.0f32; 16];
    let (chunks, rest) = x.as_chunks::<16>();
    for c in chunks {
        for i in 0..16 {
            acc[i] += c[i];
        }
    }
    lanes(acc) + rest.iter().sum::<f32>()
}

/// Largest value in sixteen independent lanes; minus infinity of nothing.
#[inline(always)]
pub fn max(x: &[f32]) -> f32 {
    let larger = |a: f32, b: f32| if a > b { a } else { b };
    let mut acc = [f32::NEG_INFINITY; 16];
    let (chunks, rest) = x.as_chunks::<16>();
    for c in chunks {
        for i in 0..16 {
            acc[i] = larger(acc[i], c[i]);
        }
    }
    let mut half = 8;
    while half > 0 {
        for i in 0..half {
            acc[i] = larger(acc[i], acc[i + half]);
        }
        half /= 2;
    }
    rest.iter().fold(acc[0], |m, v| larger(m, *v))
}

/// Dot product in sixteen independent lanes.
#[inline(always)]
pub fn dot<const FMA: bool>(a: &[f32], b: &[f32]) -> f32 {
    let mut acc = [0.0f32; 16];
    let (ca, ra) = a.as_chunks::<16>();
    let (cb, rb) = b.as_chunks::<16>();
    for (x, y) in ca.iter().zip(cb) {
        for i in 0..16 {
            acc[i] = fma::<FMA>(x[i], y[i], acc[i]);
        }
    }
    lanes(acc) + ra.iter().zip(rb).map(|(x, y)| x * y).sum::<f32>()
}

#[inline(always)]
fn lanes(acc: [f32; 16]) -> f32 {
    let mut v = [0.0f32; 8];
    for i in 0..8 {
        v[i] = acc[i] + acc[i + 8];
    }
    ((v[0] + v[4]) + (v[1] + v[5])) + ((v[2] + v[6]) + (v[3] + v[7]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_and_gelu_are_accurate() {
        for i in -8700..8800 {
            let x = i as f32 * 0.01;
            let exact = f64::from(x).exp();
            for got in [exp::<false>(x), exp::<true>(x)] {
                assert!(((f64::from(got) - exact) / exact).abs() < 3e-7, "exp({x})");
            }
        }
        for i in -1000..1000 {
            let u = i as f32 * 0.02;
            let v = f64::from(u);
            let exact = 0.5
                * v
                * (1.0 + ((2.0 / std::f64::consts::PI).sqrt() * (v + 0.044715 * v.powi(3))).tanh());
            assert!((f64::from(gelu::<true>(u)) - exact).abs() < 1e-6 * (1.0 + v.abs()));
        }
    }
}
