//! 200 seeded pick and place queries among fixtures: how many are solved, how fast, how long the way.
//!
//! `cargo run --release -p tdv-robot --example planner_bench [QUERIES [CANDIDATES
//! [SHORTCUTS]]]`. Between pick and place stand a
//! wall, a shelf, a post and boxes, all drawn from the seed; half of the queries carry a bottle. A query
//! counts if it is feasible: solved with the default parameters, or by long runs with other seeds.
//! Queries that nothing solves are listed apart. Times are wall times of one thread and, on Linux, the
//! processor's time that it got, which other programs do not lengthen.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;
use std::path::Path;
use std::time::Instant;
use tdv_geometry::{Pose, pose_from_xyz_rpy};
use tdv_robot::collision::*;
use tdv_robot::planner::{Goal, PlanError, PlanRequest, Planner, PlannerParams};
use tdv_robot::urdf::RobotModel;
use tdv_robot::{Joints, Kinematics, Limits, unwrap_near};

type Failure = Box<dyn std::error::Error>;

fn boxes(rng: &mut ChaCha8Rng) -> Vec<Fixture> {
    let mut out = Vec::new();
    let mut add = |name: String, shape, position, yaw: f64| {
        out.push(Fixture { name, shape, position, rpy: [0.0, 0.0, yaw] });
    };
    let height = rng.random_range(0.12..0.30);
    let at = [rng.random_range(0.40..0.55), rng.random_range(-0.05..0.05), height / 2.0];
    add("wall".into(), FixtureShape::Box([0.35, 0.02, height]), at, rng.random_range(-0.3..0.3));
    let z = rng.random_range(0.20..0.35);
    let y = rng.random_range(0.30..0.40);
    add("shelf".into(), FixtureShape::Box([0.30, 0.25, 0.02]), [0.5, y, z], 0.0);
    add("shelf back".into(), FixtureShape::Box([0.02, 0.25, 0.5]), [0.66, y, 0.25], 0.0);
    let post = [rng.random_range(0.25..0.7), rng.random_range(0.08..0.15), 0.3];
    add("post".into(), FixtureShape::Cylinder([0.02, 0.6]), post, 0.0);
    for i in 0..3 {
        let edges: [f64; 3] = std::array::from_fn(|_| rng.random_range(0.05..0.14));
        let at = [rng.random_range(0.3..0.7), rng.random_range(-0.4..0.4), edges[2] / 2.0];
        let yaw = rng.random_range(-1.0..1.0);
        add(format!("box {i}"), FixtureShape::Box(edges), at, yaw);
    }
    out
}

/// Gripper down, a little tilted.
fn grasp(rng: &mut ChaCha8Rng, y: [f64; 2], top: f64) -> Pose {
    let xyz =
        [rng.random_range(0.32..0.60), rng.random_range(y[0]..y[1]), rng.random_range(0.03..top)];
    let tilt = |rng: &mut ChaCha8Rng| rng.random_range(-0.2..0.2);
    pose_from_xyz_rpy(xyz, [PI + tilt(rng), tilt(rng), rng.random_range(-1.5..1.5)])
}

/// Processor time of this thread so far (ms); not a number where the system does not tell.
fn cpu_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|ns| ns.parse().ok()).map_or(f64::NAN, |ns: f64| ns / 1e6)
}

fn percentile(sorted: &[f64], p: f64) -> f64 {
    let i = ((sorted.len() as f64 - 1.0) * p).round() as usize;
    sorted.get(i).copied().unwrap_or(f64::NAN)
}

