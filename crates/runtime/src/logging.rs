//! Log lines to standard error and to `/rosout`.

use crate::args::Arguments;
use crate::clock::Clock;
use crate::node::lock;
use crate::topics::Publisher;
use std::fmt::Write as _;
use std::io::IsTerminal;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use tdv_msgs::rcl_interfaces::msg::Log;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Metadata, Subscriber};
use tracing_subscriber::filter::filter_fn;
use tracing_subscriber::layer::{Context, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer};

/// Where `/rosout` lines go once the node exists.
static ROSOUT: Mutex<Option<Rosout>> = Mutex::new(None);

struct Rosout {
    publisher: Publisher<Log>,
    clock: Clock,
    name: String,
}

/// The middleware's own chatter, kept down unless asked for.
const QUIET: [&str; 2] = ["rustdds", "ros2_client"];

/// Starts logging: `RUST_LOG` if set, else `--log-level`, else `info`. A second call does nothing.
pub fn init(node: &str, arguments: &Arguments) {
    let filter = match std::env::var("RUST_LOG") {
        Ok(text) if !text.is_empty() => EnvFilter::new(text),
        _ => EnvFilter::new(directives(node, &arguments.log_levels)),
    };
    let terminal = std::io::stderr().is_terminal();
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(std::io::stderr)
        .with_ansi(terminal)
        .with_target(false);
    // An error means that a test or an embedding program has already set up logging: use that.
    let _ = tracing_subscriber::registry()
        .with(filter)
        .with(filter_fn(wanted))
        .with(lines)
        .with(RosoutLayer)
        .try_init();
}

fn directives(node: &str, levels: &[(String, String)]) -> String {
    let mut default = "info";
    let mut out = String::new();
    for (logger, level) in levels {
        if logger.is_empty() || logger == node {
            default = level;
        } else {
            let _ = write!(out, ",{}={level}", logger.replace('.', "::"));
        }
    }
    for target in QUIET {
        if !levels.iter().any(|(logger, _)| logger == target) {
            let _ = write!(out, ",{target}=error");
        }
    }
    format!("{default}{out}")
}

/// From now on log lines go to `/rosout` too.
pub(crate) fn publish_to(publisher: Publisher<Log>, clock: Clock, name: String) {
    *lock(&ROSOUT) = Some(Rosout { publisher, clock, name });
}

/// The node leaves the graph: log lines no longer go to `/rosout`, where a publisher would keep the
/// participant alive, and the middleware's last words are dropped.
pub(crate) fn stop_publishing() {
    LEAVING.store(true, Ordering::Relaxed);
    drop(lock(&ROSOUT).take());
}

/// Set while the participant is taken down.
static LEAVING: AtomicBool = AtomicBool::new(false);

/// While leaving, the middleware complains about parts of itself that are already gone.
fn wanted(meta: &Metadata<'_>) -> bool {
    !(LEAVING.load(Ordering::Relaxed) && QUIET.iter().any(|t| meta.target().starts_with(t)))
}

struct RosoutLayer;

impl<S: Subscriber> Layer<S> for RosoutLayer {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let meta = event.metadata();
        // Lines from inside the middleware would come back to it, while the lock is held.
        if QUIET.iter().any(|t| meta.target().starts_with(t)) || meta.target() == "log" {
            return;
        }
        let guard = lock(&ROSOUT);
        let Some(rosout) = guard.as_ref() else { return };
        let level = match *meta.level() {
            Level::ERROR => Log::ERROR,
            Level::WARN => Log::WARN,
            Level::INFO => Log::INFO,
            _ => Log::DEBUG,
        };
        let mut text = Text(String::new());
        event.record(&mut text);
        // Not through `Publisher::publish`, which logs.
        let _ = rosout.publisher.inner.publish(Log {
            stamp: crate::convert_time(rosout.clock.now()),
            level,
            name: rosout.name.clone(),
            msg: text.0,
            file: meta.file().unwrap_or_default().into(),
            function: meta.module_path().unwrap_or_default().into(),
            line: meta.line().unwrap_or_default(),
        });
    }
}

struct Text(String);

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        let _ = match (field.name(), self.0.is_empty()) {
            ("message", true) => write!(self.0, "{value:?}"),
            ("message", false) => {
                self.0.insert_str(0, &format!("{value:?} "));
                Ok(())
            }
            (name, true) => write!(self.0, "{name}={value:?}"),
            (name, false) => write!(self.0, " {name}={value:?}"),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filters() {
        let pair = |a: &str, b: &str| (a.to_string(), b.to_string());
        assert_eq!(directives("n", &[]), "info,rustdds=error,ros2_client=error");
        assert_eq!(
            directives("n", &[pair("n", "debug"), pair("rustdds", "warn"), pair("a.b", "error")]),
            "debug,rustdds=warn,a::b=error,ros2_client=error"
        );
    }
}
