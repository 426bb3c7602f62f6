//! The pose tracker's core, without pixels: one state per object from detections in the camera frame,
//! the tool's pose and whether the gripper holds something.

mod attach;
mod history;
mod levelling;
mod track;

pub use attach::{AttachConfig, Attachment};
pub use history::TcpHistory;
pub use levelling::{Levelling, LevellingConfig};
pub use track::ObjectState;

use crate::perceiver::Detection;
use nalgebra::{Matrix6, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use tdv_geometry::{Pose, Stamp, Symmetry};
use track::{Observation, Track};

/// Settings of the state machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ObjectsConfig {
    /// Confidence from which a detection is believed.
    pub accept: f64,
    /// Confidence below which a tracked object is no longer believed (less than `accept`: hysteresis).
    pub reject: f64,
    /// Consistent detections that end INIT.
    pub init_frames: u32,
    /// Seconds without a believed detection until TRACKING becomes OCCLUDED.
    pub occluded_after: f64,
    /// Seconds without one until OCCLUDED becomes LOST. The arm may hide an object for a whole carry, and
    /// what stands on the table stays where it is meanwhile.
    pub lost_after: f64,
    /// Jump (m) and turn (rad) between frames that must be confirmed by `init_frames` detections.
    pub jump: f64,
    /// See `jump`.
    pub turn: f64,
    /// Least part of a new pose that is taken in (light filter); large changes pass unfiltered.
    pub smoothing: f64,
    /// Measuring the grasp.
    pub attach: AttachConfig,
    /// Correction of the camera's pose.
    pub levelling: LevellingConfig,
}

impl Default for ObjectsConfig {
    fn default() -> Self {
        Self {
            accept: 0.5,
            reject: 0.35,
            init_frames: 3,
            occluded_after: 0.1,
            lost_after: 8.0,
            jump: 0.08,
            turn: 0.7,
            smoothing: 0.25,
            attach: AttachConfig::default(),
            levelling: LevellingConfig::default(),
        }
    }
}

/// An object of the task.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectSpec {
    /// Catalogue name.
    pub name: String,
    /// Its symmetry.
    pub symmetry: Symmetry,
}

/// Which objects there are and what they are to each other.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TaskObjects {
    /// All objects.
    pub objects: Vec<ObjectSpec>,
    /// Name of the object relative to which poses are given.
    pub reference: String,
    /// Name of the object the gripper holds when it holds something.
    pub moving: String,
}

/// What a frame brings.
#[derive(Debug, Clone)]
pub struct ObjectsInput<'a> {
    /// Stamp of the image.
    pub stamp: Stamp,
    /// Detections of that image (camera frame).
    pub detections: &'a [Detection],
    /// `T_camera_table` seen in that image.
    pub table: Option<Pose>,
    /// Nominal camera pose.
    pub t_base_camera: Pose,
    /// Whether the gripper holds the moving object.
    pub object_held: bool,
}

/// One object after a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectEstimate {
    /// Catalogue name.
    pub name: String,
    /// Its state.
    pub state: ObjectState,
    /// `T_base_object`; `None` until the first pose.
    pub pose: Option<Pose>,
    /// `T_reference_object`; `None` until both poses are known.
    pub relative: Option<Pose>,
    /// 0..1; 0 when LOST or INIT without a pose.
    pub confidence: f64,
    /// Covariance in base axes: xyz (m^2), rotation (rad^2).
    pub covariance: Matrix6<f64>,
    /// A sentence for the operator where the state alone does not say it; else empty.
    pub note: String,
}

/// All objects after a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectsOutput {
    /// Stamp of the image it derives from.
    pub stamp: Stamp,
    /// In the order of [`TaskObjects::objects`].
    pub objects: Vec<ObjectEstimate>,
    /// `T_base_tcp` at the stamp, if known.
    pub tcp: Option<Pose>,
    /// `T_reference_tcp`.
    pub tcp_relative: Option<Pose>,
    /// `T_base_camera` after levelling.
    pub t_base_camera: Pose,
}

