//! Which plans are accepted, and the blended tool path that comes out of them.

use super::params::ControllerParams;
use super::types::{Moving, Plan};
use nalgebra::{UnitQuaternion, Vector3};
use tdv_geometry::{Pose, Stamp, interpolate, pose_distance};
use thiserror::Error;

/// Why a plan is not followed.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum PlanError {
    /// A number is NaN or infinite, or a quaternion is not of unit length.
    #[error("plan refused: {what} is not a finite pose")]
    NotFinite {
        /// Which pose.
        what: String,
    },
    /// The time step makes no sense.
    #[error("plan refused: dt is {dt} s, expected above 0 and at most 0.5")]
    BadStep {
        /// Seconds.
        dt: f64,
    },
    /// Too few or too many poses.
    #[error("plan refused: {count} poses, expected 2..=1000")]
    BadLength {
        /// How many.
        count: usize,
    },
    /// The observation is too old.
    #[error("plan refused: its observation is {:.0} ms old, {:.0} ms is allowed", .age * 1e3, .limit * 1e3)]
    Stale {
        /// Seconds.
        age: f64,
        /// Seconds.
        limit: f64,
    },
    /// The observation lies in the future.
    #[error("plan refused: its stamp is {:.0} ms in the future; check the clocks", .ahead * 1e3)]
    Future {
        /// Seconds.
        ahead: f64,
    },
    /// The plan begins too far from the tool.
    #[error("plan refused: it jumps {:.0} mm and {:.0} deg from the tool, {:.0} mm and {:.0} deg are allowed",
        .metres * 1e3, .radians.to_degrees(), .max_metres * 1e3, .max_radians.to_degrees())]
    Jump {
        /// Metres.
        metres: f64,
        /// Radians.
        radians: f64,
        /// Metres.
        max_metres: f64,
        /// Radians.
        max_radians: f64,
    },
    /// It moves an object whose pose in the gripper is not known.
    #[error("plan refused: it moves an object, whose pose in the gripper is not known yet")]
    NotAttached,
}

/// An accepted plan as a tool path, with what is left of the one before.
#[derive(Debug, Clone)]
struct Active {
    plan: Plan,
    object_to_tcp: Pose,
    since: Stamp,
    shift: Vector3<f64>,
    turn: Vector3<f64>,
}

impl Active {
    /// The plan's own tool pose at a time.
    fn raw(&self, at: Stamp) -> Pose {
        let p = &self.plan;
        // Knot 0 is the observed pose (when known) at the plan's stamp, knot i the i-th prediction.
        let x = at.since(p.stamp) / p.dt;
        let n = p.poses.len();
        let pose = if x >= n as f64 {
            p.poses[n - 1]
        } else if x < 1.0 {
            let first = p.moving_pose.as_ref().unwrap_or(&p.poses[0]);
            interpolate(first, &p.poses[0], x.max(0.0))
        } else {
            let i = x.floor() as usize;
            interpolate(&p.poses[i - 1], &p.poses[i], x - x.floor())
        };
        p.reference_pose * pose * self.object_to_tcp
    }
}

/// Keeps the newest acceptable plan.
#[derive(Debug, Clone, Default)]
pub(super) struct PlanFollower {
    active: Option<Active>,
    seen: Option<(Stamp, u32)>,
}

impl PlanFollower {
    /// Forgets the plan; the next one starts from the commanded tool.
    pub fn clear(&mut self) {
        *self = Self { active: None, seen: self.seen };
    }

    /// Age (s) of the observation behind the plan in use.
    pub fn age(&self, now: Stamp) -> Option<f64> {
        self.active.as_ref().map(|a| now.since(a.plan.stamp))
    }

