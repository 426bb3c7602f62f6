//! The committed object files are those that the example makes, and they hold together.

#[path = "../examples/make_objects.rs"]
mod make_objects;

use make_objects::{files, root};
use nalgebra::Point3;
use tdv_rendering::{ObjectFile, PartShape};

const NAMES: [&str; 17] = [
    "mug",
    "coaster",
    "bottle",
    "disc",
    "cube",
    "toy",
    "card",
    "ring",
    "peg",
    "wall",
    "tumbler",
    "cabinet",
    "drawer",
    "socket",
    "plug",
    "tissue_box",
    "tissue",
];
/// Objects whose origin does not lie on their underside.
const HANGING: [&str; 3] = ["cube", "drawer", "tissue"];

#[test]
fn committed_files_are_regenerated_byte_by_byte() {
    let made = files();
    assert_eq!(made.len(), 3 * NAMES.len() + 2 * 2);
    for (name, text) in made {
        let committed = std::fs::read_to_string(root().join(&name)).unwrap();
        assert!(
            committed == text,
            "{} differs: run `cargo run -p tdv-rendering --example make_objects`",
            name.display()
        );
    }
}

#[test]
fn every_object_loads_and_its_parts_lie_in_its_mesh() {
    for name in NAMES {
        let dir = root().join(name);
        let object = ObjectFile::load(&dir).unwrap();
        let mesh = object.load_mesh(&dir).unwrap();
        assert_eq!(object.name, name);
        assert!(mesh.triangles.len() < 3000 && mesh.volume() > 0.0, "{name}");
        let (low, high) = mesh.bounds();
        if !HANGING.contains(&name) {
            assert!(low.z.abs() < 1e-6, "{name} does not stand on its origin's plane");
        }
        let mut reach_low = [f64::MAX; 3];
        let mut reach_high = [f64::MIN; 3];
        for part in &object.collision {
            let half = match part.shape {
                PartShape::Box { half_extents } => half_extents,
                PartShape::Cylinder { radius, height } => [radius, radius, height / 2.0],
            };
            for corner in 0..8 {
                let sign = |bit: usize| if corner >> bit & 1 == 1 { 1.0 } else { -1.0 };
                let p = part.pose()
                    * Point3::new(half[0] * sign(0), half[1] * sign(1), half[2] * sign(2));
                for k in 0..3 {
                    // Corners of a turned wall box stick out by up to 2 mm.
                    assert!(
                        p[k] > low[k] - 2e-3 && p[k] < high[k] + 2e-3,
                        "{name}: part at {:?} leaves the mesh: {p}",
                        part.xyz
                    );
                    reach_low[k] = reach_low[k].min(p[k]);
                    reach_high[k] = reach_high[k].max(p[k]);
                }
            }
        }
        for k in 0..3 {
            assert!(reach_low[k] < low[k] + 3e-3 && reach_high[k] > high[k] - 3e-3, "{name} {k}");
        }
    }
}

#[test]
fn sizes_are_those_of_the_task() {
    let size = |name: &str| {
        let dir = root().join(name);
        let (low, high) = ObjectFile::load(&dir).unwrap().load_mesh(&dir).unwrap().bounds();
        (high - low).map(|v| (v * 1e4).round() / 10.0)
    };
    assert_eq!(size("mug").as_slice(), [98.0, 64.0, 90.0]);
    assert_eq!(size("coaster").as_slice(), [100.0, 100.0, 8.0]);
    assert_eq!(size("bottle").as_slice(), [90.0, 63.0, 190.0]);
    assert_eq!(size("disc").as_slice(), [120.0, 120.0, 6.0]);
    assert_eq!(size("cube").as_slice(), [85.0, 85.0, 85.0]);
}
