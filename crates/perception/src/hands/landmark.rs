//! The 21 joints of a hand in a window of the image: the hand landmark network.

use std::path::Path;

use image::RgbImage;
use nalgebra::Vector3;

use super::Handedness;
use super::network::{Network, NetworkError};
use super::warp::{Border, Window};

/// Side of the network's input.
const SIZE: usize = 224;
/// Number of joints.
pub const JOINTS: usize = 21;

/// What the network sees in one window. Joints in OpenPose order: wrist; thumb CMC, MCP, IP, tip;
/// then MCP, PIP, DIP, tip of index, middle, ring and little finger.
#[derive(Clone, Debug, PartialEq)]
pub struct Landmarks {
    /// Probability that the window shows a hand, 0..1.
    pub presence: f64,
    /// Whose hand.
    pub handedness: Handedness,
    /// Joints in the image, pixels (centres at integer coordinates).
    pub pixels: [(f64, f64); JOINTS],
    /// Joints in metres for a hand of average size, relative to about the hand's middle; axes
    /// parallel to the image's (x right, y down, z away from the camera).
    pub shape: [Vector3<f64>; JOINTS],
}

/// The hand landmark network.
#[derive(Debug)]
pub struct LandmarkNetwork {
    network: Network,
    outputs: [usize; 4],
}

impl LandmarkNetwork {
    /// Loads `hand_landmark_full.tflite`.
    ///
    /// # Errors
    /// [`NetworkError`] if the file is missing, damaged or another network.
    pub fn load(path: &Path) -> Result<Self, NetworkError> {
        let network = Network::load(path)?;
        let outputs = network.expect(
            &[1, SIZE, SIZE, 3],
            [
                ("Identity", &[1, 3 * JOINTS]),
                ("Identity_1", &[1, 1]),
                ("Identity_2", &[1, 1]),
                ("Identity_3", &[1, 3 * JOINTS]),
            ],
        )?;
        Ok(Self { network, outputs })
    }

    /// Looks for one hand in `window` of `image`.
    pub fn run(&mut self, image: &RgbImage, window: &Window) -> Landmarks {
        window.sample(image, SIZE, Border::Nearest, self.network.input_mut());
        self.network.run();
        let [screen, presence, side, world] = self.outputs.map(|i| self.network.output(i));
        let point = |values: &[f32], joint: usize| {
            Vector3::from_fn(|axis, _| f64::from(values[3 * joint + axis]))
        };
        Landmarks {
            presence: f64::from(presence[0]),
            handedness: Handedness::from_right_score(side[0]),
            pixels: std::array::from_fn(|joint| {
                let p = point(screen, joint) / SIZE as f64;
                window.to_image(p.x, p.y)
            }),
            shape: std::array::from_fn(|joint| {
                let p = point(world, joint);
                let (x, y) = window.turn(p.x, p.y);
                Vector3::new(x, y, p.z)
            }),
        }
    }
}

/// The joints that stay with the palm, and the fingers' first two: what the next window is laid
/// round. The tips move too much.
const STEADY: [usize; 12] = [0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18];

/// The window in which the same hand is looked for in the next image.
#[must_use]
pub fn next_window(pixels: &[(f64, f64); JOINTS]) -> Window {
    let wrist = pixels[0];
    // Between the knuckles, the middle one counted twice.
    let knuckles = (
        (pixels[5].0 + pixels[13].0) / 4.0 + pixels[9].0 / 2.0,
        (pixels[5].1 + pixels[13].1) / 4.0 + pixels[9].1 / 2.0,
    );
    let angle = (knuckles.0 - wrist.0).atan2(wrist.1 - knuckles.1);
    let upright = Window { centre: (0.0, 0.0), side: 0.0, angle };
    let (mut low, mut high) = ((f64::MAX, f64::MAX), (f64::MIN, f64::MIN));
    for joint in STEADY {
        let (x, y) = upright.turn_back(pixels[joint].0, pixels[joint].1);
        low = (low.0.min(x), low.1.min(y));
        high = (high.0.max(x), high.1.max(y));
    }
    let size = (high.0 - low.0, high.1 - low.1);
    let middle = ((low.0 + high.0) / 2.0, (low.1 + high.1) / 2.0 - 0.1 * size.1);
    Window { centre: upright.turn(middle.0, middle.1), side: 2.0 * size.0.max(size.1), angle }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_window_turns_with_the_hand() {
        let mut pixels = [(100.0, 100.0); JOINTS];
        pixels[0] = (100.0, 140.0);
        for (joint, u) in [(5, 80.0), (9, 100.0), (13, 110.0), (17, 125.0)] {
            pixels[joint] = (u, 100.0);
        }
        let window = next_window(&pixels);
        assert!((window.side - 90.0).abs() < 5.0, "{window:?}");
        assert!(window.angle.abs() < 0.1);
        // Turned about the origin by 1 rad, the window turns and moves with the pixels.
        let turn = Window { centre: (0.0, 0.0), side: 0.0, angle: 1.0 };
        let turned = next_window(&pixels.map(|(u, v)| turn.turn(u, v)));
        let centre = turn.turn(window.centre.0, window.centre.1);
        assert!((turned.angle - window.angle - 1.0).abs() < 1e-9);
        assert!((turned.centre.0 - centre.0).abs() < 1e-6);
        assert!((turned.centre.1 - centre.1).abs() < 1e-6);
        assert!((turned.side - window.side).abs() < 1e-6);
    }
}
