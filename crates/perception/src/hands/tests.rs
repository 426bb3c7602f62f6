//! The real networks against reference outputs and on images. These tests need the network files:
//! in the folder named by TDV_HAND_MODELS, else in models/hands (launch_scripts/fetch_hand_models.sh
//! puts them there); without them they say so and pass.

use std::path::PathBuf;

use nalgebra::Vector3;

use super::testing::{K, Scene, shapes, video_landmarks};
use super::*;

/// Paths of the palm and the landmark network, if they are there.
fn models() -> Option<[PathBuf; 2]> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let folder = std::env::var_os("TDV_HAND_MODELS")
        .map_or_else(|| root.join("models/hands"), PathBuf::from);
    let files = ["palm_detection_full.tflite", "hand_landmark_full.tflite"];
    let paths = files.map(|name| folder.join(name));
    if paths.iter().all(|path| path.is_file()) {
        return Some(paths);
    }
    println!(
        "SKIPPED: no hand networks in {}; run launch_scripts/fetch_hand_models.sh",
        folder.display()
    );
    None
}

fn detector() -> Option<HandDetector> {
    models().map(|[palm, landmark]| HandDetector::load(&palm, &landmark).unwrap())
}

/// Fills the input with the numbers that the golden file was made with.
fn fill(network: &mut network::Network) {
    for (i, value) in network.input_mut().iter_mut().enumerate() {
        *value = ((7919 * i) % 1009) as f32 / 1008.0;
    }
}

#[test]
fn outputs_equal_those_of_the_reference_interpreter() {
    let Some(paths) = models() else { return };
    let golden =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/hands/network_outputs.json");
    let golden: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(golden).unwrap()).unwrap();
    for path in paths {
        let mut network = network::Network::load(&path).unwrap();
        let name = path.file_stem().unwrap().to_str().unwrap();
        // Twice: a run must not depend on what the one before left in the buffers.
        for _ in 0..2 {
            fill(&mut network);
            network.run();
        }
        for (i, (output, expected)) in golden[name].as_object().unwrap().iter().enumerate() {
            let values = network.output(i);
            assert_eq!(values.len() as u64, expected["length"].as_u64().unwrap());
            let step = expected["step"].as_u64().unwrap() as usize;
            let expected = expected["values"].as_array().unwrap();
            let worst = values
                .iter()
                .step_by(step)
                .zip(expected)
                .map(|(value, expected)| (f64::from(*value) - expected.as_f64().unwrap()).abs())
                .fold(0.0, f64::max);
            println!("{name} {output}: largest difference {worst:.1e}");
            assert!(worst < 1e-3, "{name} {output}: {worst}");
        }
    }
}

#[test]
fn damaged_networks_give_errors_or_numbers_but_never_a_panic() {
    use rand_chacha::rand_core::{RngCore, SeedableRng};
    let Some([palm, _]) = models() else { return };
    let bytes = std::fs::read(&palm).unwrap();
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
    let mut refused = 0;
    for _ in 0..200 {
        let end = random.next_u32() as usize % bytes.len();
        refused += usize::from(network::Network::parse(&bytes[..end], &palm).is_err());
    }
    assert_eq!(refused, 200, "a truncated file was taken");
    for _ in 0..300 {
        let mut damaged = bytes.clone();
        // The structure stands at the end of the file, behind the weights.
        for _ in 0..4 {
            let back = random.next_u32() as usize % 60_000;
            let at = bytes.len() - 1 - back;
            damaged[at] = random.next_u32() as u8;
        }
        refused += usize::from(network::Network::parse(&damaged, &palm).is_err());
    }
    println!("{} of 300 damaged files refused", refused - 200);
    assert!(refused > 220);
}

#[test]
fn the_two_networks_are_not_mistaken_for_each_other() {
    let Some([palm, landmark]) = models() else { return };
    let error = HandDetector::load(&landmark, &palm).unwrap_err();
    assert!(matches!(error, HandError::Network(NetworkError::Interface { .. })), "{error}");
}

