//! The whole networks against transformers. `tests/golden/foundation/make_onnx_networks.py` makes tiny
//! ones, which are too large to be committed.

use super::*;
use crate::text_image::phrases::Phrases;
use crate::text_image::wordpiece::WordPiece;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use tdv_perception::backend::{CutOut, FollowMask, LocateText, PixelBox};
use tdv_rendering::{Rgb, RgbImage};

/// The folder, and a reason to skip.
fn folder() -> Option<PathBuf> {
    let folder = std::env::var_os("TDV_ONNX_GOLDEN").map(PathBuf::from);
    if folder.is_none() || library().is_err() {
        eprintln!("skipped: TDV_ONNX_GOLDEN and ORT_DYLIB_PATH have to be set");
        return None;
    }
    folder
}

fn read<T: DeserializeOwned>(folder: &Path, name: &str) -> T {
    serde_json::from_str(&std::fs::read_to_string(folder.join(name)).unwrap()).unwrap()
}

/// The script's formula.
fn image(height: usize, width: usize) -> Vec<f32> {
    let mut out = Vec::new();
    for c in (0..3).map(f64::from) {
        for v in (0..height).map(|v| v as f64) {
            for u in (0..width).map(|u| u as f64) {
                let wave = (0.11 * (c + 1.0) * u + 0.07 * v + c).sin();
                out.push((wave + 0.3 * (0.05 * u * (v + c) / 9.0).cos()) as f32);
            }
        }
    }
    out
}

fn difference(got: &[f32], want: &[f32]) -> f32 {
    assert_eq!(got.len(), want.len());
    let scale = want.iter().fold(0f32, |m, w| m.max(w.abs()));
    got.iter().zip(want).map(|(g, w)| (g - w).abs()).fold(0.0, f32::max) / scale
}

#[derive(Deserialize)]
struct Grounding {
    phrases: Vec<String>,
    logits: Vec<f32>,
    boxes: Vec<f32>,
}

#[test]
fn groundingdino_answers_as_in_transformers() {
    let Some(folder) = folder() else { return };
    let want: Grounding = read(&folder, "grounding.json");
    let mut net = GroundingDino::load(&folder).unwrap();
    let words = WordPiece::load(&folder.join("vocab.txt")).unwrap();
    let phrases = Phrases::new(&want.phrases, &words).unwrap();
    let (logits, columns, boxes) = net.forward((image(192, 256), 256, 192), &phrases).unwrap();
    let n = phrases.ids.len();
    let cut: Vec<f32> = logits.chunks(columns).flat_map(|r| r[..n].to_vec()).collect();
    let d = [difference(&cut, &want.logits), difference(&boxes, &want.boxes)];
    eprintln!("groundingdino: relative differences {d:?}");
    assert!(d.iter().all(|d| *d < 1e-4), "{d:?}");
    // Another number of tokens than the file was traced with.
    net.threshold = 0.0;
    let photo = RgbImage::from_fn(64, 48, |x, y| Rgb([x as u8 * 4, y as u8 * 5, 90]));
    let net: &mut dyn LocateText = &mut net;
    let found = net.locate(&photo, &["mug".into()]).unwrap();
    assert!(!found.is_empty());
    for f in &found {
        assert!(f.phrase == 0 && f.pixels.right <= 63.5 && f.pixels.top >= -0.5, "{f:?}");
    }
}

#[derive(Deserialize)]
struct Segmenting {
    boxes: Vec<[f32; 4]>,
    masks: Vec<f32>,
    iou: Vec<f32>,
    object: Vec<f32>,
}

#[test]
fn sam2_answers_as_in_transformers() {
    let Some(folder) = folder() else { return };
    let want: Segmenting = read(&folder, "sam2.json");
    let mut net = Sam2::load(&folder).unwrap();
    let features = net.encode(image(128, 128)).unwrap();
    let out = net.decode(&features, &want.boxes).unwrap();
    let (shape, masks) = &out[0];
    let columns = shape[4];
    let every_fourth: Vec<f32> = masks
        .chunks(columns)
        .step_by(4)
        .flat_map(|r| r.iter().step_by(4).copied().collect::<Vec<_>>())
        .collect();
    let d = [
        difference(&every_fourth, &want.masks),
        difference(&out[1].1, &want.iou),
        difference(&out[2].1, &want.object),
    ];
    eprintln!("sam2: relative differences {d:?}");
    assert!(d.iter().all(|d| *d < 1e-4), "{d:?}");
    // Another number of boxes; masks have the image's size.
    let photo = RgbImage::from_fn(64, 48, |x, y| Rgb([x as u8 * 4, y as u8 * 5, 90]));
    let b = PixelBox { left: 10.0, top: 10.0, right: 40.0, bottom: 30.0 };
    let made = net.cut_out(&photo, &[b]).unwrap();
    assert_eq!((made.len(), made[0].width, made[0].height), (1, 64, 48));
    assert!(net.cut_out(&photo, &[]).unwrap().is_empty());
    let mut follower = Sam2Follower::new(net);
    assert!(follower.follow(&photo).is_err(), "nothing to follow yet");
}

#[test]
fn missing_files_are_named_before_the_library_is_needed() {
    let e = Sam2::load(Path::new("no/such")).unwrap_err().to_string();
    assert!(e.contains("sam2_encoder.onnx") && e.contains("Apache-2.0"), "{e}");
    let e = GroundingDino::load(Path::new("no/such")).unwrap_err().to_string();
    assert!(e.contains("vocab.txt"), "{e}");
}
