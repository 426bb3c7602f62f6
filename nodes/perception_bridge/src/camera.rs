//! Images as the perception chain wants them: without distortion, depth aligned to colour.

use std::sync::{Arc, Mutex, PoisonError};
use tdv_geometry::{FrameError, FrameTree, Pose, Stamp};
use tdv_msgs::sensor_msgs::msg::CameraInfo;
use tdv_msgs::tf2_msgs::msg::TFMessage;
use tdv_rendering::{
    AlignError, DepthAligner, DepthImage, Intrinsics, Lens, RgbImage, Undistorter,
};
use tdv_runtime::convert::{self, ConvertError};
use tdv_runtime::tracked;

/// Why images are not usable yet, or at all.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// Nobody has said what the camera is like.
    #[error("no {0} yet")]
    NoInfo(String),
    /// The calibration itself.
    #[error(transparent)]
    Convert(#[from] ConvertError),
    /// The depth camera's place is not known.
    #[error("/tf_static: where is the depth camera? {0}")]
    Place(#[from] FrameError),
    /// A depth image of another camera.
    #[error(transparent)]
    Align(#[from] AlignError),
}

/// Frames known from `/tf_static`, shared with whoever listens.
pub type Frames = Arc<Mutex<FrameTree>>;

/// Learns the fixed frames of a message; what is no pose is skipped with a word.
pub fn learn(frames: &Frames, message: &TFMessage) {
    let mut tree = frames.lock().unwrap_or_else(PoisonError::into_inner);
    for t in &message.transforms {
        let fixed = tracked::transform_pose(t).map_err(|e| e.to_string()).and_then(|pose| {
            tree.fix(&t.header.frame_id, &t.child_frame_id, pose).map_err(|e| e.to_string())
        });
        if let Err(why) = fixed {
            tracing::warn!("/tf_static: {}: {why}", t.child_frame_id);
        }
    }
}

/// One camera_info, understood.
#[derive(Debug, Clone, PartialEq)]
struct Calibration {
    frame: String,
    intrinsics: Intrinsics,
    lens: Lens,
}

impl Calibration {
    fn new(topic: &str, info: &CameraInfo) -> Result<Self, ConvertError> {
        let intrinsics = convert::intrinsics_from_info(topic, info)?;
        let lens = convert::lens_from_info(topic, info)?;
        Ok(Self { frame: info.header.frame_id.clone(), intrinsics, lens })
    }
}

/// Both cameras; what can be computed once is kept until a calibration changes.
pub struct Camera {
    color_topic: String,
    /// Empty when the depth images are aligned already.
    depth_topic: String,
    frames: Frames,
    color: Option<Calibration>,
    depth: Option<Calibration>,
    undistorter: Option<Undistorter>,
    aligner: Option<(Pose, DepthAligner)>,
}

impl Camera {
    /// `color_topic` and `depth_topic` are those of the two camera_infos.
    pub fn new(color_topic: &str, depth_topic: &str, frames: Frames) -> Self {
        Self {
            color_topic: color_topic.into(),
            depth_topic: depth_topic.into(),
            frames,
            color: None,
            depth: None,
            undistorter: None,
            aligner: None,
        }
    }

    /// Takes the colour camera's calibration.
    pub fn color_info(&mut self, info: &CameraInfo) -> Result<(), CameraError> {
        let new = Calibration::new(&self.color_topic, info)?;
        if self.color.as_ref() != Some(&new) {
            let bends = new.lens != Lens::None;
            self.undistorter = bends.then(|| Undistorter::new(new.intrinsics, new.lens));
            self.color = Some(new);
            self.aligner = None;
        }
        Ok(())
    }

    /// Takes the depth camera's calibration.
    pub fn depth_info(&mut self, info: &CameraInfo) -> Result<(), CameraError> {
        let new = Calibration::new(&self.depth_topic, info)?;
        if self.depth.as_ref() != Some(&new) {
            self.depth = Some(new);
            self.aligner = None;
        }
        Ok(())
    }

    /// Whether a frame could be made now; false asks for patience, not for another frame.
    pub fn is_known(&self) -> Result<(), CameraError> {
        let missing = |topic: &str| Err(CameraError::NoInfo(topic.into()));
        if self.color.is_none() {
            return missing(&self.color_topic);
        }
        if !self.depth_topic.is_empty() && self.depth.is_none() {
            return missing(&self.depth_topic);
        }
        self.place().map(|_| ())
    }

    /// `T_color_depth`; the identity for aligned images.
    fn place(&self) -> Result<Pose, CameraError> {
        match (&self.color, &self.depth) {
            (Some(color), Some(depth)) if color.frame != depth.frame => {
                let tree = self.frames.lock().unwrap_or_else(PoisonError::into_inner);
                Ok(tree.lookup(&color.frame, &depth.frame, Stamp(0))?)
            }
            _ => Ok(Pose::identity()),
        }
    }

    /// The pair as one pinhole camera sees it, with that camera.
    pub fn pair(
        &mut self,
        color: RgbImage,
        depth: DepthImage,
    ) -> Result<(RgbImage, DepthImage, Intrinsics), CameraError> {
        self.is_known()?;
        let Some(intrinsics) = self.color.as_ref().map(|c| c.intrinsics) else {
            return Err(CameraError::NoInfo(self.color_topic.clone()));
        };
        let depth = match &self.depth {
            // A depth camera of its own: moved to the colour camera behind its lens.
            Some(camera) => {
                let place = self.place()?;
                let stale = self.aligner.as_ref().is_none_or(|(old, _)| *old != place);
                if stale {
                    let new = DepthAligner::new(camera.intrinsics, &camera.lens, place, intrinsics);
                    self.aligner = Some((place, new));
                }
                match &self.aligner {
                    Some((_, aligner)) => aligner.align(&depth)?,
                    None => depth,
                }
            }
            // Aligned to the raw colour image: bent as that one is.
            None => self.undistorter.as_ref().map(|u| u.depth(&depth)).unwrap_or(depth),
        };
        let color = self.undistorter.as_ref().map(|u| u.color(&color)).unwrap_or(color);
        Ok((color, depth, intrinsics))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_from_xyz_rpy;
    use tdv_msgs::std_msgs::msg::Header;

    fn info(width: u32, height: u32, focal: f64, frame: &str) -> CameraInfo {
        let (cx, cy) = (f64::from(width) / 2.0, f64::from(height) / 2.0);
        let k = Intrinsics { width, height, fx: focal, fy: focal, cx, cy };
        convert::info_from_intrinsics(&k, Header { frame_id: frame.into(), ..Default::default() })
    }

    #[test]
    fn aligned_images_pass_and_a_bent_lens_is_straightened() {
        let mut camera = Camera::new("/info", "", Frames::default());
        let (color, depth) = (RgbImage::new(64, 48), DepthImage::new(64, 48));
        let e = camera.pair(color.clone(), depth.clone()).expect_err("no info");
        assert!(e.to_string().contains("/info"), "{e}");
        let mut i = info(64, 48, 60.0, "color");
        camera.color_info(&i).expect("plain");
        let mut ramp = depth.clone();
        for (k, z) in ramp.data.iter_mut().enumerate() {
            *z = 1.0 + (k % 64) as f32 * 0.001;
        }
        let (_, same, k) = camera.pair(color.clone(), ramp.clone()).expect("pair");
        assert_eq!((same, k.fx), (ramp.clone(), 60.0));
        i.d = vec![-0.3, 0.0, 0.0, 0.0, 0.0];
        camera.color_info(&i).expect("bent");
        let (_, straight, _) = camera.pair(color, ramp.clone()).expect("pair");
        assert!(straight.data[0] > ramp.data[0], "the corner comes from farther inside");
        i.distortion_model = "mirror".into();
        assert!(camera.color_info(&i).expect_err("model").to_string().contains("mirror"));
    }

    #[test]
    fn a_depth_camera_of_its_own_waits_for_its_place() {
        let frames = Frames::default();
        let mut camera = Camera::new("/color", "/depth", frames.clone());
        camera.color_info(&info(64, 48, 60.0, "color")).expect("color");
        assert!(matches!(camera.is_known(), Err(CameraError::NoInfo(t)) if t == "/depth"));
        camera.depth_info(&info(32, 24, 20.0, "depth")).expect("depth");
        assert!(matches!(camera.is_known(), Err(CameraError::Place(_))));
        // 0.1 m to the right of the colour camera.
        let place = pose_from_xyz_rpy([0.1, 0.0, 0.0], [0.0; 3]);
        frames.lock().expect("lock").fix("color", "depth", place).expect("fix");
        let wall = DepthImage { width: 32, height: 24, data: vec![1.0; 32 * 24] };
        let (_, aligned, _) = camera.pair(RgbImage::new(64, 48), wall.clone()).expect("pair");
        assert_eq!((aligned.width, aligned.height), (64, 48));
        assert!(aligned.data.iter().filter(|z| **z == 1.0).count() > 64 * 40);
        let e = camera.pair(RgbImage::new(64, 48), DepthImage::new(5, 5)).expect_err("size");
        assert!(e.to_string().contains("5x5"), "{e}");
    }
}
