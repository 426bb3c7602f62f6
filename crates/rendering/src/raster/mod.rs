//! The CPU rasteriser. First pass: every triangle writes inverse depth and its own number into a
//! visibility buffer. Second pass: each covered pixel is shaded once, from the triangle it shows.

mod base;
mod resolve;
mod setup;

use crate::lighting::Lighting;
use crate::{DepthImage, Intrinsics, Mesh, RgbImage};
use base::Base;
use resolve::Shader;
use tdv_geometry::Pose;

/// Nothing nearer than this (m) is drawn.
const NEAR: f64 = 0.01;

/// A mesh standing somewhere before the camera.
#[derive(Debug, Clone, Copy)]
pub struct Instance<'a> {
    /// What.
    pub mesh: &'a Mesh,
    /// T_camera_object.
    pub pose: Pose,
    /// Its number in the id image; 0 is kept for "nothing".
    pub id: u16,
}

/// Everything [`Renderer::render`] makes; row-major images of the camera's size.
#[derive(Debug, Clone, Default)]
pub struct Rendered {
    /// sRGB colour.
    pub color: RgbImage,
    /// Exact depth along the optical axis (m), 0 where nothing is.
    pub depth: DepthImage,
    /// [`Instance::id`] of the surface seen, 0 where nothing is.
    pub ids: Vec<u16>,
    /// Unit surface normals in the camera frame, turned towards the camera; zero where nothing is.
    pub normals: Vec<[f32; 3]>,
}

/// What [`Renderer::render_depth`] makes; fields as in [`Rendered`].
#[derive(Debug, Clone, Default)]
pub struct DepthOnly {
    /// Exact depth (m).
    pub depth: DepthImage,
    /// Instance ids.
    pub ids: Vec<u16>,
    /// Unit normals in the camera frame.
    pub normals: Vec<[f32; 3]>,
}

/// Draws meshes; keeps its buffers from call to call, so that one renderer should serve many frames.
#[derive(Debug, Default)]
pub struct Renderer {
    /// Leave out triangles that show their inner side (half the work for closed meshes; open or
    /// badly wound ones get holes). Off by default.
    pub cull_backfaces: bool,
    /// How many instances at the head of every scene are the same meshes, unchanged, from call to call.
    /// While camera, light and their poses stay too, they are drawn once, and later pictures begin as a
    /// copy of that; the images are the same to the byte. 0 by default.
    pub still: usize,
    base: Base,
    camera: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    screen: Vec<[f64; 3]>,
    bases: Vec<usize>,
    inv_z: Vec<f32>,
    visible: Vec<u32>,
    drawn: Vec<(u32, u32)>,
}

impl Renderer {
    /// A renderer without buffers yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Colour, depth, ids and normals of the scene. Instances whose pose is not finite, and triangles
    /// that name missing vertices, are left out. `out` is resized as needed.
    pub fn render(
        &mut self,
        camera: &Intrinsics,
        scene: &[Instance<'_>],
        lighting: &Lighting,
        out: &mut Rendered,
    ) {
        let (still, moving) = scene.split_at(self.still.min(scene.len()));
        if still.is_empty() {
            self.draw(camera, scene, None, lighting, out);
            return;
        }
        let mut base = std::mem::take(&mut self.base);
        if !base.is_of(camera, still, lighting) {
            self.draw(camera, still, None, lighting, &mut base.image);
            base.inv_z.clone_from(&self.inv_z);
        }
        self.draw(camera, moving, Some(&base), lighting, out);
        self.base = base;
    }

    /// Draws a scene over `base`, or over the background.
    fn draw(
        &mut self,
        camera: &Intrinsics,
        scene: &[Instance<'_>],
        base: Option<&Base>,
        lighting: &Lighting,
        out: &mut Rendered,
    ) {
        self.visibility(camera, scene, base);
        let pixels = fit(camera, &mut out.depth, &mut out.ids, &mut out.normals);
        if out.color.dimensions() != (camera.width, camera.height) {
            out.color = RgbImage::new(camera.width, camera.height);
        }
        debug_assert_eq!(out.color.as_raw().len(), pixels * 3);
        self.resolve(
            camera,
            scene,
            base,
            (&mut out.depth.data, &mut out.ids, &mut out.normals),
            Some((&Shader::new(lighting), &mut out.color)),
        );
    }

    /// Depth, ids and normals alone: the fast path.
    pub fn render_depth(
        &mut self,
        camera: &Intrinsics,
        scene: &[Instance<'_>],
        out: &mut DepthOnly,
    ) {
        self.visibility(camera, scene, None);
        fit(camera, &mut out.depth, &mut out.ids, &mut out.normals);
        let fields = (&mut *out.depth.data, &mut *out.ids, &mut *out.normals);
        self.resolve(camera, scene, None, fields, None);
    }
}

fn fit(
    camera: &Intrinsics,
    depth: &mut DepthImage,
    ids: &mut Vec<u16>,
    normals: &mut Vec<[f32; 3]>,
) -> usize {
    let pixels = camera.width as usize * camera.height as usize;
    (depth.width, depth.height) = (camera.width, camera.height);
    depth.data.resize(pixels, 0.0);
    ids.resize(pixels, 0);
    normals.resize(pixels, [0.0; 3]);
    pixels
}

#[cfg(test)]
mod tests;
