use super::*;

const NOW: Stamp = Stamp(50_000_000_000);
const Q: Joints = [0.1, -1.2, 1.3, -1.4, -1.5, 0.6];

fn rest() -> Desired {
    Desired { q: Q, qd: [0.0; 6] }
}

fn point(t: f64, shift: f64, v: Option<f64>) -> TrajectoryPoint {
    TrajectoryPoint {
        positions: Q.iter().map(|x| x + shift).collect(),
        velocities: v.map_or(Vec::new(), |v| vec![v; 6]),
        time_from_start: t,
        ..Default::default()
    }
}

fn trajectory(points: Vec<TrajectoryPoint>) -> JointTrajectory {
    JointTrajectory { names: JOINT_NAMES.map(String::from).to_vec(), stamp: None, points }
}

fn reject(t: &JointTrajectory) -> TrajectoryRejection {
    let mut e = JointTrajectoryExecutor::new(ExecutorParams::default());
    let err = e.accept(t, NOW, &rest()).unwrap_err();
    assert!(e.sample(NOW).is_none(), "a refused trajectory changes nothing");
    err
}

#[test]
fn rules_of_acceptance() {
    let good = trajectory(vec![point(0.1, 0.1, Some(0.5)), point(0.3, 0.2, Some(0.0))]);
    let with = |f: &dyn Fn(&mut JointTrajectory)| {
        let mut t = good.clone();
        f(&mut t);
        reject(&t)
    };
    let e = with(&|t| t.names[0] = "shoulder_pan".into());
    assert!(matches!(e, TrajectoryRejection::Joints { .. }) && e.code() == -2);
    assert_eq!(with(&|t| t.names.truncate(5)).code(), -2);
    assert_eq!(with(&|t| t.names[1] = t.names[0].clone()).code(), -2);
    assert_eq!(with(&|t| t.points.clear()), TrajectoryRejection::Empty);
    let e = with(&|t| t.points[1].time_from_start = 0.1);
    assert!(matches!(e, TrajectoryRejection::Time { index: 1, .. }) && e.code() == -1);
    assert!(matches!(
        with(&|t| t.points[0].time_from_start = -0.1),
        TrajectoryRejection::Time { .. }
    ));
    let e = with(&|t| t.points[0].positions.truncate(3));
    assert!(matches!(e, TrajectoryRejection::Size { field: "positions", .. }));
    let e = with(&|t| t.points[0].effort = vec![1.0; 6]);
    assert!(matches!(e, TrajectoryRejection::Size { field: "efforts", .. }));
    let e = with(&|t| t.points[0].velocities[2] = f64::NAN);
    assert!(matches!(e, TrajectoryRejection::NotFinite { field: "velocities", .. }));
    let e = with(&|t| t.points[1].velocities[3] = 0.1);
    assert!(matches!(e, TrajectoryRejection::EndsMoving { .. }), "{e}");
    let e = with(&|t| t.points[1].positions[2] = 3.5);
    assert!(matches!(e, TrajectoryRejection::Range { .. }), "{e}");
    let e = with(&|t| t.stamp = Some(NOW.plus(-0.31)));
    assert!(matches!(e, TrajectoryRejection::Past { .. }) && e.code() == -3);
}

#[test]
fn names_in_any_order() {
    let mut t = trajectory(vec![point(0.2, 0.0, Some(0.0))]);
    t.names.reverse();
    t.points[0].positions = vec![0.6, -1.5, -1.4, 1.3, -1.2, 0.2];
    let mut e = JointTrajectoryExecutor::new(ExecutorParams::default());
    e.accept(&t, NOW, &rest()).unwrap();
    let end = e.sample(NOW.plus(1.0)).unwrap();
    assert_eq!(end.q, [0.2, -1.2, 1.3, -1.4, -1.5, 0.6]);
    assert_eq!(e.goal(), Some((end.q, NOW.plus(0.2))));
}

#[test]
fn linear_cubic_quintic_and_the_hold_at_the_end() {
    let mut e = JointTrajectoryExecutor::new(ExecutorParams::default());
    e.accept(&trajectory(vec![point(0.2, 0.1, None)]), NOW, &rest()).unwrap();
    let s = e.sample(NOW.plus(0.05)).unwrap();
    assert!((s.q[0] - Q[0] - 0.025).abs() < 1e-9 && (s.qd[0] - 0.5).abs() < 1e-9);
    e.clear();
    let mut t = trajectory(vec![point(0.1, 0.05, Some(1.0)), point(0.2, 0.1, Some(0.0))]);
    e.accept(&t, NOW, &rest()).unwrap();
    let s = e.sample(NOW.plus(0.1)).unwrap();
    assert!((s.q[3] - Q[3] - 0.05).abs() < 1e-9 && (s.qd[3] - 1.0).abs() < 1e-9);
    assert!(e.is_moving(NOW.plus(0.19)) && !e.is_moving(NOW.plus(0.21)));
    let s = e.sample(NOW.plus(60.0)).unwrap();
    assert!((s.q[0] - Q[0] - 0.1).abs() < 1e-12 && s.qd == [0.0; 6]);
    t.points.iter_mut().for_each(|p| p.accelerations = vec![0.0; 6]);
    e.clear();
    e.accept(&t, NOW, &rest()).unwrap();
    let (a, b) = (e.sample(NOW.plus(0.15)).unwrap(), e.sample(NOW.plus(0.150001)).unwrap());
    assert!(((b.q[0] - a.q[0]) / 1e-6 - a.qd[0]).abs() < 1e-3);
}

#[test]
fn a_new_trajectory_starts_from_the_present_target() {
    let mut e = JointTrajectoryExecutor::new(ExecutorParams::default());
    let far = trajectory(vec![point(0.5, 0.2, Some(0.0))]);
    e.accept(&far, NOW, &rest()).unwrap();
    let t = NOW.plus(0.2);
    let before = e.sample(t).unwrap();
    e.accept(&trajectory(vec![point(0.5, -0.2, Some(0.0))]), t, &rest()).unwrap();
    let after = e.sample(t).unwrap();
    for i in 0..6 {
        assert!((before.q[i] - after.q[i]).abs() < 1e-12);
        assert!((before.qd[i] - after.qd[i]).abs() < 1e-12);
    }
    assert!((e.sample(t.plus(0.5)).unwrap().q[0] - (Q[0] - 0.2)).abs() < 1e-12);
}

#[test]
fn a_stamp_places_the_trajectory_in_time() {
    let mut e = JointTrajectoryExecutor::new(ExecutorParams::default());
    let mut t = trajectory(vec![point(0.1, 0.05, Some(0.5)), point(0.3, 0.1, Some(0.0))]);
    // Sent 20 ms ago: reached 20 ms sooner.
    t.stamp = Some(NOW.plus(-0.02));
    e.accept(&t, NOW, &rest()).unwrap();
    assert!((e.sample(NOW.plus(0.08)).unwrap().q[0] - Q[0] - 0.05).abs() < 1e-9);
    // Sent 150 ms ago: the first point is passed over.
    t.stamp = Some(NOW.plus(-0.15));
    e.clear();
    e.accept(&t, NOW, &rest()).unwrap();
    assert!((e.sample(NOW).unwrap().q[0] - Q[0]).abs() < 1e-12);
    assert!((e.sample(NOW.plus(0.15)).unwrap().q[0] - Q[0] - 0.1).abs() < 1e-9);
}
