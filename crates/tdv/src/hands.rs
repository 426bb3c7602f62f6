//! `tdv eval hands`: our hand chain against MediaPipe's own on a real video, and the grasp found in
//! rendered demonstrations against the lab's contact.

use crate::arguments::{HandsArgs, RecordDemoArgs};
use crate::eval::write_json;
use crate::observe::{bar, observe};
use crate::record_demo;
use anyhow::{Context as _, ensure};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use tdv_demonstration::{ParseConfig, Task, parse};
use tdv_evaluation::percentile;
use tdv_perception::hands::{HandDetector, JOINTS};

/// Frames with a hand, percent.
const WANTED_FOUND_PERCENT: f64 = 98.0;
/// Mean distance (px) of our joints from MediaPipe's.
const WANTED_PX: f64 = 3.0;
/// Frames between the grasp found and the lab's contact.
const WANTED_FRAMES: usize = 3;

/// What MediaPipe found, as `tests/golden/hands/make_video_landmarks.py --follow` writes it.
#[derive(Deserialize)]
struct Landmarks {
    frames: Vec<LandmarkFrame>,
}

#[derive(Deserialize)]
struct LandmarkFrame {
    frame: usize,
    /// px.
    pixels: [[f64; 2]; JOINTS],
}

/// Figures of the video.
#[derive(Debug, Serialize)]
struct VideoReport {
    frames: usize,
    /// Frames in which we find a hand.
    found: usize,
    /// Frames in which MediaPipe does.
    reference_found: usize,
    /// Frames with both.
    compared: usize,
    /// Distance (px) over all joints of all frames with both: mean, median, 95th percentile, most.
    px: [f64; 4],
    /// Median milliseconds a frame.
    ms: f64,
}

/// One rendered demonstration.
#[derive(Debug, Serialize)]
struct GraspReport {
    task: String,
    seed: u64,
    frames: usize,
    /// Frames with a hand.
    hands: usize,
    /// First frame with contact in the lab, and as found.
    contact: [usize; 2],
    /// Last frame with contact in the lab, and the first without as found, if the release is seen.
    release: Option<[usize; 2]>,
}

#[derive(Serialize)]
struct HandsReport {
    video: Option<VideoReport>,
    grasps: Vec<GraspReport>,
}

/// Measures what is asked for; false when a target is missed.
pub fn run(args: &HandsArgs) -> anyhow::Result<bool> {
    let mut met = true;
    let video = match (&args.frames, &args.landmarks) {
        (Some(frames), Some(landmarks)) => Some(video(frames, landmarks, args)?),
        _ => None,
    };
    if let Some(v) = &video {
        let share = 100.0 * v.found as f64 / v.frames.max(1) as f64;
        println!(
            "video:  a hand in {} of {} frames ({share:.1} %; the reference: {}), {:.1} ms a frame",
            v.found, v.frames, v.reference_found, v.ms
        );
        let [mean, median, p95, most] = v.px;
        println!(
            "        {mean:.2} px from the reference on average (median {median:.2}, p95 {p95:.2}, \
             most {most:.1}) over {} frames",
            v.compared
        );
        met &= share >= WANTED_FOUND_PERCENT && mean < WANTED_PX;
    }
    let mut grasps = Vec::new();
    for seed in args.seed..args.seed + args.demonstrations {
        let g = grasp(&args.task, seed, args)?;
        let off = |[is, found]: [usize; 2]| found as i64 - is as i64;
        println!(
            "{} {seed}: a hand in {} of {} frames; contact at frame {} found at {} ({:+}){}",
            g.task,
            g.hands,
            g.frames,
            g.contact[0],
            g.contact[1],
            off(g.contact),
            g.release.map_or(String::new(), |r| format!(
                "; released after {} found at {} ({:+})",
                r[0],
                r[1],
                off(r)
            ))
        );
        met &= g.contact[0].abs_diff(g.contact[1]) <= WANTED_FRAMES;
        grasps.push(g);
    }
    println!(
        "wanted: a hand in {WANTED_FOUND_PERCENT} % of the frames, under {WANTED_PX} px on average, \
         contact within {WANTED_FRAMES} frames: {}",
        if met { "met" } else { "NOT met" }
    );
    if let Some(path) = &args.json {
        write_json(path, &HandsReport { video, grasps })?;
    }
    Ok(met)
}

