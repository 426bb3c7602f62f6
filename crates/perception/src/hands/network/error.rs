use std::path::PathBuf;

/// Why a network file could not be used. Every message names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// The file could not be read.
    #[error("{}: {source}; run launch_scripts/fetch_hand_models.sh to obtain the hand networks", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The file is not a TFLite network, or it is damaged.
    #[error(
        "{}: not a usable TFLite network ({what}); fetch it again with launch_scripts/fetch_hand_models.sh",
        path.display()
    )]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// The network uses an operator that this interpreter does not have.
    #[error("{}: the operator {operator} is not supported", path.display())]
    UnsupportedOperator {
        /// The file.
        path: PathBuf,
        /// The operator's name in the TFLite schema, or its number.
        operator: String,
    },
    /// The network is sound, but it has a feature that this interpreter does not have.
    #[error("{}: {what} is not supported", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// The feature.
        what: String,
    },
    /// The network's inputs or outputs are not those of the network expected in its place.
    #[error("{}: {what}; this is another network than the one expected here", path.display())]
    Interface {
        /// The file.
        path: PathBuf,
        /// What differs.
        what: String,
    },
}

/// The same without the path, as the parts inside report it.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Flaw {
    Malformed(String),
    Operator(String),
    Unsupported(String),
}

impl Flaw {
    pub(super) fn malformed(what: impl Into<String>) -> Self {
        Self::Malformed(what.into())
    }

    pub(super) fn unsupported(what: impl Into<String>) -> Self {
        Self::Unsupported(what.into())
    }

    pub(super) fn at(self, path: &std::path::Path) -> NetworkError {
        let path = path.to_path_buf();
        match self {
            Self::Malformed(what) => NetworkError::Malformed { path, what },
            Self::Operator(operator) => NetworkError::UnsupportedOperator { path, operator },
            Self::Unsupported(what) => NetworkError::Unsupported { path, what },
        }
    }
}
