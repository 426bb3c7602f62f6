//! A laboratory in one process: the arm controller, the driver's executor, an arm that follows its
//! target with a first-order lag, a gripper, and a policy that sees the arm late.

#![allow(dead_code)] // each test file uses a part of it

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use tdv_geometry::{
    Pose, Stamp, interpolate, pose_distance, pose_from_xyz_rpy, smooth_step, twist_arc,
};
use tdv_robot::gripper::{gap_from_knuckle, knuckle_from_gap};
use tdv_robot::motion::*;
use tdv_robot::*;

pub const TICK: f64 = 0.008;

/// Straight down at a place of `base_link`, closing axis along y turned by `yaw`.
pub fn down(x: f64, y: f64, z: f64, yaw: f64) -> Pose {
    pose_from_xyz_rpy([x, y, z], [std::f64::consts::PI, 0.0, yaw])
}

/// Minimum-jerk path over a hump, at most 0.2 m/s on the straight.
pub fn path(from: Pose, to: Pose, hump: f64) -> Vec<Pose> {
    let d = (to.translation.vector - from.translation.vector).norm() + 2.0 * hump;
    let n = (1.875 * d / 0.2 / 0.05).ceil() as usize;
    (0..=n)
        .map(|i| {
            let s = smooth_step(i as f64 / n as f64);
            let mut p = interpolate(&from, &to, s);
            p.translation.z += hump * 16.0 * s * s * (1.0 - s) * (1.0 - s);
            p
        })
        .collect()
}

/// Given where the moving frame is, the future of a path (poses 50 ms apart) from the nearest phase on.
pub struct Policy {
    pub path: Vec<Pose>,
    pub phase: f64,
}

impl Policy {
    fn at(&self, phase: f64) -> Pose {
        let x = phase.clamp(0.0, (self.path.len() - 1) as f64);
        let i = (x.floor() as usize).min(self.path.len() - 2);
        interpolate(&self.path[i], &self.path[i + 1], x - i as f64)
    }

    /// `pull`: 0 gives the path itself, above 0 the way back to it from the present pose too.
    pub fn plan(&mut self, now: &Pose, pull: f64) -> Vec<Pose> {
        let range = |k: i32| (self.phase + f64::from(k) * 0.1).max(0.0);
        let best = (-10..60)
            .map(range)
            .min_by(|a, b| {
                let d = |x: f64| twist_arc(&self.at(x), now, 0.1);
                d(*a).total_cmp(&d(*b))
            })
            .unwrap();
        self.phase = best;
        let here = self.at(best);
        let off = now.translation.vector - here.translation.vector;
        (1..=16)
            .map(|i| {
                let mut p = self.at(best + f64::from(i));
                if pull > 0.0 {
                    p.translation.vector += off * (-f64::from(i) * 0.05 / pull).exp();
                }
                p
            })
            .collect()
    }

    pub fn at_end(&self, now: &Pose) -> bool {
        twist_arc(&self.path[self.path.len() - 1], now, 0.1) < 0.006
    }
}

/// What went on, for the assertions.
#[derive(Debug, Default)]
pub struct Log {
    pub codes: Vec<StatusCode>,
    pub sentences: Vec<String>,
    pub paths: usize,
    pub max_qd: f64,
    pub max_qdd: f64,
    pub max_tcp: f64,
    /// Greatest distance of the measured tcp from the policy's path (m).
    pub max_off: f64,
    /// Longest time (s) that the tool stood still while it was following.
    pub longest_stall: f64,
    /// Distance from the end of each procedure when the switch fired (m, rad).
    pub ends: Vec<(f64, f64)>,
}

/// What the switch policy says of a procedure.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    pub moving: Moving,
    pub grip: bool,
    pub end: GripperEnd,
}

impl Step {
    pub fn new(moving: Moving, grip: bool, end: GripperEnd) -> Self {
        Self { moving, grip, end }
    }
}

