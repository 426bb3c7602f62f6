use crate::controllers::ControllerWatch;
use crate::gripper::Gripper;
use crate::inputs;
use crate::params::{ArmParameters, Command};
use crate::permissions::Permissions;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tdv_geometry::Stamp;
use tdv_msgs::sensor_msgs::msg::JointState;
use tdv_msgs::std_msgs::msg::{Bool, Float64, Float64MultiArray};
use tdv_msgs::std_srvs::srv::{Trigger, TriggerRequest, TriggerResponse};
use tdv_msgs::tdv_msgs::msg::{ControllerStatus, PoseTrajectory, Procedure, TrackedObjects};
use tdv_msgs::trajectory_msgs::msg::JointTrajectory;
use tdv_robot::motion::{GripperFeedback, GripperRequest, Requests};
use tdv_robot::{ArmController, ControllerInput, ControllerOutput, Kinematics, Limits};
use tdv_runtime::{Level, Node, Params, Publisher, Qos, ServiceClient, tracked};
use tokio::runtime::Handle;

/// The status goes out at least this often.
const REPEAT: f64 = 0.1;

type SharedInput = Arc<Mutex<ControllerInput>>;

/// Where the motion goes.
enum Output {
    /// Trajectories, with their stamp or to be started on arrival.
    Trajectory(Publisher<JointTrajectory>, bool),
    Positions(Publisher<Float64MultiArray>),
}

struct Loop {
    node: Node,
    core: ArmController,
    input: SharedInput,
    runtime: Handle,
    output: Output,
    permissions: Permissions,
    status: Publisher<ControllerStatus>,
    gripper: Gripper,
    switch_reset: ServiceClient<Trigger>,
    switch_regrasp: ServiceClient<Trigger>,
    last_status: Option<(Stamp, ControllerStatus)>,
    last_plan: Option<Stamp>,
}

fn with<T>(input: &SharedInput, f: impl FnOnce(&mut ControllerInput) -> T) -> T {
    // Every change is one assignment.
    f(&mut input.lock().unwrap_or_else(PoisonError::into_inner))
}

/// The node's life.
pub async fn control(node: Node, params: Params<ArmParameters>) -> anyhow::Result<()> {
    let mut p = ArmParameters::clone(&params.get());
    if !p.limits_file.is_empty() {
        p.control.limits = Limits::load(Path::new(&p.limits_file))?;
    }
    let kinematics = if p.robot == "ur5e" { Kinematics::ur5e() } else { Kinematics::ur5() };
    let core = ArmController::new(kinematics, p.control.clone())
        .map_err(|problems| anyhow::anyhow!("{}", problems.join("; ")))?;
    let core = match p.world()? {
        Some(world) => core.with_world(world),
        None => core,
    };
    let input: SharedInput = Arc::default();
    let permissions = permissions(&node, &p)?;
    let take = Arc::new(AtomicBool::new(false));
    if !p.controller_manager.is_empty() {
        let (granted, always) = (permissions.clone(), p.control.auto_resume);
        let (manager, name) = (&p.controller_manager, p.motion_controller());
        let watch = ControllerWatch::new(&node, manager, name, granted, take.clone(), always)?;
        node.spawn("controller watch", watch.watch());
    }
    subscribe_robot(&node, &input)?;
    subscribe_task(&node, &p, &input)?;
    serve_requests(&node, &input, &take)?;
    let tick = Duration::from_secs_f64(p.control.tick);
    let control = Loop {
        core,
        input,
        runtime: Handle::current(),
        output: output(&node, &p)?,
        permissions,
        status: node.publisher("/arm_controller/status", Qos::latched())?,
        gripper: Gripper::new(&node, p.gripper_action, &p.gripper_controller)?,
        switch_reset: node.client("/switch_policy/reset")?,
        switch_regrasp: node.client("/switch_policy/regrasp")?,
        last_status: None,
        last_plan: None,
        node: node.clone(),
    };
    tokio::task::spawn_blocking(move || control.run(tick)).await?;
    Ok(())
}

fn output(node: &Node, p: &ArmParameters) -> anyhow::Result<Output> {
    Ok(match (p.control.dry_run, p.command) {
        (true, _) => Output::Trajectory(
            node.publisher("~/dry_run/joint_trajectory", Qos::reliable(1))?,
            p.stamp_trajectories,
        ),
        (false, Command::Trajectory) => {
            let topic = format!("/{}/joint_trajectory", p.trajectory_controller);
            Output::Trajectory(node.publisher(&topic, Qos::reliable(1))?, p.stamp_trajectories)
        }
        (false, Command::ForwardPosition) => {
            let topic = format!("/{}/commands", p.forward_controller);
            Output::Positions(node.publisher(&topic, Qos::reliable(1))?)
        }
    })
}

