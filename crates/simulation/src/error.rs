use std::path::PathBuf;
use thiserror::Error;

/// What can go wrong in setting up or serving the lab.
#[derive(Debug, Error)]
pub enum SimulationError {
    /// A file cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A scene file does not have the fields it should.
    #[error("{path}: {reason}")]
    Parse {
        /// The file.
        path: PathBuf,
        /// What the parser said.
        reason: String,
    },
    /// A value of a scene that makes no sense.
    #[error("{path}: {field} {reason}")]
    Value {
        /// The file.
        path: PathBuf,
        /// Which field.
        field: String,
        /// What is wrong with it and what is possible.
        reason: String,
    },
    /// An object's folder was refused.
    #[error(transparent)]
    Object(#[from] tdv_rendering::ObjectError),
    /// A name that the scene does not have.
    #[error("the scene has no object `{name}`; it has {known}")]
    UnknownObject {
        /// The name asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// No place on the table fits.
    #[error("no free place for `{name}` within {min:.2} to {max:.2} m of where it stands")]
    NoPlace {
        /// The object.
        name: String,
        /// Least distance asked for, m.
        min: f64,
        /// Most, m.
        max: f64,
    },
    /// The arm cannot be where it is to begin.
    #[error("robot.home: the arm cannot begin there: {0}")]
    Home(#[from] tdv_robot::IkError),
    /// A server's port cannot be had.
    #[error("{what} cannot listen on {address}: {source}; is another controller running there?")]
    Listen {
        /// Which server.
        what: &'static str,
        /// Address and port.
        address: String,
        /// What the system said.
        source: std::io::Error,
    },
}
