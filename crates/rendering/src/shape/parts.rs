use super::voxels::Voxels;
use crate::{CollisionPart, Mesh, PartShape};
use nalgebra::Point3;
use tdv_geometry::Symmetry;

/// Cubes along the longest side of an object that is cut into boxes.
const RESOLUTION: usize = 40;
/// Most boxes.
const MOST: usize = 32;
/// Part of the solid that may stay uncovered.
const SPARE: f64 = 0.03;
/// Slices of an object that is cut into cylinders.
const SLICES: usize = 48;

/// Convex parts for physics and collision checking, in the frame of the mesh: a pile of cylinders for
/// what is round about the vertical axis (its hollows are filled), else boxes along the axes.
/// Empty for a mesh without extent.
pub fn convex_parts(mesh: &Mesh, symmetry: &Symmetry) -> Vec<CollisionPart> {
    match symmetry {
        Symmetry::Continuous { axis } if axis[2].abs() > 0.999 => cylinders(mesh),
        _ => boxes(mesh),
    }
}

fn cylinders(mesh: &Mesh) -> Vec<CollisionPart> {
    let (low, high) = mesh.bounds();
    let middle = mesh.center();
    let height = (high.z - low.z).max(1e-9);
    let mut radius = vec![0.0_f64; SLICES];
    for s in mesh.surface_points(40 * SLICES * 8, 11) {
        let slice = ((s.point.z - low.z) / height * SLICES as f64) as usize;
        let r = (s.point.x - middle.x).hypot(s.point.y - middle.y);
        let slot = &mut radius[slice.min(SLICES - 1)];
        *slot = slot.max(r);
    }
    let widest = radius.iter().copied().fold(0.0, f64::max);
    let tolerance = (0.06 * widest).max(0.001);
    let mut out = Vec::new();
    let mut first = 0;
    while first < SLICES {
        let (mut least, mut most, mut last) = (radius[first], radius[first], first + 1);
        while last < SLICES && most.max(radius[last]) - least.min(radius[last]) <= tolerance {
            least = least.min(radius[last]);
            most = most.max(radius[last]);
            last += 1;
        }
        let z = |i: usize| low.z + height * i as f64 / SLICES as f64;
        // The middle of the range: no slice is off by more than half the tolerance.
        let r = round(0.5 * (least + most));
        if r > 0.0 {
            out.push(CollisionPart {
                shape: PartShape::Cylinder { radius: r, height: round(z(last) - z(first)) },
                xyz: [round(middle.x), round(middle.y), round(0.5 * (z(first) + z(last)))],
                rpy: [0.0; 3],
            });
        }
        first = last;
    }
    out
}

fn boxes(mesh: &Mesh) -> Vec<CollisionPart> {
    let v = Voxels::new(mesh, RESOLUTION);
    let (low, high) = mesh.bounds();
    let mut open: Vec<bool> = v.solid.clone();
    let total = open.iter().filter(|s| **s).count();
    let mut left = total;
    let depth = depths(&v);
    let mut out = Vec::new();
    while left as f64 > SPARE * total as f64 && out.len() < MOST {
        // Boxes grown from some of the deepest cubes that are still uncovered; the one that covers most.
        let mut seeds: Vec<usize> = (0..open.len()).filter(|i| open[*i]).collect();
        seeds.sort_by_key(|i| std::cmp::Reverse(depth[*i]));
        let step = (seeds.len() / 24).max(1);
        let best = seeds
            .iter()
            .step_by(step)
            .flat_map(|s| [[0, 1, 2], [1, 2, 0], [2, 0, 1]].map(|order| grow(&v, *s, order)))
            .max_by_key(|b| cells(&v, b).filter(|i| open[*i]).count());
        let Some(b) = best else { break };
        for i in cells(&v, &b).collect::<Vec<_>>() {
            left -= usize::from(std::mem::replace(&mut open[i], false));
        }
        out.push(part(&v, &b, &low, &high));
    }
    out
}

/// First and last cube along each axis.
type Range = [[usize; 2]; 3];

fn part(v: &Voxels, b: &Range, low: &Point3<f64>, high: &Point3<f64>) -> CollisionPart {
    let mut xyz = [0.0; 3];
    let mut half_extents = [0.0; 3];
    for k in 0..3 {
        let from = (v.low[k] + b[k][0] as f64 * v.edge).max(low[k]);
        let to = (v.low[k] + (b[k][1] + 1) as f64 * v.edge).min(high[k]);
        xyz[k] = round(0.5 * (from + to));
        half_extents[k] = round(0.5 * (to - from)).max(1e-4);
    }
    CollisionPart { shape: PartShape::Box { half_extents }, xyz, rpy: [0.0; 3] }
}

fn cells<'a>(v: &'a Voxels, b: &Range) -> impl Iterator<Item = usize> + 'a {
    let [x, y, z] = *b;
    (z[0]..=z[1]).flat_map(move |k| {
        (y[0]..=y[1]).flat_map(move |j| (x[0]..=x[1]).map(move |i| v.index([i, j, k])))
    })
}