fn detector(args: &HandsArgs) -> anyhow::Result<HandDetector> {
    HandDetector::load(
        &args.hand_models.join("palm_detection_full.tflite"),
        &args.hand_models.join("hand_landmark_full.tflite"),
    )
    .context("hand networks (launch_scripts/fetch_hand_models.sh gets them)")
}

/// All NNNN.png of a folder in order, the hand followed from one to the next.
fn video(frames: &Path, landmarks: &Path, args: &HandsArgs) -> anyhow::Result<VideoReport> {
    let text =
        std::fs::read_to_string(landmarks).with_context(|| landmarks.display().to_string())?;
    let reference: Landmarks = serde_json::from_str(&text).with_context(|| {
        format!("{}: tests/golden/hands/make_video_landmarks.py writes it", landmarks.display())
    })?;
    let reference: BTreeMap<usize, [[f64; 2]; JOINTS]> =
        reference.frames.into_iter().map(|f| (f.frame, f.pixels)).collect();
    let mut numbers: Vec<usize> = std::fs::read_dir(frames)
        .with_context(|| frames.display().to_string())?
        .filter_map(|e| e.ok()?.file_name().to_str()?.strip_suffix(".png")?.parse().ok())
        .collect();
    numbers.sort_unstable();
    ensure!(!numbers.is_empty(), "{}: no frames (NNNN.png)", frames.display());
    let mut hands = detector(args)?;
    let (mut found, mut compared) = (0, 0);
    let (mut distances, mut times) = (Vec::new(), Vec::new());
    let progress = bar(numbers.len() as u64, "hands");
    for number in &numbers {
        let path = frames.join(format!("{number:04}.png"));
        let color = image::open(&path).with_context(|| path.display().to_string())?.to_rgb8();
        let begin = std::time::Instant::now();
        let seen = hands.find(&color);
        times.push(begin.elapsed().as_secs_f64() * 1000.0);
        found += usize::from(seen.is_some());
        if let (Some(seen), Some(expected)) = (seen, reference.get(number)) {
            compared += 1;
            let all = seen.pixels.iter().zip(expected);
            distances.extend(all.map(|((u, v), e)| (u - e[0]).hypot(v - e[1])));
        }
        progress.inc(1);
    }
    progress.finish_and_clear();
    ensure!(compared > 0, "no frame with a hand here and in {}", landmarks.display());
    let mean = distances.iter().sum::<f64>() / distances.len() as f64;
    let at = |q: f64| percentile(&distances, q).unwrap_or(f64::NAN);
    Ok(VideoReport {
        frames: numbers.len(),
        found,
        reference_found: reference.len(),
        compared,
        px: [mean, at(0.5), at(0.95), at(1.0)],
        ms: percentile(&times, 0.5).unwrap_or(f64::NAN),
    })
}

/// Renders a demonstration into a bag, parses it and compares its contact with the lab's.
fn grasp(task: &str, seed: u64, args: &HandsArgs) -> anyhow::Result<GraspReport> {
    let file = Path::new("config/tasks").join(format!("{task}.yaml"));
    let description = Task::load(&file)?;
    let bag = args.run.join(format!("{task}_{seed}"));
    std::fs::create_dir_all(&args.run).with_context(|| args.run.display().to_string())?;
    for old in [bag.clone(), args.run.join(format!("{task}_{seed}_truth"))] {
        tdv_bag::remove_bag(&old)?;
    }
    let contacts = record_demo::render(&RecordDemoArgs {
        task: task.to_owned(),
        output: bag.clone(),
        seed,
        objects: args.objects.clone(),
        quality: 90,
    })?;
    let seen = observe(&bag, &description, &args.hand_models, &args.objects)?;
    let (_, report) = parse(&seen.frames, &description, &ParseConfig::default())
        .with_context(|| format!("the demonstration in {}", bag.display()))?;
    let keys = report.keyframes.context("nothing was grasped and carried")?;
    // A frame may have been lost on the way through the bag: stamps tell which is which.
    let index = |i: usize| {
        let stamp = seen.frames.get(i).map(|f| f.stamp)?;
        contacts.iter().position(|(s, _)| *s == stamp)
    };
    let first = contacts.iter().position(|c| c.1).context("the lab shows no contact")?;
    let last = contacts.iter().rposition(|c| c.1).unwrap_or(first);
    Ok(GraspReport {
        task: task.to_owned(),
        seed,
        frames: seen.frames.len(),
        hands: seen.hands,
        contact: [first, index(keys.contact).context("a frame that was not recorded")?],
        release: keys.release.and_then(index).map(|r| [last, r]),
    })
}
