use crate::convert::{self, ConvertError};
use crate::tracked;
use std::path::Path;
use tdv_bag::{BagError, BagReader, TopicInfo};
use tdv_geometry::{FrameTree, Pose, Stamp};
use tdv_msgs::sensor_msgs::msg::{CameraInfo, CompressedImage, Image};
use tdv_msgs::tf2_msgs::msg::TFMessage;
use tdv_msgs::{CdrError, from_cdr_bytes};
use tdv_rendering::{DepthImage, Intrinsics, Lens, RgbImage, Undistorter};

/// Why a bag gives no frames.
#[derive(Debug, thiserror::Error)]
pub enum CameraBagError {
    /// The bag itself.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// A message that is not what its topic says.
    #[error("{topic}: {source}")]
    Message {
        /// The topic.
        topic: String,
        /// Why.
        source: CdrError,
    },
    /// An image or intrinsics that cannot be used.
    #[error(transparent)]
    Convert(#[from] ConvertError),
    /// Nobody knows where the camera is.
    #[error("{bag}: where is the camera? /tf_static: {why}")]
    Place {
        /// The bag.
        bag: String,
        /// What is wrong with the frames.
        why: String,
    },
    /// Something is not in the bag.
    #[error("{bag} has no {what}; its topics are: {have}")]
    Missing {
        /// The bag.
        bag: String,
        /// What is looked for.
        what: &'static str,
        /// What there is.
        have: String,
    },
}

/// One pair of aligned images, without lens distortion.
#[derive(Debug, Clone)]
pub struct CameraFrame {
    /// Stamp of both.
    pub stamp: Stamp,
    /// Colour.
    pub color: RgbImage,
    /// Depth, aligned to colour (m).
    pub depth: DepthImage,
    /// Intrinsics of both.
    pub intrinsics: Intrinsics,
}

/// Frames of a recording, in order, one at a time.
pub struct CameraBag {
    reader: BagReader,
    color: TopicInfo,
    depth: TopicInfo,
    intrinsics: Intrinsics,
    /// For a camera whose lens bends.
    undistorter: Option<Undistorter>,
    t_base_camera: Pose,
    waiting_color: Option<(Stamp, RgbImage)>,
    waiting_depth: Option<(Stamp, DepthImage)>,
    unpaired: usize,
}

fn is_color(t: &TopicInfo) -> bool {
    let image = t.type_name == "sensor_msgs/msg/Image"
        || (t.type_name == "sensor_msgs/msg/CompressedImage" && t.name.ends_with("/compressed"));
    image && t.name.contains("color") && !t.name.contains("depth")
        || image && t.name.contains("/color/image")
}

fn is_depth(t: &TopicInfo) -> bool {
    (t.type_name == "sensor_msgs/msg/Image" || t.name.ends_with("/compressedDepth"))
        && t.name.contains("aligned_depth_to_color")
}

impl CameraBag {
    /// Opens a bag and finds its camera: colour, depth aligned to colour, `camera_info`, and the camera's pose
    /// in `base_link` from `/tf_static`.
    ///
    /// # Errors
    /// [`CameraBagError`].
    pub fn open(path: &Path) -> Result<Self, CameraBagError> {
        let mut reader = BagReader::open(path)?;
        let topics = reader.topics();
        let have = topics.iter().map(|t| t.name.as_str()).collect::<Vec<_>>().join(", ");
        let missing = |what| CameraBagError::Missing {
            bag: path.display().to_string(),
            what,
            have: have.clone(),
        };
        // Compressed topics first: where both were recorded, they are the smaller ones.
        let pick = |test: &dyn Fn(&TopicInfo) -> bool| {
            let mut found: Vec<&TopicInfo> = topics.iter().filter(|t| test(t)).collect();
            found.sort_by_key(|t| t.type_name != "sensor_msgs/msg/CompressedImage");
            found.first().map(|t| (*t).clone())
        };
        let color = pick(&is_color)
            .ok_or_else(|| missing("colour images (…/color/image_raw[/compressed])"))?;
        let depth = pick(&is_depth).ok_or_else(|| {
            missing("depth images aligned to colour (…/aligned_depth_to_color/image_raw[/compressedDepth])")
        })?;
        let info =
            pick(&|t| t.type_name == "sensor_msgs/msg/CameraInfo" && t.name.contains("color"))
                .ok_or_else(|| missing("camera_info of the colour camera"))?;
        let tf = pick(&|t| t.name == "/tf_static")
            .ok_or_else(|| missing("/tf_static with the camera's pose in base_link"))?;
        reader.select(&[&info.name], None)?;
        let Some(m) = reader.next_message()? else { return Err(missing("camera_info message")) };
        let message: CameraInfo = decode(&info.name, &m.data)?;
        let intrinsics = convert::intrinsics_from_info(&info.name, &message)?;
        let lens = convert::lens_from_info(&info.name, &message)?;
        let undistorter = (lens != Lens::None).then(|| Undistorter::new(intrinsics, lens));
        let camera = message.header.frame_id;
        let place = |why| CameraBagError::Place { bag: path.display().to_string(), why };
        reader.select(&[&tf.name], None)?;
        let mut frames = FrameTree::default();
        while let Some(m) = reader.next_message()? {
            let message: TFMessage = decode(&tf.name, &m.data)?;
            for t in &message.transforms {
                let pose = tracked::transform_pose(t).map_err(|e| place(e.to_string()))?;
                frames
                    .fix(&t.header.frame_id, &t.child_frame_id, pose)
                    .map_err(|e| place(e.to_string()))?;
            }
        }
        let t_base_camera =
            frames.lookup("base_link", &camera, Stamp(0)).map_err(|e| place(e.to_string()))?;
        reader.select(&[&color.name, &depth.name], None)?;
        Ok(Self {
            reader,
            color,
            depth,
            intrinsics,
            undistorter,
            t_base_camera,
            waiting_color: None,
            waiting_depth: None,
            unpaired: 0,
        })
    }

