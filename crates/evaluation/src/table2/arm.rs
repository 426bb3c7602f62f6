//! The arms of the ablation study: what one changes against the ordinary setting.

use serde::{Deserialize, Serialize};
use tdv_demonstration::GenerationMode;
use tdv_policy::Prediction;

/// One setting of everything that the study varies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Arm {
    /// Its name in tables and files.
    pub name: String,
    /// How trajectories are made of the demonstration.
    pub warp: GenerationMode,
    /// Poses of the past that policy and switch see.
    pub history: usize,
    /// What the network predicts.
    pub prediction: Prediction,
    /// The averaged weights are used, not the last.
    pub ema: bool,
    /// Trajectories that start beside the path.
    pub recovery: bool,
    /// The encoder runs once per plan, not once per denoising step. The plans are the same.
    pub encoder_cache: bool,
    /// A head that tells the share of the way, with a threshold, instead of the switch classifier.
    pub progress: bool,
}

impl Arm {
    /// What `tdv teach` does.
    pub fn ordinary() -> Self {
        Self {
            name: "ordinary".into(),
            warp: GenerationMode::Repaired,
            history: 8,
            prediction: Prediction::Sample,
            ema: true,
            recovery: true,
            encoder_cache: true,
            progress: false,
        }
    }

    /// The ordinary one and all that change something.
    pub fn all() -> Vec<Self> {
        let change = |name: &str, f: &dyn Fn(&mut Self)| {
            let mut arm = Self::ordinary();
            f(&mut arm);
            arm.name = name.into();
            arm
        };
        vec![
            Self::ordinary(),
            change("paper_warp", &|a| a.warp = GenerationMode::Paper),
            change("history_1", &|a| a.history = 1),
            change("history_16", &|a| a.history = 16),
            change("history_64", &|a| a.history = 64),
            change("epsilon", &|a| a.prediction = Prediction::Epsilon),
            change("no_ema", &|a| a.ema = false),
            change("no_recovery", &|a| a.recovery = false),
            change("no_encoder_cache", &|a| a.encoder_cache = false),
            // As SPOT has it: the present pose only, and progress instead of a switch.
            change("progress_head", &|a| (a.history, a.progress) = (1, true)),
        ]
    }

    /// The one of that name.
    pub fn named(name: &str) -> Option<Self> {
        Self::all().into_iter().find(|a| a.name == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_arm_changes_something_and_has_its_own_name() {
        let all = Arm::all();
        for (i, a) in all.iter().enumerate() {
            assert_eq!(Arm::named(&a.name).as_ref(), Some(a));
            let plain = Arm { name: "ordinary".into(), ..a.clone() };
            assert_eq!(plain == Arm::ordinary(), i == 0, "{}", a.name);
        }
        assert!(Arm::named("nonsense").is_none());
    }
}
