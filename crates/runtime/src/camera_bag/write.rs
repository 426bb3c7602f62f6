use super::{CAMERA_FRAME, COLOR_TOPIC, CameraBagError, DEPTH_TOPIC, INFO_TOPIC};
use crate::{convert, tracked};
use serde::Serialize;
use std::path::{Path, PathBuf};
use tdv_bag::{BagWriter, Durability, Topic, TopicId};
use tdv_geometry::{Pose, Stamp};
use tdv_msgs::geometry_msgs::msg::Point;
use tdv_msgs::sensor_msgs::msg::{CameraInfo, CompressedImage};
use tdv_msgs::tdv_msgs::msg::{HandJoints, TrackedObject, TrackedObjects};
use tdv_msgs::tf2_msgs::msg::TFMessage;
use tdv_msgs::{RosMessage, to_cdr_bytes};
use tdv_rendering::{DepthImage, Intrinsics, RgbImage};

fn topic<M: RosMessage>(name: &str, durability: Durability) -> Topic {
    Topic {
        name: name.into(),
        type_name: M::FULL_NAME.into(),
        schema: M::schema().into(),
        durability,
    }
}

fn write<M: Serialize>(
    writer: &mut BagWriter,
    id: TopicId,
    name: &str,
    stamp: Stamp,
    message: &M,
) -> Result<(), CameraBagError> {
    let data = to_cdr_bytes(message)
        .map_err(|source| CameraBagError::Message { topic: name.into(), source })?;
    Ok(writer.write(id, stamp, stamp, &data)?)
}

/// Writes an RGB-D recording: JPEG colour, compressed depth, `camera_info`, `/tf_static`.
pub struct CameraBagWriter {
    writer: BagWriter,
    intrinsics: Intrinsics,
    t_base_camera: Pose,
    quality: u8,
    ids: [TopicId; 4],
    begun: bool,
}

impl CameraBagWriter {
    /// Starts a bag. `quality` is that of the JPEG images, 1 to 100.
    ///
    /// # Errors
    /// [`CameraBagError::Bag`].
    pub fn create(
        path: &Path,
        intrinsics: Intrinsics,
        t_base_camera: Pose,
        quality: u8,
    ) -> Result<Self, CameraBagError> {
        let mut writer = BagWriter::create(path)?;
        let v = Durability::Volatile;
        let ids = [
            writer.add_topic(topic::<TFMessage>("/tf_static", Durability::TransientLocal))?,
            writer.add_topic(topic::<CameraInfo>(INFO_TOPIC, v))?,
            writer.add_topic(topic::<CompressedImage>(COLOR_TOPIC, v))?,
            writer.add_topic(topic::<CompressedImage>(DEPTH_TOPIC, v))?,
        ];
        Ok(Self { writer, intrinsics, t_base_camera, quality, ids, begun: false })
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// [`CameraBagError`].
    pub fn frame(
        &mut self,
        stamp: Stamp,
        color: &RgbImage,
        depth: &DepthImage,
    ) -> Result<(), CameraBagError> {
        let header = convert::header(stamp, CAMERA_FRAME);
        let [tf, info, color_id, depth_id] = self.ids;
        let w = &mut self.writer;
        if !self.begun {
            self.begun = true;
            let t = tracked::transform("base_link", CAMERA_FRAME, stamp, &self.t_base_camera);
            write(w, tf, "/tf_static", stamp, &TFMessage { transforms: vec![t] })?;
        }
        let message = convert::info_from_intrinsics(&self.intrinsics, header.clone());
        write(w, info, INFO_TOPIC, stamp, &message)?;
        let message = convert::compressed_from_color(color, header.clone(), self.quality);
        write(w, color_id, COLOR_TOPIC, stamp, &message)?;
        let message = convert::compressed_from_depth(depth, header);
        write(w, depth_id, DEPTH_TOPIC, stamp, &message)
    }

    /// Ends the bag.
    ///
    /// # Errors
    /// [`CameraBagError::Bag`].
    pub fn finish(self) -> Result<PathBuf, CameraBagError> {
        Ok(self.writer.finish()?)
    }
}

/// Writes poses and hand joints, for the ground truth of a recording.
pub struct PosesBagWriter {
    writer: BagWriter,
    ids: [TopicId; 2],
}

const OBJECTS_TOPIC: &str = "/virtual_lab/ground_truth/objects";
const HAND_TOPIC: &str = "/virtual_lab/ground_truth/hand_joints";

impl PosesBagWriter {
    /// Starts a bag.
    ///
    /// # Errors
    /// [`CameraBagError::Bag`].
    pub fn create(path: &Path) -> Result<Self, CameraBagError> {
        let mut writer = BagWriter::create(path)?;
        let v = Durability::Volatile;
        let ids = [
            writer.add_topic(topic::<TrackedObjects>(OBJECTS_TOPIC, v))?,
            writer.add_topic(topic::<HandJoints>(HAND_TOPIC, v))?,
        ];
        Ok(Self { writer, ids })
    }

    /// Appends the true poses (base_link) of one frame and, if there is a hand, its joints.
    ///
    /// # Errors
    /// [`CameraBagError`].
    pub fn frame(
        &mut self,
        stamp: Stamp,
        objects: &[(&str, Pose)],
        hand: Option<&[tdv_geometry::nalgebra::Point3<f64>]>,
    ) -> Result<(), CameraBagError> {
        let objects = objects
            .iter()
            .map(|(name, pose)| {
                let mut o = TrackedObject {
                    name: (*name).into(),
                    state: TrackedObject::TRACKING,
                    confidence: 1.0,
                    ..Default::default()
                };
                o.pose.pose = tracked::pose_message(pose);
                o
            })
            .collect();
        let header = tracked::header(stamp);
        let message = TrackedObjects { header: header.clone(), objects };
        write(&mut self.writer, self.ids[0], OBJECTS_TOPIC, stamp, &message)?;
        if let Some(joints) = hand {
            let joints = joints.iter().map(|p| Point { x: p.x, y: p.y, z: p.z }).collect();
            let message = HandJoints { header, handedness: "right".into(), score: 1.0, joints };
            write(&mut self.writer, self.ids[1], HAND_TOPIC, stamp, &message)?;
        }
        Ok(())
    }

    /// Ends the bag.
    ///
    /// # Errors
    /// [`CameraBagError::Bag`].
    pub fn finish(self) -> Result<PathBuf, CameraBagError> {
        Ok(self.writer.finish()?)
    }
}
