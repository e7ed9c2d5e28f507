//! `robot.toml` from disk: another structure than the meta-module.

use std::path::Path;
use std::sync::Arc;

use control::machine::Machine;
use files::model::Model;
use files::structure::Structure;
use physics::Robot;

use crate::disk;
use crate::failure::{Exit, Failure, Outcome};

/// A structure as it stood in its file, and as a robot.
pub struct RobotFile {
    /// The file's text.
    pub text: String,
    /// The robot.
    pub robot: Arc<Robot>,
}

/// Reads a structure.
///
/// # Errors
/// Exit code 3 with file, line and what is wrong.
pub fn structure(path: &Path) -> Outcome<Structure> {
    let shown = path.display().to_string();
    let text = disk::read_text(path, disk::MAX_TEXT)
        .map_err(|e| Failure::say(Exit::BadFile, format!("{shown}: {e}")))?;
    Structure::parse(&shown, &text).map_err(|error| Failure::new(Exit::BadFile, error))
}

/// Reads a structure as the firmware sees it: its joints, and what of it may meet.
///
/// # Errors
/// Exit code 3 with file, line and what is wrong.
pub fn machine(path: &Path) -> Outcome<Machine> {
    machine_of(path, &structure(path)?)
}

/// A structure that was read from `path` as the firmware sees it.
///
/// # Errors
/// Exit code 3 with file, line and what is wrong.
pub fn machine_of(path: &Path, structure: &Structure) -> Outcome<Machine> {
    structure.machine().map_err(|error| {
        let (shown, line) = (path.display(), structure.line(error.part()));
        Failure::say(Exit::BadFile, format!("{shown}:{line}: {error}"))
    })
}

/// Reads a structure and builds the robot with the model's twist for the firmware's pre-check.
///
/// # Errors
/// Exit code 3 with file, line and what is wrong.
pub fn load(path: &Path, model: &Model) -> Outcome<RobotFile> {
    let shown = path.display().to_string();
    let text = disk::read_text(path, disk::MAX_TEXT)
        .map_err(|e| Failure::say(Exit::BadFile, format!("{shown}: {e}")))?;
    let structure =
        Structure::parse(&shown, &text).map_err(|error| Failure::new(Exit::BadFile, error))?;
    let robot = Robot::of_structure(&structure, model).map_err(|error| {
        let line = structure.line(error.part());
        Failure::say(Exit::BadFile, format!("{shown}:{line}: {error}"))
    })?;
    Ok(RobotFile {
        text,
        robot: Arc::new(robot),
    })
}
