//! The tree of named frames that `/tf_static` and `/tf` tell of (REP-105: every frame has one parent).

use crate::{Pose, Stamp, interpolate};
use std::collections::{BTreeMap, VecDeque};
use thiserror::Error;

/// Seconds of a moving frame that are kept.
const KEPT: f64 = 2.0;
/// A moving frame stands where it was last seen for at most this long (s).
const HOLD: f64 = 0.2;
/// Longest chain; a longer one is a loop.
const DEEPEST: usize = 64;
/// Frames of one tree. A sender that invents names without end fills no memory.
const MOST: usize = 1024;

/// Why there is no transform.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum FrameError {
    /// The chain upwards ends elsewhere.
    #[error(
        "no transform from {target} to {source_frame}: the chain of {source_frame} ends at {root}"
    )]
    NotConnected {
        /// The frame that was asked for.
        target: String,
        /// The frame whose pose was asked for.
        source_frame: String,
        /// The last known ancestor of it.
        root: String,
    },
    /// A frame is its own ancestor.
    #[error("the frames above {0} form a loop")]
    Loop(String),
    /// A moving frame is not known at that time.
    #[error("{frame} is known from {oldest:.3} s to {newest:.3} s, asked for {asked:.3} s")]
    Time {
        /// The frame.
        frame: String,
        /// Oldest stamp (s).
        oldest: f64,
        /// Newest stamp (s).
        newest: f64,
        /// The stamp asked for (s).
        asked: f64,
    },
    /// Too many frames.
    #[error("frame {0} is one too many: {MOST} are kept")]
    Full(String),
}

#[derive(Debug, Clone)]
enum Motion {
    Fixed(Pose),
    /// Stamps increase; never empty.
    Moving(VecDeque<(Stamp, Pose)>),
}

#[derive(Debug, Clone)]
struct Edge {
    parent: String,
    motion: Motion,
}

/// Frames by name, each with its pose in its parent.
#[derive(Debug, Clone, Default)]
pub struct FrameTree {
    edges: BTreeMap<String, Edge>,
}

impl FrameTree {
    /// Says once and for all where `child` is: `T_parent_child`. A later word replaces it.
    ///
    /// # Errors
    /// [`FrameError::Full`].
    pub fn fix(&mut self, parent: &str, child: &str, pose: Pose) -> Result<(), FrameError> {
        self.set(child, Edge { parent: parent.into(), motion: Motion::Fixed(pose) })
    }

    /// Says where `child` is at one time. A stamp older than the newest one, after a restart of the
    /// sender's clock, begins the record anew.
    ///
    /// # Errors
    /// [`FrameError::Full`].
    pub fn place(
        &mut self,
        parent: &str,
        child: &str,
        stamp: Stamp,
        pose: Pose,
    ) -> Result<(), FrameError> {
        if let Some(Edge { parent: known, motion: Motion::Moving(track) }) =
            self.edges.get_mut(child)
            && known == parent
            && let Some((newest, _)) = track.back().copied()
        {
            if stamp == newest {
                return Ok(());
            }
            if stamp < newest {
                track.clear();
            }
            track.push_back((stamp, pose));
            while track.front().is_some_and(|(t, _)| stamp.since(*t) > KEPT) {
                track.pop_front();
            }
            return Ok(());
        }
        let motion = Motion::Moving(VecDeque::from([(stamp, pose)]));
        self.set(child, Edge { parent: parent.into(), motion })
    }

    fn set(&mut self, child: &str, edge: Edge) -> Result<(), FrameError> {
        if self.edges.len() >= MOST && !self.edges.contains_key(child) {
            return Err(FrameError::Full(child.into()));
        }
        self.edges.insert(child.into(), edge);
        Ok(())
    }

    /// `T_target_source` at `stamp`, where `target` is an ancestor of `source` or stands in the same
    /// tree. Moving frames are interpolated.
    ///
    /// # Errors
    /// [`FrameError`].
    pub fn lookup(&self, target: &str, source: &str, stamp: Stamp) -> Result<Pose, FrameError> {
        let up = self.chain(source, stamp)?;
        if let Some((_, pose)) = up.iter().find(|(name, _)| *name == target) {
            return Ok(*pose);
        }
        let other = self.chain(target, stamp)?;
        let root = up.last().map_or(source, |(name, _)| name);
        match (up.last(), other.last()) {
            (Some((a, root_source)), Some((b, root_target))) if a == b => {
                Ok(root_target.inverse() * root_source)
            }
            _ => Err(FrameError::NotConnected {
                target: target.into(),
                source_frame: source.into(),
                root: root.into(),
            }),
        }
    }

