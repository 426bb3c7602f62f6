//! One closed-loop trial.

use super::brain::{Brain, Decision};
use super::eyes::{Eyes, Frame, PoseNoise, RATE};
use super::layout::{self, environment};
use super::plant::Plant;
use super::{
    Arm, Cause, Lesson, Level, PolicyKind, Start, Surroundings, Table2Error, TrialRecord,
    demonstrator, fnv64,
};
use std::collections::VecDeque;
use std::sync::Arc;
use tdv_demonstration::Task;
use tdv_geometry::{Stamp, yaw_of};
use tdv_robot::motion::{Attach, ObjectPlace, ObjectReport, StatusCode};
use tdv_simulation::disturbance::Disturbance;
use tdv_simulation::trial::{PlacingGoal, Rule};
use tdv_simulation::{LabAssets, SimulationError};

/// The arm controller being done, the judge gets this long to see everything at rest, s.
const AFTERWARDS: f64 = 2.0;
/// Frames that every observation, and all that follows from it, comes late.
const LATE: f64 = 1.0;

/// What a trial is made of.
pub struct Setting<'a> {
    /// Task.
    pub task: &'a Task,
    /// Scene and objects.
    pub assets: &'a Arc<LabAssets>,
    /// What stands around the arm.
    pub surroundings: Option<&'a Surroundings>,
    /// What was taught.
    pub lesson: &'a Arc<Lesson>,
    /// Demonstrations, for the record.
    pub demos: usize,
    /// Level.
    pub level: Level,
    /// Who drives.
    pub policy: PolicyKind,
    /// Push an object in mid-run.
    pub disturbed: bool,
    /// Ablation.
    pub arm: &'a Arm,
    /// Noise of the observed poses.
    pub noise: PoseNoise,
    /// Seed of the starts.
    pub seed: u64,
}

/// What a frame leads to, on its way.
struct Delivery {
    due: f64,
    stamp: Stamp,
    frame: Frame,
    decision: Decision,
    held: bool,
    /// The task has an object that is carried.
    carries: bool,
}

/// Runs trial number `trial`; the same setting gives the same record, apart from times of the machine.
///
/// # Errors
/// Of setting up the lab and of the policies.
pub fn run_trial(setting: &Setting<'_>, trial: usize) -> Result<TrialRecord, Table2Error> {
    let began = std::time::Instant::now();
    let start = start(setting, trial)?;
    let scene = &setting.assets.scene;
    let seed = environment(&scene.name, setting.seed, trial);
    let last = setting.lesson.demonstration.procedures.last();
    let goal = match scene.task.rule {
        // The yaw is to be the demonstrated one.
        Rule::Placing => PlacingGoal {
            offset: scene.task.goal.offset,
            yaw: last.map_or(0.0, |p| yaw_of(&p.goal().rotation)),
        },
        _ => scene.task.goal,
    };
    let varied = (layout::varied(scene, setting.task), (start.x, start.y, start.yaw));
    let world = setting.surroundings.map(|s| s.world().clone());
    let plant = Plant::new(setting.assets.clone(), seed, goal, varied, world)?;
    let brain = Brain::new(setting.lesson, setting.task, setting.policy, setting.arm)?;
    let eyes =
        Eyes::new(setting.task, setting.noise, fnv64(["eyes", &seed.to_string()].into_iter()));
    // By turns the moving object and the reference.
    let pushes = (seed & !1) | (trial as u64 & 1);
    let disturbance = setting.disturbed.then(|| Disturbance::new(pushes));
    let mut run = Run {
        plant,
        brain,
        eyes,
        disturbance,
        begin: 0.0,
        frames: 0,
        deliveries: VecDeque::new(),
        carried: None,
        was_held: false,
        stopped: false,
    };
    run.go()?;
    Ok(run.record(setting, start, trial, began.elapsed().as_secs_f64()))
}

pub(super) fn start(setting: &Setting<'_>, trial: usize) -> Result<Start, Table2Error> {
    let scene = &setting.assets.scene;
    let seed = environment(&scene.name, setting.seed, trial);
    let reference = scene.draw_starts(seed)?[scene.index_of(&scene.task.reference)?];
    let reference = [reference.translation.x, reference.translation.y];
    let yaw = demonstrator::start_yaw(&setting.lesson.demonstration);
    let varied = layout::varied(scene, setting.task);
    let numbers = (setting.seed, trial);
    Ok(layout::start(
        (scene, varied),
        &setting.task.workspace,
        setting.level,
        yaw,
        reference,
        numbers,
    ))
}

struct Run<'a> {
    plant: Plant,
    brain: Brain,
    eyes: Eyes<'a>,
    disturbance: Option<Disturbance>,
    begin: f64,
    frames: u64,
    deliveries: VecDeque<Delivery>,
    /// The object that the last procedure with one moves.
    carried: Option<String>,
    was_held: bool,
    stopped: bool,
}

