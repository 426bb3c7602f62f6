use super::{IkSolutions, JOINT_NAMES, Joints};
use std::f64::consts::TAU;
use tdv_geometry::Pose;
use thiserror::Error;

/// How to choose among the solutions of the inverse kinematics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IkSelection {
    /// Least joint angles (rad).
    pub lower: Joints,
    /// Greatest joint angles (rad).
    pub upper: Joints,
    /// Weight of each joint in the distance to the seed; the large joints cost more.
    pub weights: Joints,
    /// Greatest change of any joint from the seed (rad); infinite for none.
    pub max_step: f64,
}

impl Default for IkSelection {
    fn default() -> Self {
        Self {
            lower: [-TAU; 6],
            upper: [TAU; 6],
            weights: [3.0, 3.0, 2.0, 1.0, 1.0, 0.5],
            max_step: f64::INFINITY,
        }
    }
}

/// Why there is no joint solution to go to.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum IkError {
    /// A number of the target or the seed is NaN or infinite.
    #[error("{what} is not finite")]
    NotFinite {
        /// Target or seed.
        what: &'static str,
    },
    /// The pose is outside the arm's reach.
    #[error(
        "flange position ({x:.3}, {y:.3}, {z:.3}) m in base_link is out of reach in this orientation"
    )]
    Unreachable {
        /// Metres.
        x: f64,
        /// Metres.
        y: f64,
        /// Metres.
        z: f64,
    },
    /// Every solution breaks a joint limit; the one named is of the solution nearest to the seed.
    #[error("{joint} would be at {value:.3} rad, its range is {lower:.3}..{upper:.3}")]
    OutsideLimits {
        /// The joint's name.
        joint: &'static str,
        /// Rad.
        value: f64,
        /// Rad.
        lower: f64,
        /// Rad.
        upper: f64,
    },
    /// The nearest solution is on another branch or a whole turn away.
    #[error(
        "{joint} would jump by {step:.3} rad, {max_step:.3} is allowed: another branch of the inverse kinematics"
    )]
    BranchFlip {
        /// The joint's name.
        joint: &'static str,
        /// Rad.
        step: f64,
        /// Rad.
        max_step: f64,
    },
}

/// `angle` plus the whole turns that bring it nearest to `near` within `lower..=upper`; the nearest
/// of all turns when none is within.
pub fn unwrap_near(angle: f64, near: f64, lower: f64, upper: f64) -> f64 {
    let best = angle + ((near - angle) / TAU).round() * TAU;
    if best < lower && best + TAU <= upper {
        best + TAU
    } else if best > upper && best - TAU >= lower {
        best - TAU
    } else {
        best
    }
}

pub(super) fn nearest(
    solve: impl FnOnce() -> IkSolutions,
    target: &Pose,
    seed: &Joints,
    sel: &IkSelection,
) -> Result<Joints, IkError> {
    if !seed.iter().all(|v| v.is_finite()) {
        return Err(IkError::NotFinite { what: "seed" });
    }
    let p = target.translation.vector;
    if !p.iter().chain(target.rotation.coords.iter()).all(|v| v.is_finite()) {
        return Err(IkError::NotFinite { what: "target pose" });
    }
    let mut inside: Option<(f64, Joints)> = None;
    let mut outside: Option<(f64, usize, f64)> = None;
    for s in solve().iter() {
        let q: Joints =
            std::array::from_fn(|i| unwrap_near(s[i], seed[i], sel.lower[i], sel.upper[i]));
        let distance: f64 = (0..6).map(|i| (sel.weights[i] * (q[i] - seed[i])).powi(2)).sum();
        match (0..6).find(|&i| q[i] < sel.lower[i] || q[i] > sel.upper[i]) {
            None if inside.is_none_or(|(best, _)| distance < best) => inside = Some((distance, q)),
            Some(i) if outside.is_none_or(|(best, ..)| distance < best) => {
                outside = Some((distance, i, q[i]));
            }
            _ => {}
        }
    }
    let Some((_, q)) = inside else {
        return Err(match outside {
            Some((_, i, value)) => IkError::OutsideLimits {
                joint: JOINT_NAMES[i],
                value,
                lower: sel.lower[i],
                upper: sel.upper[i],
            },
            None => IkError::Unreachable { x: p.x, y: p.y, z: p.z },
        });
    };
    if let Some(i) = (0..6).find(|&i| (q[i] - seed[i]).abs() > sel.max_step) {
        return Err(IkError::BranchFlip {
            joint: JOINT_NAMES[i],
            step: q[i] - seed[i],
            max_step: sel.max_step,
        });
    }
    Ok(q)
}

