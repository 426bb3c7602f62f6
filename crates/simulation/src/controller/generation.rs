use crate::arm::ArmModel;

/// Which controller generation is imitated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Generation {
    /// CB3: 125 Hz.
    #[default]
    Cb3,
    /// e-Series: 500 Hz.
    ESeries,
}

impl Generation {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Cb3, Self::ESeries];

    /// The one of a name.
    pub fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|g| g.name() == name)
    }

    /// As parameters and commands name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cb3 => "cb3",
            Self::ESeries => "e_series",
        }
    }

    /// The arm that it drives.
    pub fn arm(self) -> ArmModel {
        match self {
            Self::Cb3 => ArmModel::Ur5,
            Self::ESeries => ArmModel::Ur5e,
        }
    }

    /// Control cycle, s.
    pub fn cycle(self) -> f64 {
        match self {
            Self::Cb3 => 0.008,
            Self::ESeries => 0.002,
        }
    }

    /// Software version: major, minor, bug-fix, build.
    pub fn version(self) -> [u32; 4] {
        match self {
            Self::Cb3 => [3, 15, 8, 106_339],
            Self::ESeries => [5, 12, 4, 1_101_661],
        }
    }
}
