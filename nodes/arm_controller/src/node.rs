use crate::inputs;
use crate::params::ArmParameters;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tdv_geometry::Stamp;
use tdv_msgs::control_msgs::action::{GripperCommand, GripperCommandGoal};
use tdv_msgs::sensor_msgs::msg::JointState;
use tdv_msgs::std_msgs::msg::{Bool, Float64};
use tdv_msgs::std_srvs::srv::{Trigger, TriggerRequest, TriggerResponse};
use tdv_msgs::tdv_msgs::msg::{ControllerStatus, PoseTrajectory, Procedure, TrackedObjects};
use tdv_msgs::trajectory_msgs::msg::JointTrajectory;
use tdv_robot::motion::{GripperFeedback, GripperRequest, ProcedureState, Requests};
use tdv_robot::{ArmController, ControllerInput, ControllerOutput, Kinematics, Limits};
use tdv_runtime::{ActionClient, Level, Node, Params, Publisher, Qos, ServiceClient, tracked};
use tokio::runtime::Handle;

/// The status goes out at least this often.
const REPEAT: f64 = 0.1;
const ACTION_PATIENCE: Duration = Duration::from_secs(8);

type SharedInput = Arc<Mutex<ControllerInput>>;

struct Loop {
    node: Node,
    core: ArmController,
    input: SharedInput,
    runtime: Handle,
    trajectory: Publisher<JointTrajectory>,
    status: Publisher<ControllerStatus>,
    gripper: ActionClient<GripperCommand>,
    switch_reset: ServiceClient<Trigger>,
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
    let input: SharedInput = Arc::new(Mutex::new(ControllerInput {
        enable: !p.require_program,
        ..ControllerInput::default()
    }));
    subscribe_robot(&node, &p, &input)?;
    subscribe_task(&node, &p, &input)?;
    serve_requests(&node, &input)?;
    let tick = Duration::from_secs_f64(p.control.tick);
    let control = Loop {
        core,
        input,
        runtime: Handle::current(),
        trajectory: node.publisher(
            &format!("/{}/joint_trajectory", p.trajectory_controller),
            Qos::reliable(1),
        )?,
        status: node.publisher("/arm_controller/status", Qos::latched())?,
        gripper: node.action_client(&format!("/{}/gripper_cmd", p.gripper_controller))?,
        switch_reset: node.client("/switch_policy/reset")?,
        last_status: None,
        last_plan: None,
        node: node.clone(),
    };
    tokio::task::spawn_blocking(move || control.run(tick)).await?;
    Ok(())
}

fn subscribe_robot(node: &Node, p: &ArmParameters, input: &SharedInput) -> anyhow::Result<()> {
    let shared = input.clone();
    node.subscribe("/joint_states", Qos::best_effort(10), move |m: JointState| {
        with(&shared, |i| {
            if let Some(joints) = inputs::arm_joints(&m) {
                i.joints = Some(joints);
            }
            if let Some(knuckle) = inputs::knuckle(&m) {
                let old = i.gripper.unwrap_or(GripperFeedback {
                    command: None,
                    knuckle,
                    stalled: false,
                    reached: false,
                });
                i.gripper = Some(GripperFeedback { knuckle, ..old });
            }
        });
    })?;
    if p.require_program {
        let shared = input.clone();
        let topic = "/io_and_status_controller/robot_program_running";
        node.subscribe(topic, Qos::latched(), move |m: Bool| with(&shared, |i| i.enable = m.data))?;
    }
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
    node.subscribe("/diffusion_policy/prediction", Qos::best_effort(2), {
        move |m: PoseTrajectory| match inputs::plan(&m, &offset) {
            Ok(Some(plan)) => with(&shared, |i| i.plan = Some(plan)),
            Ok(None) => {}
            Err(why) => tracing::warn!("prediction refused: {why}"),
        }
    })?;
    let shared = input.clone();
    node.subscribe("/switch_policy/procedure", Qos::best_effort(5), move |m: Procedure| {
        let stamp = tracked::stamp(&m.header);
        let state = ProcedureState { stamp, procedure: m.procedure, complete: m.complete };
        with(&shared, |i| i.procedure = Some(state));
    })?;
    let shared = input.clone();
    node.subscribe("/pose_tracker/objects", Qos::best_effort(5), move |m: TrackedObjects| {
        with(&shared, |i| i.attach = inputs::attach(&m));
    })?;
    Ok(())
}

fn serve_requests(node: &Node, input: &SharedInput) -> anyhow::Result<()> {
    let requests: [(&str, fn(&mut Requests)); 5] = [
        ("pause", |r| r.pause = true),
        ("resume", |r| r.resume = true),
        ("reset", |r| r.reset = true),
        ("home", |r| r.home = true),
        ("abort", |r| r.abort = true),
    ];
    for (name, set) in requests {
        let shared = input.clone();
        node.service::<Trigger, _, _>(&format!("~/{name}"), move |_request| {
            with(&shared, |i| set(&mut i.requests));
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
            let taken = i.clone();
            i.requests = Requests::default();
            taken
        });
        let output = self.core.step(now, &input);
        self.act(now, &input, &output);
        self.report(now, &output);
    }

    fn act(&mut self, now: Stamp, input: &ControllerInput, output: &ControllerOutput) {
        if let Some(path) = &output.trajectory {
            self.trajectory.publish(inputs::trajectory(path));
            if let Some(plan) = &input.plan
                && self.last_plan != Some(plan.stamp)
            {
                self.last_plan = Some(plan.stamp);
                self.node.diagnostics().latency("image_to_command", now.since(plan.stamp));
            }
        }
        if let Some(request) = output.gripper {
            self.command_gripper(request);
        }
        if output.reset_switch {
            let client = self.switch_reset.clone();
            self.runtime.spawn(async move {
                if let Err(e) = client.call(TriggerRequest::default(), Duration::from_secs(2)).await
                {
                    tracing::error!("the switch policy was not reset: {e}");
                }
            });
        }
    }

    fn command_gripper(&self, request: GripperRequest) {
        let (client, input) = (self.gripper.clone(), self.input.clone());
        self.runtime.spawn(async move {
            let mut goal = GripperCommandGoal::default();
            goal.command.position = request.position;
            goal.command.max_effort = request.max_effort;
            match client.run(goal, ACTION_PATIENCE).await {
                Ok((_, result)) => with(&input, |i| {
                    let knuckle = i.gripper.map_or(result.position, |g| g.knuckle);
                    i.gripper = Some(GripperFeedback {
                        command: Some(request.id),
                        knuckle,
                        stalled: result.stalled,
                        reached: result.reached_goal,
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
        let level = if message.code >= 12 { Level::Warn } else { Level::Ok };
        self.node.diagnostics().level(level, s.sentence.clone());
        self.status.publish(message.clone());
        self.last_status = Some((now, message));
    }
}
