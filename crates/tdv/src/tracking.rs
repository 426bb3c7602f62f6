//! `tdv eval tracking`: a recorded data set with reference poses, in process or through the live graph.

use crate::arguments::TrackingArgs;
use crate::eval::write_json;
use crate::launch;
use crate::tracking_synthetic;
use anyhow::{Context as _, bail};
use std::collections::BTreeMap;
use std::path::Path;
use tdv_evaluation::{TrackingFrame, TrackingReport};
use tdv_geometry::Pose;
use tdv_msgs::tdv_msgs::msg::TrackedObject;
use tdv_perception::visp::{self, Sequence};
use tdv_perception::{Perceiver, PerceiverConfig};
use tdv_runtime::camera_bag::CameraBagWriter;
use tdv_runtime::tracked;
use tdv_runtime::trial::{TrialSetup, run_replay, shutdown_on_signals};

/// Quality of the bag's JPEG images: nearly lossless.
const QUALITY: u8 = 97;
/// Seconds for the whole replay.
const PATIENCE: f64 = 60.0;

/// Tracks the object of a data set and compares with its reference.
pub fn run(args: &TrackingArgs) -> anyhow::Result<bool> {
    if args.synthetic {
        return tracking_synthetic::run(args);
    }
    let dataset = args.dataset.as_deref().context("--dataset is missing")?;
    if args.object != "cube" {
        bail!("the data set has reference poses of the cube only, not of {:?}", args.object);
    }
    let sequence = Sequence::open(dataset)?;
    if !args.live {
        let summary = visp::evaluate_visp(dataset)?;
        println!("{summary:#?}");
        if let Some(path) = &args.json {
            write_json(path, &serde_json::json!({ "summary": summary }))?;
        }
        return Ok(summary.lost == 0);
    }
    let report = live(args, dataset, &sequence)?;
    println!("{:#?}", report.summary);
    if let Some(path) = &args.json {
        write_json(path, &report)?;
    }
    Ok(report.summary.lost == 0)
}

/// The data set as a bag, with the camera's pose such that the table of the first frame is z = 0.
///
/// # Errors
/// A file of the data set is missing or broken, no table is in view, or the bag cannot be written.
pub fn import(sequence: &Sequence, bag: &Path) -> anyhow::Result<Pose> {
    let config = PerceiverConfig { prompt: "track the cube".into(), ..Default::default() };
    let mut perceiver = Perceiver::new(config, vec![sequence.cube()?]);
    let table = perceiver
        .step(&sequence.frame(0)?)?
        .table
        .context("no table plane is in the first frame")?;
    let t_base_camera = table.pose.inverse();
    let mut writer = CameraBagWriter::create(bag, sequence.intrinsics, t_base_camera, QUALITY)?;
    for index in 0..sequence.len {
        let frame = sequence.frame(index)?;
        writer.frame(frame.stamp, &frame.color, &frame.depth)?;
    }
    writer.finish()?;
    Ok(t_base_camera)
}

/// A catalogue that holds the cube alone.
fn catalogue(dataset: &Path, sequence: &Sequence, folder: &Path) -> anyhow::Result<()> {
    let cube = folder.join("cube");
    std::fs::create_dir_all(&cube)?;
    let source = dataset.join("models/cube");
    for file in ["cube.obj", "cube.mtl"] {
        std::fs::copy(source.join(file), cube.join(file))
            .with_context(|| source.join(file).display().to_string())?;
    }
    let model = sequence.cube()?;
    let (half, middle) = (0.5 * (model.max - model.min), model.centre());
    let text = format!(
        "# The cube of the ViSP data set; its mesh is untextured.\n\
         name: cube\nsynonyms: [block, box]\nmesh: cube.obj\nsymmetry: cube\nmass: 0.1\n\
         friction: 0.5\ncollision:\n  \
         - {{shape: {{box: {{half_extents: [{:?}, {:?}, {:?}]}}}}, xyz: [{:?}, {:?}, {:?}]}}\n",
        half.x, half.y, half.z, middle.x, middle.y, middle.z
    );
    std::fs::write(cube.join("object.yaml"), text)?;
    Ok(())
}

fn live(
    args: &TrackingArgs,
    dataset: &Path,
    sequence: &Sequence,
) -> anyhow::Result<TrackingReport> {
    let (bag, objects) = (args.run.join("bag"), args.run.join("objects"));
    tdv_bag::remove_bag(&bag)?;
    std::fs::create_dir_all(&args.run)?;
    let t_base_camera = import(sequence, &bag)?;
    catalogue(dataset, sequence, &objects)?;
    let launch_file = Path::new("launch_scripts/replay.launch.yaml");
    let arguments = [
        ("bag", bag.display().to_string()),
        ("task", "''".into()),
        ("prompt", "track the cube".into()),
        ("objects", "[cube]".into()),
        ("objects_dir", objects.display().to_string()),
        ("level", "false".into()),
        ("policy", "false".into()),
    ];
    let setup = TrialSetup {
        launch_file: launch_file.into(),
        share: launch::share(launch_file),
        arguments: arguments
            .into_iter()
            .map(|(k, v)| (k.to_owned(), v))
            .collect::<BTreeMap<_, _>>(),
        log_folder: args.run.join("logs"),
        domain: 59,
        patience: PATIENCE,
        pictures: false,
        fault: None,
        driver: None,
        bag: None,
    };
    let outcome = run_replay(&setup, &shutdown_on_signals()?)?;
    for exit in &outcome.exits {
        println!("{} ended ({:?}); see {}", exit.name, exit.code, args.run.join("logs").display());
    }
    let mut judge = visp::Judge::default();
    let mut frames = Vec::new();
    for index in 0..sequence.len {
        let stamp = visp::stamp_of(index);
        let pose = outcome.objects.get(&stamp).and_then(|all| {
            let seen = all.objects.iter().find(|o| o.name == "cube")?;
            if !matches!(seen.state, TrackedObject::TRACKING | TrackedObject::OCCLUDED) {
                return None;
            }
            Some(t_base_camera.inverse() * tracked::usable_pose(all, "cube")?)
        });
        let error = judge.frame(sequence, index, pose.as_ref());
        frames.push(TrackingFrame {
            frame: index,
            tracked: pose.is_some(),
            translation_mm: error.map(|(d, _)| d),
            rotation_deg: error.map(|(_, a)| a),
            ms: outcome.delay_ms.get(&stamp).copied().unwrap_or(f64::NAN),
        });
    }
    Ok(TrackingReport::new(frames, judge.jumps()))
}
