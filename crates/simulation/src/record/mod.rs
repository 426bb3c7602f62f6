//! A scripted demonstration: a hand takes something, moves it and leaves it, before the RGB-D camera.
//! Placing a cup is written out here; the other tasks are tables of phases ([`demonstration`]).
//!
//! The motion is kinematic (minimum-jerk channels, the held object fixed to the palm) and the images
//! go through the sensor model. Ground truth comes beside each frame and is for evaluation only.

mod phases;
mod tasks;

pub use phases::{Grip, Phase, Script};
pub use tasks::{TASKS, TaskDemo, demonstration};

use crate::avatar::{GraspFit, GraspTarget, HandPose, HandShape, Skin, fit_grasp, tool_from_hand};
use crate::backdrop::{Backdrop, BackdropConfig, FIRST_FREE_ID};
use crate::sensor::{RgbdSensor, SceneItem, SensorConfig, SensorFrame};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use std::collections::BTreeMap;
use tdv_geometry::{Pose, Stamp, pose_from_xyz_rpy, smooth_step, yaw_of};
use tdv_rendering::{DepthImage, Intrinsics, Mesh, RgbImage, look_at};
use thiserror::Error;

/// Why a demonstration cannot be recorded.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum RecordError {
    /// A number that makes no sense.
    #[error("demonstration: {field} {reason}")]
    Value {
        /// Which field of the configuration.
        field: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// The hand cannot hold the object from above.
    #[error(
        "demonstration: the hand finds no grasp on an object of {radius_mm:.0} mm radius and \
         {height_mm:.0} mm height ({reason})"
    )]
    NoGrasp {
        /// Radius of the object (mm).
        radius_mm: f64,
        /// Height of the object (mm).
        height_mm: f64,
        /// How the search failed.
        reason: String,
    },
}

/// An object of the scene.
#[derive(Debug, Clone)]
pub struct DemoObject {
    /// Its name in the truth.
    pub name: String,
    /// Its surface, in its own frame.
    pub mesh: Mesh,
}

/// How the hand moves.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Motion {
    /// Takes an upright object, carries it in a human arc and puts it down upright.
    #[default]
    Placing,
    /// By a table of phases.
    Script(Script),
}

/// What is shown. Poses in base_link.
#[derive(Debug, Clone)]
pub struct DemoConfig {
    /// Seed of light, table, noise and the hand's small motions.
    pub seed: u64,
    /// Frames a second.
    pub rate: f64,
    /// Stamp of the first frame.
    pub start: Stamp,
    /// Where the moving object stands (upright).
    pub moving_start: Pose,
    /// Where the reference object lies.
    pub reference: Pose,
    /// Where the moving object ends (upright).
    pub moving_end: Pose,
    /// How the hand moves.
    pub motion: Motion,
    /// How high the object is lifted (m) when it is placed; a script says so itself.
    pub lift: f64,
    /// The moving object as the grasp sees it.
    pub target: GraspTarget,
    /// T_base_camera, optical frame.
    pub camera: Pose,
    /// The camera.
    pub sensor: SensorConfig,
    /// The room.
    pub backdrop: BackdropConfig,
    /// The hand's bones.
    pub shape: HandShape,
    /// The hand's surface.
    pub skin: Skin,
    /// A point (m) near the demonstrator's shoulder: the forearm comes from there.
    pub shoulder: [f64; 3],
    /// Where the wrist waits before and after, relative to the object's start.
    pub home: [f64; 3],
}

impl DemoConfig {
    /// The mug from `start` (x, y in m, yaw in rad) onto the coaster at (0.45, -0.22), seen by a
    /// camera of its own 0.7 m away. The demonstrator sits at the table's +y side.
    pub fn cup_on_coaster(seed: u64, start: [f64; 3]) -> Self {
        let reference = pose_from_xyz_rpy([0.45, -0.22, 0.0], [0.0; 3]);
        let intrinsics =
            Intrinsics { width: 640, height: 480, fx: 610.0, fy: 610.0, cx: 319.5, cy: 239.5 };
        Self {
            seed,
            rate: 15.0,
            start: Stamp::from_secs(1000.0),
            moving_start: pose_from_xyz_rpy([start[0], start[1], 0.0], [0.0, 0.0, start[2]]),
            reference,
            moving_end: pose_from_xyz_rpy([0.45, -0.22, 0.008], [0.0, 0.0, 0.1]),
            motion: Motion::Placing,
            lift: 0.12,
            target: GraspTarget::mug(),
            camera: look_at(&Point3::new(1.04, -0.05, 0.58), &Point3::new(0.49, -0.05, 0.14)),
            sensor: SensorConfig { intrinsics, ..SensorConfig::lab() },
            backdrop: BackdropConfig::default(),
            shape: HandShape::default(),
            skin: Skin::default(),
            shoulder: [0.45, 0.75, 0.50],
            home: [-0.04, 0.07, 0.32],
        }
    }

