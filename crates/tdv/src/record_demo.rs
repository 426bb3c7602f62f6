use crate::arguments::RecordDemoArgs;
use crate::observe::bar;
use tdv_geometry::Stamp;
use tdv_runtime::camera_bag::{CameraBagWriter, PosesBagWriter};
use tdv_simulation::record::{Recording, RecordingConfig};

/// Time of the first frame of a rendered demonstration: 2026-01-01 12:00 UTC.
const EPOCH: Stamp = Stamp(1_767_268_800_000_000_000);

/// Renders a demonstration into two bags: what a camera sees, and the truth.
pub fn run(args: &RecordDemoArgs) -> anyhow::Result<()> {
    let config = RecordingConfig::default();
    let mut recording = Recording::new(&config, &args.objects, args.seed)?;
    let name = args.output.file_name().map_or_else(|| "bag".into(), |n| n.to_string_lossy());
    let truth_path = args.output.with_file_name(format!("{name}_truth"));
    let mut camera = CameraBagWriter::create(
        &args.output,
        recording.intrinsics(),
        recording.t_base_camera(),
        args.quality,
    )?;
    let mut truth = PosesBagWriter::create(&truth_path)?;
    let progress = bar(recording.frame_count() as u64, "recording");
    while let Some(frame) = recording.next_frame() {
        let stamp = EPOCH.plus(frame.time);
        camera.frame(stamp, &frame.color, &frame.depth)?;
        let objects: Vec<_> =
            frame.objects.iter().map(|(name, pose)| (name.as_str(), *pose)).collect();
        truth.frame(stamp, &objects, frame.joints.as_ref().map(|j| j.as_slice()))?;
        progress.inc(1);
    }
    progress.finish_and_clear();
    println!("{}", camera.finish()?.display());
    println!("{}", truth.finish()?.display());
    Ok(())
}
