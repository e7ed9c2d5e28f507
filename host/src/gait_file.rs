//! Gait files from disk, with the checks the robot will make, made before anything is sent.

use std::io::Read;
use std::path::{Path, PathBuf};

use control::gait::{Gait, RobotMismatch};
use control::robot::RobotModel;

use crate::failure::{Exit, Failure, Outcome};

/// Why a text file could not be read.
#[derive(Debug, thiserror::Error)]
pub enum TextFileError {
    /// Opening or reading failed.
    #[error("cannot read {path}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Not UTF-8.
    #[error("{path}: byte {at} is not UTF-8 text; save the file as UTF-8")]
    NotText {
        /// The file.
        path: PathBuf,
        /// First bad byte.
        at: usize,
    },
}

/// Reads at most `limit` + 1 bytes of a text file: an endless device does not fill the memory.
///
/// # Errors
/// [`TextFileError`]
pub fn read_text(path: &Path, limit: usize) -> Result<String, TextFileError> {
    let io = |source| TextFileError::Io {
        path: path.to_owned(),
        source,
    };
    let file = std::fs::File::open(path).map_err(io)?;
    let mut bytes = Vec::new();
    file.take(limit as u64 + 1)
        .read_to_end(&mut bytes)
        .map_err(io)?;
    String::from_utf8(bytes).map_err(|e| {
        let at = e.utf8_error().valid_up_to();
        TextFileError::NotText {
            path: path.to_owned(),
            at,
        }
    })
}

/// Reads and validates a gait file.
///
/// # Errors
/// Exit code 3, with file, line and what to do.
pub fn load(path: &Path) -> Outcome<Gait> {
    let text =
        read_text(path, files::gait::MAX_BYTES).map_err(|e| Failure::new(Exit::BadFile, e))?;
    Ok(files::gait::parse(&path.display().to_string(), &text)?)
}

/// Speed check against the robot's joints.
///
/// # Errors
/// [`RobotMismatch`]
pub fn check_speed(gait: &Gait, model: &RobotModel) -> Result<(), RobotMismatch> {
    gait.check_speed(model)
}
