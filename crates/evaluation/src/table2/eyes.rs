//! What the robot is told of the objects: the truth with a stated noise, one frame late.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::collections::BTreeMap;
use tdv_demonstration::Task;
use tdv_geometry::nalgebra::{Translation3, UnitQuaternion, Vector3};
use tdv_geometry::{Pose, interpolate, pose_distance};

/// Frames per second.
pub(super) const RATE: f64 = 30.0;
/// Frames that are averaged before the pose in the gripper is known, and the share by which later ones
/// move it: those of the pose tracker.
const FRAMES: u32 = 8;
const LATER: f64 = 0.03;
/// ... unless they are farther from it than this, m.
const OUTLIER: f64 = 0.015;
/// Farther from where it is carried (m), for so many frames, the object has slipped out.
const SLIP: (f64, u32) = (0.05, 10);

/// Standard deviations of the observed poses, white from frame to frame.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PoseNoise {
    /// By axis, m.
    pub position: f64,
    /// By axis of the rotation vector, rad.
    pub rotation: f64,
}

impl Default for PoseNoise {
    fn default() -> Self {
        Self { position: 0.002, rotation: 1f64.to_radians() }
    }
}

/// One frame as the policies get it.
pub(super) struct Frame {
    /// `T_base_link_frame` by name, with `tcp`.
    pub poses: BTreeMap<String, Pose>,
    /// `T_tcp_object` of the held object.
    pub attach: Option<Pose>,
    /// The held object is where the gripper is.
    pub in_grip: bool,
}

pub(super) struct Eyes<'a> {
    task: &'a Task,
    noise: PoseNoise,
    rng: ChaCha8Rng,
    attach: Option<(Pose, u32)>,
    off: u32,
}

impl<'a> Eyes<'a> {
    pub fn new(task: &'a Task, noise: PoseNoise, seed: u64) -> Self {
        Self { task, noise, rng: ChaCha8Rng::seed_from_u64(seed), attach: None, off: 0 }
    }

    fn noisy(&mut self, p: &Pose) -> Pose {
        let mut draw =
            |scale: f64| Vector3::from_fn(|_, _| scale * self.rng.sample::<f64, _>(StandardNormal));
        let (shift, turn) = (draw(self.noise.position), draw(self.noise.rotation));
        Pose::from_parts(
            Translation3::from(p.translation.vector + shift),
            UnitQuaternion::from_scaled_axis(turn) * p.rotation,
        )
    }

    /// A look at the true poses; `held` names the object that the arm controller holds.
    pub fn look(&mut self, truth: &[(String, Pose)], tcp: &Pose, held: Option<&str>) -> Frame {
        let mut poses = BTreeMap::from([("tcp".to_owned(), *tcp)]);
        if held.is_none() {
            (self.attach, self.off) = (None, 0);
        }
        for (name, pose) in truth {
            let mut seen = self.noisy(pose);
            if *name == self.task.reference_object {
                seen = self.task.canonical_reference(&seen);
            }
            if held == Some(name.as_str()) {
                seen = self.carry(tcp, &seen);
            }
            poses.insert(name.clone(), seen);
        }
        let in_grip = self.attach.is_some() && self.off < SLIP.1;
        Frame { poses, attach: self.attach.map(|a| a.0).filter(|_| in_grip), in_grip }
    }

    /// A held object hangs on the tool where the first frames saw it.
    fn carry(&mut self, tcp: &Pose, seen: &Pose) -> Pose {
        let now = tcp.inverse() * seen;
        let (mean, count) = self.attach.unwrap_or((now, 0));
        let distance = pose_distance(&mean, &now).0;
        let away = distance > SLIP.0;
        self.off = if away { self.off + 1 } else { 0 };
        if self.off >= SLIP.1 {
            return *seen;
        }
        let share = match count {
            0..FRAMES if !away => 1.0 / f64::from(count + 1),
            FRAMES.. if distance < OUTLIER => LATER,
            _ => 0.0,
        };
        let mean = interpolate(&mean, &now, share);
        self.attach = Some((mean, count + 1));
        tcp * mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use tdv_geometry::pose_from_xyz_rpy;

    fn task() -> Task {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        Task::load(&root.join("config/tasks/cup_on_coaster.yaml")).unwrap()
    }

    #[test]
    fn noise_is_as_stated_seeded_and_white() {
        let task = task();
        let truth = [("mug".to_owned(), pose_from_xyz_rpy([0.4, 0.1, 0.0], [0.0, 0.0, 0.7]))];
        let look = |seed| -> Vec<Pose> {
            let mut eyes = Eyes::new(&task, PoseNoise::default(), seed);
            (0..2000).map(|_| eyes.look(&truth, &Pose::identity(), None).poses["mug"]).collect()
        };
        let seen = look(3);
        assert_eq!(seen, look(3));
        assert_ne!(seen[0], look(4)[0]);
        let x: Vec<f64> = seen.iter().map(|p| p.translation.x - 0.4).collect();
        let power = x.iter().map(|v| v * v).sum::<f64>() / x.len() as f64;
        assert!((power.sqrt() - 0.002).abs() < 1.5e-4, "{}", power.sqrt());
        let next = x.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / x.len() as f64;
        assert!(next.abs() < 0.1 * power, "frames hang together: {next}");
        let turn = seen.iter().map(|p| pose_distance(p, &truth[0].1).1.powi(2)).sum::<f64>();
        let rms = (turn / 3.0 / seen.len() as f64).sqrt().to_degrees();
        assert!((rms - 1.0).abs() < 0.07, "{rms} deg");
    }

    #[test]
    fn a_held_object_hangs_on_the_tool_until_it_slips() {
        let task = task();
        let mut eyes = Eyes::new(&task, PoseNoise::default(), 1);
        let attach = pose_from_xyz_rpy([0.0, 0.0, 0.06], [std::f64::consts::PI, 0.0, 0.2]);
        let mut frame = None;
        for i in 0..60 {
            let tcp = pose_from_xyz_rpy([0.4, 0.005 * f64::from(i), 0.2], [3.1, 0.0, 0.0]);
            let truth = [("mug".to_owned(), tcp * attach)];
            frame = Some(eyes.look(&truth, &tcp, Some("mug")));
        }
        let frame = frame.unwrap();
        let (d, a) = pose_distance(&frame.attach.unwrap(), &attach);
        assert!(frame.in_grip && d < 0.002 && a < 0.02, "{d} {a}");
        let lost = [("mug".to_owned(), pose_from_xyz_rpy([0.4, 0.3, 0.0], [0.0; 3]))];
        let tcp = pose_from_xyz_rpy([0.4, 0.5, 0.4], [3.1, 0.0, 0.0]);
        let last = (0..12).map(|_| eyes.look(&lost, &tcp, Some("mug"))).last().unwrap();
        assert!(!last.in_grip && last.attach.is_none());
        assert!(pose_distance(&last.poses["mug"], &lost[0].1).0 < 0.02);
    }
}
