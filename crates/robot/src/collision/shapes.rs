use super::convert;
use glamx::{DPose3, DVec3};
use nalgebra::Point3;
use parry3d_f64::query::gjk::{CsoPoint, GJKResult, VoronoiSimplex, closest_points};
use parry3d_f64::shape::{ConvexPolyhedron, Cuboid, Cylinder, Segment, SupportMap};
use parry3d_f64::transformation::vhacd::{VHACD, VHACDParameters};
use tdv_geometry::Pose;
use thiserror::Error;

/// Why points do not make a convex part.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum ShapeError {
    /// A size that is not above zero, or a number that is not finite.
    #[error("{what} is {value}, expected a finite number above zero")]
    Size {
        /// Which size.
        what: &'static str,
        /// The value.
        value: f64,
    },
    /// Points that lie in a plane, or too few.
    #[error("{count} points have no convex hull with a volume")]
    Flat {
        /// How many there are.
        count: usize,
    },
}

/// What is left of a part when its rounding is taken off.
#[derive(Clone)]
enum Core {
    /// In the body's frame.
    Segment(Segment),
    Cuboid(Cuboid),
    Cylinder(Cylinder),
    Hull(ConvexPolyhedron),
}

/// A convex shape fixed in a body: all points within `radius` of its core.
#[derive(Clone)]
pub struct ConvexPart {
    core: Core,
    radius: f64,
    /// `T_body_core`; segments are given in the body's frame.
    pose: DPose3,
    /// Bounding sphere in the body's frame.
    pub(super) centre: DVec3,
    pub(super) bound: f64,
}

impl std::fmt::Debug for ConvexPart {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let core = match &self.core {
            Core::Segment(Segment { a, b }) => format!("capsule {a} {b}"),
            Core::Cuboid(c) => format!("cuboid {}", c.half_extents),
            Core::Cylinder(c) => format!("cylinder {} {}", c.radius, c.half_height),
            Core::Hull(h) => format!("hull of {} points", h.points().len()),
        };
        write!(f, "{core} radius {}", self.radius)
    }
}

fn size(what: &'static str, value: f64) -> Result<f64, ShapeError> {
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err(ShapeError::Size { what, value }) }
}

impl ConvexPart {
    /// All points within `radius` of the segment `a..b` (m, body frame); a sphere for `a == b`.
    ///
    /// # Errors
    /// [`ShapeError::Size`].
    pub fn capsule(a: [f64; 3], b: [f64; 3], radius: f64) -> Result<Self, ShapeError> {
        if let Some(v) = a.iter().chain(&b).find(|v| !v.is_finite()) {
            return Err(ShapeError::Size { what: "a capsule's end", value: *v });
        }
        let (a, b) = (convert::array(a), convert::array(b));
        Ok(Self {
            core: Core::Segment(Segment::new(a, b)),
            radius: size("a radius", radius)?,
            pose: DPose3::IDENTITY,
            centre: 0.5 * (a + b),
            bound: 0.5 * (b - a).length() + radius,
        })
    }

    /// A box of edge lengths `edges` (m) whose centre and axes are `pose` = `T_body_box`.
    ///
    /// # Errors
    /// [`ShapeError::Size`].
    pub fn cuboid(edges: [f64; 3], pose: &Pose) -> Result<Self, ShapeError> {
        for e in edges {
            size("an edge", e)?;
        }
        let half = 0.5 * convert::array(edges);
        Self::solid(Core::Cuboid(Cuboid::new(half)), pose, half.length())
    }

    /// A cylinder about z of `pose` = `T_body_cylinder`, which is at its middle (m).
    ///
    /// # Errors
    /// [`ShapeError::Size`].
    pub fn cylinder(radius: f64, length: f64, pose: &Pose) -> Result<Self, ShapeError> {
        let (r, h) = (size("a radius", radius)?, 0.5 * size("a length", length)?);
        // The library's cylinder stands along y.
        let y_to_z = nalgebra::UnitQuaternion::from_axis_angle(
            &nalgebra::Vector3::x_axis(),
            std::f64::consts::FRAC_PI_2,
        );
        Self::solid(Core::Cylinder(Cylinder::new(h, r)), &(pose * y_to_z), r.hypot(h))
    }

    fn solid(core: Core, pose: &Pose, bound: f64) -> Result<Self, ShapeError> {
        let pose = convert::pose(pose);
        if !pose.translation.is_finite() || !pose.rotation.is_finite() {
            return Err(ShapeError::Size { what: "a pose", value: f64::NAN });
        }
        Ok(Self { core, radius: 0.0, pose, centre: pose.translation, bound })
    }

