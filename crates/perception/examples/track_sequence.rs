//! Runs the perceiver over a recorded sequence and prints its figures.
//! `track_sequence DIR [OVERLAY_DIR [EVERY]]`: with a second folder, every n-th frame is written there
//! with the tracked silhouette's outline drawn in.
#![allow(clippy::print_stdout)]

use std::path::PathBuf;
use tdv_geometry::Symmetry;
use tdv_perception::visp::{Sequence, run};
use tdv_perception::{PerceiverConfig, PerceptionOutput, RgbdFrame};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let dir = PathBuf::from(args.next().ok_or("which folder? it holds cam.json, color/, depth/")?);
    let overlays = args.next().map(PathBuf::from);
    let every: usize = args.next().map_or(Ok(10), |a| a.parse())?;
    let sequence = Sequence::open(&dir)?;
    let config = PerceiverConfig { prompt: "track the cube".into(), ..PerceiverConfig::default() };
    let mut failed = None;
    let summary = run(&sequence, config, |i, frame, out| {
        let Some(d) = out.detections.first() else { return };
        let error = sequence.reference.get(i).map(|(truth, usable)| {
            let (t, a) = Symmetry::Cube.distance(&d.pose, truth);
            format!(
                "{:5.1} mm {:5.2} deg {}",
                t * 1e3,
                a.to_degrees(),
                if *usable { "" } else { "*" }
            )
        });
        println!(
            "{i:3} found {} confidence {:.2} stale {} {} {}",
            d.found,
            d.confidence,
            out.stale_depth,
            error.unwrap_or_default(),
            d.reason
        );
        if let Some(folder) = overlays.as_ref().filter(|_| i % every == 0) {
            let path = folder.join(format!("overlay_{i:04}.png"));
            if let Err(e) = outlined(frame, out).save(&path) {
                failed = Some(format!("{}: {e}", path.display()));
            }
        }
    })?;
    if let Some(reason) = failed {
        return Err(reason.into());
    }
    println!("{}", serde_json::to_string_pretty(&summary)?);
    Ok(())
}

fn outlined(frame: &RgbdFrame, out: &PerceptionOutput) -> tdv_rendering::RgbImage {
    let mut image = frame.color.clone();
    let (w, h) = image.dimensions();
    let label = |x: u32, y: u32| out.masks[(y * w + x) as usize];
    for y in 1..h - 1 {
        for x in 1..w - 1 {
            let own = label(x, y);
            let edge = own > 0
                && [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)]
                    .iter()
                    .any(|(x, y)| label(*x, *y) != own);
            if edge {
                image.get_pixel_mut(x, y).0 = [255, 0, 255];
            }
        }
    }
    image
}
