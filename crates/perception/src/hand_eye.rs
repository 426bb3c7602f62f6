//! Where the camera is: hand-eye calibration from pairs of a tool pose and the pose of a target seen.
//!
//! A closed solution (rotations as in Park and Martin 1994, by singular values; translations by least
//! squares) starts a least-squares refinement of both unknown transforms over all pairs.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use tdv_geometry::{GeometryError, Pose, exact_rotation, pose_exp, pose_from_xyz_quat, pose_log};
use thiserror::Error;

/// Fewest pairs.
const LEAST: usize = 4;
/// Weight (m) of a radian against a metre: the target's corners are about this far from its middle.
const ARM: f64 = 0.1;
/// Sine-like measure of how far the axes of rotation are from parallel, below which there is no answer.
const PARALLEL: f64 = 0.05;

/// Where camera and target are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mount {
    /// The camera on the tool, the target fixed in the room: the answer is `T_tool_camera`.
    EyeInHand,
    /// The camera fixed in the room, the target on the tool: the answer is `T_base_camera`.
    EyeToHand,
}

/// One place of the arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandEyePair {
    /// `T_base_tool` by the robot's kinematics.
    pub base_tool: Pose,
    /// `T_camera_target` by the picture.
    pub camera_target: Pose,
}

/// Why there is no calibration.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum HandEyeError {
    /// Not enough pairs.
    #[error("{have} pairs, at least {LEAST} are needed, ten are good")]
    Few {
        /// How many there are.
        have: usize,
    },
    /// The tool turned about one axis only, or not at all.
    #[error(
        "the tool turns about one axis only (spread {spread:.3}, {PARALLEL} needed): tilt it about two \
         different axes by 20 degrees or more"
    )]
    Degenerate {
        /// Second singular value of the axes over the first.
        spread: f64,
    },
    /// The file does not have the fields it should.
    #[error("pose file: {0}")]
    Parse(String),
    /// A pose that is none.
    #[error("pair {index}: {source}")]
    Pose {
        /// Which pair.
        index: usize,
        /// Why.
        source: GeometryError,
    },
}

/// The result.
#[derive(Debug, Clone, PartialEq)]
pub struct HandEye {
    /// `T_tool_camera` (eye in hand) or `T_base_camera` (eye to hand).
    pub camera: Pose,
    /// `T_base_target` (eye in hand) or `T_tool_target` (eye to hand).
    pub target: Pose,
    /// Of each pair: how far (m, rad) the target is from where it should be.
    pub residuals: Vec<(f64, f64)>,
    /// Root mean square of the residuals (m, rad).
    pub rms: (f64, f64),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseEntry {
    /// m.
    xyz: [f64; 3],
    /// x, y, z, w.
    xyzw: [f64; 4],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PairEntry {
    base_tool: PoseEntry,
    camera_target: PoseEntry,
}

/// Reads pairs from YAML (or JSON): a list of `base_tool` and `camera_target`, each with `xyz` (m) and
/// `xyzw` (unit quaternion).
///
/// # Errors
/// [`HandEyeError::Parse`], [`HandEyeError::Pose`].
pub fn pairs_from_yaml(text: &str) -> Result<Vec<HandEyePair>, HandEyeError> {
    let list: Vec<PairEntry> =
        serde_saphyr::from_str(text).map_err(|e| HandEyeError::Parse(e.to_string()))?;
    list.iter()
        .enumerate()
        .map(|(index, p)| {
            let pose = |e: &PoseEntry| {
                pose_from_xyz_quat(e.xyz, e.xyzw)
                    .map_err(|source| HandEyeError::Pose { index, source })
            };
            Ok(HandEyePair {
                base_tool: pose(&p.base_tool)?,
                camera_target: pose(&p.camera_target)?,
            })
        })
        .collect()
}

/// Finds the camera.
///
/// # Errors
/// [`HandEyeError::Few`], [`HandEyeError::Degenerate`].
pub fn calibrate(pairs: &[HandEyePair], mount: Mount) -> Result<HandEye, HandEyeError> {
    if pairs.len() < LEAST {
        return Err(HandEyeError::Few { have: pairs.len() });
    }
    // With the tool's pose turned round, the fixed camera is the same problem.
    let known: Vec<(Pose, Pose)> = pairs
        .iter()
        .map(|p| match mount {
            Mount::EyeInHand => (p.base_tool, p.camera_target),
            Mount::EyeToHand => (p.base_tool.inverse(), p.camera_target),
        })
        .collect();
    let mut camera = closed(&known)?;
    let mut target = known[0].0 * camera * known[0].1;
    refine(&known, &mut camera, &mut target);
    let residuals: Vec<(f64, f64)> = known
        .iter()
        .map(|(a, b)| {
            let e = residual(a, &camera, b, &target);
            (e.fixed_rows::<3>(0).norm(), e.fixed_rows::<3>(3).norm())
        })
        .collect();
    let mean = |f: fn(&(f64, f64)) -> f64| {
        (residuals.iter().map(|r| f(r).powi(2)).sum::<f64>() / residuals.len() as f64).sqrt()
    };
    let rms = (mean(|r| r.0), mean(|r| r.1));
    Ok(HandEye { camera, target, residuals, rms })
}

/// Solves A X = X B for all pairs of pairs.
fn closed(known: &[(Pose, Pose)]) -> Result<Pose, HandEyeError> {
    let mut moves = Vec::new();
    for (i, a) in known.iter().enumerate() {
        for b in &known[..i] {
            moves.push((b.0.inverse() * a.0, b.1 * a.1.inverse()));
        }
    }
    let (mut cross, mut axes) = (Matrix3::zeros(), Matrix3::zeros());
    for (a, b) in &moves {
        let (alpha, beta) = (a.rotation.scaled_axis(), b.rotation.scaled_axis());
        // Near a half turn the axis may come out either way.
        if alpha.norm() > 2.8 {
            continue;
        }
        cross += alpha * beta.transpose();
        axes += alpha * alpha.transpose();
    }
    let values = axes.symmetric_eigenvalues();
    let mut values: Vec<f64> = values.iter().map(|v| v.max(0.0).sqrt()).collect();
    values.sort_by(f64::total_cmp);
    let spread = if values[2] > 1e-9 { values[1] / values[2] } else { 0.0 };
    if spread < PARALLEL {
        return Err(HandEyeError::Degenerate { spread });
    }
    let svd = cross.svd(true, true);
    let (Some(u), Some(vt)) = (svd.u, svd.v_t) else {
        return Err(HandEyeError::Degenerate { spread });
    };
    let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * vt).determinant().signum()));
    let rotation = exact_rotation(u * sign * vt);
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (a, b) in &moves {
        let c = a.rotation.to_rotation_matrix().matrix() - Matrix3::identity();
        let d = rotation * b.translation.vector - a.translation.vector;
        normal += c.transpose() * c;
        right += c.transpose() * d;
    }
    let t = normal.cholesky().map(|n| n.solve(&right));
    let t = t.ok_or(HandEyeError::Degenerate { spread })?;
    Ok(Pose::from_parts(t.into(), rotation))
}

