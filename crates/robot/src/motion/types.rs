use crate::executor::{JointTrajectory, TrajectoryPoint};
use crate::kinematics::{JOINT_NAMES, Joints};
use tdv_geometry::{Pose, Stamp};

/// What a plan moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Moving {
    /// The gripper's `tcp`.
    Tcp,
    /// A held object; needs its pose in the gripper, see [`Attach`].
    Object,
}

/// A prediction of the policy.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Of the observation it was made from.
    pub stamp: Stamp,
    /// Procedure it belongs to.
    pub procedure: u32,
    /// What it moves.
    pub moving: Moving,
    /// `T_base_link_reference` used for it.
    pub reference_pose: Pose,
    /// `T_reference_moving` observed at `stamp`, when known.
    pub moving_pose: Option<Pose>,
    /// `T_reference_moving`, `dt` apart, the first one `dt` after `stamp`.
    pub poses: Vec<Pose>,
    /// Seconds.
    pub dt: f64,
}

/// Measured joints, already sorted by name.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointState {
    /// When it was measured.
    pub stamp: Stamp,
    /// Rad, UR order.
    pub q: Joints,
    /// Rad/s.
    pub qd: Joints,
}

/// What the gripper does at the end of a procedure.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum GripperEnd {
    /// Stays as it is.
    #[default]
    None,
    /// Closes.
    Close,
    /// Opens, and the arm backs off.
    Open,
}

/// Newest word of the switch policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProcedureState {
    /// Of the observation it was decided on, or of its repetition.
    pub stamp: Stamp,
    /// Current procedure.
    pub procedure: u32,
    /// The last procedure has ended: its `end` is due.
    pub complete: bool,
    /// The fingers are closed on something during it. The gripper closes before it, or opens where they
    /// are not to be.
    pub grip: bool,
    /// What it moves.
    pub moving: Moving,
    /// What the gripper does at its end; counts for the last procedure, between two `grip` says it.
    pub end: GripperEnd,
}

impl ProcedureState {
    /// Of the task with two procedures: 0 reaches for an object, 1 carries it and lets it go.
    pub fn pick_and_place(stamp: Stamp, procedure: u32, complete: bool) -> Self {
        let carries = procedure > 0;
        Self {
            stamp,
            procedure,
            complete,
            grip: carries,
            moving: if carries { Moving::Object } else { Moving::Tcp },
            end: if carries { GripperEnd::Open } else { GripperEnd::Close },
        }
    }
}

/// Pose of the held object in the gripper, `T_tcp_object`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attach {
    /// When it was measured; one from before the grip is not used.
    pub stamp: Stamp,
    /// `T_tcp_object`.
    pub pose: Pose,
}

/// What the tracker says of the object that is to be held.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectReport {
    /// Of the frame it derives from.
    pub stamp: Stamp,
    /// Where the object is.
    pub place: ObjectPlace,
}

/// Where the tracker believes the object to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ObjectPlace {
    /// In the gripper.
    Held,
    /// Elsewhere: the camera sees it.
    Apart,
    /// Not known.
    Unknown,
}

/// Newest state of the gripper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GripperFeedback {
    /// When the knuckle angle was measured.
    pub stamp: Stamp,
    /// Id of the [`GripperRequest`] that `stalled` and `reached` answer; `None` before the first.
    pub command: Option<u32>,
    /// Knuckle angle (rad), always the newest.
    pub knuckle: f64,
    /// The fingers were stopped by an object.
    pub stalled: bool,
    /// The fingers are where they were sent.
    pub reached: bool,
}

/// Requests of the operator; each is an edge, set for one step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Requests {
    /// Stop and stay.
    pub pause: bool,
    /// Go on after a stop.
    pub resume: bool,
    /// Forget the task's progress and begin again; opens the gripper.
    pub reset: bool,
    /// Go to the home pose.
    pub home: bool,
    /// Stop; only `reset` leaves this.
    pub abort: bool,
}

/// Everything that [`super::ArmController::step`] looks at.
#[derive(Debug, Clone, PartialEq)]
pub struct ControllerInput {
    /// Newest joint state.
    pub joints: Option<JointState>,
    /// Newest plan; may be the same for many steps.
    pub plan: Option<Plan>,
    /// Newest procedure.
    pub procedure: Option<ProcedureState>,
    /// Newest attachment.
    pub attach: Option<Attach>,
    /// Newest word of the tracker on the object.
    pub object: Option<ObjectReport>,
    /// Newest gripper state.
    pub gripper: Option<GripperFeedback>,
    /// Why the arm may not move, in words (dead-man switch, driver not ready, protective stop); none
    /// when it may.
    pub disabled: Option<String>,
    /// Factor 0..=1 by which the driver stretches time; 1 when it does not say.
    pub speed_scaling: f64,
    /// Edges.
    pub requests: Requests,
}

