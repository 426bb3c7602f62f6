//! Renders the lab's scenes as its camera sees them, to look at:
//! `cargo run -p tdv-simulation --example scene_picture -- DIRECTORY [SEED] [SCENE ...]`.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tdv_simulation::backdrop::{Backdrop, BackdropConfig};
use tdv_simulation::sensor::{RgbdSensor, SceneItem, SensorFrame};
use tdv_simulation::{Lab, LabAssets, Scene};

const SCENES: [&str; 6] =
    ["stitch_on_card", "ring_on_peg", "pour_water", "open_drawer", "insert_plug", "pull_tissue"];

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let directory = PathBuf::from(arguments.next().ok_or("name a directory for the pictures")?);
    let seed = arguments.next().map_or(Ok(1), |s| s.parse())?;
    let named: Vec<String> = arguments.collect();
    let names: Vec<&str> =
        if named.is_empty() { SCENES.to_vec() } else { named.iter().map(String::as_str).collect() };
    std::fs::create_dir_all(&directory)?;
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scenes");
    for name in names {
        let scene = Scene::load(&scenes.join(name).with_extension("yaml"))?;
        let mut lab = Lab::from_assets(Arc::new(LabAssets::load(scene)?), seed)?;
        (0..250).for_each(|_| lab.step());
        let backdrop = Backdrop::generate(&BackdropConfig::default(), seed);
        let camera = &lab.scene().camera;
        let mut sensor = RgbdSensor::new(camera.sensor(), seed);
        let mut items = backdrop.items();
        let seen = lab.render_instances();
        items.extend(seen.iter().map(|i| SceneItem { mesh: i.mesh, pose: i.pose, id: i.id }));
        let mut frame = SensorFrame::default();
        sensor.capture(&camera.pose(), &items, &backdrop.lighting, 0, &mut frame);
        frame.color.save(directory.join(format!("{name}.png")))?;
    }
    Ok(())
}
