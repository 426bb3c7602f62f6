//! One of everything, for checks against other ROS 2 implementations (tests/peers): topics of several
//! kinds, an image pair at 30 Hz, services, an action server, and on request a client of each.

use serde::{Deserialize, Serialize};
use std::process::ExitCode;
use std::time::Duration;
use tdv_geometry::pose_from_xyz_rpy;
use tdv_msgs::control_msgs::action::{
    GripperCommand, GripperCommandFeedback, GripperCommandGoal, GripperCommandResult,
};
use tdv_msgs::rosgraph_msgs::msg::Clock as ClockMessage;
use tdv_msgs::sensor_msgs::msg::JointState;
use tdv_msgs::std_msgs::msg::String as Text;
use tdv_msgs::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse, Trigger, TriggerResponse};
use tdv_msgs::tdv_msgs::msg::PoseTrajectory;
use tdv_msgs::tf2_msgs::msg::TFMessage;
use tdv_msgs::vision_msgs::msg::{Detection3D, Detection3DArray};
use tdv_rendering::{DepthImage, RgbImage};
use tdv_runtime::{Goal, GoalEnd, Level, Node, Parameters, Params, Qos, convert, tracked};

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct PeerParameters {
    speed: f64,
    label: String,
    gains: Vec<f64>,
    limits: Limits,
    images: bool,
    publish_clock: bool,
    call: bool,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Limits {
    count: i64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { count: 3 }
    }
}

impl Default for PeerParameters {
    fn default() -> Self {
        Self {
            speed: 0.2,
            label: "peer".into(),
            gains: vec![1.0, 2.0],
            limits: Limits::default(),
            images: false,
            publish_clock: false,
            call: false,
        }
    }
}

impl Parameters for PeerParameters {
    fn validate(&self) -> Vec<String> {
        let fast = self.speed > 0.25;
        if fast { vec![format!("'speed' must be at most 0.25, is {}", self.speed)] } else { vec![] }
    }
    fn live() -> &'static [&'static str] {
        &["speed", "gains"]
    }
    fn describe(name: &str) -> &'static str {
        if name == "speed" { "of the tool, m/s" } else { "" }
    }
}

async fn body(node: Node, params: Params<PeerParameters>) -> anyhow::Result<()> {
    let latched = node.publisher::<Text>("~/latched", Qos::latched())?;
    latched.publish(Text { data: params.get().label.clone() });
    let tf_static = node.publisher::<TFMessage>("/tf_static", Qos::latched())?;
    let pose = pose_from_xyz_rpy([0.95, 0.0, 0.7], [0.0, 0.0, 1.0]);
    tf_static.publish(TFMessage {
        transforms: vec![tracked::transform("base_link", "camera", node.now(), &pose)],
    });

    let echo = node.publisher::<Text>("~/echo", Qos::reliable(32))?;
    node.subscribe("~/chatter", Qos::reliable(32), move |m: Text| {
        echo.publish(Text { data: format!("heard {}", m.data) });
    })?;
    let heard_latched = node.publisher::<Text>("~/heard_latched", Qos::latched())?;
    node.subscribe("/peer_latched", Qos::latched(), move |m: Text| {
        heard_latched.publish(m);
    })?;

    node.service::<Trigger, _, _>("~/greet", |_| async {
        TriggerResponse { success: true, message: "hello".into() }
    })?;
    node.action_server::<GripperCommand, _, _, _>("~/gripper_cmd", accept, grip)?;
    node.diagnostics().level(Level::Ok, "all there");

    if params.get().call {
        let n = node.clone();
        node.spawn("caller", async move {
            if let Err(error) = call_peer(&n).await {
                n.shutdown().fail(format!("{error:#}"));
            }
        });
    }
    if params.get().images {
        start_images(&node)?;
    }
    publish_state(&node, &params).await
}

fn accept(goal: &GripperCommandGoal) -> Result<(), String> {
    let position = goal.command.position;
    if (0.0..=0.8).contains(&position) { Ok(()) } else { Err(format!("position {position}")) }
}

