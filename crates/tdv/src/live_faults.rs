//! The fault campaign on the running graph.

use crate::arguments::{ClosedLoopArgs, FaultsArgs};
use crate::{eval, motion};
use anyhow::Context as _;
use std::path::Path;
use tdv_demonstration::{Demonstration, Task};
use tdv_evaluation::campaign::{CampaignReport, CaseResult, FaultKind, LiveFault, judge_motion};
use tdv_robot::{Kinematics, Limits};
use tdv_runtime::trial::{
    FaultFigures, FaultSetup, TrialOutcome, Trouble, run_trial, shutdown_on_signals,
};
use tdv_simulation::Scene;

/// Least position of the speed slider that the driver takes.
const SLOW: f64 = 0.01;
/// Seconds of the clock that a case may take: a trial's, and an operator who helps.
const PATIENCE: f64 = 130.0;

/// Runs `cases` cases one after the other. True when no case broke anything.
pub fn campaign(args: &FaultsArgs, cases: u64) -> anyhow::Result<bool> {
    let loop_args = closed_loop(args);
    let task = Task::load(&args.task)?;
    let model = args.model.clone().unwrap_or_else(|| Path::new("models").join(&task.name));
    let demonstration = Demonstration::load(&model.join("demonstration.json"))
        .context("teach first: `tdv teach` makes the model folder")?;
    let scene = Scene::load(Path::new(&task.scene))?;
    let share = crate::launch::share(&loop_args.launch_file);
    let limits = Limits::load(&share.join("config/robot/limits.yaml"))?;
    let arm = Kinematics::ur5();
    std::fs::create_dir_all(&args.run).with_context(|| args.run.display().to_string())?;
    let shutdown = shutdown_on_signals()?;
    let mut results = Vec::new();
    for index in 0..cases {
        let seed = args.seed + index;
        let fault = LiveFault::draw(index, seed);
        let mut setup = eval::setup(&loop_args, &task, &scene, &demonstration, &model, seed)?;
        setup.fault = Some(FaultSetup {
            trouble: trouble(fault.kind)?,
            carrying: fault.carrying,
            after: fault.after,
            lasts: fault.lasts,
        });
        setup.patience = PATIENCE;
        let outcome = run_trial(&setup, &shutdown).with_context(|| format!("case {seed}"))?;
        let mut violations = judge_motion(&motion::samples(&outcome), &limits, &arm);
        violations.extend(mishaps(&outcome));
        let case = result(seed, &fault, &outcome, violations);
        tell(&case, &outcome);
        results.push(case);
    }
    let report = CampaignReport::new(results);
    print!("{}", report.table());
    if let Some(path) = &args.json {
        eval::write_json(path, &report)?;
    }
    Ok(report.safe())
}

/// The plain closed loop: the campaign changes nothing else.
fn closed_loop(args: &FaultsArgs) -> ClosedLoopArgs {
    ClosedLoopArgs::one(args.task.clone(), args.model.clone(), args.seed, args.run.clone())
}

fn trouble(kind: FaultKind) -> anyhow::Result<Trouble> {
    let node = match kind {
        FaultKind::PerceptionKilled => "perception_bridge",
        FaultKind::TrackerKilled => "pose_tracker",
        FaultKind::SwitchKilled => "switch_policy",
        FaultKind::PolicyKilled => "diffusion_policy",
        FaultKind::ControllerKilled => "arm_controller",
        FaultKind::DriverKilled => "ur5_driver",
        FaultKind::RtdeCut => return Ok(Trouble::CutRtde),
        FaultKind::GripperSilent => return Ok(Trouble::CutGripper),
        FaultKind::ProtectiveStop => return Ok(Trouble::ProtectiveStop),
        FaultKind::SpeedSlider => return Ok(Trouble::SpeedSlider(SLOW)),
        other => anyhow::bail!("{other:?} cannot be done to the running graph"),
    };
    Ok(Trouble::Kill(node.into()))
}