    /// Camera's pose in `base_link` (optical frame).
    pub fn t_base_camera(&self) -> &Pose {
        &self.t_base_camera
    }

    /// Colour images in the bag.
    pub fn frame_count(&self) -> u64 {
        self.color.count
    }

    /// Images without a partner so far.
    pub fn unpaired(&self) -> usize {
        self.unpaired
    }

    /// The next frame; none at the end.
    ///
    /// # Errors
    /// [`CameraBagError`].
    pub fn next_frame(&mut self) -> Result<Option<CameraFrame>, CameraBagError> {
        while let Some(m) = self.reader.next_message()? {
            if m.topic == self.color.name {
                let (stamp, image) = self.decode_color(&m.data)?;
                self.unpaired += usize::from(self.waiting_color.is_some());
                self.waiting_color = Some((stamp, image));
            } else {
                let (stamp, image) = self.decode_depth(&m.data)?;
                self.unpaired += usize::from(self.waiting_depth.is_some());
                self.waiting_depth = Some((stamp, image));
            }
            let same = match (&self.waiting_color, &self.waiting_depth) {
                (Some((a, _)), Some((b, _))) => a == b,
                _ => false,
            };
            if same
                && let (Some((stamp, color)), Some((_, depth))) =
                    (self.waiting_color.take(), self.waiting_depth.take())
            {
                let (color, depth) = match &self.undistorter {
                    Some(u) => (u.color(&color), u.depth(&depth)),
                    None => (color, depth),
                };
                return Ok(Some(CameraFrame { stamp, color, depth, intrinsics: self.intrinsics }));
            }
        }
        Ok(None)
    }

    fn decode_color(&self, data: &[u8]) -> Result<(Stamp, RgbImage), CameraBagError> {
        let topic = &self.color.name;
        if self.color.type_name == "sensor_msgs/msg/Image" {
            let m: Image = decode(topic, data)?;
            Ok((tracked::stamp(&m.header), convert::color_from_image(topic, &m)?))
        } else {
            let m: CompressedImage = decode(topic, data)?;
            Ok((tracked::stamp(&m.header), convert::color_from_compressed(topic, &m)?))
        }
    }

    fn decode_depth(&self, data: &[u8]) -> Result<(Stamp, DepthImage), CameraBagError> {
        let topic = &self.depth.name;
        if self.depth.type_name == "sensor_msgs/msg/Image" {
            let m: Image = decode(topic, data)?;
            Ok((tracked::stamp(&m.header), convert::depth_from_image(topic, &m)?))
        } else {
            let m: CompressedImage = decode(topic, data)?;
            Ok((tracked::stamp(&m.header), convert::depth_from_compressed(topic, &m)?))
        }
    }
}

fn decode<M: serde::de::DeserializeOwned>(topic: &str, data: &[u8]) -> Result<M, CameraBagError> {
    from_cdr_bytes(data)
        .map_err(|source| CameraBagError::Message { topic: topic.to_owned(), source })
}
