//! The one human demonstration of a task, in process: the lab's scripted demonstrator, whose objects and
//! hand joints are taken as they are. No camera: what tracking and hand networks would add is measured
//! elsewhere.

use super::Table2Error;
use tdv_demonstration::{
    Demonstration, FrameObservation, ParseConfig, ParseReport, Task, TaskKind, parse,
};
use tdv_geometry::{pose_from_xyz_rpy, yaw_of};
use tdv_simulation::LabAssets;
use tdv_simulation::avatar::GraspTarget;
use tdv_simulation::record::{DemoConfig, DemoObject, Recorder};
use tdv_simulation::scene::Placement;

/// Where the moving object stands in the demonstration: x, y (m), yaw (rad) in base_link.
const START: [f64; 3] = [0.55, 0.10, 0.262];
/// Yaw at which the demonstrator puts it down, rad.
const END_YAW: f64 = 0.1;
/// Seed of the hand's small motions. One demonstration per task: it is the same in every cell.
const SEED: u64 = 1;

/// Shows a task once and parses what was seen.
///
/// # Errors
/// [`Table2Error::Task`] for a task that the scripted demonstrator cannot show (it takes an upright
/// object and puts it down on another one), and whatever recording and parsing refuse.
pub fn demonstrate(
    task: &Task,
    assets: &LabAssets,
) -> Result<(Demonstration, ParseReport), Table2Error> {
    let frames = frames(task, assets)?;
    Ok(parse(&frames, task, &ParseConfig::default())?)
}

fn frames(task: &Task, assets: &LabAssets) -> Result<Vec<FrameObservation>, Table2Error> {
    let cannot =
        |reason: &str| Table2Error::Task { name: task.name.clone(), reason: reason.into() };
    if task.kind != TaskKind::Object {
        return Err(cannot(
            "the scripted demonstrator takes an object; this is a task of the hand",
        ));
    }
    let (Some(moving), Some(reference)) = (task.moving_shape(), task.reference_shape()) else {
        return Err(cannot("it has no shape of its moving or reference object"));
    };
    let object = |name: &str| -> Result<DemoObject, Table2Error> {
        let i = assets.scene.index_of(name)?;
        Ok(DemoObject { name: name.to_owned(), mesh: assets.meshes[i].clone() })
    };
    let at = assets.scene.index_of(&task.reference_object)?;
    let Placement::Spot(spot) = &assets.scene.objects[at].start else {
        return Err(cannot("its scene has no fixed place for the reference object"));
    };
    let narrowest = task.grasp.closing.iter().map(|c| c.width).min_by(f64::total_cmp);
    let width = narrowest.unwrap_or(2.0 * moving.radius);
    let [low, high] = task.grasp.height.unwrap_or([0.5 * moving.height, 0.7 * moving.height]);
    let [x, y] = spot.xy;
    let mut config = DemoConfig::cup_on_coaster(SEED, START);
    config.moving_start =
        pose_from_xyz_rpy([START[0], START[1], -moving.bottom], [0.0, 0.0, START[2]]);
    config.reference = pose_from_xyz_rpy([x, y, -reference.bottom], [0.0; 3]);
    config.moving_end =
        pose_from_xyz_rpy([x, y, reference.height - moving.bottom], [0.0, 0.0, END_YAW]);
    config.target = GraspTarget {
        radius: 0.5 * width,
        height: moving.height,
        tool_height: 0.5 * (low + high) - moving.bottom,
    };
    let recorder =
        Recorder::new(config, object(&task.moving_object)?, object(&task.reference_object)?)?;
    Ok((0..recorder.frames())
        .map(|i| {
            let truth = recorder.truth(i);
            let objects = truth.objects.iter().map(|(n, p)| (n.clone(), (*p, 1.0))).collect();
            FrameObservation { stamp: truth.stamp, objects, hand: Some(truth.joints) }
        })
        .collect())
}

/// Yaw (rad) at which the moving object stood in the demonstration: that of level PG.
pub(super) fn start_yaw(demonstration: &Demonstration) -> f64 {
    demonstration.object_start.map_or(START[2], |p| yaw_of(&p.rotation))
}
