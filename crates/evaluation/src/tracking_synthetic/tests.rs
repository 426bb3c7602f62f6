use super::*;

#[test]
fn the_same_seed_gives_the_same_poses_and_errors() {
    let all = objects();
    let config = SyntheticConfig { frames: 4, ..SyntheticConfig::default() };
    let without_time = |mut r: SequenceResult| {
        r.frames.iter_mut().for_each(|f| f.ms = 0.0);
        r
    };
    let a = without_time(run(&all[1], 1, 3, &config, |_| {}).unwrap());
    let b = without_time(run(&all[1], 1, 3, &config, |_| {}).unwrap());
    assert_eq!(a, b);
    assert_eq!(a.frames.len(), 4);
    let other = SyntheticConfig { seed: 2, ..config };
    let c = without_time(run(&all[1], 1, 3, &other, |_| {}).unwrap());
    assert_ne!(a.frames, c.frames);
}

#[test]
#[ignore = "open: the mug in the gripper is hidden by up to 86 %, at most 80 are wanted"]
fn hands_and_grippers_hide_a_part_and_not_all() {
    let all = objects();
    for (number, index) in [(4, 2), (0, 3), (4, 4)] {
        let shot = shot(&all[number], number, index, 60, 1);
        let (mesh, poses) = shot.occluder.as_ref().unwrap();
        let mut gauge = Gauge::new(&shot.camera);
        let hidden: Vec<f64> = shot
            .object
            .iter()
            .zip(poses)
            .map(|(p, o)| gauge.hidden(&all[number].mesh, p, mesh, o))
            .collect();
        let most = hidden.iter().copied().fold(0.0, f64::max);
        assert!((0.15..0.8).contains(&most), "{number} {index}: {most}");
    }
}