/// Closes in 10 steps of 50 ms.
async fn grip(mut goal: Goal<GripperCommand>) -> (GoalEnd, GripperCommandResult) {
    let target = goal.goal.command.position;
    let mut position = 0.0;
    for step in 1..=10 {
        tokio::select! {
            () = goal.canceled() => {
                return (GoalEnd::Canceled, GripperCommandResult { position, ..Default::default() });
            }
            () = tokio::time::sleep(Duration::from_millis(50)) => {}
        }
        position = target * f64::from(step) / 10.0;
        goal.feedback(GripperCommandFeedback { position, ..Default::default() });
    }
    let reached_goal = true;
    (GoalEnd::Succeeded, GripperCommandResult { position, reached_goal, ..Default::default() })
}

/// Calls the other side's service and action, and reports on a topic.
async fn call_peer(node: &Node) -> anyhow::Result<()> {
    let report = node.publisher::<Text>("~/report", Qos::latched_depth(5))?;
    let patience = Duration::from_secs(20);
    let set = node.client::<SetBool>("/python/set")?;
    let SetBoolResponse { success, message } =
        set.call(SetBoolRequest { data: true }, patience).await?;
    let gripper = node.action_client::<GripperCommand>("/python/gripper_cmd")?;
    let mut goal = GripperCommandGoal::default();
    goal.command.position = 0.4;
    let ticket = gripper.send(goal, patience).await?;
    let (end, result) = gripper.result(ticket, patience).await?;
    let feedback = gripper.feedback(ticket).map(|f| f.position);
    report.publish(Text {
        data: format!("{success} {message} {end:?} {:.2} {feedback:?}", result.position),
    });
    node.shutdown().wait().await;
    Ok(())
}

async fn publish_state(node: &Node, params: &Params<PeerParameters>) -> anyhow::Result<()> {
    let joints = node.publisher::<JointState>("/joint_states", Qos::reliable(10))?;
    let plan = node.publisher::<PoseTrajectory>("~/plan", Qos::reliable(2))?;
    let detections = node.publisher::<Detection3DArray>("~/detections", Qos::reliable(5))?;
    let clock = match params.get().publish_clock {
        true => Some(node.publisher::<ClockMessage>("/clock", Qos::reliable(1))?),
        false => None,
    };
    let mut ticks = tokio::time::interval(Duration::from_millis(8));
    for count in 0_u32.. {
        tokio::select! {
            _ = ticks.tick() => {}
            _ = node.shutdown().wait() => return Ok(()),
        }
        let header = convert::header(node.now(), "base_link");
        joints.publish(JointState {
            header: header.clone(),
            name: vec!["shoulder_pan_joint".into()],
            position: vec![f64::from(count)],
            ..Default::default()
        });
        if count % 4 == 0 {
            plan.publish(PoseTrajectory {
                header: header.clone(),
                moving: "mug".into(),
                procedure: 1,
                dt: 0.05,
                poses: vec![Default::default(); 16],
                ..Default::default()
            });
            let found = Detection3D { id: "mug".into(), ..Default::default() };
            detections.publish(Detection3DArray { header, detections: vec![found] });
        }
        if let Some(clock) = &clock {
            let time = convert::time_from_stamp(tdv_geometry::Stamp(i64::from(count) * 8_000_000));
            clock.publish(ClockMessage { clock: time });
        }
    }
    Ok(())
}

fn start_images(node: &Node) -> anyhow::Result<()> {
    let color = node.publisher("/camera/color/image_raw", Qos::reliable(2))?;
    let depth = node.publisher("/camera/depth/image_raw", Qos::reliable(2))?;
    let n = node.clone();
    node.spawn("images", async move {
        let picture = RgbImage::from_fn(640, 480, |x, y| [x as u8, y as u8, 7].into());
        let distances = DepthImage {
            width: 640,
            height: 480,
            data: (0..640 * 480).map(|i| (i % 4000) as f32 / 1000.0).collect(),
        };
        let mut ticks = tokio::time::interval(Duration::from_micros(33_333));
        loop {
            ticks.tick().await;
            let header = convert::header(n.now(), "camera_color_optical_frame");
            color.publish(convert::image_from_color(&picture, header.clone()));
            depth.publish(convert::image_from_depth(&distances, header));
        }
    });
    Ok(())
}

fn main() -> ExitCode {
    tdv_runtime::run("peer", body)
}
