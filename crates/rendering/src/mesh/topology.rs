use super::Mesh;
use std::collections::HashMap;

/// How the triangles of a mesh hang together, after vertices at the same place are taken as one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Topology {
    /// Edges of at least one triangle.
    pub edges: usize,
    /// Edges of one triangle only: the rims of holes.
    pub open: usize,
    /// Edges of more than two triangles: there the surface has no inside.
    pub crowded: usize,
    /// Edges of two triangles that are wound against each other.
    pub twisted: usize,
}

impl Topology {
    /// Whether the mesh bounds a solid.
    pub fn closed(&self) -> bool {
        self.edges > 0 && self.open == 0 && self.crowded == 0 && self.twisted == 0
    }

    /// Whether a part of the edges larger than `fraction` has no inside and outside.
    pub fn broken(&self, fraction: f64) -> bool {
        (self.crowded + self.twisted) as f64 > fraction * self.edges as f64
    }
}

impl Mesh {
    /// Counts the edges by the number of their triangles.
    pub fn topology(&self) -> Topology {
        let step = f64::max(self.diameter() * 1e-6, 1e-12);
        let welded = self.cells(step);
        let mut edges: HashMap<(u32, u32), (u32, u32)> = HashMap::new();
        for t in &self.triangles {
            let t = t.map(|i| welded[i as usize]);
            if t[0] == t[1] || t[1] == t[2] || t[2] == t[0] {
                continue;
            }
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                let counts = edges.entry((a.min(b), a.max(b))).or_default();
                if a < b {
                    counts.0 += 1;
                } else {
                    counts.1 += 1;
                }
            }
        }
        let mut out = Topology { edges: edges.len(), ..Topology::default() };
        for (there, back) in edges.values() {
            match there + back {
                1 => out.open += 1,
                2 if there != back => out.twisted += 1,
                2 => {}
                _ => out.crowded += 1,
            }
        }
        out
    }

    /// The mesh with its triangles wound outwards, if it was inside out.
    #[must_use]
    pub fn outward(mut self) -> Self {
        if self.volume() < 0.0 {
            for t in &mut self.triangles {
                t.swap(1, 2);
            }
            for n in &mut self.normals {
                *n = n.map(|v| -v);
            }
        }
        self
    }

    /// At most about `most` triangles: vertices of one grid cell become one, the grid as fine as that
    /// allows. A texture goes into the vertex colours. The mesh itself if it is small enough.
    #[must_use]
    pub fn simplified(&self, most: usize) -> Self {
        if self.triangles.len() <= most {
            return self.clone();
        }
        let mut fine = self.clone();
        fine.bake_texture();
        let fine = fine;
        let corner = |i: u32| nalgebra::Vector3::from(fine.positions[i as usize].map(f64::from));
        let area: f64 = fine
            .triangles
            .iter()
            .map(|t| t.map(corner))
            .map(|[a, b, c]| (b - a).cross(&(c - a)).norm() / 2.0)
            .sum();
        // Two triangles for each cell that the surface passes through, and it passes through more than
        // its area needs.
        let mut step = (2.0 * area / most.max(1) as f64).sqrt().max(fine.diameter() * 1e-4);
        loop {
            let out = fine.clustered(step);
            if out.triangles.len() <= most {
                return out;
            }
            step *= 1.1;
        }
    }

    fn clustered(&self, step: f64) -> Self {
        let cell = self.cells(step);
        let count = cell.iter().max().map_or(0, |m| *m as usize + 1);
        let mut sums = vec![([0.0_f64; 3], [0.0_f64; 3], 0.0_f64); count];
        for (i, c) in cell.iter().enumerate() {
            let s = &mut sums[*c as usize];
            for k in 0..3 {
                s.0[k] += f64::from(self.positions[i][k]);
                s.1[k] += f64::from(self.colors[i][k]);
            }
            s.2 += 1.0;
        }
        let mut out = Mesh {
            positions: sums.iter().map(|s| s.0.map(|v| (v / s.2) as f32)).collect(),
            colors: sums.iter().map(|s| s.1.map(|v| (v / s.2).round() as u8)).collect(),
            uvs: vec![[0.0; 2]; count],
            ..Mesh::default()
        };
        // Two layers that fall onto each other cancel out, so that what was closed stays closed.
        let mut net: HashMap<[u32; 3], i32> = HashMap::new();
        let mut kept = Vec::new();
        for t in &self.triangles {
            let t = t.map(|i| cell[i as usize]);
            if t[0] == t[1] || t[1] == t[2] || t[2] == t[0] {
                continue;
            }
            let least = (0..3).min_by_key(|k| t[*k]).unwrap_or(0);
            let turned = [t[least], t[(least + 1) % 3], t[(least + 2) % 3]];
            let forward = turned[1] < turned[2];
            let key = if forward { turned } else { [turned[0], turned[2], turned[1]] };
            *net.entry(key).or_insert(0) += if forward { 1 } else { -1 };
            kept.push(key);
        }
        for key in kept {
            // The first one that names it writes what is left of it.
            if let Some(n) = net.remove(&key) {
                let t = if n > 0 { key } else { [key[0], key[2], key[1]] };
                out.triangles.extend(std::iter::repeat_n(t, n.unsigned_abs() as usize));
            }
        }
        out.recompute_normals();
        out
    }

    /// Number of the grid cell of each vertex, in order of first appearance.
    fn cells(&self, step: f64) -> Vec<u32> {
        let mut numbers: HashMap<[i64; 3], u32> = HashMap::with_capacity(self.positions.len());
        self.positions
            .iter()
            .map(|p| {
                let key = p.map(|v| (f64::from(v) / step).round() as i64);
                let next = numbers.len() as u32;
                *numbers.entry(key).or_insert(next)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::primitives;

    #[test]
    fn solids_are_closed_and_damage_is_counted() {
        let cube = primitives::cuboid([0.1; 3], [1; 3]);
        let t = cube.topology();
        assert!(t.closed() && t.edges == 18, "{t:?}");
        let mut open = cube.clone();
        open.triangles.pop();
        assert_eq!(open.topology().open, 3);
        let mut twisted = cube.clone();
        twisted.triangles[0].swap(0, 1);
        assert_eq!(twisted.topology().twisted, 3);
        let mut crowded = cube.clone();
        crowded.triangles.push([0, 1, 7]);
        assert!(crowded.topology().crowded > 0 && !crowded.topology().closed());
        let mut inside_out = cube.clone();
        inside_out.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        assert!(inside_out.volume() < 0.0 && (inside_out.outward().volume() - 0.001).abs() < 1e-9);
    }

    #[test]
    fn simplified_keeps_shape_and_colour() {
        let ball = primitives::sphere(0.05, 200, [200, 40, 30]);
        let small = ball.simplified(3000);
        assert!(ball.triangles.len() > 15_000 && small.triangles.len() <= 3000);
        assert!((small.volume() / ball.volume() - 1.0).abs() < 0.04, "{}", small.volume());
        assert!(small.colors.iter().all(|c| *c == [200, 40, 30]));
        assert_eq!(small.simplified(3000), small);
    }
}
