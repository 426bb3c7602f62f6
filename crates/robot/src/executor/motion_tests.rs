use super::*;
use crate::limits::Limits;

const Q: Joints = [0.1, -1.2, 1.3, -1.4, -1.5, 0.6];
const DT: f64 = 0.008;

/// An arm that follows its targets with a lag, under the driver's core.
struct Bench {
    motion: Motion,
    input: RobotInput,
    lag: f64,
    ended: Vec<GoalEndReport>,
    fault: Option<String>,
}

impl Bench {
    fn new() -> Self {
        let limits = Limits::default();
        let motion = Motion::new(MotionParams { limits, following: 0.25 });
        let input = RobotInput {
            time: 500.0,
            clock: NOW,
            q: Q,
            qd: [0.0; 6],
            may_move: true,
            watchdog: false,
            factor: 1.0,
            enabled: true,
        };
        let mut b = Self { motion, input, lag: 0.04, ended: Vec::new(), fault: None };
        b.run(1);
        b
    }

    fn run(&mut self, cycles: usize) -> Vec<Option<Joints>> {
        (0..cycles)
            .map(|_| {
                let out = self.motion.step(&self.input);
                self.ended.extend(out.ended);
                self.fault = out.fault.or(self.fault.take());
                for i in 0..6 {
                    let to = out.target.map_or(self.input.q[i], |t| t[i]);
                    let step = (to - self.input.q[i]) * DT / self.lag;
                    self.input.q[i] += step;
                    self.input.qd[i] = step / DT;
                }
                self.input.time += DT;
                self.input.clock = self.input.clock.plus(DT);
                out.target
            })
            .collect()
    }
}

fn to(shift: f64, time: f64) -> JointTrajectory {
    JointTrajectory {
        names: JOINT_NAMES.map(String::from).to_vec(),
        stamp: None,
        points: vec![TrajectoryPoint {
            positions: Q.iter().map(|q| q + shift).collect(),
            velocities: vec![0.0; 6],
            time_from_start: time,
            ..Default::default()
        }],
    }
}

const NOW: Stamp = Stamp(1_700_000_000_000_000_000);

#[test]
fn a_goal_is_reached_and_reported_once() {
    let mut b = Bench::new();
    let id = b.motion.follow_goal(&to(0.3, 1.0), GoalTolerances::default(), NOW).unwrap();
    b.run(120);
    assert!(b.ended.is_empty());
    b.run(40);
    assert_eq!(b.ended.len(), 1, "{:?}", b.ended);
    assert_eq!((b.ended[0].id, b.ended[0].code), (id, GoalCode::Successful));
    assert!((b.input.q[0] - Q[0] - 0.3).abs() < 0.01);
}

#[test]
fn tolerances_are_watched() {
    let mut b = Bench::new();
    b.lag = 0.5;
    let tight = GoalTolerances { path: [Some(0.05); 6], ..Default::default() };
    b.motion.follow_goal(&to(0.3, 1.0), tight, NOW).unwrap();
    let targets = b.run(200);
    assert_eq!(b.ended[0].code, GoalCode::PathTolerance);
    // Held, not frozen in motion: the last targets are equal.
    assert_eq!(targets[198], targets[199]);
    assert!(b.fault.is_none());
    let mut b = Bench::new();
    b.lag = 0.8;
    let g = GoalTolerances {
        path: [None; 6],
        goal: [Some(0.01); 6],
        time: Some(0.2),
        ..Default::default()
    };
    b.motion.follow_goal(&to(0.2, 1.0), g, NOW).unwrap();
    b.run(140);
    assert!(b.ended.is_empty());
    b.run(30);
    assert_eq!(b.ended[0].code, GoalCode::GoalTolerance);
}

#[test]
fn newer_goals_cancels_and_topics_take_over_without_a_jump() {
    let mut b = Bench::new();
    let first = b.motion.follow_goal(&to(0.3, 1.0), GoalTolerances::default(), NOW).unwrap();
    b.run(50);
    let second = b.motion.follow_goal(&to(-0.1, 1.0), GoalTolerances::default(), NOW).unwrap();
    b.run(50);
    assert_eq!((b.ended[0].id, b.ended[0].code), (first, GoalCode::InvalidGoal));
    b.motion.cancel(first);
    b.run(1);
    assert_eq!(b.motion.state().unwrap().goal, Some(second), "another goal's cancel");
    b.motion.cancel(second);
    let t = b.run(60);
    assert_eq!(t[58], t[59]);
    assert!(b.fault.is_none(), "{:?}", b.fault);
    b.motion.follow(&to(0.0, 0.5), NOW).unwrap();
    b.run(100);
    assert!((b.input.q[3] - Q[3]).abs() < 0.01);
}