    fn check(&self) -> Result<(), RecordError> {
        let bad = |field, reason: String| Err(RecordError::Value { field, reason });
        if !(self.rate > 0.0 && self.rate <= 120.0) {
            return bad("rate", format!("{} Hz is not between 0 and 120", self.rate));
        }
        if !(self.lift >= 0.02 && self.lift <= 0.4) {
            return bad("lift", format!("{} m is not between 0.02 and 0.4", self.lift));
        }
        for (field, pose) in [
            ("moving_start", &self.moving_start),
            ("moving_end", &self.moving_end),
            ("reference", &self.reference),
            ("camera", &self.camera),
        ] {
            let p = pose.translation.vector;
            if !p.iter().all(|v| v.is_finite() && v.abs() < 5.0) {
                return bad(field, format!("position {p:?} is not finite or beyond 5 m"));
            }
        }
        if let Motion::Script(script) = &self.motion {
            return script.problem().map_or(Ok(()), |reason| bad("motion", reason));
        }
        for (field, pose) in
            [("moving_start", &self.moving_start), ("moving_end", &self.moving_end)]
        {
            let up = pose.rotation * Vector3::z();
            if up.z < 0.999 {
                return bad(field, "is not upright: the hand grasps from above".into());
            }
        }
        Ok(())
    }
}

/// Ground truth of one frame; poses in base_link. For evaluation only.
#[derive(Debug, Clone, PartialEq)]
pub struct DemoTruth {
    /// The frame's stamp.
    pub stamp: Stamp,
    /// T_base_object by name.
    pub objects: BTreeMap<String, Pose>,
    /// The hand's 21 joints (m), OpenPose order.
    pub joints: [Point3<f64>; 21],
    /// Whether the hand holds the object.
    pub contact: bool,
    /// T_base_tcp that follows from the joints.
    pub tool: Option<Pose>,
}

/// What the camera delivers for one frame.
#[derive(Debug, Clone)]
pub struct DemoFrame {
    /// Its stamp.
    pub stamp: Stamp,
    /// Colour.
    pub color: RgbImage,
    /// Aligned depth with noise and holes.
    pub depth: DepthImage,
}

/// When each part of the motion begins and ends (s).
mod script {
    pub const REACH: [f64; 2] = [0.6, 1.8];
    pub const PREPARE: [f64; 2] = [0.7, 1.5];
    pub const DESCEND: [f64; 2] = [1.2, 2.6];
    pub const CLOSE: [f64; 2] = [2.6, 3.05];
    pub const LIFT: [f64; 2] = [3.2, 4.2];
    pub const CARRY: [f64; 2] = [3.8, 5.7];
    pub const LOWER: [f64; 2] = [5.3, 6.4];
    pub const OPEN: [f64; 2] = [6.55, 6.95];
    pub const RETREAT: [f64; 2] = [6.85, 7.65];
    pub const LEAVE: [f64; 2] = [7.2, 7.9];
    pub const END: f64 = 8.0;
}

const MOVING_ID: u16 = FIRST_FREE_ID;
const REFERENCE_ID: u16 = FIRST_FREE_ID + 1;
const HAND_ID: u16 = FIRST_FREE_ID + 2;

/// A demonstration ready to be rendered.
#[derive(Debug)]
pub struct Recorder {
    config: DemoConfig,
    grasp: GraspFit,
    moving: DemoObject,
    reference: DemoObject,
    others: Vec<(DemoObject, Pose)>,
    backdrop: Backdrop,
    sensor: RgbdSensor,
    exposure: SensorFrame,
}

