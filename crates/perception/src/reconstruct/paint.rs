use super::symmetry::Assumed;
use super::view::View;
use nalgebra::{Point3, Vector3};
use tdv_rendering::Mesh;

/// Colours every vertex: as it is seen, else as its image under the symmetry is seen, else as its
/// neighbours are.
pub(super) fn paint(mesh: &mut Mesh, view: &View, assumed: &Assumed) {
    let images = assumed.images();
    let mut colors: Vec<Option<[u8; 3]>> = mesh
        .positions
        .iter()
        .zip(&mesh.normals)
        .map(|(p, n)| {
            let p = Point3::from(p.map(f64::from));
            let n = Vector3::from(n.map(f64::from));
            images.iter().find_map(|image| view.color(&(image * p), &(image * n)))
        })
        .collect();
    // What nobody sees takes the mean of the painted neighbours, ring by ring.
    for _ in 0..200 {
        let mut sums = vec![([0_u32; 3], 0_u32); colors.len()];
        for t in &mesh.triangles {
            for k in 0..3 {
                let (from, to) = (t[k] as usize, t[(k + 1) % 3] as usize);
                for (from, to) in [(from, to), (to, from)] {
                    if let (Some(c), None) = (colors[from], colors[to]) {
                        (0..3).for_each(|j| sums[to].0[j] += u32::from(c[j]));
                        sums[to].1 += 1;
                    }
                }
            }
        }
        let mut painted = false;
        for (color, (sum, n)) in colors.iter_mut().zip(&sums) {
            if *n > 0 {
                *color = Some(sum.map(|s| (s / n) as u8));
                painted = true;
            }
        }
        if !painted {
            break;
        }
    }
    for (color, found) in mesh.colors.iter_mut().zip(colors) {
        *color = found.unwrap_or([160; 3]);
    }
}
