//! What is kept of a trial, one JSON line each.

use super::{Level, PolicyKind, Start, Table2Error};
use serde::{Deserialize, Serialize};
use std::io::Write as _;
use std::path::Path;

/// Where a failed trial went wrong, coarsely.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// The gripper never got to where it closes.
    NeverReached,
    /// It closed, and never held the object.
    GraspFailed,
    /// The object was held and lost before its place.
    Lost,
    /// It was carried, and the end of the task was never seen.
    NeverPlaced,
    /// It was let go in the wrong place or orientation.
    Misplaced,
    /// It, or something else, fell over or off the table.
    Fell,
    /// The robot stopped for protection.
    ProtectiveStop,
}

impl Cause {
    /// As in tables.
    pub fn words(self) -> &'static str {
        match self {
            Self::NeverReached => "never reached the object",
            Self::GraspFailed => "grasp failed",
            Self::Lost => "object lost on the way",
            Self::NeverPlaced => "never came to the end of the placing",
            Self::Misplaced => "let go off the target",
            Self::Fell => "something fell over or off the table",
            Self::ProtectiveStop => "robot stopped for protection",
        }
    }
}

/// One trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrialRecord {
    /// Task.
    pub task: String,
    /// Demonstrations.
    pub demos: usize,
    /// Level.
    pub level: Level,
    /// Who drove.
    pub policy: PolicyKind,
    /// An object was pushed in mid-run.
    pub disturbed: bool,
    /// Arm of the ablation study.
    pub arm: String,
    /// `truth` or `perceived`.
    pub poses: String,
    /// Seed of training and starts.
    pub seed: u64,
    /// Number of the trial; below 13 one of the fixed points.
    pub trial: usize,
    /// Identity of what was taught.
    pub lesson: String,
    /// The start.
    pub start: Start,
    /// Whether the success definition held.
    pub success: bool,
    /// What the judge said.
    pub reason: String,
    /// What the arm controller said last.
    pub sentence: String,
    /// Where it went wrong.
    pub cause: Option<Cause>,
    /// Distance from the target in the plane, mm.
    pub error_mm: Option<f64>,
    /// Yaw error, deg.
    pub error_deg: Option<f64>,
    /// Simulated seconds.
    pub duration_s: f64,
    /// Seconds of this machine; not part of what the seed decides.
    pub wall_s: f64,
    /// Mean time of a plan on this machine, ms.
    pub plan_ms: f64,
    /// How often the gripper closed.
    pub grips: u32,
    /// The push happened (it waits for the right moment).
    pub pushed: bool,
    /// Times the arm went into the table.
    pub table_hits: u32,
}

impl TrialRecord {
    /// Tells trials apart: equal keys are the same trial of the same lesson.
    pub fn key(&self) -> String {
        key(
            &[&self.task, &self.arm, &self.poses, &self.lesson],
            self.demos,
            (self.level, self.policy, self.disturbed),
            (self.seed, self.trial),
        )
    }

    /// The same without what the machine's load decides.
    pub fn timeless(&self) -> Self {
        Self { wall_s: 0.0, plan_ms: 0.0, ..self.clone() }
    }
}

pub(super) fn key(
    names: &[&str; 4],
    demos: usize,
    (level, policy, disturbed): (Level, PolicyKind, bool),
    (seed, trial): (u64, usize),
) -> String {
    let [task, arm, poses, lesson] = names;
    format!(
        "{task}/{demos}/{}/{}/{disturbed}/{arm}/{poses}/{seed}/{trial}/{lesson}",
        level.name(),
        policy.name()
    )
}

/// Appends a line.
///
/// # Errors
/// [`Table2Error::File`].
pub fn append_record(path: &Path, record: &TrialRecord) -> Result<(), Table2Error> {
    let mut line = serde_json::to_string(record).map_err(|e| Table2Error::io(path, e))?;
    line.push('\n');
    let file = std::fs::OpenOptions::new().create(true).append(true).open(path);
    // One write: a line is there whole or, after a crash, cut short at the file's end.
    file.and_then(|mut f| f.write_all(line.as_bytes())).map_err(|e| Table2Error::io(path, e))
}

/// All lines of a file; none where there is no file. A last line cut short by a crash is left out, and
/// the file is made whole again.
///
/// # Errors
/// [`Table2Error::File`], naming the line that is no record.
pub fn read_records(path: &Path) -> Result<Vec<TrialRecord>, Table2Error> {
    if !path.is_file() {
        return Ok(Vec::new());
    }
    let mut text = std::fs::read_to_string(path).map_err(|e| Table2Error::io(path, e))?;
    if !text.is_empty() && !text.ends_with('\n') {
        text.truncate(text.rfind('\n').map_or(0, |i| i + 1));
        std::fs::write(path, &text).map_err(|e| Table2Error::io(path, e))?;
    }
    text.lines()
        .enumerate()
        .map(|(i, line)| {
            serde_json::from_str(line)
                .map_err(|e| Table2Error::io(path, format!("line {}: {e}", i + 1)))
        })
        .collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub fn record(trial: usize, success: bool) -> TrialRecord {
        TrialRecord {
            task: "cup_on_coaster".into(),
            demos: 50,
            level: Level::PG,
            policy: PolicyKind::Learned,
            disturbed: false,
            arm: "ordinary".into(),
            poses: "truth".into(),
            seed: 1,
            trial,
            lesson: "l".into(),
            start: Start { x: 0.3, y: 0.1, yaw: 0.2, point: (trial < 13).then_some(trial) },
            success,
            reason: "placed".into(),
            sentence: String::new(),
            cause: (!success).then_some(Cause::Misplaced),
            error_mm: Some(3.0),
            error_deg: Some(1.0),
            duration_s: 20.0,
            wall_s: 1.0,
            plan_ms: 1.3,
            grips: 1,
            pushed: false,
            table_hits: 0,
        }
    }

    #[test]
    fn lines_survive_a_crash_in_mid_write() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.jsonl");
        assert!(read_records(&path).unwrap().is_empty());
        for i in 0..3 {
            append_record(&path, &record(i, i != 1)).unwrap();
        }
        let whole = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, &whole[..whole.len() - 20]).unwrap();
        assert_eq!(read_records(&path).unwrap().len(), 2);
        append_record(&path, &record(2, true)).unwrap();
        let back = read_records(&path).unwrap();
        assert_eq!(back, [record(0, true), record(1, false), record(2, true)]);
        std::fs::write(&path, "{}\n").unwrap();
        assert!(read_records(&path).unwrap_err().to_string().contains("line 1"));
    }

    #[test]
    fn keys_tell_everything_apart_but_results() {
        let a = record(3, true);
        assert_eq!(a.key(), TrialRecord { success: false, wall_s: 9.0, ..a.clone() }.key());
        let others = [
            TrialRecord { trial: 4, ..a.clone() },
            TrialRecord { demos: 15, ..a.clone() },
            TrialRecord { level: Level::PoG, ..a.clone() },
            TrialRecord { disturbed: true, ..a.clone() },
            TrialRecord { lesson: "m".into(), ..a.clone() },
        ];
        assert!(others.iter().all(|b| b.key() != a.key()));
    }
}