impl Recorder {
    /// Fits the grasp and dresses the scene.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn new(
        config: DemoConfig,
        moving: DemoObject,
        reference: DemoObject,
    ) -> Result<Self, RecordError> {
        config.check()?;
        let grasp = fit_grasp(&config.shape, &config.target);
        check_grasp(&grasp, &config.target)?;
        let backdrop = Backdrop::generate(&config.backdrop, config.seed);
        let sensor = RgbdSensor::new(config.sensor.clone(), config.seed);
        let exposure = SensorFrame::default();
        let others = Vec::new();
        Ok(Self { config, grasp, moving, reference, others, backdrop, sensor, exposure })
    }

    /// With things that stand there and are not touched, and their poses.
    #[must_use]
    pub fn with_others(mut self, others: Vec<(DemoObject, Pose)>) -> Self {
        self.others = others;
        self
    }

    /// What is shown.
    pub fn config(&self) -> &DemoConfig {
        &self.config
    }

    /// The grasp used, in the object's frame.
    pub fn grasp(&self) -> &GraspFit {
        &self.grasp
    }

    /// How many frames there are.
    pub fn frames(&self) -> usize {
        let end = match &self.config.motion {
            Motion::Placing => script::END,
            Motion::Script(s) => s.duration(),
        };
        (end * self.config.rate).floor() as usize + 1
    }

    /// Ground truth of frame `index`, without rendering.
    pub fn truth(&self, index: usize) -> DemoTruth {
        let t = index as f64 / self.config.rate;
        let (hand, object, contact) = self.state(t);
        let joints = self.config.shape.joints(&hand);
        let mut objects = BTreeMap::from([
            (self.moving.name.clone(), object),
            (self.reference.name.clone(), self.config.reference),
        ]);
        objects.extend(self.others.iter().map(|(o, pose)| (o.name.clone(), *pose)));
        DemoTruth {
            stamp: self.config.start.plus(t),
            objects,
            joints,
            contact,
            tool: tool_from_hand(&joints),
        }
    }

    /// Renders frame `index` (0 .. [`Self::frames`]) through the sensor.
    pub fn frame(&mut self, index: usize) -> (DemoFrame, DemoTruth) {
        let truth = self.truth(index);
        let t = index as f64 / self.config.rate;
        let (hand, object, _) = self.state(t);
        let skin = self.config.skin.mesh(&self.config.shape, &hand, &self.elbow(&hand));
        let mut items = self.backdrop.items();
        items.push(SceneItem { mesh: &self.moving.mesh, pose: object, id: MOVING_ID });
        items.push(SceneItem {
            mesh: &self.reference.mesh,
            pose: self.config.reference,
            id: REFERENCE_ID,
        });
        items.push(SceneItem { mesh: &skin, pose: Pose::identity(), id: HAND_ID });
        for (k, (other, pose)) in self.others.iter().enumerate() {
            items.push(SceneItem { mesh: &other.mesh, pose: *pose, id: HAND_ID + 1 + k as u16 });
        }
        self.sensor.capture(
            &self.config.camera,
            &items,
            &self.backdrop.lighting,
            index as u64,
            &mut self.exposure,
        );
        let frame = DemoFrame {
            stamp: truth.stamp,
            color: self.exposure.color.clone(),
            depth: self.exposure.depth.clone(),
        };
        (frame, truth)
    }

    /// Hand, object pose and contact at time `t` (s).
    fn state(&self, t: f64) -> (HandPose, Pose, bool) {
        use script::{CARRY, CLOSE, DESCEND, LEAVE, LIFT, LOWER, OPEN, PREPARE, REACH, RETREAT};
        let c = &self.config;
        if let Motion::Script(script) = &c.motion {
            return script.state(t, &c.moving_start, &self.grasp, self.sway(t));
        }
        let contact = (CLOSE[1]..OPEN[0]).contains(&t);
        // The frame that the object has while it is held, and that the hand follows throughout.
        let carried = channel(t, CARRY);
        let (from, to) = (c.moving_start.translation.vector, c.moving_end.translation.vector);
        let up = channel(t, LIFT) - channel(t, LOWER);
        let height = from.z + (to.z - from.z) * channel(t, LOWER) + c.lift * up;
        let along = from + (to - from) * carried;
        let turn = yaw_of(&c.moving_end.rotation) - yaw_of(&c.moving_start.rotation);
        let turn = turn.sin().atan2(turn.cos());
        let yaw = yaw_of(&c.moving_start.rotation) + turn * carried;
        // A human neither holds still nor keeps a cup level; both fade where it stands.
        let sway = self.sway(t);
        let lean = 0.09 * (std::f64::consts::PI * carried).sin();
        let across = (to - from).cross(&Vector3::z()).try_normalize(1e-6);
        let tilt = across.map_or_else(UnitQuaternion::identity, |axis| {
            UnitQuaternion::from_scaled_axis((axis * -lean + sway.1) * up)
        });
        let held = Pose::from_parts(
            Translation3::new(along.x + sway.0.x * up, along.y + sway.0.y * up, height),
            tilt * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
        );
        let object = if t < CLOSE[1] {
            c.moving_start
        } else if t < OPEN[0] {
            held
        } else {
            c.moving_end
        };
        // The hand: home, over the object, round it, with it, off it, away.
        let near = channel(t, REACH) - channel(t, LEAVE);
        let low = channel(t, DESCEND) - channel(t, RETREAT);
        let bend = channel(t, CLOSE) - channel(t, OPEN);
        let ready = channel(t, PREPARE) - channel(t, LEAVE);
        let mut hand = HandPose::relaxed(Pose::identity())
            .blend(&self.grasp.open, ready)
            .blend(&self.grasp.closed, bend);
        let palm = held * self.grasp.closed.palm;
        let home = Vector3::from(c.home);
        let wrist = palm.translation.vector;
        let base = held.translation.vector;
        // Home hangs at the same place relative to the object's current resting place.
        let away = base + home + sway.0;
        let mut position = away + (wrist - away) * near;
        position.z = away.z + (wrist.z - away.z) * low;
        // At home the hand is turned and tilted as a resting arm would have it.
        let rest = UnitQuaternion::from_scaled_axis(Vector3::new(0.35, 0.1, 0.25) * (1.0 - near));
        hand.palm = Pose::from_parts(Translation3::from(position), rest * palm.rotation);
        (hand, object, contact)
    }

    /// Small slow motions of the hand: metres and radians, from the seed.
    fn sway(&self, t: f64) -> (Vector3<f64>, Vector3<f64>) {
        let phase = |k: u32| {
            f64::from(crate::sensor::noise::unit(crate::sensor::noise::key(
                self.config.seed,
                0,
                100 + k,
            ))) * std::f64::consts::TAU
        };
        let wave = |k: u32| {
            0.7 * (t * 4.1 + phase(k)).sin()
                + 0.3 * (t * (9.0 + 0.7 * f64::from(k)) + phase(k + 9)).sin()
        };
        (
            Vector3::new(wave(0), wave(1), wave(2)) * 1.2e-3,
            Vector3::new(wave(3), wave(4), 0.0) * 8e-3,
        )
    }

    /// Where the elbow is: from the wrist towards the shoulder, raised.
    fn elbow(&self, hand: &HandPose) -> Point3<f64> {
        let wrist = Point3::from(hand.palm.translation.vector);
        let shoulder = Point3::from(self.config.shoulder);
        let towards = (shoulder - wrist).try_normalize(1e-6).unwrap_or_else(Vector3::y);
        wrist + (towards + Vector3::z() * 0.55).normalize() * self.config.skin.forearm
    }
}

