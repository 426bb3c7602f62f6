//! Learning to move an object from poses alone: the trajectory diffusion policy and the switch
//! policy, their training and their inference.
//!
//! A policy sees the last poses of the moving frame in the reference frame (`T_reference_moving`),
//! the task's text and the number of the procedure, and predicts the poses that shall follow. See
//! [`train()`], [`TrainedPolicy`], [`Planner`], [`HistoryBuffer`]; [`train_switch`], [`SwitchPolicy`],
//! [`SwitchCore`].

mod allocator;
mod checkpoint;
mod config;
mod error;
mod history;
pub mod kernels;
pub mod log;
pub mod network;
mod normaliser;
mod observer;
mod open_loop;
mod planner;
#[cfg(any(test, feature = "candle"))]
pub mod reference;
pub mod rng;
pub mod rollout;
mod samples;
mod schedule;
mod switch;
pub mod synthetic;
mod tasks;
mod tensors;
pub mod text;
mod train;

pub use allocator::tune_allocator;
pub use checkpoint::TrainedPolicy;
pub use config::{PolicyConfig, Prediction, Sampler, TrainConfig};
pub use error::{CheckpointProblem, PolicyError};
pub use history::{HistoryBuffer, HistoryConfig, HistoryError, Pushed};
pub use normaliser::{Normaliser, POSE_DIM};
pub use observer::{Observation, Observer, ObserverError};
pub use open_loop::{OpenLoop, OpenLoopError};
pub use planner::{Planner, PlannerConfig};
pub use samples::{ProcedureData, TrainingSet};
pub use schedule::{SamplingPlan, SamplingStep, Schedule};
pub use switch::{
    SwitchConfig, SwitchCore, SwitchGuard, SwitchPolicy, SwitchReport, SwitchState,
    SwitchTrainConfig, train_progress, train_switch, train_switch_tasks,
};
pub use tasks::LearnedTask;
pub use train::{TrainProgress, Training, train, train_tasks};
