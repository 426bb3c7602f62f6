//! Which symmetry the object may have, and where: the one under whose images of itself the fewest
//! measured points come to lie where the view sees that nothing is.

use super::view::View;
use nalgebra::{Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use tdv_geometry::Pose;

/// Depth (m) below the measured surface of the points that must be solid.
const SKIN: f64 = 0.0015;
/// Emptiness (m) that noise explains.
const SLACK: f64 = 0.0007;
/// Emptiness (m) that contradicts a symmetry.
const CLEAR: f64 = 0.0045;
/// Part of the points that may contradict a symmetry that is believed: a handle is more than that.
const BELIEVED: f64 = 0.025;
/// Points that are looked at.
const POINTS: usize = 500;

/// The symmetry that the unseen side is made with, about the object frame's z axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Assumed {
    /// Round about the axis.
    Round,
    /// Mirrored by the planes x = 0 and y = 0.
    TwoPlanes,
    /// Mirrored by the plane x = 0.
    OnePlane,
}

impl std::fmt::Display for Assumed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Round => "round about the vertical",
            Self::TwoPlanes => "two mirror planes",
            Self::OnePlane => "one mirror plane",
        })
    }
}

/// A map of the object onto itself: a turn about z after a mirroring, or neither.
pub(super) type Image = nalgebra::Matrix3<f64>;

impl Assumed {
    /// Its maps, the identity first.
    pub(super) fn images(self) -> Vec<Image> {
        const TURNS: u32 = 32;
        let diagonal = |x: f64, y: f64| Image::from_diagonal(&Vector3::new(x, y, 1.0));
        match self {
            Self::Round => (0..TURNS)
                .map(|i| {
                    let a = TAU * f64::from(i) / f64::from(TURNS);
                    *Rotation3::from_axis_angle(&Vector3::z_axis(), a).matrix()
                })
                .collect(),
            Self::TwoPlanes => vec![
                diagonal(1.0, 1.0),
                diagonal(-1.0, 1.0),
                diagonal(1.0, -1.0),
                diagonal(-1.0, -1.0),
            ],
            Self::OnePlane => vec![diagonal(1.0, 1.0), diagonal(-1.0, 1.0)],
        }
    }
}

/// A place of the axis and a direction of the planes in the search's frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    pub assumed: Assumed,
    /// Part of the points that contradict it.
    pub violation: f64,
    at: [f64; 3],
}

impl Found {
    /// `T_search_object`.
    pub fn axis(&self) -> Pose {
        place(&self.at)
    }
}

fn place(at: &[f64; 3]) -> Pose {
    Pose::from_parts(
        Translation3::new(at[0], at[1], 0.0),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), at[2]),
    )
}

pub(super) struct Search<'a> {
    view: &'a View,
    points: Vec<Point3<f64>>,
    /// Direction away from the camera along the table.
    away: [f64; 2],
    /// Half of the width of what is seen.
    half: f64,
}

impl<'a> Search<'a> {
    pub fn new(view: &'a View) -> Self {
        let all = view.points();
        let step = (all.len() / POINTS).max(1);
        let points: Vec<Point3<f64>> =
            all.iter().step_by(step).map(|p| p + view.sight(p) * SKIN).collect();
        let sight = view.sight(&Point3::origin());
        let flat = sight.x.hypot(sight.y).max(1e-6);
        let away = [sight.x / flat, sight.y / flat];
        let across = |p: &Point3<f64>| -p.x * away[1] + p.y * away[0];
        let low = points.iter().map(across).fold(f64::MAX, f64::min);
        let high = points.iter().map(across).fold(f64::MIN, f64::max);
        Self { view, points, away, half: (0.5 * (high - low)).clamp(0.01, 0.3) }
    }

