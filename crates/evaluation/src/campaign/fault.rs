//! The troubles and when they come.

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// A kind of trouble.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// Most predictions are lost.
    MessageLoss,
    /// Predictions come twice and out of order.
    OutOfOrder,
    /// No predictions at all.
    PolicySilent,
    /// The switch policy says nothing.
    SwitchSilent,
    /// Predictions with NaN in them.
    NotANumber,
    /// Predictions turned by half a turn.
    Flipped,
    /// Predictions 30 cm off.
    Jump,
    /// Predictions that come late.
    Late,
    /// Predictions stamped in the future.
    Future,
    /// Trajectories with wrong joint names.
    WrongNames,
    /// No connection between driver and robot.
    RtdeCut,
    /// Joint states do not reach the controller, or are NaN.
    JointStates,
    /// The gripper says nothing and does nothing.
    GripperSilent,
    /// The arm controller is killed and started again.
    ControllerKilled,
    /// The driver is killed and started again.
    DriverKilled,
    /// A protective stop, unlocked and played again by the operator.
    ProtectiveStop,
    /// An emergency stop.
    EmergencyStop,
    /// The speed slider at 1 %.
    SpeedSlider,
    /// The object slips out of the gripper.
    Slip,
    /// The perception bridge is killed and started again (live only).
    PerceptionKilled,
    /// The pose tracker is killed and started again (live only).
    TrackerKilled,
    /// The switch policy is killed and started again (live only).
    SwitchKilled,
    /// The diffusion policy is killed and started again (live only).
    PolicyKilled,
}

impl FaultKind {
    /// Those of the campaign in one process.
    pub const ALL: [Self; 19] = [
        Self::MessageLoss,
        Self::OutOfOrder,
        Self::PolicySilent,
        Self::SwitchSilent,
        Self::NotANumber,
        Self::Flipped,
        Self::Jump,
        Self::Late,
        Self::Future,
        Self::WrongNames,
        Self::RtdeCut,
        Self::JointStates,
        Self::GripperSilent,
        Self::ControllerKilled,
        Self::DriverKilled,
        Self::ProtectiveStop,
        Self::EmergencyStop,
        Self::SpeedSlider,
        Self::Slip,
    ];

    /// Those of the campaign on the running graph.
    pub const LIVE: [Self; 10] = [
        Self::PerceptionKilled,
        Self::TrackerKilled,
        Self::SwitchKilled,
        Self::PolicyKilled,
        Self::ControllerKilled,
        Self::DriverKilled,
        Self::RtdeCut,
        Self::GripperSilent,
        Self::ProtectiveStop,
        Self::SpeedSlider,
    ];

    /// The time (s) within which the arm has to rest when the trouble lasts longer than that; none
    /// where it may go on. Predictions and observations: 350 ms after the last good one; what silences
    /// a node below them has to act at least as fast.
    pub fn rest_due(self) -> Option<f64> {
        match self {
            Self::MessageLoss | Self::OutOfOrder | Self::SpeedSlider | Self::Slip => None,
            // 0.6 s of silence are allowed to a gripper that is polled over a serial line.
            Self::GripperSilent => Some(0.85),
            _ => Some(0.35),
        }
    }
}

/// One trouble.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fault {
    /// Its kind.
    pub kind: FaultKind,
    /// The arm has to have moved for this long before it comes, s.
    pub after: f64,
    /// How long it lasts, s.
    pub lasts: f64,
    /// How strong it is, 0 to 1.
    pub strength: f64,
    /// Trajectories say when they begin, or begin on arrival.
    pub stamped: bool,
}

impl Fault {
    /// Drawn from a seed's generator.
    pub fn draw(rng: &mut ChaCha8Rng) -> Self {
        let kind = FaultKind::ALL[rng.random_range(0..FaultKind::ALL.len())];
        Self {
            kind,
            after: rng.random_range(0.2..6.0),
            lasts: rng.random_range(0.05..3.0),
            strength: rng.random_range(0.0..1.0),
            stamped: rng.random_range(0..2) == 1,
        }
    }
}