#[test]
fn a_rendered_hand_is_found_and_lifted() {
    let Some(mut detector) = detector() else { return };
    let (mut errors, mut pixel_errors) = (Vec::new(), Vec::new());
    for (i, shape) in shapes().iter().enumerate() {
        let place = Vector3::new(-0.15 + 0.03 * i as f64, -0.05 + 0.02 * (i % 4) as f64, 0.6);
        let mut scene = Scene::new(shape, 1.0, place, i as u64);
        scene.spoil();
        detector.reset();
        let hand = detector.detect(&scene.color, &scene.depth, &K).unwrap();
        let Some(hand) = hand else {
            println!("hand {i}: not found");
            continue;
        };
        let error = scene.error(&hand.joints_camera, &[2, 3, 5]);
        let mut pixels: Vec<f64> = hand
            .pixels
            .iter()
            .zip(scene.pixels())
            .map(|(found, truth)| (found.0 - truth.0).hypot(found.1 - truth.1))
            .collect();
        pixels.sort_by(f64::total_cmp);
        println!(
            "hand {i}: {:?}, score {:.2}, median {:.1} px, joints 2, 3, 5 off by {:.1} mm",
            hand.handedness,
            hand.score,
            pixels[10],
            error * 1e3
        );
        errors.push(error);
        pixel_errors.push(pixels[10]);
    }
    assert!(errors.len() >= 10, "{} of 11 hands found", errors.len());
    errors.sort_by(f64::total_cmp);
    pixel_errors.sort_by(f64::total_cmp);
    let middle = errors.len() / 2;
    println!("median: {:.1} px, {:.1} mm", pixel_errors[middle], errors[middle] * 1e3);
    assert!(errors[middle] < 0.015 && pixel_errors[middle] < 8.0);
}

#[test]
fn an_image_without_a_hand_gives_none() {
    let Some(mut detector) = detector() else { return };
    let color =
        RgbImage::from_fn(640, 480, |x, y| image::Rgb([((x / 40 + y / 40) % 2 * 90) as u8; 3]));
    let depth = DepthImage { width: 640, height: 480, data: vec![0.7; 640 * 480] };
    assert_eq!(detector.detect(&color, &depth, &K).unwrap(), None);
}

#[test]
fn inputs_that_do_not_belong_together_are_refused() {
    let color = RgbImage::new(640, 480);
    let depth = DepthImage::new(320, 240);
    let error = check(&color, &depth, &K).unwrap_err();
    assert!(error.to_string().contains("320x240"), "{error}");
    let depth = DepthImage::new(640, 480);
    assert!(check(&color, &depth, &K).is_ok());
    assert!(check(&color, &depth, &Intrinsics { width: 848, ..K }).is_err());
    assert!(check(&color, &depth, &Intrinsics { fx: 0.0, ..K }).is_err());
}

/// Needs frames of the real video as NNNN.png in the folder named by TDV_HAND_FRAMES
/// (tests/golden/hands/make_video_landmarks.py writes them).
#[test]
fn joints_on_a_real_video_agree_with_mediapipe() {
    let Some(mut detector) = detector() else { return };
    let Some(folder) = std::env::var_os("TDV_HAND_FRAMES") else {
        println!("SKIPPED: TDV_HAND_FRAMES names no folder with frames of the real video");
        return;
    };
    for frame in video_landmarks()["frames"].as_array().unwrap() {
        let number = frame["frame"].as_u64().unwrap();
        let path = Path::new(&folder).join(format!("{number:04}.png"));
        let color = image::open(&path).unwrap().to_rgb8();
        detector.reset();
        let hand = detector.find(&color).unwrap();
        let expected = frame["pixels"].as_array().unwrap();
        let mut errors: Vec<f64> = hand
            .pixels
            .iter()
            .zip(expected)
            .map(|(p, e)| (p.0 - e[0].as_f64().unwrap()).hypot(p.1 - e[1].as_f64().unwrap()))
            .collect();
        errors.sort_by(f64::total_cmp);
        println!("frame {number}: median {:.1} px, worst {:.1} px", errors[10], errors[20]);
        // The hand is about 300 px large.
        assert!(errors[10] < 4.0 && errors[20] < 12.0, "frame {number}: {errors:?}");
        assert_eq!(hand.handedness, Handedness::Right, "the video shows a right hand");
    }
}
