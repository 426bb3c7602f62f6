//! The metric size of a mesh that has none, from a view of the object standing on a table.

mod fit;
#[cfg(test)]
mod tests;

use crate::catalogue::ObjectModel;
use crate::frame::RgbdFrame;
use crate::register::{RegisterConfig, search};
use crate::segment::{Cluster, Mask};
use crate::table::TablePlane;
use serde::{Deserialize, Serialize};
use tdv_geometry::{Pose, Symmetry};
use tdv_rendering::Mesh;
use thiserror::Error;

/// Settings of the estimate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScaleConfig {
    /// Largest spread (largest over smallest, less one) of the single estimates.
    pub tolerance: f64,
    /// Least agreement of the drawn mesh with the view, 0..1.
    pub min_score: f64,
    /// Search of the pose.
    pub register: RegisterConfig,
}

impl Default for ScaleConfig {
    fn default() -> Self {
        Self {
            tolerance: 0.12,
            min_score: 0.5,
            register: RegisterConfig { yaws: 24, ..RegisterConfig::default() },
        }
    }
}

/// One way to measure the size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaleEstimate {
    /// Which.
    pub name: &'static str,
    /// Metres per unit of the mesh.
    pub value: f64,
    /// Relative standard deviation that the sensor allows.
    pub sigma: f64,
}

/// The size found.
#[derive(Debug, Clone, PartialEq)]
pub struct ScaleReport {
    /// Metres per unit of the mesh.
    pub scale: f64,
    /// What it was made of.
    pub estimates: Vec<ScaleEstimate>,
    /// Largest over smallest estimate, less one.
    pub spread: f64,
    /// `T_camera_object` of the scaled mesh.
    pub pose: Pose,
    /// Agreement of the scaled mesh with depth and outline, 0..1.
    pub score: f64,
}

/// Why there is no size.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum ScaleError {
    /// The mesh is flat or empty.
    #[error("the mesh has no height; is its up axis z (for glTF: y)?")]
    Flat,
    /// The mesh does not look like the thing seen.
    #[error(
        "the mesh agrees with the view by {score:.2}, {needed:.2} needed: is it the same object, upright?"
    )]
    NoMatch {
        /// Agreement found.
        score: f64,
        /// Agreement needed.
        needed: f64,
    },
    /// The estimates contradict each other.
    #[error(
        "the estimates of the scale spread by {:.0} % ({list}), {:.0} % are allowed: the mesh has other \
         proportions than the object, or much of it is hidden; give --scale or --height",
        spread * 100.0, tolerance * 100.0
    )]
    Disagree {
        /// Largest over smallest, less one.
        spread: f64,
        /// What is allowed.
        tolerance: f64,
        /// The estimates as text.
        list: String,
    },
}

/// How large the mesh is, as seen.
///
/// `mesh` stands on its origin's plane, z up, in any unit. `mask` (with a window larger than the object)
/// and `cluster` are its pixels in `frame`, best the average of several frames. The height above the
/// plane, width, depth in the image, area and a scaled ICP are compared by drawing the mesh where it was
/// found, so that hidden sides and perspective do not count; the result is their weighted mean.
///
/// # Errors
/// [`ScaleError`]; a spread beyond the tolerance is one, the estimates then stand in the error.
pub fn estimate_scale(
    frame: &RgbdFrame,
    table: &TablePlane,
    cluster: &Cluster,
    mask: &Mask,
    mesh: &Mesh,
    symmetry: &Symmetry,
    config: &ScaleConfig,
) -> Result<ScaleReport, ScaleError> {
    let (low, high) = mesh.bounds();
    let size = high - low;
    if !(size.z > 1e-9 && size.x.max(size.y) > 1e-9) {
        return Err(ScaleError::Flat);
    }
    // A coaster's height is mostly noise: start from the footprint then.
    let tall = cluster.top / size.z;
    let wide = cluster.length / size.x.max(size.y);
    let mut scale = if cluster.top > 0.02 { tall } else { wide };
    let mut best: Option<ScaleReport> = None;
    for round in 0..4 {
        let model = ObjectModel::new("mesh", mesh.scaled(scale), symmetry.clone());
        let Some(found) = search(frame, mask, &model, Some(table), &config.register) else { break };
        let Some(fit) = fit::measure(frame, table, mask, &model, &found.pose) else { break };
        let estimates: Vec<ScaleEstimate> =
            fit.into_iter().map(|e| ScaleEstimate { value: e.value * scale, ..e }).collect();
        let next = combine(&estimates);
        let report = ScaleReport {
            scale: next,
            spread: spread(&estimates),
            estimates,
            pose: found.pose,
            score: found.score,
        };
        let settled = (next / scale - 1.0).abs() < 0.003;
        if best.as_ref().is_none_or(|b| report.score >= b.score - 0.02) {
            best = Some(report);
        }
        if settled && round > 0 {
            break;
        }
        // A wrong start must not run away.
        scale *= (next / scale).clamp(0.6, 1.6);
    }
    let none = ScaleError::NoMatch { score: 0.0, needed: config.min_score };
    let best = best.ok_or(none)?;
    if best.score < config.min_score {
        return Err(ScaleError::NoMatch { score: best.score, needed: config.min_score });
    }
    if best.spread > config.tolerance {
        let list: Vec<String> =
            best.estimates.iter().map(|e| format!("{} {:.4}", e.name, e.value)).collect();
        return Err(ScaleError::Disagree {
            spread: best.spread,
            tolerance: config.tolerance,
            list: list.join(", "),
        });
    }
    Ok(best)
}

/// Mean of the logarithms, weighted by the deviations.
fn combine(estimates: &[ScaleEstimate]) -> f64 {
    let (mut sum, mut weight) = (0.0, 0.0);
    for e in estimates {
        let w = 1.0 / (e.sigma * e.sigma);
        sum += w * e.value.ln();
        weight += w;
    }
    (sum / weight).exp()
}

/// Of the estimates that the sensor lets know the size within 6 %.
fn spread(estimates: &[ScaleEstimate]) -> f64 {
    let sure = || estimates.iter().filter(|e| e.sigma < 0.06).map(|e| e.value);
    let (least, most) = (sure().fold(f64::MAX, f64::min), sure().fold(0.0, f64::max));
    if most > 0.0 { most / least - 1.0 } else { 0.0 }
}