    /// The convex hull of points (m, body frame).
    ///
    /// # Errors
    /// [`ShapeError`]: not finite, or flat.
    pub fn hull(points: &[Point3<f64>]) -> Result<Self, ShapeError> {
        if points.iter().any(|p| !p.coords.iter().all(|v| v.is_finite())) {
            return Err(ShapeError::Size { what: "a point", value: f64::NAN });
        }
        let points: Vec<DVec3> = points.iter().map(convert::point).collect();
        Self::hull_of(&points).ok_or(ShapeError::Flat { count: points.len() })
    }

    fn hull_of(points: &[DVec3]) -> Option<Self> {
        if points.len() < 4 {
            return None;
        }
        let hull = ConvexPolyhedron::from_convex_hull(points)?;
        let (lo, hi) = hull
            .points()
            .iter()
            .fold((DVec3::MAX, DVec3::MIN), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
        if (hi - lo).min_element() <= 1e-9 {
            return None;
        }
        let centre = 0.5 * (lo + hi);
        let bound = hull.points().iter().map(|p| (*p - centre).length()).fold(0.0, f64::max);
        Some(Self { core: Core::Hull(hull), radius: 0.0, pose: DPose3::IDENTITY, centre, bound })
    }

    /// The same part fixed elsewhere: `by` = `T_body_old`.
    #[must_use]
    pub fn moved(mut self, by: &Pose) -> Self {
        let by = convert::pose(by);
        if let Core::Segment(Segment { a, b }) = &mut self.core {
            (*a, *b) = (by.transform_point(*a), by.transform_point(*b));
        } else {
            self.pose = by * self.pose;
        }
        self.centre = by.transform_point(self.centre);
        self
    }

    /// Where the part is with its body at `body`.
    pub(super) fn place(&self, body: &DPose3) -> Placed {
        let centre = body.transform_point(self.centre);
        let (pose, ends) = match &self.core {
            Core::Segment(s) => (*body, [body.transform_point(s.a), body.transform_point(s.b)]),
            _ => (*body * self.pose, [centre; 2]),
        };
        Placed { pose, centre, ends }
    }

    /// A cheap lower bound of the distance to another part: bounding spheres, then the other's sphere
    /// against this segment or box, both ways.
    pub(super) fn at_least(&self, at: &Placed, other: &Self, there: &Placed, enough: f64) -> f64 {
        let spheres = (at.centre - there.centre).length() - self.bound - other.bound;
        if spheres >= enough {
            return spheres;
        }
        let one = self.to_point(at, there.centre).map_or(spheres, |d| d - other.bound);
        if one >= enough {
            return one;
        }
        let two = other.to_point(there, at.centre).map_or(spheres, |d| d - self.bound);
        if two >= enough {
            return two;
        }
        let gaps = self.box_gap(at, other, there).max(other.box_gap(there, self, at));
        gaps.max(one).max(two)
    }

    /// Distance of a point from this segment or box.
    fn to_point(&self, at: &Placed, p: DVec3) -> Option<f64> {
        match &self.core {
            Core::Segment(_) => {
                let (along, to) = (at.ends[1] - at.ends[0], p - at.ends[0]);
                let length2 = along.length_squared();
                let t = if length2 > 0.0 { (to.dot(along) / length2).clamp(0.0, 1.0) } else { 0.0 };
                Some((to - t * along).length() - self.radius)
            }
            Core::Cuboid(c) => {
                let p = at.pose.inverse_transform_point(p).abs();
                Some((p - c.half_extents).max(DVec3::ZERO).length())
            }
            _ => None,
        }
    }

    /// Gap between this box and the other segment's extent along the box's axes.
    fn box_gap(&self, at: &Placed, other: &Self, there: &Placed) -> f64 {
        let (Core::Cuboid(c), Core::Segment(_)) = (&self.core, &other.core) else {
            return f64::MIN;
        };
        let [a, b] = there.ends.map(|p| at.pose.inverse_transform_point(p));
        let gap = (a.min(b) - c.half_extents).max(-a.max(b) - c.half_extents);
        gap.max(DVec3::ZERO).length() - other.radius
    }

    /// Height of the lowest point.
    pub(super) fn lowest(&self, at: &Placed) -> f64 {
        let z = match &self.core {
            Core::Segment(_) => at.ends[0].z.min(at.ends[1].z),
            Core::Cuboid(c) => {
                let r = at.pose.rotation;
                let across = |axis: DVec3, half: f64| (r * axis).z.abs() * half;
                let h = c.half_extents;
                at.pose.translation.z
                    - across(DVec3::X, h.x)
                    - across(DVec3::Y, h.y)
                    - across(DVec3::Z, h.z)
            }
            _ => self.support().support_point(&at.pose, DVec3::NEG_Z).z,
        };
        z - self.radius
    }

    fn support(&self) -> &dyn SupportMap {
        match &self.core {
            Core::Segment(s) => s,
            Core::Cuboid(c) => c,
            Core::Cylinder(c) => c,
            Core::Hull(h) => h,
        }
    }
}

/// A part's place in the world.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placed {
    /// Of the core; of the body for a segment.
    pose: DPose3,
    /// Of the bounding sphere.
    centre: DVec3,
    /// Of the segment.
    ends: [DVec3; 2],
}

