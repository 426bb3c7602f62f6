//! The task file: what is moved where, over which starts, and how the training set is made.

mod config;

pub use config::ClosingAxis;
pub use config::{
    GenerationConfig, GenerationMode, GraspConfig, HomeRegion, RecoveryConfig, RetimeConfig,
    Workspace,
};

use crate::sequence::{self, GripperEnd, ProcedureSpec, TCP};
use crate::{DemonstrationError, file};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use tdv_geometry::{Pose, Symmetry};

/// What is learned: the path of a grasped object, or the path of the hand itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TaskKind {
    /// Procedures `reach` and `place`, unless others are listed.
    Object,
    /// One procedure `follow`: the gripper seen from the reference object, unless others are listed.
    Hand,
}

/// Where the yaw of the placed object comes from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TargetYaw {
    /// As demonstrated, in the reference frame (see [`crate::canonical_reference`]).
    #[default]
    Demonstration,
    /// A given yaw in the reference frame (deg), whatever was demonstrated.
    Fixed(f64),
}

/// What parsing and generation need to know about an object's outside; lengths in m, object frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectShape {
    /// Rotations that leave it looking the same.
    #[serde(default)]
    pub symmetry: Symmetry,
    /// Radius of a cylinder about the object's z axis that holds all of it.
    pub radius: f64,
    /// From its lowest to its highest point when it stands.
    pub height: f64,
    /// z of its lowest point in the object frame; 0 when the origin lies on the underside.
    #[serde(default)]
    pub bottom: f64,
    /// Stands upright (z up) on the table before and after the task.
    #[serde(default = "yes")]
    pub stands: bool,
}

fn yes() -> bool {
    true
}

impl ObjectShape {
    /// z of the highest point in the object frame (m).
    pub fn top(&self) -> f64 {
        self.bottom + self.height
    }
}

/// One task, as in `config/tasks/NAME.yaml`. Unknown fields are refused.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Identifier; also names the checkpoint.
    pub name: String,
    /// The instruction in words, given to the text encoder.
    pub text: String,
    /// Object or hand task.
    pub kind: TaskKind,
    /// The object that the hand moves; for a hand task the frame `tcp`.
    pub moving_object: String,
    /// The object whose frame is the goal frame.
    pub reference_object: String,
    /// Scene file of the virtual lab, relative to the repository's root.
    pub scene: String,
    /// What stands in the arm's reach, relative to the repository's root; none = the table only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub workcell: Option<String>,
    /// The procedures in order; none = those of the kind, see [`Task::sequence`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub procedures: Vec<ProcedureSpec>,
    /// Shapes of the objects named above.
    pub objects: BTreeMap<String, ObjectShape>,
    /// Where objects may stand at the start (base_link).
    pub workspace: Workspace,
    /// Yaw of the placed object.
    #[serde(default)]
    pub target_yaw: TargetYaw,
    /// How the demonstrated grasp is fitted to the gripper.
    #[serde(default)]
    pub grasp: GraspConfig,
    /// How the training set is made.
    #[serde(default)]
    pub generation: GenerationConfig,
}

impl Task {
    /// Reads and validates a task file.
    ///
    /// # Errors
    /// [`DemonstrationError::Io`]; [`DemonstrationError::Format`] for YAML that is not a task, naming
    /// line and field; [`DemonstrationError::Invalid`] with every problem of the values.
    pub fn load(path: &Path) -> Result<Self, DemonstrationError> {
        let task = Self::from_yaml(&file::read(path)?).map_err(|e| match e {
            DemonstrationError::Format { reason, .. } => {
                DemonstrationError::Format { path: path.to_path_buf(), reason }
            }
            e => e,
        })?;
        task.check(&format!("task file {}", path.display()))?;
        Ok(task)
    }

    /// Parses YAML text without validating the values.
    ///
    /// # Errors
    /// [`DemonstrationError::Format`].
    pub fn from_yaml(text: &str) -> Result<Self, DemonstrationError> {
        serde_saphyr::from_str(text)
            .map_err(|e| DemonstrationError::Format { path: "task".into(), reason: e.to_string() })
    }

    pub(crate) fn check(&self, what: &str) -> Result<(), DemonstrationError> {
        let problems = self.validate();
        if problems.is_empty() {
            return Ok(());
        }
        Err(DemonstrationError::Invalid { what: what.to_string(), problems })
    }

