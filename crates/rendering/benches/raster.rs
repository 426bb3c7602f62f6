//! Frame rates of the rasteriser: 20 000 triangles, 640x480, one core.
#![allow(missing_docs)]

use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use tdv_geometry::pose_from_xyz_rpy;
use tdv_rendering::mesh::primitives::{MugSize, mug, rounded_cuboid, sphere};
use tdv_rendering::{DepthOnly, Instance, Intrinsics, Lighting, Mesh, Rendered, Renderer};

fn scene() -> Vec<(Mesh, [f64; 3])> {
    let table = rounded_cuboid([1.4, 1.0, 0.02], 0.002, [180, 170, 160]);
    let mut out = vec![(table, [0.0, 0.1, 1.0])];
    for k in 0..4 {
        let x = -0.3 + 0.2 * f64::from(k);
        out.push((mug(&MugSize::default(), 96, [40, 80, 160], [230; 3]), [x, 0.1, 0.7]));
        out.push((sphere(0.05, 56, [200, 60, 40]), [x, -0.1, 0.8]));
    }
    out
}

fn raster(c: &mut Criterion) {
    let camera = Intrinsics { width: 640, height: 480, fx: 610.0, fy: 610.0, cx: 319.5, cy: 239.5 };
    let meshes = scene();
    let instances: Vec<Instance<'_>> = meshes
        .iter()
        .enumerate()
        .map(|(i, (mesh, at))| Instance {
            mesh,
            pose: pose_from_xyz_rpy(*at, [0.6, 0.3, 0.1 * i as f64]),
            id: i as u16 + 1,
        })
        .collect();
    let triangles: usize = meshes.iter().map(|(m, _)| m.triangles.len()).sum();
    let mut renderer = Renderer::new();
    let mut depth = DepthOnly::default();
    c.bench_function(&format!("depth, {triangles} triangles"), |b| {
        b.iter(|| renderer.render_depth(&camera, black_box(&instances), &mut depth));
    });
    let mut full = Rendered::default();
    let lighting = Lighting::default();
    c.bench_function(&format!("colour, {triangles} triangles"), |b| {
        b.iter(|| renderer.render(&camera, black_box(&instances), &lighting, &mut full));
    });
    let crop = camera.crop(250, 180, 140, 120);
    c.bench_function("depth, one mug in a crop of 140x120", |b| {
        b.iter(|| renderer.render_depth(&crop, black_box(&instances[1..2]), &mut depth));
    });
}

criterion_group!(benches, raster);
criterion_main!(benches);
