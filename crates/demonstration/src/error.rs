use std::path::PathBuf;
use tdv_geometry::GeometryError;
use thiserror::Error;

/// What can go wrong between a recorded demonstration and a training set.
#[derive(Debug, Error)]
pub enum DemonstrationError {
    /// A file could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file is not in the expected form.
    #[error("{path}: {reason}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A task or configuration with problems, all of them listed.
    #[error("{what} has {n} problem(s):\n  - {list}", n = problems.len(), list = problems.join("\n  - "))]
    Invalid {
        /// Which task or configuration.
        what: String,
        /// Every problem, one sentence each.
        problems: Vec<String>,
    },
    /// Too few frames to see a motion in.
    #[error(
        "{have} frame(s) in the demonstration, at least {need} are needed; record the whole task"
    )]
    TooFewFrames {
        /// Frames given.
        have: usize,
        /// Frames needed.
        need: usize,
    },
    /// Frames are not in the order of their stamps.
    #[error(
        "frame {index} has stamp {stamp} ns, not later than frame {}; sort the recording by stamp",
        index - 1
    )]
    StampsOutOfOrder {
        /// The first frame that is not later than the one before.
        index: usize,
        /// Its stamp (ns).
        stamp: i64,
    },
    /// A coordinate is NaN or infinite.
    #[error("frame {frame}: {what} is not finite; the observation is broken at its source")]
    NotFinite {
        /// Frame index.
        frame: usize,
        /// Which object or joint.
        what: String,
    },
    /// The moving object is in no frame, or in too few.
    #[error(
        "moving object '{name}' is seen in {seen} of {frames} frames (confidence at least {min_confidence}), \
         at least {need} are needed; check its name in the task and its model"
    )]
    ObjectMissing {
        /// Name of the object.
        name: String,
        /// Frames with a usable pose.
        seen: usize,
        /// All frames.
        frames: usize,
        /// Frames needed.
        need: usize,
        /// The threshold.
        min_confidence: f64,
    },
    /// The reference object is in no frame, or in too few.
    #[error(
        "reference object '{name}' is seen in {seen} of {frames} frames, at least {need} are needed; \
         check its name in the task and its model"
    )]
    ReferenceMissing {
        /// Name of the object.
        name: String,
        /// Frames with a usable pose.
        seen: usize,
        /// All frames.
        frames: usize,
        /// Frames needed.
        need: usize,
    },
    /// No usable hand.
    #[error(
        "no hand: {usable} of {frames} frames have 21 usable hand joints, at least {need} are needed; \
         the hand must be in view while it reaches and grasps"
    )]
    NoHand {
        /// Frames with a usable hand.
        usable: usize,
        /// All frames.
        frames: usize,
        /// Frames needed.
        need: usize,
    },
    /// Nothing was moved.
    #[error(
        "object '{name}' never moves: it ends {moved:.3} m from its start, at least {need:.3} m are needed; \
         is it the object of the task?"
    )]
    ObjectNeverMoves {
        /// Name of the object.
        name: String,
        /// Largest distance from the start (m).
        moved: f64,
        /// Least distance that counts as a motion (m).
        need: f64,
    },
    /// The object moves, but not with the hand.
    #[error("no grasp found: {reason}")]
    NoGrasp {
        /// The evidence that is missing.
        reason: String,
    },
    /// The grasp cannot be made to fit the gripper within the limits of the task.
    #[error("the demonstrated grasp does not fit the gripper: {reason}")]
    GraspDoesNotFit {
        /// Why, with the numbers.
        reason: String,
    },
    /// A hole in the observations that is too long to bridge.
    #[error(
        "{what} is not seen for {seconds:.2} s from frame {frame} on, at most {allowed:.2} s can be bridged"
    )]
    GapTooLong {
        /// What is missing.
        what: String,
        /// First frame of the gap.
        frame: usize,
        /// Its length (s).
        seconds: f64,
        /// The limit (s).
        allowed: f64,
    },
    /// A rotation that is none.
    #[error(
        "frame {frame}: the quaternion of '{name}' has norm {norm}, not 1; the observation is broken at its source"
    )]
    NotARotation {
        /// Frame index.
        frame: usize,
        /// Which object.
        name: String,
        /// Norm of the quaternion.
        norm: f64,
    },
    /// A procedure in which nothing moves.
    #[error(
        "procedure '{procedure}': all {poses} poses are the same; is it a recording of the task, and do its \
         segments have a length?"
    )]
    StandsStill {
        /// Name of the procedure.
        procedure: String,
        /// How many.
        poses: usize,
    },
    /// Where one procedure ends and the next begins cannot be seen.
    #[error(
        "procedure '{procedure}': {reason}; give its frames in a segments file (`tdv teach --segments`)"
    )]
    NoBoundary {
        /// Name of the procedure.
        procedure: String,
        /// What is missing.
        reason: String,
    },
    /// A procedure that is not in the task or the demonstration.
    #[error("there is no procedure {asked}; there are {known}")]
    UnknownProcedure {
        /// Name or number asked for.
        asked: String,
        /// What there is.
        known: String,
    },
    /// No start is left.
    #[error(
        "procedure '{procedure}': no start is left: the workspace x {x:?}, y {y:?} lies within {radius} m of \
         the reference object at {reference:?} or outside its polygon; widen it or make exclude_radius smaller"
    )]
    EmptyWorkspace {
        /// Name of the procedure.
        procedure: String,
        /// Its x range (m).
        x: [f64; 2],
        /// Its y range (m).
        y: [f64; 2],
        /// The excluded radius (m).
        radius: f64,
        /// Where the reference stands (m, base_link).
        reference: [f64; 2],
    },
    /// Generation found too few acceptable trajectories.
    #[error(
        "procedure '{procedure}': only {accepted} of {wanted} trajectories after {tried} starts; rejected: {reasons}"
    )]
    TooManyRejections {
        /// Name of the procedure.
        procedure: String,
        /// Accepted trajectories.
        accepted: usize,
        /// Wanted trajectories.
        wanted: usize,
        /// Starts tried.
        tried: usize,
        /// Counts by reason.
        reasons: String,
    },
    /// Numbers that are not a pose or trajectory.
    #[error("{what}: {source}")]
    Geometry {
        /// Where.
        what: String,
        /// What.
        source: GeometryError,
    },
}

impl DemonstrationError {
    pub(crate) fn geometry(what: impl Into<String>) -> impl FnOnce(GeometryError) -> Self {
        let what = what.into();
        move |source| Self::Geometry { what, source }
    }
}
