use super::shapes::distance;
use super::*;
use crate::gripper::KNUCKLE_CLOSED;
use crate::kinematics::{IkSelection, Joints, Kinematics};
use crate::urdf::{LinkShape, RobotModel, Shape};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};
use std::path::Path;
use tdv_geometry::{Pose, pose_from_xyz_rpy};

fn model() -> RobotModel {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/robot/ur5_2f85.urdf");
    RobotModel::load(Path::new(path)).unwrap()
}

fn fixture(name: &str, shape: FixtureShape, position: [f64; 3], rpy: [f64; 3]) -> Fixture {
    Fixture { name: name.into(), shape, position, rpy }
}

fn cell() -> Workcell {
    Workcell::new(vec![
        fixture("wall", FixtureShape::Box([0.3, 0.02, 0.3]), [0.5, 0.1, 0.15], [0.0, 0.0, 0.3]),
        fixture("post", FixtureShape::Cylinder([0.03, 0.6]), [0.35, -0.3, 0.3], [0.1, 0.0, 0.0]),
        fixture("ball", FixtureShape::Sphere(0.06), [-0.3, 0.2, 0.5], [0.0; 3]),
    ])
}

fn world() -> CollisionWorld {
    CollisionWorld::new(&model(), &cell(), Margins::default(), 0.0).unwrap()
}

/// A convex set for the independent check: the nearest point of it to another.
struct Set {
    name: String,
    at: Pose,
    shape: Shape,
    flat_ends: bool,
}

impl Set {
    fn nearest(&self, p: &Point3<f64>) -> Point3<f64> {
        let p = self.at.inverse_transform_point(p);
        let q = match self.shape {
            Shape::Box([x, y, z]) => Point3::new(
                p.x.clamp(-x / 2.0, x / 2.0),
                p.y.clamp(-y / 2.0, y / 2.0),
                p.z.clamp(-z / 2.0, z / 2.0),
            ),
            Shape::Cylinder(r, l) if self.flat_ends => {
                let k = (r / p.x.hypot(p.y)).min(1.0);
                Point3::new(p.x * k, p.y * k, p.z.clamp(-l / 2.0, l / 2.0))
            }
            Shape::Cylinder(r, l) => {
                let c = Point3::new(0.0, 0.0, p.z.clamp(-l / 2.0, l / 2.0));
                c + (p - c) * (r / (p - c).norm().max(1e-300)).min(1.0)
            }
            Shape::Sphere(r) => Point3::from(p.coords * (r / p.coords.norm().max(1e-300)).min(1.0)),
        };
        self.at * q
    }

    /// Points spread over the surface.
    fn samples(&self) -> Vec<Point3<f64>> {
        let mut out = Vec::new();
        for i in 0..14 {
            for j in 0..8 {
                let (z, a) = (f64::from(i) / 6.5 - 1.0, f64::from(j) / 8.0 * TAU);
                let far = Point3::new(a.cos(), a.sin(), z);
                out.push(self.nearest(&(self.at * far)));
                out.push(self.nearest(&(self.at * Point3::from(far.coords * 0.2))));
            }
        }
        out
    }

    /// Distance of two convex sets: the best of the samples, then projections to and fro.
    fn distance(&self, samples: &[Point3<f64>], other: &Self) -> f64 {
        let gap = |p: &Point3<f64>| (other.nearest(p) - p).norm();
        let mut p = *samples.iter().min_by(|a, b| gap(a).total_cmp(&gap(b))).unwrap();
        let mut best = gap(&p);
        for _ in 0..1500 {
            p = self.nearest(&other.nearest(&p));
            let d = gap(&p);
            let done = best - d < 1e-10;
            best = best.min(d);
            if done {
                break;
            }
        }
        best
    }
}

fn rank(link: &str) -> usize {
    [
        "base_link_inertia",
        "shoulder_link",
        "upper_arm_link",
        "forearm_link",
        "wrist_1_link",
        "wrist_2_link",
    ]
    .iter()
    .position(|n| *n == link)
    .unwrap_or(6)
}

