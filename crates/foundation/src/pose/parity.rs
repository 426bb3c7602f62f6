//! Both networks against torch's own modules; `tests/golden/foundation/make_pose_networks.py` made the
//! files.

use super::*;
use candle_core::Tensor;
use serde::Deserialize;
use std::path::PathBuf;

#[derive(Deserialize)]
struct Expected {
    poses: usize,
    side: usize,
    width: usize,
    translation: Vec<f32>,
    rotation: Vec<f32>,
    refiner_parameters: usize,
    score: Vec<f32>,
    scorer_parameters: usize,
}

/// The committed folder, or another one made by the same script.
fn folder() -> PathBuf {
    let committed = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/foundation");
    std::env::var_os("TDV_POSE_GOLDEN").map_or_else(|| committed.into(), PathBuf::from)
}

fn expected() -> Expected {
    let text = std::fs::read_to_string(folder().join("pose_networks.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

fn weights(name: &str) -> Weights {
    Weights::load(&folder().join(name), &Device::Cpu, "golden weights", "run the script").unwrap()
}

/// The script's formula.
fn image(poses: usize, side: usize, phase: f64) -> Tensor {
    let mut data = Vec::new();
    for n in (0..poses).map(|n| n as f64) {
        for c in (0..6).map(f64::from) {
            for v in 0..side {
                for u in 0..side {
                    let at = |i: usize| (2 * i + 1) as f64 / side as f64 - 1.0;
                    let (x, y) = (at(u), at(v));
                    let inside = (x - 0.2 * n + 0.1).powi(2) + y.powi(2) < 0.5 + 0.1 * phase;
                    let wave = ((2.0 + c) * x + (1.0 + n) * y + phase).sin()
                        + 0.5 * (3.0 * c + n - 4.0 * x * y).cos();
                    let wave = if c < 3.0 { wave.abs() / 1.5 } else { wave };
                    data.push(if inside { wave as f32 } else { 0.0 });
                }
            }
        }
    }
    Tensor::from_vec(data, (poses, 6, side, side), &Device::Cpu).unwrap()
}

/// Largest difference, relative to the largest value.
fn difference(got: &Tensor, want: &[f32]) -> f32 {
    let got: Vec<f32> = got.flatten_all().unwrap().to_vec1().unwrap();
    assert_eq!(got.len(), want.len());
    let scale = want.iter().fold(0f32, |m, w| m.max(w.abs()));
    got.iter().zip(want).map(|(g, w)| (g - w).abs()).fold(0.0, f32::max) / scale
}

#[test]
fn outputs_equal_those_of_torch() {
    let e = expected();
    let (a, b) = (image(e.poses, e.side, 0.0), image(e.poses, e.side, 1.0));
    let (t, r) = RefineNet::new(&weights("refiner.safetensors")).unwrap().forward(&a, &b).unwrap();
    let net = ScoreNet::new(&weights("scorer.safetensors")).unwrap();
    let s = net.compare(&net.features(&a, &b).unwrap()).unwrap();
    let all =
        [difference(&t, &e.translation), difference(&r, &e.rotation), difference(&s, &e.score)];
    eprintln!("width {}, side {}: relative differences {all:?}", e.width, e.side);
    assert!(all.iter().all(|d| *d < 1e-5), "{all:?}");
    // The features may be made in parts, the comparison not.
    let parts: Vec<Tensor> = (0..e.poses)
        .map(|i| net.features(&a.narrow(0, i, 1).unwrap(), &b.narrow(0, i, 1).unwrap()).unwrap())
        .collect();
    let again = net.compare(&Tensor::cat(&parts, 0).unwrap()).unwrap();
    assert!(difference(&again, &e.score) < 1e-5);
    let alone = net.compare(&parts[0]).unwrap();
    assert!(difference(&alone, &e.score[..1]) > 1e-3);
    // The two inputs are not the same to the networks.
    let swapped = net.compare(&net.features(&b, &a).unwrap()).unwrap();
    assert!(difference(&swapped, &e.score) > 1e-3);
}

/// Parameters of each network at a width (of the first convolution), in torch's count.
fn parameters(c: usize) -> [usize; 2] {
    let conv = |i: usize, o: usize, k: usize| i * o * k * k + o + 2 * o;
    let block = |w: usize| 2 * conv(w, w, 3);
    let linear = |i: usize, o: usize| i * o + o;
    let single = conv(6, c, 7) + conv(c, 2 * c, 3) + 2 * block(2 * c);
    let encoder = single + 2 * block(4 * c) + conv(4 * c, 8 * c, 3) + 2 * block(8 * c);
    let w = 8 * c;
    let attention = linear(w, 3 * w) + linear(w, w);
    let head = attention + 2 * linear(w, w) + 4 * w + linear(w, 3);
    [encoder + 2 * head, encoder + 2 * attention + linear(w, 1)]
}

#[test]
fn the_layout_has_as_many_parameters_as_the_released_networks() {
    let e = expected();
    assert_eq!(parameters(e.width), [e.refiner_parameters, e.scorer_parameters]);
    assert_eq!(parameters(64), [16_830_406, 15_773_121]);
}

#[test]
fn missing_weights_say_where_to_get_them_and_the_licence() {
    let dir = tempfile::tempdir().unwrap();
    let e = load(dir.path(), &Device::Cpu, PoseConfig::default()).unwrap_err().to_string();
    for part in [REFINER_FILE, "research", "convert_foundationpose.py"] {
        assert!(e.contains(part), "{e}");
    }
    // The refiner's file under the scorer's name: the tensor that is not there is named.
    std::fs::copy(folder().join("refiner.safetensors"), dir.path().join(REFINER_FILE)).unwrap();
    std::fs::copy(folder().join("refiner.safetensors"), dir.path().join(SCORER_FILE)).unwrap();
    let e = load(dir.path(), &Device::Cpu, PoseConfig::default()).unwrap_err().to_string();
    assert!(e.contains("encoderA.0.layers.0.weight") && e.contains(SCORER_FILE), "{e}");
    std::fs::copy(folder().join("scorer.safetensors"), dir.path().join(SCORER_FILE)).unwrap();
    load(dir.path(), &Device::Cpu, PoseConfig::default()).unwrap();
}
