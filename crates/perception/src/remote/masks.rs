//! A mask for each wanted object without a pose: what stands on the table, by size and colour.

use crate::catalogue::ObjectModel;
use crate::frame::RgbdFrame;
use crate::perceiver::{PerceiverConfig, window_mask};
use crate::points::PointMap;
use crate::segment::{Mask, Scene};
use crate::table::{TablePlane, detect_table, follow_table};
use std::sync::Arc;

/// Finds masks frame by frame; remembers the table.
#[derive(Debug)]
pub(crate) struct MaskFinder {
    config: PerceiverConfig,
    pub table: Option<TablePlane>,
}

impl MaskFinder {
    pub fn new(config: PerceiverConfig) -> Self {
        Self { config, table: None }
    }

    /// One mask, or why there is none, for each model in their order.
    pub fn find(
        &mut self,
        frame: &RgbdFrame,
        models: &[Arc<ObjectModel>],
    ) -> Vec<Result<Mask, String>> {
        let (k, c) = (&frame.intrinsics, &self.config.table);
        let map = PointMap::new(frame, 8);
        self.table = self
            .table
            .and_then(|t| follow_table(&map, k, &t, c))
            .or_else(|| detect_table(&PointMap::new(frame, 4), k, c));
        let Some(table) = self.table else {
            let why = "no table plane in view: point the camera at the table";
            return models.iter().map(|_| Err(why.to_owned())).collect();
        };
        let scene = Scene::new(frame, table);
        let generic = scene.clusters();
        let mut taken = vec![false; scene.map.points.len()];
        models
            .iter()
            .map(|model| {
                let colored = scene.colored_clusters(model);
                let best = colored
                    .iter()
                    .chain(&generic)
                    .filter(|c| {
                        let used = c.cells.iter().filter(|i| taken[**i as usize]).count();
                        2 * used < c.cells.len()
                    })
                    .map(|c| (scene.fit(c, model).total, c))
                    .max_by(|a, b| a.0.total_cmp(&b.0));
                match best {
                    Some((fit, cluster)) if fit >= self.config.min_fit => {
                        cluster.cells.iter().for_each(|i| taken[*i as usize] = true);
                        Ok(window_mask(&scene, cluster, frame, model))
                    }
                    Some((fit, _)) => Err(format!(
                        "no {} seen: nothing on the table has its size and colour (best fit {fit:.2}, \
                         {:.2} needed)",
                        model.name, self.config.min_fit
                    )),
                    None => Err(format!("no {} seen: nothing stands on the table", model.name)),
                }
            })
            .collect()
    }
}
