//! How well objects are found in the lab's scenes: first pose and the pose ten frames later, by seed.
//!
//!     cargo run --example first_pose -- config/scenes/cup_on_coaster.yaml "put the mug on the coaster" 40

use anyhow::Context as _;
use std::path::Path;
use std::sync::Arc;
use tdv_geometry::{Stamp, yaw_of};
use tdv_perception::{ObjectModel, Perceiver, PerceiverConfig, RgbdFrame};
use tdv_simulation::backdrop::{Backdrop, BackdropConfig};
use tdv_simulation::sensor::{RgbdSensor, SceneItem, SensorFrame};
use tdv_simulation::{Lab, LabAssets, Scene};

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, prompt, count, rest @ ..] = arguments.as_slice() else {
        anyhow::bail!("arguments: SCENE PROMPT COUNT [FIRST_SEED]");
    };
    let first: u64 = rest.first().map_or(Ok(1), |s| s.parse())?;
    let assets = Arc::new(LabAssets::load(Scene::load(Path::new(scene))?)?);
    let (mut bad, count) = (0, count.parse::<u64>()?);
    for seed in first..first + count {
        let lab = Lab::from_assets(assets.clone(), seed)?;
        let knowledge = lab.knowledge();
        let models = assets
            .scene
            .objects
            .iter()
            .zip(&knowledge.mesh_scale)
            .map(|(o, s)| {
                let folder = Path::new("config/objects").join(&o.name);
                Ok(ObjectModel::load(&folder)?.rescaled(*s))
            })
            .collect::<anyhow::Result<Vec<_>>>()?;
        let config = PerceiverConfig { prompt: prompt.clone(), ..Default::default() };
        let mut perceiver = Perceiver::new(config, models);
        let distractors = assets.scene.distractors;
        let room = Backdrop::generate(&BackdropConfig { distractors, ..Default::default() }, seed);
        let mut sensor = RgbdSensor::new(assets.scene.camera.sensor(), seed);
        let camera = assets.scene.camera.pose();
        let poses = lab.render_poses();
        let mut items: Vec<SceneItem> = room.items();
        items.extend(assets.instances(&poses).into_iter().map(|i| SceneItem {
            mesh: i.mesh,
            pose: i.pose,
            id: i.id,
        }));
        let mut line = format!("seed {seed:3}");
        let mut wrong = false;
        for frame in 0..10 {
            let mut out = SensorFrame::default();
            sensor.capture(&camera, &items, &room.lighting, frame, &mut out);
            if frame == 0 && seed == first {
                out.color.save("/tmp/first_pose.png").context("picture")?;
            }
            let image = RgbdFrame {
                stamp: Stamp(frame as i64 * 33_000_000),
                color: out.color,
                depth: out.depth,
                intrinsics: knowledge.intrinsics,
            };
            let began = std::time::Instant::now();
            let seen = perceiver.step(&image)?;
            if frame != 0 && frame != 9 {
                continue;
            }
            line += &format!(" | {:5.0} ms", 1e3 * began.elapsed().as_secs_f64());
            for d in &seen.detections {
                let truth = lab.object_pose(&d.name)?;
                let model = ObjectModel::load(&Path::new("config/objects").join(&d.name))?;
                let found = camera * d.pose;
                let (distance, angle) = model.distance(&found, &truth);
                line += &format!(
                    " {} {:4.1} mm {:5.1} deg {:.2}",
                    d.name,
                    1e3 * distance,
                    angle.to_degrees(),
                    d.confidence
                );
                if !d.reason.is_empty() {
                    line += &format!(" ({})", d.reason);
                }
                wrong |= frame == 9 && (angle > 0.2 || distance > 0.015);
            }
        }
        let m = lab.object_pose(&assets.scene.task.moving)?;
        line += &format!(
            " | true {:.2} {:.2} yaw {:4.0}{}",
            m.translation.x,
            m.translation.y,
            yaw_of(&m.rotation).to_degrees(),
            if wrong { "  WRONG" } else { "" }
        );
        bad += u64::from(wrong);
        println!("{line}");
    }
    println!("{bad} of {count} wrong");
    Ok(())
}
