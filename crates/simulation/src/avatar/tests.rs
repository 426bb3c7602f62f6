use super::*;
use nalgebra::{Point3, Vector3};
use tdv_geometry::Pose;

#[test]
fn bones_keep_their_length_however_the_hand_bends() {
    let shape = HandShape::default();
    let mut pose = HandPose::relaxed(Pose::identity());
    for k in 0..12 {
        pose.thumb.mcp = 0.1 * f64::from(k);
        pose.thumb.roll = 0.3 * f64::from(k);
        pose.fingers[k as usize % 4].pip = 0.12 * f64::from(k);
        pose.fingers[k as usize % 4].spread = 0.02 * f64::from(k);
        let j = shape.joints(&pose);
        for (b, length) in shape.thumb.iter().enumerate() {
            assert!(((j[b + 2] - j[b + 1]).norm() - length).abs() < 1e-12);
        }
        for f in 0..4 {
            for (b, length) in shape.fingers[f].iter().enumerate() {
                let i = 5 + 4 * f + b;
                assert!(((j[i + 1] - j[i]).norm() - length).abs() < 1e-12);
            }
        }
    }
}

#[test]
fn flexing_goes_to_the_inside_of_the_palm_and_the_thumb_is_on_its_side() {
    let shape = HandShape::default();
    let mut pose = HandPose::relaxed(Pose::identity());
    let before = shape.joints(&pose);
    pose.fingers[1].mcp += 0.5;
    let after = shape.joints(&pose);
    assert!(after[12].z < before[12].z - 0.02);
    assert!(before[4].y > before[8].y && before[8].y > before[20].y);
    let length = (before[12] - before[0]).norm();
    assert!((0.17..0.21).contains(&length), "{length}");
}

#[test]
fn the_mug_grasp_gives_the_gripper_pose_that_is_wanted() {
    let target = GraspTarget::mug();
    let fit = fit_grasp(&HandShape::default(), &target);
    let p = fit.tool.translation.vector;
    let z = fit.tool.rotation * Vector3::z();
    let y = fit.tool.rotation * Vector3::y();
    let lean = (-z.z).acos().to_degrees();
    let turn = y.y.abs().acos().to_degrees();
    println!(
        "tcp at ({:.1}, {:.1}, {:.1}) mm, approach {lean:.1} deg from down, closing axis {turn:.1} \
         deg from y, gaps {:?} mm, intrusion {:.2} mm",
        p.x * 1e3,
        p.y * 1e3,
        p.z * 1e3,
        fit.gaps.map(|g| (g * 1e5).round() / 1e2),
        fit.intrusion * 1e3
    );
    println!("{:#?}", fit.closed);
    for (i, j) in HandShape::default().joints(&fit.closed).iter().enumerate() {
        println!("{i} {:.1} {:.1} {:.1}", j.x * 1e3, j.y * 1e3, j.z * 1e3);
    }
    assert!((0.055..0.065).contains(&p.z));
    assert!(p.xy().norm() < 0.008);
    assert!(lean < 10.0 && turn < 10.0);
    assert!(fit.gaps.iter().all(|g| g.abs() < 1.5e-3));
    assert!(fit.intrusion < 2e-3);
    assert_eq!(fit, fit_grasp(&HandShape::default(), &target));
}

#[test]
fn the_open_hand_clears_the_mug() {
    let target = GraspTarget::mug();
    let shape = HandShape::default();
    let fit = fit_grasp(&shape, &target);
    let joints = shape.joints(&fit.open);
    for tip in [3, 4, 7, 8, 11, 12] {
        let gap = target.distance(&joints[tip]) - 0.009;
        assert!(gap > 0.004, "joint {tip}: {:.1} mm", gap * 1e3);
    }
}

#[test]
fn a_left_or_degenerate_hand_is_no_tool() {
    assert!(tool_from_hand(&[Point3::origin(); 21]).is_none());
}

#[test]
fn the_skin_is_closed_and_encloses_the_joints() {
    let shape = HandShape::default();
    let pose = HandPose::relaxed(Pose::identity());
    let mesh = Skin::default().mesh(&shape, &pose, &Point3::new(-0.3, 0.0, 0.05));
    assert!((4_000..30_000).contains(&mesh.triangles.len()), "{}", mesh.triangles.len());
    let volume = mesh.volume();
    // A hand and most of a forearm: about a litre.
    assert!((4e-4..1.6e-3).contains(&volume), "{volume}");
    for (i, j) in shape.joints(&pose).iter().enumerate() {
        let nearest = mesh
            .positions
            .iter()
            .map(|p| (Point3::from(p.map(f64::from)) - j).norm())
            .fold(f64::MAX, f64::min);
        assert!((0.004..0.03).contains(&nearest), "joint {i}: {nearest}");
    }
    let mut edges = std::collections::HashMap::<(u32, u32), i32>::new();
    for t in &mesh.triangles {
        for k in 0..3 {
            *edges.entry((t[k], t[(k + 1) % 3])).or_default() += 1;
            *edges.entry((t[(k + 1) % 3], t[k])).or_default() -= 1;
        }
    }
    assert!(edges.values().all(|n| *n == 0));
}