/// Refuses a grasp that does not close round the body's axis with touching fingertips.
fn check_grasp(grasp: &GraspFit, target: &GraspTarget) -> Result<(), RecordError> {
    let worst = grasp.gaps.iter().map(|g| g.abs()).fold(0.0, f64::max);
    let aside = grasp.tool.translation.vector.xy().norm();
    if worst < 4e-3 && grasp.intrusion < 4e-3 && aside < 0.015 {
        return Ok(());
    }
    Err(RecordError::NoGrasp {
        radius_mm: target.radius * 1e3,
        height_mm: target.height * 1e3,
        reason: format!(
            "a fingertip is {:.1} mm off, bones go {:.1} mm in, the grip's middle is {:.1} mm \
             beside the axis",
            worst * 1e3,
            grasp.intrusion * 1e3,
            aside * 1e3
        ),
    })
}

/// 0 before the span, 1 after it, minimum jerk between.
fn channel(t: f64, span: [f64; 2]) -> f64 {
    smooth_step((t - span[0]) / (span[1] - span[0]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_rendering::mesh::primitives::{MugSize, disc, mug};

    fn recorder(seed: u64) -> Recorder {
        let moving = DemoObject {
            name: "mug".into(),
            mesh: mug(&MugSize::default(), 48, [38, 84, 168], [228, 222, 208]),
        };
        let reference =
            DemoObject { name: "coaster".into(), mesh: disc(0.05, 0.008, 64, [158, 72, 48]) };
        let config = DemoConfig::cup_on_coaster(seed, [0.55, 0.10, 0.2]);
        Recorder::new(config, moving, reference).unwrap()
    }

    #[test]
    fn the_object_is_taken_carried_and_put_down_smoothly() {
        let r = recorder(1);
        let all: Vec<DemoTruth> = (0..r.frames()).map(|k| r.truth(k)).collect();
        assert!((110..130).contains(&all.len()));
        let mug: Vec<Pose> = all.iter().map(|f| f.objects["mug"]).collect();
        let first = all.iter().position(|f| f.contact).unwrap();
        let last = all.iter().rposition(|f| f.contact).unwrap();
        assert!(all[first..=last].iter().all(|f| f.contact));
        // At rest before and after, at the two given poses.
        assert!(mug[..first].iter().all(|p| *p == r.config.moving_start));
        assert!(mug[last + 1..].iter().all(|p| *p == r.config.moving_end));
        assert!((mug[last].translation.vector - mug[last + 1].translation.vector).norm() < 1e-6);
        let top = mug.iter().map(|p| p.translation.z).fold(0.0, f64::max);
        assert!((0.115..0.13).contains(&top), "{top}");
        for pair in mug.windows(2) {
            let step = (pair[1].translation.vector - pair[0].translation.vector).norm();
            assert!(step * r.config.rate < 0.45, "{} m/s", step * r.config.rate);
        }
        // While held, the object does not move in the hand.
        let held: Vec<Vector3<f64>> =
            (first..=last).map(|k| (mug[k].inverse() * all[k].joints[0]).coords).collect();
        for h in &held {
            assert!((h - held[0]).norm() < 3e-3, "{}", (h - held[0]).norm());
        }
    }

    #[test]
    fn the_hand_does_not_go_through_the_mug_or_the_table() {
        let r = recorder(2);
        for k in 0..r.frames() {
            let f = r.truth(k);
            let into = f.objects["mug"].inverse();
            for (i, j) in f.joints.iter().enumerate() {
                let gap = r.config.target.distance(&(into * j));
                assert!(gap > 0.004, "frame {k} joint {i}: {:.1} mm", gap * 1e3);
                assert!(j.z > 0.004, "frame {k} joint {i} at z {:.1} mm", j.z * 1e3);
            }
        }
    }

    #[test]
    fn joints_and_objects_stay_in_view() {
        let r = recorder(3);
        let camera = r.config.sensor.intrinsics;
        for k in 0..r.frames() {
            let f = r.truth(k);
            let t = r.config.camera.inverse();
            for (i, j) in f.joints.iter().enumerate() {
                let (u, v) = camera.project(&(t * j)).unwrap();
                assert!(camera.contains(u, v), "frame {k} joint {i} at ({u:.0}, {v:.0})");
            }
        }
    }

    #[test]
    fn frames_are_reproducible_and_show_hand_and_objects() {
        let (mut a, mut b) = (recorder(4), recorder(4));
        let ((fa, ta), (fb, tb)) = (a.frame(45), b.frame(45));
        assert_eq!(ta, tb);
        assert_eq!(fa.color, fb.color);
        assert_eq!(fa.depth, fb.depth);
        for id in [MOVING_ID, REFERENCE_ID, HAND_ID] {
            assert!(a.exposure.ids.iter().filter(|i| **i == id).count() > 300, "id {id}");
        }
    }

    #[test]
    fn impossible_scripts_are_refused() {
        let object = || DemoObject { name: "x".into(), mesh: Mesh::default() };
        let with = |change: &dyn Fn(&mut DemoConfig)| {
            let mut config = DemoConfig::cup_on_coaster(1, [0.5, 0.1, 0.0]);
            change(&mut config);
            Recorder::new(config, object(), object()).map(|_| ()).unwrap_err().to_string()
        };
        assert!(with(&|c| c.rate = 0.0).contains("rate"));
        assert!(with(&|c| c.lift = f64::NAN).contains("lift"));
        let tilted = pose_from_xyz_rpy([0.5, 0.0, 0.0], [0.4, 0.0, 0.0]);
        assert!(with(&|c| c.moving_start = tilted).contains("upright"));
        assert!(with(&|c| c.target.radius = 0.09).contains("90 mm radius"));
    }
}
