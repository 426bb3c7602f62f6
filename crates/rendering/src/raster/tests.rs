use super::*;
use crate::mesh::primitives;
use crate::{Light, look_at};
use nalgebra::{Point3, Vector3};
use tdv_geometry::pose_from_xyz_rpy;

const K: Intrinsics =
    Intrinsics { width: 160, height: 120, fx: 150.0, fy: 150.0, cx: 79.5, cy: 59.5 };

fn flat_light() -> Lighting {
    Lighting {
        ambient: [1.0; 3],
        lights: vec![],
        specular: 0.0,
        shininess: 1.0,
        background: [9; 3],
    }
}

#[test]
fn depth_of_a_sphere_is_exact() {
    let mesh = primitives::sphere(0.1, 256, [255, 0, 0]);
    let pose = pose_from_xyz_rpy([0.02, -0.01, 0.6], [0.3, 0.2, 0.1]);
    let mut out = Rendered::default();
    Renderer::new().render(&K, &[Instance { mesh: &mesh, pose, id: 7 }], &flat_light(), &mut out);
    let centre = pose.translation.vector;
    let mut seen = 0;
    for y in 0..120 {
        for x in 0..160 {
            let i = y * 160 + x;
            // Analytic ray-sphere hit.
            let ray = K.ray(x as f64, y as f64);
            let (a, b, c) = (ray.dot(&ray), ray.dot(&centre), centre.dot(&centre) - 0.01);
            let disc = b * b - a * c;
            if disc < 2e-4 {
                // At the silhouette polygon and sphere differ; well outside nothing may be drawn.
                if disc < -2e-4 {
                    assert_eq!((out.ids[i], out.depth.data[i]), (0, 0.0));
                    assert_eq!(out.color.get_pixel(x as u32, y as u32).0, [9; 3]);
                }
                continue;
            }
            let z = (b - disc.sqrt()) / a;
            assert!((f64::from(out.depth.data[i]) - z).abs() < 1e-4, "{x} {y}");
            assert_eq!(out.ids[i], 7);
            assert_eq!(out.color.get_pixel(x as u32, y as u32).0, [255, 0, 0]);
            let n = (ray * z - centre).normalize();
            let have = Vector3::from(out.normals[i].map(f64::from));
            assert!(have.dot(&n) > 0.9995, "{have} {n}");
            seen += 1;
        }
    }
    assert!(seen > 1500);
}

#[test]
fn the_fast_path_and_the_full_one_agree() {
    let (a, b) = (primitives::cuboid([0.1; 3], [1; 3]), primitives::capsule(0.03, 0.2, 24, [2; 3]));
    let scene = [
        Instance { mesh: &a, pose: pose_from_xyz_rpy([0.0, 0.0, 0.5], [0.4, 0.5, 0.6]), id: 1 },
        Instance { mesh: &b, pose: pose_from_xyz_rpy([0.02, 0.0, 0.45], [1.0, 0.0, 0.6]), id: 2 },
    ];
    let (mut full, mut fast) = (Rendered::default(), DepthOnly::default());
    let mut renderer = Renderer::new();
    renderer.render(&K, &scene, &flat_light(), &mut full);
    renderer.render_depth(&K, &scene, &mut fast);
    assert_eq!(full.depth, fast.depth);
    assert_eq!(full.ids, fast.ids);
    assert_eq!(full.normals, fast.normals);
    assert!(fast.ids.contains(&1) && fast.ids.contains(&2));
    // Closed meshes lose nothing by leaving out the back.
    renderer.cull_backfaces = true;
    let mut culled = DepthOnly::default();
    renderer.render_depth(&K, &scene, &mut culled);
    let differ = culled.ids.iter().zip(&fast.ids).filter(|(a, b)| a != b).count();
    assert!(differ <= 3, "{differ}");
    // A crop shows exactly what the whole image shows there.
    renderer.cull_backfaces = false;
    let mut crop = DepthOnly::default();
    renderer.render_depth(&K.crop(50, 30, 64, 48), &scene, &mut crop);
    for y in 0..48 {
        for x in 0..64 {
            let whole = (y + 30) * 160 + x + 50;
            assert_eq!(crop.ids[y * 64 + x], fast.ids[whole]);
            assert!((crop.depth.data[y * 64 + x] - fast.depth.data[whole]).abs() < 1e-5);
        }
    }
}

