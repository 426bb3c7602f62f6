use super::*;
use crate::backdrop::{Backdrop, BackdropConfig, TABLE_ID};
use nalgebra::Point3;
use tdv_geometry::pose_from_xyz_rpy;
use tdv_rendering::look_at;
use tdv_rendering::mesh::primitives::{MugSize, cuboid, disc, mug};

fn wall_at(z: f64, frames: u64) -> (Vec<f64>, Vec<Vec<f32>>) {
    let wall = cuboid([4.0, 4.0, 0.01], [180; 3]);
    let mut sensor = RgbdSensor::new(SensorConfig::lab(), 5);
    let mut out = SensorFrame::default();
    let pose = pose_from_xyz_rpy([0.0, 0.0, z + 0.005], [0.0; 3]);
    let mut errors = Vec::new();
    let mut images = Vec::new();
    for frame in 0..frames {
        let item = SceneItem { mesh: &wall, pose, id: 1 };
        sensor.capture(&Pose::identity(), &[item], &Lighting::default(), frame, &mut out);
        errors.extend(out.depth.data.iter().filter(|d| **d > 0.0).map(|d| f64::from(*d) - z));
        images.push(out.depth.data.clone());
    }
    (errors, images)
}

#[test]
fn range_noise_grows_with_the_square_of_the_distance_as_stated() {
    let noise = DepthNoise::default();
    for (z, stated) in [(0.5, 0.66e-3), (0.85, 1.90e-3), (1.2, 3.78e-3)] {
        assert!((noise.sigma(z, 610.0) - stated).abs() < 0.02e-3);
        let (errors, _) = wall_at(z, 4);
        let n = errors.len() as f64;
        let mean = errors.iter().sum::<f64>() / n;
        let sigma = (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / n).sqrt();
        // Rounding to millimetres adds 0.29 mm; patches lost are those of extreme common noise.
        let expected = stated.hypot(0.29e-3);
        println!("z {z} m: sigma {:.2} mm, bias {:.3} mm", sigma * 1e3, mean * 1e3);
        assert!((sigma / expected - 1.0).abs() < 0.06, "{z}: {sigma} {expected}");
        assert!(mean.abs() < 0.1e-3);
    }
}

#[test]
fn readings_are_whole_millimetres_and_neighbours_share_noise() {
    let (_, images) = wall_at(0.85, 2);
    let image = &images[0];
    for z in image {
        assert!((z * 1000.0 - (z * 1000.0).round()).abs() < 1e-3);
    }
    assert_ne!(images[0], images[1]);
    // The common part does not average out over a patch.
    let pair = |a: f32, b: f32| (a > 0.0 && b > 0.0).then(|| f64::from((a - 0.85) * (b - 0.85)));
    let products: Vec<f64> = image.windows(2).filter_map(|w| pair(w[0], w[1])).collect();
    let covariance = products.iter().sum::<f64>() / products.len() as f64;
    let share = covariance / 1.90e-3_f64.powi(2);
    assert!((0.2..0.35).contains(&share), "{share}");
}

/// The lab's camera over a table with a mug and a coaster.
fn lab_scene(seed: u64, frame: u64) -> SensorFrame {
    let room = Backdrop::generate(&BackdropConfig::default(), seed);
    let (cup, mat) = (
        mug(&MugSize::default(), 48, [38, 84, 168], [228; 3]),
        disc(0.05, 0.008, 64, [158, 72, 48]),
    );
    let mut items = room.items();
    let cup_pose = pose_from_xyz_rpy([0.55, 0.12, 0.0], [0.0, 0.0, 1.0]);
    items.push(SceneItem { mesh: &cup, pose: cup_pose, id: 40 });
    let mat_pose = pose_from_xyz_rpy([0.45, -0.22, 0.0], [0.0; 3]);
    items.push(SceneItem { mesh: &mat, pose: mat_pose, id: 41 });
    let camera = look_at(&Point3::new(0.95, 0.0, 0.70), &Point3::new(0.475, 0.0, 0.02));
    let mut sensor = RgbdSensor::new(SensorConfig::lab(), seed);
    let mut out = SensorFrame::default();
    sensor.capture(&camera, &items, &room.lighting, frame, &mut out);
    out
}

