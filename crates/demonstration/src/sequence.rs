//! The order of a task's procedures: what moves, seen from what, and what the gripper does after it.

use crate::{GraspConfig, TargetYaw, Workspace};
use serde::{Deserialize, Serialize};

/// Name of the gripper's frame.
pub const TCP: &str = "tcp";

/// What the gripper does when a procedure has come to its end.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GripperEnd {
    /// Closes: from here on something is held.
    Close,
    /// Opens: it is let go.
    Open,
    /// Stays as it is.
    #[default]
    None,
}

impl GripperEnd {
    /// What procedures of these names do where a file does not say it.
    pub fn of_name(name: &str) -> Self {
        match name {
            "reach" => Self::Close,
            "place" => Self::Open,
            _ => Self::None,
        }
    }
}

/// One procedure in a task file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProcedureSpec {
    /// Unique in the task.
    pub name: String,
    /// What moves: an object, or `tcp`.
    pub moving: String,
    /// The object whose frame it is seen from.
    pub reference: String,
    /// What the gripper does at its end.
    #[serde(default)]
    pub end: GripperEnd,
    /// Yaw of the moving object at the end, instead of the task's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_yaw: Option<TargetYaw>,
    /// How the grasp at the end is fitted to the gripper, instead of the task's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grasp: Option<GraspConfig>,
    /// Where the grasped or carried object may start, instead of the task's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub workspace: Option<Workspace>,
}

impl ProcedureSpec {
    /// Without anything of its own.
    pub fn new(name: &str, moving: &str, reference: &str, end: GripperEnd) -> Self {
        Self {
            name: name.into(),
            moving: moving.into(),
            reference: reference.into(),
            end,
            target_yaw: None,
            grasp: None,
            workspace: None,
        }
    }
}

/// What counts of a procedure for its place in the sequence.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Step<'a> {
    pub moving: &'a str,
    pub reference: &'a str,
    pub end: GripperEnd,
}

/// What the gripper holds during a procedure.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Hold {
    /// The fingers are closed on something.
    pub grip: bool,
    /// The procedure that ended with closing them.
    pub grasped_by: Option<usize>,
    /// What moves with the gripper. None for a grip on what only the hand's path speaks of, such as the
    /// handle of a drawer.
    pub object: Option<String>,
}

/// Where a procedure's trajectories start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Role {
    /// The open gripper goes to an object that is carried next.
    Reach,
    /// An object is carried from where it was grasped.
    Carry,
    /// The gripper's own path, from anywhere.
    Hand,
    /// Goes on where the procedure before it has ended, with the same frame moving.
    GoesOn,
}

