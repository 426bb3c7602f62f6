use super::PlanRequest;
use crate::collision::{Advance, CollisionError, CollisionWorld};
use crate::kinematics::Joints;

/// What a radian of each joint counts in lengths: about the metres by which it moves the tool.
pub(super) const WEIGHTS: Joints = [0.8, 0.8, 0.6, 0.3, 0.25, 0.15];

/// Length of a joint-space line.
pub(super) fn length(a: &Joints, b: &Joints) -> f64 {
    (0..6).map(|i| (WEIGHTS[i] * (b[i] - a[i])).powi(2)).sum::<f64>().sqrt()
}

/// Length of a path in joint space.
pub(super) fn path_length(path: &[Joints]) -> f64 {
    path.windows(2).map(|w| length(&w[0], &w[1])).sum()
}

/// The configuration at fraction `t` of a line.
pub(super) fn between(a: &Joints, b: &Joints, t: f64) -> Joints {
    std::array::from_fn(|i| a[i] + t * (b[i] - a[i]))
}

/// Certified joint-space lines in one world.
pub(super) struct Edges<'a> {
    pub world: &'a CollisionWorld,
    pub request: &'a PlanRequest<'a>,
    pub slip: f64,
}

impl Edges<'_> {
    pub fn check(&self, q: &Joints) -> Result<(), CollisionError> {
        self.world.check(q, self.request.knuckle, self.request.held)
    }

    /// The whole line keeps every margin less the slip; its end keeps the margins themselves.
    pub fn free(&self, a: &Joints, b: &Joints) -> bool {
        // Most lines that collide do so at one of a few points, which are cheap to look at.
        [1.0, 0.5, 0.25, 0.75].iter().all(|t| self.check(&between(a, b, *t)).is_ok())
            && self.reach(a, b) >= 1.0
    }

    /// The greatest fraction of the line at which the margins were found kept, all of the line before
    /// being certified; the start is taken to be free.
    pub fn reach(&self, a: &Joints, b: &Joints) -> f64 {
        let dq: Joints = std::array::from_fn(|i| b[i] - a[i]);
        let (mut t, mut good) = (0.0, 0.0);
        while t < 1.0 {
            let by = Advance { dq: &dq, remaining: 1.0 - t, slip: self.slip };
            let q = between(a, b, t);
            match self.world.advance(&q, self.request.knuckle, self.request.held, by) {
                Ok(step) => {
                    good = t;
                    if step >= 1.0 - t {
                        break;
                    }
                    t += step;
                }
                Err(_) => return good,
            }
        }
        if self.check(b).is_ok() { 1.0 } else { good }
    }
}