    /// Looks at the newest plan; `Ok(true)` when it is new and taken over. `tool` is the commanded
    /// `T_base_link_tcp` and `attach` is `T_tcp_object` when an object is held.
    ///
    /// # Errors
    /// [`PlanError`], once per plan; the plan in use stays.
    pub fn consider(
        &mut self,
        plan: &Plan,
        now: Stamp,
        tool: &Pose,
        attach: Option<&Pose>,
        p: &ControllerParams,
    ) -> Result<bool, PlanError> {
        let key = (plan.stamp, plan.procedure);
        if self.seen == Some(key) {
            return Ok(false);
        }
        let object_to_tcp = match (plan.moving, attach) {
            (Moving::Tcp, _) => Pose::identity(),
            (Moving::Object, Some(t)) => t.inverse(),
            (Moving::Object, None) => return Err(PlanError::NotAttached),
        };
        self.seen = Some(key);
        validate(plan, now, p)?;
        let mut new = Active {
            plan: plan.clone(),
            object_to_tcp,
            since: now,
            shift: Vector3::zeros(),
            turn: Vector3::zeros(),
        };
        let begin = new.raw(now.plus(p.lookahead));
        let (metres, radians) = pose_distance(tool, &begin);
        if metres > p.max_plan_jump || radians > p.max_plan_turn {
            return Err(PlanError::Jump {
                metres,
                radians,
                max_metres: p.max_plan_jump,
                max_radians: p.max_plan_turn,
            });
        }
        let old = self.desired(now, p).unwrap_or(*tool);
        new.shift = old.translation.vector - begin.translation.vector;
        new.turn = (old.rotation * begin.rotation.inverse()).scaled_axis();
        self.active = Some(new);
        Ok(true)
    }

    /// Desired `T_base_link_tcp` at a time: the plan read `lookahead` later, plus the fading
    /// difference to what was followed before.
    pub fn desired(&self, at: Stamp, p: &ControllerParams) -> Option<Pose> {
        let a = self.active.as_ref()?;
        let raw = a.raw(at.plus(p.lookahead));
        let rest = if p.blend_time > 0.0 {
            (-at.since(a.since).max(0.0) / p.blend_time).exp()
        } else {
            0.0
        };
        Some(Pose::from_parts(
            (raw.translation.vector + a.shift * rest).into(),
            UnitQuaternion::from_scaled_axis(a.turn * rest) * raw.rotation,
        ))
    }
}

