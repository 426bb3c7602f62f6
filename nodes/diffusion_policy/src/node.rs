use crate::params::PolicyParameters;
use anyhow::Context as _;
use std::path::Path;
use std::time::Duration;
use tdv_demonstration::{Demonstration, Task};
use tdv_geometry::{Pose, Stamp};
use tdv_msgs::geometry_msgs::msg::PoseStamped;
use tdv_msgs::nav_msgs::msg::Path as PathMessage;
use tdv_msgs::tdv_msgs::msg::{PoseTrajectory, Procedure, TrackedObjects};
use tdv_policy::{
    HistoryConfig, Observation, Observer, OpenLoop, Planner, PlannerConfig, TrainedPolicy,
};
use tdv_runtime::{Inbox, Level, Node, Params, Publisher, Qos, tracked};

/// Waits this long for a message before looking whether the node is to end.
const PATIENCE: Duration = Duration::from_millis(200);

struct Work {
    node: Node,
    seed: u64,
    planner: Planner,
    /// The control experiment that plays instead of planning.
    open_loop: Option<OpenLoop>,
    observer: Observer,
    objects: Inbox<TrackedObjects>,
    procedure: Inbox<Procedure>,
    prediction: Publisher<PoseTrajectory>,
    path: Publisher<PathMessage>,
}

/// The node's life.
pub async fn predict(node: Node, params: Params<PolicyParameters>) -> anyhow::Result<()> {
    let p = params.get();
    let folder = Path::new(&p.model);
    let demonstration = Demonstration::load(&folder.join("demonstration.json"))
        .context("`tdv teach` writes the model folder")?;
    let names: Vec<&str> = demonstration.procedures.iter().map(|d| d.name.as_str()).collect();
    let mut policy =
        TrainedPolicy::load_for(&folder.join("policy.safetensors"), &demonstration.task, &names)?;
    if p.untrained {
        policy = policy.with_random_weights(p.seed as u64);
    }
    let config =
        PlannerConfig { inference_steps: Some(p.inference_steps as usize), ..Default::default() };
    let planner = Planner::new(&policy, config)?;
    let history =
        HistoryConfig { length: planner.history_len(), dt: planner.dt(), max_gap: p.max_gap };
    let open_loop = if p.open_loop {
        let task = Task::load(Path::new(&p.task))?;
        Some(OpenLoop::new(demonstration.clone(), task, planner.horizon()))
    } else {
        None
    };
    let work = Work {
        seed: p.seed as u64,
        planner,
        open_loop,
        observer: Observer::new(&demonstration, history)?,
        objects: node.newest("/pose_tracker/objects", Qos::best_effort(5))?,
        procedure: node.newest("/switch_policy/procedure", Qos::best_effort(5))?,
        prediction: node.publisher("/diffusion_policy/prediction", Qos::reliable(2))?,
        path: node.publisher("/diffusion_policy/path", Qos::reliable(2))?,
        node: node.clone(),
    };
    node.diagnostics().level(Level::Ok, "waiting for the pose tracker");
    // Inference is computation: it gets a thread of its own.
    tokio::task::spawn_blocking(move || work.run()).await.context("the inference thread")?;
    Ok(())
}

impl Work {
    fn run(mut self) {
        let mut current: Option<Procedure> = None;
        while !self.node.shutdown().is_requested() {
            let Some(objects) = self.objects.recv_timeout(PATIENCE) else {
                if self.objects.is_closed() {
                    return;
                }
                continue;
            };
            if let Some(newest) = self.procedure.try_newest() {
                if current.as_ref().is_some_and(|c| c.procedure > newest.procedure) {
                    // The task went back, for example after a failed grasp.
                    self.observer.reset();
                }
                current = Some(newest);
            }
            self.answer(&objects, current.as_ref().map_or(0, |c| c.procedure as usize));
        }
    }

    /// Every observation gets an answer; it has no poses when there is nothing to plan from, so that a
    /// lockstep replay can go on and the controller sees why.
    fn answer(&mut self, objects: &TrackedObjects, procedure: usize) {
        let mut message = PoseTrajectory {
            header: objects.header.clone(),
            procedure: procedure as u32,
            dt: self.planner.dt(),
            ..Default::default()
        };
        if let Some((_, moving, reference)) = self.observer.names(procedure) {
            message.moving = moving.into();
            message.reference = reference.into();
        }
        let stamp = tracked::stamp(&objects.header);
        let began = std::time::Instant::now();
        let planned = self.plan(stamp, objects, procedure);
        let diagnostics = self.node.diagnostics();
        match planned {
            Ok((poses, observation)) => {
                message.reference_pose = tracked::pose_message(&observation.reference_pose);
                message.moving_pose = tracked::pose_message(&observation.moving_pose);
                message.poses = poses.iter().map(tracked::pose_message).collect();
                diagnostics.level(Level::Ok, format!("planning procedure {procedure}"));
                diagnostics.latency("plan", began.elapsed().as_secs_f64());
                diagnostics.latency("image_to_plan", self.node.now().since(stamp));
                self.path.publish(PathMessage {
                    header: objects.header.clone(),
                    poses: poses
                        .iter()
                        .map(|p| PoseStamped {
                            header: objects.header.clone(),
                            pose: tracked::pose_message(&(observation.reference_pose * p)),
                        })
                        .collect(),
                });
            }
            Err(error) => diagnostics.level(Level::Warn, format!("no plan: {error}")),
        }
        self.prediction.publish(message);
    }

    /// The poses `T_reference_moving` that shall follow, and what they were made from.
    fn plan(
        &mut self,
        stamp: Stamp,
        objects: &TrackedObjects,
        procedure: usize,
    ) -> anyhow::Result<(Vec<Pose>, Observation)> {
        let pose_of = |name: &str| tracked::usable_pose(objects, name);
        if let Some(control) = &mut self.open_loop {
            control.look(pose_of)?;
            let believed = |name: &str| control.believed(procedure, name, pose_of(name));
            let seen = self.observer.observe(stamp, procedure, believed)?;
            return Ok((seen.undo(&control.plan(&seen)?), seen));
        }
        let seen = self.observer.observe(stamp, procedure, pose_of)?;
        let plan = self.planner.plan(procedure, &seen.history, self.seed)?;
        Ok((seen.undo(&plan), seen))
    }
}
