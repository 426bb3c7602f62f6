//! The judge of a trial, from the lab's truth. What counts as done is a [`Rule`].
//!
//! Success of placing: the object's centre within 15 mm of the target in the plane, upright within 10 deg, yaw
//! within 10 deg unless it is rotationally symmetric, released, at rest for 1 s, nothing else knocked
//! over, within 60 s.

mod rule;

pub use rule::{Measured, Rule};

use serde::{Deserialize, Serialize};
use tdv_geometry::nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use tdv_geometry::{Pose, Symmetry, yaw_of};

/// The numbers of the definition.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SuccessConfig {
    /// Largest distance of the object's centre from the target in the plane, m.
    pub distance: f64,
    /// Largest tilt, deg.
    pub tilt_deg: f64,
    /// Largest error of yaw, deg.
    pub yaw_deg: f64,
    /// How long everything has to hold, s.
    pub rest: f64,
    /// Time limit, s.
    pub limit: f64,
}

impl Default for SuccessConfig {
    fn default() -> Self {
        Self { distance: 0.015, tilt_deg: 10.0, yaw_deg: 10.0, rest: 1.0, limit: 60.0 }
    }
}

/// Where the moving object has to end, seen from the reference object.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlacingGoal {
    /// Offset in the plane, m.
    pub offset: [f64; 2],
    /// Yaw, rad; that of the demonstration. The frame of a reference that is symmetric about z has no
    /// yaw of its own: it is taken as aligned with `base_link`.
    pub yaw: f64,
}

/// One object as the judge sees it.
#[derive(Debug, Clone, Copy)]
pub struct Observed<'a> {
    /// Name, for the reason.
    pub name: &'a str,
    /// `T_base_link_object`.
    pub pose: Pose,
    /// Linear (m/s) and angular (rad/s) speed.
    pub speed: (f64, f64),
    /// The robot touches it.
    pub touched: bool,
    /// It lies on the floor.
    pub fallen: bool,
}

/// What is said about a trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// Nothing will change any more.
    pub finished: bool,
    /// All of the definition holds.
    pub success: bool,
    /// Why (not), for people.
    pub reason: String,
    /// Distance of the centre from the target in the plane, m.
    pub error_m: f64,
    /// Error of yaw, rad; 0 for a symmetric object.
    pub error_rad: f64,
    /// Tilt of the moving object, rad.
    pub tilt_rad: f64,
    /// The robot does not touch it.
    pub released: bool,
    /// Seconds since the trial began.
    pub elapsed: f64,
    /// What the task's rule looks at.
    #[serde(default)]
    pub measured: Measured,
}

/// Slower than this an object is at rest: m/s and rad/s.
const REST: (f64, f64) = (0.005, 0.05);
/// An object tilted by more than this (rad) has been knocked over.
const KNOCKED: f64 = 0.35;
/// A fallen moving object ends the trial after lying untouched for this long, s.
const HOPELESS: f64 = 3.0;

/// Follows one trial.
#[derive(Debug, Clone)]
pub struct Judge {
    config: SuccessConfig,
    rule: Rule,
    goal: PlacingGoal,
    moving: usize,
    reference: usize,
    moving_symmetry: Symmetry,
    reference_symmetry: Symmetry,
    held_for: f64,
    down_for: f64,
    verdict: Verdict,
}

fn tilt(pose: &Pose) -> f64 {
    (pose.rotation * Vector3::z()).angle(&Vector3::z())
}

fn about_z(s: &Symmetry) -> bool {
    matches!(s, Symmetry::Continuous { axis } if axis[2].abs() > 0.99 * Vector3::from(*axis).norm())
}

fn upright(yaw: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw)
}

impl Judge {
    /// A judge for the objects with these indices and symmetries.
    pub fn new(
        config: SuccessConfig,
        goal: PlacingGoal,
        (moving, moving_symmetry): (usize, Symmetry),
        (reference, reference_symmetry): (usize, Symmetry),
    ) -> Self {
        let verdict = Verdict {
            finished: false,
            success: false,
            reason: "running".into(),
            error_m: f64::INFINITY,
            error_rad: 0.0,
            tilt_rad: 0.0,
            released: true,
            elapsed: 0.0,
            measured: Measured::default(),
        };
        Self {
            config,
            rule: Rule::default(),
            goal,
            moving,
            reference,
            moving_symmetry,
            reference_symmetry,
            held_for: 0.0,
            down_for: 0.0,
            verdict,
        }
    }

