use crate::arguments::RecordArgs;
use std::time::{Duration, Instant};
use tdv_runtime::record::Recorder;
use tdv_runtime::trial::shutdown_on_signals;
use tdv_runtime::{Arguments, Environment, Node, Resolver};

/// Records until Ctrl-C, SIGTERM or the end of the time.
pub fn run(args: &RecordArgs) -> anyhow::Result<()> {
    let shutdown = shutdown_on_signals()?;
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    runtime.block_on(async {
        let resolver = Resolver::new("tdv_record", &Arguments::default())?;
        let node = Node::new(resolver, Environment::read()?, false)?;
        let wanted = (!args.topics.is_empty()).then(|| args.topics.clone());
        let recorder = Recorder::create(&node, &args.output, wanted)?;
        println!("recording into {}; Ctrl-C ends it", args.output.display());
        let began = Instant::now();
        let limit = args.duration.map(Duration::try_from_secs_f64).transpose()?;
        let recording = recorder
            .run(|| shutdown.is_requested() || limit.is_some_and(|l| began.elapsed() > l))
            .await?;
        node.leave();
        crate::bag::info(&recording.path)?;
        crate::eval::tell_dropped(&recording);
        Ok(())
    })
}
