//! The pipeline with stand-ins for the networks that look at the same crops.

use super::*;
use candle_core::{D, DType};
use nalgebra::Point3;
use tdv_geometry::{Stamp, Symmetry, pose_from_xyz_rpy};
use tdv_rendering::mesh::primitives;
use tdv_rendering::{Instance, Intrinsics, Lighting, Mesh, Rendered, Renderer};

const K: Intrinsics =
    Intrinsics { width: 640, height: 480, fx: 610.0, fy: 610.0, cx: 319.5, cy: 239.5 };

/// Brings the middle of the drawn points onto that of the measured ones; turns nothing.
struct Centroids;

impl Refine for Centroids {
    fn refine(&self, a: &Tensor, b: &Tensor) -> Result<(Tensor, Tensor), FoundationError> {
        let middle = |t: &Tensor| -> candle_core::Result<Tensor> {
            let points = t.narrow(1, 3, 3)?.flatten_from(2)?;
            let there = points.narrow(1, 2, 1)?.ne(0f32)?.to_dtype(DType::F32)?;
            let count = there.sum(D::Minus1)?.clamp(1f32, f32::MAX)?;
            points.broadcast_mul(&there)?.sum(D::Minus1)?.broadcast_div(&count)
        };
        let step = (middle(b)? - middle(a)?)?;
        let none = step.zeros_like()?;
        Ok((step, none))
    }
}

/// Prefers crops with the same points. Colour is left out: the scene's light is not the networks'.
struct Difference;

impl Rank for Difference {
    fn features(&self, a: &Tensor, b: &Tensor) -> Result<Tensor, FoundationError> {
        let there = |t: &Tensor| t.narrow(1, 5, 1)?.ne(0f32)?.to_dtype(DType::F32);
        let (in_a, in_b) = (there(a)?, there(b)?);
        let both = (&in_a * &in_b)?;
        let either = ((in_a + in_b)? - &both)?;
        let distance = (a.narrow(1, 3, 3)? - b.narrow(1, 3, 3)?)?.abs()?.sum_keepdim(1)?;
        // A point that only one of them has counts fully.
        let cost = ((distance.clamp(0f32, 1f32)? * &both)? + (&either - &both)?)?;
        let sum = |t: Tensor| t.flatten_from(1)?.sum(1);
        Ok((sum(cost)?.neg()? / (sum(either)? + 1.0)?)?.unsqueeze(1)?)
    }
    fn compare(&self, features: &Tensor) -> Result<Tensor, FoundationError> {
        Ok(features.flatten_all()?)
    }
}

/// A block with an arm: no two views are alike.
fn thing() -> Mesh {
    let mut mesh = primitives::cuboid([0.04, 0.06, 0.12], [40, 80, 190]);
    let arm = primitives::cuboid([0.06, 0.03, 0.03], [190, 60, 40]);
    mesh.append(&arm.transformed(&pose_from_xyz_rpy([0.045, 0.015, 0.045], [0.0; 3])));
    mesh
}

/// It before a wall.
fn scene(pose: &Pose) -> (RgbdFrame, Vec<bool>) {
    let (mesh, wall) = (thing(), primitives::cuboid([3.0, 3.0, 0.1], [120, 120, 120]));
    let mut out = Rendered::default();
    let scene = [
        Instance { mesh: &wall, pose: Pose::translation(0.0, 0.0, 1.3), id: 1 },
        Instance { mesh: &mesh, pose: *pose, id: 2 },
    ];
    Renderer::new().render(&K, &scene, &Lighting::default(), &mut out);
    let mask = out.ids.iter().map(|i| *i == 2).collect();
    let frame = RgbdFrame { stamp: Stamp(0), color: out.color, depth: out.depth, intrinsics: K };
    (frame, mask)
}

fn estimator(px: u32) -> PoseEstimator<Centroids, Difference> {
    let config = PoseConfig { crop_px: px, ..PoseConfig::default() };
    PoseEstimator::new(Centroids, Difference, Device::Cpu, config).unwrap()
}

