//! Live trials: the whole graph as processes, watched from one more node, judged by the lab.

mod fault;
mod latency;
mod operator;
mod pictures;
mod replay;
mod signals;

use crate::host::StolenTime;
use crate::launch::{LaunchError, LaunchFile, Launched, NodeCommand, NodeExit, StartOptions};
use crate::names::Resolver;
use crate::node::Node;
use crate::record::{RecordError, Recorder, Recording};
use crate::{
    Arguments, DiscoveryRange, Environment, Inbox, Qos, Reason, RuntimeError, Shutdown, tracked,
};
pub use fault::{FaultFigures, FaultSetup, Trouble};
pub use replay::{ReplayOutcome, run_replay};
pub use signals::shutdown_on_signals;

use fault::{FaultWatch, Step};
use latency::StageClock;
use operator::Operator;
use pictures::PictureTaker;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use tdv_geometry::{Pose, Stamp};
use tdv_msgs::diagnostic_msgs::msg::DiagnosticArray;
use tdv_msgs::sensor_msgs::msg::{Image, JointState};
use tdv_msgs::tdv_msgs::msg::{
    ControllerStatus, PoseTrajectory, TrackedObject, TrackedObjects, TrialVerdict,
};
use tdv_msgs::trajectory_msgs::msg::JointTrajectory;
use tdv_rendering::RgbImage;

/// The nodes that may die in a trial; without the lab there is no robot.
pub const NODES: [&str; 6] = [
    "perception_bridge",
    "pose_tracker",
    "switch_policy",
    "diffusion_policy",
    "arm_controller",
    "ur5_driver",
];

/// How a trial is run.
#[derive(Debug, Clone)]
pub struct TrialSetup {
    /// Launch file of the graph.
    pub launch_file: PathBuf,
    /// What `$(find-pkg-share tdv)` stands for.
    pub share: PathBuf,
    /// Launch arguments.
    pub arguments: BTreeMap<String, String>,
    /// Where the nodes write their output.
    pub log_folder: PathBuf,
    /// ROS domain, its own for each of the trials that run close to each other.
    pub domain: u16,
    /// Seconds of the clock after which the trial is given up, start-up included.
    pub patience: f64,
    /// Keep small camera pictures of the run.
    pub pictures: bool,
    /// What is done to the graph while the arm moves.
    pub fault: Option<FaultSetup>,
    /// Shell command of a driver that is started too; the launch file's own is then left out by its
    /// argument `driver`.
    pub driver: Option<String>,
    /// Record the run into this folder, which must not exist yet.
    pub bag: Option<PathBuf>,
}

/// What a trial gave.
#[derive(Debug, Clone, Default)]
pub struct TrialOutcome {
    /// The lab's last verdict; none when it never spoke.
    pub verdict: Option<TrialVerdict>,
    /// First true poses in base_link, by object.
    pub start: BTreeMap<String, Pose>,
    /// Milliseconds by stage: `image_to_pose`, `pose_to_plan`, `plan_to_command`.
    pub latency_ms: BTreeMap<String, Vec<f64>>,
    /// CPU seconds per second of the clock, by node.
    pub cpu: BTreeMap<String, f64>,
    /// The controller's sentences, each once in a row.
    pub story: Vec<String>,
    /// Nodes that ended by themselves.
    pub exits: Vec<NodeExit>,
    /// Small camera pictures in order.
    pub pictures: Vec<RgbImage>,
    /// Seconds of the clock.
    pub wall: f64,
    /// The most CPU time that the machine's host took within a second while the graph ran, milliseconds.
    pub stolen_ms: f64,
    /// The bag of the run.
    pub bag: Option<Recording>,
    /// The true joints at 125 Hz.
    pub motion: Vec<JointState>,
    /// Predictions that came while the controller followed them, and when.
    pub predictions: Vec<(Stamp, PoseTrajectory)>,
    /// Pose of the held object in the gripper, `T_tcp_object`, by the tracker's stamps.
    pub attachments: Vec<(Stamp, Pose)>,
    /// The last figures of the driver and the robot about the command stream, by name.
    pub stream: BTreeMap<String, f64>,
    /// What the trouble did, when one was asked for and the arm moved.
    pub fault: Option<FaultFigures>,
    /// The controller said at the end that the task is done.
    pub done: bool,
    /// What the lab counted of mishaps, by name: `table_hits`, `stopped_itself`.
    pub incidents: BTreeMap<String, String>,
}

