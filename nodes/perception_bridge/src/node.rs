use crate::frames::Pairing;
use crate::params::BridgeParameters;
use anyhow::{Context as _, bail};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tdv_geometry::Stamp;
use tdv_msgs::sensor_msgs::msg::{CameraInfo, CompressedImage, Image};
use tdv_msgs::std_msgs::msg::Header;
use tdv_msgs::std_srvs::srv::{Trigger, TriggerResponse};
use tdv_msgs::vision_msgs::msg::Detection3DArray;
use tdv_perception::{Catalogue, ObjectModel, Perceiver, PerceptionOutput, RgbdFrame};
use tdv_rendering::{DepthImage, Intrinsics, RgbImage};
use tdv_runtime::{Inbox, Level, Node, Params, Publisher, Qos, Sender, convert, inbox, tracked};

/// Images as they came, decoded only when their turn comes.
enum ColorMessage {
    Raw(Image),
    Compressed(CompressedImage),
}

enum DepthMessage {
    Raw(Image),
    Compressed(CompressedImage),
}

type Pair = (Header, ColorMessage, DepthMessage);
type SharedPairing = Arc<Mutex<Pairing<ColorMessage, DepthMessage>>>;

struct Work {
    node: Node,
    params: BridgeParameters,
    perceiver: Perceiver,
    pairs: Inbox<Pair>,
    camera_info: Inbox<CameraInfo>,
    intrinsics: Option<Intrinsics>,
    again: Arc<AtomicBool>,
    detections: Publisher<Detection3DArray>,
    segmentation: Option<Publisher<Image>>,
    frozen: Option<PerceptionOutput>,
}

fn models(params: &BridgeParameters) -> anyhow::Result<Vec<ObjectModel>> {
    let folder = Path::new(&params.objects_dir);
    let mut models = if params.objects.is_empty() {
        Catalogue::load(folder)?.models
    } else {
        params
            .objects
            .iter()
            .map(|name| ObjectModel::load(&folder.join(name)))
            .collect::<Result<_, _>>()?
    };
    for model in &mut models {
        let scale = params.mesh_scale(&model.name);
        if scale != 1.0 {
            *model = model.rescaled(scale);
        }
    }
    Ok(models)
}

/// The node's life.
pub async fn perceive(node: Node, params: Params<BridgeParameters>) -> anyhow::Result<()> {
    let p = params.get().as_ref().clone();
    let models = models(&p).context("the object catalogue")?;
    if models.is_empty() {
        bail!("'objects_dir' {} holds no object", p.objects_dir);
    }
    let (sender, pairs) = inbox(if p.every_frame { 256 } else { 1 });
    subscribe_images(&node, &p, sender)?;
    let again = Arc::new(AtomicBool::new(false));
    let flag = again.clone();
    node.service::<Trigger, _, _>("~/reregister", move |_request| {
        flag.store(true, Ordering::SeqCst);
        async { TriggerResponse { success: true, message: "all objects are searched anew".into() } }
    })?;
    let work = Work {
        perceiver: Perceiver::new(p.perceiver.clone(), models),
        pairs,
        camera_info: node.newest(&p.camera_info_topic, Qos::sensor_data())?,
        intrinsics: None,
        again,
        detections: node.publisher("/perception_bridge/detections", Qos::reliable(5))?,
        segmentation: p
            .publish_segmentation
            .then(|| node.publisher("/perception_bridge/segmentation", Qos::best_effort(2)))
            .transpose()?,
        frozen: None,
        params: p,
        node: node.clone(),
    };
    node.diagnostics().level(Level::Warn, "waiting for the camera");
    tokio::task::spawn_blocking(move || work.run()).await.context("the perception thread")?;
    Ok(())
}

fn subscribe_images(node: &Node, p: &BridgeParameters, sender: Sender<Pair>) -> anyhow::Result<()> {
    let pairing: SharedPairing = Arc::new(Mutex::new(Pairing::new(p.sync_tolerance)));
    let deliver = {
        let sender = Arc::new(sender);
        let diagnostics = node.diagnostics().clone();
        move |stamp: Stamp,
              frame_id: &str,
              pair: Option<(ColorMessage, DepthMessage)>,
              dropped: u64| {
            diagnostics.set("unpaired_images", dropped);
            if let Some((color, depth)) = pair {
                sender.send((tracked::header_in(stamp, frame_id), color, depth));
            }
        }
    };
    let color = {
        let (pairing, deliver) = (pairing.clone(), deliver.clone());
        move |header: &Header, message: ColorMessage| {
            let mut pairing = pairing.lock().unwrap_or_else(PoisonError::into_inner);
            let pair = pairing.push_a(tracked::stamp(header), message);
            let stamp = pair.as_ref().map_or_else(Stamp::default, |p| p.0);
            deliver(stamp, &header.frame_id, pair.map(|p| (p.1, p.2)), pairing.dropped());
        }
    };
    let depth = {
        move |header: &Header, message: DepthMessage| {
            let mut pairing = pairing.lock().unwrap_or_else(PoisonError::into_inner);
            let pair = pairing.push_b(tracked::stamp(header), message);
            let stamp = pair.as_ref().map_or_else(Stamp::default, |p| p.0);
            deliver(stamp, &header.frame_id, pair.map(|p| (p.1, p.2)), pairing.dropped());
        }
    };
    let qos = if p.every_frame { Qos::reliable(32) } else { Qos::sensor_data() };
    if p.compressed {
        node.subscribe(
            &format!("{}/compressed", p.color_topic),
            qos,
            move |m: CompressedImage| {
                color(&m.header.clone(), ColorMessage::Compressed(m));
            },
        )?;
        let topic = format!("{}/compressedDepth", p.depth_topic);
        node.subscribe(&topic, qos, move |m: CompressedImage| {
            depth(&m.header.clone(), DepthMessage::Compressed(m));
        })?;
    } else {
        node.subscribe(&p.color_topic, qos, move |m: Image| {
            color(&m.header.clone(), ColorMessage::Raw(m));
        })?;
        node.subscribe(&p.depth_topic, qos, move |m: Image| {
            depth(&m.header.clone(), DepthMessage::Raw(m));
        })?;
    }
    Ok(())
}

