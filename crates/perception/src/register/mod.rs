//! The first pose of an object from its mask: many hypotheses rendered and compared with depth and
//! silhouette at low resolution, the best ones refined by ICP and a local search.

mod grid;
mod target;

use crate::catalogue::{ObjectModel, Resting};
use crate::frame::RgbdFrame;
use crate::segment::Mask;
use crate::table::TablePlane;
use crate::view::Painter;
use nalgebra::{UnitQuaternion, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use target::{Target, move_about};
use tdv_geometry::Pose;

/// Settings of the registration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RegisterConfig {
    /// Longer side (px) of the images on which all hypotheses are compared.
    pub coarse_px: f64,
    /// Longer side (px) of the images on which the best are refined.
    pub fine_px: f64,
    /// Yaws tried for an upright object.
    pub yaws: usize,
    /// Hypotheses that go into ICP.
    pub keep: usize,
    /// Hypotheses that go into the fine search.
    pub finalists: usize,
    /// Least score (0..1) of an accepted pose.
    pub min_score: f64,
    /// An upright pose with at least this score is taken without trying tilted ones.
    pub upright_enough: f64,
}

impl Default for RegisterConfig {
    fn default() -> Self {
        Self {
            coarse_px: 64.0,
            fine_px: 110.0,
            yaws: 36,
            keep: 16,
            finalists: 4,
            min_score: 0.45,
            upright_enough: 0.6,
        }
    }
}

/// A registered pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Registration {
    /// `T_camera_object`.
    pub pose: Pose,
    /// Agreement with depth and silhouette, 0..1.
    pub score: f64,
    /// Best score among poses that differ by more than 20 degrees (symmetry considered) or half a
    /// radius; 0 when there is none.
    pub second: f64,
    /// Whether it was found standing upright on the table.
    pub upright: bool,
}

impl Registration {
    /// Whether another orientation fits nearly as well (within 3 %).
    pub fn ambiguous(&self) -> bool {
        self.second > 0.97 * self.score
    }
}

/// Finds the pose of `model` whose pixels are `mask` (its window should reach beyond the object by a
/// third of its size). `table` gives upright hypotheses to objects that rest upright. `None` when the
/// mask holds no depth or nothing scores [`RegisterConfig::min_score`].
pub fn register(
    frame: &RgbdFrame,
    mask: &Mask,
    model: &ObjectModel,
    table: Option<&TablePlane>,
    config: &RegisterConfig,
) -> Option<Registration> {
    let best = search(frame, mask, model, table, config)?;
    (best.score >= config.min_score).then_some(best)
}

/// As [`register`], whatever the score; `None` only without depth in the mask.
pub(crate) fn search(
    frame: &RgbdFrame,
    mask: &Mask,
    model: &ObjectModel,
    table: Option<&TablePlane>,
    config: &RegisterConfig,
) -> Option<Registration> {
    let coarse = Target::new(frame, mask, config.coarse_px);
    let fine = Target::new(frame, mask, config.fine_px);
    let mut painter = Painter::new();
    let standing = table.filter(|_| model.resting == Resting::Upright);
    if let Some(table) = standing {
        let turns = grid::upright(model, table, config.yaws);
        let best = run(&coarse, &fine, &mut painter, model, &turns, Some(table), config);
        if let Some(best) = best.filter(|b| b.score >= config.upright_enough) {
            return Some(best);
        }
        let tilted = run(&coarse, &fine, &mut painter, model, &grid::general(model), None, config);
        // Standing is the likelier of two equal explanations.
        return match (best, tilted) {
            (Some(b), Some(t)) => Some(if t.score > b.score + 0.05 { t } else { b }),
            (b, t) => b.or(t),
        };
    }
    run(&coarse, &fine, &mut painter, model, &grid::general(model), None, config)
}

