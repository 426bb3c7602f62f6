use crate::camera::{Camera, FRAME, Snapshot};
use crate::params::LabParameters;
use anyhow::Context as _;
use std::net::IpAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tdv_geometry::Stamp;
use tdv_msgs::sensor_msgs::msg::JointState;
use tdv_msgs::std_srvs::srv::{SetBool, SetBoolResponse, Trigger, TriggerResponse};
use tdv_msgs::tdv_msgs::msg::{TrackedObject, TrackedObjects, TrialVerdict};
use tdv_msgs::tf2_msgs::msg::TFMessage;
use tdv_robot::JOINT_NAMES;
use tdv_runtime::{Level, Node, Params, Publisher, Qos, Sender, inbox, realtime, tracked};
use tdv_simulation::controller::StopReason;
use tdv_simulation::disturbance::{Disturbance, ForcedDrop};
use tdv_simulation::trial::PlacingGoal;
use tdv_simulation::ur_server::{Cutter, Link, ServerConfig, UrServer};
use tdv_simulation::{Lab, LabAssets, Pacer, Scene};

/// Times between two messages of each kind (s of the lab's time).
const TRUTH_PERIOD: f64 = 1.0 / 30.0;
const JOINTS_PERIOD: f64 = 1.0 / 125.0;
const VERDICT_PERIOD: f64 = 0.5;

struct World {
    node: Node,
    lab: Lab,
    server: UrServer,
    pacer: Pacer,
    /// The graph's time of the lab's time zero.
    origin: Stamp,
    disturbance: Option<Disturbance>,
    disturb_now: Arc<AtomicBool>,
    protect_now: Arc<AtomicBool>,
    /// Why the robot stopped itself, each reason once; a stop that somebody asked for is none.
    stops: Vec<StopReason>,
    drop: Option<ForcedDrop>,
    frames: Option<Sender<Snapshot>>,
    truth: Publisher<TrackedObjects>,
    true_joints: Publisher<JointState>,
    verdict: Publisher<TrialVerdict>,
    finished: bool,
}

/// The node's life.
pub async fn simulate(node: Node, params: Params<LabParameters>) -> anyhow::Result<()> {
    let p = params.get();
    let seed = p.seed as u64;
    let mut scene = Scene::load(Path::new(&p.scene))?;
    if let Some(generation) = p.generation() {
        scene.robot.controller = generation;
    }
    let assets = Arc::new(LabAssets::load(scene)?);
    let mut lab = Lab::from_assets(assets.clone(), seed)?;
    lab.begin_trial(PlacingGoal { offset: [p.goal_offset[0], p.goal_offset[1]], yaw: p.goal_yaw })?;
    let address: IpAddr = p.address.parse().context("'address'")?;
    let ports = ServerConfig {
        address,
        rtde: p.rtde_port,
        gripper: p.gripper_port,
        dashboard: p.dashboard_port,
        primary: p.primary_port,
        secondary: p.secondary_port,
        realtime: p.realtime_port,
    };
    let (priority, generation) = (p.thread_priority, assets.scene.robot.controller);
    // The threads of its connections inherit the priority of the one that starts it.
    let server = tokio::task::spawn_blocking(move || {
        realtime::request("the controller's sockets", priority);
        UrServer::start(ports, generation)
    });
    let server = server.await.context("the controller's sockets")??;
    let knowledge = lab.knowledge().clone();
    let tf = node.publisher::<TFMessage>("/tf_static", Qos::latched_depth(10))?;
    tf.publish(TFMessage {
        transforms: vec![tracked::transform("base_link", FRAME, node.now(), &knowledge.camera)],
    });
    let frames = if p.camera { Some(start_camera(&node, assets, &knowledge, seed)?) } else { None };
    let disturb_now = flag(&node, "~/disturb", "an object will be displaced")?;
    let protect_now = flag(&node, "~/protective_stop", "the robot will be stopped")?;
    for (name, link) in [("~/cut_rtde", Link::Rtde), ("~/cut_gripper", Link::Gripper)] {
        serve_cut(&node, name, link, server.cutter())?;
    }
    let world = World {
        true_joints: node.publisher("/virtual_lab/ground_truth/joint_states", Qos::reliable(10))?,
        truth: node.publisher("/virtual_lab/ground_truth/objects", Qos::reliable(5))?,
        verdict: node.publisher("/virtual_lab/ground_truth/verdict", Qos::latched())?,
        lab,
        server,
        pacer: Pacer::new(1.0),
        origin: node.now(),
        disturbance: p.disturb.then(|| Disturbance::new(seed)),
        disturb_now,
        protect_now,
        stops: Vec::new(),
        drop: p.drop.then(|| ForcedDrop::new(seed)),
        frames,
        finished: false,
        node: node.clone(),
    };
    node.diagnostics().level(Level::Ok, format!("controller on {address}"));
    let physics = tokio::task::spawn_blocking(move || {
        realtime::request("the physics thread", priority);
        world.run();
    });
    physics.await.context("the physics thread")?;
    Ok(())
}

