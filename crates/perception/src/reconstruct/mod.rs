//! A mesh of an object that nobody has modelled, from RGB-D views.
//!
//! One view shows one side. The shape is what every view, and every image of a view under the object's
//! own symmetry (found first: round about the vertical, two mirror planes, or one), leaves standing of
//! the space above the table: not seen through, not outside the outline. Views in which the object is
//! carried and tracked add what they see through; a hand that hides it proves nothing and harms nothing.

mod carve;
mod paint;
mod surface;
mod symmetry;
#[cfg(test)]
mod tests;
mod view;

pub use symmetry::Assumed;

use crate::candidates::Candidate;
use crate::frame::RgbdFrame;
use crate::table::TablePlane;
use carve::Field;
use nalgebra::{Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};
use symmetry::Search;
use tdv_geometry::Pose;
use tdv_rendering::Mesh;
use thiserror::Error;
use view::View;

/// Settings of the reconstruction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReconstructConfig {
    /// Cells along the longest side.
    pub cells: usize,
    /// Depth (m) by which a point must be seen through in a later view, noise apart.
    pub through: f64,
    /// Later views that must see through a cell.
    pub votes: u16,
    /// Most triangles of the result.
    pub triangles: usize,
}

impl Default for ReconstructConfig {
    fn default() -> Self {
        Self { cells: 56, through: 0.008, votes: 3, triangles: 8000 }
    }
}

/// Why there is no mesh.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum ReconstructError {
    /// Too little was measured.
    #[error(
        "only {points} depth readings on the object, {needed} are needed: move the camera nearer"
    )]
    Sparse {
        /// Readings.
        points: usize,
        /// Needed.
        needed: usize,
    },
    /// Nothing is left.
    #[error("no shape fits the view: outline and depth of the object contradict each other")]
    Nothing,
}

/// A shape under construction.
#[derive(Debug)]
pub struct Reconstruction {
    config: ReconstructConfig,
    view: View,
    assumed: Assumed,
    violation: f64,
    field: Field,
    later: usize,
}

/// Fewest depth readings on the object.
const LEAST_POINTS: usize = 300;

impl Reconstruction {
    /// From one view (best the mean of several frames) of an object at rest on the table.
    ///
    /// # Errors
    /// [`ReconstructError`].
    pub fn start(
        frame: &RgbdFrame,
        table: &TablePlane,
        thing: &Candidate,
        config: ReconstructConfig,
    ) -> Result<Self, ReconstructError> {
        // An upright frame under the middle of what is seen; the symmetry moves it to the axis.
        let seen = table.pose.inverse_transform_point(&thing.cluster.centroid);
        let foot =
            Pose::from_parts(Translation3::new(seen.x, seen.y, 0.0), UnitQuaternion::identity());
        let mut view = View::new(frame, &thing.mask, table.pose * foot);
        let points = view.points().len();
        if points < LEAST_POINTS {
            return Err(ReconstructError::Sparse { points, needed: LEAST_POINTS });
        }
        let found = Search::new(&view).run();
        view.move_frame(&found.axis());
        let field =
            Field::new(&view, &found.assumed, config.cells).ok_or(ReconstructError::Nothing)?;
        Ok(Self {
            config,
            assumed: found.assumed,
            violation: found.violation,
            view,
            field,
            later: 0,
        })
    }

    /// `T_camera_object` in the first view.
    pub fn pose(&self) -> Pose {
        self.view.t_camera_object
    }

    /// The symmetry that the unseen side was made with.
    pub fn assumed(&self) -> Assumed {
        self.assumed
    }

    /// Part of the points that contradict the symmetry, 0..1; above 0.1 the unseen side is a guess.
    pub fn violation(&self) -> f64 {
        self.violation
    }

    /// Later views used.
    pub fn later_views(&self) -> usize {
        self.later
    }

    /// Cuts away what a view with the object at `t_camera_object` sees through. Only readings that lie
    /// clearly behind a cell count: whatever hides the object cuts nothing.
    pub fn see_through(&mut self, frame: &RgbdFrame, t_camera_object: &Pose) {
        self.field.see_through(frame, t_camera_object, self.config.through);
        self.later += 1;
    }

    /// The mesh: origin at the middle of the underside, z up, metres; closed, with vertex colours.
    ///
    /// # Errors
    /// [`ReconstructError::Nothing`].
    pub fn mesh(&self) -> Result<Mesh, ReconstructError> {
        let mut mesh = surface::extract(&self.field, self.config.votes);
        if mesh.triangles.is_empty() {
            return Err(ReconstructError::Nothing);
        }
        paint::paint(&mut mesh, &self.view, &self.assumed);
        Ok(mesh.simplified(self.config.triangles))
    }
}
