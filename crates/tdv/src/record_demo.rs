use crate::arguments::RecordDemoArgs;
use crate::observe::bar;
use anyhow::Context as _;
use std::path::Path;
use tdv_geometry::Stamp;
use tdv_rendering::ObjectFile;
use tdv_runtime::camera_bag::{CameraBagWriter, PosesBagWriter};
use tdv_simulation::record::{DemoObject, Recorder, TaskDemo, demonstration};

/// Time of the first frame of a rendered demonstration: 2026-01-01 12:00 UTC.
const EPOCH: Stamp = Stamp(1_767_268_800_000_000_000);

fn object(folder: &Path, name: &str) -> anyhow::Result<DemoObject> {
    let folder = folder.join(name);
    let mesh = ObjectFile::load(&folder)?.load_mesh(&folder)?;
    Ok(DemoObject { name: name.to_owned(), mesh })
}

/// Renders a demonstration into two bags: what a camera sees, and the truth.
pub fn run(args: &RecordDemoArgs) -> anyhow::Result<()> {
    render(args).map(|_| ())
}

/// As [`run`]; gives the stamp of each frame and whether the hand holds the object in it.
pub fn render(args: &RecordDemoArgs) -> anyhow::Result<Vec<(Stamp, bool)>> {
    let TaskDemo { mut config, moving, reference, others } =
        demonstration(&args.task, args.seed).context("no such task")?;
    config.start = EPOCH;
    let (intrinsics, camera_pose) = (config.sensor.intrinsics, config.camera);
    let others = others
        .into_iter()
        .map(|(name, pose)| Ok((object(&args.objects, name)?, pose)))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let (moving, reference) = (object(&args.objects, moving)?, object(&args.objects, reference)?);
    let mut recorder = Recorder::new(config, moving, reference)?.with_others(others);
    let name = args.output.file_name().map_or_else(|| "bag".into(), |n| n.to_string_lossy());
    let truth_path = args.output.with_file_name(format!("{name}_truth"));
    let mut camera = CameraBagWriter::create(&args.output, intrinsics, camera_pose, args.quality)?;
    let mut truth = PosesBagWriter::create(&truth_path)?;
    let progress = bar(recorder.frames() as u64, "recording");
    let mut contacts = Vec::with_capacity(recorder.frames());
    for index in 0..recorder.frames() {
        let (frame, is) = recorder.frame(index);
        camera.frame(frame.stamp, &frame.color, &frame.depth)?;
        let objects: Vec<_> =
            is.objects.iter().map(|(name, pose)| (name.as_str(), *pose)).collect();
        truth.frame(is.stamp, &objects, Some(&is.joints))?;
        contacts.push((frame.stamp, is.contact));
        progress.inc(1);
    }
    progress.finish_and_clear();
    println!("{}", camera.finish()?.display());
    println!("{}", truth.finish()?.display());
    Ok(contacts)
}
