//! `robot.toml` from disk: another structure than the meta-module.

use std::path::Path;
use std::sync::Arc;

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