/// Least of distance less margin, by the independent shapes.
fn brute(m: &RobotModel, shapes: &[LinkShape], q: &Joints, knuckle: f64) -> (f64, bool) {
    let poses = m.link_poses(q, knuckle);
    let margins = Margins::default();
    let sets: Vec<Set> = shapes
        .iter()
        .map(|s| Set {
            name: s.link.clone(),
            at: poses[s.link.as_str()] * s.origin,
            shape: s.shape,
            flat_ends: false,
        })
        .collect();
    let samples: Vec<_> = sets.iter().map(Set::samples).collect();
    let fixtures: Vec<Set> = cell()
        .fixtures
        .iter()
        .map(|f| {
            let shape = match f.shape {
                FixtureShape::Box(e) => Shape::Box(e),
                FixtureShape::Cylinder([r, l]) => Shape::Cylinder(r, l),
                FixtureShape::Sphere(r) => Shape::Sphere(r),
                FixtureShape::Mesh(_) => unreachable!(),
            };
            Set {
                name: f.name.clone(),
                at: pose_from_xyz_rpy(f.position, f.rpy),
                shape,
                flat_ends: true,
            }
        })
        .collect();
    let (mut least, mut touching) = (f64::INFINITY, false);
    for (a, s) in sets.iter().zip(&samples) {
        let finger = ["knuckle", "finger"].iter().any(|n| a.name.contains(n));
        if rank(&a.name) > 1 {
            // Down from far away, the lowest point is the one nearest to a point far below.
            let far = Point3::new(a.at.translation.x, a.at.translation.y, -1e5);
            let low = a.nearest(&far).z;
            least = least.min(low - if finger { margins.fingertip } else { margins.table });
        }
        for b in fixtures.iter().filter(|_| rank(&a.name) > 0) {
            let d = a.distance(s, b);
            least = least.min(d - margins.fixture);
            touching |= d < 1e-4;
        }
        for b in sets.iter().filter(|b| rank(&a.name) + 1 < rank(&b.name)) {
            let d = a.distance(s, b);
            least = least.min(d - margins.own);
            touching |= d < 1e-4;
        }
    }
    (least, touching)
}

#[test]
fn distances_equal_those_of_projected_surface_points() {
    let n = std::env::var("TDV_COLLISION_POSES").ok().and_then(|v| v.parse().ok()).unwrap_or(400);
    let (m, w) = (model(), world());
    let shapes = m.collisions();
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let (mut free, mut worst, mut hits): (usize, f64, usize) = (0, 0.0, 0);
    for i in 0..n {
        let mut q: Joints = std::array::from_fn(|_| rng.random_range(-PI..PI));
        if i % 2 == 0 {
            // Above the table more often.
            q = [
                rng.random_range(-PI..PI),
                rng.random_range(-2.6..-0.5),
                rng.random_range(0.2..2.6),
                q[3],
                q[4],
                q[5],
            ];
        }
        let knuckle = rng.random_range(0.0..KNUCKLE_CLOSED);
        let (b, touching) = brute(&m, &shapes, &q, knuckle);
        let c = w.distance(&q, knuckle, None).unwrap();
        assert_eq!(w.check(&q, knuckle, None).is_ok(), c.slack >= 0.0, "{q:?} {c:?}");
        if touching {
            hits += 1;
            assert!(c.slack <= b + 1e-5, "{q:?} {b} {c:?}");
        } else {
            worst = worst.max((c.slack - b).abs());
            // GJK ends a few micrometres above on round shapes. Projections come near from above, slowly where surfaces are nearly parallel.
            assert!(c.slack < b + 1e-5 && b - c.slack < 1e-4, "{q:?} by points {b}, {c:?}");
        }
        free += usize::from(c.slack >= 0.0);
    }
    println!(
        "{n} configurations: {free} free, {hits} with overlap, greatest difference {worst:.1e} m"
    );
    assert!(free > n / 20 && hits > n / 20);
}

#[test]
fn no_pair_comes_nearer_between_two_looks_than_the_bound_says() {
    let w = world();
    let m = Margins::default();
    let held = HeldObject::new(
        "bottle",
        vec![ConvexPart::capsule([0.0, 0.0, 0.1], [0.0, 0.05, 0.2], 0.03).unwrap()],
        &Pose::identity(),
        &[],
    );
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let (mut edges, mut steps, slip) = (0, 0, 1e-3);
    while edges < 300 {
        let a: Joints = std::array::from_fn(|i| {
            [0.0, -1.5, 1.5, -1.5, -1.6, 0.0][i] + rng.random_range(-1.5..1.5)
        });
        let dq: Joints = std::array::from_fn(|_| rng.random_range(-0.7..0.7));
        if w.check(&a, 0.3, Some(&held)).is_err() {
            continue;
        }
        edges += 1;
        let t = w.advance(&a, 0.3, Some(&held), Advance { dq: &dq, remaining: 1.0, slip }).unwrap();
        assert!(t > 0.0 && t <= 1.0);
        steps += usize::from(t < 1.0);
        for i in 0..=60 {
            let x = t * f64::from(i) / 60.0;
            let q = std::array::from_fn(|j| a[j] + x * dq[j]);
            let c = w.distance(&q, 0.3, Some(&held)).unwrap();
            assert!(c.slack >= -slip - 1e-9, "{c:?} at {x} of {t}");
        }
    }
    assert!(steps > 100 && m.own > slip);
}

