//! Inverse kinematics: all solutions of random poses, and forward kinematics beside it.
//!
//! `cargo bench -p tdv-robot --bench ik`. The same poses against another implementation, in one run:
//! tests/peers/ik_geo.

use criterion::{Criterion, criterion_group, criterion_main};
use rand::{Rng, SeedableRng};
use std::f64::consts::PI;
use std::hint::black_box;
use tdv_robot::{IkSelection, Joints, Kinematics};

fn bench(c: &mut Criterion) {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
    let qs: Vec<Joints> =
        (0..1024).map(|_| std::array::from_fn(|_| rng.random_range(-PI..PI))).collect();
    let k = Kinematics::ur5();
    let poses: Vec<_> = qs.iter().map(|q| k.fk(q)).collect();
    let mut i = 0;
    let mut next = move || {
        i = (i + 1) & 1023;
        i
    };
    c.bench_function("ik, all solutions", |b| b.iter(|| k.ik(black_box(&poses[next()]))));
    c.bench_function("ik, nearest", |b| {
        b.iter(|| {
            let n = next();
            k.nearest(black_box(&poses[n]), &qs[n], &IkSelection::default())
        });
    });
    c.bench_function("fk", |b| b.iter(|| k.fk(black_box(&qs[next()]))));
}

criterion_group!(benches, bench);
criterion_main!(benches);