/// What is held during each step.
pub(crate) fn holds(steps: &[Step<'_>]) -> Vec<Hold> {
    let mut since: Option<usize> = None;
    let mut out = Vec::with_capacity(steps.len());
    for (i, s) in steps.iter().enumerate() {
        let carried = s.moving != TCP;
        let object = match since {
            Some(g) => {
                let name = steps[g].reference;
                let until = steps[g + 1..].iter().position(|s| s.end == GripperEnd::Open);
                let last = until.map_or(steps.len() - 1, |k| g + 1 + k);
                let moves =
                    steps[g].moving == TCP && steps[g + 1..=last].iter().any(|s| s.moving == name);
                moves.then(|| name.to_string())
            }
            None => carried.then(|| s.moving.to_string()),
        };
        out.push(Hold { grip: since.is_some() || carried, grasped_by: since, object });
        match s.end {
            GripperEnd::Close => since = since.or(Some(i)),
            GripperEnd::Open => since = None,
            GripperEnd::None => {}
        }
    }
    out
}

/// The role of step `i`.
pub(crate) fn role(steps: &[Step<'_>], i: usize) -> Role {
    let reaches = |i: usize| {
        let s = steps[i];
        let next = steps.get(i + 1);
        s.moving == TCP
            && s.end == GripperEnd::Close
            && next.is_some_and(|n| n.moving == s.reference)
    };
    let goes_on = i > 0
        && steps[i - 1].moving == steps[i].moving
        && steps[i - 1].end != GripperEnd::Open
        && !reaches(i - 1);
    match (steps[i].moving == TCP, goes_on) {
        (true, false) if reaches(i) => Role::Reach,
        (_, true) => Role::GoesOn,
        (true, false) => Role::Hand,
        (false, false) => Role::Carry,
    }
}

/// Every problem of a sequence, one sentence each; `known`: whether an object has a shape.
pub(crate) fn problems(specs: &[ProcedureSpec], known: impl Fn(&str) -> bool) -> Vec<String> {
    let mut p = Vec::new();
    if specs.is_empty() {
        p.push("procedures: there is none".into());
    }
    let steps: Vec<Step<'_>> = specs.iter().map(Step::from).collect();
    let holds = holds(&steps);
    for (i, (s, hold)) in specs.iter().zip(&holds).enumerate() {
        let at = format!("procedures[{i}] '{}'", s.name);
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        if s.name.is_empty() || !s.name.chars().all(plain) {
            p.push(format!("{at}: its name must be letters, digits, '_' or '-'"));
        }
        if specs[..i].iter().any(|o| o.name == s.name) {
            p.push(format!("{at}: an earlier procedure has the same name"));
        }
        if s.moving == s.reference {
            p.push(format!("{at}: moving and reference are both '{}'", s.moving));
        }
        for (field, name) in [("moving", &s.moving), ("reference", &s.reference)] {
            if !(known(name) || field == "moving" && name == TCP) {
                p.push(format!("{at}: objects has no entry for {field} '{name}'"));
            }
        }
        let held = hold.grasped_by.map(|g| specs[g].reference.as_str());
        if s.moving != TCP && held != Some(s.moving.as_str()) {
            p.push(format!(
                "{at}: it moves '{}', which no procedure before it has grasped (moving tcp, reference {}, \
                 end close)",
                s.moving, s.moving
            ));
        }
        match (s.end, hold.grasped_by.is_some()) {
            (GripperEnd::Close, true) => {
                p.push(format!("{at}: it ends with closing a gripper that is closed already"));
            }
            (GripperEnd::Open, false) => {
                p.push(format!("{at}: it ends with opening a gripper that holds nothing"));
            }
            _ => {}
        }
    }
    p
}

impl<'a> From<&'a ProcedureSpec> for Step<'a> {
    fn from(s: &'a ProcedureSpec) -> Self {
        Self { moving: &s.moving, reference: &s.reference, end: s.end }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use GripperEnd::{Close, None as Stay, Open};

    fn specs(list: &[(&str, &str, &str, GripperEnd)]) -> Vec<ProcedureSpec> {
        list.iter().map(|(n, m, r, e)| ProcedureSpec::new(n, m, r, *e)).collect()
    }

    fn look(specs: &[ProcedureSpec]) -> (Vec<Hold>, Vec<Role>) {
        let steps: Vec<Step<'_>> = specs.iter().map(Step::from).collect();
        (holds(&steps), (0..steps.len()).map(|i| role(&steps, i)).collect())
    }

    #[test]
    fn two_objects_in_turn() {
        let s = specs(&[
            ("reach_mug", "tcp", "mug", Close),
            ("place_mug", "mug", "coaster", Open),
            ("reach_bottle", "tcp", "bottle", Close),
            ("over_disc", "bottle", "disc", Stay),
            ("place_bottle", "bottle", "disc", Open),
        ]);
        assert!(problems(&s, |n| n != "tcp").is_empty());
        let (holds, roles) = look(&s);
        assert_eq!(roles, [Role::Reach, Role::Carry, Role::Reach, Role::Carry, Role::GoesOn]);
        let grasped: Vec<_> = holds.iter().map(|h| h.grasped_by).collect();
        assert_eq!(grasped, [None, Some(0), None, Some(2), Some(2)]);
        assert_eq!(holds[4].object.as_deref(), Some("bottle"));
        assert!(!holds[2].grip && holds[2].object.is_none());
    }

    #[test]
    fn a_hand_task_with_a_grip_holds_no_object() {
        let s = specs(&[
            ("approach", "tcp", "drawer", Close),
            ("pull", "tcp", "drawer", Open),
            ("leave", "tcp", "drawer", Stay),
        ]);
        assert!(problems(&s, |n| n == "drawer").is_empty());
        let (holds, roles) = look(&s);
        assert_eq!(roles, [Role::Hand, Role::GoesOn, Role::Hand]);
        assert!(holds[1].grip && holds[1].object.is_none() && !holds[2].grip);
    }

    #[test]
    fn sequences_that_cannot_be_are_named() {
        let bad = specs(&[
            ("place", "mug", "coaster", Open),
            ("place", "tcp", "tcp", Close),
            ("reach", "tcp", "vase", Close),
        ]);
        let p = problems(&bad, |n| ["mug", "coaster", "tcp"].contains(&n)).join("\n");
        for word in
            ["no procedure before it", "holds nothing", "same name", "vase", "closed already"]
        {
            assert!(p.contains(word), "{word} not in {p}");
        }
        assert_eq!(problems(&[], |_| true).len(), 1);
    }
}
