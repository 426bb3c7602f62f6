//! Objects pushed over the table, or lost by the gripper, while a trial runs.

use super::Lab;
use crate::draw::{Stream, rng};
use crate::error::SimulationError;
use crate::world::DT;
use rand::Rng;
use tdv_geometry::nalgebra::Translation3;
use tdv_geometry::{Pose, smooth_step};

/// An object on its way to somewhere else.
#[derive(Debug, Clone, Copy)]
pub(super) struct Slide {
    object: usize,
    from: Pose,
    by: [f64; 2],
    elapsed: f64,
    duration: f64,
}

impl Lab {
    /// One tick of all pushes under way.
    pub(super) fn slide(&mut self) {
        for s in &mut self.slides {
            s.elapsed += DT;
            let f = smooth_step(s.elapsed / s.duration);
            let mut pose = s.from;
            pose.translation.x += s.by[0] * f;
            pose.translation.y += s.by[1] * f;
            self.world.place_object(s.object, &pose);
        }
        self.slides.retain(|s| s.elapsed < s.duration);
    }

    /// The pads' friction is gone for `seconds`: what is held slips out.
    pub fn make_slippery(&mut self, seconds: f64) {
        self.slippery = seconds.max(0.0);
        self.world.set_pad_grip(if self.slippery > 0.0 { 0.0 } else { 1.0 });
    }

    /// One tick of the pads' drying.
    pub(super) fn dry(&mut self) {
        if self.slippery > 0.0 {
            let left = self.slippery - DT;
            self.make_slippery(if left > 0.5 * DT { left } else { 0.0 });
        }
    }

    /// Pushes an object over the table by (`dx`, `dy`) m within `duration` s (0: at once).
    ///
    /// # Errors
    /// [`SimulationError::UnknownObject`]; [`SimulationError::NoPlace`] when it would leave the table
    /// or bump into something.
    pub fn displace(
        &mut self,
        name: &str,
        dx: f64,
        dy: f64,
        duration: f64,
    ) -> Result<(), SimulationError> {
        let i = self.assets.scene.index_of(name)?;
        if !self.place_is_free(i, [dx, dy]) {
            let d = dx.hypot(dy);
            return Err(SimulationError::NoPlace { name: name.into(), min: d, max: d });
        }
        let from = self.world.object_pose(i);
        let duration = duration.max(DT);
        self.slides.retain(|s| s.object != i);
        self.slides.push(Slide { object: i, from, by: [dx, dy], elapsed: 0.0, duration });
        Ok(())
    }

    /// Pushes an object by 5 to 10 cm in a direction drawn from the seed, within half a second;
    /// returns (dx, dy). Of a held object the caller had better push the reference instead.
    ///
    /// # Errors
    /// As [`displace`](Self::displace).
    pub fn disturb(&mut self, name: &str, seed: u64) -> Result<[f64; 2], SimulationError> {
        let i = self.assets.scene.index_of(name)?;
        let mut rng = rng(seed, Stream::Disturbance);
        for _ in 0..200 {
            let length = rng.random_range(0.05..=0.10);
            let angle: f64 = rng.random_range(0.0..std::f64::consts::TAU);
            let by = [length * angle.cos(), length * angle.sin()];
            if self.place_is_free(i, by) {
                self.displace(name, by[0], by[1], 0.5)?;
                return Ok(by);
            }
        }
        Err(SimulationError::NoPlace { name: name.into(), min: 0.05, max: 0.10 })
    }

    /// Whether object `i` can be pushed by `by` without leaving the reachable part of the table or
    /// bumping into another object or the gripper.
    fn place_is_free(&self, i: usize, by: [f64; 2]) -> bool {
        let from = self.world.object_pose(i).translation;
        let to = Translation3::new(from.x + by[0], from.y + by[1], from.z);
        if !(0.22..=0.74).contains(&to.x) || !(-0.32..=0.32).contains(&to.y) {
            return false;
        }
        // Clear of everything along the whole push, not only at its end.
        let clear = |x: f64, y: f64, reach: f64| {
            (0..=10).all(|k| {
                let f = f64::from(k) / 10.0;
                (from.x + f * by[0] - x).hypot(from.y + f * by[1] - y) > reach
            })
        };
        let others_clear = (0..self.world.object_count()).filter(|k| *k != i).all(|k| {
            let o = self.world.object_pose(k).translation;
            clear(o.x, o.y, self.radius(i) + self.radius(k) + 0.01)
        });
        let tool = self.world.link_poses()[6];
        let tcp = tool * Translation3::new(0.0, 0.0, crate::gripper::TCP_OFFSET);
        let low = tcp.translation.z < 0.20;
        let t = tcp.translation;
        others_clear && (!low || clear(t.x, t.y, self.radius(i) + 0.07))
    }

    /// Radius of an object's footprint about its origin, m.
    fn radius(&self, i: usize) -> f64 {
        self.assets.meshes.get(i).map_or(0.05, |m| {
            m.positions.iter().map(|p| f64::from(p[0]).hypot(f64::from(p[1]))).fold(0.0, f64::max)
        })
    }
}
