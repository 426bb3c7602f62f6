//! Slice kernels of the network, forward and backward, written once and compiled for AVX-512, AVX2
//! and the baseline; the processor decides at run time.
//!
//! All matrices are row-major f32. Sums run in a fixed order, so equal inputs give equal bytes on
//! equal processors.

mod adamw;
mod attention;
mod layer_norm;
mod math;
mod matmul;
mod pointwise;
mod tile;
mod transpose;

pub use adamw::{AdamW, adamw};
pub use attention::{AttentionShape, attention, attention_backward};
pub use layer_norm::{LayerNormShape, layer_norm_modulate, layer_norm_modulate_backward};
pub use matmul::{matmul, matmul_bias, matmul_nt, matmul_tn};
pub use pointwise::{
    add, add_rows, bias_gelu, column_sums, fill_rows, gated_add, gated_add_backward, gelu,
    gelu_backward, silu, silu_backward, squared_norm,
};

pub(crate) use tile::{Start, Strided, WIDTH, panel};
pub(crate) use transpose::transpose;

/// What the vector units of this processor can do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SimdLevel {
    /// Only what every processor of the architecture has.
    Baseline,
    /// AVX2 and FMA.
    Avx2,
    /// AVX-512 F, VL, DQ and BW.
    Avx512,
}

/// The best level of this processor (detected once by the standard library).
#[inline]
pub fn simd_level() -> SimdLevel {
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512bw")
        {
            return SimdLevel::Avx512;
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            return SimdLevel::Avx2;
        }
    }
    SimdLevel::Baseline
}

/// All levels that this processor has.
#[cfg(test)]
pub(crate) fn levels() -> Vec<SimdLevel> {
    match simd_level() {
        SimdLevel::Avx512 => vec![SimdLevel::Avx512, SimdLevel::Avx2, SimdLevel::Baseline],
        SimdLevel::Avx2 => vec![SimdLevel::Avx2, SimdLevel::Baseline],
        SimdLevel::Baseline => vec![SimdLevel::Baseline],
    }
}

/// Compiles the generic `$body::<FMA>` three times and picks one by [`simd_level`].
macro_rules! dispatch {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $ty:ty),* $(,)?) $(-> $ret:ty)? = $body:ident) => {
        $(#[$meta])*
        #[allow(clippy::too_many_arguments)]
        $vis fn $name($($arg: $ty),*) $(-> $ret)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma")]
                #[allow(clippy::too_many_arguments)]
                fn v4($($arg: $ty),*) $(-> $ret)? { $body::<true>($($arg),*) }
                #[target_feature(enable = "avx2,fma")]
                #[allow(clippy::too_many_arguments)]
                fn v3($($arg: $ty),*) $(-> $ret)? { $body::<true>($($arg),*) }
                match $crate::kernels::simd_level() {
                    // SAFETY: the processor has the features, it was just asked.
                    $crate::kernels::SimdLevel::Avx512 => return unsafe { v4($($arg),*) },
                    // SAFETY: as above.
                    $crate::kernels::SimdLevel::Avx2 => return unsafe { v3($($arg),*) },
                    $crate::kernels::SimdLevel::Baseline => {}
                }
            }
            $body::<{ cfg!(target_arch = "aarch64") }>($($arg),*)
        }
    };
}
pub(crate) use dispatch;

#[cfg(test)]
pub(crate) mod check {
    //! Finite differences for the kernels' backward passes.
    use rand::Rng;

    pub fn random(n: usize, seed: u64) -> Vec<f32> {
        let mut rng = crate::rng::stream(seed, crate::rng::Stream::Init);
        (0..n).map(|_| rng.random_range(-1.0f32..1.0)).collect()
    }

    /// Compares `gradient` with central differences of `f` around `x` (all coordinates).
    pub fn gradient(name: &str, x: &[f32], gradient: &[f32], mut f: impl FnMut(&[f32]) -> f64) {
        let h = 1e-2f32;
        let mut y = x.to_vec();
        for i in 0..x.len() {
            y[i] = x[i] + h;
            let up = f(&y);
            y[i] = x[i] - h;
            let down = f(&y);
            y[i] = x[i];
            let numeric = (up - down) / (2.0 * f64::from(h));
            let error = (numeric - f64::from(gradient[i])).abs();
            assert!(
                error < 2e-3 * (1.0 + numeric.abs()),
                "{name}[{i}]: analytic {} against numeric {numeric}",
                gradient[i]
            );
        }
    }

    pub fn dot(a: &[f32], b: &[f32]) -> f64 {
        a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
    }
}