    /// The same judge for another kind of task.
    #[must_use]
    pub fn with_rule(mut self, rule: Rule) -> Self {
        self.rule = rule;
        self
    }

    /// The verdict so far.
    pub fn verdict(&self) -> &Verdict {
        &self.verdict
    }

    /// The target of the moving object, `T_base_link_object`, for a reference at `reference`.
    pub fn target(&self, reference: &Pose) -> Pose {
        let yaw = if about_z(&self.reference_symmetry) { 0.0 } else { yaw_of(&reference.rotation) };
        let frame = Pose::from_parts(reference.translation, upright(yaw));
        let at = Translation3::new(self.goal.offset[0], self.goal.offset[1], 0.0);
        frame * Pose::from_parts(at, upright(self.goal.yaw))
    }

    /// One look at the world, `dt` seconds after the last. `drops` are the centres of what is poured
    /// (m, base_link), if there are any.
    pub fn step(&mut self, dt: f64, objects: &[Observed], drops: &[Point3<f64>]) -> &Verdict {
        if self.verdict.finished {
            return &self.verdict;
        }
        self.verdict.elapsed += dt;
        let (Some(moving), Some(reference)) =
            (objects.get(self.moving), objects.get(self.reference))
        else {
            return self.finish(false, "the scene lacks the moving or the reference object".into());
        };
        let target = self.target(&reference.pose);
        let off = moving.pose.translation.vector - target.translation.vector;
        self.verdict.error_m = off.xy().norm();
        self.verdict.tilt_rad = tilt(&moving.pose);
        self.verdict.error_rad = if about_z(&self.moving_symmetry) {
            0.0
        } else {
            let flat = Pose::rotation((upright(yaw_of(&moving.pose.rotation))).scaled_axis());
            let goal = Pose::rotation(target.rotation.scaled_axis());
            self.moving_symmetry.distance(&flat, &goal).1
        };
        self.verdict.released = !moving.touched;
        self.verdict.measured = self.rule.measure(moving, reference, drops);

        if let Some(o) = objects.iter().find(|o| o.fallen) {
            return self.finish(false, format!("{} fell off the table", o.name));
        }
        // The reference may tilt for a moment when something is set down on its rim: only what lies
        // still has been knocked over.
        let knocked = |o: &&Observed| tilt(&o.pose) > KNOCKED && o.speed.0 < REST.0 && !o.touched;
        let mut others = objects.iter().enumerate().filter(|(i, _)| *i != self.moving);
        if let Some((_, o)) = others.find(|(_, o)| knocked(o)) {
            return self.finish(false, format!("{} was knocked over", o.name));
        }
        let at_rest = moving.speed.0 < REST.0 && moving.speed.1 < REST.1;
        let lying = self.verdict.tilt_rad > 0.8 && at_rest && !moving.touched;
        self.down_for = if lying { self.down_for + dt } else { 0.0 };
        if self.down_for > HOPELESS {
            return self.finish(false, format!("{} lies on its side", moving.name));
        }
        let missing = self.missing(moving.name, at_rest);
        self.held_for = if missing.is_none() { self.held_for + dt } else { 0.0 };
        if self.held_for >= self.config.rest {
            return self.finish(true, self.rule.done().into());
        }
        let reason = missing.unwrap_or_else(|| format!("{}, waiting for rest", self.rule.done()));
        if self.verdict.elapsed >= self.config.limit {
            return self.finish(false, format!("time is up: {reason}"));
        }
        self.verdict.reason = reason;
        &self.verdict
    }

    /// Ends the trial now, for instance because the robot says that it is done.
    pub fn conclude(&mut self, why: &str) -> &Verdict {
        if !self.verdict.finished {
            let reason = format!("{why}: {}", self.verdict.reason);
            self.finish(false, reason);
        }
        &self.verdict
    }