fn run(
    coarse: &Target,
    fine: &Target,
    painter: &mut Painter,
    model: &ObjectModel,
    turns: &[UnitQuaternion<f64>],
    table: Option<&TablePlane>,
    config: &RegisterConfig,
) -> Option<Registration> {
    let measured = coarse.centroid()?;
    let mut scored: Vec<(f64, Pose)> = Vec::with_capacity(turns.len());
    for turn in turns {
        // The visible side is nearer than the centre; the drawing tells by how much.
        let guess = measured.coords + measured.coords.normalize() * (0.5 * model.radius);
        let mut pose = Pose::from_parts((guess - turn * model.centre().coords).into(), *turn);
        for _ in 0..2 {
            painter.draw(&coarse.k, model, &pose);
            let Some(seen) = painter.visible_centroid(&coarse.k) else { break };
            pose.translation.vector += measured - seen;
            if let Some(table) = table {
                stand(&mut pose, table, model);
            }
        }
        scored.push((coarse.score(painter, model, &pose), pose));
    }
    // A mug's handle decides late: neighbours of a good hypothesis must not push out other yaws.
    keep_best(&mut scored, config.keep, model, 18f64.to_radians());
    for (score, pose) in &mut scored {
        let moved = coarse.icp(painter, model, *pose, 0.03, 6);
        let s = coarse.score(painter, model, &moved);
        if s > *score {
            (*score, *pose) = (s, moved);
        }
    }
    for (score, pose) in &mut scored {
        *score = fine.score(painter, model, pose);
        let moved = fine.icp(painter, model, *pose, 0.015, 4);
        let s = fine.score(painter, model, &moved);
        if s > *score {
            (*score, *pose) = (s, moved);
        }
    }
    keep_best(&mut scored, config.finalists, model, 25f64.to_radians());
    for (score, pose) in &mut scored {
        polish(fine, painter, model, score, pose);
    }
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (score, pose) = *scored.first()?;
    let second = scored
        .iter()
        .filter(|(_, p)| {
            let (d, a) = model.distance(p, &pose);
            a > 20f64.to_radians() || d > 0.5 * model.radius
        })
        .map(|s| s.0)
        .fold(0.0, f64::max);
    Some(Registration { pose, score, second, upright: table.is_some() })
}

/// Moves an upright object along the table's normal until its underside is on the table.
fn stand(pose: &mut Pose, table: &TablePlane, model: &ObjectModel) {
    let c = model.centre();
    let foot = *pose * nalgebra::Point3::new(c.x, c.y, model.min.z);
    pose.translation.vector -= table.normal * table.height(&foot);
}

/// Best first, near-duplicates (both within `angle` and a tenth of the radius) dropped, at most `count`.
fn keep_best(scored: &mut Vec<(f64, Pose)>, count: usize, model: &ObjectModel, angle: f64) {
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<(f64, Pose)> = Vec::with_capacity(count);
    for (s, p) in scored.iter() {
        let new = kept.iter().all(|(_, k)| {
            let (d, a) = model.distance(p, k);
            a > angle || d > 0.1 * model.radius
        });
        if new {
            kept.push((*s, *p));
            if kept.len() == count {
                break;
            }
        }
    }
    *scored = kept;
}

/// Greedy search along the six directions with shrinking steps: it sees the silhouette, which ICP
/// does not (a mug's yaw is its handle, a few pixels of outline).
fn polish(
    target: &Target,
    painter: &mut Painter,
    model: &ObjectModel,
    score: &mut f64,
    pose: &mut Pose,
) {
    let (mut angle, mut shift) = (10f64.to_radians(), 0.006);
    while angle > 0.7f64.to_radians() {
        let mut improved = false;
        for axis in 0..6 {
            for sign in [1.0, -1.0] {
                let mut step = Vector6::zeros();
                if axis < 3 {
                    // About the object's own axes, so that yaw is one of the directions.
                    let a = pose.rotation * Vector3::ith(axis, sign * angle);
                    step.fixed_rows_mut::<3>(0).copy_from(&a);
                } else {
                    step[axis] = sign * shift;
                }
                let moved = move_about(pose, &(*pose * model.centre()), &step);
                let s = target.score(painter, model, &moved);
                if s > *score + 1e-4 {
                    (*score, *pose) = (s, moved);
                    improved = true;
                }
            }
        }
        if !improved {
            angle *= 0.5;
            shift *= 0.5;
        }
    }
}
