use crate::Mesh;
use nalgebra::{Point3, Unit, UnitQuaternion, Vector3};
use std::collections::HashMap;
use std::f64::consts::TAU;
use tdv_geometry::Symmetry;

/// Points that are turned.
const PROBES: usize = 1500;
/// Points that they are compared with.
const TARGETS: usize = 20_000;
/// Share of the points that must come to lie on the surface: a handle of a few per cent decides.
const SHARE: f64 = 0.98;
/// Distance from the surface that still counts as on it, as a part of the diameter.
const TOLERANCE: f64 = 0.022;
/// Orders of a finite symmetry that are looked for, the highest first.
const ORDERS: [usize; 7] = [12, 8, 6, 5, 4, 3, 2];

/// What was found.
#[derive(Debug, Clone, PartialEq)]
pub struct SymmetryReport {
    /// The symmetry of the shape, in the frame in which the mesh was given.
    pub symmetry: Symmetry,
    /// How far the turned surface lies off (98th percentile, as a part of the diameter) for the symmetry
    /// that was found, or for the best one that was refused.
    pub deviation: f64,
    /// Whether the colours are not symmetric (a label on one side): the tracker sees shape and outline
    /// only, and cannot tell the equivalent poses apart all the same.
    pub colors_differ: bool,
}

/// The symmetry of a mesh about the vertical axis through the middle of its bounding box: any turn,
/// turns of a whole part of the circle, or those of a cube. Other axes do not matter for things that
/// stand on one side. Points are drawn from `seed`.
pub fn find_symmetry(mesh: &Mesh, seed: u64) -> SymmetryReport {
    let surface = Surface::new(mesh, seed);
    let turn = |axis: Vector3<f64>, angle: f64| {
        UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis), angle)
    };
    let vertical = Vector3::z();
    // Angles that share no small whole part of the circle.
    let worst = [0.31, 0.83, 1.27, 1.93, 2.51, 2.97]
        .map(|a| surface.deviation(&turn(vertical, a)))
        .into_iter()
        .fold((0.0, false), |w: (f64, bool), d| (w.0.max(d.0), w.1 | d.1));
    if worst.0 < TOLERANCE {
        let symmetry = Symmetry::Continuous { axis: [0.0, 0.0, 1.0] };
        return SymmetryReport { symmetry, deviation: worst.0, colors_differ: worst.1 };
    }
    let mut refused = worst.0;
    for order in ORDERS {
        let step = TAU / order as f64;
        let (mut deviation, mut colors_differ) = surface.deviation(&turn(vertical, step));
        if deviation >= TOLERANCE {
            refused = refused.min(deviation);
            continue;
        }
        let mut symmetry = Symmetry::Discrete {
            rotations: (1..order)
                .map(|k| {
                    let q = turn(vertical, step * k as f64);
                    [q.i, q.j, q.k, q.w].map(|v| if v.abs() < 1e-12 { 0.0 } else { v })
                })
                .collect(),
        };
        let quarter = surface.deviation(&turn(Vector3::x(), TAU / 4.0));
        if order == 4 && quarter.0 < TOLERANCE {
            symmetry = Symmetry::Cube;
            deviation = deviation.max(quarter.0);
            colors_differ |= quarter.1;
        }
        return SymmetryReport { symmetry, deviation, colors_differ };
    }
    SymmetryReport { symmetry: Symmetry::None, deviation: refused, colors_differ: false }
}

/// Points of the surface in a grid, about the middle of the bounding box.
struct Surface {
    probes: Vec<(Point3<f64>, [u8; 3])>,
    targets: Vec<(Point3<f64>, Vector3<f64>, [u8; 3])>,
    grid: HashMap<[i32; 3], Vec<u32>>,
    cell: f64,
    /// Typical distance between targets.
    spacing: f64,
    diameter: f64,
}

impl Surface {
    fn new(mesh: &Mesh, seed: u64) -> Self {
        let middle = mesh.center().coords;
        let diameter = mesh.diameter().max(1e-9);
        let targets: Vec<_> = mesh
            .surface_points(TARGETS, seed)
            .iter()
            .map(|s| (s.point - middle, s.normal, s.color))
            .collect();
        let probes = mesh.surface_points(PROBES, seed.wrapping_add(1));
        let cell = diameter / 40.0;
        let mut grid: HashMap<[i32; 3], Vec<u32>> = HashMap::new();
        for (i, t) in targets.iter().enumerate() {
            grid.entry(key(&t.0, cell)).or_default().push(i as u32);
        }
        // At most the area of the bounding sphere's two sides.
        let spacing = diameter * 1.8 / (TARGETS as f64).sqrt();
        let probes = probes.iter().map(|s| (s.point - middle, s.color)).collect();
        Self { probes, targets, grid, cell, spacing, diameter }
    }

