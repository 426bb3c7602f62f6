//! Renders the scripted demonstration to PNG files, to look at:
//! `cargo run -p tdv-simulation --example demonstration_frames -- DIRECTORY [SEED [X Y YAW_DEG | TASK]]`.
//! Every third frame is written, with one line of truth a frame in `truth.txt` (frame, contact, then
//! 21 joint pixels).

use std::error::Error;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use tdv_rendering::ObjectFile;
use tdv_simulation::record::{DemoConfig, DemoObject, Recorder, demonstration};

fn object(name: &str) -> Result<DemoObject, Box<dyn Error>> {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/objects").join(name);
    let mesh = ObjectFile::load(&dir)?.load_mesh(&dir)?;
    Ok(DemoObject { name: name.to_owned(), mesh })
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let directory = PathBuf::from(arguments.next().ok_or("name a directory for the pictures")?);
    let mut words: Vec<String> = arguments.collect();
    let task = words.pop_if(|w| w.parse::<f64>().is_err());
    let numbers = words.iter().map(|a| a.parse()).collect::<Result<Vec<f64>, _>>()?;
    let seed = numbers.first().map_or(1, |s| *s as u64);
    let start = match numbers.get(1..4) {
        Some(v) => [v[0], v[1], v[2].to_radians()],
        None => [0.55, 0.10, 15_f64.to_radians()],
    };
    std::fs::create_dir_all(&directory)?;
    let mut recorder = match task {
        None => {
            let config = DemoConfig::cup_on_coaster(seed, start);
            Recorder::new(config, object("mug")?, object("coaster")?)?
        }
        Some(task) => {
            let demo = demonstration(&task, seed).ok_or("no such task")?;
            let mut others = Vec::new();
            for (name, pose) in demo.others {
                others.push((object(name)?, pose));
            }
            Recorder::new(demo.config, object(demo.moving)?, object(demo.reference)?)?
                .with_others(others)
        }
    };
    let camera = recorder.config().sensor.intrinsics;
    let t_camera_base = recorder.config().camera.inverse();
    let mut lines = String::new();
    for index in (0..recorder.frames()).step_by(3) {
        let (frame, truth) = recorder.frame(index);
        frame.color.save(directory.join(format!("{index:03}.png")))?;
        write!(lines, "{index} {}", u8::from(truth.contact))?;
        for joint in &truth.joints {
            let (u, v) = camera.project(&(t_camera_base * joint)).unwrap_or_default();
            write!(lines, " {u:.1} {v:.1}")?;
        }
        lines.push('\n');
    }
    std::fs::write(directory.join("truth.txt"), lines)?;
    Ok(())
}