#[test]
fn at_least_one_in_twenty_readings_is_a_hole_and_edges_have_most() {
    let (mut holes, mut all, mut edge_holes, mut edge) = (0.0, 0.0, 0.0, 0.0);
    for seed in 0..4 {
        let f = lab_scene(seed, seed);
        let w = f.depth.width as usize;
        for y in 2..f.depth.height as usize - 2 {
            for x in 2..w - 2 {
                let i = y * w + x;
                let z = f.exact.data[i];
                let step = |j: usize| (f.exact.data[j] - z).abs() > 0.02;
                let lost = f64::from(f.depth.data[i] == 0.0);
                all += 1.0;
                holes += lost;
                if step(i - 2) || step(i + 2) || step(i - 2 * w) || step(i + 2 * w) {
                    edge += 1.0;
                    edge_holes += lost;
                }
            }
        }
    }
    let (share, at_edges) = (holes / all, edge_holes / edge);
    println!("holes: {:.1} % of all, {:.1} % beside depth edges", share * 100.0, at_edges * 100.0);
    assert!((0.05..0.09).contains(&share), "{share}");
    assert!((0.4..0.8).contains(&at_edges), "{at_edges}");
}

#[test]
fn grazing_surfaces_are_lost_and_flying_pixels_stay_few() {
    // The inner wall of the mug and its silhouette: count readings that lie on nothing.
    let f = lab_scene(1, 0);
    let mut flying = 0;
    let mut read = 0;
    for i in 0..f.ids.len() {
        if f.depth.data[i] > 0.0 {
            read += 1;
            flying += usize::from((f.depth.data[i] - f.exact.data[i]).abs() > 0.012);
        }
    }
    let share = flying as f64 / f64::from(read);
    assert!(share > 1e-4 && share < 5e-3, "{share}");
    // A table seen at 5 degrees gives hardly any reading.
    let table = cuboid([4.0, 4.0, 0.01], [180; 3]);
    let camera = look_at(&Point3::new(-1.0, 0.0, 0.06), &Point3::new(0.0, 0.0, 0.0));
    let mut sensor = RgbdSensor::new(SensorConfig::lab(), 5);
    let mut out = SensorFrame::default();
    let item =
        SceneItem { mesh: &table, pose: pose_from_xyz_rpy([0.0, 0.0, -0.005], [0.0; 3]), id: 1 };
    sensor.capture(&camera, &[item], &Lighting::default(), 0, &mut out);
    let row =
        |y: usize| out.depth.data[y * 640..(y + 1) * 640].iter().filter(|z| **z > 0.0).count();
    assert!(row(240) < 30, "{}", row(240));
}

#[test]
fn frames_are_keyed_by_seed_and_number() {
    let (a, b) = (lab_scene(3, 9), lab_scene(3, 9));
    assert_eq!(a.color, b.color);
    assert_eq!(a.depth, b.depth);
    let c = lab_scene(3, 10);
    assert_ne!(a.color, c.color);
    assert_ne!(a.depth, c.depth);
    // Truth does not depend on noise.
    assert_eq!(a.exact, c.exact);
    assert!(a.ids.contains(&40) && a.ids.contains(&41) && a.ids.contains(&TABLE_ID));
}

#[test]
fn colour_noise_is_a_few_levels_and_can_be_switched_off() {
    let wall = cuboid([4.0, 4.0, 0.01], [128; 3]);
    let pose = pose_from_xyz_rpy([0.0, 0.0, 0.8], [0.0; 3]);
    let item = SceneItem { mesh: &wall, pose, id: 1 };
    let light = Lighting { ambient: [1.0; 3], lights: vec![], ..Lighting::default() };
    let mut config = SensorConfig::lab();
    let mut out = SensorFrame::default();
    RgbdSensor::new(config.clone(), 2).capture(&Pose::identity(), &[item], &light, 0, &mut out);
    let patch: Vec<f64> = (220..260)
        .flat_map(|y| (300..340).map(move |x| (x, y)))
        .map(|(x, y)| f64::from(out.color.get_pixel(x, y).0[1]))
        .collect();
    let mean = patch.iter().sum::<f64>() / patch.len() as f64;
    let sigma = (patch.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / patch.len() as f64).sqrt();
    println!("colour noise at grey {mean:.0}: {sigma:.2} levels");
    assert!((1.8..3.2).contains(&sigma), "{sigma}");
    let corner: f64 =
        (0..20).map(|x| f64::from(out.color.get_pixel(x, 0).0[1])).sum::<f64>() / 20.0;
    assert!(corner / mean < 0.93 && corner / mean > 0.8, "{corner} {mean}");
    config.color.enabled = false;
    config.depth.enabled = false;
    RgbdSensor::new(config, 2).capture(&Pose::identity(), &[item], &light, 0, &mut out);
    assert!(out.color.pixels().all(|p| p.0 == [128; 3]));
    assert!(out.depth.data.iter().all(|z| (z - 0.795).abs() < 1e-6));
}
