use super::*;
use tdv_ur_protocol::servo::{ProgramState, ServoProgram};

const DT: f64 = 0.002;
const HOME: [f64; 6] = [0.0, -1.5, 1.8, -1.8, -1.57, 0.0];

fn cb3() -> Controller {
    Controller::new(Generation::Cb3, HOME)
}

fn run(c: &mut Controller, script: &str) {
    c.run_script(script).unwrap();
}

fn wait(c: &mut Controller, seconds: f64) {
    for _ in 0..(seconds / DT).round() as usize {
        c.step(DT);
    }
}

/// Steps until no program runs; the seconds that it took.
fn finish(c: &mut Controller) -> f64 {
    let start = c.time();
    while c.runtime_state() != RuntimeState::Stopped {
        c.step(DT);
        assert!(c.time() - start < 60.0, "the program does not end");
    }
    c.time() - start
}

fn errors(c: &mut Controller) -> Vec<String> {
    let all = c.take_messages();
    all.into_iter().filter(|m| m.kind == MessageKind::Error).map(|m| m.text).collect()
}

/// Follows a ramp of 0.4 rad/s with `servoj`; the lag in s and the largest overshoot at its end.
fn ramp(generation: Generation, lookahead: f64, gain: f64) -> (f64, f64) {
    let mut c = Controller::new(generation, HOME);
    let text = format!(
        "def f():\n while True:\n  q = get_actual_joint_positions()\n  \
         q[0] = read_input_float_register(0)\n  \
         servoj(q, t={}, lookahead_time={lookahead}, gain={gain})\n end\nend\n",
        generation.cycle()
    );
    run(&mut c, &text);
    let (mut to, mut lag, mut over) = (0.0, 0.0, 0.0_f64);
    for k in 0..2000 {
        let moving = k < 1000;
        if moving {
            to = 0.4 * k as f64 * DT;
        }
        c.inputs_mut().write_double(0, to);
        let before = c.q()[0];
        c.step(DT);
        if k == 999 {
            lag = (to - before) / 0.4;
        }
        over = over.max(c.q()[0] - to);
    }
    assert!((c.q()[0] - to).abs() < 1e-4);
    (lag, over)
}

#[test]
fn servoj_lags_by_its_lookahead_and_gain() {
    let (official, over) = ramp(Generation::ESeries, 0.03, 2000.0);
    println!("500 Hz, 0.03 s, gain 2000: {official}");
    assert!((official - 0.034).abs() < 0.005 && over < 1e-3, "{official} {over}");
    let (soft, _) = ramp(Generation::ESeries, 0.1, 300.0);
    println!("500 Hz, 0.1 s, gain 300: {soft}");
    assert!((0.10..0.14).contains(&soft), "{soft}");
    let (low, _) = ramp(Generation::ESeries, 0.03, 300.0);
    let (long, _) = ramp(Generation::ESeries, 0.2, 2000.0);
    assert!(low > official + 0.005 && long > official + 0.1, "{official} {low} {long}");
    let (slow, _) = ramp(Generation::Cb3, 0.03, 2000.0);
    println!("125 Hz, 0.03 s, gain 2000: {slow}");
    assert!(slow > official && slow < official + 0.012, "{slow}");
}

#[test]
fn a_larger_lookahead_smooths_more() {
    // Targets that jump to and fro by 4 mrad every cycle: what comes through?
    let rough = |lookahead: f64| {
        let mut c = Controller::new(Generation::ESeries, HOME);
        let text = format!(
            "def f():\n s = 0.002\n while True:\n  q = get_actual_joint_positions()\n  q[0] = s\n  \
             s = 0 - s\n  servoj(q, t=0.008, lookahead_time={lookahead}, gain=1000)\n end\nend\n"
        );
        run(&mut c, &text);
        wait(&mut c, 1.0);
        let mut most = 0.0_f64;
        for _ in 0..200 {
            c.step(DT);
            most = most.max(c.qd()[0].abs());
        }
        most
    };
    let (short, long) = (rough(0.03), rough(0.15));
    assert!(long < 0.6 * short, "{short} {long}");
}