    fn missing(&self, name: &str, at_rest: bool) -> Option<String> {
        let v = &self.verdict;
        let c = &self.config;
        if self.rule != Rule::Placing {
            let missing = self.rule.missing(name, &v.measured, v.tilt_rad, c);
            if missing.is_some() || !self.rule.wants_release() {
                return missing;
            }
        } else if let Some(missing) = self.misplaced(name) {
            return Some(missing);
        }
        if !v.released {
            return Some(format!("{name} is still touched by the robot"));
        }
        (!at_rest).then(|| format!("{name} is not at rest"))
    }

    fn misplaced(&self, name: &str) -> Option<String> {
        let v = &self.verdict;
        let c = &self.config;
        if v.error_m > c.distance {
            return Some(format!("{name} is {:.0} mm from its target", v.error_m * 1e3));
        }
        if v.tilt_rad.to_degrees() > c.tilt_deg {
            return Some(format!("{name} is tilted by {:.0} deg", v.tilt_rad.to_degrees()));
        }
        if v.error_rad.to_degrees() > c.yaw_deg {
            return Some(format!("{name} is turned by {:.0} deg", v.error_rad.to_degrees()));
        }
        None
    }

    fn finish(&mut self, success: bool, reason: String) -> &Verdict {
        self.verdict.finished = true;
        self.verdict.success = success;
        self.verdict.reason = reason;
        &self.verdict
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_from_xyz_rpy;

    const Z: Symmetry = Symmetry::Continuous { axis: [0.0, 0.0, 1.0] };

    fn seen(name: &str, pose: Pose) -> Observed<'_> {
        Observed { name, pose, speed: (0.0, 0.0), touched: false, fallen: false }
    }

    fn judge(yaw: f64) -> Judge {
        let goal = PlacingGoal { offset: [0.0, 0.0], yaw };
        Judge::new(SuccessConfig::default(), goal, (0, Symmetry::None), (1, Z))
    }

    /// Runs until finished and returns the verdict.
    fn run(mut j: Judge, change: impl Fn(f64, &mut [Observed; 2])) -> Verdict {
        let coaster = pose_from_xyz_rpy([0.45, -0.22, 0.0], [0.0, 0.0, 1.3]);
        loop {
            let mut o = [
                seen("mug", pose_from_xyz_rpy([0.456, -0.218, 0.008], [0.0, 0.0, 0.5])),
                seen("coaster", coaster),
            ];
            change(j.verdict().elapsed, &mut o);
            if j.step(0.02, &o, &[]).finished {
                return j.verdict().clone();
            }
        }
    }

    #[test]
    fn placed_and_left_alone_for_a_second() {
        let v = run(judge(0.45), |_, _| {});
        assert!(v.success && (0.99..1.05).contains(&v.elapsed), "{v:?}");
        assert!((v.error_m - 0.00632).abs() < 1e-4 && (v.error_rad - 0.05).abs() < 1e-9);
        let v = run(judge(0.45), |t, o| o[0].touched = t < 3.0);
        assert!(v.success && v.elapsed > 3.9);
    }

    #[test]
    fn each_clause_fails_by_itself() {
        let cases: [(&str, fn(f64, &mut [Observed; 2])); 6] = [
            ("mm from", |_, o| o[0].pose.translation.x += 0.012),
            ("tilted", |_, o| {
                o[0].pose.rotation *= UnitQuaternion::from_euler_angles(0.2, 0.0, 0.0)
            }),
            ("turned", |_, o| o[0].pose.rotation *= upright(0.3)),
            ("touched", |_, o| o[0].touched = true),
            ("not at rest", |_, o| o[0].speed.0 = 0.02),
            ("knocked over", |_, o| {
                o[1].pose.rotation = UnitQuaternion::from_euler_angles(1.0, 0.0, 0.0);
            }),
        ];
        for (word, change) in cases {
            let v = run(judge(0.45), change);
            assert!(!v.success && v.reason.contains(word), "{word}: {v:?}");
        }
        let v = run(judge(0.45), |_, o| o[0].fallen = true);
        assert!(v.reason.contains("fell off"));
    }

