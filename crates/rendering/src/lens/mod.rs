//! Lens distortion as `sensor_msgs/CameraInfo` states it, and images without it.

mod align;
mod undistort;

pub use align::{AlignError, DepthAligner};
pub use undistort::Undistorter;

use nalgebra::{Matrix2, Vector2};
use thiserror::Error;

/// Coefficients that cannot be used.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum LensError {
    /// A name that is not understood.
    #[error(
        "distortion_model {0:?} is not understood; plumb_bob, rational_polynomial and equidistant are"
    )]
    Model(String),
    /// A wrong number of coefficients.
    #[error("distortion_model {model} with {count} coefficients; expected {expected}")]
    Count {
        /// The model.
        model: String,
        /// How many there are.
        count: usize,
        /// How many there may be.
        expected: &'static str,
    },
    /// A coefficient that is NaN or infinite.
    #[error("distortion coefficient {index} is {value}: is the camera calibrated?")]
    NotFinite {
        /// Which.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// A tilted sensor.
    #[error("the coefficients of a tilted sensor (13th and 14th) are not understood")]
    Tilt,
}

/// What a lens does to ideal image coordinates (z = 1), in OpenCV's conventions.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Lens {
    /// Nothing: a pinhole.
    #[default]
    None,
    /// `plumb_bob` and `rational_polynomial`: radial, tangential and thin prism terms.
    Brown {
        /// k1 to k6; the last three in the denominator.
        radial: [f64; 6],
        /// p1, p2.
        tangential: [f64; 2],
        /// s1 to s4.
        prism: [f64; 4],
        /// Radius (z = 1) up to which the model is one to one.
        reach: f64,
    },
    /// `equidistant`, also called fisheye: a polynomial of the angle off the axis.
    Fisheye {
        /// k1 to k4.
        k: [f64; 4],
        /// Angle (rad) up to which the model is one to one.
        reach: f64,
    },
}

/// Largest radius of an ideal ray that is looked at: 80 degrees off the axis.
const WIDEST: f64 = 5.6;

impl Lens {
    /// From the fields of a `CameraInfo`. No coefficient, or only zeros, is no distortion whatever the
    /// model's name (except for a fisheye, whose zeros bend too).
    ///
    /// # Errors
    /// [`LensError`].
    pub fn from_coefficients(model: &str, d: &[f64]) -> Result<Self, LensError> {
        if let Some((index, value)) = d.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            return Err(LensError::NotFinite { index, value: *value });
        }
        let count =
            |expected| Err(LensError::Count { model: model.into(), count: d.len(), expected });
        let at = |i: usize| d.get(i).copied().unwrap_or(0.0);
        let fisheye = matches!(model, "equidistant" | "fisheye");
        if d.is_empty() || (!fisheye && d.iter().all(|v| *v == 0.0)) {
            return Ok(Self::None);
        }
        match model {
            "plumb_bob" | "rational_polynomial" | "" => {
                if ![4, 5, 8, 12, 14].contains(&d.len()) {
                    return count("4, 5, 8 or 12");
                }
                if at(12) != 0.0 || at(13) != 0.0 {
                    return Err(LensError::Tilt);
                }
                let radial = [at(0), at(1), at(4), at(5), at(6), at(7)];
                let tangential = [at(2), at(3)];
                let prism = [at(8), at(9), at(10), at(11)];
                let reach = monotonic(|r| r * factor(&radial, r * r), WIDEST);
                Ok(Self::Brown { radial, tangential, prism, reach })
            }
            "equidistant" | "fisheye" => {
                if d.len() != 4 {
                    return count("4");
                }
                let k = [at(0), at(1), at(2), at(3)];
                let reach = monotonic(|a| bend(&k, a), 1.4);
                Ok(Self::Fisheye { k, reach })
            }
            other => Err(LensError::Model(other.into())),
        }
    }

    /// Where the lens puts the ideal point (x, y) at z = 1; `None` beyond the range in which the model
    /// is one to one.
    pub fn distort(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        let r2 = x * x + y * y;
        match self {
            Self::None => Some((x, y)),
            Self::Brown { radial, tangential: [p1, p2], prism: [s1, s2, s3, s4], reach } => {
                if r2 > reach * reach {
                    return None;
                }
                let f = factor(radial, r2);
                let dx = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + (s1 + s2 * r2) * r2;
                let dy = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + (s3 + s4 * r2) * r2;
                Some((x * f + dx, y * f + dy))
            }
            Self::Fisheye { k, reach } => {
                let r = r2.sqrt();
                let angle = r.atan();
                if angle > *reach {
                    return None;
                }
                let f = if r > 1e-9 { bend(k, angle) / r } else { 1.0 };
                Some((x * f, y * f))
            }
        }
    }

    /// Inverse of [`Self::distort`], by Newton steps; `None` where no ideal point leads there.
    pub fn undistort(&self, xd: f64, yd: f64) -> Option<(f64, f64)> {
        if *self == Self::None {
            return Some((xd, yd));
        }
        let goal = Vector2::new(xd, yd);
        let at = |p: &Vector2<f64>| self.distort(p.x, p.y).map(|(x, y)| Vector2::new(x, y));
        let mut p = goal;
        // A start beyond the model's range is pulled in.
        for _ in 0..20 {
            if at(&p).is_some() {
                break;
            }
            p *= 0.8;
        }
        for _ in 0..40 {
            let off = at(&p)? - goal;
            if off.norm() < 1e-12 {
                break;
            }
            let h = 1e-6;
            let dx = (at(&(p + Vector2::new(h, 0.0)))? - at(&p)?) / h;
            let dy = (at(&(p + Vector2::new(0.0, h)))? - at(&p)?) / h;
            let mut step = Matrix2::from_columns(&[dx, dy]).try_inverse()? * off;
            // Shorter steps while they lead out of the range or away.
            let mut tries = 0;
            while at(&(p - step)).is_none_or(|q| (q - goal).norm() > off.norm()) && tries < 30 {
                step *= 0.5;
                tries += 1;
            }
            p -= step;
        }
        (at(&p)? - goal).norm().le(&1e-7).then_some((p.x, p.y))
    }
}

