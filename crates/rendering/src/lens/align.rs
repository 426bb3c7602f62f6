use super::Lens;
use crate::{DepthImage, Intrinsics};
use nalgebra::{Point3, Vector3};
use tdv_geometry::Pose;
use thiserror::Error;

/// A depth image that is not of the camera that was set up.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum AlignError {
    /// Another size.
    #[error("depth image is {have_width}x{have_height}, its camera_info says {width}x{height}")]
    Size {
        /// Columns of the image.
        have_width: u32,
        /// Rows of the image.
        have_height: u32,
        /// Columns in the calibration.
        width: u32,
        /// Rows in the calibration.
        height: u32,
    },
}

/// Neighbours within this part of the depth are one surface.
const SAME: f32 = 0.015;

/// Registers the images of a depth camera to a colour camera: each reading is moved through space and
/// drawn as large as its pixel is over there, the nearest surface wins, and pin holes that the
/// resampling leaves within one surface are closed. Corner rays are computed once.
#[derive(Debug, Clone)]
pub struct DepthAligner {
    depth: Intrinsics,
    color: Intrinsics,
    t_color_depth: Pose,
    /// Directions (z = 1) of the upper left corner of every pixel, one row and column more than
    /// pixels; NaN where the lens does not look.
    corners: Vec<[f32; 2]>,
}

impl DepthAligner {
    /// From the depth camera's calibration, its pose in the colour camera's optical frame and the
    /// (undistorted) colour camera.
    pub fn new(depth: Intrinsics, lens: &Lens, t_color_depth: Pose, color: Intrinsics) -> Self {
        let mut corners =
            Vec::with_capacity((depth.width as usize + 1) * (depth.height as usize + 1));
        for v in 0..=depth.height {
            for u in 0..=depth.width {
                let ray = depth.ray(f64::from(u) - 0.5, f64::from(v) - 0.5);
                let ideal = lens.undistort(ray.x, ray.y);
                corners.push(ideal.map_or([f32::NAN; 2], |(x, y)| [x as f32, y as f32]));
            }
        }
        Self { depth, color, t_color_depth, corners }
    }

    /// The depth image as the colour camera would see it, of the colour image's size.
    ///
    /// # Errors
    /// [`AlignError`].
    pub fn align(&self, image: &DepthImage) -> Result<DepthImage, AlignError> {
        let (w, h) = (self.depth.width as usize, self.depth.height as usize);
        if (image.width, image.height) != (self.depth.width, self.depth.height)
            || image.data.len() != w * h
        {
            return Err(AlignError::Size {
                have_width: image.width,
                have_height: image.height,
                width: self.depth.width,
                height: self.depth.height,
            });
        }
        let mut out = DepthImage::new(self.color.width, self.color.height);
        let turn = self.t_color_depth.rotation.to_rotation_matrix();
        let shift = self.t_color_depth.translation.vector;
        let (cw, ch) = (self.color.width as usize, self.color.height as usize);
        for v in 0..h {
            for u in 0..w {
                let z = f64::from(image.data[v * w + u]);
                if !(z > 0.0) {
                    continue;
                }
                let corner = |i: usize| {
                    let [x, y] = self.corners[i];
                    let ray = Vector3::new(f64::from(x), f64::from(y), 1.0);
                    let p = turn * (ray * z) + shift;
                    (self.color.project(&Point3::from(p)), p.z)
                };
                let i = v * (w + 1) + u;
                let (a, za) = corner(i);
                let (b, zb) = corner(i + w + 2);
                let (Some(a), Some(b)) = (a, b) else { continue };
                // The pixel's centre lies midway, up to the lens.
                let z = (0.5 * (za + zb)) as f32;
                let Some(columns) = covered(a.0, b.0, cw) else { continue };
                let Some(rows) = covered(a.1, b.1, ch) else { continue };
                for y in rows {
                    for x in columns.clone() {
                        let seen = &mut out.data[y * cw + x];
                        if *seen == 0.0 || z < *seen {
                            *seen = z;
                        }
                    }
                }
            }
        }
        close_pinholes(&mut out);
        Ok(out)
    }
}