pub struct Bench {
    pub k: Kinematics,
    pub controller: ArmController,
    pub executor: JointTrajectoryExecutor,
    pub now: Stamp,
    pub q: Joints,
    pub qd: Joints,
    pub lag: f64,
    pub latency: (f64, f64),
    pub noise: f64,
    pub pull: f64,
    /// `T_base_link_reference` of each procedure.
    pub references: Vec<Pose>,
    pub policies: Vec<Policy>,
    pub steps: Vec<Step>,
    /// Procedures that the switch policy went back to.
    pub went_back: Vec<u32>,
    pub procedure: u32,
    pub complete: bool,
    pub input: ControllerInput,
    pub log: Log,
    /// Width (m) of what is between the fingers; `None`: nothing.
    pub object: Option<f64>,
    pub attach: Pose,
    pub knuckle: f64,
    pub perceive: bool,
    /// The switch policy lives.
    pub decide: bool,
    pub alive: bool,
    /// The gripper's state is known.
    pub gripper_speaks: bool,
    /// Where the tracker says that the object is.
    pub place: ObjectPlace,
    /// Whether the driver is told the trajectories' start, or starts on arrival.
    pub stamped: bool,
    pub guard: Option<TargetGuard>,
    /// Changes a plan before it goes out.
    pub tamper: Option<fn(&mut Plan)>,
    command: Option<GripperRequest>,
    queue: VecDeque<(Stamp, Plan)>,
    in_flight: Option<JointPath>,
    next_frame: Stamp,
    pub last_frame: Stamp,
    last_qd: Joints,
    still: f64,
    rng: ChaCha8Rng,
}

pub const START: [f64; 3] = [0.35, -0.12, 0.30];

impl Bench {
    pub fn new(params: ControllerParams) -> Self {
        let k = Kinematics::ur5();
        let seed = [0.0, -1.6, 1.9, -1.9, -1.57, 0.0];
        let start = down(START[0], START[1], START[2], 0.3);
        let q = k.nearest_tcp(&start, &seed, &IkSelection::default()).unwrap();
        let mug = pose_from_xyz_rpy([0.58, 0.18, 0.0], [0.0, 0.0, 0.5]);
        let coaster = pose_from_xyz_rpy([0.45, -0.22, 0.0], [0.0; 3]);
        let grasp = down(0.58, 0.18, 0.065, 0.6);
        let attach = grasp.inverse() * mug;
        let reach = path(mug.inverse() * start, mug.inverse() * grasp, 0.0);
        let placed = pose_from_xyz_rpy([0.0, 0.0, 0.008], [0.0, 0.0, 0.2]);
        let place = path(coaster.inverse() * mug, placed, 0.12);
        let now = Stamp::from_secs(1000.0);
        Self {
            controller: ArmController::new(k.clone(), params).unwrap(),
            executor: JointTrajectoryExecutor::new(ExecutorParams::default()),
            k,
            now,
            q,
            qd: [0.0; 6],
            lag: 0.045,
            latency: (0.06, 0.10),
            noise: 0.0,
            pull: 0.0,
            references: vec![mug, coaster],
            policies: vec![Policy { path: reach, phase: 0.0 }, Policy { path: place, phase: 0.0 }],
            steps: vec![
                Step::new(Moving::Tcp, false, GripperEnd::Close),
                Step::new(Moving::Object, true, GripperEnd::Open),
            ],
            went_back: Vec::new(),
            procedure: 0,
            complete: false,
            input: ControllerInput::default(),
            log: Log::default(),
            object: Some(0.064),
            attach,
            knuckle: 0.0,
            perceive: true,
            decide: true,
            alive: true,
            gripper_speaks: true,
            place: ObjectPlace::Held,
            stamped: false,
            guard: Some(TargetGuard::new(&Limits::default())),
            tamper: None,
            command: None,
            queue: VecDeque::new(),
            in_flight: None,
            next_frame: now,
            last_frame: now,
            last_qd: [0.0; 6],
            still: 0.0,
            rng: ChaCha8Rng::seed_from_u64(7),
        }
    }

    /// `T_reference_moving` as the arm is now.
    pub fn relative(&self) -> Pose {
        let tcp = self.k.fk_tcp(&self.q);
        let moving = match self.steps[self.index()].moving {
            Moving::Tcp => tcp,
            Moving::Object => tcp * self.attach,
        };
        self.references[self.index()].inverse() * moving
    }

