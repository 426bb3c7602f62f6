//! What the still part of a scene looked like in the last image.

use super::Instance;
use crate::lighting::Lighting;
use crate::{Intrinsics, RgbImage};
use tdv_geometry::Pose;

/// The last image and what it was made under.
#[derive(Debug, Default)]
pub(super) struct Memory {
    made_under: Option<(Intrinsics, Vec<Pose>, Lighting)>,
    /// Number of the triangle that each pixel showed, plus one.
    pub visible: Vec<u32>,
    pub color: RgbImage,
}

impl Memory {
    /// Whether the last image was made under the same camera, still poses and light; from now on these.
    pub fn known(
        &mut self,
        camera: &Intrinsics,
        still: &[Instance<'_>],
        lighting: &Lighting,
    ) -> bool {
        if still.is_empty() {
            self.made_under = None;
            return false;
        }
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