#[test]
fn movej_keeps_its_speed_and_acceleration_and_arrives() {
    let mut c = cb3();
    let mut to = HOME;
    to[0] = 0.8;
    to[3] = -1.4;
    run(&mut c, &format!("def f():\n movej({to:?}, a=1.5, v=0.7)\nend\n"));
    let (mut most, mut last) = (0.0_f64, 0.0);
    while c.runtime_state() != RuntimeState::Stopped {
        c.step(DT);
        most = most.max(c.qd()[0]);
        // The last tick may hold the rest of one before.
        assert!((c.qd()[0] - last).abs() <= 2.0 * 1.5 * DT + 1e-6);
        last = c.qd()[0];
        assert!((c.q()[0] / 0.8 - (c.q()[3] + 1.8) / 0.4).abs() < 1e-9, "joints move together");
    }
    assert!((most - 0.7).abs() < 1e-6);
    assert_eq!(*c.q(), to);
    assert!((c.time() - (0.8 / 0.7 + 0.7 / 1.5)).abs() < 0.03, "{}", c.time());
    let begin = c.time();
    run(&mut c, &format!("movej({HOME:?}, t=2)\n"));
    finish(&mut c);
    assert!((c.time() - begin - 2.0).abs() < 0.03);
}

#[test]
fn movel_is_straight_and_ends_at_its_pose() {
    let mut c = cb3();
    let from = c.tcp_pose();
    run(
        &mut c,
        "def f():\n p1 = get_actual_tcp_pose()\n movel(pose_add(p1, p[0.05,-0.1,0.08,0,0,0]), a=1, v=0.2)\nend\n",
    );
    let (mut off, mut speed) = (0.0_f64, 0.0_f64);
    let way = Vector3::new(0.05, -0.1, 0.08);
    while c.runtime_state() != RuntimeState::Stopped {
        c.step(DT);
        let d = c.tcp_pose().translation.vector - from.translation.vector;
        off = off.max((d - way * (d.dot(&way) / way.norm_squared())).norm());
        let [x, y, z, ..] = c.tcp_speed();
        speed = speed.max(Vector3::new(x, y, z).norm());
    }
    let d = c.tcp_pose().translation.vector - from.translation.vector;
    assert!((d - way).norm() < 1e-6, "{d}");
    assert!(off < 1e-5 && (speed - 0.2).abs() < 0.01, "{off} {speed}");
    assert!(c.tcp_pose().rotation.angle_to(&from.rotation) < 1e-6);
}

#[test]
fn the_slider_slows_moves_and_speeds_but_not_servoj() {
    let mut to = HOME;
    to[5] = 1.0;
    let script = format!("movej({to:?}, a=5, v=0.5)\n");
    let mut time = Vec::new();
    for fraction in [1.0, 0.25] {
        let mut c = cb3();
        c.set_speed_fraction(fraction);
        wait(&mut c, 1.0);
        run(&mut c, &script);
        time.push(finish(&mut c));
    }
    assert!((time[1] / time[0] - 4.0).abs() < 0.1, "{time:?}");
    let mut c = cb3();
    c.set_speed_fraction(0.25);
    wait(&mut c, 1.0);
    run(&mut c, "def f():\n speedj([0.4,0,0,0,0,0], a=2, t=1)\nend\n");
    wait(&mut c, 0.6);
    assert!((c.qd()[0] - 0.1).abs() < 1e-6);
    let (lag, _) = ramp(Generation::ESeries, 0.03, 2000.0);
    assert!(lag < 0.04);
}

#[test]
fn speedj_and_speedl_stop_when_their_time_is_over() {
    let mut c = cb3();
    run(&mut c, "def f():\n speedj([0.3,0,0,0,0,-0.3], a=1, t=0.5)\n sleep(1)\nend\n");
    wait(&mut c, 0.45);
    assert!((c.qd()[0] - 0.3).abs() < 1e-6 && (c.qd()[5] + 0.3).abs() < 1e-6);
    wait(&mut c, 0.5);
    assert!(c.qd().iter().all(|v| v.abs() < 1e-9));
    let z = c.tcp_pose().translation.z;
    run(&mut c, "def f():\n speedl([0,0,0.1,0,0,0], a=1, t=0.5)\n stopl(1)\nend\n");
    wait(&mut c, 0.4);
    assert!((c.tcp_speed()[2] - 0.1).abs() < 1e-3 && c.tcp_speed()[0].abs() < 1e-3);
    finish(&mut c);
    // 0.5 s with a ramp of 0.1 s, then 0.1 s to rest: 0.05 m.
    assert!((c.tcp_pose().translation.z - z - 0.05).abs() < 0.004);
}

