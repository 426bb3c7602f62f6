//! The drawn mesh against the view: by what factor is what is seen larger?

use super::ScaleEstimate;
use crate::catalogue::ObjectModel;
use crate::frame::RgbdFrame;
use crate::segment::Mask;
use crate::table::TablePlane;
use crate::view::Painter;
use nalgebra::{Matrix4, Point3, Vector3, Vector4};
use tdv_geometry::Pose;

/// Standard deviation (m) of the top of what is seen.
const HEIGHT_SIGMA: f64 = 0.0015;
/// Standard deviation (px) of an extent in the image.
const EXTENT_SIGMA_PX: f64 = 1.5;
/// Farthest (m) a measured point may be from the drawn surface.
const REACH: f64 = 0.02;

/// Factors by which the model should grow; `None` when it is not in view.
pub(super) fn measure(
    frame: &RgbdFrame,
    table: &TablePlane,
    mask: &Mask,
    model: &ObjectModel,
    pose: &Pose,
) -> Option<Vec<ScaleEstimate>> {
    let k = frame.intrinsics.crop(mask.x0, mask.y0, mask.width, mask.height);
    let mut painter = Painter::new();
    painter.draw(&k, model, pose);
    let drawn = &painter.out.depth.data;
    let row = mask.width as usize;
    let (mut seen, mut shown) = (Outline::default(), Outline::default());
    let (mut measured, mut rendered) = (Vec::new(), Vec::new());
    for (i, z) in drawn.iter().enumerate() {
        let (x, y) = ((i % row) as i32, (i / row) as i32);
        let (u, v) = (x + mask.x0, y + mask.y0);
        let inside = mask.at(u, v);
        if inside {
            seen.add(x, y);
            if let Some(p) = frame.point(u, v) {
                measured.push(table.height(&p));
            }
        }
        if *z > 0.0 {
            shown.add(x, y);
            let p = k.unproject(f64::from(x), f64::from(y), f64::from(*z));
            rendered.push(table.height(&p));
        }
    }
    let (top_seen, top_shown) = (top(&mut measured)?, top(&mut rendered)?);
    let mut out = vec![ScaleEstimate {
        name: "height",
        value: top_seen / top_shown,
        sigma: HEIGHT_SIGMA / top_seen.max(1e-4),
    }];
    let (ws, wr) = (seen.width()?, shown.width()?);
    out.push(ScaleEstimate { name: "width", value: ws / wr, sigma: EXTENT_SIGMA_PX / ws });
    let (vs, vr) = (seen.height()?, shown.height()?);
    out.push(ScaleEstimate { name: "image height", value: vs / vr, sigma: EXTENT_SIGMA_PX / vs });
    let (a, b) = (seen.area(), shown.area());
    let sigma = EXTENT_SIGMA_PX / a.sqrt();
    out.push(ScaleEstimate { name: "area", value: (a / b).sqrt(), sigma });
    if let Some((value, sigma)) = icp(frame, table, mask, model, pose, &mut painter) {
        out.push(ScaleEstimate { name: "icp", value, sigma });
    }
    out.iter().all(|e| e.value.is_finite() && e.value > 0.0).then_some(out)
}

/// Mean of the highest tenth without its uppermost fifth: one flying pixel is no top.
fn top(heights: &mut [f64]) -> Option<f64> {
    if heights.len() < 30 {
        return None;
    }
    heights.sort_by(f64::total_cmp);
    let n = heights.len();
    let band = &heights[n * 90 / 100..n * 98 / 100];
    let mean = band.iter().sum::<f64>() / band.len() as f64;
    (mean > 0.0).then_some(mean)
}

/// Columns and rows of a set of pixels.
#[derive(Default)]
struct Outline {
    columns: Vec<u32>,
    rows: Vec<u32>,
    count: usize,
}

impl Outline {
    fn add(&mut self, x: i32, y: i32) {
        let count = |list: &mut Vec<u32>, i: i32| {
            let i = i.max(0) as usize;
            if list.len() <= i {
                list.resize(i + 1, 0);
            }
            list[i] += 1;
        };
        count(&mut self.columns, x);
        count(&mut self.rows, y);
        self.count += 1;
    }

    fn area(&self) -> f64 {
        self.count as f64
    }

    fn width(&self) -> Option<f64> {
        extent(&self.columns, self.count)
    }

