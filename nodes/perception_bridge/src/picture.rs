//! `~/overlay`: what is seen, as a picture for people; made only while somebody looks.

use std::sync::Arc;
use std::time::{Duration, Instant};
use tdv_msgs::sensor_msgs::msg::Image;
use tdv_msgs::std_msgs::msg::Header;
use tdv_perception::{ObjectModel, Perceiver, PerceptionOutput, RgbdFrame, overlay};
use tdv_runtime::{Node, Publisher, Qos, convert};

const TOPIC: &str = "/perception_bridge/overlay";
/// Between two looks at who subscribes.
const LOOK: Duration = Duration::from_millis(500);
/// Between two pictures: people see no difference, and the poses must not wait.
const PERIOD: Duration = Duration::from_millis(95);

pub struct Picture {
    node: Node,
    publisher: Publisher<Image>,
    models: Vec<Arc<ObjectModel>>,
    backend: String,
    looked: Option<Instant>,
    wanted: bool,
    drawn: Option<Instant>,
}

impl Picture {
    pub fn new(node: &Node, backend: &str, perceiver: &Perceiver) -> anyhow::Result<Self> {
        Ok(Self {
            node: node.clone(),
            publisher: node.publisher(TOPIC, Qos::best_effort(2))?,
            models: perceiver.models().collect(),
            backend: backend.to_owned(),
            looked: None,
            wanted: false,
            drawn: None,
        })
    }

    /// Draws and publishes, if somebody looks; `seconds` went into the result.
    pub fn show(
        &mut self,
        header: &Header,
        frame: &RgbdFrame,
        output: &PerceptionOutput,
        seconds: f64,
    ) {
        if self.looked.is_none_or(|t| t.elapsed() > LOOK) {
            self.wanted = self.node.has_readers(TOPIC).unwrap_or(false);
            self.looked = Some(Instant::now());
        }
        if !self.wanted || self.drawn.is_some_and(|t| t.elapsed() < PERIOD) {
            return;
        }
        let began = Instant::now();
        let table = if output.table.is_some() { "table seen" } else { "no table" };
        let status = format!(
            "{} {:.0} ms, {table}, {}",
            self.backend,
            1e3 * seconds,
            if output.stale_depth { "depth is stale".into() } else { output.depth.to_string() }
        );
        let picture = overlay::draw(frame, output, &self.models, &status);
        self.publisher.publish(convert::image_from_color(&picture, header.clone()));
        self.node.diagnostics().latency("overlay", began.elapsed().as_secs_f64());
        self.drawn = Some(began);
    }
}
