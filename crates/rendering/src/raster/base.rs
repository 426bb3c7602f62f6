//! The still part of a scene, drawn once.

use super::{Instance, Rendered};
use crate::Intrinsics;
use crate::lighting::Lighting;
use tdv_geometry::Pose;

/// A picture of the still part and what it was made under.
#[derive(Debug, Default)]
pub(super) struct Base {
    made_under: Option<(Intrinsics, Vec<Pose>, Lighting)>,
    /// Inverse depth (1/m), 0 where nothing is.
    pub inv_z: Vec<f32>,
    pub image: Rendered,
}

impl Base {
    /// Whether it was made under this camera, these poses and this light; if not, it is about to be.
    pub fn is_of(
        &mut self,
        camera: &Intrinsics,
        still: &[Instance<'_>],
        lighting: &Lighting,
    ) -> bool {
        let same = self.made_under.as_ref().is_some_and(|(c, poses, l)| {
            c == camera && l == lighting && still.iter().map(|i| &i.pose).eq(poses)
        });
        if !same {
            let poses = still.iter().map(|i| i.pose).collect();
            self.made_under = Some((*camera, poses, lighting.clone()));
        }
        same
    }
}