/// Pixels whose centres lie between two image coordinates, at least the one nearest to their middle;
/// `None` outside an image of `size` pixels.
fn covered(a: f64, b: f64, size: usize) -> Option<std::ops::RangeInclusive<usize>> {
    // NaN from a ray that the lens does not have fails both comparisons.
    if !((a - b).abs() < 64.0 && a.abs() < 1e6) {
        return None;
    }
    let (a, b) = (a.min(b), a.max(b));
    let (mut first, mut last) = (a.ceil() as i64, (b.ceil() as i64) - 1);
    if last < first {
        first = ((a + b) / 2.0).round() as i64;
        last = first;
    }
    let (first, last) = (first.max(0), last.min(size as i64 - 1));
    (first <= last).then_some(first as usize..=last as usize)
}

/// Gives a pixel without reading the mean of its neighbours when at least five of the eight have one
/// and all of them are one surface.
fn close_pinholes(image: &mut DepthImage) {
    let (w, h) = (image.width as usize, image.height as usize);
    if w < 3 || h < 3 {
        return;
    }
    let old = image.data.clone();
    for y in 1..h - 1 {
        for x in 1..w - 1 {
            if old[y * w + x] > 0.0 {
                continue;
            }
            let (mut sum, mut n, mut low, mut high) = (0.0, 0.0_f32, f32::MAX, 0.0_f32);
            for row in [y - 1, y, y + 1] {
                for z in &old[row * w + x - 1..=row * w + x + 1] {
                    if *z > 0.0 {
                        sum += z;
                        n += 1.0;
                        low = low.min(*z);
                        high = high.max(*z);
                    }
                }
            }
            if n >= 5.0 && high - low < SAME * low {
                image.data[y * w + x] = sum / n;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_from_xyz_rpy;

    const DEPTH: Intrinsics =
        Intrinsics { width: 424, height: 240, fx: 213.0, fy: 213.0, cx: 213.5, cy: 119.0 };
    const COLOR: Intrinsics =
        Intrinsics { width: 640, height: 360, fx: 465.0, fy: 465.5, cx: 318.0, cy: 183.0 };

    fn pose() -> Pose {
        pose_from_xyz_rpy([0.015, 0.0002, 0.0005], [0.003, -0.015, 0.008])
    }

    /// Depth along `camera`'s axis to the plane z = 0.8 + 0.3 x of the colour frame, with a square of
    /// 20 cm at 0.5 m before it.
    fn view(camera: &Intrinsics, t_color_camera: &Pose, lens: &Lens) -> DepthImage {
        let mut out = DepthImage::new(camera.width, camera.height);
        for v in 0..camera.height {
            for u in 0..camera.width {
                let ray = camera.ray(f64::from(u), f64::from(v));
                let Some((x, y)) = lens.undistort(ray.x, ray.y) else { continue };
                let d = t_color_camera.rotation * Vector3::new(x, y, 1.0);
                let o = t_color_camera.translation.vector;
                let plane = (0.8 + 0.3 * o.x - o.z) / (d.z - 0.3 * d.x);
                let near = (0.5 - o.z) / d.z;
                let hit = o + d * near;
                let z = if hit.x.abs() < 0.1 && hit.y.abs() < 0.1 { near } else { plane };
                out.data[(v * camera.width + u) as usize] = if z > 0.0 { z as f32 } else { 0.0 };
            }
        }
        out
    }

    #[test]
    fn a_plane_and_a_square_come_out_where_the_colour_camera_sees_them() {
        let bent = Lens::from_coefficients("plumb_bob", &[-0.15, 0.03, 0.001, 0.0, 0.0]).unwrap();
        for lens in [Lens::None, bent] {
            let depth = view(&DEPTH, &pose(), &lens);
            let want = view(&COLOR, &Pose::identity(), &Lens::None);
            let have = DepthAligner::new(DEPTH, &lens, pose(), COLOR).align(&depth).unwrap();
            let (mut good, mut holes, mut n) = (0, 0, 0);
            for v in 40..320 {
                for u in 90..550 {
                    let i = v * 640 + u;
                    n += 1;
                    holes += usize::from(have.data[i] == 0.0);
                    good += usize::from((have.data[i] - want.data[i]).abs() < 0.003);
                }
            }
            // What the colour camera sees and the depth camera does not stays without reading.
            assert!(holes < n / 50, "{holes} holes of {n}");
            assert!(good > n * 96 / 100, "{good} of {n}");
            // Nothing of the plane shines through the square.
            let square = (-60..60).flat_map(|y| (-60..60).map(move |x| (318 + x, 183 + y)));
            for (u, v) in square {
                let z = have.data[(v * 640 + u) as usize];
                assert!((z - 0.5).abs() < 0.002, "{u} {v}: {z}");
            }
        }
    }

    #[test]
    fn the_same_camera_gives_the_same_image_and_other_sizes_are_refused() {
        let depth = view(&COLOR, &Pose::identity(), &Lens::None);
        let same = DepthAligner::new(COLOR, &Lens::None, Pose::identity(), COLOR);
        let back = same.align(&depth).unwrap();
        let off = back.data.iter().zip(&depth.data).filter(|(a, b)| (*a - *b).abs() > 1e-6).count();
        assert!(off < 2, "{off}");
        let e = same.align(&DepthImage::new(10, 10)).unwrap_err().to_string();
        assert!(e.contains("10x10") && e.contains("640x360"), "{e}");
    }

    /// The real pair of cameras: with the true extrinsics, depth edges lie on colour edges. Redness is
    /// looked at: bottle and can have it, the checkerboard under them, which has edges everywhere, has none.
    #[test]
    fn real_depth_edges_lie_on_colour_edges() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../../shared/data/m3t_schauma");
        let Ok(color) = image::open(folder.join("color_camera_image_200.png")) else {
            eprintln!("skipped: {} is not there", folder.display());
            return;
        };
        let color = color.into_rgb8();
        let raw = image::open(folder.join("depth_camera_image_200.png")).unwrap().into_luma16();
        let depth = DepthImage::from_millimetres(848, 480, raw.as_raw()).unwrap();
        let kd = Intrinsics {
            width: 848,
            height: 480,
            fx: 425.773,
            fy: 425.773,
            cx: 427.202,
            cy: 237.662,
        };
        let kc = Intrinsics {
            width: 960,
            height: 540,
            fx: 698.128,
            fy: 698.617,
            cx: 478.459,
            cy: 274.426,
        };
        let m = nalgebra::Matrix3::new(
            0.99985489,
            0.00778240,
            0.01509715,
            -0.00782678,
            0.99996543,
            0.00288261,
            -0.01507424,
            -0.00300036,
            0.99988175,
        );
        let turn = tdv_geometry::rotation_from_matrix(&m, 1e-3).unwrap();
        let redness = |u: u32, v: u32| {
            let [r, _, b] = color.get_pixel(u, v).0;
            f64::from(r) - f64::from(b)
        };
        // Mean step of the redness across the depth edges, the camera shifted sideways by `x` metres.
        let contrast = |x: f64| {
            let t = nalgebra::Translation3::new(0.01453388 + x, 0.00013995, 0.00051057);
            let aligned = DepthAligner::new(kd, &Lens::None, Pose::from_parts(t, turn), kc)
                .align(&depth)
                .unwrap();
            let filled = aligned.data.iter().filter(|z| **z > 0.0).count() as f64;
            let (mut sum, mut n) = (0.0, 0.0);
            for v in 4..536_u32 {
                for u in 4..956_u32 {
                    let z = |du: u32| aligned.data[(v * 960 + u + du - 2) as usize];
                    let (l, r) = (z(0), z(4));
                    if l > 0.0 && r > 0.0 && (l - r).abs() > 0.08 {
                        sum += (redness(u - 2, v) - redness(u + 2, v)).abs();
                        n += 1.0;
                    }
                }
            }
            (sum / f64::max(n, 1.0), filled / (960.0 * 540.0))
        };
        let (right, filled) = contrast(0.0);
        let (left, _) = contrast(-0.005);
        let (far, _) = contrast(0.005);
        println!(
            "contrast {right:.1}, shifted {left:.1} and {far:.1}, {:.0} % filled",
            filled * 100.0
        );
        assert!(filled > 0.5, "{filled}");
        assert!(right > 1.3 * left && right > 1.3 * far, "{right} {left} {far}");
    }
}
