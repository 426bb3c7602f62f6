//! The page that `teach` leaves behind.

use crate::teach::Lesson;
use anyhow::Context as _;
use std::path::Path;
use tdv_demonstration::ProcedureReport;
use tdv_evaluation::{LinePlot, Page, Series, TopView};
use tdv_geometry::PoseTrajectory;
use tdv_rendering::codec;

fn path_xy(t: &PoseTrajectory) -> Vec<(f64, f64)> {
    t.poses().map(|p| (p.translation.x, p.translation.y)).collect()
}

/// Distance from the goal in the plane against height.
fn path_side(t: &PoseTrajectory) -> Vec<(f64, f64)> {
    let end = t.last().pose.translation;
    t.poses()
        .map(|p| {
            let d = p.translation.vector - end.vector;
            (d.x.hypot(d.y), p.translation.z)
        })
        .collect()
}

/// One sentence about what became of a procedure's starts.
pub fn describe(p: &ProcedureReport) -> String {
    let list = |counts: &std::collections::BTreeMap<String, usize>| {
        counts.iter().map(|(k, n)| format!("{n} {k}")).collect::<Vec<_>>().join(", ")
    };
    format!(
        "{}: {} trajectories and {} recoveries from {} starts; rejected: {}; warp: {}",
        p.name,
        p.accepted,
        p.recoveries,
        p.tried,
        if p.rejected.is_empty() { "none".into() } else { list(&p.rejected) },
        list(&p.rules)
    )
}

/// Writes the page, under a temporary name first.
pub fn write(path: &Path, lesson: &Lesson) -> anyhow::Result<()> {
    let d = &lesson.demonstration;
    let mut page = Page::new(
        &format!("Taught: {}", lesson.task.text),
        "One demonstration, parsed from its pixels, multiplied, and learned.",
    );
    page.section("Result").table(
        &["what", "value"],
        &[
            vec![
                "kinematic rollouts from unseen starts".into(),
                format!(
                    "{} of {} within 10 mm and 5 deg; median {:.1} mm, {:.1} deg",
                    lesson.rollout.successes,
                    lesson.rollout.trials,
                    1e3 * lesson.rollout.median_position,
                    lesson.rollout.median_rotation.to_degrees()
                ),
            ],
            vec![
                "switch policy on held-out trajectories".into(),
                format!(
                    "precision {:.2}, recall {:.2}, delay {:.0} ms in the median, {:.0} ms in nine of \
                     ten, {} missed, {} too early",
                    lesson.switch.precision,
                    lesson.switch.recall,
                    1e3 * lesson.switch.median_delay,
                    1e3 * lesson.switch.delay_90,
                    lesson.switch.missed,
                    lesson.switch.premature
                ),
            ],
            vec![
                "time".into(),
                lesson
                    .seconds
                    .iter()
                    .map(|(stage, s)| format!("{stage} {s:.1} s"))
                    .collect::<Vec<_>>()
                    .join(", "),
            ],
        ],
    );
    parsing(&mut page, lesson);
    page.section("Original and generated trajectories").text(
        "Poses of the moving frame in the reference frame, metres. Thin: generated; thick: the demonstration.",
    );
    for p in &lesson.dataset.procedures {
        let original = d.procedure(&p.name).map(|o| &o.trajectory);
        let series = |f: fn(&PoseTrajectory) -> Vec<(f64, f64)>| {
            original
                .map(|t| Series {
                    name: "demonstration".into(),
                    color: "#e4572e".into(),
                    points: f(t),
                })
                .into_iter()
                .collect::<Vec<_>>()
        };
        let top = TopView {
            title: format!("{} from above", p.name),
            x_label: format!("x in {} (m)", p.reference),
            y_label: "y (m)".into(),
            background: p.trajectories.iter().map(path_xy).collect(),
            series: series(path_xy),
        };
        let side = TopView {
            title: format!("{} from the side", p.name),
            x_label: "distance from the goal (m)".into(),
            y_label: "height (m)".into(),
            background: p.trajectories.iter().map(path_side).collect(),
            series: series(path_side),
        };
        let caption = format!(
            "{}: {} in {}, {} trajectories",
            p.name,
            p.moving,
            p.reference,
            p.trajectories.len()
        );
        page.drawings(&[(top.svg(), caption.as_str()), (side.svg(), "height over distance")]);
    }
    for p in &lesson.generation.procedures {
        page.text(&describe(p));
    }
    training(&mut page, lesson);
    let partial = path.with_extension("html.partial");
    std::fs::write(&partial, page.html()).with_context(|| partial.display().to_string())?;
    std::fs::rename(&partial, path).with_context(|| path.display().to_string())
}

fn parsing(page: &mut Page, lesson: &Lesson) {
    page.section("Parsed frames");
    let pictures: Vec<_> = lesson
        .pictures
        .iter()
        .map(|(t, image)| ("image/jpeg", codec::encode_jpeg(image, 80), format!("{t:.1} s")))
        .collect();
    if pictures.is_empty() {
        page.text("This demonstration was imported as poses; it has no pictures.");
    } else {
        page.pictures(&pictures);
    }
    let hand: Vec<f64> = lesson
        .observations
        .iter()
        .filter(|f| f.hand.is_some())
        .map(|f| f.stamp.since(lesson.observations[0].stamp))
        .collect();
    page.text(&format!(
        "{} frames, a hand in {} of them. The object was carried {:.2} m.",
        lesson.observations.len(),
        hand.len(),
        lesson.parse.carried
    ));
    let rows: Vec<Vec<String>> = lesson
        .parse
        .repairs
        .iter()
        .map(|r| vec![format!("{:?}", r.kind), r.frames.to_string(), r.text.clone()])
        .collect();
    if rows.is_empty() {
        page.text("Nothing had to be repaired.");
    } else {
        page.table(&["repair", "frames", "what was done"], &rows);
    }
}

fn training(page: &mut Page, lesson: &Lesson) {
    let loss = LinePlot {
        title: "training loss".into(),
        x_label: "step".into(),
        y_label: "loss".into(),
        log_y: true,
        series: vec![Series {
            name: "loss".into(),
            color: "#2e86ab".into(),
            points: lesson.progress.iter().map(|p| (p.step as f64, p.loss)).collect(),
        }],
    };
    page.section("Training").drawings(&[(loss.svg(), "mean squared error of the denoised plan")]);
}
