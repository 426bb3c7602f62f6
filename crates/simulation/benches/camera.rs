//! Times of the lab's camera: a picture of the cup scene, with and without its imperfections, and with
//! the still part drawn anew each time.
#![allow(missing_docs)]

use criterion::{Criterion, criterion_group, criterion_main};
use std::path::Path;
use tdv_simulation::backdrop::{Backdrop, BackdropConfig};
use tdv_simulation::sensor::{RgbdSensor, SceneItem, SensorConfig, SensorFrame};
use tdv_simulation::{Lab, Scene};

fn camera(c: &mut Criterion) {
    let scene =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scenes/cup_on_coaster.yaml");
    let lab = Scene::load(&scene).and_then(|s| Lab::new(&s, 1)).expect("the scene");
    let backdrop = Backdrop::generate(&BackdropConfig::default(), 1);
    let mut items: Vec<SceneItem<'_>> = backdrop.items();
    let still = items.len();
    let instances = lab.render_instances();
    items.extend(instances.iter().map(|i| SceneItem { mesh: i.mesh, pose: i.pose, id: i.id }));
    let pose = lab.scene().camera.pose();
    let mut picture = |name: &str, config: SensorConfig, still: usize| {
        let mut sensor = RgbdSensor::new(config, 1);
        sensor.keep_still(still);
        let mut frame = SensorFrame::default();
        let mut number = 0;
        c.bench_function(name, |b| {
            b.iter(|| {
                number += 1;
                sensor.capture(&pose, &items, &backdrop.lighting, number, &mut frame);
            });
        });
    };
    let lab = lab.scene().camera.sensor();
    picture("picture", lab.clone(), still);
    picture("picture, still part drawn anew", lab.clone(), 0);
    let mut perfect = lab.clone();
    perfect.depth.enabled = false;
    picture("picture, perfect depth", perfect.clone(), still);
    perfect.color.enabled = false;
    picture("picture, perfect depth and colour", perfect, still);
}

criterion_group!(benches, camera);
criterion_main!(benches);