    /// The procedures in order: those listed, or those of the kind.
    pub fn sequence(&self) -> Vec<ProcedureSpec> {
        if !self.procedures.is_empty() {
            return self.procedures.clone();
        }
        let (moving, reference) = (&self.moving_object, &self.reference_object);
        match self.kind {
            TaskKind::Object => vec![
                ProcedureSpec::new("reach", TCP, moving, GripperEnd::Close),
                ProcedureSpec::new("place", moving, reference, GripperEnd::Open),
            ],
            TaskKind::Hand => vec![ProcedureSpec::new("follow", TCP, reference, GripperEnd::None)],
        }
    }

    /// All objects that the task is about, the reference object first.
    pub fn object_names(&self) -> Vec<String> {
        let mut names = vec![self.reference_object.clone()];
        if self.moving_object != TCP {
            names.push(self.moving_object.clone());
        }
        for s in self.sequence() {
            for name in [s.moving, s.reference] {
                if name != TCP && !names.contains(&name) {
                    names.push(name);
                }
            }
        }
        names
    }

    /// The listed procedure of that name, with what it has of its own.
    pub(crate) fn spec(&self, name: &str) -> Option<&ProcedureSpec> {
        self.procedures.iter().find(|s| s.name == name)
    }

    /// Where the object that a procedure grasps or carries may start.
    pub fn workspace_of(&self, procedure: &str) -> &Workspace {
        self.spec(procedure).and_then(|s| s.workspace.as_ref()).unwrap_or(&self.workspace)
    }

    /// Shape of the moving object, if the task has it (a valid object task has).
    pub fn moving_shape(&self) -> Option<&ObjectShape> {
        self.objects.get(&self.moving_object)
    }

    /// Shape of the reference object, if the task has it (a valid task has).
    pub fn reference_shape(&self) -> Option<&ObjectShape> {
        self.objects.get(&self.reference_object)
    }

    /// `T_base_reference` with the orientation that training and live use agree on, see
    /// [`crate::canonical_reference`].
    pub fn canonical_reference(&self, pose: &Pose) -> Pose {
        let symmetry = self.reference_shape().map(|s| s.symmetry.clone()).unwrap_or_default();
        crate::canonical_reference(pose, &symmetry)
    }

