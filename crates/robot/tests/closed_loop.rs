//! The whole task with a policy that replans from the lagging arm.

mod bench;

use bench::*;
use tdv_robot::ControllerParams;
use tdv_robot::motion::StatusCode as S;

fn lab() -> ControllerParams {
    ControllerParams { auto_resume: true, ..Default::default() }
}

fn report(name: &str, b: &Bench, seconds: f64) {
    println!(
        "{name}: {seconds:.1} s, ends {:.1?} mm, {} trajectories, max {:.2} rad/s {:.1} rad/s2, tcp {:.3} m/s, \
         off path {:.1} mm, longest stall {:.2} s",
        b.log.ends.iter().map(|e| e.0 * 1e3).collect::<Vec<_>>(),
        b.log.paths,
        b.log.max_qd,
        b.log.max_qdd,
        b.log.max_tcp,
        b.log.max_off * 1e3,
        b.log.longest_stall
    );
}

fn whole_task(name: &str, change: impl Fn(&mut Bench)) -> Bench {
    let mut b = Bench::new(lab());
    change(&mut b);
    let begin = b.now;
    b.run(40.0);
    report(name, &b, b.now.since(begin));
    assert_eq!(b.last_code(), S::Done, "{:?} {}", b.log.codes, b.last_sentence());
    let l = &b.controller.params().limits;
    assert!(b.log.max_qd <= l.joint_velocity * 1.01);
    assert!(b.log.max_tcp <= l.tcp_speed * 1.03, "{}", b.log.max_tcp);
    assert!(b.log.max_qdd <= l.stop_acceleration * 1.5, "{}", b.log.max_qdd);
    assert!(b.log.longest_stall < 0.6, "{}", b.log.longest_stall);
    b
}

#[test]
fn the_task_is_carried_out_at_any_lag_and_latency() {
    for (lag, latency) in
        [(0.03, (0.06, 0.06)), (0.045, (0.06, 0.10)), (0.06, (0.10, 0.10)), (0.1, (0.03, 0.10))]
    {
        let b = whole_task(&format!("lag {lag} latency {latency:?}"), |b| {
            b.lag = lag;
            b.latency = latency;
        });
        assert!(b.log.max_off < 0.012, "{}", b.log.max_off);
        assert!(b.log.ends.iter().all(|e| e.0 < 0.001 && e.1 < 0.01), "{:?}", b.log.ends);
        let order = [S::Following, S::Grasping, S::AwaitingAttach, S::Following, S::Releasing];
        let mut codes = b.log.codes.iter();
        for want in order.iter().chain(&[S::Retreating, S::Done]) {
            assert!(codes.any(|c| c == want), "{want:?} in order in {:?}", b.log.codes);
        }
        let bad = [S::HoldStale, S::HoldRefused, S::HoldJoints, S::HoldGripper, S::Recovering];
        assert!(b.log.codes.iter().all(|c| !bad.contains(c)), "{:?}", b.log.codes);
    }
}

#[test]
fn noise_and_a_policy_that_pulls_back_to_the_path() {
    whole_task("noise 2 mm", |b| b.noise = 0.002);
    whole_task("stamped trajectories", |b| b.stamped = true);
    whole_task("pull 0.2 s", |b| b.pull = 0.2);
    whole_task("noise 2 mm, pull 0.5 s", |b| {
        b.noise = 0.002;
        b.pull = 0.5;
    });
}

#[test]
fn the_lookahead_need_not_be_exact() {
    for lookahead in [0.05, 0.10, 0.20, 0.25] {
        whole_task(&format!("lookahead {lookahead}"), |b| {
            let params = ControllerParams { lookahead, ..lab() };
            b.controller = tdv_robot::ArmController::new(b.k.clone(), params).unwrap();
        });
    }
}

#[test]
fn late_plans_only_slow_the_arm_down() {
    // Every third plan or so is older than allowed: the arm brakes and goes on, and gets there.
    let mut b = Bench::new(lab());
    b.latency = (0.03, 0.14);
    b.run(60.0);
    report("late plans", &b, 0.0);
    assert!(b.log.codes.contains(&S::HoldStale));
    assert_eq!(b.last_code(), S::Done, "{:?} {}", b.log.codes, b.last_sentence());
}

#[test]
fn the_object_is_displaced_on_the_way() {
    let mut b = Bench::new(lab());
    b.run(1.5);
    b.references[0].translation.x -= 0.06;
    b.references[0].translation.y -= 0.05;
    b.run(30.0);
    report("displaced", &b, 0.0);
    assert_eq!(b.last_code(), S::Done, "{:?} {}", b.log.codes, b.last_sentence());
}
