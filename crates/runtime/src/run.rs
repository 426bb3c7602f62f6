//! From `main` to the exit code.

use crate::args::{Arguments, Usage};
use crate::logging;
use crate::names::Resolver;
use crate::node::Node;
use crate::parameters::{Parameters, Params, Store, load, serve};
use crate::qos::Qos;
use crate::shutdown::{Reason, Shutdown};
use crate::{Environment, convert_time};
use std::future::Future;
use std::io::Write;
use std::process::ExitCode;
use std::time::Duration;
use tdv_msgs::diagnostic_msgs::msg::DiagnosticArray;
use tokio::signal::unix::{SignalKind, signal};

/// How long a body may take to end by itself after it was asked to.
const GRACE: Duration = Duration::from_secs(2);

/// Exit code for bad input or a failure at run time.
const FAILURE: u8 = 1;
/// Exit code for bad arguments, parameters or environment.
const BAD_ARGUMENTS: u8 = 2;

/// Runs a node: parses the process arguments, loads the parameters, starts logging, joins the graph,
/// serves parameters and diagnostics, runs `body` on a tokio runtime, and leaves the graph on SIGINT,
/// SIGTERM, [`Shutdown::request`] or the end of the body.
///
/// Exit code: 0 after a signal or when the body returns `Ok`, 1 when it returns an error, panics or
/// [`Shutdown::fail`] was called, 2 for bad arguments, parameters or environment. `--help` prints the
/// usage and all parameters with their defaults.
pub fn run<P, F, B>(default_name: &str, body: F) -> ExitCode
where
    P: Parameters,
    F: FnOnce(Node, Params<P>) -> B,
    B: Future<Output = anyhow::Result<()>> + Send + 'static,
{
    let arguments = match Arguments::parse(std::env::args()) {
        Ok(arguments) => arguments,
        Err(error) => return complain(default_name, BAD_ARGUMENTS, &error),
    };
    if arguments.help {
        return help::<P>(default_name);
    }
    if let Err(error) = arguments.expect_no_rest() {
        return complain(default_name, BAD_ARGUMENTS, &error);
    }
    run_with(default_name, &arguments, body)
}

/// [`run`] with arguments from elsewhere; leftover arguments are the caller's.
pub fn run_with<P, F, B>(default_name: &str, arguments: &Arguments, body: F) -> ExitCode
where
    P: Parameters,
    F: FnOnce(Node, Params<P>) -> B,
    B: Future<Output = anyhow::Result<()>> + Send + 'static,
{
    let resolver = match Resolver::new(default_name, arguments) {
        Ok(resolver) => resolver,
        Err(error) => return complain(default_name, BAD_ARGUMENTS, &error),
    };
    let loaded = match load::<P>(resolver.node(), resolver.namespace(), arguments) {
        Ok(loaded) => loaded,
        Err(error) => return complain(default_name, BAD_ARGUMENTS, &error),
    };
    let environment = match Environment::read() {
        Ok(environment) => environment,
        Err(error) => return complain(default_name, BAD_ARGUMENTS, &error),
    };
    logging::init(resolver.node(), arguments);
    let runtime =
        match tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build() {
            Ok(runtime) => runtime,
            Err(error) => return complain(default_name, FAILURE, &error),
        };
    let name = resolver.fully_qualified();
    let result = runtime.block_on(async {
        let node = Node::new(resolver, environment, loaded.use_sim_time)?;
        watch_signals(node.shutdown().clone())?;
        let (store, params) = Store::new(loaded.values, loaded.use_sim_time);
        let result = match start_standard_services(&node, store) {
            Ok(()) => drive(&node, body(node.clone(), params)).await,
            Err(error) => Err(error),
        };
        logging::stop_publishing();
        node.leave();
        result
    });
    // Ends the tasks that hold publishers; threads must end by themselves.
    runtime.shutdown_timeout(GRACE);
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => complain(&name, FAILURE, &format!("{error:#}")),
    }
}

/// Runs the body until it ends or the end is asked for.
async fn drive(
    node: &Node,
    body: impl Future<Output = anyhow::Result<()>> + Send + 'static,
) -> anyhow::Result<()> {
    let shutdown = node.shutdown().clone();
    let mut body = tokio::spawn(body);
    let finished = tokio::select! {
        result = &mut body => Some(result),
        _ = shutdown.wait() => tokio::time::timeout(GRACE, &mut body).await.ok(),
    };
    body.abort();
    match finished {
        Some(Ok(result)) => result?,
        Some(Err(error)) if error.is_panic() => anyhow::bail!("the node panicked (see above)"),
        Some(Err(_)) | None => {}
    }
    match shutdown.reason() {
        Some(Reason::Failed(why)) => anyhow::bail!(why),
        Some(Reason::Asked(why)) => tracing::info!("ending: {why}"),
        None => {}
    }
    Ok(())
}

fn start_standard_services(node: &Node, store: Store) -> anyhow::Result<()> {
    let rosout = node.publisher("/rosout", Qos::latched_depth(100))?;
    logging::publish_to(rosout, node.clock().clone(), node.name().to_string());
    serve(node, store)?;
    let publisher = node.publisher::<DiagnosticArray>("/diagnostics", Qos::reliable(10))?;
    let n = node.clone();
    node.spawn("diagnostics", async move {
        let name = n.fully_qualified_name();
        let mut ticks = tokio::time::interval(Duration::from_secs(1));
        loop {
            ticks.tick().await;
            let mut message = DiagnosticArray::default();
            message.header.stamp = convert_time(n.now());
            message.status.push(n.diagnostics().status(&name));
            publisher.publish(message);
        }
    });
    Ok(())
}

/// The first signal asks for the end, the second one enforces it.
fn watch_signals(shutdown: Shutdown) -> std::io::Result<()> {
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    tokio::spawn(async move {
        let mut count = 0;
        loop {
            let name = tokio::select! {
                _ = interrupt.recv() => "SIGINT",
                _ = terminate.recv() => "SIGTERM",
            };
            count += 1;
            if count == 2 {
                std::process::exit(i32::from(FAILURE));
            }
            shutdown.request(name);
        }
    });
    Ok(())
}

fn complain(name: &str, code: u8, error: &dyn std::fmt::Display) -> ExitCode {
    let _ = writeln!(std::io::stderr(), "{}: {error}", name.trim_start_matches('/'));
    ExitCode::from(code)
}

fn help<P: Parameters>(name: &str) -> ExitCode {
    let mut text = format!("{}\n\nparameters (* may change at run time):\n", Usage(name));
    for (parameter, default, description, live) in parameter_table::<P>() {
        let mark = if live { '*' } else { ' ' };
        text.push_str(&format!("{mark} {parameter} = {default}"));
        if !description.is_empty() {
            text.push_str(&format!("  # {description}"));
        }
        text.push('\n');
    }
    match std::io::stdout().write_all(text.as_bytes()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(_) => ExitCode::from(FAILURE),
    }
}

/// (name, default as JSON, description, may change at run time) of every parameter: for help texts
/// and README tables.
pub fn parameter_table<P: Parameters>() -> Vec<(String, String, String, bool)> {
    let (store, _) = Store::new(P::default(), false);
    let tree = serde_json::to_value(P::default()).unwrap_or_default();
    let value = |name: &str| {
        tree.pointer(&format!("/{}", name.replace('.', "/")))
            .map_or_else(|| "false".to_string(), ToString::to_string)
    };
    store
        .names()
        .into_iter()
        .map(|name| {
            let descriptor = store.describe(&name);
            (name.clone(), value(&name), descriptor.description, !descriptor.read_only)
        })
        .collect()
}