#[test]
fn bodies_are_named_and_bad_numbers_refused() {
    let (k, w) = (Kinematics::ur5(), world());
    let seed = [0.2, -1.3, 1.7, -2.0, -1.6, 0.4];
    let at = |x: f64, y: f64, z: f64| {
        let down = pose_from_xyz_rpy([x, y, z], [PI, 0.0, 0.0]);
        k.nearest_tcp(&down, &seed, &IkSelection::default()).unwrap()
    };
    assert_eq!(w.check(&at(0.5, -0.15, 0.2), 0.0, None), Ok(()));
    let e = w.check(&at(0.5, 0.1, 0.2), 0.0, None).unwrap_err().to_string();
    assert!(e.contains("wall") && e.contains("robotiq"), "{e}");
    let e = w.check(&at(0.5, -0.15, 0.001), 0.4, None).unwrap_err().to_string();
    assert!(e.contains("table") && e.contains("finger"), "{e}");
    // Elbow folded: the forearm lies on the upper arm's bearing.
    let e = w.check(&[0.0, -1.57, 3.1, 0.0, 0.0, 0.0], 0.0, None).unwrap_err().to_string();
    assert!(e.contains("link"), "{e}");
    assert!(matches!(w.check(&[f64::NAN; 6], 0.0, None), Err(CollisionError::NotFinite { .. })));
    assert!(matches!(
        w.distance(&seed, f64::INFINITY, None),
        Err(CollisionError::NotFinite { .. })
    ));
}

#[test]
fn what_is_held_counts() {
    let (k, w) = (Kinematics::ur5(), world());
    let seed = [0.2, -1.3, 1.7, -2.0, -1.6, 0.4];
    let down = pose_from_xyz_rpy([0.5, -0.05, 0.2], [PI, 0.0, 0.0]);
    let q = k.nearest_tcp(&down, &seed, &IkSelection::default()).unwrap();
    let stick = |length: f64, touching: &[&str]| {
        let part = ConvexPart::cuboid([0.02, length, 0.02], &Pose::identity()).unwrap();
        HeldObject::new("stick", vec![part], &Pose::translation(0.0, 0.0, 0.15), touching)
    };
    assert_eq!(w.check(&q, 0.4, None), Ok(()));
    assert_eq!(w.check(&q, 0.4, Some(&stick(0.1, &[]))), Ok(()));
    let e = w.check(&q, 0.4, Some(&stick(0.4, &[]))).unwrap_err().to_string();
    assert!(e.contains("stick") && e.contains("wall"), "{e}");
    assert_eq!(w.check(&q, 0.4, Some(&stick(0.4, &["wall"]))), Ok(()));
    // It may stand on the table but not sink into it.
    let tall = |length: f64| {
        let part =
            ConvexPart::cylinder(0.02, length, &Pose::translation(0.0, 0.0, length / 2.0)).unwrap();
        HeldObject::new("tall", vec![part], &Pose::translation(0.0, 0.0, 0.15), &[])
    };
    assert_eq!(w.check(&q, 0.4, Some(&tall(0.2))), Ok(()));
    let e = w.check(&q, 0.4, Some(&tall(0.21))).unwrap_err().to_string();
    assert!(e.contains("tall") && e.contains("table"), "{e}");
}

