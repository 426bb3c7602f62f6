use crate::messages;
use crate::params::TrackerParameters;
use anyhow::Context as _;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use tdv_demonstration::Task;
use tdv_geometry::{FrameError, FrameTree};
use tdv_msgs::geometry_msgs::msg::{PoseStamped, TransformStamped};
use tdv_msgs::std_srvs::srv::{Trigger, TriggerResponse};
use tdv_msgs::tdv_msgs::msg::{ControllerStatus, Procedure, TrackedObjects};
use tdv_msgs::tf2_msgs::msg::TFMessage;
use tdv_msgs::vision_msgs::msg::Detection3DArray;
use tdv_perception::objects::{ObjectSpec, Objects, ObjectsInput, ObjectsOutput, TaskObjects};
use tdv_rendering::object::ObjectFile;
use tdv_robot::{base_link_to_base, default_tool};
use tdv_runtime::{Level, Node, Params, Publisher, Qos, tracked};

struct State {
    objects: Objects,
    frames: FrameTree,
    held: bool,
}

impl State {
    /// Which object the gripper holds, once it holds something. The name stays until something else is
    /// gripped: the next procedure begins before the fingers have opened.
    fn procedure(&mut self, m: &Procedure) {
        if m.grip {
            self.objects.set_moving(&m.held);
        }
    }
}

struct Outputs {
    node: Node,
    objects: Publisher<TrackedObjects>,
    tf: Publisher<TFMessage>,
    reference: String,
    camera_frame: String,
}

/// The task's objects, or without a task those of the parameter.
fn objects_of(p: &TrackerParameters) -> anyhow::Result<TaskObjects> {
    let (mut names, mut moving) = (p.objects.clone(), String::new());
    if !p.task.is_empty() {
        let task = Task::load(Path::new(&p.task))?;
        names = task.object_names();
        moving = task.moving_object;
    }
    let folder = Path::new(&p.objects_dir);
    let reference = names.first().cloned().unwrap_or_default();
    let objects = names
        .into_iter()
        .map(|name| {
            let file = ObjectFile::load(&folder.join(&name))?;
            Ok(ObjectSpec { name, symmetry: file.symmetry })
        })
        .collect::<anyhow::Result<_>>()?;
    Ok(TaskObjects { objects, reference, moving })
}

/// The node's life.
pub async fn track(node: Node, params: Params<TrackerParameters>) -> anyhow::Result<()> {
    let p = params.get();
    let objects = objects_of(&p).context("the objects to track")?;
    let outputs = Outputs {
        objects: node.publisher("/pose_tracker/objects", Qos::reliable(5))?,
        tf: node.publisher("/tf", Qos::reliable(100))?,
        reference: objects.reference.clone(),
        camera_frame: p.camera_frame.clone(),
        node: node.clone(),
    };
    let state = Arc::new(Mutex::new(State {
        objects: Objects::new(p.tracking.clone(), objects),
        frames: FrameTree::default(),
        held: false,
    }));
    node.diagnostics().level(Level::Warn, format!("no transform to {} yet", p.camera_frame));
    subscribe_inputs(&node, &state)?;
    let shared = state.clone();
    node.service::<Trigger, _, _>("~/reset", move |_request| {
        with(&shared, |s| s.objects.reset(""));
        async { TriggerResponse { success: true, message: "all objects forgotten".into() } }
    })?;
    node.subscribe("/perception_bridge/detections", Qos::best_effort(5), {
        move |message: Detection3DArray| outputs.answer(&message, &state)
    })?;
    node.shutdown().wait().await;
    Ok(())
}

fn with<T>(state: &Mutex<State>, f: impl FnOnce(&mut State) -> T) -> T {
    // Poses in it stay whole even if a task died while it had the lock.
    f(&mut state.lock().unwrap_or_else(PoisonError::into_inner))
}

