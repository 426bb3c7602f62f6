use super::super::testing::{K, Scene, gauss, shapes};
use super::*;

/// The scene, and the pixels and the shape as a network might give them: pixels off by about 2,
/// the shape by 4 mm a joint and axis and by a turn of about 6 degrees.
fn seen(i: usize, size: f64) -> (Scene, [(f64, f64); JOINTS], [Vector3<f64>; JOINTS]) {
    let shape = shapes()[i];
    let mut scene = Scene::new(&shape, size, places()[i % 3], 100 + i as u64);
    let random = &mut scene.random;
    let turn = Rotation3::new(Vector3::from_fn(|_, _| 0.06 * gauss(random)));
    let shape = shape.map(|p| turn * p + Vector3::from_fn(|_, _| 0.004 * gauss(random)));
    let mut pixels = scene.pixels();
    for pixel in &mut pixels {
        pixel.0 += 2.0 * gauss(&mut scene.random);
        pixel.1 += 2.0 * gauss(&mut scene.random);
    }
    (scene, pixels, shape)
}

fn places() -> [Vector3<f64>; 3] {
    [Vector3::new(0.0, 0.0, 0.6), Vector3::new(0.2, -0.1, 0.8), Vector3::new(-0.15, 0.12, 0.5)]
}

fn count(lifted: &Lifted) -> usize {
    lifted.measured.iter().filter(|measured| **measured).count()
}

const ALL: [usize; JOINTS] =
    [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20];

#[test]
fn joints_come_out_within_a_centimetre() {
    let (mut all, mut grasp, hands) = (0.0, 0.0, 11);
    for i in 0..hands {
        let size = 0.85 + 0.03 * i as f64;
        let (mut scene, pixels, shape) = seen(i, size);
        scene.spoil();
        let lifted = lift(&pixels, &shape, &scene.depth, &K).unwrap();
        let error = scene.error(&lifted.joints, &ALL);
        println!("hand {i} of size {size:.2}: {:.1} mm, size {:.2}", error * 1e3, lifted.size);
        assert!(error < 0.012 && count(&lifted) > 10, "hand {i}: {error}");
        all += error / hands as f64;
        grasp += scene.error(&lifted.joints, &[2, 3, 5]) / hands as f64;
    }
    println!("mean {:.1} mm, joints 2, 3, 5 {:.1} mm", all * 1e3, grasp * 1e3);
    assert!(all < 0.006 && grasp < 0.006);
}

#[test]
#[ignore = "open: joints move by 23 mm when an object hides half of the hand"]
fn an_object_in_front_of_half_the_hand_does_not_move_it() {
    for i in 0..6 {
        let (mut scene, pixels, shape) = seen(i, 1.0);
        // A board 8 cm before the hand, over everything left of its middle.
        let board = places()[i % 3].z as f32 - 0.08;
        for (at, z) in scene.depth.data.iter_mut().enumerate() {
            if ((at % K.width as usize) as f64) < pixels[9].0 {
                *z = board;
            }
        }
        let lifted = lift(&pixels, &shape, &scene.depth, &K).unwrap();
        let error = scene.error(&lifted.joints, &ALL);
        println!("hand {i}: {:.1} mm, {} measured", error * 1e3, count(&lifted));
        assert!(error < 0.020, "hand {i}: {error}");
    }
}

#[test]
fn without_depth_there_is_no_hand() {
    let (mut scene, pixels, shape) = seen(0, 1.0);
    scene.depth.data.fill(0.0);
    assert_eq!(lift(&pixels, &shape, &scene.depth, &K), None);
    scene.depth.data.fill(f32::NAN);
    assert_eq!(lift(&pixels, &shape, &scene.depth, &K), None);
    scene.depth.data.clear();
    assert_eq!(lift(&pixels, &shape, &scene.depth, &K), None);
}

#[test]
fn nonsense_is_no_hand() {
    let (scene, pixels, shape) = seen(0, 1.0);
    let outcome = |pixels: &[(f64, f64); JOINTS], shape: &[Vector3<f64>; JOINTS]| {
        lift(pixels, shape, &scene.depth, &K)
    };
    assert!(outcome(&pixels, &shape).is_some());
    assert_eq!(outcome(&[(100.0, 100.0); JOINTS], &shape), None);
    assert_eq!(outcome(&pixels, &[Vector3::zeros(); JOINTS]), None);
    let mut broken = pixels;
    broken[3].0 = f64::NAN;
    assert_eq!(outcome(&broken, &shape), None);
    assert_eq!(outcome(&pixels.map(|(u, v)| (u + 5000.0, v - 1e9)), &shape), None);
}
