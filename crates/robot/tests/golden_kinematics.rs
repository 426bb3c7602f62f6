//! Our kinematics against numbers made by an independent implementation (tests/golden).

use nalgebra::{Matrix4, Rotation3, UnitQuaternion};
use std::f64::consts::{PI, TAU};
use tdv_geometry::Pose;
use tdv_robot::{Joints, Kinematics, base_link_to_base};

#[derive(serde::Deserialize)]
struct Case {
    q: Joints,
    base_tool0: Vec<f64>,
    ik: Vec<Joints>,
}

#[derive(serde::Deserialize)]
struct Golden {
    ur5: Vec<Case>,
    ur5e: Vec<Case>,
}

fn apart(a: &Joints, b: &Joints) -> f64 {
    let wrap = |d: f64| (d + PI).rem_euclid(TAU) - PI;
    a.iter().zip(b).map(|(x, y)| wrap(x - y).abs()).fold(0.0, f64::max)
}

#[test]
fn forward_and_inverse_agree() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/kinematics.json");
    let golden: Golden = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    for (k, cases) in [(Kinematics::ur5(), golden.ur5), (Kinematics::ur5e(), golden.ur5e)] {
        assert_eq!(cases.len(), 40);
        for c in cases {
            let m = Matrix4::from_row_slice(&c.base_tool0);
            let r = m.fixed_view::<3, 3>(0, 0).into_owned();
            let p = m.fixed_view::<3, 1>(0, 3).into_owned();
            let ours = base_link_to_base().inverse() * k.fk(&c.q);
            assert!((ours.translation.vector - p).norm() < 1e-12, "{:?}", c.q);
            let turned = ours.rotation.to_rotation_matrix();
            assert!((turned.matrix() - r).abs().max() < 1e-12);
            if c.ik.is_empty() {
                continue; // the singular zero configuration: forward only
            }
            let rotation =
                UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(r));
            let target = base_link_to_base() * Pose::from_parts(p.into(), rotation);
            let found = k.ik(&target);
            assert_eq!(found.len(), c.ik.len(), "{:?}", c.q);
            for s in &c.ik {
                let best = found.iter().map(|f| apart(f, s)).fold(f64::INFINITY, f64::min);
                assert!(best < 1e-7, "solution {s:?} is missing, nearest {best:.1e}");
            }
        }
    }
}