#[test]
fn a_cancel_in_stretched_time_brakes_without_a_jerk() {
    let mut b = Bench::new();
    b.input.factor = 0.4;
    b.run(100);
    let id = b.motion.follow_goal(&to(0.5, 1.0), GoalTolerances::default(), NOW).unwrap();
    let before = b.run(150);
    b.motion.cancel(id);
    let after = b.run(100);
    let speed = |a: &Option<Joints>, b: &Option<Joints>| (b.unwrap()[0] - a.unwrap()[0]) / DT;
    let (was, is) = (speed(&before[148], &before[149]), speed(&before[149], &after[0]));
    assert!(was > 0.2 && (was - is).abs() < 0.12, "{was} {is}");
    assert_eq!(after[98], after[99]);
}

#[test]
fn the_slider_stretches_time_and_a_pause_is_not_caught_up() {
    let mut b = Bench::new();
    b.input.factor = 0.5;
    b.run(100);
    b.motion.follow_goal(&to(0.3, 1.0), GoalTolerances::default(), NOW).unwrap();
    b.run(230);
    assert!(b.ended.is_empty());
    b.run(60);
    assert_eq!(b.ended[0].code, GoalCode::Successful);
    // The slider at zero holds the goal, and the way goes on where it was.
    b.input.factor = 1.0;
    b.run(100);
    b.motion.follow(&to(0.0, 1.0), NOW).unwrap();
    b.run(50);
    b.input.factor = 0.0;
    b.run(100);
    let held = b.input.q;
    b.run(500);
    assert!((held[0] - b.input.q[0]).abs() < 1e-6);
    b.input.factor = 1.0;
    let t = b.run(250);
    let steps = t.windows(2).map(|w| (w[1].unwrap()[0] - w[0].unwrap()[0]).abs());
    assert!(steps.fold(0.0, f64::max) < 0.008);
    assert!((b.input.q[0] - Q[0]).abs() < 0.01 && b.fault.is_none());
    // The driver itself was held up for half a second: neither a fault nor a jump.
    b.motion.follow(&to(0.3, 1.0), NOW).unwrap();
    let before = b.run(40)[39].unwrap();
    b.input.time += 0.5;
    let after = b.run(1)[0].unwrap();
    assert!((after[0] - before[0]).abs() < 0.03 && b.fault.is_none());
}

#[test]
fn a_stop_forgets_and_a_late_driver_starts_anew() {
    for watchdog in [false, true] {
        let mut b = Bench::new();
        b.motion.follow_goal(&to(0.3, 1.0), GoalTolerances::default(), NOW).unwrap();
        b.run(50);
        (b.input.may_move, b.input.watchdog) = (watchdog, watchdog);
        assert_eq!(b.run(2), [None, None]);
        assert_eq!(b.ended[0].code, GoalCode::InvalidGoal);
        if !watchdog {
            assert_eq!(b.motion.follow(&to(0.0, 1.0), NOW), Err(MotionRefusal::NotReady));
        }
        (b.input.may_move, b.input.watchdog) = (true, false);
        assert_eq!(b.run(5), [None; 5], "it came back by itself");
        b.motion.follow(&to(0.0, 1.0), NOW).unwrap();
        b.run(250);
        assert!((b.input.q[0] - Q[0]).abs() < 0.01 && b.fault.is_none());
    }
}

