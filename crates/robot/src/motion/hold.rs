use super::types::StatusCode;

/// Why the arm is being kept at rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Cause {
    /// Just started; a restarted controller must not move the arm unasked.
    Ready,
    Paused,
    Aborted,
    Disabled,
    Stale,
    Refused,
    Joints,
    Gripper,
}

impl Cause {
    pub fn code(self) -> StatusCode {
        match self {
            Self::Ready => StatusCode::Ready,
            Self::Paused => StatusCode::Paused,
            Self::Aborted => StatusCode::Aborted,
            Self::Disabled => StatusCode::Disabled,
            Self::Stale => StatusCode::HoldStale,
            Self::Refused => StatusCode::HoldRefused,
            Self::Joints => StatusCode::HoldJoints,
            Self::Gripper => StatusCode::HoldGripper,
        }
    }

    /// Whether `auto_resume` may end this hold.
    pub fn ends_by_itself(self) -> bool {
        !matches!(self, Self::Paused | Self::Aborted)
    }
}

/// A hold in force.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Hold {
    pub cause: Cause,
    pub sentence: String,
}