#[test]
fn parts_of_all_kinds_agree_with_each_other() {
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    let pose = |rng: &mut ChaCha8Rng| {
        let r =
            UnitQuaternion::from_scaled_axis(Vector3::from_fn(|_, _| rng.random_range(-3.0..3.0)));
        Pose::from_parts(Vector3::from_fn(|_, _| rng.random_range(-0.4..0.4)).into(), r)
    };
    let id = Pose::identity();
    let corners: Vec<_> = (0..8)
        .map(|i| Point3::new([-0.1, 0.1][i & 1], [-0.05, 0.05][(i >> 1) & 1], [-0.2, 0.2][i >> 2]))
        .collect();
    let same =
        [ConvexPart::cuboid([0.2, 0.1, 0.4], &id).unwrap(), ConvexPart::hull(&corners).unwrap()];
    let rod = ConvexPart::capsule([0.0, 0.0, -0.1], [0.0, 0.0, 0.1], 0.03).unwrap();
    let can = ConvexPart::cylinder(0.03, 0.2, &id).unwrap();
    for _ in 0..2000 {
        let (p, q) = (pose(&mut rng), pose(&mut rng));
        let (gp, gq) = (super::convert::pose(&p), super::convert::pose(&q));
        let apart = |a: &ConvexPart, b: &ConvexPart, enough: f64| {
            distance((a, &a.place(&gp)), (b, &b.place(&gq)), enough)
        };
        for other in [&rod, &can] {
            let d: Vec<f64> = same.iter().map(|s| apart(s, other, 10.0)).collect();
            assert!((d[0] - d[1]).abs() < 1e-6, "{d:?}");
            let back = distance((other, &other.place(&gq)), (&same[0], &same[0].place(&gp)), 10.0);
            assert!((back - d[0]).abs() < 1e-6, "{back} {d:?}");
            for s in &same {
                let bound = s.at_least(&s.place(&gp), other, &other.place(&gq), 10.0);
                assert!(bound <= d[0] + 1e-6, "{bound} {d:?}");
                // Asked for less, the answer is a bound.
                let capped = apart(s, other, 0.05);
                assert!(
                    (capped - d[0]).abs() < 1e-6
                        || (capped >= 0.05 - 1e-9 && capped <= d[0] + 1e-6)
                );
            }
            // The capsule is the can with round ends.
            assert!(apart(&same[0], &rod, 10.0) <= apart(&same[0], &can, 10.0) + 1e-6);
        }
    }
    for bad in [ConvexPart::hull(&corners[..4]), ConvexPart::capsule([f64::NAN; 3], [0.0; 3], 0.1)]
    {
        assert!(bad.is_err());
    }
    assert!(ConvexPart::cuboid([0.1, 0.0, 0.1], &id).is_err());
}

#[test]
fn a_decomposition_contains_the_mesh_and_leaves_its_hollow() {
    // A square cup: five boxes' corners as one mesh.
    let (mut v, mut t) = (Vec::new(), Vec::new());
    let mut slab = |lo: [f64; 3], hi: [f64; 3]| {
        let n = v.len() as u32;
        for i in 0..8usize {
            v.push(Point3::new(
                [lo[0], hi[0]][i & 1],
                [lo[1], hi[1]][(i >> 1) & 1],
                [lo[2], hi[2]][i >> 2],
            ));
        }
        for f in [
            [0, 2, 3],
            [0, 3, 1],
            [4, 5, 7],
            [4, 7, 6],
            [0, 1, 5],
            [0, 5, 4],
            [2, 6, 7],
            [2, 7, 3],
            [0, 4, 6],
            [0, 6, 2],
            [1, 3, 7],
            [1, 7, 5],
        ] {
            t.push(f.map(|i: u32| i + n));
        }
    };
    slab([-0.05, -0.05, 0.0], [0.05, 0.05, 0.01]);
    slab([-0.05, -0.05, 0.0], [-0.04, 0.05, 0.1]);
    slab([0.04, -0.05, 0.0], [0.05, 0.05, 0.1]);
    slab([-0.05, -0.05, 0.0], [0.05, -0.04, 0.1]);
    slab([-0.05, 0.04, 0.0], [0.05, 0.05, 0.1]);
    let id = super::convert::pose(&Pose::identity());
    let gap = |parts: &[ConvexPart], p: &Point3<f64>| {
        let dot = ConvexPart::capsule(p.coords.into(), p.coords.into(), 1e-6).unwrap();
        parts
            .iter()
            .map(|s| distance((s, &s.place(&id)), (&dot, &dot.place(&id)), 10.0))
            .fold(f64::INFINITY, f64::min)
    };
    let hull = convex_parts(&v, None).unwrap();
    let parts = convex_parts(&v, Some(&t)).unwrap();
    assert!(hull.len() == 1 && parts.len() > 1, "{}", parts.len());
    for p in &v {
        assert!(gap(&parts, p) < 1e-3 && gap(&hull, p) < 1e-6, "{p} {}", gap(&parts, p));
    }
    let inside = Point3::new(0.0, 0.0, 0.07);
    assert!(gap(&hull, &inside) <= 0.0 && gap(&parts, &inside) > 0.02, "{}", gap(&parts, &inside));
}
