//! The topics of Isaac ROS FoundationPose, one estimator node for each object: images and masks out, poses
//! back. Estimators pair their inputs by equal stamps, so that all four carry the frame's.

use crate::params::RemoteParameters;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tdv_msgs::sensor_msgs::msg::{CameraInfo, Image};
use tdv_msgs::std_msgs::msg::Header;
use tdv_msgs::vision_msgs::msg::Detection3DArray;
use tdv_perception::remote::{Answer, RemotePoses, Verdict};
use tdv_perception::{FrameError, Perceiver, PerceptionOutput, RgbdFrame};
use tdv_runtime::{Inbox, Node, Publisher, Qos, convert, inbox, tracked};

/// What Isaac's nodes offer by default; theirs are reliable too.
const QOS: Qos = Qos::reliable(2);

/// The remote estimators as one perceiver.
pub struct Remote {
    node: Node,
    poses: RemotePoses,
    patience: Duration,
    image: Publisher<Image>,
    depth: Publisher<Image>,
    info: Publisher<CameraInfo>,
    masks: Vec<Publisher<Image>>,
    answers: Inbox<(usize, Detection3DArray)>,
}

impl Remote {
    /// Publishes and subscribes everything for the objects of `perceiver`.
    pub fn new(node: &Node, p: &RemoteParameters, perceiver: &Perceiver) -> anyhow::Result<Self> {
        let ns = &p.namespace;
        let (sender, answers) = inbox(64);
        let sender = Arc::new(sender);
        let mut masks = Vec::new();
        for (i, name) in perceiver.names().into_iter().enumerate() {
            let topic = format!("{ns}/{name}/pose_estimation/segmentation");
            masks.push(node.publisher(&topic, QOS)?);
            // The first pose comes from one node, all others from another.
            for source in ["pose_estimation", "tracking"] {
                let sender = sender.clone();
                let topic = format!("{ns}/{name}/{source}/output");
                node.subscribe(&topic, Qos::best_effort(10), move |m: Detection3DArray| {
                    sender.send((i, m));
                })?;
            }
        }
        Ok(Self {
            node: node.clone(),
            poses: RemotePoses::new(p.belief.clone(), perceiver),
            patience: Duration::from_secs_f64(p.patience),
            image: node.publisher(&format!("{ns}/pose_estimation/image"), QOS)?,
            depth: node.publisher(&format!("{ns}/pose_estimation/depth_image"), QOS)?,
            info: node.publisher(&format!("{ns}/pose_estimation/camera_info"), QOS)?,
            masks,
            answers,
        })
    }

    /// Forgets all poses. The estimators register anew by themselves (`reset_period`).
    pub fn forget(&mut self) {
        self.poses.forget();
    }

    /// Asks about a frame and waits for the answers, for as long as patience lasts.
    pub fn step(
        &mut self,
        header: &Header,
        frame: &RgbdFrame,
    ) -> Result<PerceptionOutput, FrameError> {
        let requests = self.poses.begin(frame, &header.frame_id)?;
        let began = Instant::now();
        if !requests.is_empty() {
            self.image.publish(convert::image_from_color(&frame.color, header.clone()));
            self.depth.publish(convert::image_from_depth_in_metres(&frame.depth, header.clone()));
            self.info.publish(convert::info_from_intrinsics(&frame.intrinsics, header.clone()));
        }
        for request in requests {
            let (width, height) = frame.color.dimensions();
            let mask = convert::image_from_labels(width, height, &request.mask, header.clone());
            if let Some(publisher) = self.masks.get(request.object) {
                publisher.publish(mask);
            }
        }
        while self.poses.is_waiting() {
            let left = self.patience.saturating_sub(began.elapsed());
            if left.is_zero() || self.node.shutdown().is_requested() {
                break;
            }
            let slice = left.min(Duration::from_millis(100));
            if let Some((object, message)) = self.answers.recv_timeout(slice) {
                self.take(object, &message, began);
            }
        }
        let output = self.poses.finish(frame, began.elapsed().as_secs_f64());
        self.report();
        output
    }

    fn take(&mut self, object: usize, message: &Detection3DArray, began: Instant) {
        let pose = match message.detections.first() {
            Some(d) => tracked::detection_parts(d).map(|(_, pose, _, _)| pose),
            None => Err("it holds no detection".into()),
        };
        let stamp = tracked::stamp(&message.header);
        let frame_id = message.header.frame_id.clone();
        match self.poses.answer(object, &Answer { stamp, frame_id, pose }) {
            Verdict::Taken => {
                self.node.diagnostics().latency("remote_answer", began.elapsed().as_secs_f64());
            }
            verdict => tracing::debug!("answer about object {object}: {verdict:?}"),
        }
    }

    fn report(&self) {
        let (counts, diagnostics) = (self.poses.counts(), self.node.diagnostics());
        for (key, count) in [
            ("remote_asked", counts.asked),
            ("remote_believed", counts.believed),
            ("remote_unanswered", counts.unanswered),
            ("remote_stale_answers", counts.stale),
            ("remote_wrong_frame", counts.wrong_frame),
            ("remote_unusable", counts.unusable),
            ("remote_disagreeing", counts.disagreeing),
        ] {
            diagnostics.set(key, count);
        }
    }
}