/// Grows a box of solid cubes side by side, the axes in the given order, until no side can move.
fn grow(v: &Voxels, seed: usize, order: [usize; 3]) -> Range {
    let (w, h) = (v.size[0], v.size[1]);
    let at = [seed % w, seed / w % h, seed / (w * h)];
    let mut b: Range = at.map(|i| [i, i]);
    loop {
        let before = b;
        for k in order {
            for side in 0..2 {
                let mut layer = b;
                if side == 0 {
                    let Some(i) = b[k][0].checked_sub(1) else { continue };
                    layer[k] = [i, i];
                } else {
                    let i = b[k][1] + 1;
                    if i >= v.size[k] {
                        continue;
                    }
                    layer[k] = [i, i];
                }
                if cells(v, &layer).all(|i| v.solid[i]) {
                    b[k][side] = layer[k][0];
                }
            }
        }
        if b == before {
            return b;
        }
    }
}

/// Steps to the nearest empty cube, counted along the axes, by sweeping.
fn depths(v: &Voxels) -> Vec<u16> {
    let mut depth: Vec<u16> = v.solid.iter().map(|s| if *s { u16::MAX - 1 } else { 0 }).collect();
    let [w, h, d] = v.size;
    for round in 0..2 {
        for step in 0..w * h * d {
            let i = if round == 0 { step } else { w * h * d - 1 - step };
            let at = [i % w, i / w % h, i / (w * h)];
            let strides = [1, w, w * h];
            for k in 0..3 {
                let near = |inside: bool, j: usize| if inside { depth[j] } else { 0 };
                let low = near(at[k] > 0, i.wrapping_sub(strides[k]));
                let high = near(at[k] + 1 < v.size[k], (i + strides[k]).min(depth.len() - 1));
                depth[i] = depth[i].min(low.min(high) + 1);
            }
        }
    }
    depth
}

/// To a hundredth of a millimetre.
fn round(v: f64) -> f64 {
    let r = (v * 1e5).round() / 1e5;
    // No negative zero in the file.
    if r == 0.0 { 0.0 } else { r }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::primitives::{self, MugSize};

    /// Part of random points on which the parts and the mesh's solid agree, by rays.
    fn agreement(mesh: &Mesh, parts: &[CollisionPart]) -> f64 {
        let v = Voxels::new(mesh, 60);
        let mut same = 0;
        for z in 0..v.size[2] {
            for y in 0..v.size[1] {
                for x in 0..v.size[0] {
                    let p =
                        Point3::from([x, y, z].map(|i| (i as f64 + 0.5) * v.edge)) + v.low.coords;
                    let inside = parts.iter().any(|part| {
                        let q = part.pose().inverse() * p;
                        match part.shape {
                            PartShape::Box { half_extents: e } => {
                                (0..3).all(|k| q[k].abs() <= e[k])
                            }
                            PartShape::Cylinder { radius, height } => {
                                q.x.hypot(q.y) <= radius && q.z.abs() <= height / 2.0
                            }
                        }
                    });
                    same += usize::from(inside == v.solid[v.index([x, y, z])]);
                }
            }
        }
        same as f64 / v.solid.len() as f64
    }

    #[test]
    fn a_box_is_one_box_and_an_ell_is_two() {
        let mut m = primitives::cuboid([0.12, 0.06, 0.03], [1; 3]);
        let parts = convex_parts(&m, &Symmetry::None);
        assert_eq!(parts.len(), 1);
        let PartShape::Box { half_extents: e } = parts[0].shape else { panic!("no box") };
        assert!((e[0] - 0.06).abs() < 1e-4 && (e[2] - 0.015).abs() < 1e-4, "{e:?}");
        let up = tdv_geometry::pose_from_xyz_rpy([-0.045, 0.0, 0.065], [0.0; 3]);
        m.append(&primitives::cuboid([0.03, 0.06, 0.1], [1; 3]).transformed(&up));
        let parts = convex_parts(&m, &Symmetry::None);
        assert!(parts.len() <= 3, "{parts:?}");
        assert!(agreement(&m, &parts) > 0.94, "{}", agreement(&m, &parts));
    }

    #[test]
    fn round_things_are_piles_of_cylinders() {
        let profile =
            [[0.0, 0.0], [0.03, 0.0], [0.03, 0.12], [0.012, 0.15], [0.012, 0.18], [0.0, 0.18]];
        let bottle = primitives::lathe(&profile, 48, &[[9; 3]]);
        let parts = convex_parts(&bottle, &Symmetry::Continuous { axis: [0.0, 0.0, 1.0] });
        assert!((3..=20).contains(&parts.len()), "{}", parts.len());
        assert!(agreement(&bottle, &parts) > 0.95, "{}", agreement(&bottle, &parts));
    }

    #[test]
    fn a_mug_keeps_its_hollow_and_its_handle() {
        let mug = primitives::mug(&MugSize::default(), 48, [9; 3], [9; 3]);
        let parts = convex_parts(&mug, &Symmetry::None);
        assert!(parts.len() <= MOST);
        let score = agreement(&mug, &parts);
        assert!(score > 0.9, "{score}");
        // The middle of the hollow is free.
        let free = parts.iter().all(|p| {
            let q = p.pose().inverse() * Point3::new(0.0, 0.0, 0.06);
            let PartShape::Box { half_extents: e } = p.shape else { return false };
            (0..3).any(|k| q[k].abs() > e[k])
        });
        assert!(free);
    }
}