#[test]
fn a_fault_stays_until_reset() {
    let mut b = Bench::new();
    // Gently at first, then far too fast.
    let mut t = to(1.2, 0.4);
    let gentle = to(0.05, 0.2).points.remove(0);
    t.points.insert(0, TrajectoryPoint { velocities: Vec::new(), ..gentle });
    b.motion.follow_goal(&t, GoalTolerances::default(), NOW).unwrap();
    b.run(60);
    assert!(b.fault.is_some() && b.motion.fault().is_some());
    assert_eq!(b.ended[0].code, GoalCode::InvalidGoal);
    assert!(matches!(b.motion.follow(&to(0.0, 1.0), NOW), Err(MotionRefusal::Fault(_))));
    assert!(b.run(10).iter().all(Option::is_none));
    b.motion.reset();
    b.motion.follow(&to(0.0, 1.0), NOW).unwrap();
    assert!(b.run(3).iter().all(Option::is_some));
}

#[test]
fn an_arm_that_is_held_fast_is_a_fault() {
    let mut b = Bench::new();
    b.lag = 1e6;
    b.motion.follow(&to(0.5, 1.0), NOW).unwrap();
    b.run(150);
    assert!(b.fault.unwrap().contains("ahead of the arm"));
}

#[test]
fn streams_need_their_controller_and_go_stale() {
    let mut b = Bench::new();
    let inactive = MotionRefusal::Inactive(Some(MotionController::Trajectory));
    assert_eq!(b.motion.stream_velocity(&[0.1; 6]), Err(inactive));
    b.motion.select(Some(MotionController::Velocity));
    assert_eq!(b.motion.stream_velocity(&[0.1; 5]), Err(MotionRefusal::Values(5)));
    assert_eq!(b.motion.stream_velocity(&[f64::NAN; 6]), Err(MotionRefusal::Values(0)));
    for _ in 0..50 {
        b.motion.stream_velocity(&[0.5; 6]).unwrap();
        b.run(1);
    }
    assert!((b.input.qd[0] - 0.5).abs() < 0.05, "{:?}", b.input.qd);
    // The commander dies: at rest within 0.1 s and the braking time, and it stays so.
    let t = b.run(60);
    assert_eq!(t[25], t[59]);
    assert!(b.motion.follow(&to(0.0, 1.0), NOW).is_err());
    b.motion.select(Some(MotionController::Position));
    let target = b.input.q.map(|q| q + 0.2);
    for _ in 0..100 {
        b.motion.stream_position(&target).unwrap();
        b.run(1);
    }
    assert!((b.input.q[1] - target[1]).abs() < 0.01 && b.fault.is_none());
    b.motion.select(Some(MotionController::Trajectory));
    b.motion.follow(&to(0.0, 2.0), NOW).unwrap();
    b.run(300);
    assert!((b.input.q[0] - Q[0]).abs() < 0.01 && b.fault.is_none());
}

#[test]
fn released_switch_and_lost_connection() {
    let mut b = Bench::new();
    b.motion.follow_goal(&to(0.3, 1.0), GoalTolerances::default(), NOW).unwrap();
    b.run(60);
    b.input.enabled = false;
    let t = b.run(60);
    assert!(t[59].is_some() && t[58] == t[59], "it holds");
    assert_eq!(b.ended[0].code, GoalCode::InvalidGoal);
    assert_eq!(b.motion.follow(&to(0.0, 1.0), NOW), Err(MotionRefusal::NotEnabled));
    b.input.enabled = true;
    b.run(1);
    b.motion.forget();
    assert_eq!(b.motion.follow(&to(0.0, 1.0), NOW), Err(MotionRefusal::NoState));
    assert!(b.motion.state().is_none());
}

#[test]
fn a_trajectory_that_begins_elsewhere_is_refused() {
    let mut b = Bench::new();
    let refusal = b.motion.follow(&to(0.4, 0.2), NOW).unwrap_err();
    assert!(matches!(refusal, MotionRefusal::Entry { .. }), "{refusal}");
    assert!(b.run(5).iter().all(Option::is_none));
}

