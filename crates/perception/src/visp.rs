//! Tracking on a recorded RGB-D sequence (folders of PNG files with `cam.json`), judged against
//! reference poses.

use crate::catalogue::ObjectModel;
use crate::color::Palette;
use crate::frame::{FrameError, RgbdFrame};
use crate::perceiver::{Perceiver, PerceiverConfig};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Instant;
use tdv_geometry::{Pose, Stamp, Symmetry, rotation_from_matrix};
use tdv_rendering::{DepthImage, Intrinsics, Mesh, MeshError};
use thiserror::Error;

/// What can be wrong with a sequence folder.
#[derive(Debug, Error)]
pub enum SequenceError {
    /// A file that cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A JSON file without the fields it should have.
    #[error("{path}: {reason}")]
    Json {
        /// Which.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// An image that cannot be decoded.
    #[error("{path}: {reason}")]
    Image {
        /// Which.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A frame whose images do not fit together.
    #[error("frame {index}: {source}")]
    Frame {
        /// Which.
        index: usize,
        /// What is wrong.
        source: FrameError,
    },
    /// No frames.
    #[error("{0}: no color/color_image_0000.png")]
    Empty(PathBuf),
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Camera {
    w: u32,
    h: u32,
    depth_scale: f64,
    px: f64,
    py: f64,
    u0: f64,
    v0: f64,
}

#[derive(Deserialize)]
#[allow(non_snake_case)]
struct Reference {
    camera_T_cube: Vec<[[f64; 4]; 4]>,
    usable: Vec<bool>,
}

/// A sequence of the ViSP render-based-tracking data set: colour and depth images, intrinsics, and
/// reference poses of its cube.
#[derive(Debug, Clone)]
pub struct Sequence {
    dir: PathBuf,
    /// Intrinsics of both images.
    pub intrinsics: Intrinsics,
    depth_scale: f64,
    /// Number of frames.
    pub len: usize,
    /// `T_camera_cube` and whether the frame is fit for comparison; may be shorter than the sequence.
    pub reference: Vec<(Pose, bool)>,
}

/// Seconds between two frames (30 Hz).
pub const FRAME_PERIOD_S: f64 = 1.0 / 30.0;

impl Sequence {
    /// Opens a folder.
    ///
    /// # Errors
    /// [`SequenceError`] naming the file.
    pub fn open(dir: &Path) -> Result<Self, SequenceError> {
        let camera: Camera = json(&dir.join("cam.json"))?;
        let reference_path = dir.join("cube_reference.json");
        let reference: Reference = json(&reference_path)?;
        let mut poses = Vec::with_capacity(reference.camera_T_cube.len());
        for (i, (m, usable)) in reference.camera_T_cube.iter().zip(&reference.usable).enumerate() {
            let r = Matrix3::from_fn(|row, col| m[row][col]);
            let rotation = rotation_from_matrix(&r, 1e-2).map_err(|e| SequenceError::Json {
                path: reference_path.clone(),
                reason: format!("camera_T_cube[{i}]: {e}"),
            })?;
            let t = Vector3::new(m[0][3], m[1][3], m[2][3]);
            poses.push((Pose::from_parts(t.into(), rotation), *usable));
        }
        let len = (0..).take_while(|i| color_path(dir, *i).is_file()).count();
        if len == 0 {
            return Err(SequenceError::Empty(dir.into()));
        }
        Ok(Self {
            dir: dir.into(),
            intrinsics: Intrinsics {
                width: camera.w,
                height: camera.h,
                fx: camera.px,
                fy: camera.py,
                cx: camera.u0,
                cy: camera.v0,
            },
            depth_scale: camera.depth_scale,
            len,
            reference: poses,
        })
    }

    /// Reads a frame; stamps are 1/30 s apart, starting at 1 s.
    ///
    /// # Errors
    /// [`SequenceError`] naming the file.
    pub fn frame(&self, index: usize) -> Result<RgbdFrame, SequenceError> {
        let open = |path: PathBuf| {
            image::open(&path)
                .map_err(|e| SequenceError::Image { reason: e.to_string(), path: path.clone() })
        };
        let color = open(color_path(&self.dir, index))?.into_rgb8();
        let path = self.dir.join(format!("depth/depth_{index:04}.png"));
        let depth = open(path)?.into_luma16();
        let data =
            depth.as_raw().iter().map(|d| (f64::from(*d) * self.depth_scale) as f32).collect();
        Ok(RgbdFrame {
            stamp: stamp_of(index),
            color,
            depth: DepthImage { width: depth.width(), height: depth.height(), data },
            intrinsics: self.intrinsics,
        })
    }

    /// The cube's model: the data set's untextured mesh, 24-fold symmetric, colours unknown.
    ///
    /// # Errors
    /// [`SequenceError::Mesh`].
    pub fn cube(&self) -> Result<ObjectModel, SequenceError> {
        let mesh = Mesh::load(&self.dir.join("models/cube/cube.obj"))?;
        let mut model = ObjectModel::new("cube", mesh, Symmetry::Cube);
        model.synonyms = vec!["block".into(), "box".into()];
        // The mesh's grey is not the picture block's colour.
        model.palette = Palette::default();
        Ok(model)
    }
}

/// Stamp of a frame.
pub fn stamp_of(index: usize) -> Stamp {
    Stamp::from_secs(1.0 + index as f64 * FRAME_PERIOD_S)
}

fn color_path(dir: &Path, index: usize) -> PathBuf {
    dir.join(format!("color/color_image_{index:04}.png"))
}

fn json<T: for<'a> Deserialize<'a>>(path: &Path) -> Result<T, SequenceError> {
    let text = std::fs::read_to_string(path)
        .map_err(|source| SequenceError::Io { path: path.into(), source })?;
    serde_json::from_str(&text)
        .map_err(|e| SequenceError::Json { path: path.into(), reason: e.to_string() })
}

/// The figures of a run; errors on the reference's usable frames, symmetry considered.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Summary {
    /// Frames processed.
    pub frames: usize,
    /// Frames without a pose.
    pub lost: usize,
    /// Frames compared with the reference.
    pub compared: usize,
    /// Changes of the symmetric equivalent after the first pose.
    pub symmetry_jumps: usize,
    /// Median position error (mm).
    pub median_translation_mm: f64,
    /// 95th percentile of it.
    pub p95_translation_mm: f64,
    /// Median rotation error (deg).
    pub median_rotation_deg: f64,
    /// 95th percentile of it.
    pub p95_rotation_deg: f64,
    /// Mean processing time (ms) of a frame, the first one (registration) left out.
    pub ms_per_frame: f64,
    /// Processing time (ms) of the first frame.
    pub first_frame_ms: f64,
}

/// Collects errors of poses against the reference, frame by frame.
#[derive(Debug, Clone, Default)]
pub struct Judge {
    translation_mm: Vec<f64>,
    rotation_deg: Vec<f64>,
    frames: usize,
    lost: usize,
    jumps: usize,
    last: Option<Pose>,
}

impl Judge {
    /// Takes the pose found in frame `index` (`None`: not found) and gives its errors (mm, deg) where
    /// the reference is fit for it.
    pub fn frame(
        &mut self,
        sequence: &Sequence,
        index: usize,
        pose: Option<&Pose>,
    ) -> Option<(f64, f64)> {
        self.frames += 1;
        let Some(pose) = pose else {
            self.lost += 1;
            return None;
        };
        if let Some(last) = &self.last
            && last.rotation.angle_to(&pose.rotation) > 40f64.to_radians()
        {
            self.jumps += 1;
        }
        self.last = Some(*pose);
        let Some((truth, true)) = sequence.reference.get(index) else { return None };
        let (d, a) = Symmetry::Cube.distance(pose, truth);
        let error = (1000.0 * d, a.to_degrees());
        self.translation_mm.push(error.0);
        self.rotation_deg.push(error.1);
        Some(error)
    }

    /// Changes of the symmetric equivalent so far.
    pub fn jumps(&self) -> usize {
        self.jumps
    }

    /// The figures so far, without times.
    pub fn summary(&self) -> Summary {
        let q = |v: &[f64], q: f64| {
            let mut v = v.to_vec();
            v.sort_by(f64::total_cmp);
            let i = (q * v.len().saturating_sub(1) as f64).round() as usize;
            v.get(i).copied().unwrap_or(f64::NAN)
        };
        Summary {
            frames: self.frames,
            lost: self.lost,
            compared: self.translation_mm.len(),
            symmetry_jumps: self.jumps,
            median_translation_mm: q(&self.translation_mm, 0.5),
            p95_translation_mm: q(&self.translation_mm, 0.95),
            median_rotation_deg: q(&self.rotation_deg, 0.5),
            p95_rotation_deg: q(&self.rotation_deg, 0.95),
            ..Summary::default()
        }
    }
}

/// Runs the perceiver over the sequence in `dir`, from the prompt "track the cube".
///
/// # Errors
/// [`SequenceError`] for missing or broken files.
pub fn evaluate_visp(dir: &Path) -> Result<Summary, SequenceError> {
    let sequence = Sequence::open(dir)?;
    let config = PerceiverConfig { prompt: "track the cube".into(), ..PerceiverConfig::default() };
    run(&sequence, config, |_, _, _| {})
}

/// As [`evaluate_visp`] with other settings; `look` sees every frame with its output.
///
/// # Errors
/// As [`evaluate_visp`].
pub fn run(
    sequence: &Sequence,
    config: PerceiverConfig,
    mut look: impl FnMut(usize, &RgbdFrame, &crate::PerceptionOutput),
) -> Result<Summary, SequenceError> {
    let mut perceiver = Perceiver::new(config, vec![sequence.cube()?]);
    let mut judge = Judge::default();
    let (mut first, mut rest) = (0.0, 0.0);
    for index in 0..sequence.len {
        let frame = sequence.frame(index)?;
        let start = Instant::now();
        let out =
            perceiver.step(&frame).map_err(|source| SequenceError::Frame { index, source })?;
        let ms = start.elapsed().as_secs_f64() * 1000.0;
        if index == 0 {
            first = ms;
        } else {
            rest += ms;
        }
        let pose = out.detections.first().filter(|d| d.found).map(|d| d.pose);
        judge.frame(sequence, index, pose.as_ref());
        look(index, &frame, &out);
    }
    Ok(Summary {
        ms_per_frame: rest / sequence.len.saturating_sub(1).max(1) as f64,
        first_frame_ms: first,
        ..judge.summary()
    })
}
