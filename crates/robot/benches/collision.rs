//! Collision checks of free and colliding configurations among fixtures.
//!
//! `cargo bench -p tdv-robot --bench collision`.

use criterion::{Criterion, criterion_group, criterion_main};
use rand::{Rng, SeedableRng};
use std::hint::black_box;
use std::path::Path;
use tdv_robot::Joints;
use tdv_robot::collision::{CollisionWorld, ConvexPart, HeldObject, Margins, Workcell};
use tdv_robot::urdf::RobotModel;

const CELL: &str = "
fixtures:
- {name: wall, shape: {box: [0.02, 0.4, 0.25]}, position: [0.5, 0.0, 0.125]}
- {name: shelf, shape: {box: [0.3, 0.3, 0.02]}, position: [0.5, -0.35, 0.35]}
- {name: side, shape: {box: [0.3, 0.02, 0.35]}, position: [0.5, -0.5, 0.175]}
- {name: post, shape: {cylinder: [0.03, 0.5]}, position: [0.3, 0.35, 0.25]}
";

fn bench(c: &mut Criterion) {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/robot/ur5_2f85.urdf");
    let Ok(model) = RobotModel::load(Path::new(path)) else { return };
    let Ok(cell) = serde_saphyr::from_str::<Workcell>(CELL) else { return };
    let Ok(world) = CollisionWorld::new(&model, &cell, Margins::default(), 0.0) else { return };
    let part = ConvexPart::capsule([0.0, 0.0, 0.1], [0.0, 0.0, 0.2], 0.03);
    let Ok(part) = part else { return };
    let held = HeldObject::new("bottle", vec![part], &nalgebra::Isometry3::identity(), &[]);
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let mut free = Vec::new();
    let mut any: Vec<Joints> = Vec::new();
    while free.len() < 512 {
        let about = [0.0, -1.5, 1.5, -1.5, -1.6, 0.0];
        let q: Joints = std::array::from_fn(|i| about[i] + rng.random_range(-1.2..1.2));
        any.push(q);
        if world.check(&q, 0.3, Some(&held)).is_ok() {
            free.push(q);
        }
    }
    let mut i = 0;
    let mut next = || {
        i += 1;
        i
    };
    let at = |list: &[Joints], n: usize| black_box(list[n % list.len()]);
    c.bench_function("check, free", |b| b.iter(|| world.check(&at(&free, next()), 0.3, None)));
    c.bench_function("check, free, holding", |b| {
        b.iter(|| world.check(&at(&free, next()), 0.3, Some(&held)));
    });
    c.bench_function("check, any", |b| b.iter(|| world.check(&at(&any, next()), 0.3, None)));
    c.bench_function("distance, free", |b| {
        b.iter(|| world.distance(&at(&free, next()), 0.3, None))
    });
}

criterion_group!(benches, bench);
criterion_main!(benches);