/// Messages are some milliseconds early or late: the path that is followed must not be.
#[test]
fn jitter_of_arrival_makes_no_step() {
    for stamped in [true, false] {
        let mut b = Bench::new();
        let mut late = 0.0;
        let mut last: Option<Joints> = None;
        let mut fastest: f64 = 0.0;
        for n in 0..400_u32 {
            if n % 2 == 0 {
                // 0.5 rad/s for ever, told anew every 16 ms, 1 to 5 ms on the way.
                let sent = 0.008 * f64::from(n);
                late = 0.001 + 0.004 * f64::from((n * 7) % 11) / 10.0;
                let at = |t: f64| Q.map(|q| q + 0.5 * (sent + t));
                let point = |t: f64, v: f64| TrajectoryPoint {
                    positions: at(t).to_vec(),
                    velocities: vec![v; 6],
                    time_from_start: t,
                    ..Default::default()
                };
                let trajectory = JointTrajectory {
                    names: JOINT_NAMES.map(String::from).to_vec(),
                    stamp: stamped.then(|| NOW.plus(sent)),
                    points: (0..=8)
                        .map(|i| point(0.008 * f64::from(i), 0.5))
                        .chain([point(0.2, 0.0)])
                        .collect(),
                };
                b.motion.follow(&trajectory, NOW.plus(sent + late)).unwrap();
            }
            let target = b.run(1)[0];
            if let (Some(a), Some(c), true) = (last, target, n > 20) {
                fastest = fastest.max((c[0] - a[0]) / DT);
            }
            last = target;
        }
        assert!(b.fault.is_none() && late > 0.0, "{:?}", b.fault);
        let allowed = if stamped { 0.502 } else { 0.62 };
        assert!(fastest < allowed, "stamped {stamped}: {fastest} rad/s instead of 0.5");
    }
}

/// A robot whose states stop for some cycles and go on as if nothing had been: the trajectories that came
/// meanwhile are ahead, and are caught up with at a bounded speed.
#[test]
fn a_robot_that_falls_behind_is_no_jump() {
    const SPEED: f64 = 0.8;
    let mut b = Bench::new();
    let (mut wall, mut fastest) = (0.0, 0.0_f64);
    let mut last: Option<Joints> = None;
    for n in 0..400_u32 {
        if n % 40 == 39 {
            let stall = 0.008 * f64::from(n / 40 % 4);
            wall += stall;
            b.input.clock = b.input.clock.plus(stall);
        }
        let point = |t: f64, v: f64| TrajectoryPoint {
            // To and fro, so that the range is not left.
            positions: Q.map(|q| q + SPEED * (4.0 * (wall + t)).sin() / 4.0).to_vec(),
            velocities: vec![v * SPEED * (4.0 * (wall + t)).cos(); 6],
            time_from_start: t,
            ..Default::default()
        };
        let trajectory = JointTrajectory {
            names: JOINT_NAMES.map(String::from).to_vec(),
            stamp: Some(NOW.plus(DT + wall)),
            points: (0..=15)
                .map(|i| point(0.008 * f64::from(i), 1.0))
                .chain([point(0.3, 0.0)])
                .collect(),
        };
        // It comes in the last moment before the next state, which is late by the stall.
        b.motion.follow(&trajectory, NOW.plus(DT + wall)).unwrap();
        let target = b.run(1)[0];
        wall += DT;
        if let (Some(a), Some(c), true) = (last, target, n > 20) {
            let step = (0..6).map(|i| (c[i] - a[i]).abs()).fold(0.0, f64::max);
            fastest = fastest.max(step / DT);
        }
        last = target;
    }
    assert!(b.fault.is_none(), "{:?}", b.fault);
    assert!(fastest < 1.3, "{fastest} rad/s");
}

#[test]
fn what_is_planned_is_what_comes() {
    let mut b = Bench::new();
    assert_eq!(b.motion.planned(NOW), None, "nothing was commanded");
    b.motion.follow(&to(0.3, 1.0), NOW).unwrap();
    b.run(20);
    let clock = b.input.clock;
    let planned = b.motion.planned(clock.plus(49.0 * DT)).unwrap();
    let end = b.motion.planned(clock.plus(5.0)).unwrap();
    assert_eq!(b.motion.planned(clock.plus(-30.0)), None, "long gone");
    let came = b.run(50).last().copied().flatten().unwrap();
    assert!((planned.q[0] - came[0]).abs() < 1e-3, "{planned:?} {came:?}");
    assert!(planned.qd[0] > 0.1);
    assert!((end.q[0] - Q[0] - 0.3).abs() < 1e-9 && end.qd == [0.0; 6]);
    b.input.may_move = false;
    b.run(1);
    assert_eq!(b.motion.planned(clock), None, "the robot was stopped");
}
