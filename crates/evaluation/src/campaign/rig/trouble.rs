//! The trouble and what an operator does about it.

use super::{FaultKind, MOVING, REST, Rig, Stage, new_controller, new_driver};
use rand::Rng;
use tdv_robot::motion::StatusCode;
use tdv_simulation::controller::{RobotMode, SafetyMode, StopReason};
use tdv_simulation::world::DT;

impl Rig {
    /// Begins and ends the trouble, and does what an operator does after a stop.
    pub(super) fn stage_fault(&mut self) {
        let t = self.time();
        match self.stage {
            Stage::Before => {
                if self.fastest() > MOVING {
                    self.moved_for += DT;
                }
                let ready = self.moved_for > self.fault.after && self.fastest() > MOVING;
                if ready && (self.fault.kind != FaultKind::Slip || self.held) {
                    self.begin_fault(t);
                }
            }
            Stage::During { since } => {
                if self.fastest() < REST {
                    self.rest_since.get_or_insert(t);
                } else {
                    self.rest_since = None;
                }
                self.backed_off |= self.status == Some(StatusCode::Retreating);
                self.result.sentence.clone_from(&self.sentence);
                if t - since >= self.duration() {
                    self.result.lasted = t - since;
                    self.result.rest_s = self.rest_since.map(|r| r - since);
                    // Backing off needs no prediction: the arm may go on.
                    let due = self.fault.kind.rest_due().filter(|_| !self.backed_off);
                    self.result.rest_due = due.filter(|due| t - since > due + 0.05);
                    self.stage = Stage::After;
                    self.end_fault();
                }
            }
            Stage::After => {}
        }
        self.operate();
    }

    fn duration(&self) -> f64 {
        match self.fault.kind {
            // As long as the robot insists on.
            FaultKind::ProtectiveStop => 5.5,
            FaultKind::EmergencyStop | FaultKind::SpeedSlider => self.fault.lasts.max(1.0),
            _ => self.fault.lasts,
        }
    }

    fn begin_fault(&mut self, t: f64) {
        self.stage = Stage::During { since: t };
        self.result.speed = self.fastest();
        let c = self.lab.controller_mut();
        match self.fault.kind {
            FaultKind::ProtectiveStop => c.protect(StopReason::Asked),
            FaultKind::EmergencyStop => c.set_safety(SafetyMode::RobotEmergencyStop),
            FaultKind::SpeedSlider => c.set_speed_fraction(0.01),
            FaultKind::Slip => self.lab.make_slippery(0.5),
            FaultKind::Late => self.plans.clear(),
            _ => {}
        }
    }

    fn end_fault(&mut self) {
        let c = self.lab.controller_mut();
        match self.fault.kind {
            FaultKind::ProtectiveStop => {
                if let Err(e) = c.unlock() {
                    self.result.violations.push(format!("unlock: {e}"));
                }
            }
            FaultKind::EmergencyStop => {
                c.set_safety(SafetyMode::Normal);
                if c.power_on(true).is_err() {
                    self.result.violations.push("power on refused".into());
                }
            }
            FaultKind::SpeedSlider => c.set_speed_fraction(1.0),
            FaultKind::ControllerKilled => self.controller = new_controller(),
            FaultKind::DriverKilled => {
                self.driver = new_driver(&self.limits);
                self.heartbeat = self.rng.random_range(0..1000);
            }
            _ => {}
        }
    }

    /// The driver sends its program anew where none runs and the robot is ready; a latched fault of the
    /// driver is reset by the operator once the arm rests.
    fn operate(&mut self) {
        let c = self.lab.controller();
        let ready = c.robot_mode() == RobotMode::Running && c.safety_mode() == SafetyMode::Normal;
        let stopped = self.has(FaultKind::ProtectiveStop) || self.has(FaultKind::EmergencyStop);
        if ready && !c.program_running() && !stopped && self.fastest() < REST {
            self.lab.controller_mut().stop_program();
            self.upload();
        }
        if self.driver.fault().is_some() && self.fastest() < REST {
            self.driver.reset();
        }
    }
}
