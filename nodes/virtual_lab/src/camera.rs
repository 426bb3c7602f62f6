//! The camera's thread: snapshots of the lab in, images out.

use std::sync::Arc;
use tdv_geometry::{Pose, Stamp};
use tdv_msgs::sensor_msgs::msg::{CameraInfo, Image};
use tdv_runtime::{Node, Publisher, Qos, convert};
use tdv_simulation::LabAssets;
use tdv_simulation::backdrop::{Backdrop, BackdropConfig};
use tdv_simulation::scene::Knowledge;
use tdv_simulation::sensor::{RgbdSensor, SceneItem, SensorFrame};

/// Frame of the images.
pub const FRAME: &str = "camera_color_optical_frame";

/// What is to be seen at one instant.
pub struct Snapshot {
    pub stamp: Stamp,
    pub number: u64,
    /// In the order of [`LabAssets::instances`].
    pub poses: Vec<Pose>,
}

/// Renders and publishes.
pub struct Camera {
    assets: Arc<LabAssets>,
    backdrop: Backdrop,
    sensor: RgbdSensor,
    pose: Pose,
    frame: SensorFrame,
    claimed: tdv_rendering::Intrinsics,
    color: Publisher<Image>,
    depth: Publisher<Image>,
    info: [Publisher<CameraInfo>; 2],
}

impl Camera {
    pub fn new(
        node: &Node,
        assets: Arc<LabAssets>,
        knowledge: &Knowledge,
        seed: u64,
    ) -> anyhow::Result<Self> {
        let qos = Qos::reliable(2);
        let scene = &assets.scene;
        let config = BackdropConfig {
            distractors: scene.distractors,
            table_top: scene.table_top,
            ..BackdropConfig::default()
        };
        let backdrop = Backdrop::generate(&config, seed);
        let mut sensor = RgbdSensor::new(assets.scene.camera.sensor(), seed);
        sensor.keep_still(backdrop.items().len());
        Ok(Self {
            backdrop,
            sensor,
            pose: assets.scene.camera.pose(),
            frame: SensorFrame::default(),
            claimed: knowledge.intrinsics,
            color: node.publisher("/camera/camera/color/image_raw", qos)?,
            depth: node.publisher("/camera/camera/aligned_depth_to_color/image_raw", qos)?,
            info: [
                node.publisher("/camera/camera/color/camera_info", qos)?,
                node.publisher("/camera/camera/aligned_depth_to_color/camera_info", qos)?,
            ],
            assets,
        })
    }

    pub fn publish(&mut self, snapshot: &Snapshot) {
        let mut items: Vec<SceneItem> = self.backdrop.items();
        items.extend(self.assets.instances(&snapshot.poses).into_iter().map(|i| SceneItem {
            mesh: i.mesh,
            pose: i.pose,
            id: i.id,
        }));
        let light = &self.backdrop.lighting;
        let header = convert::header(snapshot.stamp, FRAME);
        for info in &self.info {
            info.publish(convert::info_from_intrinsics(&self.claimed, header.clone()));
        }
        let (color, colored) = (&self.color, header.clone());
        let number = snapshot.number;
        self.sensor.capture_in_turn(&self.pose, &items, light, number, &mut self.frame, |image| {
            color.publish(convert::image_from_color(image, colored));
        });
        self.depth.publish(convert::image_from_depth(&self.frame.depth, header));
    }
}
