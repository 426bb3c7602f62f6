//! Poses from another program that sees the same images, such as FoundationPose on a GPU: whom to ask
//! with which mask, which answers count, and what they are worth. No clock and no topics in here.
//!
//! An answer is taken only for the very frame that was asked about, in its camera's frame, and as far as
//! the object drawn at it agrees with what the camera measured. Everything else is a stated reason.

mod check;
mod masks;

use crate::catalogue::ObjectModel;
use crate::frame::{FrameError, RgbdFrame};
use crate::perceiver::{Detection, Perceiver, PerceptionOutput, missing};
use crate::segment::Mask;
use crate::view::Painter;
use check::check;
use masks::MaskFinder;
use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use tdv_geometry::{Pose, Stamp};

/// Settings of what is believed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RemoteConfig {
    /// Confidence (0..1) below which an answer is no detection.
    pub min_confidence: f64,
    /// Age (s) up to which the last believed pose serves as mask where segmentation finds none.
    pub hold: f64,
    /// Standard deviation (m) of the position of a perfectly agreeing answer.
    pub sigma_m: f64,
    /// The same of its rotation (rad).
    pub sigma_rad: f64,
}

impl Default for RemoteConfig {
    fn default() -> Self {
        Self { min_confidence: 0.35, hold: 1.0, sigma_m: 0.003, sigma_rad: 0.03 }
    }
}

/// What is asked about one object.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// Index into the wanted objects.
    pub object: usize,
    /// mono8, row-major, the frame's size: 255 on the object.
    pub mask: Vec<u8>,
}

/// An answer as it came.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// Its stamp.
    pub stamp: Stamp,
    /// Its frame.
    pub frame_id: String,
    /// `T_camera_object`, or what is wrong with the message.
    pub pose: Result<Pose, String>,
}

/// What became of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It belongs to what was asked; whether it is believed, the image decides.
    Taken,
    /// It is about another frame than the one that is waited for, or came twice.
    Stale,
    /// Its frame is not the camera's.
    WrongFrame,
    /// It holds no pose.
    Unusable,
}

/// How often what happened.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RemoteCounts {
    /// Requests.
    pub asked: u64,
    /// Answers that were believed.
    pub believed: u64,
    /// Requests without an answer in time.
    pub unanswered: u64,
    /// [`Verdict::Stale`].
    pub stale: u64,
    /// [`Verdict::WrongFrame`].
    pub wrong_frame: u64,
    /// [`Verdict::Unusable`].
    pub unusable: u64,
    /// Answers that the image contradicts.
    pub disagreeing: u64,
}

#[derive(Debug, Clone)]
enum State {
    Skipped(String),
    Waiting,
    Answered(Pose),
    Failed(String),
}

#[derive(Debug)]
struct Object {
    model: Arc<ObjectModel>,
    state: State,
    mask: Option<Mask>,
    last: Option<(Stamp, Pose)>,
}

/// The objects of a prompt, seen by another program.
#[derive(Debug)]
pub struct RemotePoses {
    config: RemoteConfig,
    masks: MaskFinder,
    objects: Vec<Object>,
    unknown: Vec<(String, String)>,
    asked: Option<(Stamp, String)>,
    painter: Painter,
    counts: RemoteCounts,
}

impl RemotePoses {
    /// For the objects that a perceiver was made for; takes its settings for table and masks.
    pub fn new(config: RemoteConfig, perceiver: &Perceiver) -> Self {
        let object = |model| Object { model, state: State::Waiting, mask: None, last: None };
        let unknown = &perceiver.prompt().unknown;
        Self {
            config,
            masks: MaskFinder::new(perceiver.config().clone()),
            objects: perceiver.models().map(object).collect(),
            unknown: unknown.iter().map(|u| (u.phrase.clone(), u.reason.clone())).collect(),
            asked: None,
            painter: Painter::new(),
            counts: RemoteCounts::default(),
        }
    }

    /// How often what happened so far.
    pub fn counts(&self) -> RemoteCounts {
        self.counts
    }

    /// Forgets all poses.
    pub fn forget(&mut self) {
        self.objects.iter_mut().for_each(|o| o.last = None);
    }