/// Where the target is seen, from where it should be: metres, radians.
fn residual(a: &Pose, x: &Pose, b: &Pose, y: &Pose) -> Vector6<f64> {
    pose_log(&(y.inverse() * a * x * b))
}

/// Gauss-Newton over both transforms.
fn refine(known: &[(Pose, Pose)], x: &mut Pose, y: &mut Pose) {
    let stack = |x: &Pose, y: &Pose| {
        let mut out = DVector::zeros(6 * known.len());
        for (i, (a, b)) in known.iter().enumerate() {
            let mut e = residual(a, x, b, y);
            for k in 3..6 {
                e[k] *= ARM;
            }
            out.fixed_rows_mut::<6>(6 * i).copy_from(&e);
        }
        out
    };
    let step = |x: &Pose, y: &Pose, d: &[f64]| {
        let d = DVector::from_column_slice(d);
        let part = |from: usize| pose_exp(&d.fixed_rows::<6>(from).into_owned());
        (x * part(0), y * part(6))
    };
    for _ in 0..20 {
        let e = stack(x, y);
        let mut j = DMatrix::zeros(e.len(), 12);
        for k in 0..12 {
            let mut d = [0.0; 12];
            d[k] = 1e-6;
            let (dx, dy) = step(x, y, &d);
            j.set_column(k, &((stack(&dx, &dy) - &e) / 1e-6));
        }
        let normal = j.transpose() * &j;
        let Some(c) = normal.cholesky() else { return };
        let d = -c.solve(&(j.transpose() * &e));
        let (nx, ny) = step(x, y, d.as_slice());
        if stack(&nx, &ny).norm() > e.norm() {
            return;
        }
        (*x, *y) = (nx, ny);
        if d.norm() < 1e-10 {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use tdv_geometry::{pose_distance, pose_from_xyz_rpy};

    /// Pairs with Gaussian-like noise (m, rad); `tilt` scales the turns about x and y.
    fn pairs(
        mount: Mount,
        n: usize,
        tilt: f64,
        noise: (f64, f64),
        seed: u64,
    ) -> (Vec<HandEyePair>, Pose) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let camera = match mount {
            Mount::EyeInHand => pose_from_xyz_rpy([0.03, -0.06, 0.04], [0.1, -0.05, 1.6]),
            Mount::EyeToHand => pose_from_xyz_rpy([0.95, 0.1, 0.7], [-2.4, 0.02, 1.5]),
        };
        let target = pose_from_xyz_rpy([0.4, -0.1, 0.02], [0.05, 3.0, 0.4]);
        let made = (0..n)
            .map(|_| {
                let mut r = |s: f64| (rng.random::<f64>() - 0.5) * 2.0 * s;
                let xyz = [0.4 + r(0.15), r(0.2), 0.35 + r(0.1)];
                let tool = pose_from_xyz_rpy(xyz, [3.1 + tilt * r(0.5), tilt * r(0.5), r(0.8)]);
                let seen = match mount {
                    Mount::EyeInHand => camera.inverse() * tool.inverse() * target,
                    Mount::EyeToHand => camera.inverse() * tool * target,
                };
                let mut g = |s: f64| r(s) + r(s) + r(s);
                let off = Vector6::new(
                    g(noise.0),
                    g(noise.0),
                    g(noise.0),
                    g(noise.1),
                    g(noise.1),
                    g(noise.1),
                );
                HandEyePair { base_tool: tool, camera_target: seen * pose_exp(&off) }
            })
            .collect();
        (made, camera)
    }

    #[test]
    fn exact_pairs_give_the_exact_camera() {
        for mount in [Mount::EyeInHand, Mount::EyeToHand] {
            let (p, truth) = pairs(mount, 6, 1.0, (0.0, 0.0), 3);
            let found = calibrate(&p, mount).unwrap();
            let (d, a) = pose_distance(&found.camera, &truth);
            assert!(d < 1e-8 && a < 1e-7, "{mount:?}: {d} {a}");
            assert!(found.rms.0 < 1e-8);
        }
    }

    #[test]
    fn noise_is_averaged_and_reported() {
        for mount in [Mount::EyeInHand, Mount::EyeToHand] {
            let (mut worst, mut rms) = ((0.0_f64, 0.0_f64), 0.0);
            for seed in 0..10 {
                let (p, truth) = pairs(mount, 15, 1.0, (0.5e-3, 1.5e-3), seed);
                let found = calibrate(&p, mount).unwrap();
                let (d, a) = pose_distance(&found.camera, &truth);
                worst = (worst.0.max(d), worst.1.max(a));
                rms += found.rms.0 / 10.0;
            }
            println!(
                "{mount:?}: at most {:.2} mm, {:.3} deg; rms {:.2} mm",
                worst.0 * 1e3,
                worst.1.to_degrees(),
                rms * 1e3
            );
            assert!(worst.0 < 2.5e-3 && worst.1 < 3e-3, "{mount:?}: {worst:?}");
            // Noise of 0.5 mm an axis, uniform threefold, is 0.87 mm in length.
            assert!((0.5e-3..1.1e-3).contains(&rms), "{rms}");
        }
    }

    #[test]
    fn an_outlier_shows_and_one_axis_is_refused() {
        let (mut p, _) = pairs(Mount::EyeToHand, 12, 1.0, (2e-4, 5e-4), 1);
        p[4].camera_target.translation.vector.x += 0.02;
        let found = calibrate(&p, Mount::EyeToHand).unwrap();
        let worst = (0..12).max_by(|a, b| found.residuals[*a].0.total_cmp(&found.residuals[*b].0));
        assert_eq!(worst, Some(4));
        let (flat, _) = pairs(Mount::EyeToHand, 12, 0.0, (0.0, 0.0), 1);
        assert!(matches!(calibrate(&flat, Mount::EyeToHand), Err(HandEyeError::Degenerate { .. })));
        assert_eq!(calibrate(&p[..3], Mount::EyeToHand), Err(HandEyeError::Few { have: 3 }));
    }

    #[test]
    fn the_file_is_read_and_bad_entries_are_named() {
        let text = "- base_tool: {xyz: [1, 2, 3], xyzw: [0, 0, 0, 1]}\n  camera_target: {xyz: [0, 0, 1], xyzw: [1, 0, 0, 0]}\n";
        let p = pairs_from_yaml(text).unwrap();
        assert!((p[0].base_tool.translation.z - 3.0).abs() < 1e-12);
        let e = pairs_from_yaml(&text.replace("[1, 0, 0, 0]", "[1, 1, 0, 0]")).unwrap_err();
        assert!(matches!(e, HandEyeError::Pose { index: 0, .. }), "{e}");
        assert!(matches!(pairs_from_yaml("- tool: 1"), Err(HandEyeError::Parse(_))));
    }
}