fn permissions(node: &Node, p: &ArmParameters) -> anyhow::Result<Permissions> {
    let permissions = Permissions::new(
        p.require_program,
        !p.enable_topic.is_empty(),
        !p.controller_manager.is_empty(),
        Duration::from_secs_f64(p.enable_timeout),
    );
    if p.require_program {
        let given = permissions.clone();
        let topic = "/io_and_status_controller/robot_program_running";
        node.subscribe(topic, Qos::latched(), move |m: Bool| given.program(m.data))?;
    }
    if !p.enable_topic.is_empty() {
        let given = permissions.clone();
        node.subscribe(&p.enable_topic, Qos::best_effort(1), move |m: Bool| given.switch(m.data))?;
    }
    Ok(permissions)
}

fn subscribe_robot(node: &Node, input: &SharedInput) -> anyhow::Result<()> {
    let shared = input.clone();
    node.subscribe("/joint_states", Qos::best_effort(10), move |m: JointState| {
        with(&shared, |i| {
            if let Some(joints) = inputs::arm_joints(&m) {
                i.joints = Some(joints);
            }
            if let Some(knuckle) = inputs::knuckle(&m) {
                let stamp = tracked::stamp(&m.header);
                let old = i.gripper.unwrap_or(GripperFeedback {
                    stamp,
                    command: None,
                    knuckle,
                    stalled: false,
                    reached: false,
                });
                i.gripper = Some(GripperFeedback { stamp, knuckle, ..old });
            }
        });
    })?;
    let shared = input.clone();
    let topic = "/speed_scaling_state_broadcaster/speed_scaling";
    node.subscribe(topic, Qos::best_effort(1), move |m: Float64| {
        if m.data.is_finite() {
            with(&shared, |i| i.speed_scaling = (m.data / 100.0).clamp(0.0, 1.0));
        }
    })?;
    Ok(())
}

fn subscribe_task(node: &Node, p: &ArmParameters, input: &SharedInput) -> anyhow::Result<()> {
    let (shared, offset) = (input.clone(), p.grasp_offset.clone());
    // The object that is to be held.
    let carried = Arc::new(Mutex::new(String::new()));
    let held = carried.clone();
    node.subscribe("/diffusion_policy/prediction", Qos::best_effort(2), {
        move |m: PoseTrajectory| match inputs::plan(&m, &offset) {
            Ok(Some(plan)) => with(&shared, |i| i.plan = Some(plan)),
            Ok(None) => {}
            Err(why) => tracing::warn!("prediction refused: {why}"),
        }
    })?;
    let shared = input.clone();
    node.subscribe("/switch_policy/procedure", Qos::best_effort(5), move |m: Procedure| {
        with(&shared, |i| i.procedure = Some(inputs::procedure(&m)));
        *held.lock().unwrap_or_else(PoisonError::into_inner) = m.held;
    })?;
    let shared = input.clone();
    node.subscribe("/pose_tracker/objects", Qos::best_effort(5), move |m: TrackedObjects| {
        let name = carried.lock().unwrap_or_else(PoisonError::into_inner).clone();
        with(&shared, |i| {
            i.attach = inputs::attach(&m);
            i.object = inputs::report(&m, &name);
        });
    })?;
    Ok(())
}

fn serve_requests(node: &Node, input: &SharedInput, take: &Arc<AtomicBool>) -> anyhow::Result<()> {
    let requests: [(&str, fn(&mut Requests)); 5] = [
        ("pause", |r| r.pause = true),
        ("resume", |r| r.resume = true),
        ("reset", |r| r.reset = true),
        ("home", |r| r.home = true),
        ("abort", |r| r.abort = true),
    ];
    for (name, set) in requests {
        let (shared, take) = (input.clone(), take.clone());
        node.service::<Trigger, _, _>(&format!("~/{name}"), move |_request| {
            with(&shared, |i| set(&mut i.requests));
            if ["resume", "home"].contains(&name) {
                take.store(true, Ordering::SeqCst);
            }
            async move { TriggerResponse { success: true, message: format!("{name} requested") } }
        })?;
    }
    Ok(())
}

