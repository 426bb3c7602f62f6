use crate::arguments::GraphArgs;
use std::collections::BTreeSet;
use std::time::Duration;
use tdv_runtime::{Arguments, Environment, Node, Resolver};

/// Topics that every node has and that say nothing about the graph.
const COMMON: [&str; 4] = ["/rosout", "/parameter_events", "/diagnostics", "/ros_discovery_info"];

/// Prints the running graph.
pub fn run(args: &GraphArgs) -> anyhow::Result<()> {
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    let graph = runtime.block_on(async {
        let environment = Environment::read()?;
        let resolver = Resolver::new("tdv_graph", &Arguments::default())?;
        let node = Node::new(resolver, environment, false)?;
        let observer = node.observe_graph()?;
        tokio::time::sleep(Duration::try_from_secs_f64(args.wait)?).await;
        let graph = observer.snapshot();
        node.leave();
        anyhow::Ok((environment, graph))
    })?;
    let (environment, graph) = graph;
    eprintln!(
        "domain {}, {:?}: {} nodes",
        environment.domain,
        environment.range,
        graph.nodes.len()
    );
    println!("flowchart TD");
    let id = |name: &str| name.trim_start_matches('/').replace('/', "_");
    for node in &graph.nodes {
        println!("  {}([{node}])", id(node));
    }
    let mut edges = BTreeSet::new();
    for (topic, info) in graph.topics.iter().filter(|(t, _)| !COMMON.contains(&t.as_str())) {
        for from in &info.publishers {
            for to in info.subscribers.iter().filter(|to| *to != from) {
                edges.insert(format!("  {} -- {topic} --> {}", id(from), id(to)));
            }
        }
    }
    for edge in edges {
        println!("{edge}");
    }
    Ok(())
}
