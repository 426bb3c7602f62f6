//! The hand's surface: an implicit blend of tapered bones, meshed by surface nets.

use super::grasp::FLESH;
use super::kinematics::{HandPose, HandShape};
use nalgebra::{Point3, Vector3};
use tdv_rendering::Mesh;

type P3 = Point3<f32>;
type V3 = Vector3<f32>;

/// Two balls and everything between them.
#[derive(Debug, Clone, Copy)]
struct Bone {
    from: P3,
    along: V3,
    inverse_square: f32,
    radii: [f32; 2],
}

impl Bone {
    fn new(from: &Point3<f64>, to: &Point3<f64>, r0: f64, r1: f64) -> Self {
        let (from, to) = (from.map(|v| v as f32), to.map(|v| v as f32));
        let along = to - from;
        let inverse_square = 1.0 / along.norm_squared().max(1e-12);
        Self { from, along, inverse_square, radii: [r0 as f32, r1 as f32] }
    }

    fn distance(&self, p: &P3) -> f32 {
        let v = p - self.from;
        let t = (v.dot(&self.along) * self.inverse_square).clamp(0.0, 1.0);
        (v - self.along * t).norm() - (self.radii[0] + (self.radii[1] - self.radii[0]) * t)
    }
}

/// Smooth minimum: blends over `k` metres.
fn blend(a: f32, b: f32, k: f32) -> f32 {
    let h = (k - (a - b).abs()).max(0.0) / k;
    a.min(b) - h * h * k * 0.25
}

/// Colours and mesh width of the skin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Skin {
    /// sRGB colour in full light.
    pub color: [u8; 3],
    /// sRGB colour of the sleeve.
    pub sleeve: [u8; 3],
    /// Bare forearm between wrist and sleeve (m).
    pub bare_forearm: f64,
    /// Length of the forearm (m).
    pub forearm: f64,
    /// Edge length of the surface grid (m).
    pub cell: f64,
    /// Factor on the standard flesh.
    pub thickness: f64,
}

impl Default for Skin {
    fn default() -> Self {
        Self {
            color: [224, 172, 138],
            sleeve: [70, 76, 84],
            bare_forearm: 0.10,
            forearm: 0.30,
            cell: 0.0040,
            thickness: 1.0,
        }
    }
}

/// The hand as a distance field: a palm and five fingers that melt into it but not into each other.
struct Field {
    palm: Vec<Bone>,
    fingers: [Vec<Bone>; 5],
}

impl Field {
    fn distance(&self, p: &P3) -> f32 {
        let palm = self.palm.iter().fold(1.0, |d, bone| blend(d, bone.distance(p), 0.012));
        self.fingers.iter().fold(palm, |nearest, bones| {
            let finger = bones.iter().fold(1.0, |d, bone| blend(d, bone.distance(p), 0.003));
            // Fingers lying side by side keep a crease between them.
            blend(nearest, blend(finger, palm, 0.009), 0.0012)
        })
    }

    fn gradient(&self, p: &P3) -> V3 {
        let e = 5e-4;
        let d = |x: f32, y: f32, z: f32| self.distance(&(p + V3::new(x, y, z)));
        V3::new(
            d(e, 0.0, 0.0) - d(-e, 0.0, 0.0),
            d(0.0, e, 0.0) - d(0.0, -e, 0.0),
            d(0.0, 0.0, e) - d(0.0, 0.0, -e),
        ) / (2.0 * e)
    }

    fn bones(&self) -> impl Iterator<Item = &Bone> {
        self.palm.iter().chain(self.fingers.iter().flatten())
    }
}

impl Skin {
    /// The hand's surface in the frame of `pose.palm`'s parent. `elbow` (same frame) says where the
    /// forearm goes.
    pub fn mesh(&self, shape: &HandShape, pose: &HandPose, elbow: &Point3<f64>) -> Mesh {
        // In the palm frame the grid moves with the hand and the surface does not shimmer.
        let local = HandPose { palm: tdv_geometry::Pose::identity(), ..*pose };
        let joints = shape.joints(&local);
        let elbow = pose.palm.inverse() * elbow;
        let field = self.field(&joints, &elbow);
        let mut mesh = surface_net(&field, self.cell as f32);
        self.paint(&mut mesh, &field, &joints, &elbow);
        mesh.transformed(&pose.palm)
    }