/// Why a trial could not be run at all.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// The graph cannot be started.
    #[error(transparent)]
    Launch(#[from] LaunchError),
    /// The watching node cannot be created.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The bag cannot be written.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The end was asked for before the trial was over.
    #[error("interrupted ({0}); the nodes have been stopped")]
    Interrupted(String),
}

/// The lab's verdict comes within this time after the controller is done, or the trial has failed.
const AFTER_DONE: Duration = Duration::from_secs(5);
/// So has a trial in which the arm has not moved for this time, start-up included.
const STILL: Duration = Duration::from_secs(20);
/// The same where an operator may have to help after a trouble.
const STILL_IN_TROUBLE: Duration = Duration::from_secs(40);
/// The lab's last diagnostics come within this time.
const LAST_WORDS: Duration = Duration::from_millis(1300);
/// Joint speed (rad/s) of an arm that moves.
const MOVING: f64 = 0.02;

/// Diagnostic values about the stream of commands begin so.
const STREAM: &str = "command_";

/// What the lab says of mishaps.
const INCIDENTS: [&str; 2] = ["table_hits", "stopped_itself"];

/// What a bag of a run leaves out: images at full rate, and what would only be drawn for it. The runner
/// writes its pictures instead.
const TOO_MUCH: [&str; 6] = [
    "/camera/camera/color/image_raw",
    "/camera/camera/aligned_depth_to_color/image_raw",
    "/perception_bridge/segmentation",
    "/perception_bridge/overlay",
    "/isaac/pose_estimation/image",
    "/isaac/pose_estimation/depth_image",
];

struct Watch {
    verdict: Inbox<TrialVerdict>,
    truth: Inbox<TrackedObjects>,
    joints: Inbox<JointState>,
    objects: Inbox<TrackedObjects>,
    plans: Inbox<PoseTrajectory>,
    commands: Inbox<JointTrajectory>,
    status: Inbox<ControllerStatus>,
    diagnostics: Inbox<DiagnosticArray>,
    images: Option<Inbox<Image>>,
    /// Since when the controller says that the task is done.
    done: Option<Instant>,
    /// The controller follows the predictions.
    following: bool,
    /// When the true joints last moved.
    moved: Instant,
}

impl Watch {
    fn new(node: &Node, pictures: bool) -> Result<Self, RuntimeError> {
        Ok(Self {
            verdict: node.newest("/virtual_lab/ground_truth/verdict", Qos::best_effort(5))?,
            truth: node.newest("/virtual_lab/ground_truth/objects", Qos::best_effort(5))?,
            joints: node.queue(
                "/virtual_lab/ground_truth/joint_states",
                Qos::best_effort(10),
                256,
            )?,
            objects: node.queue("/pose_tracker/objects", Qos::best_effort(5), 64)?,
            plans: node.queue("/diffusion_policy/prediction", Qos::best_effort(5), 64)?,
            commands: node.queue(
                "/scaled_joint_trajectory_controller/joint_trajectory",
                Qos::best_effort(5),
                64,
            )?,
            status: node.queue("/arm_controller/status", Qos::best_effort(5), 64)?,
            diagnostics: node.queue("/diagnostics", Qos::best_effort(10), 64)?,
            images: pictures
                .then(|| node.newest("/camera/camera/color/image_raw", Qos::sensor_data()))
                .transpose()?,
            done: None,
            following: false,
            moved: Instant::now(),
        })
    }
}

/// Runs one trial from the start of the processes to their end. Blocks; uses a tokio runtime of its own.
///
/// # Errors
/// [`TrialError`]. A trial that goes wrong is not an error: its outcome says how. One that `shutdown`
/// ends early is; its bag is finished all the same.
pub fn run_trial(setup: &TrialSetup, shutdown: &Shutdown) -> Result<TrialOutcome, TrialError> {
    block_on(watch_trial(setup, shutdown))
}

fn not_interrupted(shutdown: &Shutdown) -> Result<(), TrialError> {
    match shutdown.reason() {
        Some(Reason::Asked(why) | Reason::Failed(why)) => Err(TrialError::Interrupted(why)),
        None => Ok(()),
    }
}

fn block_on<T>(work: impl Future<Output = Result<T, TrialError>>) -> Result<T, TrialError> {
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(|e| RuntimeError::Create {
            what: "tokio runtime",
            name: "trial".into(),
            reason: e.to_string(),
        })?
        .block_on(work)
}

