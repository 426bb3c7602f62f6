//! Frame-to-frame pose tracking of one object by colour along its outline and by depth on its surface
//! (after ICG, Stoiber et al. 2022; instead of precomputed views the object is drawn where it is).

mod depth;
mod histogram;
mod occlusion;
mod quality;
mod region;
mod surface;
mod system;

pub use quality::Quality;

use crate::catalogue::ObjectModel;
use crate::frame::RgbdFrame;
use crate::view::{Painter, Window};
use histogram::{Counts, Histograms};
use nalgebra::{Matrix6, Vector3};
use occlusion::{Occlusion, margin_at};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use surface::Surface;
use system::System;
use tdv_geometry::Pose;

/// Settings of the tracker. Lists hold one value per correspondence iteration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackerConfig {
    /// Lines across the outline.
    pub lines: usize,
    /// Points on the surface.
    pub points: usize,
    /// Pixels per line segment.
    pub scales: Vec<u32>,
    /// Standard deviation (px) of the outline.
    pub region_sigma_px: Vec<f64>,
    /// Farthest measured point (m) taken for a surface point.
    pub depth_reach: Vec<f64>,
    /// Standard deviation of a depth pair (m at 1 m distance).
    pub depth_sigma: Vec<f64>,
    /// Newton steps per correspondence iteration.
    pub updates: usize,
    /// Regularisation of rotations.
    pub rotation_damping: f64,
    /// Regularisation of translations.
    pub translation_damping: f64,
    /// Learning rate of the colour histograms.
    pub learning_rate: f32,
    /// How much nearer (m, for a surface 1 m away) something must be to hide it.
    pub occluder_margin: f64,
    /// Part of the surface that must be visible for the pose to be changed at all: what peeps out behind
    /// a hand or a gripper does not tell six numbers, and following it leads astray.
    pub min_visible: f64,
    /// Confidence below which colours are not learnt.
    pub learn_above: f64,
}

impl Default for TrackerConfig {
    fn default() -> Self {
        Self {
            lines: 140,
            points: 200,
            scales: vec![6, 4, 2, 1],
            region_sigma_px: vec![15.0, 7.0, 4.0, 2.0],
            depth_reach: vec![0.04, 0.025, 0.015, 0.01],
            depth_sigma: vec![0.05, 0.03, 0.015, 0.008],
            updates: 2,
            rotation_damping: 1000.0,
            translation_damping: 30000.0,
            learning_rate: 0.2,
            occluder_margin: 0.016,
            min_visible: 0.2,
            learn_above: 0.6,
        }
    }
}

/// What the tracker found in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tracked {
    /// `T_camera_object`, the symmetric equivalent nearest to the last one.
    pub pose: Pose,
    /// 0..1; see [`Quality::confidence`].
    pub confidence: f64,
    /// Covariance (m^2, rad^2) of position and rotation in camera axes: xyz, then rotation.
    pub covariance: Matrix6<f64>,
    /// The figures behind the confidence.
    pub quality: Quality,
}

/// Tracks one object.
#[derive(Debug)]
pub struct Tracker {
    model: Arc<ObjectModel>,
    config: TrackerConfig,
    pose: Pose,
    colors: Histograms,
    painter: Painter,
    occlusion: Occlusion,
    counts: Counts,
    last: Quality,
    lines: Vec<region::Line>,
    pairs: Vec<depth::Pair>,
    /// What the last drawing showed, and where.
    surface: Surface,
    window: Option<Window>,
}

impl Tracker {
    /// A tracker starting at a registered pose: learns the colours there and settles for a few rounds.
    pub fn start(
        frame: &RgbdFrame,
        model: Arc<ObjectModel>,
        pose: &Pose,
        config: TrackerConfig,
    ) -> Self {
        let mut t = Self {
            model,
            config,
            pose: *pose,
            colors: Histograms::new(),
            painter: Painter::new(),
            occlusion: Occlusion::default(),
            counts: Counts::new(),
            last: Quality::default(),
            lines: Vec::new(),
            pairs: Vec::new(),
            surface: Surface::default(),
            window: None,
        };
        t.draw(frame, true);
        t.learn(frame, 1.0);
        // The start pose is near: only the fine iterations.
        let n = t.rounds();
        for _ in 0..4 {
            for i in n.saturating_sub(2)..n {
                t.draw(frame, true);
                t.iterate(frame, i, true, false);
            }
        }
        t.draw(frame, true);
        t.learn(frame, 0.5);
        t
    }

    /// The last pose.
    pub fn pose(&self) -> Pose {
        self.pose
    }

    /// The object that is tracked.
    pub fn model(&self) -> &ObjectModel {
        &self.model
    }

    fn rounds(&self) -> usize {
        let c = &self.config;
        c.scales
            .len()
            .min(c.region_sigma_px.len())
            .min(c.depth_reach.len())
            .min(c.depth_sigma.len())
    }

