//! A Robotiq 2F-85 as its registers show it: activation, go-to requests, object detection. The
//! fingers themselves live in [`crate::world`]; here is the logic between a request and their drive.
//!
//! The real fingers swing on a parallelogram, which moves the pads 13.5 mm along the approach axis
//! between open and closed; here they slide straight, so the tool centre point stays put.

pub use tdv_robot::TCP_OFFSET;
use tdv_robot::gripper as maps;
pub use tdv_ur_protocol::gripper::ObjectStatus;

/// Gap between the pads when fully open, m.
pub const STROKE: f64 = 0.085;
/// Width of a pad across the closing axis, m.
pub const PAD_WIDTH: f64 = 0.022;
/// Length of a pad along the approach axis, m.
pub const PAD_LENGTH: f64 = 0.038;
/// Thickness of the rubber pad, m.
pub const PAD_THICKNESS: f64 = 0.007;
/// Thickness of the finger behind the pad, m.
pub const FINGER_THICKNESS: f64 = 0.011;
/// Where the finger begins along the approach axis of `tool0`, m.
pub const FINGER_ROOT: f64 = 0.078;
/// Front of the palm along the approach axis of `tool0`, m.
pub const PALM_FRONT: f64 = 0.080;
/// Radius of the palm, m.
pub const PALM_RADIUS: f64 = 0.0375;

/// Gap (m) that a requested position 0..=255 asks for; both ends saturate.
pub fn gap_of_count(count: u8) -> f64 {
    maps::gap_from_knuckle(maps::knuckle_from_register(count))
}

/// Position feedback (counts, 3 open to 230 closed) for a gap in m.
pub fn count_of_gap(gap: f64) -> u8 {
    maps::register_from_knuckle(maps::knuckle_from_gap(gap))
}

fn within((low, high): (f64, f64), count: u8) -> f64 {
    low + (high - low) * f64::from(count) / 255.0
}

/// Speed of the gap, m/s, for a requested speed 0..=255: 20 to 150 mm/s.
pub fn speed_of_count(count: u8) -> f64 {
    within(maps::SPEED_RANGE, count)
}

/// Force of each pad, N, for a requested force 0..=255: 20 to 235 N.
pub fn force_of_count(count: u8) -> f64 {
    within(maps::FORCE_RANGE, count)
}

/// What the fingers are to do now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FingerDrive {
    /// Gap to go to, m.
    pub gap: f64,
    /// Speed of the gap, m/s.
    pub speed: f64,
    /// Largest force of each pad, N.
    pub force: f64,
}

impl Default for FingerDrive {
    fn default() -> Self {
        Self { gap: STROKE, speed: 0.1, force: 40.0 }
    }
}

/// Activation, with the numbers of the STA register.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Activation {
    /// Not activated; requests are ignored.
    #[default]
    Reset = 0,
    /// Finding its ends.
    Activating = 1,
    /// Ready.
    Active = 3,
}

/// The registers that a client writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GripperRequest {
    /// ACT: activate.
    pub activate: bool,
    /// GTO: go to the requested position.
    pub go_to: bool,
    /// ATR: automatic release (opens slowly, then wants a new activation).
    pub auto_release: bool,
    /// POS, 0 open to 255 closed.
    pub position: u8,
    /// SPE, 0..=255.
    pub speed: u8,
    /// FOR, 0..=255.
    pub force: u8,
}

/// The registers that a client reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GripperStatus {
    /// STA.
    pub activation: Activation,
    /// OBJ.
    pub object: ObjectStatus,
    /// POS: measured position in counts.
    pub position: u8,
    /// PRE: the request that the gripper works on.
    pub requested: u8,
    /// FLT: 0, 5 (go-to asked before activation), 7 (not activated), 15 (automatic release done).
    pub fault: u8,
}

impl Default for GripperStatus {
    fn default() -> Self {
        Self {
            activation: Activation::Reset,
            object: ObjectStatus::AtPosition,
            position: count_of_gap(STROKE),
            requested: 0,
            fault: 0,
        }
    }
}

