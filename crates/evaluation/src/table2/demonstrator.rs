//! The one human demonstration of a task, in process: the lab's scripted demonstrator, whose objects and
//! hand joints are taken as they are. The benchmark's tasks have scripts of their own; any other task that
//! puts an upright object on another is shown as the cup is. No camera: what tracking and hand networks would add is measured
//! elsewhere.

use super::Table2Error;
use tdv_demonstration::{
    Demonstration, FrameObservation, ParseConfig, ParseReport, RemapMethod, Task, TaskKind, parse,
};
use tdv_geometry::{pose_from_xyz_rpy, yaw_of};
use tdv_simulation::LabAssets;
use tdv_simulation::avatar::GraspTarget;
use tdv_simulation::record::{self, DemoConfig, DemoObject, Motion, Recorder, TaskDemo};
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
/// [`Table2Error::Task`] for a task that the scripted demonstrator cannot show (one without a script that
/// is not about an upright object put down on another), and whatever recording and parsing refuse.
pub fn demonstrate(
    task: &Task,
    assets: &LabAssets,
) -> Result<(Demonstration, ParseReport), Table2Error> {
    let frames = frames(task, assets)?;
    let mut config = ParseConfig::default();
    if task.kind == TaskKind::Hand {
        // No object tells where between the fingers a thing is: the fingertips do.
        config.remap.method = RemapMethod::Phantom;
    }
    Ok(parse(&frames, task, &config)?)
}

fn frames(task: &Task, assets: &LabAssets) -> Result<Vec<FrameObservation>, Table2Error> {
    let object = |name: &str| -> Result<DemoObject, Table2Error> {
        let i = assets.scene.index_of(name)?;
        Ok(DemoObject { name: name.to_owned(), mesh: assets.meshes[i].clone() })
    };
    let scripted = record::demonstration(&task.name, SEED)
        .filter(|d| matches!(d.config.motion, Motion::Script(_)));
    let recorder = match scripted {
        Some(TaskDemo { config, moving, reference, others }) => {
            let others: Result<Vec<_>, Table2Error> =
                others.into_iter().map(|(name, pose)| Ok((object(name)?, pose))).collect();
            Recorder::new(config, object(moving)?, object(reference)?)?.with_others(others?)
        }
        None => {
            let config = placing(task, assets)?;
            Recorder::new(config, object(&task.moving_object)?, object(&task.reference_object)?)?
        }
    };
    Ok((0..recorder.frames())
        .map(|i| {
            let truth = recorder.truth(i);
            let objects = truth.objects.iter().map(|(n, p)| (n.clone(), (*p, 1.0))).collect();
            FrameObservation { stamp: truth.stamp, objects, hand: Some(truth.joints) }
        })
        .collect())
}

/// An upright object put down on another, as the cup on the coaster.
fn placing(task: &Task, assets: &LabAssets) -> Result<DemoConfig, Table2Error> {
    let cannot =
        |reason: &str| Table2Error::Task { name: task.name.clone(), reason: reason.into() };
    if task.kind != TaskKind::Object {
        return Err(cannot("there is no script for it, and it is a task of the hand"));
    }
    let (Some(moving), Some(reference)) = (task.moving_shape(), task.reference_shape()) else {
        return Err(cannot("it has no shape of its moving or reference object"));
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
    Ok(config)
}

/// Yaw (rad) at which the object that varies stood in the demonstration: that of level PG. It is the moving
/// object, in a task of the hand the reference.
pub(super) fn start_yaw(demonstration: &Demonstration) -> f64 {
    yaw_of(&demonstration.object_start.unwrap_or(demonstration.reference_pose).rotation)
}

#[cfg(test)]
mod tests {
    use crate::table2::Stage;
    use std::path::Path;
    use tdv_demonstration::GripperEnd::{Close, None as Stay, Open};
    use tdv_geometry::nalgebra::Vector3;

    #[test]
    fn every_task_is_parsed_from_its_demonstration() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        // Where the tool of the first procedure ends, in its reference's frame, and what follows.
        for (name, grasp, second) in [
            ("cup_on_coaster", [0.0, 0.0, 0.0625], Open),
            ("stitch_on_card", [0.0, 0.0, 0.048], Open),
            ("ring_on_peg", [0.0, 0.0, 0.0225], Open),
            ("pour_water", [0.0, 0.0, 0.050], Stay),
            ("open_drawer", [0.145, 0.0, 0.064], Open),
            ("insert_plug", [-0.045, 0.0, 0.072], Open),
            ("pull_tissue", [0.0, 0.0, 0.086], Stay),
        ] {
            let stage = Stage::load(&root, name).unwrap_or_else(|e| panic!("{name}: {e}"));
            let d = &stage.demonstration;
            let ends: Vec<_> = d.procedures.iter().map(|p| p.end).collect();
            assert_eq!(ends, [Close, second], "{name}");
            let goal = d.procedures[0].goal();
            let off = goal.translation.vector - Vector3::from(grasp);
            println!("{name}: grasp off by {:?} mm", (1e3 * off).as_slice());
            assert!(off.xy().norm() < 1e-6 && off.z.abs() < 0.005, "{name}: {off}");
            assert!((goal.rotation * Vector3::z()).z < -0.999, "{name}");
            // What the hand has taken it moves as the thing can move.
            let moved = d.procedures[1].goal().translation.vector - goal.translation.vector;
            match name {
                "open_drawer" => assert!(moved.x > 0.11 && moved.yz().norm() < 0.006, "{moved}"),
                "pull_tissue" => assert!(moved.z > 0.12 && moved.xy().norm() < 0.006, "{moved}"),
                "insert_plug" => {
                    let hole = Vector3::new(0.090, 0.0, -0.014);
                    assert!((moved - hole).norm() < 0.006, "{moved}");
                }
                // On the base plate, not on the peg's top.
                "ring_on_peg" => {
                    let end = d.procedures[1].goal().translation;
                    assert!((end.z - 0.010).abs() < 1e-6, "{end}");
                }
                _ => {}
            }
        }
    }
}
