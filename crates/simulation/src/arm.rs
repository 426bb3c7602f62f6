//! The arms of the lab: their link frames and the round shapes that their links have, for contact and
//! for drawing.

use tdv_geometry::Pose;
use tdv_robot::Kinematics;
pub use tdv_robot::base_link_to_base;

/// Which arm stands on the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ArmModel {
    /// The UR5 of the CB3 series.
    #[default]
    Ur5,
    /// The UR5e.
    Ur5e,
}

impl ArmModel {
    /// Its kinematics, with the default tool.
    pub fn kinematics(self) -> Kinematics {
        match self {
            Self::Ur5 => Kinematics::ur5(),
            Self::Ur5e => Kinematics::ur5e(),
        }
    }

    /// As the robot's description and the parameter `robot` have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ur5 => "ur5",
            Self::Ur5e => "ur5e",
        }
    }

    /// Poses of the seven link frames in `base_link` for the joint angles `q` (rad): the base, then the
    /// Denavit-Hartenberg frame after each joint; the last one is `tool0`.
    pub fn link_frames(self, q: &[f64; 6]) -> [Pose; 7] {
        self.kinematics().frames(q)
    }

    /// All round pieces of the arm, from the base to the flange. The first two do not move against the
    /// table and are left out of the table check.
    pub fn pieces(self) -> [LinkPiece; 12] {
        match self {
            Self::Ur5 => pieces(0.135_85, 0.1197, 0.392_25),
            Self::Ur5e => pieces(0.138, 0.131, 0.3922),
        }
    }
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
    /// Index into [`ArmModel::link_frames`].
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

/// `shoulder`: offset (m) of the upper arm from the shoulder axis' plane; the forearm is nearer by `elbow`;
/// `forearm`: its length (m).
const fn pieces(shoulder: f64, elbow: f64, forearm: f64) -> [LinkPiece; 12] {
    let fore = shoulder - elbow;
    [
        piece(0, [0.0, 0.0, 0.0], [0.0, 0.0, 0.04], 0.075, Paint::Dark),
        piece(1, [0.0, -0.05, 0.0], [0.0, 0.05, 0.0], 0.06, Paint::Tube),
        piece(1, [0.0, 0.0, 0.0], [0.0, 0.0, 0.07], 0.058, Paint::Tube),
        piece(2, [0.425, 0.0, 0.075], [0.425, 0.0, shoulder + 0.055], 0.06, Paint::Cap),
        piece(2, [0.425, 0.0, shoulder], [0.0, 0.0, shoulder], 0.052, Paint::Tube),
        piece(2, [0.0, 0.0, 0.06], [0.0, 0.0, shoulder + 0.05], 0.052, Paint::Cap),
        piece(3, [forearm, 0.0, fore - 0.04], [forearm, 0.0, fore + 0.04], 0.05, Paint::Cap),
        piece(3, [forearm, 0.0, fore], [0.0, 0.0, fore], 0.04, Paint::Tube),
        piece(3, [0.0, 0.0, fore - 0.04], [0.0, 0.0, fore + 0.045], 0.04, Paint::Cap),
        piece(4, [0.0, -0.05, 0.0], [0.0, 0.045, 0.0], 0.039, Paint::Tube),
        piece(5, [0.0, 0.05, 0.0], [0.0, -0.045, 0.0], 0.039, Paint::Cap),
        piece(6, [0.0, 0.0, -0.05], [0.0, 0.0, 0.0], 0.037, Paint::Dark),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::nalgebra::Vector3;

    #[test]
    fn zero_configurations_match_the_published_numbers() {
        for (arm, want) in [
            (ArmModel::Ur5, Vector3::new(-0.81725, -0.19145, -0.005491)),
            (ArmModel::Ur5e, Vector3::new(-0.8172, -0.2329, 0.0628)),
        ] {
            let tool0 = base_link_to_base().inverse() * arm.link_frames(&[0.0; 6])[6];
            let t = tool0.translation.vector;
            assert!((t - want).norm() < 1e-9, "{arm:?}: {t}");
        }
    }
}