#[cfg(test)]
mod tests {
    use super::super::Kinematics;
    use super::*;
    use std::f64::consts::PI;
    use tdv_geometry::pose_distance;

    const SEED: Joints = [0.2, -1.3, 1.7, -2.0, -1.6, 0.4];

    #[test]
    fn follows_across_the_wrap() {
        let k = Kinematics::ur5();
        let mut seed = SEED;
        seed[5] = 3.0;
        for i in 0..200 {
            let mut want = SEED;
            want[5] = 3.0 + 0.01 * f64::from(i);
            let q = k
                .nearest(&k.fk(&want), &seed, &IkSelection { max_step: 0.05, ..Default::default() })
                .unwrap();
            assert!((q[5] - want[5]).abs() < 1e-9, "continuous over pi");
            seed = q;
        }
        assert!(seed[5] > PI + 1.0);
    }

    #[test]
    fn a_limit_chooses_another_turn_or_refuses() {
        assert!((unwrap_near(3.1, -3.1, -3.5, 3.5) - (3.1 - TAU)).abs() < 1e-12);
        assert!((unwrap_near(3.1, -3.1, -3.15, 3.15) - 3.1).abs() < 1e-12);
        let k = Kinematics::ur5();
        let mut sel = IkSelection::default();
        sel.upper[0] = -1.0;
        sel.lower[0] = -1.1;
        let e = k.nearest(&k.fk(&SEED), &SEED, &sel).unwrap_err();
        assert!(matches!(e, IkError::OutsideLimits { joint: "shoulder_pan_joint", .. }), "{e}");
    }

    #[test]
    fn branch_flip_unreachable_and_nan_are_errors() {
        let k = Kinematics::ur5();
        let sel = IkSelection { max_step: 0.1, ..Default::default() };
        let other = k.ik(&k.fk(&SEED))[0];
        let far = if (other[2] - SEED[2]).abs() > 0.1 { other } else { k.ik(&k.fk(&SEED))[1] };
        let lone =
            IkSelection { lower: far.map(|v| v - 0.01), upper: far.map(|v| v + 0.01), ..sel };
        assert!(matches!(k.nearest(&k.fk(&far), &SEED, &lone), Err(IkError::BranchFlip { .. })));
        let far = Pose::translation(1.5, 0.0, 0.0);
        assert!(matches!(k.nearest(&far, &SEED, &sel), Err(IkError::Unreachable { .. })));
        let bad = Pose::translation(f64::NAN, 0.0, 0.0);
        assert!(matches!(k.nearest(&bad, &SEED, &sel), Err(IkError::NotFinite { .. })));
    }

    #[test]
    fn a_singular_wrist_keeps_joint_6_of_the_seed() {
        let k = Kinematics::ur5();
        let mut q = SEED;
        q[4] = 0.0;
        let got = k.nearest(&k.fk(&q), &q, &IkSelection::default()).unwrap();
        assert!((0..6).all(|i| (got[i] - q[i]).abs() < 1e-6), "{got:?}");
        assert!(pose_distance(&k.fk(&got), &k.fk(&q)).0 < 1e-9);
    }
}