#[test]
fn a_protective_stop_needs_five_seconds_and_play_goes_on() {
    let mut to = HOME;
    to[0] = 1.0;
    let mut c = cb3();
    run(&mut c, &format!("def f():\n movej({to:?}, a=2, v=0.8)\nend\n"));
    wait(&mut c, 0.6);
    let fast = c.qd()[0];
    assert!(fast > 0.7);
    c.protect(StopReason::Table);
    assert_eq!((c.safety_mode(), c.robot_status_bits() & 2), (SafetyMode::ProtectiveStop, 0));
    assert_eq!(c.runtime_state(), RuntimeState::Pausing);
    wait(&mut c, fast / STOP_DECELERATION + 0.01);
    assert_eq!((c.runtime_state(), c.qd()[0]), (RuntimeState::Paused, 0.0));
    assert!(c.play().is_err() && c.unlock().is_err());
    wait(&mut c, 5.0);
    assert!(c.unlock().is_ok());
    wait(&mut c, 0.5);
    assert_eq!(c.qd()[0], 0.0, "an unlock alone moves nothing");
    c.play().unwrap();
    assert_eq!(c.runtime_state(), RuntimeState::Resuming);
    finish(&mut c);
    assert_eq!(c.q()[0], 1.0);
}

#[test]
fn pause_stop_and_replacement_brake_within_the_bound() {
    for action in [Controller::pause, Controller::stop_program, |c: &mut Controller| {
        c.run_script("def g():\n sleep(1)\nend\n").unwrap();
    }] {
        let mut c = cb3();
        run(&mut c, "def f():\n while True:\n  speedj([1,0,0,0,0,0], a=4, t=0.1)\n end\nend\n");
        wait(&mut c, 1.0);
        assert!((c.qd()[0] - 1.0).abs() < 1e-6);
        action(&mut c);
        let mut last = 1.0;
        for _ in 0..60 {
            c.step(DT);
            assert!(last - c.qd()[0] <= STOP_DECELERATION * DT + 1e-9);
            last = c.qd()[0];
        }
        assert_eq!(last, 0.0);
    }
}

#[test]
fn limits_of_position_and_reach_are_protective_stops() {
    let mut c = cb3();
    run(&mut c, "def f():\n speedj([0,0,0,0,0,3], a=10)\n sleep(10)\nend\n");
    wait(&mut c, 4.0);
    assert_eq!(c.protective_stop(), Some(StopReason::JointPosition));
    assert!(c.q()[5] <= POSITION_LIMIT && c.qd()[5] == 0.0);
    let mut c = cb3();
    run(&mut c, "def f():\n movel(p[2, 0, 0.3, 0, 3.14, 0], v=1, a=5)\nend\n");
    wait(&mut c, 4.0);
    assert!(matches!(c.protective_stop(), Some(StopReason::Reach | StopReason::JointSpeed)));
    let mut c = cb3();
    run(&mut c, "def f():\n speedj([9,0,0,0,0,0], a=40)\nend\n");
    wait(&mut c, 1.0);
    assert_eq!(c.protective_stop(), Some(StopReason::JointSpeed));
}

#[test]
fn a_killed_thread_leaves_nothing_moving() {
    for motion in
        ["movej([2,-1.5,1.8,-1.8,-1.57,0], v=0.5)", "servoj([0.5,-1.5,1.8,-1.8,-1.57,0], t=9)"]
    {
        let mut c = cb3();
        run(
            &mut c,
            &format!(
                "def f():\n thread t():\n  {motion}\n end\n h = run t()\n sleep(0.3)\n kill h\n sleep(9)\nend\n"
            ),
        );
        wait(&mut c, 0.29);
        assert!(c.qd()[0] > 0.1, "{motion}");
        wait(&mut c, 0.5);
        assert_eq!(c.qd()[0], 0.0, "{motion}");
    }
}

#[test]
fn what_is_not_simulated_loads_and_fails_by_name() {
    let mut c = cb3();
    assert!(matches!(c.run_script("def f():\n dance()\nend\n"), Err(ProgramError::Script(_))));
    assert!(errors(&mut c)[0].contains("dance"));
    run(&mut c, "def f():\n if False:\n  freedrive_mode()\n end\n sleep(0.1)\nend\n");
    finish(&mut c);
    assert!(errors(&mut c).is_empty());
    run(&mut c, "def f():\n freedrive_mode()\nend\n");
    finish(&mut c);
    let e = errors(&mut c);
    assert!(e[0].contains("freedrive_mode") && e[0].contains("not simulated"), "{e:?}");
    run(&mut c, "def f():\n movej([0,0,0,0,0,0], r=0.1)\nend\n");
    finish(&mut c);
    assert!(errors(&mut c)[0].contains("blend radius"));
    for nonsense in ["movej([0,0,0])", "movej([0,0,0,0,0,0], v=0)", "stopj(0)", "servoj(1)"] {
        run(&mut c, &format!("def f():\n {nonsense}\nend\n"));
        finish(&mut c);
        assert_eq!(errors(&mut c).len(), 1, "{nonsense}");
    }
}

