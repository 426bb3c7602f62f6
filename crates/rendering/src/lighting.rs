use nalgebra::Vector3;
use tdv_geometry::Pose;

/// A lamp far away.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Direction from the scene TOWARDS the lamp, camera frame; need not be normalised.
    pub direction: [f32; 3],
    /// Strength per colour channel, linear; 1.0 lights a white surface facing it fully.
    pub color: [f32; 3],
}

/// How a scene is lit. All strengths are linear (the renderer decodes and encodes sRGB).
#[derive(Debug, Clone, PartialEq)]
pub struct Lighting {
    /// Light from everywhere, per channel.
    pub ambient: [f32; 3],
    /// The lamps.
    pub lights: Vec<Light>,
    /// Strength of the highlight (0 = matt), for every surface.
    pub specular: f32,
    /// Exponent of the highlight.
    pub shininess: f32,
    /// sRGB colour of pixels that no surface covers.
    pub background: [u8; 3],
}

impl Default for Lighting {
    /// A lamp over the camera's left shoulder, a weak one from the right, ambient light, matt.
    fn default() -> Self {
        Self {
            ambient: [0.35; 3],
            lights: vec![
                Light { direction: [-0.4, -0.8, -0.6], color: [0.6; 3] },
                Light { direction: [0.8, -0.3, -0.5], color: [0.15; 3] },
            ],
            specular: 0.0,
            shininess: 24.0,
            background: [0; 3],
        }
    }
}

impl Lighting {
    /// The same lamps given in another frame: `directions` are rotated by `t_camera_world`'s rotation.
    #[must_use]
    pub fn in_camera(&self, t_camera_world: &Pose) -> Self {
        let mut out = self.clone();
        for light in &mut out.lights {
            let d = t_camera_world.rotation * Vector3::from(light.direction.map(f64::from));
            light.direction = [d.x as f32, d.y as f32, d.z as f32];
        }
        out
    }
}