/// The fingers stand still when the gap has changed by less than this (m), about a count of the position
/// feedback, for [`STILL_FOR`]. A grip on something stiff trembles, which is no motion.
const STILL: f64 = 0.0003;
/// s.
const STILL_FOR: f64 = 0.06;
/// Nearer than this to the request (m) counts as there: about two counts.
const THERE: f64 = 0.0008;
/// The fingers have this long (s) to start before standing still means contact.
const START_GRACE: f64 = 0.08;
/// Shortest activation, s.
const ACTIVATION_TIME: f64 = 0.5;

/// The gripper's logic. One [`step`](Self::step) per tick of the lab.
#[derive(Debug, Clone, Default)]
pub struct Gripper {
    request: GripperRequest,
    status: GripperStatus,
    drive: FingerDrive,
    since_request: f64,
    still: f64,
    /// Gap (m) since when they stand still.
    stood: f64,
    closing: bool,
    holding: Option<f64>,
}

impl Gripper {
    /// A gripper just powered: open and not activated.
    pub fn new() -> Self {
        Self::default()
    }

    /// The registers written last.
    pub fn request(&self) -> GripperRequest {
        self.request
    }

    /// Writes the registers; they take effect with the next step.
    pub fn set_request(&mut self, request: GripperRequest) {
        let moved =
            (request.position, request.go_to) != (self.request.position, self.request.go_to);
        if request.activate != self.request.activate || moved {
            self.since_request = 0.0;
            self.still = 0.0;
        }
        if moved && request.go_to {
            // OBJ must not show the last request's answer for this one.
            self.status.object = ObjectStatus::Moving;
        }
        self.request = request;
        self.status.requested = request.position;
    }

    /// The registers to read.
    pub fn status(&self) -> GripperStatus {
        self.status
    }

    /// One tick of `dt` seconds with the measured gap (m); returns the drive.
    pub fn step(&mut self, dt: f64, gap: f64) -> FingerDrive {
        self.since_request += dt;
        if (gap - self.stood).abs() < STILL {
            self.still += dt;
        } else {
            (self.still, self.stood) = (0.0, gap);
        }
        self.status.position = count_of_gap(gap);
        let stopped = self.since_request > START_GRACE && self.still > STILL_FOR;
        if !self.request.activate {
            self.status.activation = Activation::Reset;
            self.status.fault = if self.request.go_to { 7 } else { 0 };
            self.hold(gap);
            return self.drive;
        }
        if self.status.activation == Activation::Reset {
            self.status.activation = Activation::Activating;
            self.since_request = 0.0;
            self.still = 0.0;
        }
        if self.status.activation == Activation::Activating {
            self.status.fault = if self.request.go_to { 5 } else { 0 };
            self.holding = None;
            self.drive = FingerDrive::default();
            if self.since_request > ACTIVATION_TIME && stopped {
                self.status.activation = Activation::Active;
                self.status.fault = 0;
                self.since_request = 0.0;
            }
            return self.drive;
        }
        if self.request.auto_release {
            self.holding = None;
            self.drive = FingerDrive { gap: STROKE, speed: 0.02, force: 40.0 };
            self.status.fault = if stopped { 15 } else { 11 };
            return self.drive;
        }
        if !self.request.go_to || self.status.fault == 15 {
            self.hold(gap);
            return self.drive;
        }
        self.holding = None;
        let target = gap_of_count(self.request.position);
        self.drive = FingerDrive {
            gap: target,
            speed: speed_of_count(self.request.speed),
            force: force_of_count(self.request.force),
        };
        if (target - gap).abs() > THERE {
            self.closing = target < gap;
        }
        self.status.object = if !stopped {
            match self.status.object {
                // A contact is only forgotten once the fingers really move again.
                kept if self.still > 0.0 && self.since_request > START_GRACE => kept,
                _ => ObjectStatus::Moving,
            }
        } else if (target - gap).abs() <= THERE {
            ObjectStatus::AtPosition
        } else if self.closing {
            ObjectStatus::ContactClosing
        } else {
            ObjectStatus::ContactOpening
        };
        self.drive
    }

