//! One trait for each step of perception that a learned model may take over: words to boxes, a box to a
//! mask, masks from image to image, a mask to a first pose, a pose to the next one. The classical chain
//! is [`Classical`]; `tdv-foundation` has the others.

use crate::catalogue::ObjectModel;
use crate::frame::RgbdFrame;
use crate::register::{RegisterConfig, register};
use crate::segment::Mask;
use crate::table::TablePlane;
use tdv_geometry::Pose;
use tdv_rendering::RgbImage;
use thiserror::Error;

/// Why a step gave nothing.
#[derive(Debug, Error)]
pub enum BackendError {
    /// What was looked for is not in this image; another image may help.
    #[error("{0}")]
    NotFound(String),
    /// The step cannot run: missing files, inputs that do not fit together.
    #[error("{backend}: {source}")]
    Failed {
        /// Which backend.
        backend: &'static str,
        /// What it said.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

/// A rectangle of an image (px, pixel centres at integers).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelBox {
    /// Left border.
    pub left: f64,
    /// Upper border.
    pub top: f64,
    /// Right border.
    pub right: f64,
    /// Lower border.
    pub bottom: f64,
}

impl PixelBox {
    /// Width times height (px^2), 0 for a box turned inside out.
    pub fn area(&self) -> f64 {
        (self.right - self.left).max(0.0) * (self.bottom - self.top).max(0.0)
    }

    /// Intersection over union with another box, 0..1.
    pub fn overlap(&self, other: &Self) -> f64 {
        let common = Self {
            left: self.left.max(other.left),
            top: self.top.max(other.top),
            right: self.right.min(other.right),
            bottom: self.bottom.min(other.bottom),
        };
        let both = common.area();
        if both > 0.0 { both / (self.area() + other.area() - both) } else { 0.0 }
    }
}

/// A box that fits a phrase.
#[derive(Debug, Clone, PartialEq)]
pub struct Located {
    /// Index of the phrase.
    pub phrase: usize,
    /// Where.
    pub pixels: PixelBox,
    /// 0..1.
    pub score: f64,
}

/// What a pose step found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseEstimate {
    /// `T_camera_object`.
    pub pose: Pose,
    /// 0..1: how much of the object agrees with the measured depth (and outline, if the backend looks).
    pub confidence: f64,
}

/// Words to boxes.
pub trait LocateText: Send {
    /// All boxes that fit one of the phrases ("red mug"), best first.
    ///
    /// # Errors
    /// [`BackendError::Failed`]; an image without any of it gives an empty list.
    fn locate(
        &mut self,
        color: &RgbImage,
        phrases: &[String],
    ) -> Result<Vec<Located>, BackendError>;
}

/// Boxes to masks.
pub trait CutOut: Send {
    /// One mask for each box, in their order.
    ///
    /// # Errors
    /// [`BackendError::Failed`].
    fn cut_out(&mut self, color: &RgbImage, boxes: &[PixelBox]) -> Result<Vec<Mask>, BackendError>;
}

/// A mask from image to image.
pub trait FollowMask: Send {
    /// Begins with a mask in an image; whatever was followed before is forgotten.
    ///
    /// # Errors
    /// [`BackendError::Failed`].
    fn begin(&mut self, color: &RgbImage, mask: &Mask) -> Result<(), BackendError>;

    /// The mask in the next image; `None` while the object is out of sight.
    ///
    /// # Errors
    /// [`BackendError::Failed`], also before [`Self::begin`].
    fn follow(&mut self, color: &RgbImage) -> Result<Option<Mask>, BackendError>;
}

/// A mask to a first pose.
pub trait FirstPose: Send {
    /// The pose of `model` whose pixels are `mask`.
    ///
    /// # Errors
    /// [`BackendError::NotFound`] when nothing fits.
    fn first_pose(
        &mut self,
        frame: &RgbdFrame,
        mask: &Mask,
        model: &ObjectModel,
    ) -> Result<PoseEstimate, BackendError>;
}

/// A pose to the next one.
pub trait NextPose: Send {
    /// The pose in `frame`, from the one in the frame before (`T_camera_object`).
    ///
    /// # Errors
    /// [`BackendError::Failed`]; a lost object shows in the confidence.
    fn next_pose(
        &mut self,
        frame: &RgbdFrame,
        model: &ObjectModel,
        last: &Pose,
    ) -> Result<PoseEstimate, BackendError>;
}

/// The classical first pose, as a backend.
#[derive(Debug, Clone, Default)]
pub struct Classical {
    /// Settings of the registration.
    pub register: RegisterConfig,
    /// The table, if one is known.
    pub table: Option<TablePlane>,
}

impl FirstPose for Classical {
    fn first_pose(
        &mut self,
        frame: &RgbdFrame,
        mask: &Mask,
        model: &ObjectModel,
    ) -> Result<PoseEstimate, BackendError> {
        frame
            .check()
            .map_err(|e| BackendError::Failed { backend: "classical", source: Box::new(e) })?;
        register(frame, mask, model, self.table.as_ref(), &self.register)
            .map(|r| PoseEstimate { pose: r.pose, confidence: r.score })
            .ok_or_else(|| {
                BackendError::NotFound(format!("no pose of {} fits the mask", model.name))
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{K, Lab, camera, mug_model, upright};

    #[test]
    fn boxes_overlap_from_none_to_all() {
        let a = PixelBox { left: 0.0, top: 0.0, right: 10.0, bottom: 10.0 };
        let b = PixelBox { left: 5.0, top: 0.0, right: 15.0, bottom: 10.0 };
        let away = PixelBox { left: 20.0, top: 20.0, right: 30.0, bottom: 30.0 };
        assert!((a.overlap(&b) - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!((a.overlap(&a), a.overlap(&away)), (1.0, 0.0));
    }

    #[test]
    fn the_classical_backend_registers_or_says_that_nothing_fits() {
        let model = mug_model();
        let pose = upright(0.45, 0.05, 0.0, 0.8);
        let frame = Lab::new(3).frame(&[(&model.mesh, pose)]);
        let t_camera = camera().inverse();
        let middle = t_camera * pose * model.centre();
        let (u, v) = K.project(&middle).unwrap();
        let window = |on: &dyn Fn(i32, i32) -> bool| Mask {
            x0: u as i32 - 70,
            y0: v as i32 - 70,
            width: 140,
            height: 140,
            data: (0..140 * 140)
                .map(|i| on(u as i32 - 70 + i % 140, v as i32 - 70 + i / 140))
                .collect(),
        };
        let near = |x: i32, y: i32| {
            frame
                .point(x, y)
                .is_some_and(|p| (p - middle).norm() < 0.075 && (camera() * p).z > 0.006)
        };
        let mut backend: Box<dyn FirstPose> = Box::new(Classical::default());
        let found = backend.first_pose(&frame, &window(&near), &model).unwrap();
        let off = (found.pose * model.centre() - middle).norm();
        assert!(off < 0.01 && found.confidence > 0.45, "{off} {}", found.confidence);
        let nothing = backend.first_pose(&frame, &window(&|_, _| false), &model);
        assert!(matches!(nothing, Err(BackendError::NotFound(_))));
    }
}