#[test]
fn neighbouring_triangles_leave_no_gap_and_do_not_overlap() {
    // A wavy sheet that fills the view: every pixel must be covered.
    let n = 40;
    let mut mesh = Mesh::default();
    for j in 0..=n {
        for i in 0..=n {
            let (x, y) = (i as f32 / n as f32 - 0.5, j as f32 / n as f32 - 0.5);
            mesh.positions.push([x, y, 0.03 * (17.0 * x).sin() * (13.0 * y).cos()]);
        }
    }
    for j in 0..n {
        for i in 0..n {
            let k = j * (n + 1) + i;
            mesh.triangles.push([k, k + 1, k + n + 2]);
            mesh.triangles.push([k, k + n + 2, k + n + 1]);
        }
    }
    for k in 0..20 {
        let pose = pose_from_xyz_rpy([0.0, 0.0, 0.35], [0.01 * k as f64, 0.02, 0.31 * k as f64]);
        let mut out = DepthOnly::default();
        Renderer::new().render_depth(&K, &[Instance { mesh: &mesh, pose, id: 1 }], &mut out);
        let centre = out.ids[60 * 160 + 80];
        assert_eq!(centre, 1);
        for y in 40..80 {
            for x in 60..100 {
                assert_eq!(out.ids[y * 160 + x], 1, "hole at {x} {y}, view {k}");
            }
        }
    }
}

#[test]
fn a_plane_through_the_camera_is_clipped() {
    // A floor 0.2 m below, reaching behind the camera.
    let floor = primitives::cuboid([4.0, 0.01, 4.0], [1; 3]);
    let pose = pose_from_xyz_rpy([0.0, 0.205, 0.0], [0.0; 3]);
    let mut out = DepthOnly::default();
    Renderer::new().render_depth(&K, &[Instance { mesh: &floor, pose, id: 3 }], &mut out);
    for y in 80..120 {
        for x in 0..160 {
            let z = 0.2 / K.ray(x as f64, y as f64).y;
            let i = y * 160 + x;
            assert_eq!(out.ids[i], 3, "{x} {y}");
            assert!((f64::from(out.depth.data[i]) - z).abs() < 1e-5 * z.max(1.0));
        }
    }
    assert!(out.ids[..50 * 160].iter().all(|&i| i == 0));
    // Wholly behind the camera: nothing.
    let behind = pose_from_xyz_rpy([0.0, 0.0, -5.0], [0.0; 3]);
    Renderer::new().render_depth(&K, &[Instance { mesh: &floor, pose: behind, id: 3 }], &mut out);
    assert!(out.ids.iter().all(|&i| i == 0));
}

#[test]
fn texture_and_colour_are_perspective_correct() {
    // Left half black, right half white, on a board strongly turned about the vertical axis.
    let mut board = Mesh {
        positions: vec![[-0.2, -0.1, 0.0], [0.2, -0.1, 0.0], [0.2, 0.1, 0.0], [-0.2, 0.1, 0.0]],
        uvs: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
        colors: vec![[255; 3]; 4],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        texture: Some(RgbImage::from_fn(64, 4, |x, _| {
            image::Rgb([if x < 32 { 0 } else { 255 }; 3])
        })),
        ..Mesh::default()
    };
    board.recompute_normals();
    let pose = pose_from_xyz_rpy([0.0, 0.0, 0.5], [0.0, 1.0, 0.0]);
    let mut out = Rendered::default();
    Renderer::new().render(&K, &[Instance { mesh: &board, pose, id: 1 }], &flat_light(), &mut out);
    // The middle of the board is at the image's middle column however it is foreshortened.
    let row = 60;
    let shade = |x: u32| out.color.get_pixel(x, row).0[0];
    assert_eq!((shade(76), shade(83)), (0, 255));
    // Vertex colours follow the same rule.
    board.texture = None;
    board.colors = vec![[0; 3], [255; 3], [255; 3], [0; 3]];
    Renderer::new().render(&K, &[Instance { mesh: &board, pose, id: 1 }], &flat_light(), &mut out);
    let middle = i32::from(out.color.get_pixel(79, row).0[0]);
    // Half the linear light is byte 188.
    assert!((middle - 188).abs() <= 4, "{middle}");
}