impl Work {
    fn run(mut self) {
        while !self.node.shutdown().is_requested() {
            let Some((header, color, depth)) = self.pairs.recv_timeout(Duration::from_millis(200))
            else {
                if self.pairs.is_closed() {
                    return;
                }
                continue;
            };
            if let Some(info) = self.camera_info.try_newest() {
                match convert::intrinsics_from_info(&self.params.camera_info_topic, &info) {
                    Ok(k) => self.intrinsics = Some(k),
                    Err(e) => self.complain(&e.to_string()),
                }
            }
            let Some(intrinsics) = self.intrinsics else {
                self.complain(&format!("no {} yet", self.params.camera_info_topic));
                continue;
            };
            let images = decode(&color, &depth, &self.params);
            let (color, depth) = match images {
                Ok(images) => images,
                Err(e) => {
                    self.complain(&format!("{e:#}"));
                    continue;
                }
            };
            let frame = RgbdFrame { stamp: tracked::stamp(&header), color, depth, intrinsics };
            self.process(&header, &frame);
        }
    }

    fn complain(&self, sentence: &str) {
        tracing::warn!("{sentence}");
        self.node.diagnostics().level(Level::Error, sentence);
    }

    fn process(&mut self, header: &Header, frame: &RgbdFrame) {
        if self.again.swap(false, Ordering::SeqCst) {
            self.perceiver.reregister("");
            self.frozen = None;
        }
        let began = Instant::now();
        let output = match (&self.frozen, self.params.freeze_after_first) {
            (Some(frozen), true) => PerceptionOutput { stamp: frame.stamp, ..frozen.clone() },
            _ => match self.perceiver.step(frame) {
                Ok(output) => output,
                Err(e) => {
                    self.complain(&format!("frame of {:.3} s: {e}", frame.stamp.as_secs()));
                    return;
                }
            },
        };
        if self.frozen.is_none() && output.detections.iter().all(|d| d.found) {
            self.frozen = Some(output.clone());
        }
        self.publish(header, frame, &output);
        let diagnostics = self.node.diagnostics();
        diagnostics.latency("perception", began.elapsed().as_secs_f64());
        diagnostics.latency("image_to_detections", self.node.now().since(frame.stamp));
        let missing: Vec<String> = output
            .detections
            .iter()
            .filter(|d| !d.found)
            .map(|d| format!("{}: {}", d.name, d.reason))
            .collect();
        if missing.is_empty() {
            diagnostics.level(Level::Ok, "all objects are seen");
        } else {
            diagnostics.level(Level::Warn, missing.join("; "));
        }
    }

    fn publish(&self, header: &Header, frame: &RgbdFrame, output: &PerceptionOutput) {
        let mut detections: Vec<_> = output
            .detections
            .iter()
            .map(|d| {
                let covariance = std::array::from_fn(|i| d.covariance[(i / 6, i % 6)]);
                let score = if d.found { d.confidence.max(1e-6) } else { 0.0 };
                tracked::detection_message(header, &d.name, &d.pose, covariance, score)
            })
            .collect();
        if let Some(table) = &output.table {
            detections.push(tracked::detection_message(
                header,
                "table",
                &table.pose,
                [0.0; 36],
                1.0,
            ));
        }
        self.detections.publish(Detection3DArray { header: header.clone(), detections });
        if let Some(publisher) = &self.segmentation {
            publisher.publish(Image {
                header: header.clone(),
                width: frame.color.width(),
                height: frame.color.height(),
                encoding: "mono8".into(),
                is_bigendian: 0,
                step: frame.color.width(),
                data: output.masks.clone(),
            });
        }
    }
}

fn decode(
    color: &ColorMessage,
    depth: &DepthMessage,
    p: &BridgeParameters,
) -> anyhow::Result<(RgbImage, DepthImage)> {
    let color = match color {
        ColorMessage::Raw(m) => convert::color_from_image(&p.color_topic, m),
        ColorMessage::Compressed(m) => convert::color_from_compressed(&p.color_topic, m),
    }?;
    let depth = match depth {
        DepthMessage::Raw(m) => convert::depth_from_image(&p.depth_topic, m),
        DepthMessage::Compressed(m) => convert::depth_from_compressed(&p.depth_topic, m),
    }?;
    Ok((color, depth))
}
