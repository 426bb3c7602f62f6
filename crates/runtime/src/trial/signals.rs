//! SIGINT and SIGTERM for programs that are not a node.

use crate::Shutdown;
use tokio::signal::unix::{SignalKind, signal};

/// From now on the first SIGINT or SIGTERM asks for the end, the second one enforces it (exit code 1).
/// The watch runs on a thread of its own until the process ends: a signal that comes between two trials
/// counts too.
///
/// # Errors
/// The system refuses the handlers or the thread.
pub fn shutdown_on_signals() -> std::io::Result<Shutdown> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
    let (mut interrupt, mut terminate) = {
        let _inside = runtime.enter();
        (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?)
    };
    let shutdown = Shutdown::default();
    let asked = shutdown.clone();
    let watch = async move {
        loop {
            let name = tokio::select! {
                _ = interrupt.recv() => "SIGINT",
                _ = terminate.recv() => "SIGTERM",
            };
            if asked.is_requested() {
                std::process::exit(1);
            }
            asked.request(name);
        }
    };
    std::thread::Builder::new().name("signals".into()).spawn(move || runtime.block_on(watch))?;
    Ok(shutdown)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Reason;
    use std::time::Duration;

    #[tokio::test]
    async fn sigterm_asks_for_the_end() {
        let shutdown = shutdown_on_signals().unwrap();
        assert!(!shutdown.is_requested());
        // SAFETY: raise() has no memory effects; the handler has been set.
        unsafe {
            libc::raise(libc::SIGTERM);
        }
        let reason = tokio::time::timeout(Duration::from_secs(20), shutdown.wait()).await.unwrap();
        assert_eq!(reason, Reason::Asked("SIGTERM".into()));
    }
}