impl Loop {
    /// Ticks at a fixed rate; a late tick is not made up for.
    fn run(mut self, tick: Duration) {
        let mut due = Instant::now();
        while !self.node.shutdown().is_requested() {
            due += tick;
            let now = Instant::now();
            if due > now {
                std::thread::sleep(due - now);
            } else if now - due > tick {
                self.node.diagnostics().latency("late_tick", (now - due).as_secs_f64());
                due = now;
            }
            self.tick();
        }
    }

    fn tick(&mut self) {
        let now = self.node.now();
        let input = with(&self.input, |i| {
            i.disabled = self.permissions.refusal();
            let taken = i.clone();
            i.requests = Requests::default();
            taken
        });
        let output = self.core.step(now, &input);
        self.act(now, &input, &output);
        self.report(now, &output);
    }

    fn act(&mut self, now: Stamp, input: &ControllerInput, output: &ControllerOutput) {
        if let (Output::Positions(topic), Some((q, _)), None) =
            (&self.output, self.core.commanded(), &input.disabled)
        {
            topic.publish(Float64MultiArray { data: q.to_vec(), ..Default::default() });
        }
        if let Some(path) = &output.trajectory {
            if let Output::Trajectory(topic, stamped) = &self.output {
                topic.publish(inputs::trajectory(path, *stamped));
            }
            if let Some(plan) = &input.plan
                && self.last_plan != Some(plan.stamp)
            {
                self.last_plan = Some(plan.stamp);
                self.node.diagnostics().latency("image_to_command", now.since(plan.stamp));
            }
        }
        if let Some(request) = output.gripper {
            self.command_gripper(now, request);
        }
        if output.reset_switch {
            let client = if output.regrasp {
                self.switch_regrasp.clone()
            } else {
                self.switch_reset.clone()
            };
            self.runtime.spawn(async move {
                if let Err(e) = client.call(TriggerRequest::default(), Duration::from_secs(2)).await
                {
                    tracing::error!("the switch policy did not go back: {e}");
                }
            });
        }
    }

    fn command_gripper(&self, now: Stamp, request: GripperRequest) {
        let (client, input) = (self.gripper.clone(), self.input.clone());
        self.runtime.spawn(async move {
            match client.run(request).await {
                Ok(end) => with(&input, |i| {
                    let last = i.gripper.map(|g| (g.stamp, g.knuckle));
                    let (stamp, knuckle) =
                        last.unwrap_or((now, end.knuckle.unwrap_or(request.position)));
                    i.gripper = Some(GripperFeedback {
                        stamp,
                        command: Some(request.id),
                        knuckle,
                        stalled: end.stalled,
                        reached: end.reached,
                    });
                }),
                Err(e) => tracing::error!("gripper command {}: {e}", request.id),
            }
        });
    }

    fn report(&mut self, now: Stamp, output: &ControllerOutput) {
        let s = &output.status;
        let message = ControllerStatus {
            header: tracked::header(now),
            code: s.code as u8,
            sentence: s.sentence.clone(),
            procedure: s.procedure,
            object_held: s.object_held,
            moving: s.moving,
            done: s.done,
        };
        let changed = self.last_status.as_ref().is_none_or(|(at, last)| {
            now.since(*at) >= REPEAT
                || last.code != message.code
                || last.object_held != message.object_held
                || last.done != message.done
        });
        if !changed {
            return;
        }
        if self.last_status.as_ref().is_none_or(|(_, last)| last.code != message.code) {
            tracing::info!("{:?}: {}", s.code, s.sentence);
        }
        let level = if message.code >= ControllerStatus::PAUSED { Level::Warn } else { Level::Ok };
        self.node.diagnostics().level(level, s.sentence.clone());
        self.status.publish(message.clone());
        self.last_status = Some((now, message));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_robot::motion::StatusCode;

    #[test]
    fn the_message_has_the_controllers_numbers() {
        use ControllerStatus as M;
        for (ours, theirs) in [
            (StatusCode::WaitingForJoints, M::WAITING_FOR_JOINTS),
            (StatusCode::Following, M::FOLLOWING),
            (StatusCode::Retreating, M::RETREATING),
            (StatusCode::Done, M::DONE),
            (StatusCode::Paused, M::PAUSED),
            (StatusCode::HoldStale, M::HOLD_STALE),
            (StatusCode::HoldGripper, M::HOLD_GRIPPER),
        ] {
            assert_eq!(ours as u8, theirs, "{ours:?}");
        }
    }
}
