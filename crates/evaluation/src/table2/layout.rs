//! Where objects start.
//!
//! What varies is the moving object; in a task of the hand, which has none, the reference object.
//!
//! The 13 fixed points cover the task's rectangle (45 cm x 50 cm): three rows of three at 10 %, 50 % and
//! 90 % of both sides, and between them two rows of two at 30 % and 70 %. One that lies in the excluded
//! disc round the reference object goes to the nearest free place at the disc's edge.

use super::{Level, fnv64};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tdv_demonstration::{Task, TaskKind, Workspace};
use tdv_simulation::Scene;
use tdv_simulation::scene::Placement;

/// A start of the object that varies, before the lab has seen it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Start {
    /// m, base_link.
    pub x: f64,
    /// m, base_link.
    pub y: f64,
    /// rad.
    pub yaw: f64,
    /// Which of the 13 points, if it is one.
    pub point: Option<usize>,
}

/// Room between the excluded disc and a point that was moved to its edge, m.
const EDGE: f64 = 0.006;

/// The 13 points (x, y in m), rows in the order of x.
pub fn fixed_points(workspace: &Workspace, reference: [f64; 2]) -> [[f64; 2]; 13] {
    let rows: [(f64, &[f64]); 5] = [
        (0.1, &[0.1, 0.5, 0.9]),
        (0.3, &[0.3, 0.7]),
        (0.5, &[0.1, 0.5, 0.9]),
        (0.7, &[0.3, 0.7]),
        (0.9, &[0.1, 0.5, 0.9]),
    ];
    let side = |r: [f64; 2], f: f64| r[0] + f * (r[1] - r[0]);
    let mut out = [[0.0; 2]; 13];
    let all = rows.iter().flat_map(|(fx, ys)| ys.iter().map(|fy| (*fx, *fy)));
    for (p, (fx, fy)) in out.iter_mut().zip(all) {
        let at = [side(workspace.x, fx), side(workspace.y, fy)];
        *p = if workspace.allows(at, reference) { at } else { edge(workspace, reference, at) };
    }
    out
}

/// The place nearest to `at` on the edge of the excluded disc that lies in the rectangle.
fn edge(workspace: &Workspace, reference: [f64; 2], at: [f64; 2]) -> [f64; 2] {
    let radius = workspace.exclude_radius + EDGE;
    let places = (0..720).map(|i| {
        let angle = f64::from(i) * std::f64::consts::PI / 360.0;
        [reference[0] + radius * angle.cos(), reference[1] + radius * angle.sin()]
    });
    let far = |p: &[f64; 2]| (p[0] - at[0]).hypot(p[1] - at[1]);
    places
        .filter(|p| workspace.allows(*p, reference))
        .min_by(|a, b| far(a).total_cmp(&far(b)))
        .unwrap_or(at)
}

/// The object whose start varies.
pub(super) fn varied<'a>(scene: &'a Scene, task: &Task) -> &'a str {
    match task.kind {
        TaskKind::Object => &scene.task.moving,
        TaskKind::Hand => &scene.task.reference,
    }
}

/// Range of an object's yaw at the start, rad: that of the scene.
fn yaws(scene: &Scene, name: &str) -> [f64; 2] {
    let object = scene.objects.iter().find(|o| o.name == name);
    let deg = match object.map(|o| &o.start) {
        Some(Placement::Region(r)) => r.yaw_deg,
        Some(Placement::Spot(s)) => [s.yaw_deg - s.jitter_deg, s.yaw_deg + s.jitter_deg],
        Some(Placement::On(_)) | None => [0.0; 2],
    };
    deg.map(f64::to_radians)
}

/// Start number `trial` of a seed. Numbers below 13 are the fixed points, further ones are drawn over
/// the rectangle outside the excluded disc. Depends on nothing that was learned, so that all cells of a
/// task see the same starts; position and yaw have a stream each, so that both levels see the same
/// positions.
pub(super) fn start(
    (scene, varied): (&Scene, &str),
    workspace: &Workspace,
    level: Level,
    demonstrated_yaw: f64,
    reference: [f64; 2],
    (seed, trial): (u64, usize),
) -> Start {
    let mut rng = ChaCha8Rng::seed_from_u64(environment(&scene.name, seed, trial));
    rng.set_stream(2);
    let [low, high] = yaws(scene, varied);
    let drawn: f64 = low + (high - low) * rng.random_range(0.0..1.0);
    let yaw = if level == Level::PG { demonstrated_yaw } else { drawn };
    if let Some([x, y]) = fixed_points(workspace, reference).get(trial) {
        return Start { x: *x, y: *y, yaw, point: Some(trial) };
    }
    rng.set_stream(1);
    let mut place = [workspace.x[0], workspace.y[0]];
    for _ in 0..1000 {
        place = [
            rng.random_range(workspace.x[0]..=workspace.x[1]),
            rng.random_range(workspace.y[0]..=workspace.y[1]),
        ];
        if workspace.allows(place, reference) {
            break;
        }
    }
    Start { x: place[0], y: place[1], yaw, point: None }
}

/// Seed of the lab in a trial.
pub(super) fn environment(scene: &str, seed: u64, trial: usize) -> u64 {
    fnv64([scene, &seed.to_string(), &trial.to_string()].into_iter())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn cup() -> (Scene, Workspace) {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let scene = Scene::load(&root.join("config/scenes/cup_on_coaster.yaml")).unwrap();
        (
            scene,
            Workspace {
                x: [0.25, 0.70],
                y: [-0.25, 0.25],
                exclude_radius: 0.11,
                polygon: Vec::new(),
            },
        )
    }

    #[test]
    fn thirteen_points_apart_from_each_other_and_from_the_reference() {
        let (_, w) = cup();
        let reference = [0.45, -0.24];
        let points = fixed_points(&w, reference);
        for (i, p) in points.iter().enumerate() {
            assert!(w.allows(*p, reference), "{p:?}");
            for q in &points[..i] {
                assert!((p[0] - q[0]).hypot(p[1] - q[1]) > 0.06, "{p:?} {q:?}");
            }
        }
        assert!((points[0][0] - 0.295).abs() < 1e-12 && (points[0][1] + 0.2).abs() < 1e-12);
        assert!((points[12][0] - 0.655).abs() < 1e-12 && (points[12][1] - 0.2).abs() < 1e-12);
    }

    #[test]
    fn levels_share_positions_and_differ_in_yaw() {
        let (scene, w) = cup();
        let at = |level, trial| start((&scene, "mug"), &w, level, 0.262, [0.45, -0.24], (1, trial));
        let (mut low, mut high) = (f64::MAX, f64::MIN);
        for trial in 0..200 {
            let (a, b) = (at(Level::PG, trial), at(Level::PoG, trial));
            assert_eq!((a.x, a.y, a.point), (b.x, b.y, b.point));
            assert_eq!(a.yaw, 0.262);
            assert_eq!(a.point.is_some(), trial < 13);
            assert!(b.yaw.abs() <= std::f64::consts::FRAC_PI_2);
            (low, high) = (low.min(b.yaw), high.max(b.yaw));
        }
        assert!(low < -1.4 && high > 1.4);
        assert_ne!(
            at(Level::PG, 20),
            start((&scene, "mug"), &w, Level::PG, 0.262, [0.45, -0.24], (2, 20))
        );
    }
}
