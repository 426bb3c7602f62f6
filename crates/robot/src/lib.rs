//! UR5 and Robotiq 2F-85 without ROS: kinematics, limits, collisions, a planner, gripper maps, the
//! arm controller's core and the driver's trajectory executor. No clock, no socket; files only in the
//! loaders of URDF, limits, calibration and workcell.

pub mod collision;
pub mod executor;
pub mod gripper;
pub mod kinematics;
pub mod limits;
pub mod motion;
pub mod planner;
pub mod urdf;

pub use executor::{
    Desired, ExecutorParams, GoalCode, GoalEndReport, GoalTolerances, JointTrajectory,
    JointTrajectoryExecutor, Motion, MotionController, MotionParams, MotionRefusal, RobotInput,
    StepOutput, TargetGuard, TrajectoryPoint, TrajectoryRejection,
};
pub use kinematics::{
    Calibration, CalibrationError, Dexterity, DhTable, IkError, IkSelection, IkSolutions,
    JOINT_NAMES, Joints, Kinematics, TCP_OFFSET, base_link_to_base, default_tool, unwrap_near,
};
pub use limits::{Limits, LimitsError};
pub use motion::{ArmController, ControllerInput, ControllerOutput, ControllerParams};