/// A watching node, and the processes of the graph.
fn start(setup: &TrialSetup) -> Result<(Node, Launched), TrialError> {
    let mut commands =
        LaunchFile::load(&setup.launch_file)?.commands(&setup.arguments, &setup.share)?;
    if let Some(line) = &setup.driver {
        commands.push(NodeCommand::shell("driver", line));
    }
    let environment = Environment { domain: setup.domain, range: DiscoveryRange::Localhost };
    let resolver =
        Resolver::new("trial_runner", &Arguments::default()).map_err(RuntimeError::Name)?;
    let node = Node::new(resolver, environment, false)?;
    let options = StartOptions {
        log_folder: Some(setup.log_folder.clone()),
        environment: vec![
            ("ROS_DOMAIN_ID".into(), setup.domain.to_string()),
            ("ROS_AUTOMATIC_DISCOVERY_RANGE".into(), "LOCALHOST".into()),
        ],
        ..StartOptions::beside_this_program()
    };
    Ok((node, Launched::start(&commands, options)?))
}

async fn watch_trial(setup: &TrialSetup, shutdown: &Shutdown) -> Result<TrialOutcome, TrialError> {
    not_interrupted(shutdown)?;
    let (node, mut launched) = start(setup)?;
    let mut watch = Watch::new(&node, setup.pictures || setup.bag.is_some())?;
    let began = Instant::now();
    let mut outcome = TrialOutcome::default();
    let mut stolen = StolenTime::start();
    let mut stages = StageClock::default();
    let mut taker = PictureTaker::default();
    let mut recorder = match &setup.bag {
        Some(folder) => Some(Recorder::create(&node, folder, None)?.without(&TOO_MUCH)),
        None => None,
    };
    let mut looked: Option<Instant> = None;
    let mut fault = setup.fault.clone().map(FaultWatch::new);
    let operator = fault.is_some().then(|| Operator::new(&node)).transpose()?;
    let still = if fault.is_some() { STILL_IN_TROUBLE } else { STILL };
    let mut ended: Option<Instant> = None;
    loop {
        tokio::time::sleep(Duration::from_millis(2)).await;
        collect(&node, &mut watch, &mut outcome, &mut stages, &mut taker, &mut fault);
        stolen.look();
        if let Some(recorder) = &mut recorder {
            if looked.is_none_or(|t| t.elapsed() > Duration::from_millis(500)) {
                looked = Some(Instant::now());
                recorder.look()?;
            }
            taker.hand_over(recorder)?;
            recorder.drain()?;
        }
        let exits = launched.exited();
        let died = !exits.is_empty();
        outcome.exits.extend(exits);
        if let (Some(fault), Some(operator)) = (&mut fault, &operator) {
            let step = fault.step(node.now());
            make_trouble(step, fault.trouble(), operator, &mut launched, &mut outcome.story)?;
            outcome.story.extend(operator.notes());
        }
        // The robot has done all that it will do: the judge has had its time.
        let idle =
            watch.done.is_some_and(|t| t.elapsed() > AFTER_DONE) || watch.moved.elapsed() > still;
        let finished = idle || outcome.verdict.as_ref().is_some_and(|v| v.finished);
        let late = began.elapsed().as_secs_f64() > setup.patience;
        if finished {
            ended.get_or_insert_with(Instant::now);
        }
        // The lab counts its mishaps once a second.
        let over = ended.is_some_and(|t| fault.is_none() || t.elapsed() > LAST_WORDS);
        if over || died || late || shutdown.is_requested() {
            break;
        }
    }
    // Once more: the verdict that ended it may have come with a picture worth keeping.
    collect(&node, &mut watch, &mut outcome, &mut stages, &mut taker, &mut fault);
    outcome.wall = began.elapsed().as_secs_f64();
    outcome.stolen_ms = stolen.worst_ms();
    launched.stop(Duration::from_secs(3));
    if let Some(recorder) = recorder {
        outcome.bag = Some(recorder.finish()?);
    }
    outcome.done = watch.done.is_some();
    outcome.fault = fault.and_then(|f| f.figures());
    outcome.latency_ms = stages.into_samples();
    outcome.pictures = taker.into_pictures();
    node.leave();
    // Nodes that the same Ctrl-C ended do not make this a failed trial.
    not_interrupted(shutdown)?;
    Ok(outcome)
}

