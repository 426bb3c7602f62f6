//! What the threads of the driver share.

use std::sync::{Mutex, MutexGuard, PoisonError};
use tdv_geometry::Stamp;
use tdv_robot::{
    Desired, ExecutorParams, JointTrajectory, JointTrajectoryExecutor, Joints, Limits, TargetGuard,
    TrajectoryRejection,
};

/// The commanding side: accepted trajectory, last check, and whether the robot may be commanded.
pub struct Commands {
    executor: JointTrajectoryExecutor,
    guard: TargetGuard,
    measured: Option<Joints>,
    /// Set by a refused target; cleared by the next accepted trajectory.
    fault: Option<String>,
}

/// Shared between the ROS tasks and the RTDE thread.
pub struct Shared(Mutex<Commands>);

impl Shared {
    pub fn new(limits: &Limits) -> Self {
        Self(Mutex::new(Commands {
            executor: JointTrajectoryExecutor::new(ExecutorParams {
                lower: limits.joint_lower,
                upper: limits.joint_upper,
                ..Default::default()
            }),
            guard: TargetGuard::new(limits),
            measured: None,
            fault: None,
        }))
    }

    fn lock(&self) -> MutexGuard<'_, Commands> {
        // Each change below is complete before the lock is released.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A trajectory from the topic; refused before the first measured state.
    pub fn accept(&self, trajectory: &JointTrajectory, now: Stamp) -> Result<(), String> {
        let mut c = self.lock();
        let Some(measured) = c.measured else {
            return Err("no state of the robot yet".into());
        };
        let current = Desired { q: measured, qd: [0.0; 6] };
        c.executor
            .accept(trajectory, now, &current)
            .map_err(|e: TrajectoryRejection| e.to_string())?;
        c.fault = None;
        Ok(())
    }

    /// The joint target for now, or why there is none. While the robot `may_move` not (stopped, paused,
    /// no program) what was commanded is forgotten: it must not come back when the robot may again.
    pub fn target(
        &self,
        now: Stamp,
        measured: Joints,
        may_move: bool,
    ) -> Result<Option<Joints>, String> {
        let mut c = self.lock();
        c.measured = Some(measured);
        if !may_move {
            c.executor.clear();
            c.guard.reset();
            return Ok(None);
        }
        if let Some(fault) = &c.fault {
            return Err(fault.clone());
        }
        let Some(desired) = c.executor.sample(now) else { return Ok(None) };
        match c.guard.check(now, &desired.q, &measured) {
            Ok(()) => Ok(Some(desired.q)),
            Err(error) => {
                // Stop where the arm is: the program on the controller decelerates by itself.
                c.executor.clear();
                c.guard.reset();
                c.fault = Some(error.to_string());
                Err(error.to_string())
            }
        }
    }

    /// The connection was lost: the next motion starts from the measured state.
    pub fn forget(&self) {
        let mut c = self.lock();
        c.executor.clear();
        c.guard.reset();
        c.measured = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_robot::{JOINT_NAMES, TrajectoryPoint};

    fn to(q: f64) -> JointTrajectory {
        JointTrajectory {
            names: JOINT_NAMES.map(String::from).to_vec(),
            stamp: None,
            points: vec![TrajectoryPoint {
                positions: vec![q; 6],
                velocities: vec![0.0; 6],
                time_from_start: 0.2,
                ..Default::default()
            }],
        }
    }

    #[test]
    fn nothing_moves_before_the_first_state_or_after_a_jump() {
        let shared = Shared::new(&Limits::default());
        let t = Stamp::from_secs(1.0);
        assert!(shared.accept(&to(0.05), t).is_err());
        assert_eq!(shared.target(t, [0.0; 6], true), Ok(None));
        shared.accept(&to(0.05), t).unwrap();
        assert!(shared.target(t.plus(0.1), [0.0; 6], true).unwrap().is_some());
        // 2 rad in 0.2 s is faster than any limit: refused, and it stays refused until told anew.
        shared.accept(&to(2.0), t.plus(0.1)).unwrap();
        assert!(
            (0..30).any(|i| shared
                .target(t.plus(0.1 + 0.008 * f64::from(i)), [0.0; 6], true)
                .is_err())
        );
        assert!(shared.target(t.plus(1.0), [0.0; 6], true).is_err());
        shared.accept(&to(0.01), t.plus(1.0)).unwrap();
        assert!(shared.target(t.plus(1.01), [0.0; 6], true).unwrap().is_some());
        // A stop forgets the target for good.
        assert_eq!(shared.target(t.plus(1.02), [0.0; 6], false), Ok(None));
        assert_eq!(shared.target(t.plus(1.03), [0.0; 6], true), Ok(None));
        shared.forget();
        assert!(shared.accept(&to(0.0), t.plus(2.0)).is_err());
    }
}
