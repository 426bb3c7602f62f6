//! Training windows: a disturbed history and the clean future that shall follow it.

use crate::normaliser::{POSE_DIM, finite};
use crate::{Normaliser, PolicyConfig, PolicyError, TrainConfig};
use nalgebra::{UnitQuaternion, Vector3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use tdv_geometry::{Pose, interpolate, twist_arc};

/// Radius (m) at which a rotation counts as a way.
const LEVER: f64 = 0.1;

/// One procedure's trajectories `T_reference_moving`, uniform in time.
#[derive(Debug, Clone, PartialEq)]
pub struct ProcedureData {
    /// Its name.
    pub name: String,
    /// Trajectories, each at the set's `dt`.
    pub trajectories: Vec<Vec<Pose>>,
}

/// What a policy is trained on.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingSet {
    /// Name of the task.
    pub task: String,
    /// The task in words.
    pub text: String,
    /// Embedding of the text, if there is an encoder.
    pub text_embedding: Option<Vec<f32>>,
    /// The procedures in their order.
    pub procedures: Vec<ProcedureData>,
    /// Seconds between poses.
    pub dt: f64,
    /// Identifies the set; see [`TrainingSet::content_hash`].
    pub dataset_hash: String,
}

impl From<&tdv_demonstration::Dataset> for TrainingSet {
    /// The set's poses; of the rest at a trajectory's end one pose is kept, since training adds rest
    /// of its own.
    fn from(d: &tdv_demonstration::Dataset) -> Self {
        let poses = |t: &tdv_geometry::PoseTrajectory| {
            let mut poses: Vec<Pose> = t.poses().copied().collect();
            while poses.len() > 2 && at_rest(&poses[poses.len() - 2], &poses[poses.len() - 1]) {
                poses.pop();
            }
            poses
        };
        Self {
            task: d.task.clone(),
            text: d.text.clone(),
            text_embedding: None,
            procedures: d
                .procedures
                .iter()
                .map(|p| ProcedureData {
                    name: p.name.clone(),
                    trajectories: p.trajectories.iter().map(poses).collect(),
                })
                .collect(),
            dt: d.dt,
            dataset_hash: d.hash(),
        }
    }
}

fn at_rest(a: &Pose, b: &Pose) -> bool {
    let (d, r) = tdv_geometry::pose_distance(a, b);
    d < 1e-7 && r < 1e-6
}

impl TrainingSet {
    /// Checks the set against the policy that shall learn from it.
    ///
    /// # Errors
    /// [`PolicyError::Data`] naming procedure and trajectory, [`PolicyError::NotFinite`].
    pub fn validate(&self, config: &PolicyConfig) -> Result<(), PolicyError> {
        let fail = |reason: String| Err(PolicyError::Data { reason });
        if self.procedures.is_empty() {
            return fail("it has no procedure".into());
        }
        if (self.dt - config.dt).abs() > 1e-9 {
            return fail(format!(
                "its poses are {} s apart, the policy wants {}; resample it or set `dt`",
                self.dt, config.dt
            ));
        }
        if let Some(e) = &self.text_embedding
            && (e.is_empty() || e.iter().any(|v| !v.is_finite()))
        {
            return fail("the text embedding is empty or not finite".into());
        }
        for p in &self.procedures {
            if p.trajectories.is_empty() {
                return fail(format!("procedure `{}` has no trajectory", p.name));
            }
            for (i, t) in p.trajectories.iter().enumerate() {
                if t.len() < 2 {
                    return fail(format!(
                        "procedure `{}`: trajectory {i} has {} poses, at least 2 are needed",
                        p.name,
                        t.len()
                    ));
                }
                for (j, pose) in t.iter().enumerate() {
                    finite(pose, || format!("procedure `{}`: trajectory {i}, pose {j}", p.name))?;
                }
            }
        }
        Ok(())
    }

