use crate::camera::{self, Camera, Frames};
use crate::frames::{Order, Turn, from_the_future};
use crate::params::{Backend, BridgeParameters};
use crate::picture::Picture;
use crate::remote::Remote;
use anyhow::{Context as _, bail};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tdv_geometry::Stamp;
use tdv_msgs::sensor_msgs::msg::{CameraInfo, CompressedImage, Image};
use tdv_msgs::std_msgs::msg::Header;
use tdv_msgs::std_srvs::srv::{Trigger, TriggerResponse};
use tdv_msgs::tf2_msgs::msg::TFMessage;
use tdv_msgs::vision_msgs::msg::Detection3DArray;
use tdv_perception::{Catalogue, FrameError, ObjectModel, Perceiver, PerceptionOutput, RgbdFrame};
use tdv_rendering::{DepthImage, RgbImage};
use tdv_runtime::{
    Inbox, Level, Node, Params, Publisher, Qos, Sender, StampMatcher, convert, inbox, tracked,
};

/// How many images of one kind wait for their partner.
const WAITING: usize = 8;

/// Images as they came, decoded only when their turn comes.
enum ColorMessage {
    Raw(Image),
    Compressed(CompressedImage),
}

enum DepthMessage {
    Raw(Image),
    Compressed(CompressedImage),
}

/// Colour and depth of one instant.
struct Pair {
    came: Instant,
    header: Header,
    color: ColorMessage,
    depth: DepthMessage,
}

struct Work {
    node: Node,
    params: BridgeParameters,
    perceiver: Perceiver,
    /// In place of the perceiver.
    remote: Option<Remote>,
    picture: Picture,
    pairs: Inbox<Pair>,
    camera_info: Inbox<CameraInfo>,
    /// Of the depth camera, when depth is not aligned.
    depth_info: Option<Inbox<CameraInfo>>,
    camera: Camera,
    again: Arc<AtomicBool>,
    detections: Publisher<Detection3DArray>,
    segmentation: Option<Publisher<Image>>,
    frozen: Option<PerceptionOutput>,
    order: Order,
    /// The last answer, for whoever missed it.
    answer: Detection3DArray,
    /// Frames that were out of order or came twice.
    late: u64,
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
    let perceiver = Perceiver::new(p.perceiver.clone(), models);
    let remote = (p.backend() == Some(Backend::Remote))
        .then(|| Remote::new(&node, &p.remote, &perceiver))
        .transpose()?;
    let frames = Frames::default();
    let apart = !p.depth_info_topic.is_empty();
    if apart {
        let shared = frames.clone();
        node.subscribe("/tf_static", Qos::latched_depth(10), move |message: TFMessage| {
            camera::learn(&shared, &message);
        })?;
    }
    let work = Work {
        remote,
        picture: Picture::new(&node, &p.backend, &perceiver)?,
        perceiver,
        pairs,
        camera_info: node.newest(&p.camera_info_topic, Qos::sensor_data())?,
        depth_info: apart
            .then(|| node.newest(&p.depth_info_topic, Qos::sensor_data()))
            .transpose()?,
        camera: Camera::new(&p.camera_info_topic, &p.depth_info_topic, frames),
        again,
        detections: node.publisher("/perception_bridge/detections", Qos::reliable(5))?,
        segmentation: p
            .publish_segmentation
            .then(|| node.publisher("/perception_bridge/segmentation", Qos::best_effort(2)))
            .transpose()?,
        frozen: None,
        order: Order::default(),
        answer: Detection3DArray::default(),
        late: 0,
        params: p,
        node: node.clone(),
    };
    node.diagnostics().level(Level::Warn, "waiting for the camera");
    tokio::task::spawn_blocking(move || work.run()).await.context("the perception thread")?;
    Ok(())
}

/// Colour and depth on their way to a pair.
struct Images {
    node: Node,
    matcher: Mutex<StampMatcher<ColorMessage, DepthMessage>>,
    sender: Sender<Pair>,
    ahead: AtomicU64,
}

impl Images {
    fn color(&self, header: &Header, message: ColorMessage) {
        self.arrived(header, |matcher, stamp| matcher.left(stamp, message));
    }

    fn depth(&self, header: &Header, message: DepthMessage) {
        self.arrived(header, |matcher, stamp| matcher.right(stamp, message));
    }

    fn arrived(
        &self,
        header: &Header,
        push: impl FnOnce(
            &mut StampMatcher<ColorMessage, DepthMessage>,
            Stamp,
        ) -> Option<(Stamp, ColorMessage, DepthMessage)>,
    ) {
        let (stamp, clock) = (tracked::stamp(header), self.node.clock());
        let diagnostics = self.node.diagnostics();
        // Simulated time comes on a topic of its own and may be later than the image it belongs to.
        if !clock.is_simulated() && from_the_future(stamp, clock.now()) {
            let count = self.ahead.fetch_add(1, Ordering::Relaxed) + 1;
            diagnostics.set("images_from_the_future", count);
            let ahead = stamp.since(clock.now());
            let sentence = format!("an image is stamped {ahead:.1} s ahead of the clock: refused");
            tracing::warn!("{sentence}");
            diagnostics.level(Level::Error, sentence);
            return;
        }
        let mut matcher = self.matcher.lock().unwrap_or_else(PoisonError::into_inner);
        let pair = push(&mut matcher, stamp);
        diagnostics.set("unpaired_images", matcher.unpaired());
        if let Some((stamp, color, depth)) = pair {
            let header = tracked::header_in(stamp, &header.frame_id);
            self.sender.send(Pair { came: Instant::now(), header, color, depth });
        }
    }
}