    /// Begins a frame: what to ask. `frame_id` names the camera. An object without a mask is not asked
    /// about, because estimators answer something even then.
    ///
    /// # Errors
    /// [`FrameError`] for a frame whose images and intrinsics do not fit together.
    pub fn begin(&mut self, frame: &RgbdFrame, frame_id: &str) -> Result<Vec<Request>, FrameError> {
        frame.check()?;
        let models: Vec<_> = self.objects.iter().map(|o| o.model.clone()).collect();
        let found = self.masks.find(frame, &models);
        let width = frame.intrinsics.width as usize;
        let size = width * frame.intrinsics.height as usize;
        let mut requests = Vec::new();
        for (i, (object, found)) in self.objects.iter_mut().zip(found).enumerate() {
            let mut mask = vec![0; size];
            let age = |stamp: &Stamp| frame.stamp.since(*stamp);
            let recent = object.last.filter(|(s, _)| (0.0..=self.config.hold).contains(&age(s)));
            object.state = State::Waiting;
            object.mask = None;
            match (found, recent) {
                (Ok(m), _) => {
                    let on = m.data.iter().enumerate().filter(|(_, on)| **on);
                    let (columns, x0, y0) = (m.width as usize, m.x0 as usize, m.y0 as usize);
                    on.for_each(|(j, _)| mask[(y0 + j / columns) * width + x0 + j % columns] = 255);
                    object.mask = Some(m);
                }
                // Half hidden, or carried: where it was a moment ago still says where to look.
                (Err(_), Some((_, pose))) => {
                    let seen = check(&mut self.painter, frame, &object.model, &pose, None, None);
                    seen.pixels.iter().for_each(|(pixel, _)| mask[*pixel] = 255);
                }
                (Err(why), None) => {
                    object.state = State::Skipped(why);
                    continue;
                }
            }
            requests.push(Request { object: i, mask });
        }
        self.asked = Some((frame.stamp, frame_id.to_owned()));
        self.counts.asked += requests.len() as u64;
        Ok(requests)
    }

    /// Takes an answer about an object.
    pub fn answer(&mut self, object: usize, answer: &Answer) -> Verdict {
        let waiting = self.objects.get_mut(object).filter(|o| matches!(o.state, State::Waiting));
        let (Some(object), Some((stamp, frame_id))) = (waiting, &self.asked) else {
            self.counts.stale += 1;
            return Verdict::Stale;
        };
        if answer.stamp != *stamp {
            self.counts.stale += 1;
            return Verdict::Stale;
        }
        if answer.frame_id != *frame_id {
            self.counts.wrong_frame += 1;
            object.state = State::Failed(format!(
                "the answer is in frame {:?}, the images are in {frame_id:?}",
                answer.frame_id
            ));
            return Verdict::WrongFrame;
        }
        match &answer.pose {
            Ok(pose) => {
                object.state = State::Answered(*pose);
                Verdict::Taken
            }
            Err(why) => {
                self.counts.unusable += 1;
                object.state = State::Failed(format!("the answer is unusable: {why}"));
                Verdict::Unusable
            }
        }
    }

    /// Whether an answer is still missing.
    pub fn is_waiting(&self) -> bool {
        self.objects.iter().any(|o| matches!(o.state, State::Waiting))
    }

    /// Ends the frame that was begun; `waited` (s) goes into the reasons.
    ///
    /// # Errors
    /// As [`Self::begin`].
    pub fn finish(
        &mut self,
        frame: &RgbdFrame,
        waited: f64,
    ) -> Result<PerceptionOutput, FrameError> {
        let depth = frame.check()?;
        self.asked = None;
        let size = frame.intrinsics.width as usize * frame.intrinsics.height as usize;
        let mut masks = vec![0u8; size];
        let mut nearest = vec![f32::INFINITY; size];
        let mut detections = Vec::with_capacity(self.objects.len() + self.unknown.len());
        for (i, object) in self.objects.iter_mut().enumerate() {
            let name = object.model.name.clone();
            let not = |reason: String| missing(&name, reason);
            detections.push(match &object.state {
                State::Skipped(why) | State::Failed(why) => not(why.clone()),
                State::Waiting => {
                    self.counts.unanswered += 1;
                    not(format!("no answer within {waited:.2} s: is the estimator running?"))
                }
                State::Answered(pose) => {
                    let mask = object.mask.as_ref();
                    let table = self.masks.table.as_ref();
                    let c = check(&mut self.painter, frame, &object.model, pose, mask, table);
                    if c.confidence() < self.config.min_confidence {
                        self.counts.disagreeing += 1;
                        not(format!(
                            "the answer disagrees with the image: depth fits on {:.0} % of it, its \
                             outline covers the mask by {:.0} %",
                            100.0 * c.agreement,
                            100.0 * c.overlap
                        ))
                    } else {
                        self.counts.believed += 1;
                        object.last = Some((frame.stamp, *pose));
                        let label = u8::try_from(i + 1).unwrap_or(u8::MAX);
                        for (pixel, z) in &c.pixels {
                            if *z < nearest[*pixel] {
                                (nearest[*pixel], masks[*pixel]) = (*z, label);
                            }
                        }
                        believed(&name, pose, c.confidence(), &self.config)
                    }
                }
            });
        }
        detections.extend(self.unknown.iter().map(|(phrase, why)| missing(phrase, why.clone())));
        let table = self.masks.table;
        Ok(PerceptionOutput {
            stamp: frame.stamp,
            table,
            detections,
            masks,
            depth,
            stale_depth: false,
        })
    }
}

fn believed(name: &str, pose: &Pose, confidence: f64, config: &RemoteConfig) -> Detection {
    let (p, r) = (config.sigma_m.powi(2), config.sigma_rad.powi(2));
    let covariance = Matrix6::from_diagonal(&Vector6::new(p, p, p, r, r, r));
    Detection {
        name: name.to_owned(),
        pose: *pose,
        confidence,
        covariance: covariance / confidence.max(0.05).powi(2),
        found: true,
        reason: String::new(),
    }
}

#[cfg(test)]
mod tests;
