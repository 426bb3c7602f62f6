//! Two published ways of bending a path, to compare with.

use super::{Warp, WarpRule};
use crate::path::arcs;
use tdv_geometry::nalgebra::{SVector, UnitQuaternion, Vector3};
use tdv_geometry::{Pose, interpolate};

/// MimicGen's and DemoGen's way: the last `alpha` of the path (SE(3) arc length) is the skill and stays as
/// it is in the reference frame; before it stands a straight line with the shortest turn from the new start.
/// As many poses as the demonstration has; an empty one gives an empty path.
pub fn warp_rigid(demo: &[Pose], start: &Pose, alpha: f64) -> Warp {
    let arcs = arcs(demo);
    let total = arcs.last().copied().unwrap_or(0.0);
    let seam = arcs.partition_point(|s| *s < (1.0 - alpha) * total).min(demo.len().max(1) - 1);
    let mut poses = demo.to_vec();
    for i in 0..seam {
        // A seam after the first sample has a positive arc.
        poses[i] = interpolate(start, &demo[seam], arcs[i] / arcs[seam]);
    }
    if let Some(first) = poses.first_mut() {
        *first = *start;
    }
    Warp { poses, rule: WarpRule::Rigid, scale: 1.0, angle: 0.0 }
}

/// Natural frequency of the transformation system, per duration of the demonstration.
const FREQUENCY: f64 = 25.0;
/// The phase falls to a thousandth over the demonstration.
const DECAY: f64 = 6.907_755;
/// Least number of integration steps; keeps the stiff system stable for short demonstrations.
const STEPS: usize = 200;

type State = SVector<f64, 6>;

/// A dynamic movement primitive in the form of Hoffmann and Park, which has no singularity where start and
/// goal agree: `y'' = K (g - y) - D y' - K (g - y_0) s + K f(s)`, critically damped, phase
/// `s = exp(-a t)`. `y` is position and rotation vector from the goal's orientation. The forcing term is
/// learned from the samples, taken as evenly spaced in time, so that the demonstrated start gives the
/// demonstration back; from other starts the end is missed by some 0.2 % of the start's difference.
pub fn warp_dmp(demo: &[Pose], start: &Pose) -> Warp {
    let result = |poses| Warp { poses, rule: WarpRule::Dmp, scale: 1.0, angle: 0.0 };
    let (Some(last), n) = (demo.last(), demo.len()) else { return result(Vec::new()) };
    if n < 2 {
        return result(vec![*start]);
    }
    let taught = states(demo, last);
    let goal = taught[n - 1];
    let sub = STEPS.div_ceil(n - 1);
    let h = 1.0 / ((n - 1) * sub) as f64;
    let (k, d) = (FREQUENCY * FREQUENCY, 2.0 * FREQUENCY);
    let at = |i: usize| -> State {
        let (a, b) = (i / sub, (i / sub + 1).min(n - 1));
        taught[a] + (taught[b] - taught[a]) * ((i % sub) as f64 / sub as f64)
    };
    let mut y = near(&state(start, last), &taught[0]);
    let (pull, taught_pull) = ((goal - y) * k, (goal - taught[0]) * k);
    let (mut v, mut taught_v) = (State::zeros(), State::zeros());
    let mut poses = vec![*start];
    for i in 0..(n - 1) * sub {
        let s = (-DECAY * i as f64 * h).exp();
        let (here, next) = (at(i), at(i + 1));
        let next_v = (next - here) / h;
        let forcing = (next_v - taught_v) / h - (goal - here) * k + taught_v * d + taught_pull * s;
        taught_v = next_v;
        let acceleration = (goal - y) * k - v * d - pull * s + forcing;
        v += acceleration * h;
        y += v * h;
        if (i + 1) % sub == 0 {
            let turn = Vector3::new(y[3], y[4], y[5]);
            let rotation = last.rotation * UnitQuaternion::from_scaled_axis(turn);
            poses.push(Pose::from_parts([y[0], y[1], y[2]].into(), rotation));
        }
    }
    result(poses)
}

fn state(p: &Pose, goal: &Pose) -> State {
    let t = p.translation.vector;
    let r = (goal.rotation.inverse() * p.rotation).scaled_axis();
    State::new(t.x, t.y, t.z, r.x, r.y, r.z)
}

/// The states of a path; rotation vectors run on past half a turn instead of jumping to the other side.
fn states(demo: &[Pose], goal: &Pose) -> Vec<State> {
    let mut out: Vec<State> = demo.iter().map(|p| state(p, goal)).collect();
    for i in (0..out.len() - 1).rev() {
        out[i] = near(&out[i], &out[i + 1]);
    }
    out
}

/// The same state with the rotation vector, of all that mean the same, nearest to the one of `other`.
fn near(state: &State, other: &State) -> State {
    let mut out = *state;
    let here = state.fixed_rows::<3>(3).into_owned();
    if here.norm() > 1e-9 {
        let axis = here.normalize();
        let apart = other.fixed_rows::<3>(3) - here;
        let turns = (apart.dot(&axis) / std::f64::consts::TAU).round();
        out.fixed_rows_mut::<3>(3).copy_from(&(here + axis * turns * std::f64::consts::TAU));
    }
    out
}