/// State of all objects of a task.
#[derive(Debug, Clone)]
pub struct Objects {
    config: ObjectsConfig,
    task: TaskObjects,
    tracks: Vec<Track>,
    tcp: TcpHistory,
    levelling: Levelling,
    attachment: Option<Attachment>,
    /// The held object slipped out: perception is believed until the gripper opens.
    slipped: bool,
}

impl Objects {
    /// Nothing seen yet.
    pub fn new(config: ObjectsConfig, task: TaskObjects) -> Self {
        let tracks = task.objects.iter().map(|_| Track::default()).collect();
        let levelling = Levelling::new(config.levelling);
        Self {
            config,
            task,
            tracks,
            tcp: TcpHistory::default(),
            levelling,
            attachment: None,
            slipped: false,
        }
    }

    /// A pose of the tool centre point, `T_base_tcp`.
    pub fn push_tcp(&mut self, stamp: Stamp, pose: Pose) {
        self.tcp.push(stamp, pose);
    }

    /// The tool's recent poses.
    pub fn tcp(&self) -> &TcpHistory {
        &self.tcp
    }

    /// The levelling as it stands.
    pub fn levelling(&self) -> &Levelling {
        &self.levelling
    }

    /// `T_tcp_object` while the moving object is held and it has been measured.
    pub fn t_attach(&self) -> Option<Pose> {
        self.attachment.as_ref().and_then(Attachment::pose)
    }

    /// Which object the gripper holds when it holds something; empty: none of these.
    pub fn set_moving(&mut self, name: &str) {
        if self.task.moving == name {
            return;
        }
        self.attachment = None;
        self.slipped = false;
        self.task.moving = name.to_owned();
    }

    /// Forgets an object (all for an empty name). False when no object has this name.
    pub fn reset(&mut self, name: &str) -> bool {
        let mut any = false;
        for (spec, track) in self.task.objects.iter().zip(&mut self.tracks) {
            if name.is_empty() || spec.name == name {
                *track = Track::default();
                any = true;
            }
        }
        if any && (name.is_empty() || name == self.task.moving) {
            self.attachment = None;
            self.slipped = false;
        }
        any
    }

    /// Processes the detections of one frame.
    pub fn step(&mut self, input: &ObjectsInput<'_>) -> ObjectsOutput {
        if let Some(table) = &input.table {
            self.levelling.observe(&input.t_base_camera, table);
        }
        let camera = self.levelling.correct(&input.t_base_camera);
        let tcp = self.tcp.at(input.stamp);
        if !input.object_held {
            if self.attachment.take().is_some()
                && let Some(i) = self.index(&self.task.moving)
            {
                self.tracks[i].release(input.stamp);
            }
            self.slipped = false;
        }
        for i in 0..self.tracks.len() {
            let spec = &self.task.objects[i];
            let seen = input
                .detections
                .iter()
                .find(|d| d.name == spec.name && d.found && finite(&d.pose))
                .map(|d| Observation {
                    pose: canonical(
                        spec,
                        &(camera * d.pose),
                        self.tracks[i].pose().as_ref(),
                        spec.name == self.task.reference,
                    ),
                    confidence: d.confidence,
                    covariance: rotated(&d.covariance, &camera.rotation),
                });
            let held = input.object_held && spec.name == self.task.moving && !self.slipped;
            if held {
                self.hold(i, input.stamp, seen.as_ref(), tcp.as_ref());
            } else {
                self.tracks[i].observe(input.stamp, seen.as_ref(), &self.config);
            }
        }
        self.output(input.stamp, tcp, camera)
    }

    fn index(&self, name: &str) -> Option<usize> {
        self.task.objects.iter().position(|o| o.name == name)
    }