    fn hold(&mut self, gap: f64) {
        let at = *self.holding.get_or_insert(gap);
        self.drive = FingerDrive { gap: at, speed: 0.02, force: self.drive.force };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.002;

    /// Ideal fingers that stop at `block` when closing.
    fn run(g: &mut Gripper, gap: &mut f64, block: f64, seconds: f64) {
        for _ in 0..(seconds / DT) as usize {
            let d = g.step(DT, *gap);
            let step = (d.gap - *gap).clamp(-d.speed * DT, d.speed * DT);
            *gap = (*gap + step).max(block);
        }
    }

    fn go(position: u8) -> GripperRequest {
        GripperRequest {
            activate: true,
            go_to: true,
            position,
            speed: 255,
            force: 100,
            ..Default::default()
        }
    }

    #[test]
    fn counts_and_gaps() {
        assert_eq!((count_of_gap(STROKE), count_of_gap(0.0)), (3, 230));
        assert!((gap_of_count(0) - STROKE).abs() < 1e-4 && gap_of_count(255) < 0.0011);
        for c in 3..=230 {
            assert_eq!(count_of_gap(gap_of_count(c)), c);
        }
        assert!(
            (force_of_count(0) - 20.0).abs() < 1e-9 && (force_of_count(255) - 235.0).abs() < 1e-9
        );
    }

    #[test]
    fn a_trembling_grip_is_a_contact_and_slow_fingers_are_not() {
        let (mut g, mut gap) = (Gripper::new(), STROKE);
        g.set_request(GripperRequest { activate: true, ..Default::default() });
        run(&mut g, &mut gap, 0.0, 1.0);
        g.set_request(GripperRequest { speed: 0, ..go(255) });
        run(&mut g, &mut gap, 0.030, 1.0);
        assert_eq!(g.status().object, ObjectStatus::Moving, "at the lowest speed");
        run(&mut g, &mut gap, 0.030, 2.0);
        // 0.1 mm to and fro at 25 Hz: faster than fingers that close slowly.
        for i in 0..250 {
            let wave = (std::f64::consts::TAU * 25.0 * DT * f64::from(i)).sin();
            g.step(DT, 0.030 + 1e-4 * wave);
        }
        assert_eq!(g.status().object, ObjectStatus::ContactClosing);
    }

    #[test]
    fn activation_then_go_to_then_contact() {
        let (mut g, mut gap) = (Gripper::new(), STROKE);
        g.set_request(go(255));
        g.set_request(GripperRequest { activate: false, ..go(255) });
        run(&mut g, &mut gap, 0.0, 0.2);
        assert_eq!((g.status().activation, g.status().fault), (Activation::Reset, 7));
        assert!((gap - STROKE).abs() < 1e-9, "not activated: it does not move");

        g.set_request(GripperRequest { activate: true, ..Default::default() });
        run(&mut g, &mut gap, 0.0, 0.1);
        assert_eq!(g.status().activation, Activation::Activating);
        run(&mut g, &mut gap, 0.0, 1.0);
        assert_eq!(g.status().activation, Activation::Active);

        g.set_request(go(255));
        assert_eq!(g.status().object, ObjectStatus::Moving);
        run(&mut g, &mut gap, 0.064, 0.05);
        assert_eq!(g.status().object, ObjectStatus::Moving);
        run(&mut g, &mut gap, 0.064, 0.6);
        assert_eq!(g.status().object, ObjectStatus::ContactClosing);
        // The object is pulled out: the fingers go on and reach the request.
        run(&mut g, &mut gap, 0.0, 1.0);
        assert_eq!((g.status().object, g.status().position), (ObjectStatus::AtPosition, 230));

        g.set_request(go(0));
        run(&mut g, &mut gap, 0.0, 1.0);
        assert_eq!((g.status().object, g.status().position), (ObjectStatus::AtPosition, 3));
    }
}