fn learn(frames: &mut FrameTree, t: &TransformStamped, fixed: bool) -> anyhow::Result<()> {
    let (parent, child) = (&t.header.frame_id, &t.child_frame_id);
    let pose = tracked::transform_pose(t).with_context(|| child.clone())?;
    if fixed {
        frames.fix(parent, child, pose)?;
    } else {
        frames.place(parent, child, tracked::stamp(&t.header), pose)?;
    }
    Ok(())
}

fn subscribe_inputs(node: &Node, state: &Arc<Mutex<State>>) -> anyhow::Result<()> {
    for (topic, qos) in [("/tf_static", Qos::latched_depth(10)), ("/tf", Qos::reliable(100))] {
        let (shared, fixed) = (state.clone(), topic == "/tf_static");
        let diagnostics = node.diagnostics().clone();
        node.subscribe(topic, qos, move |message: TFMessage| {
            for t in &message.transforms {
                if let Err(why) = with(&shared, |s| learn(&mut s.frames, t, fixed)) {
                    diagnostics.level(Level::Error, format!("{topic}: {why}"));
                }
            }
        })?;
    }
    let shared = state.clone();
    node.subscribe("/tcp_pose_broadcaster/pose", Qos::best_effort(10), move |m: PoseStamped| {
        if let Ok(pose) = tracked::pose(&m.pose) {
            let tcp = base_link_to_base() * pose * default_tool();
            with(&shared, |s| s.objects.push_tcp(tracked::stamp(&m.header), tcp));
        }
    })?;
    let shared = state.clone();
    node.subscribe("/arm_controller/status", Qos::best_effort(5), move |m: ControllerStatus| {
        with(&shared, |s| s.held = m.object_held);
    })?;
    let shared = state.clone();
    node.subscribe("/switch_policy/procedure", Qos::best_effort(5), move |m: Procedure| {
        with(&shared, |s| s.procedure(&m));
    })?;
    Ok(())
}

impl Outputs {
    fn answer(&self, message: &Detection3DArray, state: &Mutex<State>) {
        let (detections, table, problems) = messages::detections(message);
        let diagnostics = self.node.diagnostics();
        if let Some(problem) = problems.first() {
            tracing::warn!("detections: {problem}");
        }
        if message.header.frame_id != self.camera_frame {
            let frame = &message.header.frame_id;
            diagnostics.level(
                Level::Error,
                format!("detections come in frame {frame:?}, expected {:?}", self.camera_frame),
            );
            return;
        }
        let stamp = tracked::stamp(&message.header);
        let output = with(state, |s| {
            let t_base_camera = s.frames.lookup("base_link", &self.camera_frame, stamp)?;
            Ok::<_, FrameError>(s.objects.step(&ObjectsInput {
                stamp,
                detections: &detections,
                table,
                t_base_camera,
                object_held: s.held,
            }))
        });
        let output = match output {
            Ok(output) => output,
            Err(why) => {
                return diagnostics.level(Level::Warn, format!("where is the camera? {why}"));
            }
        };
        self.objects.publish(messages::tracked_objects(&output, &self.reference));
        self.publish_frames(&output);
        diagnostics.latency("image_to_pose", self.node.now().since(stamp));
        self.report(&output);
    }

    fn publish_frames(&self, output: &ObjectsOutput) {
        let transforms = output
            .objects
            .iter()
            .filter_map(|o| Some(tracked::transform("base_link", &o.name, output.stamp, &o.pose?)))
            .collect();
        self.tf.publish(TFMessage { transforms });
    }

    fn report(&self, output: &ObjectsOutput) {
        let sentence: Vec<String> = output
            .objects
            .iter()
            .map(|o| {
                let note = if o.note.is_empty() { String::new() } else { format!(" ({})", o.note) };
                format!("{} {:?}{note}", o.name, o.state)
            })
            .collect();
        let all = output.objects.iter().all(|o| o.pose.is_some());
        let level = if all { Level::Ok } else { Level::Warn };
        self.node.diagnostics().level(level, sentence.join(", "));
    }
}