#[test]
fn an_object_is_registered() {
    // One of the hypotheses' orientations: the stand-in does not turn.
    let turn = hypotheses::rotations(&Symmetry::None)[100];
    let truth = Pose::from_parts(Vector3::new(0.08, -0.04, 0.7).into(), turn);
    let (frame, mask) = scene(&truth);
    let target = Target::new(&thing(), &Symmetry::None).unwrap();
    let mut e = estimator(40);
    let found = e.register(&frame, |u, v| mask[(v * 640 + u) as usize], &target).unwrap();
    let (d, angle) = tdv_geometry::pose_distance(&found.pose, &truth);
    assert!(d < 0.01 && angle < 0.1, "{d:.4} m {:.1} deg", angle.to_degrees());
    assert!(found.agreement > 0.6, "{}", found.agreement);
}

#[test]
fn an_object_is_followed() {
    let truth = pose_from_xyz_rpy([0.08, -0.04, 0.7], [2.1, 0.2, 0.9]);
    let (frame, _) = scene(&truth);
    let target = Target::new(&thing(), &Symmetry::None).unwrap();
    let mut e = estimator(40);
    // From a pose beside the truth, right orientation: the stand-in only moves.
    let beside = Pose::translation(0.012, -0.008, 0.01) * truth;
    let before = e.agreement(&frame, &checked(&frame).unwrap(), &target, &target.centred(&beside));
    let mut pose = beside;
    let mut agreement = 0.0;
    for _ in 0..4 {
        let found = e.follow(&frame, &target, &pose).unwrap();
        (pose, agreement) = (found.pose, found.agreement);
    }
    let off = (pose.translation.vector - truth.translation.vector).norm();
    // The filter thins out slanted faces, which shifts the middle of the points.
    assert!(off < 0.006, "{off}");
    assert!(agreement > before + 0.3, "{agreement} {before}");
}

#[test]
fn a_step_moves_in_radii_and_turns_at_most_twenty_degrees() {
    let pose = pose_from_xyz_rpy([0.1, 0.2, 0.8], [0.3, 0.2, 0.1]);
    let p = improved(&pose, &Vector3::new(0.1, 0.0, -0.2), &Vector3::new(0.0, 0.0, 100.0), 0.05);
    let moved = p.translation.vector - pose.translation.vector;
    assert!((moved - Vector3::new(0.005, 0.0, -0.01)).norm() < 1e-12);
    let turn = (p.rotation * pose.rotation.inverse()).scaled_axis();
    assert!((turn - Vector3::new(0.0, 0.0, -TURN)).norm() < 1e-9, "{turn}");
    let nan = improved(&pose, &Vector3::repeat(f64::NAN), &Vector3::zeros(), 0.05);
    assert_eq!(nan, pose);
}

#[test]
fn what_cannot_be_done_is_an_error() {
    let truth = pose_from_xyz_rpy([0.0, 0.0, 0.7], [2.1, 0.2, 0.9]);
    let (mut frame, mask) = scene(&truth);
    let target = Target::new(&thing(), &Symmetry::None).unwrap();
    let mut e = estimator(16);
    let none = e.register(&frame, |_, _| false, &target).unwrap_err().to_string();
    assert!(none.contains("mask"), "{none}");
    let behind = e.follow(&frame, &target, &Pose::translation(0.0, 0.0, -1.0));
    assert!(behind.is_err());
    frame.depth.data.fill(0.0);
    assert!(e.register(&frame, |u, v| mask[(v * 640 + u) as usize], &target).is_err());
    let lost = e.follow(&frame, &target, &truth).unwrap();
    assert_eq!(lost.agreement, 0.0);
    assert!((lost.pose * Point3::origin()).z.is_finite());
    frame.depth.data.pop();
    assert!(e.follow(&frame, &target, &truth).is_err());
    for bad in [
        PoseConfig { crop_px: 20, ..PoseConfig::default() },
        PoseConfig { batch: 0, ..PoseConfig::default() },
        PoseConfig { score_crop: f64::NAN, ..PoseConfig::default() },
    ] {
        assert!(PoseEstimator::new(Centroids, Difference, Device::Cpu, bad).is_err());
    }
}
