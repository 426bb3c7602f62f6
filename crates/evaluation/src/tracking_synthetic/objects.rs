//! The benchmark's own objects: solids built from numbers, some of them printed, with their symmetries.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tdv_geometry::{Pose, Symmetry, pose_from_xyz_rpy};
use tdv_rendering::mesh::primitives::{
    MugSize, cuboid, cylinder, lathe, mug, rounded_cuboid, sphere, swept_bar, tapered_capsule,
};
use tdv_rendering::{Mesh, RgbImage};

/// An object of the benchmark.
#[derive(Debug, Clone)]
pub struct BenchObject {
    /// Name.
    pub name: &'static str,
    /// Surface (m, object frame).
    pub mesh: Mesh,
    /// Rotations that change neither its shape nor its colours.
    pub symmetry: Symmetry,
}

/// All objects, always in the same order and the same to the last bit.
pub fn objects() -> Vec<BenchObject> {
    let z_axis = Symmetry::Continuous { axis: [0.0, 0.0, 1.0] };
    let half_turn = Symmetry::Discrete { rotations: vec![[0.0, 0.0, 1.0, 0.0]] };
    let half_turns = Symmetry::Discrete {
        rotations: vec![[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
    };
    let object = |name, mesh, symmetry| BenchObject { name, mesh, symmetry };
    vec![
        object("box", printed_box(), Symmetry::None),
        object("can", cylinder(0.033, 0.115, 48, [176, 40, 46]), z_axis.clone()),
        object("labelled_can", labelled_can(), Symmetry::None),
        object("bottle", bottle(), half_turn),
        object("mug", mug(&MugSize::default(), 48, [38, 84, 168], [228, 222, 208]), Symmetry::None),
        object("bowl", bowl(), z_axis.clone()),
        object("soft_toy", soft_toy(), Symmetry::None),
        object("drill", drill(), Symmetry::None),
        object("card", rounded_cuboid([0.086, 0.054, 0.003], 0.001, [36, 130, 140]), half_turns),
        object("ring", ring(), z_axis),
        object("wedge", wedge(), Symmetry::None),
        object("cube", rounded_cuboid([0.060; 3], 0.002, [206, 150, 60]), Symmetry::Cube),
        object("spoon", spoon(), Symmetry::None),
    ]
}

fn at(mesh: &Mesh, xyz: [f64; 3], rpy: [f64; 3]) -> Mesh {
    mesh.transformed(&pose_from_xyz_rpy(xyz, rpy))
}

/// Coloured rectangles on a base colour, drawn from a seed: a print as on a package.
fn print(size: [u32; 2], base: [u8; 3], inks: &[[u8; 3]], pieces: usize, seed: u64) -> RgbImage {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = RgbImage::from_pixel(size[0], size[1], tdv_rendering::Rgb(base));
    for piece in 0..pieces {
        let ink = inks[piece % inks.len().max(1)];
        let w = rng.random_range(size[0] / 12..size[0] / 3);
        let h = rng.random_range(size[1] / 14..size[1] / 4);
        let x0 = rng.random_range(0..size[0] - w);
        let y0 = rng.random_range(0..size[1] - h);
        for y in y0..y0 + h {
            for x in x0..x0 + w {
                out.put_pixel(x, y, tdv_rendering::Rgb(ink));
            }
        }
    }
    out
}

/// 60 x 110 x 150 mm, the same print on all faces.
fn printed_box() -> Mesh {
    let mut mesh = cuboid([0.060, 0.110, 0.150], [255; 3]);
    let inks = [[240, 236, 220], [30, 60, 120], [230, 180, 40]];
    mesh.texture = Some(print([128, 128], [170, 40, 36], &inks, 11, 11));
    mesh
}

/// Round in shape; its label tells how far it is turned.
fn labelled_can() -> Mesh {
    let mut mesh = cylinder(0.034, 0.100, 64, [255; 3]);
    let inks = [[236, 232, 222], [200, 50, 40], [250, 210, 70], [20, 40, 70]];
    mesh.texture = Some(print([384, 192], [40, 110, 70], &inks, 26, 23));
    mesh
}

/// An oval squeeze bottle of 84 x 59 x 185 mm with a label band and a cap.
fn bottle() -> Mesh {
    let profile = [
        [0.0, 0.0],
        [0.040, 0.0],
        [0.042, 0.003],
        [0.042, 0.030],
        [0.042, 0.105],
        [0.041, 0.120],
        [0.032, 0.140],
        [0.018, 0.150],
        [0.018, 0.170],
        [0.008, 0.173],
        [0.004, 0.185],
        [0.0, 0.185],
    ];
    const BODY: [u8; 3] = [232, 190, 40];
    const CAP: [u8; 3] = [240, 236, 226];
    const LABEL: [u8; 3] = [150, 40, 44];
    let colors = [BODY, BODY, BODY, LABEL, BODY, BODY, BODY, CAP, CAP, CAP, CAP];
    lathe(&profile, 48, &colors).stretched([1.0, 0.7, 1.0])
}

/// A bowl of 140 x 55 mm.
fn bowl() -> Mesh {
    let profile = [
        [0.0, 0.0],
        [0.032, 0.0],
        [0.045, 0.006],
        [0.060, 0.025],
        [0.070, 0.055],
        [0.066, 0.055],
        [0.056, 0.026],
        [0.042, 0.010],
        [0.030, 0.005],
        [0.0, 0.005],
    ];
    const OUT: [u8; 3] = [64, 130, 90];
    const IN: [u8; 3] = [222, 214, 190];
    lathe(&profile, 48, &[OUT, OUT, OUT, OUT, IN, IN, IN, IN, IN])
}

/// A sitting bear of 145 mm.
fn soft_toy() -> Mesh {
    const FUR: [u8; 3] = [150, 96, 52];
    const PALE: [u8; 3] = [214, 178, 128];
    const DARK: [u8; 3] = [36, 28, 26];
    let mut out =
        at(&sphere(0.040, 28, FUR).stretched([0.85, 1.0, 1.15]), [0.0, 0.0, 0.046], [0.0; 3]);
    out.append(&at(&sphere(0.032, 28, FUR), [0.004, 0.0, 0.112], [0.0; 3]));
    out.append(&at(&sphere(0.014, 16, PALE), [0.032, 0.0, 0.105], [0.0; 3]));
    out.append(&at(&sphere(0.005, 10, DARK), [0.045, 0.0, 0.109], [0.0; 3]));
    out.append(&at(
        &sphere(0.026, 20, PALE).stretched([0.5, 1.0, 1.1]),
        [0.026, 0.0, 0.048],
        [0.0; 3],
    ));
    for side in [-1.0, 1.0] {
        out.append(&at(&sphere(0.012, 14, FUR), [0.0, side * 0.024, 0.138], [0.0; 3]));
        out.append(&at(&sphere(0.0045, 8, DARK), [0.033, side * 0.012, 0.120], [0.0; 3]));
        let arm = tapered_capsule(0.013, 0.011, 0.038, 18, FUR);
        out.append(&at(&arm, [0.008, side * 0.036, 0.072], [-side * 2.2, 0.5, 0.0]));
        let leg = tapered_capsule(0.017, 0.015, 0.036, 18, FUR);
        out.append(&at(&leg, [0.018, side * 0.026, 0.018], [0.0, 1.5, side * 0.35]));
    }
    out
}

/// A cordless drill of 175 x 165 mm: barrel, grip, battery, chuck.
fn drill() -> Mesh {
    const CASE: [u8; 3] = [30, 110, 116];
    const BLACK: [u8; 3] = [38, 38, 40];
    const STEEL: [u8; 3] = [150, 152, 156];
    let along_x = [0.0, std::f64::consts::FRAC_PI_2, 0.0];
    let mut out = at(&cylinder(0.027, 0.110, 36, CASE), [-0.050, 0.0, 0.135], along_x);
    out.append(&at(&cylinder(0.016, 0.040, 28, BLACK), [0.060, 0.0, 0.135], along_x));
    out.append(&at(&cylinder(0.004, 0.035, 12, STEEL), [0.100, 0.0, 0.135], along_x));
    let grip = rounded_cuboid([0.036, 0.030, 0.095], 0.010, BLACK);
    out.append(&at(&grip, [-0.022, 0.0, 0.074], [0.0, -0.15, 0.0]));
    out.append(&at(
        &rounded_cuboid([0.080, 0.050, 0.034], 0.006, CASE),
        [-0.012, 0.0, 0.017],
        [0.0; 3],
    ));
    out
}

/// A ring with one narrow end: 100 mm outside, 22 mm high.
fn ring() -> Mesh {
    let profile = [[0.034, 0.0], [0.050, 0.0], [0.044, 0.022], [0.034, 0.022], [0.034, 0.0]];
    lathe(&profile, 56, &[[168, 72, 130]])
}

/// A right-angled wedge, 110 x 60 x 50 mm, one end painted.
fn wedge() -> Mesh {
    let (x, y, z) = (0.110, 0.030, 0.050);
    let c = [[0.0, -y, 0.0], [x, -y, 0.0], [0.0, -y, z], [0.0, y, 0.0], [x, y, 0.0], [0.0, y, z]];
    const SIDE: [u8; 3] = [196, 110, 44];
    const RAMP: [u8; 3] = [70, 84, 150];
    let mut out = Mesh::default();
    let mut face = |corners: &[usize], color: [u8; 3]| {
        let base = out.positions.len() as u32;
        for i in corners {
            out.positions.push(c[*i].map(|v| v as f32));
            out.normals.push([0.0, 0.0, 1.0]);
            out.uvs.push([0.0; 2]);
            out.colors.push(color);
        }
        for k in 1..corners.len() as u32 - 1 {
            out.triangles.push([base, base + k, base + k + 1]);
        }
    };
    face(&[0, 3, 4, 1], SIDE);
    face(&[0, 1, 2], SIDE);
    face(&[3, 5, 4], SIDE);
    face(&[0, 2, 5, 3], SIDE);
    face(&[1, 4, 5, 2], RAMP);
    out.recompute_normals();
    out
}

/// A cooking spoon of 190 mm.
fn spoon() -> Mesh {
    const WOOD: [u8; 3] = [150, 88, 48];
    let path: Vec<[f64; 2]> =
        (0..=16).map(|i| f64::from(i) / 16.0).map(|t| [0.150 * t, 0.018 * t * t]).collect();
    let mut out = swept_bar(&path, 0.014, 0.009, WOOD);
    let bowl = sphere(0.026, 24, WOOD).stretched([1.15, 0.9, 0.32]);
    out.append(&bowl.transformed(&Pose::translation(-0.022, 0.0, 0.002)));
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_are_closed_solids_of_a_hands_size() {
        let all = objects();
        assert!(all.len() >= 12);
        for o in &all {
            let volume = o.mesh.volume();
            assert!((4e-6..2e-3).contains(&volume), "{}: {volume}", o.name);
            let d = o.mesh.diameter();
            assert!((0.06..0.26).contains(&d), "{}: {d}", o.name);
            assert!(o.mesh.triangles.len() < 20_000, "{}", o.name);
        }
    }

    #[test]
    fn stated_symmetries_bring_the_shape_onto_itself() {
        use tdv_geometry::nalgebra::{Point3, Vector3};
        for o in objects() {
            let turns = match &o.symmetry {
                Symmetry::Continuous { axis } => {
                    let axis = tdv_geometry::nalgebra::Unit::new_normalize(Vector3::from(*axis));
                    vec![tdv_geometry::nalgebra::UnitQuaternion::from_axis_angle(&axis, 1.0)]
                }
                other => other.rotations(),
            };
            let points: Vec<Point3<f64>> =
                o.mesh.positions.iter().map(|p| Point3::from(p.map(f64::from))).collect();
            for turn in turns {
                for p in points.iter().step_by(1 + points.len() / 150) {
                    let q = turn * p;
                    let near = points.iter().map(|r| (r - q).norm()).fold(f64::INFINITY, f64::min);
                    // A lathe's corners are up to half a segment apart.
                    assert!(near < 0.005, "{}: {near}", o.name);
                }
            }
        }
    }
}
