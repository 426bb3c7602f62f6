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
use tdv_msgs::std_srvs::srv::{Trigger, TriggerResponse};
use tdv_msgs::tdv_msgs::msg::{TrackedObject, TrackedObjects, TrialVerdict};
use tdv_msgs::tf2_msgs::msg::TFMessage;
use tdv_robot::JOINT_NAMES;
use tdv_runtime::{Level, Node, Params, Publisher, Qos, Sender, inbox, tracked};
use tdv_simulation::disturbance::{Disturbance, ForcedDrop};
use tdv_simulation::trial::PlacingGoal;
use tdv_simulation::ur_server::{ServerConfig, UrServer};
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
    let assets = Arc::new(LabAssets::load(Scene::load(Path::new(&p.scene))?)?);
    let mut lab = Lab::from_assets(assets.clone(), seed)?;
    lab.begin_trial(PlacingGoal { offset: [p.goal_offset[0], p.goal_offset[1]], yaw: p.goal_yaw })?;
    let address: IpAddr = p.address.parse().context("'address'")?;
    let server = UrServer::start(
        ServerConfig {
            address,
            rtde: p.rtde_port,
            gripper: p.gripper_port,
            dashboard: p.dashboard_port,
            primary: p.primary_port,
            secondary: p.secondary_port,
            realtime: p.realtime_port,
        },
        assets.scene.robot.controller,
    )?;
    let knowledge = lab.knowledge().clone();
    let tf = node.publisher::<TFMessage>("/tf_static", Qos::latched_depth(10))?;
    tf.publish(TFMessage {
        transforms: vec![tracked::transform("base_link", FRAME, node.now(), &knowledge.camera)],
    });
    let frames = if p.camera { Some(start_camera(&node, assets, &knowledge, seed)?) } else { None };
    let disturb_now = Arc::new(AtomicBool::new(false));
    let flag = disturb_now.clone();
    node.service::<Trigger, _, _>("~/disturb", move |_request| {
        flag.store(true, Ordering::SeqCst);
        async { TriggerResponse { success: true, message: "an object will be displaced".into() } }
    })?;
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
        drop: p.drop.then(|| ForcedDrop::new(seed)),
        frames,
        finished: false,
        node: node.clone(),
    };
    node.diagnostics().level(Level::Ok, format!("controller on {address}"));
    tokio::task::spawn_blocking(move || world.run()).await.context("the physics thread")?;
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

    fn disturb(&mut self) {
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