    /// FNV-1a over names and the bits of every number, the text embedding's included, as 16 hexadecimal
    /// digits.
    pub fn content_hash(&self) -> String {
        let mut hash = 0xcbf2_9ce4_8422_2325_u64;
        let mut feed = |bytes: &[u8]| {
            for b in bytes {
                hash = (hash ^ u64::from(*b)).wrapping_mul(0x100_0000_01b3);
            }
        };
        feed(self.task.as_bytes());
        feed(&self.dt.to_le_bytes());
        for v in self.text_embedding.iter().flatten() {
            feed(&v.to_le_bytes());
        }
        for p in &self.procedures {
            feed(p.name.as_bytes());
            for t in &p.trajectories {
                feed(&(t.len() as u64).to_le_bytes());
                for pose in t {
                    for v in pose.translation.vector.iter().chain(pose.rotation.coords.iter()) {
                        feed(&v.to_le_bytes());
                    }
                }
            }
        }
        format!("{hash:016x}")
    }

    /// One normaliser per procedure, from all its poses.
    ///
    /// # Errors
    /// As [`Normaliser::fit`].
    pub fn normalisers(&self) -> Result<Vec<Normaliser>, PolicyError> {
        self.procedures.iter().map(|p| Normaliser::fit(p.trajectories.iter().flatten())).collect()
    }

    /// Where each procedure ends: mean position and rotation of the trajectories' last poses.
    pub fn end_poses(&self) -> Vec<Pose> {
        self.procedures
            .iter()
            .map(|p| mean(p.trajectories.iter().filter_map(|t| t.last())))
            .collect()
    }
}

fn mean<'a>(poses: impl Iterator<Item = &'a Pose> + Clone) -> Pose {
    let (mut sum, mut q, mut n) = (Vector3::zeros(), nalgebra::Vector4::zeros(), 0.0);
    for p in poses {
        sum += p.translation.vector;
        let c = p.rotation.coords;
        q += if c.dot(&q) < 0.0 { -c } else { c };
        n += 1.0;
    }
    if n == 0.0 || q.norm() < 1e-9 {
        return Pose::identity();
    }
    let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::from(q));
    Pose::from_parts((sum / n).into(), rotation)
}

/// The pose at a fractional sample number; the ends are held.
pub(crate) fn pose_at(trajectory: &[Pose], t: f64) -> Pose {
    let last = trajectory.len() - 1;
    if t <= 0.0 {
        return trajectory[0];
    }
    let i = t.floor() as usize;
    if i >= last {
        return trajectory[last];
    }
    interpolate(&trajectory[i], &trajectory[i + 1], t - i as f64)
}

/// A pose moved by Gaussian noise: standard deviations per axis, in the parent frame (m, rad).
pub(crate) fn disturb(pose: &Pose, position: f64, rotation: f64, rng: &mut ChaCha8Rng) -> Pose {
    let mut normal = || Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal));
    let (dp, dr) = (normal() * position, normal() * rotation);
    Pose::from_parts(
        (pose.translation.vector + dp).into(),
        UnitQuaternion::from_scaled_axis(dr) * pose.rotation,
    )
}

/// Where a window lies.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    pub task: usize,
    pub procedure: usize,
    pub trajectory: usize,
    pub position: usize,
}

/// Draws windows from the sets of one or more tasks.
pub(crate) struct Windows {
    sets: Vec<TrainingSet>,
    /// Of each task, one per procedure.
    normalisers: Vec<Vec<Normaliser>>,
    history: usize,
    train: TrainConfig,
    /// Per task and procedure: where each trajectory's positions start in a running count, and their
    /// total.
    starts: Vec<Vec<(Vec<usize>, usize)>>,
}

impl Windows {
    pub fn new(
        sets: Vec<TrainingSet>,
        normalisers: Vec<Vec<Normaliser>>,
        config: &PolicyConfig,
        train: &TrainConfig,
    ) -> Self {
        let count = |p: &ProcedureData| {
            let mut total = 0;
            let starts = p
                .trajectories
                .iter()
                .map(|t| {
                    let start = total;
                    total += t.len() + train.hold_samples;
                    start
                })
                .collect();
            (starts, total)
        };
        let starts = sets.iter().map(|s| s.procedures.iter().map(count).collect()).collect();
        Self { sets, normalisers, history: config.history, train: train.clone(), starts }
    }

