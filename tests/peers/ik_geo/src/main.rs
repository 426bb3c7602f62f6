//! Our inverse kinematics beside the crate ik-geo, same arm, same poses, one run.
//!
//! `cmake` has to be on the PATH (a PyPI wheel offers it: `pip install "cmake<4"`); then, in this
//! folder, `cargo run --release`. Checks first that both give as many solutions.

use criterion::Criterion;
use ik_geo::inverse_kinematics::auxiliary::Matrix3x7;
use ik_geo::nalgebra::{Matrix3, Matrix3x6, Vector3};
use ik_geo::robot::{IKSolver, three_parallel_two_intersecting};
use rand::{Rng, SeedableRng};
use std::f64::consts::PI;
use std::hint::black_box;
use tdv_robot::{DhTable, Joints, Kinematics, base_link_to_base};

fn main() {
    // The same arm by its axes and offsets in the zero configuration, in `base`.
    let d = DhTable::UR5;
    let (y, z) = (Vector3::y(), Vector3::z());
    let h = Matrix3x6::from_columns(&[z, -y, -y, -y, -z, -y]);
    let p = Matrix3x7::from_columns(&[
        d.d1 * z,
        0.0 * y,
        d.a2 * Vector3::x(),
        d.a3 * Vector3::x(),
        -d.d4 * y,
        -d.d5 * z,
        -d.d6 * y,
    ]);
    let peer = three_parallel_two_intersecting(h, p);
    // Orientation of tool0 in `base` at zero, which ik-geo leaves out.
    let k = Kinematics::ur5();
    let in_base = |q: &Joints| {
        let pose = base_link_to_base().inverse() * k.fk(q);
        let m = pose.to_homogeneous();
        let r = Matrix3::from_fn(|i, j| m[(i, j)]);
        (r, Vector3::new(m[(0, 3)], m[(1, 3)], m[(2, 3)]))
    };
    let zero = in_base(&[0.0; 6]).0;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(11);
    let qs: Vec<Joints> =
        (0..1024).map(|_| std::array::from_fn(|_| rng.random_range(-PI..PI))).collect();
    let ours: Vec<_> = qs.iter().map(|q| k.fk(q)).collect();
    let theirs: Vec<_> = qs
        .iter()
        .map(|q| {
            let (r, t) = in_base(q);
            (r * zero.transpose(), t)
        })
        .collect();
    let (mut same, mut worst) = (0, 0.0f64);
    for ((q, a), (r, t)) in qs.iter().zip(&ours).zip(&theirs) {
        let (r2, t2) = peer.fk(q);
        worst = worst.max((r2 - r).abs().max()).max((t2 - t).abs().max());
        let exact = peer.ik(*r, *t).iter().filter(|s| !s.1).count();
        same += usize::from(exact == k.ik(a).len());
    }
    println!("forward kinematics agree to {worst:.1e}; {same} of 1024 poses have as many solutions");
    let mut c = Criterion::default().configure_from_args();
    let mut i = 0;
    c.bench_function("ik, ours", |b| {
        b.iter(|| {
            i = (i + 1) & 1023;
            k.ik(black_box(&ours[i]))
        })
    });
    c.bench_function("ik, ik-geo", |b| {
        b.iter(|| {
            i = (i + 1) & 1023;
            let (r, t) = black_box(theirs[i]);
            peer.ik(r, t)
        })
    });
    c.final_summary();
}
