//! How fast trajectories are made: the warp alone, and whole trajectories whose every fifth pose has an
//! inverse-kinematics solution free of collisions.
//!
//! `cargo bench -p tdv-demonstration`.

use criterion::{Criterion, criterion_group, criterion_main};
use std::f64::consts::PI;
use std::hint::black_box;
use std::path::Path;
use tdv_demonstration::{
    Demonstration, GenerateOptions, GripperEnd, ProcedureDemo, Task, ToolPose, WarpConfig,
    generate_with, gripper_symmetry, warp_dmp, warp_paper, warp_repaired, warp_rigid,
};
use tdv_geometry::{Pose, PoseTrajectory, Symmetry, pose_from_xyz_rpy, smooth_step};
use tdv_robot::Kinematics;
use tdv_robot::collision::{CollisionWorld, Margins, Workcell};
use tdv_robot::urdf::RobotModel;

/// Knuckle angle (rad) of fingers on a mug.
const CLOSED: f64 = 0.2;

fn place() -> Vec<Pose> {
    let at = |i: u32| {
        let s = smooth_step(f64::from(i) / 89.0);
        let z = 0.008 * s + 0.12 * (PI * s).sin();
        pose_from_xyz_rpy([0.05 * (1.0 - s), 0.30 * (1.0 - s), z], [0.0, 0.0, 1.0 - 0.9 * s])
    };
    (0..90).map(at).collect()
}

fn demonstration() -> Option<Demonstration> {
    let grasp = pose_from_xyz_rpy([0.0, 0.0, 0.06], [PI, 0.0, 0.0]);
    let reach: Vec<Pose> = (0..60)
        .map(|i| grasp * Pose::translation(0.0, 0.0, -0.2 * (1.0 - f64::from(i) / 59.0)))
        .collect();
    let procedure = |name: &str, moving: &str, reference: &str, poses: &[Pose], symmetry, end| {
        Some(ProcedureDemo {
            name: name.into(),
            moving: moving.into(),
            reference: reference.into(),
            trajectory: PoseTrajectory::from_poses(poses, 1.0 / 30.0).ok()?,
            moving_symmetry: symmetry,
            reference_symmetry: Symmetry::None,
            end,
            reference_pose: None,
        })
    };
    let (close, open) = (GripperEnd::Close, GripperEnd::Open);
    Some(Demonstration {
        task: "cup_on_coaster".into(),
        text: "put the mug on the coaster".into(),
        procedures: vec![
            procedure("reach", "tcp", "mug", &reach, gripper_symmetry(), close)?,
            procedure("place", "mug", "coaster", &place(), Symmetry::None, open)?,
        ],
        grasp: Some(grasp),
        grasp_width: Some(0.064),
        reference_pose: pose_from_xyz_rpy([0.45, -0.22, 0.0], [0.0; 3]),
        object_start: Some(pose_from_xyz_rpy([0.50, 0.08, 0.0], [0.0, 0.0, 1.0])),
    })
}

fn bench(c: &mut Criterion) {
    let path = place();
    let start = pose_from_xyz_rpy([0.2, -0.15, 0.0], [0.0, 0.0, -0.8]);
    let config = WarpConfig::default();
    c.bench_function("warp repaired, 90 poses", |b| {
        b.iter(|| warp_repaired(black_box(&path), &start, &config));
    });
    c.bench_function("warp paper", |b| b.iter(|| warp_paper(black_box(&path), &start, 0.25)));
    c.bench_function("warp rigid", |b| b.iter(|| warp_rigid(black_box(&path), &start, 0.25)));
    c.bench_function("warp dmp", |b| b.iter(|| warp_dmp(black_box(&path), &start)));

    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let Ok(task) = Task::load(&root.join("config/tasks/cup_on_coaster.yaml")) else { return };
    let Ok(model) = RobotModel::load(&root.join("config/robot/ur5_2f85.urdf")) else { return };
    let cell = Workcell::default();
    let Ok(world) = CollisionWorld::new(&model, &cell, Margins::default(), 0.0) else { return };
    let Some(demo) = demonstration() else { return };
    let arm = Kinematics::ur5();
    let collides = |p: &ToolPose<'_>| {
        let knuckle = if p.grip { CLOSED } else { 0.0 };
        let solutions = arm.ik_tcp(&p.tool);
        if solutions.is_empty() {
            return Err("out of reach".to_owned());
        }
        let free = solutions.iter().any(|q| world.check(q, knuckle, None).is_ok());
        if free { Ok(()) } else { Err("collision".to_owned()) }
    };
    let options = GenerateOptions { collides: Some(&collides), ..Default::default() };
    let mut group =
        c.benchmark_group("50 trajectories of each of two procedures and 25 recoveries");
    group.sample_size(10);
    group.bench_function("geometry alone", |b| {
        b.iter(|| generate_with(&demo, &task, 50, 1, &GenerateOptions::default()));
    });
    group.bench_function("with inverse kinematics and collisions", |b| {
        b.iter(|| generate_with(&demo, &task, 50, 1, &options));
    });
    group.finish();
    if let Ok((_, report)) = generate_with(&demo, &task, 50, 1, &options) {
        for p in report.procedures {
            eprintln!("{}: {} starts tried, rejected {:?}", p.name, p.tried, p.rejected);
        }
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);