    /// A random place: tasks equally often, procedures of a task equally often, positions within a
    /// procedure equally often.
    pub fn draw(&self, rng: &mut ChaCha8Rng) -> Place {
        let many = self.starts.len() > 1;
        let task = if many { rng.random_range(0..self.starts.len()) } else { 0 };
        let procedure = rng.random_range(0..self.starts[task].len());
        let (starts, total) = &self.starts[task][procedure];
        let position = rng.random_range(0..*total);
        let trajectory = starts.partition_point(|s| *s <= position) - 1;
        Place { task, procedure, trajectory, position: position - starts[trajectory] }
    }

    /// Writes the history `[history, 9]` and the future `[horizon, 9]` around a position.
    pub fn write(
        &self,
        Place { task, procedure, trajectory, position }: Place,
        rng: &mut ChaCha8Rng,
        history: &mut [f32],
        future: &mut [f32],
    ) {
        let poses = &self.sets[task].procedures[procedure].trajectories[trajectory];
        let normaliser = &self.normalisers[task][procedure];
        let t = &self.train;
        let jitter = t.time_jitter;
        let (mut time, mut spacing) = (position as f64, 1.0);
        if jitter > 0.0 {
            time += rng.random_range(-jitter..jitter);
            spacing += rng.random_range(-jitter..jitter);
        }
        let n = self.history;
        write_history(poses, normaliser, time, spacing, t, rng, history);
        let mut oldest = time - (n - 1) as f64 * spacing;
        if rng.random_bool(t.padding) {
            let valid = rng.random_range(1..=n);
            let (old, young) = history.split_at_mut((n - valid) * POSE_DIM);
            old.chunks_exact_mut(POSE_DIM).for_each(|o| o.copy_from_slice(&young[..POSE_DIM]));
            oldest = time - (valid - 1) as f64 * spacing;
        }
        let ahead = time + departure(poses, oldest, time, t.leave);
        for (i, out) in future.chunks_exact_mut(POSE_DIM).enumerate() {
            out.copy_from_slice(&normaliser.encode(&pose_at(poses, ahead + (i + 1) as f64)));
        }
    }
}

/// Samples to skip so that a plan leaves a standstill. A history that moved less than `leave` looks
/// like rest under tracker noise, and the smooth start of a trajectory moves even less before the next
/// plan is made: without the skip that plan would start from rest again, and so on for ever. Zero for
/// a history in motion, and where less than `leave` remains to the end.
fn departure(poses: &[Pose], oldest: f64, now: f64, leave: f64) -> f64 {
    const LIMIT: usize = 10;
    let here = pose_at(poses, now);
    let moved = |t: f64| twist_arc(&here, &pose_at(poses, t), LEVER);
    if leave <= 0.0 || moved(oldest) >= leave {
        return 0.0;
    }
    (1..=LIMIT).map(|s| s as f64).find(|s| moved(now + s) >= leave).unwrap_or(0.0)
}

/// A disturbed history that ends at sample `time`, its poses `spacing` samples apart.
pub(crate) fn write_history(
    poses: &[Pose],
    normaliser: &Normaliser,
    time: f64,
    spacing: f64,
    t: &TrainConfig,
    rng: &mut ChaCha8Rng,
    history: &mut [f32],
) {
    let n = history.len() / POSE_DIM;
    let amount: f64 = rng.random();
    let drift =
        disturb(&Pose::identity(), t.drift_position * amount, t.drift_rotation * amount, rng);
    let mut seen: Vec<Pose> = (0..n)
        .map(|i| {
            let clean = pose_at(poses, time - (n - 1 - i) as f64 * spacing);
            let shifted = Pose::from_parts(
                (clean.translation.vector + drift.translation.vector).into(),
                drift.rotation * clean.rotation,
            );
            disturb(&shifted, t.noise_position, t.noise_rotation, rng)
        })
        .collect();
    if t.missing > 0.0 {
        // The newest one is what the history ends at, so it is always there.
        let there: Vec<bool> = (0..n).map(|i| !rng.random_bool(t.missing) || i + 1 == n).collect();
        fill_gaps(&mut seen, &there);
    }
    for (out, pose) in history.chunks_exact_mut(POSE_DIM).zip(&seen) {
        out.copy_from_slice(&normaliser.encode(pose));
    }
}

