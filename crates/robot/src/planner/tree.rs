use super::PlanError;
use super::edge::{Edges, between, length, path_length};
use crate::kinematics::Joints;
use crate::limits::Limits;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;

/// Longest edge of a tree in weighted length (about metres); longer ones get nodes on the way.
const STEP: f64 = 0.25;
/// An extension shorter than this brings nothing.
const LEAST: f64 = 1e-3;

#[derive(Clone, Copy)]
struct Node {
    q: Joints,
    parent: usize,
}

struct Tree(Vec<Node>);

impl Tree {
    fn new(roots: &[Joints]) -> Self {
        Self(roots.iter().enumerate().map(|(i, q)| Node { q: *q, parent: i }).collect())
    }

    fn nearest(&self, q: &Joints) -> usize {
        let mut best = (f64::INFINITY, 0);
        for (i, n) in self.0.iter().enumerate() {
            let d = length(&n.q, q);
            if d < best.0 {
                best = (d, i);
            }
        }
        best.1
    }

    /// Grows from node `from` toward `q` as far as it is free; the last new node, and whether it is `q`.
    fn grow(&mut self, from: usize, q: &Joints, edges: &Edges) -> (usize, bool) {
        let start = self.0[from].q;
        let reached = edges.reach(&start, q);
        let whole = length(&start, q);
        if reached * whole < LEAST && reached < 1.0 {
            return (from, false);
        }
        let count = (reached * whole / STEP).ceil().max(1.0) as usize;
        let mut last = from;
        for k in 1..=count {
            let at = reached * k as f64 / count as f64;
            // Points on a certified line may be in the slip; only those that keep the margins are nodes.
            let node = if k == count && reached >= 1.0 { *q } else { between(&start, q, at) };
            if k == count || edges.check(&node).is_ok() {
                self.0.push(Node { q: node, parent: last });
                last = self.0.len() - 1;
            }
        }
        (last, reached >= 1.0)
    }

    /// From node `i` to its root.
    fn trace(&self, mut i: usize) -> Vec<Joints> {
        let mut out = vec![self.0[i].q];
        while self.0[i].parent != i {
            i = self.0[i].parent;
            out.push(self.0[i].q);
        }
        out
    }
}

/// RRT-Connect: a tree from the start, one from all goals, each grown toward what the other reached.
pub(super) struct Search<'a> {
    edges: &'a Edges<'a>,
    from_start: Tree,
    from_goals: Tree,
    start: Joints,
    goals: Vec<Joints>,
    lower: Joints,
    upper: Joints,
    pub iterations: usize,
}

impl<'a> Search<'a> {
    pub fn new(limits: &Limits, edges: &'a Edges<'a>, start: &Joints, goals: &[Joints]) -> Self {
        // A turn about where the motion takes place, within the limits; more is the same poses again.
        let least = |i: usize| goals.iter().fold(start[i], |m, g| m.min(g[i]));
        let most = |i: usize| goals.iter().fold(start[i], |m, g| m.max(g[i]));
        let lower = |i: usize| limits.joint_lower[i].max((start[i] - PI).min(least(i)));
        let upper = |i: usize| limits.joint_upper[i].min((start[i] + PI).max(most(i)));
        Self {
            edges,
            from_start: Tree::new(&[*start]),
            from_goals: Tree::new(goals),
            start: *start,
            goals: goals.to_vec(),
            lower: std::array::from_fn(lower),
            upper: std::array::from_fn(upper),
            iterations: 0,
        }
    }

    pub fn run(
        &mut self,
        max_iterations: usize,
        rng: &mut ChaCha8Rng,
        expired: &mut dyn FnMut() -> bool,
    ) -> Result<Vec<Joints>, PlanError> {
        while self.iterations < max_iterations {
            if expired() {
                return Err(PlanError::TimedOut { iterations: self.iterations });
            }
            let forward = self.iterations.is_multiple_of(2);
            self.iterations += 1;
            let sample = self.sample(rng);
            let (a, b) = if forward {
                (&mut self.from_start, &mut self.from_goals)
            } else {
                (&mut self.from_goals, &mut self.from_start)
            };
            let near = a.nearest(&sample);
            // No farther than a few steps: a far sample only gives the direction.
            let whole = length(&a.0[near].q, &sample);
            let toward = between(&a.0[near].q, &sample, (4.0 * STEP / whole).min(1.0));
            let (new, _) = a.grow(near, &toward, self.edges);
            if new == near {
                continue;
            }
            let reached = a.0[new].q;
            let other = b.nearest(&reached);
            let (end, joined) = b.grow(other, &reached, self.edges);
            if joined {
                let (mut path, rest) = (a.trace(new), b.trace(end));
                path.reverse();
                path.extend(&rest[1..]);
                if !forward {
                    path.reverse();
                }
                return Ok(path);
            }
        }
        Err(PlanError::NoPath { iterations: self.iterations })
    }

    /// Half of the samples lie about the lines from the start to the goals, half anywhere.
    fn sample(&self, rng: &mut ChaCha8Rng) -> Joints {
        let goal = self.goals[rng.random_range(0..self.goals.len())];
        if rng.random_bool(0.5) {
            return std::array::from_fn(|i| rng.random_range(self.lower[i]..=self.upper[i]));
        }
        let on = between(&self.start, &goal, rng.random_range(0.0..1.0));
        let wide = rng.random_range(0.1..1.2);
        std::array::from_fn(|i| {
            let off = rng.random_range(-wide..wide) + rng.random_range(-wide..wide);
            (on[i] + off).clamp(self.lower[i], self.upper[i])
        })
    }
}

/// Leaves out corners, then joins random points of the path by straight lines where those are free and
/// shorter.
pub(super) fn shorten(
    mut path: Vec<Joints>,
    edges: &Edges,
    tries: usize,
    rng: &mut ChaCha8Rng,
    expired: &mut dyn FnMut() -> bool,
) -> Vec<Joints> {
    let mut i = 0;
    while i + 2 < path.len() && !expired() {
        let far = (i + 2..path.len()).rev().find(|&j| edges.free(&path[i], &path[j]));
        if let Some(j) = far {
            path.drain(i + 1..j);
        }
        i += 1;
    }
    for _ in 0..tries {
        if path.len() < 3 || expired() {
            break;
        }
        let (x, y) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
        let (i, p) = along(&path, f64::min(x, y));
        let (j, q) = along(&path, f64::max(x, y));
        if i == j {
            continue;
        }
        let before = length(&p, &path[i + 1])
            + path[i + 1..=j].windows(2).map(|w| length(&w[0], &w[1])).sum::<f64>()
            + length(&path[j], &q);
        // A corner costs a stop, so a gain has to be worth it.
        let gain = before - length(&p, &q);
        if gain > 0.02 && edges.check(&p).is_ok() && edges.free(&p, &q) {
            path.splice(i + 1..=j, [p, q]);
        }
    }
    // Cuts leave corners that are hardly any.
    let mut i = 0;
    while i + 2 < path.len() {
        if edges.free(&path[i], &path[i + 2]) {
            path.remove(i + 1);
        } else {
            i += 1;
        }
    }
    path
}

/// Index of the edge and the point at a fraction of the path's length.
fn along(path: &[Joints], fraction: f64) -> (usize, Joints) {
    let mut left = fraction * path_length(path);
    for (i, w) in path.windows(2).enumerate() {
        let l = length(&w[0], &w[1]);
        if left <= l && l > 0.0 {
            return (i, between(&w[0], &w[1], left / l));
        }
        left -= l;
    }
    (path.len() - 2, path[path.len() - 1])
}