fn validate(plan: &Plan, now: Stamp, p: &ControllerParams) -> Result<(), PlanError> {
    if !(plan.dt > 0.0 && plan.dt <= 0.5) {
        return Err(PlanError::BadStep { dt: plan.dt });
    }
    let count = plan.poses.len();
    if !(2..=1000).contains(&count) {
        return Err(PlanError::BadLength { count });
    }
    let sound = |t: &Pose| {
        t.translation.vector.iter().all(|v| v.is_finite())
            && (t.rotation.coords.norm() - 1.0).abs() < 1e-3
    };
    if !sound(&plan.reference_pose) {
        return Err(PlanError::NotFinite { what: "the reference's pose".into() });
    }
    if plan.moving_pose.as_ref().is_some_and(|t| !sound(t)) {
        return Err(PlanError::NotFinite { what: "the observed pose".into() });
    }
    if let Some(i) = plan.poses.iter().position(|t| !sound(t)) {
        return Err(PlanError::NotFinite { what: format!("pose {i}") });
    }
    let age = now.since(plan.stamp);
    if age > p.stale_after {
        return Err(PlanError::Stale { age, limit: p.stale_after });
    }
    if age < -p.future_tolerance {
        return Err(PlanError::Future { ahead: -age });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_from_xyz_rpy;

    fn plan(stamp: Stamp, x0: f64) -> Plan {
        let pose = |x: f64| pose_from_xyz_rpy([x, 0.0, 0.0], [0.0; 3]);
        Plan {
            stamp,
            procedure: 0,
            moving: Moving::Tcp,
            reference_pose: pose_from_xyz_rpy([0.4, 0.0, 0.2], [0.0; 3]),
            moving_pose: Some(pose(x0)),
            poses: (1..=16).map(|i| pose(x0 + 0.01 * f64::from(i))).collect(),
            dt: 0.05,
        }
    }

    #[test]
    fn reads_ahead_and_blends_without_a_step() {
        let p = ControllerParams::default();
        let (t0, tool) = (Stamp::from_secs(10.0), Pose::translation(0.4, 0.0, 0.2));
        let mut f = PlanFollower::default();
        assert_eq!(f.consider(&plan(t0, 0.0), t0.plus(0.08), &tool, None, &p), Ok(true));
        assert_eq!(f.consider(&plan(t0, 0.0), t0.plus(0.09), &tool, None, &p), Ok(false));
        // At the start where the tool is, later where the plan is 0.15 s on (0.2 m/s).
        let at = |f: &PlanFollower, s: f64| f.desired(t0.plus(s), &p).unwrap().translation.x;
        assert!((at(&f, 0.08) - 0.4).abs() < 1e-9);
        assert!((at(&f, 0.58) - (0.4 + 0.2 * 0.73)).abs() < 1e-3 + 0.05 * (-5.0f64).exp());
        let before = at(&f, 0.11);
        let t1 = t0.plus(0.033);
        assert_eq!(f.consider(&plan(t1, 0.03), t0.plus(0.11), &tool, None, &p), Ok(true));
        assert!((at(&f, 0.11) - before).abs() < 1e-9, "no step when a plan is taken over");
    }

    #[test]
    fn an_object_plan_needs_the_attachment() {
        let p = ControllerParams::default();
        let t0 = Stamp::from_secs(10.0);
        let tool = Pose::translation(0.4, 0.0, 0.3);
        let mut held = plan(t0, 0.0);
        held.moving = Moving::Object;
        let mut f = PlanFollower::default();
        assert_eq!(f.consider(&held, t0, &tool, None, &p), Err(PlanError::NotAttached));
        let attach = Pose::translation(0.0, 0.0, -0.1);
        assert_eq!(f.consider(&held, t0, &tool, Some(&attach), &p), Ok(true));
        assert!((f.desired(t0.plus(2.0), &p).unwrap().translation.z - 0.3).abs() < 1e-6);
    }

    #[test]
    fn bad_plans_are_refused_by_value() {
        let p = ControllerParams::default();
        let t0 = Stamp::from_secs(10.0);
        let tool = Pose::translation(0.4, 0.0, 0.2);
        let refuse = |plan: Plan, now: Stamp| {
            let mut f = PlanFollower::default();
            let e = f.consider(&plan, now, &tool, None, &p).unwrap_err();
            assert!(f.desired(now, &p).is_none());
            e
        };
        let mut nan = plan(t0, 0.0);
        nan.poses[3].translation.vector.y = f64::NAN;
        assert_eq!(refuse(nan, t0), PlanError::NotFinite { what: "pose 3".into() });
        let mut empty = plan(t0, 0.0);
        empty.poses.truncate(1);
        assert_eq!(refuse(empty, t0), PlanError::BadLength { count: 1 });
        let mut still = plan(t0, 0.0);
        still.dt = f64::NAN;
        assert!(matches!(refuse(still, t0), PlanError::BadStep { .. }));
        assert!(matches!(refuse(plan(t0, 0.0), t0.plus(0.16)), PlanError::Stale { .. }));
        assert!(matches!(refuse(plan(t0, 0.0), t0.plus(-0.1)), PlanError::Future { .. }));
        let e = refuse(plan(t0, 0.3), t0);
        assert!(matches!(e, PlanError::Jump { .. }), "{e}");
        assert!(e.to_string().contains("330 mm"), "{e}");
        let mut turned = plan(t0, 0.0);
        turned.reference_pose = pose_from_xyz_rpy([0.4, 0.0, 0.2], [2.0, 0.0, 0.0]);
        assert!(matches!(refuse(turned, t0), PlanError::Jump { .. }));
    }
}