/// A service that asks for something in the next step.
fn flag(node: &Node, name: &str, answer: &'static str) -> anyhow::Result<Arc<AtomicBool>> {
    let asked = Arc::new(AtomicBool::new(false));
    let flag = asked.clone();
    node.service::<Trigger, _, _>(name, move |_request| {
        flag.store(true, Ordering::SeqCst);
        async move { TriggerResponse { success: true, message: answer.into() } }
    })?;
    Ok(asked)
}

/// A service that cuts a connection of the robot (true) or lets it come again.
fn serve_cut(node: &Node, name: &str, link: Link, cutter: Cutter) -> anyhow::Result<()> {
    node.service::<SetBool, _, _>(name, move |request| {
        cutter.cut(link, request.data);
        let state = if request.data { "is cut" } else { "may come again" };
        let message = format!("the connection {state}");
        async move { SetBoolResponse { success: true, message } }
    })?;
    Ok(())
}

/// Images are made on a thread of their own; when it is late, snapshots are left out.
fn start_camera(
    node: &Node,
    assets: Arc<LabAssets>,
    knowledge: &tdv_simulation::scene::Knowledge,
    seed: u64,
) -> anyhow::Result<Sender<Snapshot>> {
    let mut camera = Camera::new(node, assets, knowledge, seed)?;
    let (sender, mut inbox) = inbox::<Snapshot>(1);
    let node = node.clone();
    std::thread::spawn(move || {
        while !inbox.is_closed() && !node.shutdown().is_requested() {
            if let Some(snapshot) = inbox.recv_timeout(Duration::from_millis(200)) {
                let began = Instant::now();
                camera.publish(&snapshot);
                node.diagnostics().latency("render", began.elapsed().as_secs_f64());
            }
        }
    });
    Ok(sender)
}

/// True once per period of the lab's time.
fn due(time: f64, step: f64, period: f64) -> bool {
    (time / period).floor() != ((time - step) / period).floor()
}

impl World {
    fn run(mut self) {
        let frame_period = 1.0 / self.lab.scene().camera.rate;
        let mut number = 0;
        let mut last = self.lab.time();
        while !self.node.shutdown().is_requested() {
            self.server.exchange(&mut self.lab);
            self.lab.step();
            let time = self.lab.time();
            let step = time - last;
            last = time;
            self.disturb();
            self.note_stop();
            let stamp = self.lab.stamp(self.origin);
            if due(time, step, frame_period)
                && let Some(frames) = &self.frames
            {
                number += 1;
                let poses = self.lab.render_poses();
                frames.send(Snapshot { stamp, number, poses });
            }
            if due(time, step, TRUTH_PERIOD) {
                self.publish_truth(stamp);
            }
            if due(time, step, JOINTS_PERIOD) {
                self.publish_true_joints(stamp);
            }
            let finished = self.lab.trial().finished;
            if due(time, step, VERDICT_PERIOD) || finished != self.finished {
                self.finished = finished;
                self.publish_verdict(stamp);
            }
            let nap = self.pacer.pace(time, Instant::now());
            if !nap.is_zero() {
                std::thread::sleep(nap);
            }
            self.follow_clock();
        }
    }