    /// Follows the object into the next frame. `with_depth`: false when the depth image is stale or
    /// empty, then colour alone is used.
    pub fn track(&mut self, frame: &RgbdFrame, with_depth: bool) -> Tracked {
        let before = self.pose;
        let mut information = Matrix6::zeros();
        for i in 0..self.rounds() {
            // The surface seen hardly changes within one frame's motion: every other round draws.
            if i % 2 == 0 {
                self.draw(frame, with_depth);
            }
            if let Some(h) = self.iterate(frame, i, with_depth, i == 0) {
                information = h;
            }
        }
        self.pose = self.model.nearest(&self.pose, &before.rotation);
        self.draw(frame, with_depth);
        let mut quality = self.measure(frame);
        if with_depth && quality.visible < self.config.min_visible {
            self.pose = before;
            self.draw(frame, with_depth);
            quality = self.measure(frame);
        }
        if !with_depth {
            // Judged by the last depth image that there was.
            quality.agreement = self.last.agreement;
            quality.visible = self.last.visible;
        }
        quality.lines = self.lines.len() as f64 / self.config.lines.max(1) as f64;
        self.last = quality;
        let confidence = quality.confidence();
        if confidence > self.config.learn_above {
            self.learn(frame, self.config.learning_rate);
        }
        Tracked {
            pose: self.pose,
            confidence,
            covariance: self.covariance(&information, confidence),
            quality,
        }
    }

    /// Draws the object at the current pose; out of view there is no window and an empty surface.
    fn draw(&mut self, frame: &RgbdFrame, with_depth: bool) {
        let full = &frame.intrinsics;
        self.window = Window::of(&self.model, &self.pose, full, 4.0);
        let Some(window) = self.window else {
            self.surface = Surface::default();
            return;
        };
        let k = window.intrinsics(full);
        self.painter.draw(&k, &self.model, &self.pose);
        self.occlusion.set(&self.painter, &window, self.config.occluder_margin, with_depth);
        let c = &self.config;
        self.surface =
            Surface::sample(&self.painter, &window, &k, full, &self.pose, c.lines, c.points);
    }

    /// One round of correspondences and its updates; the information matrix, in the object frame.
    fn iterate(
        &mut self,
        frame: &RgbdFrame,
        round: usize,
        with_depth: bool,
        first: bool,
    ) -> Option<Matrix6<f64>> {
        self.window?;
        let surface = &self.surface;
        let c = &self.config;
        let (colors, occlusion) = (&self.colors, &self.occlusion);
        region::lay_lines(
            frame,
            &surface.outline,
            &self.pose,
            colors,
            occlusion,
            c.scales[round],
            &mut self.lines,
        );
        self.pairs.clear();
        let reach = c.depth_reach[round];
        if with_depth {
            depth::find_pairs(
                frame,
                &surface.points,
                &self.pose,
                occlusion,
                reach,
                first,
                &mut self.pairs,
            );
        }
        let mut information = None;
        for update in 0..c.updates {
            let mut system = System::new();
            let sigma = c.region_sigma_px[round];
            let global = update == 0;
            region::accumulate(frame, &self.lines, &self.pose, sigma, global, &mut system);
            depth::accumulate(&self.pairs, &self.pose, c.depth_sigma[round], reach, &mut system);
            let next = system.step(&self.pose, c.rotation_damping, c.translation_damping);
            if let Some(next) = next {
                self.pose = next;
            }
            information = Some(system.hessian);
        }
        information
    }

    /// Learns the colours on both sides of the outline of the last drawing.
    fn learn(&mut self, frame: &RgbdFrame, rate: f32) {
        if self.window.is_none() {
            return;
        }
        self.counts.foreground.fill(0.0);
        self.counts.background.fill(0.0);
        let outline = &self.surface.outline;
        region::count_colors(frame, outline, &self.pose, &self.occlusion, &mut self.counts);
        self.colors.update(&self.counts, rate);
    }

    /// Compares the last drawing with the frame.
    fn measure(&self, frame: &RgbdFrame) -> Quality {
        let margin = self.config.occluder_margin;
        self.window.as_ref().map_or_else(Quality::default, |window| {
            quality::compare(frame, &self.painter, window, &self.colors, margin)
        })
    }

    /// Calls `set(index, depth)` for every image pixel (row-major index) that the object covers and
    /// that nothing nearer hides, as of the last frame tracked.
    pub fn silhouette(&self, frame: &RgbdFrame, mut set: impl FnMut(usize, f32)) {
        let Some(window) = &self.window else { return };
        let row = frame.intrinsics.width as usize;
        for (i, z) in self.painter.out.depth.data.iter().enumerate() {
            if *z <= 0.0 {
                continue;
            }
            let u = window.x0 as usize + i % window.width as usize;
            let v = window.y0 as usize + i / window.width as usize;
            let margin = margin_at(self.config.occluder_margin, *z);
            let hidden = frame.depth_at(u as i32, v as i32).is_some_and(|d| d < z - margin);
            if !hidden && u < row {
                set(v * row + u, *z);
            }
        }
    }

    fn covariance(&self, information: &Matrix6<f64>, confidence: f64) -> Matrix6<f64> {
        let mut h = *information;
        for i in 0..3 {
            // What the image does not tell is still known within 0.3 rad and 5 cm.
            h[(i, i)] += 10.0;
            h[(i + 3, i + 3)] += 400.0;
        }
        let body = h.try_inverse().unwrap_or_else(|| Matrix6::identity() * 0.01);
        // Rotation and translation change places, and both turn from object to camera axes.
        let r = self.pose.rotation.to_rotation_matrix();
        let mut a = Matrix6::zeros();
        a.fixed_view_mut::<3, 3>(0, 3).copy_from(r.matrix());
        a.fixed_view_mut::<3, 3>(3, 0).copy_from(r.matrix());
        let mut c = a * body * a.transpose() / confidence.max(0.05).powi(2);
        let floor = Vector3::new(0.5e-3, 0.5e-3, 0.5e-3);
        for i in 0..3 {
            c[(i, i)] += floor[i] * floor[i];
            c[(i + 3, i + 3)] += 0.2f64.to_radians().powi(2);
        }
        c
    }
}
