use crate::params::SwitchParameters;
use anyhow::Context as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tdv_demonstration::{Demonstration, GripperEnd, Hold};
use tdv_geometry::Stamp;
use tdv_msgs::std_srvs::srv::{Trigger, TriggerResponse};
use tdv_msgs::tdv_msgs::msg::{ControllerStatus, Procedure, TrackedObjects};
use tdv_policy::{
    HistoryConfig, Observer, SwitchConfig, SwitchCore, SwitchGuard, SwitchPolicy, SwitchState,
};
use tdv_runtime::{Level, Node, Params, Publisher, Qos, tracked};

/// The state goes out at least this often, besides on every change.
const REPEAT: Duration = Duration::from_secs(1);

struct Decision {
    node: Node,
    policy: SwitchPolicy,
    core: SwitchCore,
    observer: Observer,
    demonstration: Demonstration,
    holds: Vec<Hold>,
    output: Publisher<Procedure>,
}

fn settings(p: &SwitchParameters, policy: &SwitchPolicy) -> SwitchConfig {
    SwitchConfig {
        threshold: p.threshold as f32,
        consecutive: p.consecutive as usize,
        guard: Some(SwitchGuard {
            end_poses: policy.end_poses.clone(),
            position: p.guard_position,
            rotation: p.guard_rotation,
        }),
        timeout: Some(p.timeout),
    }
}

/// The node's life.
pub async fn decide(node: Node, mut params: Params<SwitchParameters>) -> anyhow::Result<()> {
    let p = params.get();
    let folder = Path::new(&p.model);
    let demonstration = Demonstration::load(&folder.join("demonstration.json"))
        .context("`tdv teach` writes the model folder")?;
    let names: Vec<&str> = demonstration.procedures.iter().map(|d| d.name.as_str()).collect();
    let policy =
        SwitchPolicy::load_for(&folder.join("switch.safetensors"), &demonstration.task, &names)?;
    let history = HistoryConfig { length: policy.history_len(), dt: policy.dt, max_gap: p.max_gap };
    let mut decision = Decision {
        core: SwitchCore::new(names.len(), settings(&p, &policy))?,
        observer: Observer::new(&demonstration, history)?,
        holds: demonstration.holds(),
        policy,
        output: node.publisher("/switch_policy/procedure", Qos::latched())?,
        node: node.clone(),
        demonstration: demonstration.clone(),
    };
    let mut objects =
        node.newest::<TrackedObjects>("/pose_tracker/objects", Qos::best_effort(5))?;
    let mut status =
        node.newest::<ControllerStatus>("/arm_controller/status", Qos::best_effort(5))?;
    let reset = Arc::new(AtomicBool::new(false));
    let flag = reset.clone();
    node.service::<Trigger, _, _>("~/reset", move |_request| {
        flag.store(true, Ordering::SeqCst);
        async { TriggerResponse { success: true, message: "back to procedure 0".into() } }
    })?;
    let regrasp = Arc::new(AtomicBool::new(false));
    let flag = regrasp.clone();
    node.service::<Trigger, _, _>("~/regrasp", move |_request| {
        flag.store(true, Ordering::SeqCst);
        async { TriggerResponse { success: true, message: "back to the grasp".into() } }
    })?;
    node.diagnostics().level(Level::Ok, "waiting for the pose tracker");
    decision.core.start_at(p.first_procedure as usize, node.now());
    // Not before the controller had time to say that it is in mid-task.
    let mut repeat = tokio::time::interval_at(tokio::time::Instant::now() + REPEAT, REPEAT);
    let (mut held, mut adopted) = (false, false);
    let shutdown = node.shutdown().clone();
    loop {
        tokio::select! {
            _ = shutdown.wait() => return Ok(()),
            message = objects.recv() => {
                let Some(message) = message else { return Ok(()) };
                decision.go_back(&reset, &regrasp);
                decision.observe(&message, held);
            }
            message = status.recv() => {
                let Some(message) = message else { return Ok(()) };
                held = message.object_held;
                // After a restart in mid-task the controller, which still holds the object, knows more.
                if !adopted {
                    adopted = true;
                    decision.adopt(&message);
                }
            }
            p = params.changed() => decision.core.configure(settings(&p, &decision.policy))?,
            _ = repeat.tick() => {
                decision.go_back(&reset, &regrasp);
                decision.publish(node.now());
            }
        }
    }
}

