//! The UR5 (CB3) of the lab: its link frames and the round shapes that its links have, for contact and
//! for drawing.

use tdv_geometry::Pose;
use tdv_robot::Kinematics;
pub use tdv_robot::base_link_to_base;

/// Poses of the seven link frames in `base_link` for the joint angles `q` (rad): the base, then the
/// Denavit-Hartenberg frame after each joint; the last one is `tool0`.
pub fn link_frames(q: &[f64; 6]) -> [Pose; 7] {
    Kinematics::ur5().frames(q)
}

/// What a piece of the arm is painted like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Paint {
    /// Light grey tube.
    Tube,
    /// Blue joint cap.
    Cap,
    /// Dark plastic or steel.
    Dark,
}

/// A round piece of a link: a capsule for contact, a cylinder for drawing.
#[derive(Debug, Clone, Copy)]
pub struct LinkPiece {
    /// Index into [`link_frames`].
    pub frame: usize,
    /// One end of its axis in that frame, m.
    pub a: [f64; 3],
    /// The other end.
    pub b: [f64; 3],
    /// Radius, m.
    pub radius: f64,
    /// Colour when drawn.
    pub paint: Paint,
}

const fn piece(frame: usize, a: [f64; 3], b: [f64; 3], radius: f64, paint: Paint) -> LinkPiece {
    LinkPiece { frame, a, b, radius, paint }
}

/// Offset of the upper arm from the shoulder axis plane (m).
const SHOULDER: f64 = 0.13585;
/// The same for the forearm: shoulder offset less the elbow's 0.1197 m.
const ELBOW: f64 = SHOULDER - 0.1197;

/// All round pieces of the arm, from the base to the flange. The first two do not move against the
/// table and are left out of the table check.
pub const PIECES: [LinkPiece; 12] = [
    piece(0, [0.0, 0.0, 0.0], [0.0, 0.0, 0.04], 0.075, Paint::Dark),
    piece(1, [0.0, -0.05, 0.0], [0.0, 0.05, 0.0], 0.06, Paint::Tube),
    piece(1, [0.0, 0.0, 0.0], [0.0, 0.0, 0.07], 0.058, Paint::Tube),
    piece(2, [0.425, 0.0, 0.075], [0.425, 0.0, SHOULDER + 0.055], 0.06, Paint::Cap),
    piece(2, [0.425, 0.0, SHOULDER], [0.0, 0.0, SHOULDER], 0.052, Paint::Tube),
    piece(2, [0.0, 0.0, 0.06], [0.0, 0.0, SHOULDER + 0.05], 0.052, Paint::Cap),
    piece(3, [0.39225, 0.0, ELBOW - 0.04], [0.39225, 0.0, ELBOW + 0.04], 0.05, Paint::Cap),
    piece(3, [0.39225, 0.0, ELBOW], [0.0, 0.0, ELBOW], 0.04, Paint::Tube),
    piece(3, [0.0, 0.0, ELBOW - 0.04], [0.0, 0.0, ELBOW + 0.045], 0.04, Paint::Cap),
    piece(4, [0.0, -0.05, 0.0], [0.0, 0.045, 0.0], 0.039, Paint::Tube),
    piece(5, [0.0, 0.05, 0.0], [0.0, -0.045, 0.0], 0.039, Paint::Cap),
    piece(6, [0.0, 0.0, -0.05], [0.0, 0.0, 0.0], 0.037, Paint::Dark),
];

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::nalgebra::Vector3;

    #[test]
    fn zero_configuration_matches_the_published_numbers() {
        let tool0 = base_link_to_base().inverse() * link_frames(&[0.0; 6])[6];
        let t = tool0.translation.vector;
        assert!((t - Vector3::new(-0.81725, -0.19145, -0.005491)).norm() < 1e-9, "{t}");
    }
}