    /// Every problem of the values, one sentence each; empty when the task is usable.
    pub fn validate(&self) -> Vec<String> {
        let mut p = Vec::new();
        let name_ok = |s: &str| {
            !s.is_empty() && s.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
        };
        if !name_ok(&self.name) {
            p.push(format!("name '{}' must be letters, digits, '_' or '-'", self.name));
        }
        if self.text.trim().is_empty() {
            p.push("text is empty: say what is to be done".into());
        }
        if self.scene.trim().is_empty() {
            p.push("scene is empty: name the lab's scene file".into());
        }
        if self.moving_object == self.reference_object {
            p.push(format!("moving_object and reference_object are both '{}'", self.moving_object));
        }
        let mut named = vec![("reference_object", &self.reference_object)];
        match self.kind {
            TaskKind::Object => named.push(("moving_object", &self.moving_object)),
            TaskKind::Hand if self.moving_object != TCP => p.push(format!(
                "moving_object of a hand task is the gripper, 'tcp', not '{}'",
                self.moving_object
            )),
            TaskKind::Hand => {}
        }
        for (field, name) in named {
            if !self.objects.contains_key(name) {
                p.push(format!("objects has no entry for {field} '{name}'"));
            }
        }
        let known = |name: &str| self.objects.contains_key(name);
        if !self.procedures.is_empty() {
            p.extend(sequence::problems(&self.procedures, known));
        }
        for (i, s) in self.procedures.iter().enumerate() {
            if let Some(w) = &s.workspace {
                w.validate(&format!("procedures[{i}].workspace"), &mut p);
            }
            if let Some(g) = &s.grasp {
                g.validate(&format!("procedures[{i}].grasp"), &mut p);
            }
        }
        let names = self.object_names();
        for (name, shape) in &self.objects {
            if !names.contains(name) {
                p.push(format!("objects.{name} is in no procedure of the task"));
            }
            for (field, v) in [("radius", shape.radius), ("height", shape.height)] {
                if !(v > 0.001 && v < 1.0) {
                    p.push(format!("objects.{name}.{field} {v} m must be within 0.001..1 m"));
                }
            }
            if !(-1.0..=1.0).contains(&shape.bottom) {
                p.push(format!("objects.{name}.bottom {} m must be within +-1 m", shape.bottom));
            }
            if let Symmetry::Continuous { axis } = &shape.symmetry
                && !(1e-6..1e6).contains(&nalgebra::Vector3::from(*axis).norm())
            {
                p.push(format!("objects.{name}.symmetry axis {axis:?} has no direction"));
            }
        }
        if let TargetYaw::Fixed(deg) = self.target_yaw
            && !(-180.0..=180.0).contains(&deg)
        {
            p.push(format!("target_yaw.fixed {deg} must be within -180..180 deg"));
        }
        self.workspace.validate("workspace", &mut p);
        self.grasp.validate("grasp", &mut p);
        self.generation.validate(&mut p);
        p
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(name: &str) -> Task {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/tasks").join(name);
        Task::load(&path).unwrap()
    }

    #[test]
    fn shipped_tasks_are_valid() {
        let cup = load("cup_on_coaster.yaml");
        assert_eq!((cup.kind, cup.moving_object.as_str()), (TaskKind::Object, "mug"));
        assert!(matches!(cup.reference_shape().unwrap().symmetry, Symmetry::Continuous { .. }));
        let mustard = load("mustard_on_disc.yaml");
        assert_eq!(mustard.moving_shape().unwrap().symmetry.rotations().len(), 2);
        // At most a tenth of the workspace may be excluded.
        for t in [cup, mustard] {
            let w = &t.workspace;
            let area = (w.x[1] - w.x[0]) * (w.y[1] - w.y[0]);
            assert!((area - 0.225).abs() < 1e-9);
            // ... of the disc, the part that lies inside the rectangle.
            let n = 400;
            let inside = (0..n * n)
                .filter(|i| {
                    let x = w.x[0] + (w.x[1] - w.x[0]) * (f64::from(i % n) + 0.5) / f64::from(n);
                    let y = w.y[0] + (w.y[1] - w.y[0]) * (f64::from(i / n) + 0.5) / f64::from(n);
                    (x - 0.45).hypot(y + 0.24) < w.exclude_radius
                })
                .count();
            assert!((inside as f64) < 0.1 * f64::from(n * n), "{inside} of {}", n * n);
        }
    }

    #[test]
    fn unknown_fields_are_refused_by_name() {
        let text = serde_saphyr::to_string(&load("cup_on_coaster.yaml")).unwrap();
        assert!(Task::from_yaml(&text).is_ok(), "{text}");
        let e = Task::from_yaml(&format!("{text}\nspeeed: 3\n")).unwrap_err().to_string();
        assert!(e.contains("speeed"), "{e}");
    }

    #[test]
    fn listed_procedures_replace_those_of_the_kind() {
        let cup = load("cup_on_coaster.yaml");
        let names = |t: &Task| t.sequence().iter().map(|s| s.name.clone()).collect::<Vec<_>>();
        assert_eq!(names(&cup), ["reach", "place"]);
        let mut text = serde_saphyr::to_string(&cup).unwrap();
        assert!(!text.contains("procedures"), "{text}");
        text.push_str(
            "procedures:\n- {name: take, moving: tcp, reference: mug, end: close}\n\
             - {name: pour, moving: mug, reference: coaster}\n",
        );
        let pour = Task::from_yaml(&text).unwrap();
        assert_eq!(pour.validate(), Vec::<String>::new());
        assert_eq!(names(&pour), ["take", "pour"]);
        assert_eq!(pour.object_names(), ["coaster", "mug"]);
        let wrong =
            text.replace("moving: mug, reference: coaster}", "moving: jug, reference: coaster}");
        let p = Task::from_yaml(&wrong).unwrap().validate().join("\n");
        assert!(p.contains("'jug'") && p.contains("procedures[1] 'pour'"), "{p}");
    }

    #[test]
    fn every_problem_is_listed_at_once() {
        let mut t = load("cup_on_coaster.yaml");
        t.text = " ".into();
        t.reference_object = "saucer".into();
        t.workspace.x = [0.7, 0.2];
        t.generation.alpha = 1.5;
        t.generation.count = 0;
        t.generation.retime.speed = f64::NAN;
        t.grasp.max_opening = -1.0;
        let p = t.validate();
        for word in ["text", "saucer", "workspace.x", "alpha", "count", "speed", "max_opening"] {
            assert!(p.iter().any(|s| s.contains(word)), "{word} not in {p:?}");
        }
        let e = t.check("task file x").unwrap_err().to_string();
        assert!(e.contains("task file x") && e.contains("alpha"), "{e}");
    }
}