    /// Time that was forgiven must not let the lab's stamps fall behind the graph's clock.
    fn follow_clock(&mut self) {
        let stamp = self.lab.stamp(self.origin);
        let behind = self.node.now().since(stamp);
        if behind > 0.02 {
            self.origin = self.origin.plus(behind);
        }
    }

    fn note_stop(&mut self) {
        if let Some(reason) = self.lab.controller().protective_stop()
            && reason != StopReason::Asked
            && !self.stops.contains(&reason)
        {
            tracing::warn!("the robot stopped itself: {reason:?}");
            self.stops.push(reason);
        }
    }

    fn disturb(&mut self) {
        if self.protect_now.swap(false, Ordering::SeqCst) {
            self.lab.controller_mut().protect(StopReason::Asked);
        }
        if self.disturb_now.swap(false, Ordering::SeqCst) {
            let name = self.lab.scene().task.reference.clone();
            match self.lab.disturb(&name, self.lab.seed()) {
                Ok([dx, dy]) => tracing::info!("{name} is displaced by {dx:.3}, {dy:.3} m"),
                Err(e) => tracing::warn!("{e}"),
            }
        }
        if let Some(disturbance) = &mut self.disturbance {
            match disturbance.step(&mut self.lab) {
                Ok(Some((name, [dx, dy]))) => {
                    tracing::info!("{name} is displaced by {dx:.3}, {dy:.3} m");
                }
                Ok(None) => {}
                Err(e) => tracing::debug!("{e}"),
            }
        }
        if let Some(drop) = &mut self.drop {
            match drop.step(&mut self.lab) {
                Ok(true) => tracing::info!("the grip fails"),
                Ok(false) => {}
                Err(e) => tracing::debug!("{e}"),
            }
        }
    }

    fn publish_truth(&self, stamp: Stamp) {
        let objects = self
            .lab
            .objects()
            .map(|(name, pose)| {
                let mut o = TrackedObject {
                    name: name.into(),
                    state: TrackedObject::TRACKING,
                    confidence: 1.0,
                    ..Default::default()
                };
                o.pose.pose = tracked::pose_message(&pose);
                o
            })
            .collect();
        self.truth.publish(TrackedObjects { header: tracked::header(stamp), objects });
    }

    fn publish_true_joints(&self, stamp: Stamp) {
        let (position, velocity) = self.lab.joints();
        self.true_joints.publish(JointState {
            header: tracked::header(stamp),
            name: JOINT_NAMES.map(String::from).to_vec(),
            position: position.to_vec(),
            velocity: velocity.to_vec(),
            effort: Vec::new(),
        });
    }

    fn publish_verdict(&self, stamp: Stamp) {
        let v = self.lab.trial();
        let factor = self.pacer.factor(self.lab.time(), Instant::now());
        let incidents = self.lab.incidents();
        let diagnostics = self.node.diagnostics();
        diagnostics.set("real_time_factor", format!("{factor:.3}"));
        diagnostics.set("table_hits", incidents.table_hits);
        diagnostics.set("protective_stops", incidents.protective_stops);
        if !self.stops.is_empty() {
            diagnostics.set("stopped_itself", format!("{:?}", self.stops));
        }
        if let Some(f) = self.server.command_figures() {
            diagnostics.set("command_interval_p50_ms", format!("{:.2}", f.p50_ms));
            diagnostics.set("command_interval_p99_ms", format!("{:.2}", f.p99_ms));
            diagnostics.set("command_interval_max_ms", format!("{:.2}", f.max_ms));
            let share = 100.0 * f.missed as f64 / f.ticks.max(1) as f64;
            diagnostics.set("command_missed_ticks_percent", format!("{share:.2}"));
            diagnostics.set("command_missed_ticks_in_a_row", f.missed_run);
        }
        self.verdict.publish(TrialVerdict {
            header: tracked::header(stamp),
            finished: v.finished,
            success: v.success,
            reason: v.reason.clone(),
            error_m: v.error_m,
            error_rad: v.error_rad,
            tilt_rad: v.tilt_rad,
            released: v.released,
            elapsed: v.elapsed,
            real_time_factor: factor,
        });
    }
}
