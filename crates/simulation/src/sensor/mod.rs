//! The virtual RGB-D camera: an exact rendering made as bad as a stereo depth camera's.
//!
//! What is done to the exact picture (figures are the defaults; the tests measure them):
//!
//! | effect | model |
//! |---|---|
//! | range noise | sigma(z) = subpixel * z^2 / (fx * baseline): 0.08 px and 50 mm give 0.66 / 1.9 / 3.8 mm at 0.5 / 0.85 / 1.2 m (fx 610 px); 30 % of the variance is shared by patches of 6 px |
//! | stereo shadow | background that the second imager does not see, left of near edges, is lost |
//! | lateral noise | within 2 px of a depth edge the reading comes from a pixel displaced by 0.8 px (sigma) |
//! | flying pixels | 12 % of the readings beside an edge lie somewhere between its two sides |
//! | holes | 45 % of the readings beside an edge; surfaces seen at more than 66 deg from their normal, all of them beyond 84 deg; patches of 8 px elsewhere (weak texture), 5.5 % of the area |
//! | quantisation | whole millimetres |
//! | colour | lens blur, vignette, gain, white balance, exposure flicker, shot and read noise |
//!
//! Every random number is a hash of (seed, frame number, pixel): the same frame comes out whatever
//! was rendered before it.

mod color;
mod depth;
pub(crate) mod noise;

pub use color::ColorNoise;
pub use depth::DepthNoise;

use serde::{Deserialize, Serialize};
use tdv_geometry::Pose;
use tdv_rendering::{
    DepthImage, Instance, Intrinsics, Lighting, Mesh, Rendered, Renderer, RgbImage,
};

/// The camera and its imperfections.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorConfig {
    /// The camera as it is (not as `camera_info` may claim).
    pub intrinsics: Intrinsics,
    /// Imperfections of the depth image.
    #[serde(default)]
    pub depth: DepthNoise,
    /// Imperfections of the colour image.
    #[serde(default)]
    pub color: ColorNoise,
}

impl SensorConfig {
    /// The lab's camera: 640x480, 610 px focal length, all imperfections at their defaults.
    pub fn lab() -> Self {
        let intrinsics =
            Intrinsics { width: 640, height: 480, fx: 610.0, fy: 610.0, cx: 319.5, cy: 239.5 };
        Self { intrinsics, depth: DepthNoise::default(), color: ColorNoise::default() }
    }
}

/// One thing before the camera.
#[derive(Debug, Clone, Copy)]
pub struct SceneItem<'a> {
    /// Its surface.
    pub mesh: &'a Mesh,
    /// T_base_item.
    pub pose: Pose,
    /// Its number in the id image, above 0.
    pub id: u16,
}

/// One exposure. Colour and depth are aligned, row-major, of the camera's size.
#[derive(Debug, Clone, Default)]
pub struct SensorFrame {
    /// What the colour imager delivers (sRGB).
    pub color: RgbImage,
    /// What the depth imager delivers: whole millimetres as metres, 0 = hole.
    pub depth: DepthImage,
    /// Truth: the item seen by each pixel, 0 = none. For evaluation only.
    pub ids: Vec<u16>,
    /// Truth: exact depth (m). For evaluation only.
    pub exact: DepthImage,
}

/// Renders scenes as the camera would see them.
#[derive(Debug)]
pub struct RgbdSensor {
    config: SensorConfig,
    seed: u64,
    renderer: Renderer,
    rendered: Rendered,
    depth: depth::Scratch,
    color: color::Scratch,
}

impl RgbdSensor {
    /// A camera whose noise is keyed by `seed`.
    pub fn new(config: SensorConfig, seed: u64) -> Self {
        Self {
            config,
            seed,
            renderer: Renderer::new(),
            rendered: Rendered::default(),
            depth: depth::Scratch::default(),
            color: color::Scratch::default(),
        }
    }

    /// The first `count` items of every scene are the same meshes from picture to picture; see
    /// [`Renderer::still`].
    pub fn keep_still(&mut self, count: usize) {
        self.renderer.still = count;
    }

    /// The configuration in use.
    pub fn config(&self) -> &SensorConfig {
        &self.config
    }

    /// Takes picture number `frame` from `t_base_camera` (optical frame) into `out`. `lighting` gives
    /// its lamps' directions in base_link.
    pub fn capture(
        &mut self,
        t_base_camera: &Pose,
        scene: &[SceneItem<'_>],
        lighting: &Lighting,
        frame: u64,
        out: &mut SensorFrame,
    ) {
        self.capture_in_turn(t_base_camera, scene, lighting, frame, out, |_| {});
    }

    /// As [`capture`](Self::capture); `seen` gets the colour image before the depth image is made, so
    /// that the one can travel meanwhile.
    pub fn capture_in_turn(
        &mut self,
        t_base_camera: &Pose,
        scene: &[SceneItem<'_>],
        lighting: &Lighting,
        frame: u64,
        out: &mut SensorFrame,
        seen: impl FnOnce(&RgbImage),
    ) {
        let t_camera_base = t_base_camera.inverse();
        let instances: Vec<Instance<'_>> = scene
            .iter()
            .map(|s| Instance { mesh: s.mesh, pose: t_camera_base * s.pose, id: s.id })
            .collect();
        let lighting = lighting.in_camera(&t_camera_base);
        let camera = &self.config.intrinsics;
        self.renderer.render(camera, &instances, &lighting, &mut self.rendered);
        let r = &mut self.rendered;
        let key = (self.seed, frame);
        self.config.color.apply(&r.color, key, &mut self.color, &mut out.color);
        seen(&out.color);
        self.config.depth.apply(camera, r, key, &mut self.depth, &mut out.depth);
        // The next rendering writes every pixel of whatever buffers it finds.
        std::mem::swap(&mut out.ids, &mut r.ids);
        std::mem::swap(&mut out.exact, &mut r.depth);
    }
}

#[cfg(test)]
mod tests;