impl Run<'_> {
    fn go(&mut self) -> Result<(), Table2Error> {
        self.begin = self.plant.lab.time();
        let mut done_since = None;
        while !self.plant.lab.trial().finished {
            self.plant.tick();
            let time = self.plant.lab.time();
            if ((time - self.begin) * RATE).floor() as u64 >= self.frames {
                self.frames += 1;
                self.frame(time)?;
            }
            self.deliver(time);
            self.was_held |= self.plant.word.held;
            if self.plant.lab.incidents().protective_stops > 0 {
                // Nobody unlocks it: the trial is lost.
                self.stopped = true;
                self.plant.lab.conclude("the robot stopped for protection");
            }
            if self.plant.word.code == Some(StatusCode::Done) {
                let since = *done_since.get_or_insert(time);
                let waiting = self.plant.lab.trial().reason.contains("waiting for rest");
                if time - since > AFTERWARDS && !waiting {
                    self.plant.lab.conclude("the robot is done");
                }
            } else {
                done_since = None;
            }
        }
        Ok(())
    }

    fn frame(&mut self, time: f64) -> Result<(), Table2Error> {
        if let Some(d) = &mut self.disturbance {
            match d.step(&mut self.plant.lab) {
                // No room to push anything now: later.
                Ok(_) | Err(SimulationError::NoPlace { .. }) => {}
                Err(e) => return Err(e.into()),
            }
        }
        if let Some(regrasp) = self.plant.word.reset.take() {
            self.brain.reset(regrasp, self.plant.now());
        }
        let held = self.plant.word.held;
        if let Some(name) = self.brain.carried() {
            self.carried = Some(name.to_owned());
        }
        let truth: Vec<_> =
            self.plant.lab.objects().map(|(name, pose)| (name.to_owned(), pose)).collect();
        let tcp = self.plant.tcp();
        let holding = if held { self.carried.as_deref() } else { None };
        let frame = self.eyes.look(&truth, &tcp, holding);
        let stamp = self.plant.now();
        let decision = self.brain.frame(stamp, &frame.poses, held)?;
        self.deliveries.push_back(Delivery {
            due: time + LATE / RATE,
            stamp,
            frame,
            decision,
            held,
            carries: self.carried.is_some(),
        });
        Ok(())
    }

    fn deliver(&mut self, time: f64) {
        while self.deliveries.front().is_some_and(|d| d.due <= time) {
            let Some(d) = self.deliveries.pop_front() else { return };
            let input = &mut self.plant.input;
            input.procedure = Some(d.decision.state);
            input.attach = d.frame.attach.map(|pose| Attach { stamp: d.stamp, pose });
            let place = match (d.carries, d.held && d.frame.in_grip) {
                // What the gripper's own path holds is not followed by itself.
                (false, _) => ObjectPlace::Unknown,
                (true, true) => ObjectPlace::Held,
                (true, false) => ObjectPlace::Apart,
            };
            input.object = Some(ObjectReport { stamp: d.stamp, place });
            if let Some(plan) = d.decision.plan {
                input.plan = Some(plan);
            }
        }
    }

    fn cause(&self) -> Cause {
        let v = self.plant.lab.trial();
        let (procedure, complete) = self.brain.progress();
        if self.stopped {
            return Cause::ProtectiveStop;
        }
        if ["fell off", "knocked over", "on its side"].iter().any(|w| v.reason.contains(w)) {
            return Cause::Fell;
        }
        match (self.plant.grips, self.was_held, self.plant.word.held, complete) {
            (_, _, _, true) => Cause::Misplaced,
            (0, ..) => Cause::NeverReached,
            (_, false, ..) => Cause::GraspFailed,
            (_, true, true, false) => Cause::NeverPlaced,
            (_, true, false, false) if procedure == 0 => Cause::Lost,
            _ => Cause::NeverPlaced,
        }
    }

    fn record(&self, s: &Setting<'_>, start: Start, trial: usize, wall_s: f64) -> TrialRecord {
        let v = self.plant.lab.trial();
        let (planning, plans) = self.brain.planning;
        TrialRecord {
            task: s.task.name.clone(),
            demos: s.demos,
            level: s.level,
            policy: s.policy,
            disturbed: s.disturbed,
            arm: s.arm.name.clone(),
            poses: "truth".into(),
            seed: s.seed,
            trial,
            lesson: s.lesson.hash.clone(),
            start,
            success: v.success,
            reason: v.reason.clone(),
            sentence: match self.brain.note.as_str() {
                "" => self.plant.word.sentence.clone(),
                note => format!("{}; {note}", self.plant.word.sentence),
            },
            cause: (!v.success).then(|| self.cause()),
            error_mm: Some(1e3 * v.error_m).filter(|e| e.is_finite()),
            error_deg: Some(v.error_rad.to_degrees()).filter(|e| e.is_finite()),
            duration_s: v.elapsed,
            wall_s,
            plan_ms: 1e3 * planning / f64::from(plans.max(1)),
            grips: self.plant.grips,
            pushed: self.disturbance.as_ref().is_some_and(Disturbance::is_done),
            table_hits: self.plant.lab.incidents().table_hits,
        }
    }
}
