//! The fault campaign: seeded troubles thrown at arm controller, driver and robot in one process on
//! simulated time.
//!
//! Everything on the robot's side is what runs live: the arm controller's core, the driver's commanding
//! side, the servo program in the controller's interpreter, the gripper, the physics. Only what lies
//! between them is made up here: messages take their time, observations are the truth with a stated
//! noise (2 mm, 1 deg), and the predictions are a pick-and-place by rule instead of a network's.

mod fault;
mod live;
mod planner;
mod rig;
mod table;

pub use fault::{Fault, FaultKind};
pub use live::{LiveFault, judge_motion};
pub use table::{CampaignReport, KindSummary};

use rig::Rig;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tdv_simulation::{LabAssets, SimulationError};

/// What came of one case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CaseResult {
    /// Seed of the case.
    pub seed: u64,
    /// What was done.
    pub kind: FaultKind,
    /// For how long, s.
    pub lasted: f64,
    /// Joint speed when it began, rad/s.
    pub speed: f64,
    /// Seconds from its beginning until the arm was at rest; `None` when it never rested meanwhile.
    pub rest_s: Option<f64>,
    /// The fault demands rest within this time, s.
    pub rest_due: Option<f64>,
    /// What the operator read while it lasted.
    pub sentence: String,
    /// Limits that were broken, by the robot's own measure; collisions with the table.
    pub violations: Vec<String>,
    /// The task went on and was finished afterwards.
    pub recovered: bool,
    /// The object ended where it belongs.
    pub placed: bool,
    /// The object was carried when it began; only the live campaign says so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub carrying: Option<bool>,
    /// How often an operator had to help; only the live campaign has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub helped: Option<u32>,
}

impl CaseResult {
    /// Nothing broken, at rest in time.
    pub fn safe(&self) -> bool {
        let late = self.rest_due.is_some_and(|due| self.rest_s.is_none_or(|s| s > due));
        self.violations.is_empty() && !late
    }
}

/// Runs one case; the seed decides all of it.
///
/// # Errors
/// [`SimulationError`] when the scene cannot be set up.
pub fn run_case(assets: &Arc<LabAssets>, seed: u64) -> Result<CaseResult, SimulationError> {
    Rig::new(assets.clone(), seed)?.run()
}

/// Runs `cases` cases from seed `first` on two threads. `progress` is told how many are done.
///
/// # Errors
/// [`SimulationError`] of the first case that could not be set up.
pub fn run_campaign(
    assets: &Arc<LabAssets>,
    first: u64,
    cases: u64,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<CampaignReport, SimulationError> {
    let next = AtomicU64::new(0);
    let work = || -> Result<Vec<CaseResult>, SimulationError> {
        let mut out = Vec::new();
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            if i >= cases {
                return Ok(out);
            }
            out.push(run_case(assets, first + i)?);
            progress(i + 1);
        }
    };
    let mut results = std::thread::scope(|scope| {
        let threads = [scope.spawn(work), scope.spawn(work)];
        let mut all = Vec::new();
        for thread in threads {
            // A panic of a case is a finding: it goes on in the caller.
            all.extend(thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?);
        }
        Ok::<_, SimulationError>(all)
    })?;
    results.sort_by_key(|r| r.seed);
    Ok(CampaignReport::new(results))
}