/// Distance of two parts at their places: exact when it is below `enough`, else `enough` or more. Zero
/// or negative when they touch; how deep is not measured beyond the radii.
pub(super) fn distance(
    (a, at): (&ConvexPart, &Placed),
    (b, there): (&ConvexPart, &Placed),
    enough: f64,
) -> f64 {
    let rounding = a.radius + b.radius;
    let core = match (&a.core, &b.core) {
        (Core::Segment(_), Core::Segment(_)) => segments(at.ends, there.ends),
        (Core::Segment(_), _) => return distance((b, there), (a, at), enough),
        (_, Core::Segment(_)) => {
            // The segment in the frame of the other's core.
            let [p, q] = there.ends.map(|p| at.pose.inverse_transform_point(p));
            let s = Segment::new(p, q);
            gjk(&DPose3::IDENTITY, a.support(), &s, 0.5 * (p + q), enough + rounding)
        }
        _ => {
            let to = at.pose.inverse() * there.pose;
            gjk(&to, a.support(), b.support(), to.translation, enough + rounding)
        }
    };
    core - rounding
}

fn gjk(to: &DPose3, a: &dyn SupportMap, b: &dyn SupportMap, towards: DVec3, enough: f64) -> f64 {
    let dir = (-towards).try_normalize().unwrap_or(DVec3::X);
    let mut simplex = VoronoiSimplex::new();
    simplex.reset(CsoPoint::from_shapes(to, a, b, dir));
    match closest_points(to, a, b, enough, true, &mut simplex) {
        GJKResult::ClosestPoints(p, q, _) => (p - q).length(),
        // Also given when the iteration does not end, so the separation is looked at again.
        GJKResult::NoIntersection(dir) => {
            let apart = -dir.dot(CsoPoint::from_shapes(to, a, b, dir).point);
            apart.max(0.0)
        }
        GJKResult::Intersection | GJKResult::Proximity(_) => 0.0,
    }
}

/// Distance of two segments.
///
/// The closest pair has both ends inside the segments, or one at an end: the parameter on the first is
/// clamped, the second's follows and is clamped, and then the first's follows again.
fn segments([a0, a1]: [DVec3; 2], [b0, b1]: [DVec3; 2]) -> f64 {
    let (u, v, w) = (a1 - a0, b1 - b0, a0 - b0);
    let (uu, vv, uv) = (u.dot(u), v.dot(v), u.dot(v));
    let (uw, vw) = (u.dot(w), v.dot(w));
    let on = |x: f64, length2: f64| if length2 > 0.0 { (x / length2).clamp(0.0, 1.0) } else { 0.0 };
    let det = uu * vv - uv * uv;
    // Parallel lines: any start will do.
    let s = if det > 1e-12 * uu * vv { ((uv * vw - vv * uw) / det).clamp(0.0, 1.0) } else { 0.0 };
    let t = on(uv * s + vw, vv);
    let s = on(uv * t - uw, uu);
    (w + s * u - t * v).length()
}

/// Convex parts of a mesh (m, body frame): its hull, or where `triangles` are given an approximate
/// convex decomposition, which follows hollows such as a mug's; it falls back to the hull.
///
/// # Errors
/// [`ShapeError`].
pub fn convex_parts(
    vertices: &[Point3<f64>],
    triangles: Option<&[[u32; 3]]>,
) -> Result<Vec<ConvexPart>, ShapeError> {
    let hull = ConvexPart::hull(vertices)?;
    let Some(triangles) = triangles else { return Ok(vec![hull]) };
    let count = vertices.len();
    if triangles.is_empty() || triangles.iter().flatten().any(|i| *i as usize >= count) {
        return Ok(vec![hull]);
    }
    let points: Vec<DVec3> = vertices.iter().map(convert::point).collect();
    let parameters = VHACDParameters { resolution: 48, concavity: 0.01, ..Default::default() };
    let cut = VHACD::decompose(&parameters, &points, triangles, false);
    // Hulls of voxels: a little larger than the mesh, never smaller.
    let parts: Option<Vec<_>> =
        cut.compute_convex_hulls(1).iter().map(|(p, _)| ConvexPart::hull_of(p)).collect();
    Ok(parts.filter(|p| !p.is_empty()).unwrap_or_else(|| vec![hull]))
}
