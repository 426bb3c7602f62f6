//! The smallest complete node: a parameter that may change live, a topic in, a topic out, a service.
//!
//! `cargo run -p tdv-runtime --example minimal_node -- --ros-args -p prefix:=heard`

use serde::{Deserialize, Serialize};
use std::process::ExitCode;
use tdv_msgs::std_msgs::msg::String as Text;
use tdv_msgs::std_srvs::srv::{Trigger, TriggerResponse};
use tdv_runtime::{Level, Node, Parameters, Params, Qos};

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct EchoParameters {
    prefix: String,
}

impl Default for EchoParameters {
    fn default() -> Self {
        Self { prefix: "I heard".into() }
    }
}

impl Parameters for EchoParameters {
    fn validate(&self) -> Vec<String> {
        let empty = self.prefix.is_empty();
        if empty { vec!["'prefix' must not be empty".into()] } else { vec![] }
    }
    fn live() -> &'static [&'static str] {
        &["prefix"]
    }
    fn describe(name: &str) -> &'static str {
        if name == "prefix" { "put in front of what was heard" } else { "" }
    }
}

async fn body(node: Node, params: Params<EchoParameters>) -> anyhow::Result<()> {
    let echo = node.publisher::<Text>("~/echo", Qos::reliable(10))?;
    let mut chatter = node.newest::<Text>("chatter", Qos::reliable(10))?;
    node.service::<Trigger, _, _>("~/greet", |_request| async {
        TriggerResponse { success: true, message: "hello".into() }
    })?;
    node.diagnostics().level(Level::Ok, "listening");
    while let Some(message) = chatter.recv().await {
        echo.publish(Text { data: format!("{}: {}", params.get().prefix, message.data) });
    }
    Ok(())
}

fn main() -> ExitCode {
    tdv_runtime::run("echo", body)
}
