//! Real RGB-D frames: the cube is found from a prompt and followed to the end.
#![allow(clippy::print_stdout)]

use std::path::Path;
use tdv_perception::evaluate_visp;

#[test]
fn cube_is_found_and_followed_to_the_end() {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/visp_rbt");
    if !dir.is_dir() {
        println!("skipped: {} is not there", dir.display());
        return;
    }
    let s = evaluate_visp(&dir).unwrap();
    println!("{s:?}");
    assert_eq!((s.frames, s.lost, s.symmetry_jumps), (99, 0, 0));
    assert!(s.compared >= 30, "{s:?}");
    assert!(s.median_translation_mm < 8.0 && s.median_rotation_deg < 4.0, "{s:?}");
}