/// Does to the graph what is due.
fn make_trouble(
    step: Step,
    trouble: &Trouble,
    operator: &Operator,
    launched: &mut Launched,
    story: &mut Vec<String>,
) -> Result<(), TrialError> {
    match (step, trouble) {
        (Step::Wait, _) => {}
        (Step::Begin, Trouble::Kill(name)) => {
            launched.kill(name);
            story.push(format!("{name} was killed"));
        }
        (Step::End, Trouble::Kill(name)) => {
            launched.restart(name)?;
            story.push(format!("{name} was started again"));
        }
        (Step::Begin, _) => operator.act(trouble, true),
        (Step::End, _) => operator.act(trouble, false),
        (Step::Help(time), _) => {
            story.push("the arm stands: the operator helps".into());
            operator.help(time);
        }
    }
    Ok(())
}

/// Adds a sentence unless one of the last two says the same with other numbers.
fn tell(story: &mut Vec<String>, sentence: String) {
    let words = |s: &str| s.chars().filter(|c| !c.is_ascii_digit()).collect::<String>();
    if story.iter().rev().take(2).all(|s| words(s) != words(&sentence)) {
        story.push(sentence);
    }
}

fn collect(
    node: &Node,
    watch: &mut Watch,
    outcome: &mut TrialOutcome,
    stages: &mut StageClock,
    taker: &mut PictureTaker,
    fault: &mut Option<FaultWatch>,
) {
    let now = Instant::now();
    let clock = node.now();
    if let Some(v) = watch.verdict.try_newest() {
        outcome.verdict = Some(v);
    }
    if let Some(truth) = watch.truth.try_newest()
        && outcome.start.is_empty()
    {
        for o in &truth.objects {
            if let Some(pose) = tracked::usable_pose(&truth, &o.name) {
                outcome.start.insert(o.name.clone(), pose);
            }
        }
    }
    while let Some(m) = watch.joints.try_recv() {
        if m.velocity.iter().any(|v| v.abs() > MOVING) {
            watch.moved = now;
        }
        if let Some(fault) = fault {
            fault.joints(&m, tracked::stamp(&m.header));
        }
        outcome.motion.push(m);
    }
    while let Some(m) = watch.objects.try_recv() {
        let stamp = tracked::stamp(&m.header);
        stages.pose(stamp, now);
        let held = m.objects.iter().find(|o| o.state == TrackedObject::HELD);
        if let Some(object) = held.and_then(|o| tracked::pose(&o.pose.pose).ok())
            && let Some(tcp) = tracked::usable_pose(&m, "tcp")
        {
            outcome.attachments.push((stamp, tcp.inverse() * object));
        }
    }
    while let Some(m) = watch.plans.try_recv() {
        if !m.poses.is_empty() {
            stages.plan(tracked::stamp(&m.header), now);
            if watch.following {
                outcome.predictions.push((clock, m));
            }
        }
    }
    while watch.commands.try_recv().is_some() {
        stages.command(now);
    }
    while let Some(m) = watch.status.try_recv() {
        watch.done = if m.done { watch.done.or(Some(now)) } else { None };
        watch.following = m.code == ControllerStatus::FOLLOWING;
        if let Some(fault) = fault {
            fault.status(m.object_held, m.done);
            fault.sentence("arm_controller", &m.sentence);
        }
        tell(&mut outcome.story, m.sentence);
    }
    while let Some(m) = watch.diagnostics.try_recv() {
        for s in m.status {
            if let Some(fault) = fault {
                fault.sentence(s.name.trim_start_matches('/'), &s.message);
            }
            let value = s.values.iter().find(|v| v.key == "cpu_percent");
            if let Some(percent) = value.and_then(|v| v.value.parse::<f64>().ok()) {
                outcome.cpu.insert(s.name.clone(), percent / 100.0);
            }
            for v in &s.values {
                if INCIDENTS.contains(&v.key.as_str()) {
                    outcome.incidents.insert(v.key.clone(), v.value.clone());
                } else if v.key.starts_with(STREAM)
                    && let Ok(value) = v.value.parse()
                {
                    outcome.stream.insert(v.key.clone(), value);
                }
            }
        }
    }
    if let Some(images) = &mut watch.images
        && let Some(image) = images.try_newest()
    {
        taker.take(&image, now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_story_does_not_repeat_itself_over_numbers() {
        let mut story = Vec::new();
        for s in [
            "plan 80 ms old",
            "late 151 ms",
            "plan 90 ms old",
            "late 152 ms",
            "gripper",
            "plan 3 ms old",
        ] {
            tell(&mut story, s.to_owned());
        }
        assert_eq!(story, ["plan 80 ms old", "late 151 ms", "gripper", "plan 3 ms old"]);
    }
}
