//! The hand in the image: 21 joints in metric camera coordinates.
//!
//! Two networks (MediaPipe's palm detection and hand landmarks, fetched by
//! `launch_scripts/fetch_hand_models.sh`, run by the small interpreter in [`network`]) find the
//! joints in the colour image; the depth image gives them their place in space ([`lift`]).
//!
//! [`HandDetector`] keeps the window round the hand from one image to the next and looks for palms
//! only when it has none. It follows one hand, the one with the best palm score.

pub mod landmark;
pub mod lift;
pub mod network;
pub mod palm;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod warp;

use std::path::Path;

use image::RgbImage;
use nalgebra::Point3;
use tdv_rendering::{DepthImage, Intrinsics};

pub use landmark::{JOINTS, LandmarkNetwork, Landmarks, next_window};
pub use lift::{Lifted, lift};
pub use network::NetworkError;
pub use palm::{Palm, PalmDetector};
pub use warp::Window;

/// Whose hand it is: the person's own side, in an image that is not mirrored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Handedness {
    /// A left hand.
    Left,
    /// A right hand.
    Right,
}

impl Handedness {
    fn from_right_score(score: f32) -> Self {
        if score > 0.5 { Self::Right } else { Self::Left }
    }

    /// `"left"` or `"right"`, as messages carry it.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
        }
    }
}

/// A hand seen in one RGB-D frame.
#[derive(Clone, Debug, PartialEq)]
pub struct HandObservation {
    /// Joint centres in the camera's optical frame (x right, y down, z forward), metres. OpenPose
    /// order: 0 wrist; 1-4 thumb CMC, MCP, IP, tip; 5-8 index MCP, PIP, DIP, tip; 9-12 middle;
    /// 13-16 ring; 17-20 little finger.
    pub joints_camera: [Point3<f64>; JOINTS],
    /// The same joints in the colour image, pixels, pixel centres at integer coordinates.
    pub pixels: [(f64, f64); JOINTS],
    /// The landmark network's presence score, 0..1.
    pub score: f64,
    /// Whose hand.
    pub handedness: Handedness,
    /// Which joints the depth image confirms; the others follow from the hand's shape.
    pub measured: [bool; JOINTS],
}

/// Why a frame could not be searched.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HandError {
    /// A network file is missing, damaged or another one.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// Colour, depth and intrinsics do not belong together.
    #[error(
        "the {what} is {}x{}, the colour image {}x{}; the hand chain needs depth aligned to colour",
        found.0, found.1, color.0, color.1
    )]
    Size {
        /// Which of them differs from the colour image.
        what: &'static str,
        /// Its width and height.
        found: (u32, u32),
        /// The colour image's width and height.
        color: (u32, u32),
    },
    /// The intrinsics cannot be those of a camera.
    #[error("focal lengths fx = {fx}, fy = {fy}: both have to be positive and finite")]
    Intrinsics {
        /// Horizontal focal length, pixels.
        fx: f64,
        /// Vertical focal length, pixels.
        fy: f64,
    },
}

/// What counts as a hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandConfig {
    /// Least palm score, 0..1, for the landmark network to have a look.
    pub palm_threshold: f64,
    /// Least presence score, 0..1, of the landmark network.
    pub presence_threshold: f64,
}

impl Default for HandConfig {
    fn default() -> Self {
        Self { palm_threshold: 0.5, presence_threshold: 0.5 }
    }
}

/// Finds and follows one hand.
#[derive(Debug)]
pub struct HandDetector {
    palms: PalmDetector,
    landmarks: LandmarkNetwork,
    config: HandConfig,
    /// Where the hand of the last image should be now.
    window: Option<Window>,
}

impl HandDetector {
    /// Loads both networks: `palm_detection_full.tflite` and `hand_landmark_full.tflite`.
    ///
    /// # Errors
    /// [`HandError::Network`] naming the file and what is wrong with it.
    pub fn load(palm: &Path, landmark: &Path) -> Result<Self, HandError> {
        Ok(Self {
            palms: PalmDetector::load(palm)?,
            landmarks: LandmarkNetwork::load(landmark)?,
            config: HandConfig::default(),
            window: None,
        })
    }

    /// The same detector with other thresholds.
    #[must_use]
    pub fn with_config(mut self, config: HandConfig) -> Self {
        self.config = config;
        self
    }

    /// Forgets the hand, as before the first image.
    pub fn reset(&mut self) {
        self.window = None;
    }

    /// Looks for a hand and lifts it to the camera frame. `depth` is aligned to `color`; both have
    /// the size that `k` states. `None`: no hand, or one without usable depth.
    ///
    /// # Errors
    /// [`HandError::Size`] or [`HandError::Intrinsics`] if the inputs do not belong together.
    pub fn detect(
        &mut self,
        color: &RgbImage,
        depth: &DepthImage,
        k: &Intrinsics,
    ) -> Result<Option<HandObservation>, HandError> {
        check(color, depth, k)?;
        let Some(landmarks) = self.find(color) else { return Ok(None) };
        let lifted = lift(&landmarks.pixels, &landmarks.shape, depth, k);
        Ok(lifted.map(|lifted| HandObservation {
            joints_camera: lifted.joints,
            pixels: landmarks.pixels,
            score: landmarks.presence,
            handedness: landmarks.handedness,
            measured: lifted.measured,
        }))
    }

    /// The part of [`HandDetector::detect`] that needs no depth: the hand in the image.
    pub fn find(&mut self, color: &RgbImage) -> Option<Landmarks> {
        let (width, height) = color.dimensions();
        if let Some(window) = self.window.take()
            && let Some(landmarks) = self.look(color, &window)
        {
            return Some(landmarks);
        }
        for palm in self.palms.detect(color, self.config.palm_threshold).iter().take(2) {
            let window = palm.hand_window();
            if window.is_sensible(width, height) && self.look(color, &window).is_some() {
                // The palm's window is rough; the joints found in it give a better one.
                if let Some(better) = self.window
                    && let Some(landmarks) = self.look(color, &better)
                {
                    return Some(landmarks);
                }
            }
        }
        None
    }

    /// Runs the landmark network; keeps the next window if there is a hand.
    fn look(&mut self, color: &RgbImage, window: &Window) -> Option<Landmarks> {
        let landmarks = self.landmarks.run(color, window);
        self.window = None;
        if landmarks.presence < self.config.presence_threshold {
            return None;
        }
        let next = next_window(&landmarks.pixels);
        if !next.is_sensible(color.width(), color.height()) {
            return None;
        }
        self.window = Some(next);
        Some(landmarks)
    }
}

fn check(color: &RgbImage, depth: &DepthImage, k: &Intrinsics) -> Result<(), HandError> {
    let size = color.dimensions();
    let wrong = |what, found| Err(HandError::Size { what, found, color: size });
    if (depth.width, depth.height) != size || depth.data.len() != size.0 as usize * size.1 as usize
    {
        return wrong("depth image", (depth.width, depth.height));
    }
    if (k.width, k.height) != size {
        return wrong("camera that the intrinsics describe", (k.width, k.height));
    }
    if !(k.fx.is_finite() && k.fy.is_finite() && k.fx > 0.0 && k.fy > 0.0) {
        return Err(HandError::Intrinsics { fx: k.fx, fy: k.fy });
    }
    Ok(())
}
