//! The zero level of a field as a closed mesh: one vertex in every cell that the surface passes
//! through, at the mean of its crossings, and a square across every crossed edge (surface nets).

use super::carve::Field;
use tdv_rendering::Mesh;

/// Rounds of smoothing, which take the steps of carving away.
const SMOOTHING: usize = 3;

pub(super) fn extract(field: &Field, votes: u16) -> Mesh {
    let [w, h, d] = field.size;
    let value = |x: usize, y: usize, z: usize| {
        // The outermost corners count as empty: the mesh is closed whatever the field says.
        if x == 0 || y == 0 || z == 0 || x + 1 >= w || y + 1 >= h || z + 1 >= d {
            return field.value((z * h + y) * w + x, votes).min(-1e-4);
        }
        field.value((z * h + y) * w + x, votes)
    };
    let mut vertex = vec![u32::MAX; w * h * d];
    let mut mesh = Mesh::default();
    for z in 0..d - 1 {
        for y in 0..h - 1 {
            for x in 0..w - 1 {
                let corners: [f32; 8] =
                    std::array::from_fn(|i| value(x + (i & 1), y + (i >> 1 & 1), z + (i >> 2)));
                let solid = corners.iter().filter(|v| **v > 0.0).count();
                if solid == 0 || solid == 8 {
                    continue;
                }
                let (mut sum, mut n) = ([0.0_f64; 3], 0.0);
                for a in 0..8 {
                    for k in 0..3 {
                        let b = a | 1 << k;
                        if b == a || (corners[a] > 0.0) == (corners[b] > 0.0) {
                            continue;
                        }
                        let t = f64::from(corners[a] / (corners[a] - corners[b]));
                        for (j, s) in sum.iter_mut().enumerate() {
                            *s += (a >> j & 1) as f64 + if j == k { t } else { 0.0 };
                        }
                        n += 1.0;
                    }
                }
                vertex[(z * h + y) * w + x] = mesh.positions.len() as u32;
                let base = [x, y, z];
                mesh.positions.push(std::array::from_fn(|k| {
                    (field.low[k] + (base[k] as f64 + sum[k] / n) * field.step) as f32
                }));
            }
        }
    }
    let at = |x: usize, y: usize, z: usize| vertex[(z * h + y) * w + x];
    for z in 1..d - 1 {
        for y in 1..h - 1 {
            for x in 1..w - 1 {
                let here = value(x, y, z) > 0.0;
                let edges = [
                    (
                        value(x + 1, y, z) > 0.0,
                        [at(x, y - 1, z - 1), at(x, y, z - 1), at(x, y, z), at(x, y - 1, z)],
                    ),
                    (
                        value(x, y + 1, z) > 0.0,
                        [at(x - 1, y, z - 1), at(x - 1, y, z), at(x, y, z), at(x, y, z - 1)],
                    ),
                    (
                        value(x, y, z + 1) > 0.0,
                        [at(x - 1, y - 1, z), at(x, y - 1, z), at(x, y, z), at(x - 1, y, z)],
                    ),
                ];
                for (there, mut q) in edges {
                    if here == there || q.contains(&u32::MAX) {
                        continue;
                    }
                    // Seen from the empty side the corners turn to the left.
                    if !here {
                        q.reverse();
                    }
                    mesh.triangles.push([q[0], q[1], q[2]]);
                    mesh.triangles.push([q[0], q[2], q[3]]);
                }
            }
        }
    }
    smooth(&mut mesh);
    mesh.colors = vec![[160; 3]; mesh.positions.len()];
    mesh.uvs = vec![[0.0; 2]; mesh.positions.len()];
    mesh.recompute_normals();
    mesh
}

/// Taubin's pair of steps: evens the surface out without shrinking it. The underside stays flat.
fn smooth(mesh: &mut Mesh) {
    let mut neighbours: Vec<Vec<u32>> = vec![Vec::new(); mesh.positions.len()];
    for t in &mesh.triangles {
        for k in 0..3 {
            neighbours[t[k] as usize].push(t[(k + 1) % 3]);
        }
    }
    for _ in 0..SMOOTHING {
        for weight in [0.5_f32, -0.53] {
            let old = mesh.positions.clone();
            for (p, near) in mesh.positions.iter_mut().zip(&neighbours) {
                if near.is_empty() {
                    continue;
                }
                for k in 0..3 {
                    let mean =
                        near.iter().map(|i| old[*i as usize][k]).sum::<f32>() / near.len() as f32;
                    p[k] += weight * (mean - p[k]);
                }
            }
        }
    }
}