/// What the lab and the runner saw besides the motion.
fn mishaps(outcome: &TrialOutcome) -> Vec<String> {
    let mut out = Vec::new();
    if let Some(hits) = outcome.incidents.get("table_hits").filter(|n| *n != "0") {
        out.push(format!("{hits} times into the table"));
    }
    if let Some(why) = outcome.incidents.get("stopped_itself") {
        out.push(format!("the robot stopped itself: {why}"));
    }
    out.extend(outcome.exits.iter().map(|e| format!("{} ended ({:?})", e.name, e.code)));
    if outcome.verdict.is_none() {
        out.push("the lab gave no verdict".into());
    }
    if outcome.fault.is_none() {
        out.push("the arm never moved long enough for the trouble to come".into());
    }
    out
}

fn result(
    seed: u64,
    fault: &LiveFault,
    outcome: &TrialOutcome,
    violations: Vec<String>,
) -> CaseResult {
    let figures = outcome.fault.as_ref();
    let speed = figures.map_or(0.0, |f| f.speed);
    let placed = outcome.verdict.as_ref().is_some_and(|v| v.finished && v.success);
    CaseResult {
        seed,
        kind: fault.kind,
        lasted: figures.map_or(0.0, |f| f.lasted),
        speed,
        rest_s: figures.and_then(|f| f.rest_ms).map(|ms| 1e-3 * ms),
        rest_due: figures.and_then(|_| fault.rest_due(speed)),
        sentence: figures.map(|f| f.sentence.clone()).unwrap_or_default(),
        violations,
        recovered: figures.is_some_and(|f| f.went_on) && (placed || outcome.done),
        placed,
        carrying: figures.map(|f| f.carrying),
        helped: figures.map(|f| f.helped),
    }
}

/// A case's line as soon as it is there; its story where something was not as it should be.
fn tell(case: &CaseResult, outcome: &TrialOutcome) {
    let rest = match (case.rest_s, case.rest_due) {
        (Some(s), _) => format!("at rest after {:.0} ms", 1e3 * s),
        (None, Some(_)) => "NOT at rest".into(),
        (None, None) => "went on".into(),
    };
    let due = case.rest_due.map_or(String::new(), |d| format!(" (due {:.0})", 1e3 * d));
    println!(
        "case {}: {:?}{} at {:.2} rad/s, {rest}{due}; {}, {}{}",
        case.seed,
        case.kind,
        if case.carrying == Some(true) { " while carrying" } else { "" },
        case.speed,
        if case.recovered { "recovered" } else { "NOT recovered" },
        if case.placed { "placed" } else { "NOT placed" },
        match case.helped {
            None | Some(0) => String::new(),
            Some(n) => format!(", the operator helped {n} times"),
        }
    );
    println!("    told: {}", case.sentence);
    let fault: Option<&FaultFigures> = outcome.fault.as_ref();
    if !case.safe() || !case.recovered || !case.placed || fault.is_none() {
        for line in case.violations.iter().chain(&outcome.story) {
            println!("    {line}");
        }
        if let Some(v) = &outcome.verdict {
            println!("    verdict: {}", v.reason);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_live_kind_can_be_done_and_no_other() {
        for kind in FaultKind::LIVE {
            assert!(trouble(kind).is_ok(), "{kind:?}");
        }
        assert!(trouble(FaultKind::Flipped).is_err());
    }

    #[test]
    fn a_trouble_that_never_came_is_not_a_safe_case() {
        let outcome = TrialOutcome::default();
        let fault = LiveFault::draw(0, 1);
        let case = result(1, &fault, &outcome, mishaps(&outcome));
        assert!(!case.safe() && !case.recovered);
        let come = FaultFigures {
            node: "perception_bridge".into(),
            speed: 0.4,
            rest_ms: Some(300.0),
            lasted: 1.0,
            carrying: false,
            sentence: "poses are stale".into(),
            went_on: true,
            helped: 0,
        };
        let outcome = TrialOutcome { fault: Some(come), done: true, ..Default::default() };
        let good = result(1, &fault, &outcome, Vec::new());
        assert!(good.safe() && good.recovered && !good.placed);
        let late = CaseResult { rest_s: Some(0.4), ..good };
        assert!(!late.safe());
    }
}