fn factor(k: &[f64; 6], r2: f64) -> f64 {
    let above = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]));
    let below = 1.0 + r2 * (k[3] + r2 * (k[4] + r2 * k[5]));
    above / below
}

fn bend(k: &[f64; 4], angle: f64) -> f64 {
    let a = angle * angle;
    angle * (1.0 + a * (k[0] + a * (k[1] + a * (k[2] + a * k[3]))))
}

/// How far from zero `f` grows, at most `limit`.
fn monotonic(f: impl Fn(f64) -> f64, limit: f64) -> f64 {
    const STEPS: u32 = 2000;
    let mut last = 0.0;
    for i in 1..=STEPS {
        let x = limit * f64::from(i) / f64::from(STEPS);
        let v = f(x);
        // NaN counts as the end too.
        if v.is_nan() || v <= last {
            return limit * f64::from(i - 1) / f64::from(STEPS);
        }
        last = v;
    }
    limit
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) const LENSES: [(&str, &[f64]); 5] = [
        ("plumb_bob", &[-0.28, 0.07, 0.0006, -0.0004, -0.01]),
        ("plumb_bob", &[0.12, -0.25, 0.001, 0.0005, 0.1]),
        ("rational_polynomial", &[0.4, 0.1, 0.0002, 0.0001, 0.01, 0.7, 0.2, 0.03]),
        ("rational_polynomial", &[0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1e-3, 1e-4, -1e-3, 2e-4]),
        ("equidistant", &[-0.02, 0.01, -0.006, 0.001]),
    ];

    #[test]
    fn distort_and_undistort_are_inverse() {
        for (model, d) in LENSES {
            let lens = Lens::from_coefficients(model, d).unwrap();
            let mut moved = 0.0_f64;
            for i in -8..=8 {
                for j in -6..=6 {
                    let (x, y) = (f64::from(i) * 0.07, f64::from(j) * 0.07);
                    let (xd, yd) = lens.distort(x, y).unwrap();
                    moved = moved.max((xd - x).hypot(yd - y));
                    let (a, b) = lens.undistort(xd, yd).unwrap();
                    assert!((a - x).hypot(b - y) < 1e-9, "{model}: {x} {y} gives {a} {b}");
                }
            }
            assert!(moved > 0.005, "{model} bends nothing");
        }
    }

    #[test]
    fn known_values() {
        // By hand: r2 = 0.25, factor 1 - 0.2 * 0.25 + 0.05 * 0.0625 = 0.953125;
        // tangential dx = 2 * 0.01 * 0.12 + 0.02 * (0.25 + 2 * 0.09), dy = 0.01 * (0.25 + 0.32) + 2 * 0.02 * 0.12.
        let lens = Lens::from_coefficients("plumb_bob", &[-0.2, 0.05, 0.01, 0.02, 0.0]).unwrap();
        let (x, y) = lens.distort(0.3, 0.4).unwrap();
        assert!((x - (0.285_937_5 + 0.011)).abs() < 1e-12, "{x}");
        assert!((y - (0.381_25 + 0.0105)).abs() < 1e-12, "{y}");
        // A pure equidistant lens: the distance is the angle.
        let lens = Lens::from_coefficients("equidistant", &[0.0; 4]).unwrap();
        let (x, _) = lens.distort(1.0, 0.0).unwrap();
        assert!((x - std::f64::consts::FRAC_PI_4).abs() < 1e-12);
    }

    #[test]
    fn folding_rays_and_bad_coefficients_are_refused() {
        let lens = Lens::from_coefficients("plumb_bob", &[-0.5, 0.0, 0.0, 0.0, 0.0]).unwrap();
        // r (1 - r^2 / 2) turns back at r = sqrt(2 / 3).
        assert!(lens.distort(0.8, 0.0).is_some() && lens.distort(0.83, 0.0).is_none());
        assert!(lens.undistort(0.7, 0.0).is_none());
        assert_eq!(Lens::from_coefficients("plumb_bob", &[0.0; 5]), Ok(Lens::None));
        assert_eq!(Lens::from_coefficients("", &[]), Ok(Lens::None));
        assert!(matches!(
            Lens::from_coefficients("plumb_bob", &[0.1, 0.2]),
            Err(LensError::Count { count: 2, .. })
        ));
        assert!(matches!(
            Lens::from_coefficients("plumb_bob", &[f64::NAN; 5]),
            Err(LensError::NotFinite { index: 0, .. })
        ));
        assert!(matches!(Lens::from_coefficients("omni", &[0.1; 5]), Err(LensError::Model(_))));
    }
}
