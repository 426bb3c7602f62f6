use nalgebra::{Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use tdv_geometry::Pose;

/// A pinhole camera without distortion; focal lengths and principal point in pixels, pixel centres
/// at integer coordinates (the top-left pixel covers -0.5..0.5 both ways).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Intrinsics {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Focal length along u (px).
    pub fx: f64,
    /// Focal length along v (px).
    pub fy: f64,
    /// Principal point, column (px).
    pub cx: f64,
    /// Principal point, row (px).
    pub cy: f64,
}

impl Intrinsics {
    /// Pixel of a point of the camera frame (m); `None` unless it lies in front of the camera. The
    /// pixel may lie outside the image.
    pub fn project(&self, p: &Point3<f64>) -> Option<(f64, f64)> {
        (p.z > 1e-9).then(|| (self.fx * p.x / p.z + self.cx, self.fy * p.y / p.z + self.cy))
    }

    /// Direction through a pixel in the camera frame, scaled to z = 1.
    pub fn ray(&self, u: f64, v: f64) -> Vector3<f64> {
        Vector3::new((u - self.cx) / self.fx, (v - self.cy) / self.fy, 1.0)
    }

    /// The point (m, camera frame) at depth `z` (m, along the optical axis) behind a pixel.
    pub fn unproject(&self, u: f64, v: f64, z: f64) -> Point3<f64> {
        Point3::from(self.ray(u, v) * z)
    }

    /// The camera whose image is the window of `w` x `h` pixels with its top-left pixel at (x0, y0)
    /// of this one. The window may reach beyond the image.
    #[must_use]
    pub fn crop(&self, x0: i32, y0: i32, w: u32, h: u32) -> Self {
        Self {
            width: w,
            height: h,
            cx: self.cx - f64::from(x0),
            cy: self.cy - f64::from(y0),
            ..*self
        }
    }

    /// The same view resampled by `f` (0.5 halves the resolution); sizes are rounded to whole pixels.
    #[must_use]
    pub fn scaled(&self, f: f64) -> Self {
        Self {
            width: (f64::from(self.width) * f).round().max(1.0) as u32,
            height: (f64::from(self.height) * f).round().max(1.0) as u32,
            fx: self.fx * f,
            fy: self.fy * f,
            // Centres at integers: the left image border, -0.5, must stay at -0.5.
            cx: (self.cx + 0.5) * f - 0.5,
            cy: (self.cy + 0.5) * f - 0.5,
        }
    }

    /// Whether a pixel coordinate lies on the image.
    pub fn contains(&self, u: f64, v: f64) -> bool {
        u >= -0.5
            && v >= -0.5
            && u < f64::from(self.width) - 0.5
            && v < f64::from(self.height) - 0.5
    }
}

/// Pose of a camera at `eye` whose optical axis goes through `target`, both in the parent frame
/// (m), with the image's up side towards the parent's +z: `T_parent_camera`. Looking straight along
/// z, image up is the parent's +x.
pub fn look_at(eye: &Point3<f64>, target: &Point3<f64>) -> Pose {
    let forward = (target - eye).try_normalize(1e-12).unwrap_or_else(Vector3::x);
    let right = forward
        .cross(&Vector3::z())
        .try_normalize(1e-9)
        .or_else(|| forward.cross(&Vector3::x()).try_normalize(1e-9))
        .unwrap_or_else(Vector3::y);
    let down = forward.cross(&right);
    let rotation = UnitQuaternion::from_matrix(&Matrix3::from_columns(&[right, down, forward]));
    Pose::from_parts(Translation3::from(eye.coords), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    const K: Intrinsics =
        Intrinsics { width: 640, height: 480, fx: 610.0, fy: 600.0, cx: 319.5, cy: 239.5 };

    #[test]
    fn project_and_unproject_are_inverse_and_behind_is_none() {
        let p = Point3::new(0.1, -0.2, 0.8);
        let (u, v) = K.project(&p).unwrap();
        assert!((K.unproject(u, v, 0.8) - p).norm() < 1e-12);
        assert!(K.project(&Point3::new(0.1, 0.1, -0.5)).is_none());
    }

    #[test]
    fn crop_and_scale_keep_the_rays() {
        let c = K.crop(100, 50, 64, 48);
        assert!((c.ray(3.0, 4.0) - K.ray(103.0, 54.0)).norm() < 1e-12);
        let h = K.scaled(0.5);
        // The centre of a half-resolution pixel is the corner shared by four full ones.
        assert!((h.ray(10.0, 7.0) - K.ray(20.5, 14.5)).norm() < 1e-12);
        assert_eq!((h.width, h.height), (320, 240));
    }

    #[test]
    fn looking_at_a_point_puts_it_in_the_middle_with_up_upwards() {
        let eye = Point3::new(0.95, 0.0, 0.7);
        let t = look_at(&eye, &Point3::new(0.475, 0.0, 0.02));
        let in_camera = t.inverse() * Point3::new(0.475, 0.0, 0.02);
        assert!(in_camera.x.abs() < 1e-12 && in_camera.y.abs() < 1e-12 && in_camera.z > 0.8);
        let higher = t.inverse() * Point3::new(0.475, 0.0, 0.12);
        assert!(higher.y < 0.0);
        // Facing the robot (-x), the world's +y is on the image's right.
        assert!((t.inverse() * Point3::new(0.475, 0.1, 0.02)).x > 0.0);
        let down = look_at(&Point3::new(0.0, 0.0, 1.0), &Point3::origin());
        assert!((down.inverse() * Point3::new(0.1, 0.0, 0.0)).y < 0.0);
    }
}