#[test]
fn an_rtde_watchdog_stops_the_program_when_its_register_is_silent() {
    let mut c = cb3();
    run(
        &mut c,
        "def f():\n rtde_set_watchdog(\"input_int_register_0\", 10, \"stop\")\n while True:\n  \
         speedj([0.5,0,0,0,0,0], a=2, t=0.1)\n end\nend\n",
    );
    for _ in 0..30 {
        // The same value again is a sign of life too.
        c.inputs_mut().write_int(0, 7);
        wait(&mut c, 0.05);
    }
    assert!((c.qd()[0] - 0.5).abs() < 1e-6);
    wait(&mut c, 0.2);
    assert_eq!((c.runtime_state(), c.qd()[0]), (RuntimeState::Stopped, 0.0));
}

#[test]
fn power_and_emergency_stops() {
    let mut c = Controller::with_power(Generation::Cb3, HOME, false);
    assert_eq!(c.robot_mode(), RobotMode::PowerOff);
    assert!(matches!(
        c.run_script("def f():\n sleep(1)\nend\n"),
        Err(ProgramError::NotReady { .. })
    ));
    c.power_on(true).unwrap();
    wait(&mut c, 3.0);
    assert_eq!(c.robot_mode(), RobotMode::Running);
    run(&mut c, "def f():\n while True:\n  sync()\n end\nend\n");
    wait(&mut c, 0.1);
    c.set_safety(SafetyMode::RobotEmergencyStop);
    wait(&mut c, 0.1);
    assert_eq!((c.robot_mode(), c.runtime_state()), (RobotMode::PowerOff, RuntimeState::Stopped));
    assert_eq!(c.power_on(false), Err(SafetyMode::RobotEmergencyStop));
    c.set_safety(SafetyMode::Normal);
    c.power_on(true).unwrap();
    wait(&mut c, 3.0);
    c.play().unwrap();
    c.set_safety(SafetyMode::SafeguardStop);
    wait(&mut c, 0.1);
    assert_eq!(c.runtime_state(), RuntimeState::Paused);
    c.set_safety(SafetyMode::Normal);
    wait(&mut c, 0.3);
    assert_eq!(c.runtime_state(), RuntimeState::Playing);
    c.set_safety(SafetyMode::Fault);
    c.set_safety(SafetyMode::Normal);
    assert_eq!(c.safety_mode(), SafetyMode::Fault, "a fault is not released, it is restarted");
    c.restart_safety();
    assert_eq!((c.safety_mode(), c.robot_mode()), (SafetyMode::Normal, RobotMode::PowerOff));
}

#[test]
fn registers_lines_tool_and_sec_programs() {
    let mut c = cb3();
    c.inputs_mut().write_int(24, 5);
    c.inputs_mut().write_double(47, 0.5);
    c.inputs_mut().write_bit(64, true);
    c.lines_mut().digital_in = 0b10;
    run(
        &mut c,
        "def f():\n write_output_integer_register(24, read_input_integer_register(24) + 1)\n \
         write_output_float_register(0, read_input_float_register(47))\n \
         write_output_boolean_register(1, read_input_boolean_register(64))\n \
         set_standard_digital_out(3, get_standard_digital_in(1))\n \
         set_tcp(p[0,0,0.15,0,0,0])\n set_payload(1.5, [0,0,0.05])\n textmsg(\"x \", 3)\n sleep(1)\nend\n",
    );
    wait(&mut c, 0.1);
    assert_eq!((c.outputs().ints[24], c.outputs().doubles[0]), (6, 0.5));
    assert!(c.outputs().bits[1] && c.lines().digital_out == 8);
    let tip = c.tool_pose() * Translation3::new(0.0, 0.0, 0.15);
    assert!((tip.translation.vector - c.tcp_pose().translation.vector).norm() < 1e-12);
    assert_eq!((c.payload().0, c.payload().1), (1.5, [0.0, 0.0, 0.05]));
    assert_eq!(c.take_messages()[0].text, "x 3");
    run(&mut c, "sec s():\n set_standard_digital_out(0, True)\nend\n");
    wait(&mut c, 0.1);
    assert_eq!(c.lines().digital_out, 9);
    assert_eq!(c.runtime_state(), RuntimeState::Playing, "the main program goes on");
}

#[test]
fn tool_pose_is_in_the_controllers_base() {
    let p = Controller::new(Generation::Cb3, [0.0; 6]).tool_pose();
    assert!((p.translation.x + 0.81725).abs() < 1e-9);
}

