use super::*;
use crate::average::average_frames;
use crate::candidates::{candidates, only};
use crate::testing::{Lab, mug_model, upright};
use tdv_rendering::mesh::primitives;
use tdv_rendering::shape::standing;

struct Made {
    assumed: Assumed,
    violation: f64,
    mesh: Mesh,
    /// Distances (m) of the mesh's points from the true surface: mean and 95th percentile.
    off: (f64, f64),
}

/// Mean and 95th percentile of the distances from points of `a` to the nearest of many points of `b`.
fn distances(a: &Mesh, b: &Mesh, t_b_a: &Pose) -> (f64, f64) {
    let dense = b.surface_points(12_000, 2);
    let mut all: Vec<f64> = a
        .surface_points(500, 1)
        .iter()
        .map(|s| {
            let p = t_b_a * s.point;
            dense.iter().map(|d| (d.point - p).norm_squared()).fold(f64::MAX, f64::min).sqrt()
        })
        .collect();
    all.sort_by(f64::total_cmp);
    (all.iter().sum::<f64>() / all.len() as f64, all[all.len() * 95 / 100])
}

fn make(seed: u64, truth: &Mesh, pose: Pose) -> Made {
    let mut lab = Lab::new(seed);
    let frames: Vec<RgbdFrame> = (0..10).map(|_| lab.frame(&[(truth, pose)])).collect();
    let frame = average_frames(&frames).unwrap();
    let (table, all) = candidates(&frame).unwrap();
    let some: Vec<&Candidate> = all.iter().collect();
    let thing = only(&some).unwrap();
    let r = Reconstruction::start(&frame, &table, thing, ReconstructConfig::default()).unwrap();
    let mesh = r.mesh().unwrap();
    let t_truth_made = (crate::testing::camera().inverse() * pose).inverse() * r.pose();
    let off = distances(&mesh, truth, &t_truth_made);
    Made { assumed: r.assumed(), violation: r.violation(), off, mesh }
}

#[test]
fn one_view_gives_the_whole_of_a_symmetric_thing() {
    let profile =
        [[0.0, 0.0], [0.033, 0.0], [0.033, 0.11], [0.014, 0.15], [0.014, 0.18], [0.0, 0.18]];
    let bottle = primitives::lathe(&profile, 48, &[[220, 180, 40]]);
    let boxy = standing(&primitives::cuboid([0.11, 0.06, 0.08], [190, 50, 40]));
    for (i, (name, truth, assumed)) in
        [("bottle", bottle, Assumed::Round), ("box", boxy, Assumed::TwoPlanes)]
            .into_iter()
            .enumerate()
    {
        let made = make(3, &truth, upright(0.47, 0.05, 0.0, 0.5 + i as f64));
        let ratio = made.mesh.volume() / truth.volume();
        let t = made.mesh.topology();
        println!(
            "{name}: {}, violation {:.3}, off {:.1} mm mean {:.1} mm p95, volume x{ratio:.2}, {} triangles, {t:?}",
            made.assumed,
            made.violation,
            made.off.0 * 1e3,
            made.off.1 * 1e3,
            made.mesh.triangles.len()
        );
        assert_eq!(made.assumed, assumed, "{name}");
        assert!(made.off.0 < 0.003 && made.off.1 < 0.007, "{name}: {:?}", made.off);
        assert!((0.88..1.12).contains(&ratio), "{name}: volume {ratio}");
        assert_eq!(t.open, 0, "{name} has holes");
    }
}

#[test]
fn a_mug_keeps_its_handle() {
    let truth = (*mug_model().mesh).clone();
    let made = make(4, &truth, upright(0.47, 0.0, 0.0, 1.1));
    println!(
        "mug: {}, violation {:.3}, off {:.1} mm mean {:.1} mm p95, volume {:.0} of {:.0} cm3",
        made.assumed,
        made.violation,
        made.off.0 * 1e3,
        made.off.1 * 1e3,
        made.mesh.volume() * 1e6,
        truth.volume() * 1e6
    );
    assert_ne!(made.assumed, Assumed::Round);
    let (low, high) = made.mesh.bounds();
    // 98 mm from the back to the end of the handle, 64 mm across, 90 mm high.
    let long = (high.x - low.x).max(high.y - low.y);
    assert!((0.085..0.112).contains(&long), "{long}");
    assert!((high.z - 0.09).abs() < 0.005, "{high}");
    assert!(made.off.0 < 0.006, "{:?}", made.off);
}

#[test]
fn later_views_cut_away_what_they_see_through() {
    let truth = standing(&primitives::cuboid([0.11, 0.06, 0.08], [190, 50, 40]));
    let mut lab = Lab::new(9);
    let at = upright(0.47, 0.0, 0.0, 0.4);
    let frame = lab.frame(&[(&truth, at)]);
    let (table, all) = candidates(&frame).unwrap();
    let start = || Reconstruction::start(&frame, &table, &all[0], ReconstructConfig::default());
    let (mut r, alone) = (start().unwrap(), start().unwrap().mesh().unwrap().volume());
    // A view of a narrower thing: nothing of its own is cut away, the rest is.
    let narrow = truth.stretched([0.6, 1.0, 1.0]);
    for k in 0..6 {
        let turned = upright(0.47, 0.0, 0.0, 0.4 + f64::from(k));
        let frame = lab.frame(&[(&narrow, turned)]);
        let t_made_truth = r.pose().inverse() * crate::testing::camera().inverse() * at;
        let pose = crate::testing::camera().inverse() * turned * t_made_truth.inverse();
        for _ in 0..3 {
            r.see_through(&frame, &pose);
        }
    }
    let cut = r.mesh().unwrap().volume();
    println!("{:.0} cm3, then {:.0} of {:.0}", alone * 1e6, cut * 1e6, narrow.volume() * 1e6);
    assert!(cut < 0.85 * alone && cut > 0.9 * narrow.volume(), "{alone} {cut}");
    assert!(matches!(
        Reconstruction::start(
            &RgbdFrame { depth: tdv_rendering::DepthImage::new(640, 480), ..frame.clone() },
            &table,
            &all[0],
            ReconstructConfig::default()
        ),
        Err(ReconstructError::Sparse { .. })
    ));
}
