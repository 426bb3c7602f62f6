use super::*;
use crate::collision::{Fixture, FixtureShape, Margins, Workcell};
use crate::executor::{Desired, ExecutorParams, JointTrajectoryExecutor};
use crate::kinematics::IkSelection;
use crate::urdf::RobotModel;
use std::f64::consts::PI;
use std::path::Path;
use tdv_geometry::{Stamp, pose_from_xyz_rpy};

const SEED: Joints = [0.2, -1.3, 1.7, -2.0, -1.6, 0.4];

fn world(wall: Option<[f64; 3]>) -> CollisionWorld {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/robot/ur5_2f85.urdf");
    let fixtures = wall.map(|edges| Fixture {
        name: "wall".into(),
        shape: FixtureShape::Box(edges),
        position: [0.5, 0.0, edges[2] / 2.0],
        rpy: [0.0; 3],
    });
    let cell = Workcell::new(fixtures.into_iter().collect());
    CollisionWorld::new(&RobotModel::load(Path::new(path)).unwrap(), &cell, Margins::default(), 0.0)
        .unwrap()
}

fn down(x: f64, y: f64, z: f64) -> Pose {
    pose_from_xyz_rpy([x, y, z], [PI, 0.0, 0.0])
}

fn at(x: f64, y: f64, z: f64) -> Joints {
    Kinematics::ur5().nearest_tcp(&down(x, y, z), &SEED, &IkSelection::default()).unwrap()
}

fn plan(
    w: &CollisionWorld,
    start: Joints,
    goal: Goal,
    seed: u64,
) -> Result<PlannedMotion, PlanError> {
    let (k, l) = (Kinematics::ur5(), Limits::default());
    let params = PlannerParams { seed, ..Default::default() };
    let planner = Planner { kinematics: &k, world: w, limits: &l, params };
    planner.plan(&PlanRequest { start, goal, knuckle: 0.2, held: None }, &mut || false)
}

/// Slack along a path looked at every half a milliradian of the fastest joint.
fn least_slack(w: &CollisionWorld, path: &[Joints]) -> f64 {
    let mut least = f64::INFINITY;
    for e in path.windows(2) {
        let most = (0..6).map(|i| (e[1][i] - e[0][i]).abs()).fold(0.0, f64::max);
        let n = (most / 2e-3).ceil() as usize;
        for i in 0..=n {
            let q = edge::between(&e[0], &e[1], i as f64 / n.max(1) as f64);
            least = least.min(w.distance(&q, 0.2, None).unwrap().slack);
        }
    }
    least
}

#[test]
fn an_open_way_is_straight_and_a_wall_is_passed() {
    let (start, goal) = (at(0.5, -0.2, 0.1), Goal::Tcp(down(0.5, 0.2, 0.1)));
    let open = plan(&world(None), start, goal.clone(), 1).unwrap();
    assert_eq!((open.path.len(), open.iterations), (2, 0));
    let end = Kinematics::ur5().fk_tcp(&open.path[1]);
    assert!((end.translation.vector - down(0.5, 0.2, 0.1).translation.vector).norm() < 1e-9);
    assert!(end.rotation.angle_to(&down(0.5, 0.2, 0.1).rotation) < 1e-6);
    let w = world(Some([0.3, 0.02, 0.25]));
    let over = Goal::Joints(vec![at(0.5, 0.2, 0.1)]);
    assert!(least_slack(&w, &[start, at(0.5, 0.2, 0.1)]) < 0.0, "the wall is in the way");
    for seed in 1..=3 {
        let m = plan(&w, start, over.clone(), seed).unwrap();
        assert!(m.path.len() > 2 && m.iterations > 0);
        assert_eq!((m.path[0], *m.path.last().unwrap()), (start, at(0.5, 0.2, 0.1)));
        let slack = least_slack(&w, &m.path);
        assert!(slack >= -1e-3, "{slack}");
        assert_eq!(m, plan(&w, start, over.clone(), seed).unwrap(), "same seed, same path");
    }
    // With all solutions of the pose to choose from, the way is hardly longer.
    let m = plan(&w, start, goal, 1).unwrap();
    assert!(least_slack(&w, &m.path) >= -1e-3);
}