#[allow(clippy::print_stdout)]
fn main() -> Result<(), Failure> {
    let argument = |n: usize, default: usize| -> Result<usize, Failure> {
        std::env::args().nth(n).map_or(Ok(default), |s| Ok(s.parse()?))
    };
    let params = PlannerParams::default();
    let wanted = argument(1, 200)?;
    let candidates = argument(2, params.candidates)?;
    let shortcuts = argument(3, params.shortcuts)?;
    let params = PlannerParams { candidates, shortcuts, ..params };
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/robot/ur5_2f85.urdf");
    let model = RobotModel::load(Path::new(path))?;
    let (k, limits) = (Kinematics::ur5(), Limits::default());
    let bottle = HeldObject::new(
        "bottle",
        vec![ConvexPart::capsule([0.0, 0.0, 0.11], [0.0, 0.0, 0.17], 0.03)?],
        &Pose::identity(),
        &[],
    );
    let mut rng = ChaCha8Rng::seed_from_u64(2024);
    let (mut ms, mut cpus) = (Vec::new(), Vec::new());
    let (mut ratio, mut seconds) = (Vec::new(), Vec::new());
    let (mut feasible, mut unsolved, mut unknown, mut straight) = (0, Vec::new(), 0, 0);
    let mut query = 0;
    while feasible < wanted {
        query += 1;
        let world =
            CollisionWorld::new(&model, &Workcell::new(boxes(&mut rng)), Margins::default(), 0.0)?;
        let (mut pick, place) =
            (grasp(&mut rng, [-0.40, -0.08], 0.15), grasp(&mut rng, [0.10, 0.40], 0.50));
        let (mut to, held) = (place, rng.random_bool(0.5).then_some(&bottle));
        if rng.random_bool(0.5) {
            std::mem::swap(&mut pick, &mut to);
        }
        let seed: Joints = [0.0, -1.4, 1.8, -2.0, -1.6, 0.0];
        let apart = |q: &Joints| -> f64 { (0..6).map(|i| (q[i] - seed[i]).powi(2)).sum() };
        let free = |q: &&Joints| world.check(q, 0.3, held).is_ok();
        let starts = k.ik_tcp(&pick);
        let Some(start) =
            starts.iter().filter(free).min_by(|a, b| apart(a).total_cmp(&apart(b))).copied()
        else {
            continue;
        };
        let request = PlanRequest { start, goal: Goal::Tcp(to), knuckle: 0.3, held };
        let planner = Planner { kinematics: &k, world: &world, limits: &limits, params };
        let (begin, on_cpu) = (Instant::now(), cpu_ms());
        let found = planner.plan(&request, &mut || false);
        let took = begin.elapsed().as_secs_f64() * 1e3;
        let cpu = cpu_ms() - on_cpu;
        match found {
            Ok(m) => {
                feasible += 1;
                ms.push(took);
                cpus.push(cpu);
                straight += usize::from(m.iterations == 0);
                let line = |a: &Joints, b: &Joints| -> f64 {
                    (0..6).map(|i| (b[i] - a[i]).powi(2)).sum::<f64>().sqrt()
                };
                let way: f64 = m.path.windows(2).map(|w| line(&w[0], &w[1])).sum();
                // Against the free goal configuration that is nearest, reachable straight or not.
                let near = |q: &Joints| -> Joints {
                    std::array::from_fn(|i| {
                        unwrap_near(q[i], start[i], limits.joint_lower[i], limits.joint_upper[i])
                    })
                };
                let goals: Vec<Joints> = k.ik_tcp(&to).iter().map(near).collect();
                let goals = goals.iter().filter(free).map(|g| line(&start, g));
                ratio.push(way / goals.fold(f64::INFINITY, f64::min).max(1e-9));
                seconds.push(m.duration());
            }
            Err(e @ (PlanError::NoPath { .. } | PlanError::TimedOut { .. })) => {
                let long = (100..104).any(|seed| {
                    let params = PlannerParams { seed, max_iterations: 20_000, ..params };
                    Planner { params, ..planner.clone() }.plan(&request, &mut || false).is_ok()
                });
                if long {
                    feasible += 1;
                    unsolved.push(format!("query {query}: {e}, {took:.0} ms"));
                } else {
                    unknown += 1;
                }
            }
            // No free solution of the goal: not a query.
            Err(_) => {}
        }
    }
    ms.sort_by(f64::total_cmp);
    cpus.sort_by(f64::total_cmp);
    ratio.sort_by(f64::total_cmp);
    seconds.sort_by(f64::total_cmp);
    let solved = ms.len();
    println!(
        "{solved} of {feasible} feasible queries solved ({:.1} %), {straight} by a straight line; {unknown} more that nothing solved",
        100.0 * solved as f64 / feasible as f64
    );
    for (what, v) in [
        ("wall ms", &ms),
        ("cpu ms", &cpus),
        ("path / straight line to the nearest goal", &ratio),
        ("trajectory s", &seconds),
    ] {
        println!(
            "{what}: p50 {:.2}, p90 {:.2}, p99 {:.2}, most {:.2}",
            percentile(v, 0.5),
            percentile(v, 0.9),
            percentile(v, 0.99),
            percentile(v, 1.0)
        );
    }
    unsolved.iter().for_each(|u| println!("{u}"));
    Ok(())
}