#[test]
fn equal_histories_give_equal_motions() {
    let once = || {
        let mut c = cb3();
        run(&mut c, &ServoProgram::cb3().text().unwrap());
        let mut sum = Vec::new();
        for k in 0..400 {
            servo(&mut c, k / 4 + 1, [0.001 * f64::from(k / 4), -1.5, 1.8, -1.8, -1.57, 0.0]);
            c.step(DT);
            sum.push(c.q()[0].to_bits());
        }
        sum
    };
    assert_eq!(once(), once());
}

fn servo(c: &mut Controller, beat: i32, q: [f64; 6]) {
    let i = c.inputs_mut();
    i.write_int(24, 1);
    i.write_int(25, beat);
    q.iter().enumerate().for_each(|(k, q)| i.write_double(24 + k, *q));
}

fn program(c: &Controller) -> (Option<ProgramState>, i32) {
    (ProgramState::from_register(c.outputs().ints[24]), c.outputs().ints[25])
}

/// The project's own servo program on this controller.
#[test]
fn the_servo_program_follows_watches_and_refuses() {
    for (generation, p) in
        [(Generation::Cb3, ServoProgram::cb3()), (Generation::ESeries, ServoProgram::e_series())]
    {
        let mut c = Controller::new(generation, HOME);
        run(&mut c, &p.text().unwrap());
        wait(&mut c, 0.02);
        assert_eq!(program(&c).0, Some(ProgramState::Ready));
        let mut q = HOME;
        let mut beat = 0;
        for k in 0..500 {
            q[1] = HOME[1] + 1.0 * f64::from(k) * DT;
            beat = k / 4 + 1;
            if k % 4 == 0 {
                servo(&mut c, beat, q);
            }
            c.step(DT);
        }
        assert_eq!(program(&c), (Some(ProgramState::Servoing), beat), "{:?}", errors(&mut c));
        assert!((c.qd()[1] - 1.0).abs() < 0.05, "{}", c.qd()[1]);
        let lag = q[1] - c.q()[1];
        assert!((0.025..0.060).contains(&lag), "{generation:?}: {lag}");
        // Silence: at rest within 100 ms and the time to brake, and no faster than allowed.
        let (mut rest, mut last) = (0.0, c.qd()[1]);
        while c.qd().iter().any(|v| v.abs() > 1e-9) {
            c.step(DT);
            rest += DT;
            assert!((c.qd()[1] - last).abs() <= MAX_ACCELERATION * DT + 1e-9);
            last = c.qd()[1];
            assert!(rest < 0.4);
        }
        println!("{generation:?}: at rest {rest:.3} s after the last target");
        assert!(rest < 0.25, "{rest}");
        wait(&mut c, 0.2);
        assert_eq!(program(&c).0, Some(ProgramState::WatchdogStop));
        let mut far = *c.q();
        far[3] += 0.2;
        servo(&mut c, 900, far);
        wait(&mut c, 0.02);
        assert_eq!(program(&c), (Some(ProgramState::WatchdogStop), beat));
        let near = *c.q();
        servo(&mut c, 901, near);
        wait(&mut c, 0.02);
        assert_eq!(program(&c), (Some(ProgramState::Servoing), 901));
        // Jumps and what is not a number are refused while servoing.
        let mut jump = near;
        jump[2] += 0.3;
        servo(&mut c, 902, jump);
        wait(&mut c, 0.01);
        servo(&mut c, 903, [f64::NAN; 6]);
        wait(&mut c, 0.01);
        assert_eq!(program(&c).1, 901);
        assert!((c.q()[2] - near[2]).abs() < 1e-3);
    }
}

/// What a tick costs with the servo program running; run by hand.
#[test]
#[ignore = "measures time"]
fn cost_of_a_tick() {
    for (generation, p) in
        [(Generation::Cb3, ServoProgram::cb3()), (Generation::ESeries, ServoProgram::e_series())]
    {
        let mut c = Controller::new(generation, HOME);
        run(&mut c, &p.text().unwrap());
        let mut all = Vec::new();
        for k in 0..20_000 {
            let mut q = HOME;
            q[0] = 0.2 * (f64::from(k / 4) * 0.008).sin();
            servo(&mut c, k / 4 + 1, q);
            let began = std::time::Instant::now();
            c.step(DT);
            all.push(began.elapsed().as_secs_f64() * 1e6);
        }
        assert_eq!(program(&c).0, Some(ProgramState::Servoing));
        all.sort_by(f64::total_cmp);
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        let p99 = all[all.len() * 99 / 100];
        println!(
            "{generation:?}: mean {mean:.1} us, p99 {p99:.1} us, worst {:.1} us",
            all[all.len() - 1]
        );
    }
}