    /// Every known ancestor of `frame`, itself first, with `T_ancestor_frame`.
    fn chain<'a>(
        &'a self,
        frame: &'a str,
        stamp: Stamp,
    ) -> Result<Vec<(&'a str, Pose)>, FrameError> {
        let mut chain = vec![(frame, Pose::identity())];
        let (mut at, mut pose) = (frame, Pose::identity());
        while let Some(edge) = self.edges.get(at) {
            if chain.len() > DEEPEST {
                return Err(FrameError::Loop(frame.into()));
            }
            pose = edge.motion.at(at, stamp)? * pose;
            at = &edge.parent;
            chain.push((at, pose));
        }
        Ok(chain)
    }
}

impl Motion {
    fn at(&self, frame: &str, stamp: Stamp) -> Result<Pose, FrameError> {
        let track = match self {
            Self::Fixed(pose) => return Ok(*pose),
            Self::Moving(track) => track,
        };
        let after = track.partition_point(|(t, _)| *t < stamp);
        match (after.checked_sub(1).and_then(|i| track.get(i)), track.get(after)) {
            (_, Some((t, pose))) if *t == stamp => Ok(*pose),
            (Some((a, from)), Some((b, to))) => {
                Ok(interpolate(from, to, stamp.since(*a) / b.since(*a)))
            }
            (Some((t, pose)), None) if stamp.since(*t) <= HOLD => Ok(*pose),
            _ => {
                let end = |e: Option<&(Stamp, Pose)>| e.map_or(f64::NAN, |(t, _)| t.as_secs());
                Err(FrameError::Time {
                    frame: frame.into(),
                    oldest: end(track.front()),
                    newest: end(track.back()),
                    asked: stamp.as_secs(),
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{pose_distance, pose_from_xyz_rpy};

    fn pose(x: f64, yaw: f64) -> Pose {
        pose_from_xyz_rpy([x, 0.2, 0.0], [0.0, 0.0, yaw])
    }

    fn same(a: &Pose, b: &Pose) -> bool {
        let (d, r) = pose_distance(a, b);
        d < 1e-12 && r < 1e-7
    }

    #[test]
    fn chains_are_followed_upwards_and_across() {
        let mut t = FrameTree::default();
        t.fix("base_link", "stand", pose(1.0, 0.3)).unwrap();
        t.fix("stand", "camera_link", pose(0.1, -1.0)).unwrap();
        t.fix("camera_link", "optical", pose(0.0, 2.0)).unwrap();
        t.fix("base_link", "table", pose(-0.4, 0.5)).unwrap();
        let optical = pose(1.0, 0.3) * pose(0.1, -1.0) * pose(0.0, 2.0);
        let now = Stamp::from_secs(5.0);
        assert!(same(&t.lookup("base_link", "optical", now).unwrap(), &optical));
        let across = pose(-0.4, 0.5).inverse() * optical;
        assert!(same(&t.lookup("table", "optical", now).unwrap(), &across));
        assert!(same(&t.lookup("optical", "base_link", now).unwrap(), &optical.inverse()));
        let e = t.lookup("map", "optical", now).unwrap_err().to_string();
        assert!(e.contains("map") && e.contains("ends at base_link"), "{e}");
    }

    #[test]
    fn a_camera_on_the_moving_tool_is_taken_at_the_images_time() {
        let mut t = FrameTree::default();
        t.fix("tool0", "optical", pose(0.05, 0.0)).unwrap();
        for k in 0..40 {
            let s = 1.0 + 0.05 * f64::from(k);
            t.place("base_link", "tool0", Stamp::from_secs(s), pose(s, 0.1 * s)).unwrap();
        }
        let got = t.lookup("base_link", "optical", Stamp::from_secs(2.02)).unwrap();
        assert!(same(&got, &(pose(2.02, 0.202) * pose(0.05, 0.0))));
        // Newest is 2.95: stands for a moment, then it is unknown; before the record as well.
        assert!(t.lookup("base_link", "optical", Stamp::from_secs(3.1)).is_ok());
        for s in [0.9, 3.2] {
            let e = t.lookup("base_link", "optical", Stamp::from_secs(s)).unwrap_err();
            assert!(matches!(&e, FrameError::Time { frame, .. } if frame == "tool0"), "{e}");
        }
        // The sender's clock starts over.
        t.place("base_link", "tool0", Stamp::from_secs(0.5), pose(7.0, 0.0)).unwrap();
        assert!(t.lookup("base_link", "tool0", Stamp::from_secs(0.5)).is_ok());
        assert!(t.lookup("base_link", "tool0", Stamp::from_secs(2.0)).is_err());
    }

    #[test]
    fn loops_and_floods_are_errors() {
        let mut t = FrameTree::default();
        t.fix("a", "b", pose(0.0, 0.0)).unwrap();
        t.fix("b", "a", pose(0.0, 0.0)).unwrap();
        assert_eq!(t.lookup("map", "b", Stamp(0)), Err(FrameError::Loop("b".into())));
        let mut refused = 0;
        for k in 0..2 * MOST {
            refused += usize::from(t.fix("a", &format!("f{k}"), pose(0.0, 0.0)).is_err());
        }
        assert_eq!(refused, MOST + 2);
        t.fix("c", "f0", pose(0.0, 0.0)).unwrap();
    }
}
