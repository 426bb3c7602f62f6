//! Trials of one task in process, as `tdv eval table2` does them, without the rest of the command line:
//! `cargo run -p tdv-evaluation --bin table2_run -- TASK POLICY LEVEL STARTS OUT [DEMOS] [ARM] [SEED]`.
//! Without a policy it says what was parsed and what generation makes of it.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use tdv_evaluation::table2::{
    Arm, Cell, Course, Job, Lesson, Level, POINTS, PolicyKind, PoseNoise, Stage, append_record,
    demonstrate, run_jobs,
};
use tdv_geometry::Pose;

fn pose(p: &Pose) -> String {
    let (t, r) = (p.translation.vector, p.rotation.euler_angles());
    let deg = [r.0, r.1, r.2].map(|a| format!("{:.0}", a.to_degrees())).join(" ");
    format!("({:.3} {:.3} {:.3}; {deg} deg)", t.x, t.y, t.z)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let word = |i: usize, other: &str| args.get(i).map_or(other, String::as_str).to_owned();
    let stage = Arc::new(Stage::load(Path::new("."), &word(0, "cup_on_coaster"))?);
    if args.len() < 2 {
        let (demonstration, report) = demonstrate(&stage.task, &stage.assets)?;
        for r in &report.repairs {
            println!("  repaired: {}", r.text);
        }
        println!("reference {}", pose(&demonstration.reference_pose));
        for p in &demonstration.procedures {
            let (first, last) = (p.trajectory.first().pose, p.goal());
            println!(
                "{}: {} in {}, {:?}, {:.1} s, {} -> {}",
                p.name,
                p.moving,
                p.reference,
                p.end,
                p.trajectory.duration(),
                pose(&first),
                pose(&last)
            );
        }
        return Ok(());
    }
    let policy = PolicyKind::ALL.into_iter().find(|p| p.name() == args[1]).ok_or("policy?")?;
    let levels: Vec<Level> = [Level::PG, Level::PoG]
        .into_iter()
        .filter(|l| word(2, "PG,PoG").split(',').any(|w| w == l.name()))
        .collect();
    let starts: usize = word(3, "30").parse()?;
    let out = word(4, "runs/table2");
    let demos: usize = word(5, "50").parse()?;
    let arm = Arm::named(&word(6, "ordinary")).ok_or("arm?")?;
    let seed: u64 = word(7, "1").parse()?;
    std::fs::create_dir_all(&out)?;
    let lesson = Arc::new(if policy == PolicyKind::Learned {
        let course = Course { demos, seed, steps: 600, arm: arm.clone(), threads: 2 };
        stage.teach(&course, &Path::new(&out).join("models"), &|text| println!("  {text}"))?
    } else {
        Lesson::untaught(&stage.demonstration, &stage.task)
    });
    let mut jobs = Vec::new();
    for level in levels {
        let demos = if policy == PolicyKind::Learned { demos } else { 1 };
        let cell = Cell { demos, level, policy, disturbed: false, arm: arm.clone(), seed };
        jobs.extend((POINTS..POINTS + starts).map(|trial| Job {
            stage: stage.clone(),
            lesson: lesson.clone(),
            cell: cell.clone(),
            trial,
        }));
    }
    let mut sums: BTreeMap<Level, (usize, usize)> = BTreeMap::new();
    let file = Path::new(&out).join("trials.jsonl");
    run_jobs(&jobs, PoseNoise::default(), 2, &mut |r| {
        let sum = sums.entry(r.level).or_default();
        *sum = (sum.0 + usize::from(r.success), sum.1 + 1);
        let s = &r.start;
        println!(
            "{} {} {} {} ({:.2} {:.2} {:.0} deg) {:.1} s ({:.1} s): {} {:?} | {} | {}",
            r.task,
            r.level.name(),
            r.trial,
            if r.success { "ok" } else { "LOST" },
            s.x,
            s.y,
            s.yaw.to_degrees(),
            r.duration_s,
            r.wall_s,
            r.error_mm.map_or(String::new(), |e| format!("{e:.1} mm")),
            r.cause,
            r.reason,
            r.sentence
        );
        append_record(&file, r)
    })?;
    for (level, (good, all)) in sums {
        println!(
            "== {} {} {} {}: {good} of {all}",
            stage.task.name,
            policy.name(),
            arm.name,
            level.name()
        );
    }
    Ok(())
}