    fn hold(&mut self, i: usize, stamp: Stamp, seen: Option<&Observation>, tcp: Option<&Pose>) {
        let Some(tcp) = tcp else {
            // Without the tool's pose there is nothing to carry it on with.
            self.tracks[i].observe(stamp, seen, &self.config);
            self.tracks[i].note = "held, but the tool pose is missing".into();
            return;
        };
        if self.attachment.is_none() {
            // Where the object was when the gripper closed is the first guess.
            let guess = self.tracks[i].pose().map(|p| tcp.inverse() * p);
            self.attachment = Some(Attachment::new(self.config.attach, guess));
        }
        let Some(attachment) = &mut self.attachment else { return };
        let believed = seen.filter(|s| s.confidence >= self.config.accept);
        let symmetry = &self.task.objects[i].symmetry;
        if let Some(s) = believed {
            attachment.observe(stamp, tcp, &s.pose, symmetry);
        }
        if attachment.slipped() {
            self.attachment = None;
            self.slipped = true;
            self.tracks[i].release(stamp);
            self.tracks[i].observe(stamp, seen, &self.config);
            self.tracks[i].note = "slipped out of the gripper".into();
            return;
        }
        match attachment.pose() {
            Some(t) => self.tracks[i].hold(stamp, &(tcp * t), believed),
            None => {
                self.tracks[i].observe(stamp, seen, &self.config);
                self.tracks[i].note = "held, but never seen: grasp not measured".into();
            }
        }
    }

    fn output(&self, stamp: Stamp, tcp: Option<Pose>, camera: Pose) -> ObjectsOutput {
        let reference = self
            .index(&self.task.reference)
            .and_then(|i| self.tracks[i].pose())
            .map(|p| p.inverse());
        let objects = self
            .task
            .objects
            .iter()
            .zip(&self.tracks)
            .map(|(spec, t)| {
                let pose = t.pose();
                ObjectEstimate {
                    name: spec.name.clone(),
                    state: t.state,
                    pose,
                    relative: pose.and_then(|p| reference.map(|r| r * p)),
                    confidence: t.confidence(),
                    covariance: t.covariance,
                    note: t.note.clone(),
                }
            })
            .collect();
        ObjectsOutput {
            stamp,
            objects,
            tcp,
            tcp_relative: tcp.and_then(|t| reference.map(|r| r * t)),
            t_base_camera: camera,
        }
    }
}

fn finite(p: &Pose) -> bool {
    p.translation.vector.iter().chain(p.rotation.coords.iter()).all(|v| v.is_finite())
}

/// One of the equivalent orientations, the same in every frame and every run: a round reference stands
/// with its axis where it is seen and its yaw at zero of the base; other symmetric objects keep
/// the orientation nearest to their last one (at first: nearest to the base's axes).
fn canonical(spec: &ObjectSpec, pose: &Pose, last: Option<&Pose>, reference: bool) -> Pose {
    let target = match (&spec.symmetry, last) {
        (Symmetry::None, _) => return *pose,
        (Symmetry::Continuous { axis }, _) if reference => {
            // The upright orientation that differs from the base only by what the axis demands.
            let axis = pose.rotation * Vector3::from(*axis);
            let own = Vector3::from(match &spec.symmetry {
                Symmetry::Continuous { axis } => *axis,
                _ => [0.0, 0.0, 1.0],
            });
            UnitQuaternion::rotation_between(&own, &axis).unwrap_or(pose.rotation)
        }
        (_, Some(last)) => last.rotation,
        (_, None) => UnitQuaternion::identity(),
    };
    spec.symmetry.nearest(pose, &target)
}

/// A covariance (xyz, rotation) turned from camera to base axes.
fn rotated(c: &Matrix6<f64>, r: &UnitQuaternion<f64>) -> Matrix6<f64> {
    let m = r.to_rotation_matrix();
    let mut a = Matrix6::zeros();
    a.fixed_view_mut::<3, 3>(0, 0).copy_from(m.matrix());
    a.fixed_view_mut::<3, 3>(3, 3).copy_from(m.matrix());
    a * c * a.transpose()
}

#[cfg(test)]
mod tests;