    fn index(&self) -> usize {
        (self.procedure as usize).min(self.steps.len() - 1)
    }

    fn observe(&mut self) {
        let i = self.index();
        let mut seen = self.relative();
        for v in seen.translation.vector.iter_mut() {
            *v += self.noise * self.rng.random_range(-1.0..1.0);
        }
        let mut reference = self.references[i];
        reference.translation.x += self.noise * self.rng.random_range(-1.0..1.0);
        let poses = self.policies[i].plan(&seen, self.pull);
        let mut plan = Plan {
            stamp: self.now,
            procedure: self.procedure,
            moving: self.steps[i].moving,
            reference_pose: reference,
            moving_pose: Some(seen),
            poses,
            dt: 0.05,
        };
        if let Some(f) = self.tamper {
            f(&mut plan);
        }
        let due = self.now.plus(self.rng.random_range(self.latency.0..=self.latency.1));
        self.queue.push_back((due, plan));
    }

    /// One tick of everything; returns the controller's output.
    pub fn tick(&mut self) -> Option<ControllerOutput> {
        self.now = self.now.plus(TICK);
        if let Some(p) = self.in_flight.take() {
            // One tick of transport.
            let trajectory = p.to_trajectory(self.stamped);
            let current = Desired { q: self.q, qd: [0.0; 6] };
            self.executor.accept(&trajectory, self.now, &current).unwrap();
        }
        self.plant();
        if self.perceive && self.now >= self.next_frame {
            self.next_frame = self.now.plus(1.0 / 30.0);
            self.last_frame = self.now;
            self.observe();
        }
        while self.queue.front().is_some_and(|(due, _)| *due <= self.now) {
            self.input.plan = self.queue.pop_front().map(|x| x.1);
        }
        self.gripper();
        self.input.joints = Some(JointState { stamp: self.now, q: self.q, qd: self.qd });
        if self.decide {
            self.input.procedure = Some(ProcedureState {
                stamp: self.now,
                procedure: self.procedure,
                complete: self.complete,
                grip: self.steps[self.index()].grip,
                moving: self.steps[self.index()].moving,
                end: self.steps[self.index()].end,
            });
        }
        if !self.alive {
            return None;
        }
        let out = self.controller.step(self.now, &self.input);
        self.input.requests = Requests::default();
        self.record(&out);
        if let Some(g) = out.gripper {
            self.command = Some(g);
        }
        if out.reset_switch {
            let mut first = if out.regrasp { self.index() } else { 0 };
            while self.steps[first].grip {
                first -= 1;
            }
            self.procedure = first as u32;
            self.went_back.push(self.procedure);
            self.complete = false;
            self.policies[first].phase = 0.0;
        }
        let tracked = out.status.object_held && self.place != ObjectPlace::Unknown;
        self.input.attach = tracked.then_some(Attach { stamp: self.now, pose: self.attach });
        self.in_flight.clone_from(&out.trajectory);
        Some(out)
    }

    fn plant(&mut self) {
        let Some(target) = self.executor.sample(self.now) else { return };
        if let Some(g) = &mut self.guard {
            g.check(self.now, &target.q, &self.q).unwrap();
        }
        for i in 0..6 {
            let accel = (target.qd[i] - self.last_qd[i]).abs() / TICK;
            self.log.max_qdd = self.log.max_qdd.max(accel);
            self.log.max_qd = self.log.max_qd.max(target.qd[i].abs());
            let step = (target.q[i] - self.q[i]) * (1.0 - (-TICK / self.lag).exp());
            self.q[i] += step;
            self.qd[i] = step / TICK;
        }
        self.last_qd = target.qd;
        self.log.max_tcp = self.log.max_tcp.max(self.k.tcp_speed(&target.q, &target.qd).0);
    }