    fn field(&self, j: &[Point3<f64>; 21], elbow: &Point3<f64>) -> Field {
        let f = self.thickness;
        let bone =
            |a: &Point3<f64>, b: &Point3<f64>, r0: f64, r1: f64| Bone::new(a, b, r0 * f, r1 * f);
        let size = (j[9] - j[0]).norm() / 0.096;
        let at = |x: f64, y: f64, z: f64| Point3::new(x * size, y * size, z * size);
        let mut palm = Vec::new();
        // Metacarpals from across the wrist, and the knuckles' row.
        for (k, y) in [(5, 0.012), (9, 0.004), (13, -0.006), (17, -0.014)] {
            palm.push(bone(&at(0.004, y, 0.0), &j[k], 0.0150, FLESH[k] * 1.08));
        }
        for (a, b) in [(5, 9), (9, 13), (13, 17)] {
            palm.push(bone(&j[a], &j[b], FLESH[a], FLESH[b]));
        }
        // The heel of the hand and the ball of the thumb.
        palm.push(bone(&at(0.012, -0.018, -0.010), &at(0.060, -0.028, -0.008), 0.0150, 0.0120));
        palm.push(bone(&at(0.014, 0.012, -0.008), &j[1], 0.0160, 0.0160));
        palm.push(bone(&j[1], &j[2], 0.0165, 0.0120));
        palm.push(bone(&at(0.030, 0.010, -0.008), &nalgebra::center(&j[1], &j[2]), 0.014, 0.012));
        // The web between thumb and index.
        let web = nalgebra::center(&j[1], &j[2]);
        palm.push(bone(&web, &at(0.062, 0.022, -0.002), 0.0105, 0.0105));
        // The forearm is wider than thick: two bones side by side.
        let along = (elbow - j[0]).normalize();
        let end = j[0] + along * self.forearm;
        let side = Vector3::y() - along * along.y;
        let side = side.try_normalize(1e-6).unwrap_or_else(Vector3::z);
        for s in [-1.0, 1.0] {
            let (near, far) = (side * (0.010 * s * size), side * (0.018 * s * size));
            palm.push(bone(&(j[0] + near), &(end + far), 0.0175, 0.0280));
        }
        let finger = |ids: [usize; 4]| -> Vec<Bone> {
            ids.windows(2).map(|w| bone(&j[w[0]], &j[w[1]], FLESH[w[0]], FLESH[w[1]])).collect()
        };
        let fingers = [
            finger([1, 2, 3, 4])[1..].to_vec(),
            finger([5, 6, 7, 8]),
            finger([9, 10, 11, 12]),
            finger([13, 14, 15, 16]),
            finger([17, 18, 19, 20]),
        ];
        Field { palm, fingers }
    }

    fn paint(&self, mesh: &mut Mesh, field: &Field, j: &[Point3<f64>; 21], elbow: &Point3<f64>) {
        let joint = j.map(|p| p.map(|v| v as f32));
        let along = (elbow - j[0]).normalize().map(|v| v as f32);
        let skin = self.color.map(f32::from);
        for k in 0..mesh.positions.len() {
            let p = P3::from(mesh.positions[k]);
            let n = V3::from(mesh.normals[k]);
            // Open sky above the skin: 1 on an open surface, less between fingers and in folds.
            let open = |h: f32| (field.distance(&(p + n * h)) / h).clamp(0.0, 1.0);
            let shade = 0.55 + 0.25 * open(0.006) + 0.20 * open(0.018);
            let mut color = skin;
            // Blood shows at fingertips and knuckles.
            let near = |ids: &[usize], reach: f32| {
                let d = ids.iter().map(|&i| (p - joint[i]).norm()).fold(f32::MAX, f32::min);
                (1.0 - d / reach).clamp(0.0, 1.0)
            };
            let flush =
                0.5 * near(&[4, 8, 12, 16, 20], 0.018) + 0.3 * near(&[6, 10, 14, 18, 3], 0.014);
            color[1] -= 22.0 * flush;
            color[2] -= 18.0 * flush;
            for (tip, before) in [(4, 3), (8, 7), (12, 11), (16, 15), (20, 19)] {
                if is_nail(&p, &n, &joint[tip], &joint[before], &joint) {
                    color = [236.0, 196.0, 182.0];
                }
            }
            if (p - joint[0]).dot(&along) > self.bare_forearm as f32 {
                color = self.sleeve.map(f32::from);
            }
            mesh.colors[k] = color.map(|v| (v * shade).clamp(0.0, 255.0) as u8);
        }
    }
}

/// Whether a surface point belongs to the nail of a finger: near its tip, on its back.
fn is_nail(p: &P3, n: &V3, tip: &P3, before: &P3, joints: &[P3; 21]) -> bool {
    let along = (tip - before).normalize();
    let reach = (p - tip).dot(&along);
    if !(-0.009..0.003).contains(&reach) || (p - tip).norm() > 0.014 {
        return false;
    }
    // The back is where the finger's bend opens; a thumb's back points away from the index.
    let back = if (before - joints[3]).norm() < 1e-6 { before - joints[5] } else { V3::z() };
    let back = back - along * back.dot(&along);
    back.try_normalize(1e-6).is_some_and(|b| n.dot(&b) > 0.75)
}