    /// Mean contradiction of a symmetry at a place, and a measure (m) of how large it makes the object.
    fn judge(&self, images: &[Image], at: &[f64; 3]) -> (f64, f64) {
        let t = place(at);
        let back = t.inverse();
        let (mut sum, mut n, mut reach) = (0.0, 0.0, 0.0);
        for p in &self.points {
            let local = back * p;
            reach += local.x.hypot(local.y);
            for image in &images[1..] {
                let q = t * (image * local);
                let off = -self.view.inside(&q) - SLACK;
                // Little for a little, full marks from 8 mm on.
                sum += (off / 0.008).clamp(0.0, 1.0);
                n += 1.0;
            }
        }
        (sum / f64::max(n, 1.0), reach / self.points.len().max(1) as f64)
    }

    /// Part of the points one of whose images lies where it is clearly empty.
    fn contradicted(&self, images: &[Image], at: &[f64; 3]) -> f64 {
        let t = place(at);
        let back = t.inverse();
        let count = self.points.iter().filter(|p| {
            let local = back * *p;
            images[1..].iter().any(|image| self.view.inside(&(t * (image * local))) < -CLEAR)
        });
        count.count() as f64 / self.points.len().max(1) as f64
    }

    fn cost(&self, images: &[Image], at: &[f64; 3]) -> f64 {
        let (violation, reach) = self.judge(images, at);
        // Of two shapes that explain the view, the smaller one.
        violation + 0.01 * reach / self.half
    }

    fn best(&self, assumed: Assumed) -> Found {
        let images = assumed.images();
        let images = match assumed {
            // Every other turn tells the same.
            Assumed::Round => images.into_iter().step_by(4).collect(),
            _ => images,
        };
        let angles: Vec<f64> = match assumed {
            Assumed::Round => vec![0.0],
            Assumed::TwoPlanes => (0..9).map(|i| FRAC_PI_2 * f64::from(i) / 9.0).collect(),
            Assumed::OnePlane => (0..18).map(|i| PI * f64::from(i) / 18.0).collect(),
        };
        let mut ranked: Vec<(f64, [f64; 3])> = Vec::new();
        for depth in -4..=10 {
            for side in -4..=4 {
                let (d, s) =
                    (f64::from(depth) * 0.15 * self.half, f64::from(side) * 0.15 * self.half);
                let (x, y) =
                    (d * self.away[0] - s * self.away[1], d * self.away[1] + s * self.away[0]);
                for angle in &angles {
                    let at = [x, y, *angle];
                    ranked.push((self.cost(&images, &at), at));
                }
            }
        }
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        let best = ranked
            .iter()
            .take(6)
            .map(|(cost, at)| self.refine(&images, *cost, *at, angles.len() > 1))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let at = best.map_or([0.0; 3], |b| b.1);
        Found { assumed, violation: self.contradicted(&images, &at), at }
    }

    /// Greedy steps that shrink.
    fn refine(
        &self,
        images: &[Image],
        mut cost: f64,
        mut at: [f64; 3],
        turns: bool,
    ) -> (f64, [f64; 3]) {
        let mut shift = 0.08 * self.half;
        while shift > 0.0002 {
            let mut better = false;
            for k in 0..if turns { 3 } else { 2 } {
                for sign in [1.0, -1.0] {
                    let mut next = at;
                    next[k] += sign * if k == 2 { shift / self.half * 0.8 } else { shift };
                    let c = self.cost(images, &next);
                    if c < cost - 1e-6 {
                        (cost, at, better) = (c, next, true);
                    }
                }
            }
            if !better {
                shift *= 0.5;
            }
        }
        (cost, at)
    }

    /// The richest symmetry that the view allows; one mirror plane is always assumed.
    pub fn run(&self) -> Found {
        let round = self.best(Assumed::Round);
        if round.violation < BELIEVED {
            return round;
        }
        let two = self.best(Assumed::TwoPlanes);
        if two.violation < BELIEVED {
            return two;
        }
        self.best(Assumed::OnePlane)
    }
}