#[test]
fn failures_say_what_is_wrong() {
    let w = world(Some([0.3, 0.02, 0.25]));
    let (free, wall) = (at(0.5, -0.2, 0.1), at(0.5, 0.0, 0.1));
    let e = plan(&w, wall, Goal::Joints(vec![free]), 1).unwrap_err();
    assert!(matches!(e, PlanError::Start(_)) && e.to_string().contains("wall"), "{e}");
    let e = plan(&w, free, Goal::Joints(vec![wall]), 1).unwrap_err();
    assert!(matches!(e, PlanError::Goal { tried: 1, .. }) && e.to_string().contains("wall"), "{e}");
    let e = plan(&w, free, Goal::Tcp(down(1.5, 0.0, 0.1)), 1).unwrap_err();
    assert!(matches!(e, PlanError::NoIk { .. }), "{e}");
    assert!(matches!(plan(&w, free, Goal::Joints(vec![]), 1), Err(PlanError::NoGoal { given: 0 })));
    let mut turned = free;
    turned[2] = 4.0;
    assert!(matches!(
        plan(&w, free, Goal::Joints(vec![turned]), 1),
        Err(PlanError::NoGoal { given: 1 })
    ));
    assert!(matches!(
        plan(&w, [f64::NAN; 6], Goal::Joints(vec![free]), 1),
        Err(PlanError::Start(_))
    ));
    // Time and iterations end the search.
    let (k, l) = (Kinematics::ur5(), Limits::default());
    let params = PlannerParams { max_iterations: 3, ..Default::default() };
    let planner = Planner { kinematics: &k, world: &w, limits: &l, params };
    let goal = Goal::Joints(vec![at(0.5, 0.2, 0.1)]);
    let request = PlanRequest { start: free, goal, knuckle: 0.2, held: None };
    let mut asked = 0;
    let mut expired = || {
        asked += 1;
        asked > 2
    };
    assert_eq!(
        planner.plan(&request, &mut expired).unwrap_err(),
        PlanError::TimedOut { iterations: 2 }
    );
    let one = Planner { params: PlannerParams { max_iterations: 1, ..params }, ..planner };
    assert_eq!(one.plan(&request, &mut || false).unwrap_err(), PlanError::NoPath { iterations: 1 });
}

#[test]
fn trajectories_keep_the_limits_and_the_path() {
    let (k, l) = (Kinematics::ur5(), Limits::default());
    let path = [at(0.5, -0.2, 0.1), at(0.45, 0.0, 0.4), at(0.5, 0.25, 0.1)];
    let t = parametrise(&path, &k, &l);
    let rest = |v: &[f64]| v.iter().all(|x| *x == 0.0);
    let end = t.points.last().unwrap();
    assert!(rest(&end.velocities) && rest(&end.accelerations) && end.positions == path[2]);
    let mut executor = JointTrajectoryExecutor::new(ExecutorParams::default());
    let begin = Stamp::default().plus(1.0);
    executor.accept(&t, begin, &Desired { q: path[0], qd: [0.0; 6] }).unwrap();
    let h = 0.001;
    let (mut q, mut qd, mut qdd) = (path[0], [0.0; 6], [0.0; 6]);
    let (mut fastest, mut sharpest, mut jerk): (f64, f64, f64) = (0.0, 0.0, 0.0);
    for n in 1..=(end.time_from_start / h) as usize {
        let d = executor.sample(begin.plus(h * n as f64)).unwrap();
        let acceleration: Joints = std::array::from_fn(|i| (d.qd[i] - qd[i]) / h);
        for i in 0..6 {
            assert!(d.qd[i].abs() <= l.joint_velocity + 1e-9);
            sharpest = sharpest.max(acceleration[i].abs());
            jerk = jerk.max((acceleration[i] - qdd[i]).abs() / h);
            assert!((d.q[i] - q[i] - 0.5 * h * (d.qd[i] + qd[i])).abs() < 1e-6);
        }
        let (v, w) = k.tcp_speed(&d.q, &d.qd);
        assert!(v <= l.tcp_speed + 1e-6 && w <= l.tcp_angular_speed + 1e-6, "{v} {w}");
        fastest = fastest.max(v / l.tcp_speed).max(w / l.tcp_angular_speed);
        // On one of the two lines.
        let off = path.windows(2).map(|e| {
            let (a, b) = (nalgebra::Vector6::from(e[0]), nalgebra::Vector6::from(e[1]));
            let x = (nalgebra::Vector6::from(d.q) - a).dot(&(b - a)) / (b - a).norm_squared();
            (nalgebra::Vector6::from(d.q) - a - (b - a) * x.clamp(0.0, 1.0)).norm()
        });
        assert!(off.fold(f64::INFINITY, f64::min) < 1e-6);
        (q, qd, qdd) = (d.q, d.qd, acceleration);
    }
    assert!(sharpest <= l.joint_acceleration * 1.01, "{sharpest}");
    assert!(jerk <= l.joint_jerk * 1.6, "{jerk}");
    assert!(fastest > 0.9, "the tcp's speed is used: {fastest}");
    let still = parametrise(&[path[0], path[0]], &k, &l);
    assert!(still.points.len() == 1 && rest(&still.points[0].velocities));
}