impl Default for ControllerInput {
    fn default() -> Self {
        Self {
            joints: None,
            plan: None,
            procedure: None,
            attach: None,
            object: None,
            gripper: None,
            disabled: None,
            speed_scaling: 1.0,
            requests: Requests::default(),
        }
    }
}

/// One point of a [`JointPath`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    /// Seconds from the path's stamp.
    pub time: f64,
    /// Rad, UR order.
    pub q: Joints,
    /// Rad/s.
    pub qd: Joints,
}

/// A short joint trajectory that ends at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct JointPath {
    /// When it starts.
    pub stamp: Stamp,
    /// Times strictly increase; the last velocity is zero.
    pub points: Vec<PathPoint>,
}

impl JointPath {
    /// As the message that goes to a driver. `stamped` puts the path's stamp into the header, for a
    /// driver that shares the controller's clock; without it the driver starts on arrival.
    pub fn to_trajectory(&self, stamped: bool) -> JointTrajectory {
        let point = |p: &PathPoint| TrajectoryPoint {
            positions: p.q.to_vec(),
            velocities: p.qd.to_vec(),
            time_from_start: p.time,
            ..TrajectoryPoint::default()
        };
        JointTrajectory {
            names: JOINT_NAMES.map(String::from).to_vec(),
            stamp: stamped.then_some(self.stamp),
            points: self.points.iter().map(point).collect(),
        }
    }
}

/// A command for the gripper action.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GripperRequest {
    /// Counts up; comes back in [`GripperFeedback::command`].
    pub id: u32,
    /// Knuckle angle (rad).
    pub position: f64,
    /// The action's `max_effort`.
    pub max_effort: f64,
}

/// What the controller is doing; the numbers go out in the status message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum StatusCode {
    /// No joint state has come yet.
    WaitingForJoints = 0,
    /// Stopped until `resume` after a start of this controller.
    Ready = 1,
    /// Nothing to follow yet.
    Idle = 2,
    /// Following plans.
    Following = 3,
    /// Opening the gripper at the start.
    Preparing = 4,
    /// Closing the gripper.
    Grasping = 5,
    /// Object held; waits for its pose in the gripper and for the next plan.
    AwaitingAttach = 6,
    /// Opening the gripper at the target.
    Releasing = 7,
    /// Backing off along the tool's axis.
    Retreating = 8,
    /// Grip failed or object lost: opening, backing off, starting over.
    Recovering = 9,
    /// Going to the home pose.
    Homing = 10,
    /// The task is done.
    Done = 11,
    /// Paused by request.
    Paused = 12,
    /// Not enabled.
    Disabled = 13,
    /// Aborted by request; only reset leaves this.
    Aborted = 14,
    /// No fresh plan: holding.
    HoldStale = 15,
    /// A plan or its path broke a limit or could not be reached: holding.
    HoldRefused = 16,
    /// Joint states missing, or the arm does not follow: holding.
    HoldJoints = 17,
    /// The gripper does not do what it was told: holding.
    HoldGripper = 18,
}

/// State for the operator.
#[derive(Debug, Clone, PartialEq)]
pub struct Status {
    /// Which state.
    pub code: StatusCode,
    /// The same in words, with the values that matter.
    pub sentence: String,
    /// Procedure being carried out.
    pub procedure: u32,
    /// The gripper holds an object.
    pub object_held: bool,
    /// The commanded state moves.
    pub moving: bool,
    /// The task is complete.
    pub done: bool,
}

/// What [`super::ArmController::step`] wants done.
#[derive(Debug, Clone, PartialEq)]
pub struct ControllerOutput {
    /// To the joint trajectory topic; with [`super::ControllerParams::dry_run`] it is only shown.
    pub trajectory: Option<JointPath>,
    /// To the gripper action.
    pub gripper: Option<GripperRequest>,
    /// Ask the switch policy to begin again (an edge) ...
    pub reset_switch: bool,
    /// ... not at procedure 0, but at the one that grasps what the present one presupposes.
    pub regrasp: bool,
    /// For the status topic.
    pub status: Status,
}