#[test]
fn light_falls_from_where_it_is_said_to_be() {
    let ball = primitives::sphere(0.1, 64, [200; 3]);
    let t = look_at(&Point3::new(0.0, -0.6, 0.0), &Point3::origin());
    let instance = Instance { mesh: &ball, pose: t.inverse(), id: 1 };
    let world = Lighting {
        ambient: [0.05; 3],
        lights: vec![Light { direction: [0.0, 0.0, 1.0], color: [0.9; 3] }],
        specular: 0.3,
        ..Lighting::default()
    };
    let mut out = Rendered::default();
    Renderer::new().render(&K, &[instance], &world.in_camera(&t.inverse()), &mut out);
    let at = |y: u32| u32::from(out.color.get_pixel(80, y).0[0]);
    assert!(at(40) > at(52) && at(52) > at(75), "{} {} {}", at(40), at(52), at(75));
}

#[test]
fn damaged_input_is_left_out_without_a_panic() {
    let mut mesh = primitives::cuboid([0.1; 3], [1; 3]);
    mesh.triangles.push([0, 1, 999]);
    mesh.normals.clear();
    mesh.colors.truncate(2);
    let nan = pose_from_xyz_rpy([f64::NAN, 0.0, 0.5], [0.0; 3]);
    let good = pose_from_xyz_rpy([0.0, 0.0, 0.5], [0.0; 3]);
    let scene =
        [Instance { mesh: &mesh, pose: nan, id: 1 }, Instance { mesh: &mesh, pose: good, id: 2 }];
    let mut out = Rendered::default();
    Renderer::new().render(&K, &scene, &Lighting::default(), &mut out);
    assert!(out.ids.contains(&2) && !out.ids.contains(&1));
    let none = Intrinsics { width: 0, height: 0, ..K };
    Renderer::new().render(&none, &scene, &Lighting::default(), &mut out);
    assert!(out.ids.is_empty());
}

#[test]
fn still_instances_look_the_same_remembered_or_not() {
    let mut ground = primitives::cuboid([0.6, 0.4, 0.02], [120, 90, 60]);
    ground.texture =
        Some(RgbImage::from_fn(16, 16, |x, y| crate::Rgb([(x * 16) as u8, 200, (y * 9) as u8])));
    let ball = primitives::sphere(0.05, 32, [10, 200, 30]);
    let lighting = Lighting { specular: 0.3, ..Lighting::default() };
    let scene = |x: f64| {
        [
            Instance {
                mesh: &ground,
                pose: pose_from_xyz_rpy([0.0, 0.05, 0.7], [0.9, 0.1, 0.0]),
                id: 1,
            },
            Instance { mesh: &ball, pose: pose_from_xyz_rpy([x, 0.0, 0.5], [0.0; 3]), id: 2 },
        ]
    };
    let mut remembering = Renderer { still: 1, ..Renderer::new() };
    let (mut a, mut b) = (Rendered::default(), Rendered::default());
    for i in 0..12 {
        // Light and place of the still part change once on the way.
        let mut light = lighting.clone();
        let mut items = scene(-0.15 + 0.03 * f64::from(i));
        if i == 5 {
            light.ambient = [0.1; 3];
        }
        if i >= 8 {
            items[0].pose.translation.x = 0.02;
        }
        remembering.render(&K, &items, &light, &mut a);
        Renderer::new().render(&K, &items, &light, &mut b);
        assert!(a.color == b.color && a.ids == b.ids && a.depth.data == b.depth.data, "image {i}");
        assert!(a.normals == b.normals, "image {i}");
    }
}