    fn gripper(&mut self) {
        let mut feedback = GripperFeedback {
            stamp: self.now,
            command: None,
            knuckle: self.knuckle,
            stalled: false,
            reached: false,
        };
        if let Some(c) = self.command {
            let stop = self.object.map_or(f64::INFINITY, knuckle_from_gap);
            let step = (c.position - self.knuckle).clamp(-1.5 * TICK, 1.5 * TICK);
            let free = self.knuckle + step;
            self.knuckle = if step > 0.0 { free.min(stop.max(self.knuckle)) } else { free };
            feedback = GripperFeedback {
                stamp: self.now,
                command: Some(c.id),
                knuckle: self.knuckle,
                stalled: step > 1e-6 && self.knuckle < free - 1e-9,
                reached: (self.knuckle - c.position).abs() < 0.02,
            };
        }
        if self.gripper_speaks {
            self.input.gripper = Some(feedback);
        }
        self.input.object = Some(ObjectReport { stamp: self.now, place: self.place });
    }

    fn record(&mut self, out: &ControllerOutput) {
        if self.log.codes.last() != Some(&out.status.code) {
            self.log.codes.push(out.status.code);
            self.log.sentences.push(out.status.sentence.clone());
        }
        let speed = self.k.tcp_speed(&self.q, &self.qd).0;
        let following = out.status.code == StatusCode::Following;
        self.still = if following && speed < 0.002 { self.still + TICK } else { 0.0 };
        let policy = &self.policies[self.index()];
        if following {
            if !policy.at_end(&self.relative()) {
                self.log.longest_stall = self.log.longest_stall.max(self.still);
            }
            let here = self.relative();
            let off = policy
                .path
                .windows(2)
                .map(|w| {
                    let (a, b) = (w[0].translation.vector, w[1].translation.vector);
                    let d = b - a;
                    let x = ((here.translation.vector - a).dot(&d) / d.norm_squared().max(1e-12))
                        .clamp(0.0, 1.0);
                    (here.translation.vector - a - d * x).norm()
                })
                .fold(f64::INFINITY, f64::min);
            self.log.max_off = self.log.max_off.max(off);
        }
        if let Some(p) = &out.trajectory {
            self.log.paths += 1;
            check_path(&self.k, p, self.controller.params());
        }
    }

    /// Runs; the switch fires when the policy's path has ended.
    pub fn run(&mut self, seconds: f64) {
        let mut still = 0;
        for _ in 0..(seconds / TICK) as usize {
            let Some(out) = self.tick() else { continue };
            let ended = self.policies[self.index()].at_end(&self.relative());
            still = if ended && out.status.code == StatusCode::Following { still + 1 } else { 0 };
            if still > 40 {
                still = 0;
                let end = *self.policies[self.index()].path.last().unwrap();
                self.log.ends.push(pose_distance(&self.relative(), &end));
                if self.index() + 1 < self.steps.len() {
                    self.procedure += 1;
                } else {
                    self.complete = true;
                }
            }
            if out.status.done {
                break;
            }
        }
    }

    pub fn last_code(&self) -> StatusCode {
        *self.log.codes.last().unwrap()
    }

    pub fn last_sentence(&self) -> &str {
        self.log.sentences.last().unwrap()
    }

    pub fn gap(&self) -> f64 {
        gap_from_knuckle(self.knuckle)
    }
}

/// What every trajectory must be.
pub fn check_path(k: &Kinematics, p: &JointPath, params: &ControllerParams) {
    let l = &params.limits;
    let last = p.points.last().unwrap();
    assert_eq!(last.qd, [0.0; 6], "ends at rest");
    assert!(last.time <= l.rest_within, "at rest after {} s", last.time);
    for w in p.points.windows(2) {
        let dt = w[1].time - w[0].time;
        assert!(dt > 1e-4);
        for i in 0..6 {
            assert!((w[1].q[i] - w[0].q[i]).abs() <= l.joint_velocity * dt * 1.01);
            let a = (w[1].qd[i] - w[0].qd[i]) / dt;
            assert!(a.abs() <= l.stop_acceleration.max(l.joint_acceleration), "{a} rad/s^2");
        }
    }
    for x in &p.points {
        assert!(x.q.iter().chain(&x.qd).all(|v| v.is_finite()));
        assert!(x.qd.iter().all(|v| v.abs() <= l.joint_velocity));
        assert!(k.tcp_speed(&x.q, &x.qd).0 <= l.tcp_speed * 1.001);
    }
}