    fn height(&self) -> Option<f64> {
        extent(&self.rows, self.count)
    }
}

/// Between the 1st and the 99th percentile, in fractions of a pixel.
fn extent(list: &[u32], count: usize) -> Option<f64> {
    if count < 30 {
        return None;
    }
    let at = |share: f64| {
        let goal = share * count as f64;
        let mut sum = 0.0;
        for (i, n) in list.iter().enumerate() {
            let next = sum + f64::from(*n);
            if next >= goal && *n > 0 {
                return i as f64 + (goal - sum) / f64::from(*n);
            }
            sum = next;
        }
        list.len() as f64
    };
    let e = at(0.99) - at(0.01);
    (e > 2.0).then_some(e)
}

/// Growth about the foot, shift along the table and turn about its normal that bring the drawn surface
/// onto the measured points (point to plane); the factor and its standard deviation.
fn icp(
    frame: &RgbdFrame,
    table: &TablePlane,
    mask: &Mask,
    model: &ObjectModel,
    start: &Pose,
    painter: &mut Painter,
) -> Option<(f64, f64)> {
    let k = frame.intrinsics.crop(mask.x0, mask.y0, mask.width, mask.height);
    let row = mask.width as usize;
    let c = model.centre();
    let foot_in_model = Point3::new(c.x, c.y, model.min.z);
    let (ex, ey) = (table.pose.rotation * Vector3::x(), table.pose.rotation * Vector3::y());
    let (mut scale, mut pose, mut sigma) = (1.0, *start, 1.0);
    for _ in 0..8 {
        let grown = model.rescaled(scale);
        painter.draw(&k, &grown, &pose);
        let foot = pose * (foot_in_model * scale);
        let (mut h, mut g) = (Matrix4::<f64>::zeros(), Vector4::<f64>::zeros());
        let (mut squares, mut n) = (0.0, 0.0);
        // What a table plane that is off by one metre would do.
        let mut lifted = Vector4::<f64>::zeros();
        for (i, z) in painter.out.depth.data.iter().enumerate() {
            let (x, y) = ((i % row) as i32, (i / row) as i32);
            let (u, v) = (x + mask.x0, y + mask.y0);
            if *z <= 0.0 || !mask.at(u, v) {
                continue;
            }
            let Some(q) = frame.point(u, v) else { continue };
            let p = k.unproject(f64::from(x), f64::from(y), f64::from(*z));
            if (q.z - p.z).abs() > REACH {
                continue;
            }
            let normal = Vector3::from(painter.out.normals[i].map(f64::from));
            let r = normal.dot(&(q - p));
            let arm = p - foot;
            let j = Vector4::new(
                normal.dot(&ex),
                normal.dot(&ey),
                normal.dot(&table.normal.cross(&arm)),
                normal.dot(&arm),
            );
            // Points far off count less (Huber, 3 mm).
            let w = if r.abs() < 0.003 { 1.0 } else { 0.003 / r.abs() };
            h += w * j * j.transpose();
            g += w * j * r;
            lifted += w * j * normal.dot(&table.normal);
            squares += w * r * r;
            n += 1.0;
        }
        if n < 50.0 {
            return None;
        }
        // A round thing's yaw is free: a little damping.
        let mut damped = h;
        for i in 0..4 {
            damped[(i, i)] += 1e-6 * n;
        }
        let step = damped.cholesky()?.solve(&g);
        let grow = step[3].clamp(-0.1, 0.1);
        let turn =
            nalgebra::UnitQuaternion::from_scaled_axis(table.normal * step[2].clamp(-0.2, 0.2));
        let shift = ex * step[0] + ey * step[1];
        let new_foot = foot + shift;
        scale *= grow.exp();
        pose.rotation = turn * pose.rotation;
        let moved = pose.rotation * (foot_in_model.coords * scale);
        pose.translation.vector = new_foot.coords - moved;
        let variance = squares / n;
        // Neighbouring pixels share their errors: as if one in thirty told something new.
        let inverse = damped.try_inverse()?;
        let noise = (variance.max(1e-7) * inverse[(3, 3)].max(0.0) * 30.0).sqrt().max(0.006);
        sigma = noise.hypot((inverse * lifted)[3] * HEIGHT_SIGMA);
        if step.norm() < 1e-5 {
            break;
        }
    }
    (scale.is_finite() && (0.5..2.0).contains(&scale)).then_some((scale, sigma))
}