/// Puts in place of poses that are not there what [`crate::HistoryBuffer`] would: the way between the
/// neighbours, and the first one before it. The last one must be there.
fn fill_gaps(poses: &mut [Pose], there: &[bool]) {
    let Some(first) = there.iter().position(|t| *t) else { return };
    let start = poses[first];
    poses[..first].fill(start);
    let mut before = first;
    for i in first + 1..poses.len() {
        if !there[i] {
            continue;
        }
        let (a, b) = (poses[before], poses[i]);
        for (j, pose) in poses.iter_mut().enumerate().take(i).skip(before + 1) {
            *pose = interpolate(&a, &b, (j - before) as f64 / (i - before) as f64);
        }
        before = i;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Stream, stream};
    use crate::synthetic;

    /// No disturbance of any kind.
    fn quiet() -> TrainConfig {
        TrainConfig {
            noise_position: 0.0,
            noise_rotation: 0.0,
            drift_position: 0.0,
            drift_rotation: 0.0,
            time_jitter: 0.0,
            padding: 0.0,
            missing: 0.0,
            leave: 0.0,
            ..TrainConfig::default()
        }
    }

    /// Histories of a start are padded with their oldest pose, to any length; those with missing samples
    /// are bent, but the newest pose and the future are as they were.
    #[test]
    fn padded_and_patchy_histories_end_at_the_same_pose() {
        let set = synthetic::place_set(2, 1);
        let config = PolicyConfig { dt: 0.1, ..PolicyConfig::small() };
        let n = set.normalisers().unwrap();
        let place = Place { task: 0, procedure: 0, trajectory: 0, position: 30 };
        let draw = |t: &TrainConfig, seed: u64| {
            let w = Windows::new(vec![set.clone()], vec![n.clone()], &config, t);
            let (mut h, mut f) = (vec![0.0; 8 * 9], vec![0.0; 16 * 9]);
            w.write(place, &mut stream(seed, Stream::Augmentation), &mut h, &mut f);
            (h, f)
        };
        let (whole, future) = draw(&quiet(), 0);
        let padded = TrainConfig { padding: 1.0, ..quiet() };
        let patchy = TrainConfig { missing: 0.4, ..quiet() };
        let (mut lengths, mut bent) = ([0; 9], 0);
        for seed in 0..200 {
            let (h, f) = draw(&padded, seed);
            let own = h.chunks(9).zip(whole.chunks(9)).rev().take_while(|(a, b)| a == b).count();
            lengths[own] += 1;
            assert!(h[..(8 - own) * 9].chunks(9).all(|row| row == &h[(8 - own) * 9..][..9]));
            assert_eq!(f, future);
            let (h, f) = draw(&patchy, seed);
            assert_eq!((&h[63..], &f), (&whole[63..], &future));
            // Bent by no more than the way between the neighbours.
            assert!(h.iter().zip(&whole).all(|(a, b)| (a - b).abs() < 0.6));
            bent += usize::from(h != whole);
        }
        assert!(lengths[0] == 0 && lengths[1..].iter().all(|n| *n > 5), "{lengths:?}");
        assert!(bent > 180, "{bent}");
    }

    #[test]
    fn bad_sets_are_refused_by_name() {
        let config = PolicyConfig { dt: 0.1, ..PolicyConfig::small() };
        let good = synthetic::place_set(2, 1);
        good.validate(&config).unwrap();
        let mut short = good.clone();
        short.procedures[0].trajectories[1].truncate(1);
        assert!(short.validate(&config).unwrap_err().to_string().contains("trajectory 1 has 1"));
        let mut nan = good.clone();
        nan.procedures[0].trajectories[0][3].translation.vector.x = f64::NAN;
        assert!(nan.validate(&config).unwrap_err().to_string().contains("trajectory 0, pose 3"));
        assert!(good.validate(&PolicyConfig::small()).unwrap_err().to_string().contains("0.05"));
        assert_ne!(good.content_hash(), short.content_hash());
    }

    #[test]
    fn windows_hold_the_ends_and_follow_the_path() {
        let set = synthetic::place_set(3, 1);
        let config = PolicyConfig { dt: 0.1, ..PolicyConfig::small() };
        let quiet = quiet();
        let n = set.normalisers().unwrap();
        let w = Windows::new(vec![set.clone()], vec![n.clone()], &config, &quiet);
        let at = |position| Place { task: 0, procedure: 0, trajectory: 1, position };
        let mut rng = stream(1, Stream::Batch);
        let (mut h, mut f) = (vec![0.0; 8 * 9], vec![0.0; 16 * 9]);
        w.write(at(0), &mut rng, &mut h, &mut f);
        let poses = &set.procedures[0].trajectories[1];
        assert_eq!(h[..9], n[0].encode(&poses[0]));
        assert_eq!(h[63..], n[0].encode(&poses[0]));
        assert_eq!(f[..9], n[0].encode(&poses[1]));
        let end = poses.len() - 1;
        w.write(at(end + 9), &mut rng, &mut h, &mut f);
        assert_eq!(h[..9], n[0].encode(&poses[end]));
        assert_eq!(f[15 * 9..], n[0].encode(&poses[end]));
        // From rest the plan leaves at once, in motion and at the end it does not jump.
        let length = |i: f64| departure(poses, i - 7.0, i, 0.003);
        let s = length(0.0);
        assert!(s >= 2.0 && twist_arc(&poses[0], &pose_at(poses, s), LEVER) >= 0.003);
        assert_eq!(length(poses.len() as f64 / 2.0), 0.0);
        assert_eq!(length(end as f64), 0.0);
        assert_eq!(length(end as f64 + 9.0), 0.0);
        for _ in 0..1000 {
            let p = w.draw(&mut rng);
            let t = &set.procedures[p.procedure].trajectories[p.trajectory];
            assert!(p.position < t.len() + quiet.hold_samples);
        }
    }

    #[test]
    fn tasks_and_their_procedures_are_drawn_equally_often() {
        // Sizes that differ by far, and two procedures against one.
        let mut many = synthetic::place_set(40, 1);
        many.task = "many".into();
        let few = synthetic::reach_and_place_set(2, 2);
        let config = PolicyConfig { dt: 0.1, ..PolicyConfig::small() };
        let n = vec![many.normalisers().unwrap(), few.normalisers().unwrap()];
        let w = Windows::new(vec![many, few], n, &config, &TrainConfig::default());
        let mut rng = stream(1, Stream::Batch);
        let mut counts = [[0usize; 2]; 2];
        for _ in 0..4000 {
            let p = w.draw(&mut rng);
            counts[p.task][p.procedure] += 1;
        }
        assert!((1800..2200).contains(&counts[0][0]), "{counts:?}");
        assert!((850..1150).contains(&counts[1][0]), "{counts:?}");
        assert!((850..1150).contains(&counts[1][1]), "{counts:?}");
    }

    /// What a training calls a missing sample is what the buffer makes of one that did not come in.
    #[test]
    fn gaps_are_filled_as_the_history_buffer_fills_them() {
        let set = synthetic::place_set(1, 1);
        let poses = &set.procedures[0].trajectories[0][10..18];
        for there in [
            [true, false, true, true, false, false, false, true],
            [false, false, true, false, true, true, false, true],
            [false, false, false, false, false, false, false, true],
        ] {
            let mut filled = poses.to_vec();
            fill_gaps(&mut filled, &there);
            let config = crate::HistoryConfig { length: 8, dt: 0.1, max_gap: 2.0 };
            let mut buffer = crate::HistoryBuffer::new(config).unwrap();
            for (i, (pose, there)) in poses.iter().zip(there).enumerate() {
                if there {
                    buffer.push(tdv_geometry::Stamp::from_secs(i as f64 * 0.1), pose).unwrap();
                }
            }
            for (a, b) in filled.iter().zip(buffer.poses().unwrap()) {
                let (d, r) = tdv_geometry::pose_distance(a, &b);
                assert!(d < 1e-6 && r < 1e-6, "{d} {r}");
            }
        }
    }
}