    /// Percentile of the distances after a turn, as a part of the diameter, and whether colours differ.
    fn deviation(&self, turn: &UnitQuaternion<f64>) -> (f64, bool) {
        let mut distances = Vec::with_capacity(self.probes.len());
        let mut different = 0;
        for (p, color) in &self.probes {
            let q = turn * p;
            let (distance, index) = self.nearest(&q);
            distances.push(distance / self.diameter);
            let gap = index.map_or(0, |i| {
                let other = self.targets[i].2;
                (0..3).map(|k| i32::from(color[k].abs_diff(other[k]))).sum()
            });
            different += usize::from(gap > 120);
        }
        distances.sort_by(f64::total_cmp);
        let at = (SHARE * distances.len() as f64) as usize;
        let deviation = distances.get(at).or(distances.last()).copied().unwrap_or(1.0);
        (deviation, different * 12 > self.probes.len())
    }

    /// Distance to the surface near a point; far ones are only known to be far.
    fn nearest(&self, q: &Point3<f64>) -> (f64, Option<usize>) {
        let k = key(q, self.cell);
        let mut best: Option<(f64, usize)> = None;
        for dx in -1..=1 {
            for dy in -1..=1 {
                for dz in -1..=1 {
                    let near = self.grid.get(&[k[0] + dx, k[1] + dy, k[2] + dz]);
                    for i in near.into_iter().flatten() {
                        let d = (self.targets[*i as usize].0 - q).norm_squared();
                        if best.is_none_or(|b| d < b.0) {
                            best = Some((d, *i as usize));
                        }
                    }
                }
            }
        }
        let Some((square, i)) = best else { return (self.cell, None) };
        let (t, n, _) = self.targets[i];
        let distance = square.sqrt();
        // Near samples stand for the plane around them: their spacing must not count as distance.
        if distance < 2.0 * self.spacing {
            ((t - q).dot(&n).abs(), Some(i))
        } else {
            (distance, Some(i))
        }
    }
}

fn key(p: &Point3<f64>, cell: f64) -> [i32; 3] {
    [p.x, p.y, p.z].map(|v| (v / cell).floor() as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::primitives::{self, MugSize};

    fn of(mesh: &Mesh) -> Symmetry {
        let r = find_symmetry(mesh, 3);
        println!("{:?} {:.4} {}", r.symmetry, r.deviation, r.colors_differ);
        r.symmetry
    }

    #[test]
    fn what_the_catalogue_says_is_found_in_its_meshes() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/objects");
        for name in ["mug", "coaster", "bottle", "disc", "cube"] {
            let dir = root.join(name);
            let file = crate::ObjectFile::load(&dir).unwrap();
            let found = of(&file.load_mesh(&dir).unwrap());
            match (&found, &file.symmetry) {
                (Symmetry::Discrete { rotations: a }, Symmetry::Discrete { rotations: b }) => {
                    assert_eq!(a.len(), b.len(), "{name}");
                }
                (a, b) => assert_eq!(a, b, "{name}"),
            }
        }
    }

    #[test]
    fn prisms_and_odd_things() {
        let order = |m: &Mesh| match of(m) {
            Symmetry::Discrete { rotations } => rotations.len() + 1,
            _ => 0,
        };
        assert_eq!(order(&primitives::cuboid([0.1, 0.06, 0.04], [1; 3])), 2);
        assert_eq!(order(&primitives::cuboid([0.1, 0.1, 0.04], [1; 3])), 4);
        assert_eq!(order(&primitives::cylinder(0.05, 0.1, 6, [1; 3])), 6);
        assert_eq!(order(&primitives::cylinder(0.05, 0.1, 3, [1; 3])), 0, "its box is off centre");
        let size = MugSize::default();
        let mug = primitives::mug(&size, 48, [9; 3], [9; 3]);
        assert_eq!(of(&mug), Symmetry::None);
        // A label on one half does not change the shape.
        let mut half = primitives::cylinder(0.04, 0.12, 48, [220, 20, 20]);
        for (p, c) in half.positions.iter().zip(&mut half.colors) {
            if p[0] > 0.0 {
                *c = [20, 20, 220];
            }
        }
        let r = find_symmetry(&half, 3);
        assert_eq!(r.symmetry, Symmetry::Continuous { axis: [0.0, 0.0, 1.0] });
        assert!(r.colors_differ);
    }
}
