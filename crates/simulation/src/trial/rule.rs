//! What counts as done: one rule for each kind of task, and what was measured.

use super::{Observed, SuccessConfig};
use serde::{Deserialize, Serialize};
use tdv_geometry::nalgebra::{Point3, Vector3};

/// When a task is done. Lengths in m, axes and heights in the reference object's frame.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Rule {
    /// The moving object stands at its goal on the reference, released and at rest.
    #[default]
    Placing,
    /// Enough of the drops are in the reference, a cup. The poured cup may still be held.
    Pouring {
        /// Least share of all drops, 0 to 1.
        share: f64,
        /// Inner radius of the cup.
        radius: f64,
        /// Height of the cup's rim.
        height: f64,
    },
    /// The moving object, a ring, is round the reference's z axis, released and at rest.
    Ring {
        /// Largest distance of the ring's middle from the axis.
        distance: f64,
        /// The ring's origin has to be below this height.
        below: f64,
    },
    /// The moving object, joined to the reference, has been drawn out along the joint. Both frames are
    /// the same when it is shut. It may still be held.
    Opened {
        /// The joint's axis.
        axis: [f64; 3],
        /// Least travel.
        travel: f64,
    },
    /// The moving object's origin (its tip) is in a hole that goes down from the reference's top. It
    /// may still be held.
    Inserted {
        /// x, y of the hole.
        at: [f64; 2],
        /// Height of the hole's mouth.
        mouth: f64,
        /// Largest distance of the tip from the hole's axis.
        distance: f64,
        /// Least depth of the tip below the mouth.
        depth: f64,
    },
    /// The moving object has been drawn away from where its frame was the reference's. It may still be
    /// held.
    Pulled {
        /// Least distance of the two origins.
        distance: f64,
    },
}

/// What a rule looks at, as measured last. Lengths in m.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Measured {
    /// See [`super::Verdict::error_m`] and its neighbours.
    #[default]
    Placing,
    /// Drops in the reference cup and all drops.
    Drops {
        /// In the cup.
        inside: usize,
        /// All there are.
        total: usize,
    },
    /// The ring.
    Ring {
        /// Distance of its middle from the peg's axis.
        off_axis: f64,
        /// Height of its origin in the peg's frame.
        height: f64,
    },
    /// Travel of a joint.
    Travel(f64),
    /// The plug.
    Depth {
        /// Distance of the tip from the hole's axis.
        off_axis: f64,
        /// Depth of the tip below the mouth; negative above it.
        depth: f64,
    },
    /// Distance pulled.
    Distance(f64),
}

impl Rule {
    /// What makes no sense about its numbers, if anything.
    pub fn problem(&self) -> Option<String> {
        let numbers: Vec<f64> = match *self {
            Self::Placing => vec![],
            Self::Pouring { share, radius, height } => {
                if !(share > 0.0 && share <= 1.0) {
                    return Some(format!("wants a share of drops in 0 to 1, not {share}"));
                }
                vec![radius, height]
            }
            Self::Ring { distance, below } => vec![distance, below],
            Self::Opened { axis, travel } => vec![Vector3::from(axis).norm(), travel],
            Self::Inserted { mouth, distance, depth, .. } => vec![mouth, distance, depth],
            Self::Pulled { distance } => vec![distance],
        };
        let bad = numbers.into_iter().find(|v| !(*v > 0.0 && v.is_finite()));
        bad.map(|v| format!("wants positive lengths, not {v}"))
    }

    /// Whether the object has to be let go and at rest.
    pub(super) fn wants_release(&self) -> bool {
        matches!(self, Self::Placing | Self::Ring { .. })
    }

    /// What a finished task is called.
    pub(super) fn done(&self) -> &'static str {
        match self {
            Self::Placing => "placed",
            Self::Pouring { .. } => "poured",
            Self::Ring { .. } => "on the peg",
            Self::Opened { .. } => "opened",
            Self::Inserted { .. } => "inserted",
            Self::Pulled { .. } => "pulled out",
        }
    }

    /// Measures; `drops` are centres in base_link.
    pub(super) fn measure(
        &self,
        moving: &Observed,
        reference: &Observed,
        drops: &[Point3<f64>],
    ) -> Measured {
        let into = reference.pose.inverse();
        let at = (into * moving.pose).translation.vector;
        match *self {
            Self::Placing => Measured::Placing,
            Self::Pouring { radius, height, .. } => {
                let within = |p: &&Point3<f64>| {
                    let q = into * **p;
                    q.x.hypot(q.y) < radius && (0.0..height).contains(&q.z)
                };
                Measured::Drops { inside: drops.iter().filter(within).count(), total: drops.len() }
            }
            Self::Ring { .. } => Measured::Ring { off_axis: at.xy().norm(), height: at.z },
            Self::Opened { axis, .. } => {
                let axis = Vector3::from(axis).try_normalize(1e-9).unwrap_or_else(Vector3::x);
                Measured::Travel(axis.dot(&at))
            }
            Self::Inserted { at: [x, y], mouth, .. } => {
                Measured::Depth { off_axis: (at.x - x).hypot(at.y - y), depth: mouth - at.z }
            }
            Self::Pulled { .. } => Measured::Distance(at.norm()),
        }
    }

    /// What is missing by what was measured, in words; placing is judged by the verdict's own numbers.
    pub(super) fn missing(
        &self,
        name: &str,
        measured: &Measured,
        tilt_rad: f64,
        config: &SuccessConfig,
    ) -> Option<String> {
        let mm = |v: f64| v * 1e3;
        match (*self, *measured) {
            (Self::Pouring { share, .. }, Measured::Drops { inside, total }) => {
                if total == 0 {
                    return Some("the scene has no drops to pour".into());
                }
                let enough = inside as f64 >= share * total as f64;
                (!enough).then(|| format!("{inside} of {total} drops are in the cup"))
            }
            (Self::Ring { distance, below }, Measured::Ring { off_axis, height }) => {
                if off_axis > distance {
                    return Some(format!("{name} is {:.0} mm from the axis", mm(off_axis)));
                }
                if height >= below {
                    return Some(format!("{name} is {:.0} mm too high", mm(height - below)));
                }
                (tilt_rad.to_degrees() > config.tilt_deg)
                    .then(|| format!("{name} is tilted by {:.0} deg", tilt_rad.to_degrees()))
            }
            (Self::Opened { travel, .. }, Measured::Travel(is)) => (is < travel)
                .then(|| format!("{name} is {:.0} of {:.0} mm open", mm(is), mm(travel))),
            (
                Self::Inserted { distance, depth: least, .. },
                Measured::Depth { off_axis, depth },
            ) => {
                if off_axis > distance {
                    return Some(format!("{name} is {:.0} mm beside the hole", mm(off_axis)));
                }
                (depth < least)
                    .then(|| format!("{name} is {:.0} of {:.0} mm in", mm(depth), mm(least)))
            }
            (Self::Pulled { distance }, Measured::Distance(is)) => (is < distance)
                .then(|| format!("{name} is {:.0} of {:.0} mm out", mm(is), mm(distance))),
            _ => None,
        }
    }
}
