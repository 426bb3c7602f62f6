use super::*;
use crate::average::average_frames;
use crate::candidates::{candidates, of_color, only};
use crate::testing::{Lab, coaster_model, mug_model, upright};
use tdv_rendering::mesh::primitives;
use tdv_rendering::shape::standing;

/// A view of an object, as the mean of ten frames, and what the estimate makes of a mesh.
fn estimate(
    seed: u64,
    seen: &Mesh,
    pose: Pose,
    given: &Mesh,
    symmetry: &Symmetry,
) -> Result<ScaleReport, ScaleError> {
    let mut lab = Lab::new(seed);
    let frames: Vec<RgbdFrame> = (0..10).map(|_| lab.frame(&[(seen, pose)])).collect();
    let frame = average_frames(&frames).unwrap();
    let (table, all) = candidates(&frame).unwrap();
    let c = only(&of_color(&all, "").unwrap()).unwrap();
    estimate_scale(&frame, &table, &c.cluster, &c.mask, given, symmetry, &ScaleConfig::default())
}

/// The mesh as a generator of meshes would hand it over.
fn through_glb(name: &str, mesh: &Mesh) -> Mesh {
    let path = std::env::temp_dir().join(format!("tdv-scale-{}-{name}.glb", std::process::id()));
    mesh.save_glb(&path).unwrap();
    let read = Mesh::load_unscaled(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    standing(&read)
}

#[test]
fn unit_less_meshes_get_their_size_within_three_per_cent() {
    let bottle = {
        let profile =
            [[0.0, 0.0], [0.033, 0.0], [0.033, 0.11], [0.014, 0.15], [0.014, 0.18], [0.0, 0.18]];
        primitives::lathe(&profile, 48, &[[220, 180, 40]])
    };
    let z = Symmetry::Continuous { axis: [0.0, 0.0, 1.0] };
    let boxy = standing(&primitives::cuboid([0.11, 0.06, 0.08], [190, 50, 40]));
    let things = [
        ("mug", (*mug_model().mesh).clone(), Symmetry::None),
        ("bottle", bottle, z.clone()),
        ("box", boxy, Symmetry::Discrete { rotations: vec![[0.0, 0.0, 1.0, 0.0]] }),
        ("coaster", (*coaster_model().mesh).clone(), z),
    ];
    for (i, (name, mesh, symmetry)) in things.into_iter().enumerate() {
        let pose = upright(0.45 + 0.03 * i as f64, 0.1 - 0.06 * i as f64, 0.0, 0.7 + i as f64);
        // As from a picture: one unit across, whatever its true size.
        let unit = 1.0 / mesh.diameter();
        let given = through_glb(name, &mesh.scaled(unit));
        let report = estimate(7 + i as u64, &mesh, pose, &given, &symmetry).unwrap();
        let error = report.scale * unit - 1.0;
        let list: Vec<String> = report
            .estimates
            .iter()
            .map(|e| format!("{} {:+.1} %", e.name, (e.value * unit - 1.0) * 100.0))
            .collect();
        println!(
            "{name}: {:+.2} %, spread {:.1} %, score {:.2}: {}",
            error * 100.0,
            report.spread * 100.0,
            report.score,
            list.join(", ")
        );
        assert!(error.abs() < 0.03, "{name}: {error}");
    }
}

#[test]
fn other_proportions_are_refused() {
    let tall = standing(&primitives::cuboid([0.06, 0.06, 0.16], [190, 50, 40]));
    let squat = tall.stretched([1.0, 1.0, 0.6]);
    let e = estimate(5, &tall, upright(0.5, 0.0, 0.0, 0.3), &squat, &Symmetry::None).unwrap_err();
    let text = e.to_string();
    println!("{text}");
    assert!(matches!(e, ScaleError::Disagree { .. } | ScaleError::NoMatch { .. }), "{text}");
    let flat = Mesh { positions: vec![[0.0; 3]; 3], ..Mesh::default() };
    let e = estimate(5, &tall, upright(0.5, 0.0, 0.0, 0.3), &flat, &Symmetry::None).unwrap_err();
    assert_eq!(e, ScaleError::Flat);
}
