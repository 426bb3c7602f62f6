//! Figures of merit and how they are shown: trial results and their summary, tracking errors,
//! percentiles and confidence intervals, report pages with plots.

pub mod campaign;
mod closed_loop;
mod page;
mod plot;
mod statistics;
mod stream;
pub mod table2;
pub mod text_to_mask;
mod tracking;
pub mod tracking_synthetic;

pub use closed_loop::{
    ClosedLoopReport, ClosedLoopSummary, Fault, LatencyFigures, STOLEN_MS, Trial,
};
pub use page::Page;
pub use plot::{LinePlot, Series, TopView};
pub use statistics::{percentile, wilson_interval};
pub use stream::{MotionSample, PredictedPath, StreamFigures, StreamStatistics};
pub use tracking::{TrackingFrame, TrackingReport, TrackingSummary};
