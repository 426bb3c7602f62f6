//! When a procedure is done: a classifier on the history, and the machine that owns the procedure
//! number.

mod checkpoint;
mod core;
mod policy;
mod progress;
mod train;

pub use self::core::{SwitchConfig, SwitchCore, SwitchGuard, SwitchState};
pub use policy::SwitchPolicy;
pub use progress::train_progress;
pub use train::{SwitchReport, SwitchTrainConfig, train_switch, train_switch_tasks};