impl Decision {
    fn adopt(&mut self, status: &ControllerStatus) {
        let there = status.procedure as usize;
        let procedure = match (status.object_held, status.done) {
            (true, _) => there,
            (false, true) => 0,
            // What was grasped before is at its place already.
            (false, false) => self.demonstration.retry_from(there),
        };
        if procedure > self.core.procedure() {
            tracing::info!("started in mid-task: procedure {procedure} is on");
            self.core.start_at(procedure, self.node.now());
        }
        self.publish(self.node.now());
    }

    /// As the services have asked.
    fn go_back(&mut self, reset: &AtomicBool, regrasp: &AtomicBool) {
        let again = regrasp.swap(false, Ordering::SeqCst);
        if reset.swap(false, Ordering::SeqCst) {
            tracing::info!("reset to procedure 0");
            self.core.reset();
        } else if again {
            let first = self.demonstration.retry_from(self.core.procedure());
            tracing::info!("back to procedure {first} for another grasp");
            self.core.start_at(first, self.node.now());
        } else {
            return;
        }
        self.observer.reset();
        self.publish(self.node.now());
    }

    fn observe(&mut self, objects: &TrackedObjects, held: bool) {
        let stamp = tracked::stamp(&objects.header);
        self.decide(stamp, objects, held);
        // Also when nothing has changed: the controller does not move without a fresh word.
        self.publish(stamp);
    }

    fn decide(&mut self, stamp: Stamp, objects: &TrackedObjects, held: bool) {
        let procedure = self.core.procedure();
        // Until the gripper has closed or opened as the procedure wants it, nothing counts as its progress.
        let grip = self.holds.get(procedure).is_some_and(|h| h.grip);
        if grip != held && !self.core.state().complete {
            return;
        }
        let observed =
            self.observer.observe(stamp, procedure, |name| tracked::usable_pose(objects, name));
        let diagnostics = self.node.diagnostics();
        let observation = match observed {
            Ok(o) => o,
            Err(error) => {
                diagnostics.level(Level::Warn, format!("no decision: {error}"));
                return;
            }
        };
        let probability = match self.policy.probability(procedure, &observation.history) {
            Ok(p) => p,
            Err(error) => {
                diagnostics.level(Level::Error, format!("no decision: {error}"));
                return;
            }
        };
        let state = self.core.step(stamp, probability, &observation.canonical_pose());
        self.report(&state);
        if state.switched {
            tracing::info!("procedure {procedure} is done (p = {probability:.3})");
        }
    }

    fn report(&self, state: &SwitchState) {
        let diagnostics = self.node.diagnostics();
        diagnostics.set("probability", format!("{:.3}", state.probability));
        let (level, sentence) = if state.complete {
            (Level::Ok, "the task is complete".to_owned())
        } else if state.timed_out {
            (Level::Warn, format!("procedure {} takes longer than its time-out", state.procedure))
        } else if state.guarded {
            (Level::Ok, "the classifier sees the end, the pose is not there yet".to_owned())
        } else {
            (Level::Ok, format!("procedure {} of {}", state.procedure, state.count))
        };
        diagnostics.level(level, sentence);
    }

    fn publish(&self, stamp: Stamp) {
        let state = self.core.state();
        let (name, moving, _) = self.observer.names(state.procedure).unwrap_or_default();
        let hold = self.holds.get(state.procedure).cloned().unwrap_or_default();
        let end = self.demonstration.procedures.get(state.procedure).map(|p| p.end);
        self.output.publish(Procedure {
            header: tracked::header(stamp),
            procedure: state.procedure as u32,
            count: state.count as u32,
            name: name.into(),
            probability: state.probability,
            complete: state.complete,
            moving: moving.into(),
            held: hold.object.unwrap_or_default(),
            grip: hold.grip,
            end: match end.unwrap_or_default() {
                GripperEnd::None => Procedure::END_NONE,
                GripperEnd::Close => Procedure::END_CLOSE,
                GripperEnd::Open => Procedure::END_OPEN,
            },
        });
    }
}