fn subscribe_images(node: &Node, p: &BridgeParameters, sender: Sender<Pair>) -> anyhow::Result<()> {
    let images = Arc::new(Images {
        node: node.clone(),
        matcher: Mutex::new(StampMatcher::new(p.sync_tolerance, WAITING)),
        sender,
        ahead: AtomicU64::new(0),
    });
    let shared = images.clone();
    let color = move |header: &Header, message| shared.color(header, message);
    let depth = move |header: &Header, message| images.depth(header, message);
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
            let Some(pair) = self.pairs.recv_timeout(Duration::from_millis(200)) else {
                if self.pairs.is_closed() {
                    return;
                }
                continue;
            };
            self.node.diagnostics().set("skipped_frames", self.pairs.dropped());
            if !self.is_next(&pair) {
                continue;
            }
            if let Err(why) = self.calibrate() {
                // No answer: a lockstep replay sends the frame again.
                self.complain(&why.to_string());
                continue;
            }
            let stamp = tracked::stamp(&pair.header);
            let decoded = decode(&pair.color, &pair.depth, &self.params);
            match decoded.and_then(|(color, depth)| Ok(self.camera.pair(color, depth)?)) {
                Ok((color, depth, intrinsics)) => {
                    let frame = RgbdFrame { stamp, color, depth, intrinsics };
                    self.process(&pair.header, &frame);
                }
                Err(e) => self.give_up(&pair.header, &format!("{e:#}")),
            }
        }
    }

    /// Takes new calibrations; an error while something is missing that may still come.
    fn calibrate(&mut self) -> Result<(), camera::CameraError> {
        if let Some(info) = self.camera_info.try_newest()
            && let Err(e) = self.camera.color_info(&info)
        {
            self.complain(&e.to_string());
        }
        if let Some(info) = self.depth_info.as_mut().and_then(Inbox::try_newest)
            && let Err(e) = self.camera.depth_info(&info)
        {
            self.complain(&e.to_string());
        }
        self.camera.is_known()
    }

    /// Whether a frame is to be worked on.
    fn is_next(&mut self, pair: &Pair) -> bool {
        match self.order.turn(tracked::stamp(&pair.header), pair.came) {
            Turn::Next => return true,
            Turn::StartsOver => {
                tracing::info!("the stamps step back: the images start over");
                self.again.store(true, Ordering::SeqCst);
                return true;
            }
            // Only a lockstep replay sends a frame again; a camera that repeats itself counts once.
            Turn::Missed if self.params.every_frame => {
                self.detections.publish(self.answer.clone());
            }
            Turn::Missed | Turn::Late => {
                self.late += 1;
                self.node.diagnostics().set("late_frames", self.late);
            }
        }
        false
    }

    /// Answers a frame that will never be usable with no detections at all, so that a lockstep replay
    /// can go on.
    fn give_up(&mut self, header: &Header, sentence: &str) {
        self.complain(sentence);
        self.send(Detection3DArray { header: header.clone(), detections: Vec::new() });
    }

    fn send(&mut self, answer: Detection3DArray) {
        self.detections.publish(answer.clone());
        self.order.answered(tracked::stamp(&answer.header), Instant::now());
        self.answer = answer;
    }

    fn complain(&self, sentence: &str) {
        tracing::warn!("{sentence}");
        self.node.diagnostics().level(Level::Error, sentence);
    }

    fn process(&mut self, header: &Header, frame: &RgbdFrame) {
        if self.again.swap(false, Ordering::SeqCst) {
            self.perceiver.reregister("");
            if let Some(remote) = &mut self.remote {
                remote.forget();
            }
            self.frozen = None;
        }
        let began = Instant::now();
        let output = match (&self.frozen, self.params.freeze_after_first) {
            (Some(frozen), true) => PerceptionOutput { stamp: frame.stamp, ..frozen.clone() },
            _ => match self.look(header, frame) {
                Ok(output) => output,
                Err(e) => {
                    let sentence = format!("frame of {:.3} s: {e}", frame.stamp.as_secs());
                    self.give_up(header, &sentence);
                    return;
                }
            },
        };
        if self.frozen.is_none() && output.detections.iter().all(|d| d.found) {
            self.frozen = Some(output.clone());
        }
        let seconds = began.elapsed().as_secs_f64();
        self.publish(header, frame, &output);
        let diagnostics = self.node.diagnostics();
        diagnostics.latency("perception", seconds);
        diagnostics.latency("image_to_detections", self.node.now().since(frame.stamp));
        self.picture.show(header, frame, &output, seconds);
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

    fn look(&mut self, header: &Header, frame: &RgbdFrame) -> Result<PerceptionOutput, FrameError> {
        match &mut self.remote {
            Some(remote) => remote.step(header, frame),
            None => self.perceiver.step(frame),
        }
    }

    fn publish(&mut self, header: &Header, frame: &RgbdFrame, output: &PerceptionOutput) {
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
        self.send(Detection3DArray { header: header.clone(), detections });
        if let Some(publisher) = &self.segmentation {
            let (width, height) = frame.color.dimensions();
            let labels = &output.masks;
            publisher.publish(convert::image_from_labels(width, height, labels, header.clone()));
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
