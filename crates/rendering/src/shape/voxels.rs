use crate::Mesh;
use nalgebra::{Point3, Vector3};

/// The solid of a mesh as cubes of one size.
pub(super) struct Voxels {
    pub size: [usize; 3],
    /// Lower corner of the grid (m).
    pub low: Point3<f64>,
    /// Edge (m).
    pub edge: f64,
    pub solid: Vec<bool>,
}

impl Voxels {
    /// `count` cubes along the longest side. A cube is solid if its centre is inside by the vote of
    /// three rays (a hole in the mesh misleads one), or if the surface passes through it and nothing
    /// solid is next to it: thin walls stay.
    pub fn new(mesh: &Mesh, count: usize) -> Self {
        let (low, high) = mesh.bounds();
        let span = high - low;
        let edge = (span.max() / count as f64).max(1e-9);
        let size: [usize; 3] =
            std::array::from_fn(|k| ((span[k] / edge).round() as usize).clamp(1, count));
        // The grid is centred on the mesh.
        let low =
            nalgebra::center(&low, &high) - Vector3::from_fn(|k, _| size[k] as f64 * edge / 2.0);
        let mut votes = vec![0_u8; size[0] * size[1] * size[2]];
        for axis in 0..3 {
            vote(mesh, axis, &size, &low, edge, &mut votes);
        }
        let mut out = Self { size, low, edge, solid: votes.iter().map(|v| *v >= 2).collect() };
        out.add_thin(mesh);
        out
    }

    pub fn index(&self, at: [usize; 3]) -> usize {
        (at[2] * self.size[1] + at[1]) * self.size[0] + at[0]
    }

    fn add_thin(&mut self, mesh: &Mesh) {
        let count = 8 * self.size.iter().product::<usize>().min(30_000);
        let mut thin = Vec::new();
        for s in mesh.surface_points(count, 7) {
            let at: [usize; 3] = std::array::from_fn(|k| {
                let i = (s.point[k] - self.low[k]) / self.edge;
                (i.max(0.0) as usize).min(self.size[k] - 1)
            });
            let range = |k: usize| at[k].saturating_sub(1)..=(at[k] + 1).min(self.size[k] - 1);
            let near = range(0)
                .any(|x| range(1).any(|y| range(2).any(|z| self.solid[self.index([x, y, z])])));
            if !near {
                thin.push(self.index(at));
            }
        }
        for i in thin {
            self.solid[i] = true;
        }
    }
}

/// Adds one vote to every cube whose centre has an odd number of crossings before it along an axis.
fn vote(
    mesh: &Mesh,
    axis: usize,
    size: &[usize; 3],
    low: &Point3<f64>,
    edge: f64,
    votes: &mut [u8],
) {
    let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut crossings: Vec<Vec<f64>> = vec![Vec::new(); size[a] * size[b]];
    // A little off the grid's regular places, so that no ray meets an edge of a regular mesh.
    let centre = |k: usize, i: usize| low[k] + (i as f64 + 0.5 + 1.7e-4 * (k + 1) as f64) * edge;
    for t in &mesh.triangles {
        let p = t.map(|i| mesh.positions[i as usize].map(f64::from));
        let range = |k: usize| {
            let from = p.iter().map(|c| c[k]).fold(f64::MAX, f64::min);
            let to = p.iter().map(|c| c[k]).fold(f64::MIN, f64::max);
            let first = ((from - low[k]) / edge - 1.0).max(0.0) as usize;
            let last = ((to - low[k]) / edge + 1.0).max(0.0) as usize;
            first..(last + 1).min(size[k])
        };
        let area =
            (p[1][a] - p[0][a]) * (p[2][b] - p[0][b]) - (p[2][a] - p[0][a]) * (p[1][b] - p[0][b]);
        if area.abs() < 1e-18 {
            continue;
        }
        for j in range(b) {
            for i in range(a) {
                let (x, y) = (centre(a, i), centre(b, j));
                let u = ((x - p[0][a]) * (p[2][b] - p[0][b]) - (p[2][a] - p[0][a]) * (y - p[0][b]))
                    / area;
                let v = ((p[1][a] - p[0][a]) * (y - p[0][b]) - (x - p[0][a]) * (p[1][b] - p[0][b]))
                    / area;
                if u >= 0.0 && v >= 0.0 && u + v <= 1.0 {
                    let at =
                        p[0][axis] + u * (p[1][axis] - p[0][axis]) + v * (p[2][axis] - p[0][axis]);
                    crossings[j * size[a] + i].push(at);
                }
            }
        }
    }
    for j in 0..size[b] {
        for i in 0..size[a] {
            let at = &crossings[j * size[a] + i];
            if at.is_empty() {
                continue;
            }
            for k in 0..size[axis] {
                let c = centre(axis, k);
                if at.iter().filter(|z| **z < c).count() % 2 == 1 {
                    let mut place = [0; 3];
                    place[axis] = k;
                    place[a] = i;
                    place[b] = j;
                    votes[(place[2] * size[1] + place[1]) * size[0] + place[0]] += 1;
                }
            }
        }
    }
}
