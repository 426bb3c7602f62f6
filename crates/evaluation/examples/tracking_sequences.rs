//! Runs sequences of the tracking benchmark and says what happened in each.
//! `tracking_sequences [OBJECT|all [SEQUENCE|all [FRAMES [OVERLAYS]]]]`: with a folder for overlays, frames
//! with a wrong or missing pose (every 15th otherwise) are written there: the true outline green, the
//! estimated one magenta.
#![allow(clippy::print_stdout)]

use std::path::PathBuf;
use tdv_evaluation::tracking_synthetic::{
    BenchObject, Figures, KINDS, Look, SyntheticConfig, objects, run,
};
use tdv_rendering::{DepthOnly, Instance, Renderer, RgbImage};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let name = args.next().unwrap_or_else(|| "all".into());
    let which = args.next().unwrap_or_else(|| "all".into());
    let frames: usize = args.next().map_or(Ok(150), |a| a.parse())?;
    let folder = args.next().map(PathBuf::from);
    let config = SyntheticConfig { frames, ..SyntheticConfig::default() };
    let mut results = Vec::new();
    for (number, object) in objects().iter().enumerate() {
        if name != "all" && !name.split(',').any(|n| n == object.name) {
            continue;
        }
        for index in 0..KINDS.len() {
            if which != "all" && !which.split(',').any(|w| w == index.to_string()) {
                continue;
            }
            let mut story = String::new();
            let mut since = 0;
            let mut failed = None;
            let result = run(object, number, index, &config, |look| {
                let f = look.result;
                let class = match (f.tracking, f.valid, f.wrong()) {
                    (true, _, false) => 'T',
                    (true, _, true) => 'W',
                    (false, true, false) => 'o',
                    (false, true, true) => 'x',
                    (false, false, _) => '-',
                };
                if !story.ends_with(class) {
                    since = 0;
                    story.push_str(&format!(" {}", look.number));
                    if let (Some(t), Some(r)) = (f.translation_mm, f.rotation_deg)
                        && class != 'T'
                    {
                        story.push_str(&format!(
                            "({t:.0}mm,{r:.0}d,h{:.2},c{:.2})",
                            f.hidden, f.confidence
                        ));
                    }
                    story.push(class);
                }
                since += 1;
                let bad = f.wrong() || !f.valid;
                if let Some(folder) = &folder
                    && ((bad && since % 4 == 1) || look.number % 15 == 0)
                {
                    let path =
                        folder.join(format!("{}_{index}_{:03}.png", object.name, look.number));
                    if let Err(e) = overlay(object, look).save(&path) {
                        failed = Some(format!("{}: {e}", path.display()));
                    }
                }
            })?;
            if let Some(reason) = failed {
                return Err(reason.into());
            }
            let f = Figures::of([&result]);
            println!("{:13}{index} {:9} {}", object.name, format!("{:?}", result.kind), line(&f));
            println!("    {story}");
            results.push(result);
        }
    }
    println!("{:24} {}", "all", line(&Figures::of(&results)));
    println!("{}", serde_json::to_string(&Figures::of(&results))?);
    Ok(())
}

fn line(f: &Figures) -> String {
    let n = |v: Option<f64>| v.map_or("    -".into(), |v| format!("{v:5.1}"));
    format!(
        "confident {:5.1} %  AUC {} / {}  wrong {:3}  losses {} ({})  {} mm {} deg  {} ms",
        f.confident_percent,
        n(f.auc_unoccluded),
        n(f.auc_occluded),
        f.wrong_confident,
        f.losses,
        f.recoveries,
        n(f.median_translation_mm),
        n(f.median_rotation_deg),
        n(f.ms_per_frame)
    )
}

fn overlay(object: &BenchObject, look: &Look<'_>) -> RgbImage {
    let mut image = look.frame.color.clone();
    let mut renderer = Renderer::new();
    let mut out = DepthOnly::default();
    let k = &look.frame.intrinsics;
    for (pose, color) in [(Some(look.truth), [0, 255, 0]), (look.estimate, [255, 0, 255])] {
        let Some(pose) = pose else { continue };
        renderer.render_depth(k, &[Instance { mesh: &object.mesh, pose, id: 1 }], &mut out);
        let on = |x: u32, y: u32| out.depth.data[(y * k.width + x) as usize] > 0.0;
        for y in 1..k.height - 1 {
            for x in 1..k.width - 1 {
                let edge =
                    on(x, y) && !(on(x - 1, y) && on(x + 1, y) && on(x, y - 1) && on(x, y + 1));
                if edge {
                    image.get_pixel_mut(x, y).0 = color;
                }
            }
        }
    }
    image
}