    /// Runs one rule with the moving object at `at` in the reference's frame for 1.5 s.
    fn ruled(rule: Rule, at: [f64; 3], touched: bool, drops: &[Point3<f64>]) -> Verdict {
        let reference = pose_from_xyz_rpy([0.45, -0.22, 0.0], [0.0, 0.0, 0.7]);
        let mut j = judge(0.0).with_rule(rule);
        for _ in 0..75 {
            let mut o = [
                seen("mug", reference * Pose::translation(at[0], at[1], at[2])),
                seen("coaster", reference),
            ];
            o[0].touched = touched;
            j.step(0.02, &o, drops);
        }
        j.verdict().clone()
    }

    #[test]
    fn drops_are_counted_in_the_cup() {
        let rule = Rule::Pouring { share: 0.8, radius: 0.04, height: 0.08 };
        let mut drops = vec![Point3::new(0.45, -0.22, 0.02); 80];
        drops.extend(vec![Point3::new(0.45, -0.17, 0.02); 20]);
        let v = ruled(rule, [0.1, 0.0, 0.3], true, &drops);
        assert!(v.success && v.measured == Measured::Drops { inside: 80, total: 100 }, "{v:?}");
        drops[0].z = 0.09;
        let v = ruled(rule, [0.1, 0.0, 0.3], true, &drops);
        assert!(!v.success && v.reason.contains("79 of 100"), "{v:?}");
        assert!(ruled(rule, [0.1, 0.0, 0.3], true, &[]).reason.contains("no drops"));
    }

    #[test]
    fn a_ring_has_to_be_down_round_the_axis_and_released() {
        let rule = Rule::Ring { distance: 0.004, below: 0.06 };
        assert!(ruled(rule, [0.002, 0.0, 0.01], false, &[]).success);
        for (at, touched, word) in [
            ([0.006, 0.0, 0.01], false, "from the axis"),
            ([0.0, 0.0, 0.08], false, "too high"),
            ([0.0, 0.0, 0.01], true, "touched"),
        ] {
            let v = ruled(rule, at, touched, &[]);
            assert!(!v.success && v.reason.contains(word), "{word}: {v:?}");
        }
    }

    #[test]
    fn travel_depth_and_distance_are_measured_in_the_reference() {
        let opened = Rule::Opened { axis: [1.0, 0.0, 0.0], travel: 0.1 };
        let inserted =
            Rule::Inserted { at: [0.04, 0.0], mouth: 0.03, distance: 0.004, depth: 0.018 };
        let pulled = Rule::Pulled { distance: 0.08 };
        for (rule, good, bad) in [
            (opened, [0.101, 0.0, 0.0], [0.099, 0.0, 0.0]),
            (opened, [0.101, 0.02, 0.0], [0.0, 0.2, 0.0]),
            (inserted, [0.042, 0.0, 0.01], [0.042, 0.0, 0.02]),
            (inserted, [0.04, 0.0, 0.01], [-0.04, 0.0, 0.01]),
            (pulled, [0.0, 0.0, 0.081], [0.0, 0.0, 0.079]),
        ] {
            // Held or not makes no difference.
            assert!(ruled(rule, good, true, &[]).success, "{rule:?}");
            assert!(!ruled(rule, bad, false, &[]).success, "{rule:?}");
        }
        assert!(
            Rule::Pulled { distance: f64::NAN }.problem().is_some() && opened.problem().is_none()
        );
    }

    #[test]
    fn yaw_is_free_for_a_symmetric_object() {
        let mut j = judge(0.0);
        j.moving_symmetry = Z;
        assert!(run(j, |_, _| {}).success);
    }

    #[test]
    fn lying_on_its_side_ends_early() {
        let v = run(judge(0.45), |_, o| {
            o[0].pose.rotation = UnitQuaternion::from_euler_angles(1.5, 0.0, 0.0);
        });
        assert!(!v.success && v.elapsed < 4.0 && v.reason.contains("side"), "{v:?}");
    }
}