/// Meshes the zero surface: one vertex in each grid cell that it crosses.
fn surface_net(field: &Field, cell: f32) -> Mesh {
    let (mut low, mut high) = (P3::new(1e9, 1e9, 1e9), P3::new(-1e9, -1e9, -1e9));
    for bone in field.bones() {
        for (p, r) in [(bone.from, bone.radii[0]), (bone.from + bone.along, bone.radii[1])] {
            for k in 0..3 {
                low[k] = low[k].min(p[k] - r - 2.0 * cell);
                high[k] = high[k].max(p[k] + r + 2.0 * cell);
            }
        }
    }
    let size: [usize; 3] = std::array::from_fn(|k| ((high[k] - low[k]) / cell) as usize + 2);
    let index = |x: usize, y: usize, z: usize| (z * size[1] + y) * size[0] + x;
    let node = |x: usize, y: usize, z: usize| {
        low + V3::new(x as f32 * cell, y as f32 * cell, z as f32 * cell)
    };
    let values = sample(field, size, cell, &node);
    let mut vertex = vec![u32::MAX; values.len()];
    let mut mesh = Mesh::default();
    for z in 0..size[2] - 1 {
        for y in 0..size[1] - 1 {
            for x in 0..size[0] - 1 {
                let corner: [f32; 8] = std::array::from_fn(|c| {
                    values[index(x + (c & 1), y + (c >> 1 & 1), z + (c >> 2))]
                });
                let inside = corner.iter().filter(|v| **v < 0.0).count();
                if inside == 0 || inside == 8 {
                    continue;
                }
                let mut sum = V3::zeros();
                let mut crossings = 0.0;
                for a in 0..8_usize {
                    for axis in 0..3 {
                        let b = a | 1 << axis;
                        if b == a || (corner[a] < 0.0) == (corner[b] < 0.0) {
                            continue;
                        }
                        let t = corner[a] / (corner[a] - corner[b]);
                        let mut v = V3::new((a & 1) as f32, (a >> 1 & 1) as f32, (a >> 2) as f32);
                        v[axis] = t;
                        sum += v;
                        crossings += 1.0;
                    }
                }
                let mut p = node(x, y, z) + sum * (cell / crossings);
                // One step down the field brings the averaged vertex onto the surface.
                let g = field.gradient(&p);
                p -= g * (field.distance(&p) / g.norm_squared().max(0.1));
                let n = field.gradient(&p).try_normalize(1e-6).unwrap_or_else(V3::z);
                vertex[index(x, y, z)] = mesh.positions.len() as u32;
                mesh.positions.push(p.into());
                mesh.normals.push(n.into());
                mesh.uvs.push([0.0; 2]);
                mesh.colors.push([0; 3]);
            }
        }
    }
    for z in 1..size[2] - 1 {
        for y in 1..size[1] - 1 {
            for x in 1..size[0] - 1 {
                let here = values[index(x, y, z)] < 0.0;
                let v = |dx: usize, dy: usize, dz: usize| vertex[index(x - dx, y - dy, z - dz)];
                let quads = [
                    (index(x + 1, y, z), [v(0, 1, 1), v(0, 0, 1), v(0, 0, 0), v(0, 1, 0)]),
                    (index(x, y + 1, z), [v(1, 0, 1), v(1, 0, 0), v(0, 0, 0), v(0, 0, 1)]),
                    (index(x, y, z + 1), [v(1, 1, 0), v(0, 1, 0), v(0, 0, 0), v(1, 0, 0)]),
                ];
                for (there, q) in quads {
                    if here == (values[there] < 0.0) || q.contains(&u32::MAX) {
                        continue;
                    }
                    let q = if here { q } else { [q[3], q[2], q[1], q[0]] };
                    mesh.triangles.push([q[0], q[1], q[2]]);
                    mesh.triangles.push([q[0], q[2], q[3]]);
                }
            }
        }
    }
    mesh
}

/// Field values at the grid nodes; far from the surface one value serves a block of nodes.
fn sample(
    field: &Field,
    size: [usize; 3],
    cell: f32,
    node: &impl Fn(usize, usize, usize) -> P3,
) -> Vec<f32> {
    const BLOCK: usize = 6;
    let mut values = vec![1.0_f32; size[0] * size[1] * size[2]];
    // Half the block's diagonal, and what the blending may take off the distance.
    let margin = cell * BLOCK as f32 * 0.87 + 0.012;
    let blocks = size.map(|n| n.div_ceil(BLOCK));
    for bz in 0..blocks[2] {
        for by in 0..blocks[1] {
            for bx in 0..blocks[0] {
                let (x0, y0, z0) = (bx * BLOCK, by * BLOCK, bz * BLOCK);
                let half = BLOCK as f32 * cell / 2.0;
                let middle = field.distance(&(node(x0, y0, z0) + V3::new(half, half, half)));
                let far = middle.abs() > margin;
                for z in z0..(z0 + BLOCK).min(size[2]) {
                    for y in y0..(y0 + BLOCK).min(size[1]) {
                        for x in x0..(x0 + BLOCK).min(size[0]) {
                            let i = (z * size[1] + y) * size[0] + x;
                            values[i] = if far { middle } else { field.distance(&node(x, y, z)) };
                        }
                    }
                }
            }
        }
    }
    values
}
