//! The emulated robot in this process: firmware, bus and motors on a virtual clock that runs as fast as the host can.

use std::any::Any;
use std::path::Path;
use std::time::Duration;

use control::motion::MotionParams;
use control::robot::RobotModel;
use files::model::Model;
use files::structure::Structure;
use hil_sim::ground::Ground;
use hil_sim::lab::{CameraSetup, Lab};
use hil_sim::robot::link::LinkLine;
use hil_sim::robot::{EmulatedRobot, Setup};
use hil_sim::scenario::{self, Scenario};
use hil_sim::world::World;

use super::{Link, LinkError, PortUri};
use crate::disk;
use crate::recording::beside::{BaseRow, ImuRow, Seen};
use crate::searching::frames::Frames;

/// Largest scenario file.
const MAX_BYTES: u64 = 1 << 20;

/// The emulated robot as a link.
pub struct SimLink {
    uri: PortUri,
    robot: EmulatedRobot<World>,
    line: LinkLine,
}

impl core::fmt::Debug for SimLink {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("SimLink")
            .field("uri", &self.uri)
            .finish_non_exhaustive()
    }
}

/// What instruments beside the emulated robot have seen.
#[derive(Debug, Clone, PartialEq)]
pub struct EmulatedLab {
    /// The camera, if one stands there: what anyone could measure of it with a ruler.
    pub camera: Option<CameraSetup>,
    /// Film, poses, readings.
    pub seen: Seen,
}

impl EmulatedLab {
    /// What the instruments beside a robot have seen since it was powered; `None` when there are none.
    #[must_use]
    pub fn beside(robot: &EmulatedRobot<World>) -> Option<Self> {
        let world = robot.motors().borrow();
        let body: &dyn Any = world.plant().body();
        let lab = body.downcast_ref::<Ground>()?.lab()?;
        Some(Self::of(lab))
    }

    fn of(lab: &Lab) -> Self {
        let (t_s, frames) = lab.film(&RobotModel::default()).unzip();
        let base = lab.poses().map(|pose| BaseRow {
            t_s: pose.t_s,
            position_m: pose.position_m,
            quaternion: pose.quaternion,
        });
        let imu = lab.readings().map(|reading| ImuRow {
            t_s: reading.t_s,
            gyro_rad_s: reading.gyro_rad_s,
            accel_m_s2: reading.accel_m_s2,
        });
        Self {
            camera: lab.params().camera.map(|camera| *camera.setup()),
            seen: Seen {
                film: Frames { t_s, frames },
                base: base.collect(),
                imu: imu.collect(),
            },
        }
    }
}

fn read(path: &Path) -> Result<String, LinkError> {
    disk::read_text(path, MAX_BYTES)
        .map_err(|e| LinkError::Scenario(format!("cannot read {}: {e}", path.display())))
}

/// Whether a text is a `robot.toml`: no scenario has bodies.
fn is_robot(text: &str) -> bool {
    toml::from_str::<toml::Table>(text).is_ok_and(|table| table.contains_key("body"))
        && text.contains("[[body]]")
}

/// The robot of a structure that was read from the file `name`.
///
/// # Errors
/// [`LinkError::Scenario`]
pub fn robot_scenario(name: &str, structure: &Structure) -> Result<Scenario, LinkError> {
    scenario::of_structure(structure).map_err(|error| {
        let line = structure.line(error.part());
        LinkError::Scenario(format!("{name}:{line}: {error}"))
    })
}

/// Reads a scenario, or the robot of a `robot.toml`; without a file six catalogue motors without faults.
///
/// # Errors
/// [`LinkError::Scenario`]
pub fn load_scenario(path: Option<&Path>) -> Result<Scenario, LinkError> {
    let text = match path {
        Some(path) => read(path)?,
        None => String::new(),
    };
    let name = path.map_or_else(|| "sim:".to_owned(), |p| p.display().to_string());
    if is_robot(&text) {
        let structure =
            Structure::parse(&name, &text).map_err(|e| LinkError::Scenario(e.to_string()))?;
        return robot_scenario(&name, &structure);
    }
    let mut scenario =
        scenario::parse(&name, &text).map_err(|e| LinkError::Scenario(e.to_string()))?;
    if let Some(file) = &scenario.model_file {
        let folder = path.and_then(Path::parent).unwrap_or(Path::new(""));
        let shown = folder.join(file).display().to_string();
        let text = read(&folder.join(file))?;
        scenario.model =
            Model::parse(&shown, &text).map_err(|e| LinkError::Scenario(e.to_string()))?;
    }
    Ok(scenario)
}

/// A robot of this scenario, its joints in the home pose, just powered.
///
/// # Errors
/// [`LinkError::Scenario`]
pub fn robot_of(scenario: &Scenario) -> Result<EmulatedRobot<World>, LinkError> {
    let world = scenario
        .build()
        .map_err(|e| LinkError::Scenario(e.to_string()))?;
    let setup = Setup {
        seed: scenario.world.seed,
        motion: MotionParams::default().with_machine(scenario.machine),
        ..Setup::default()
    };
    Ok(EmulatedRobot::with_motors(setup, world))
}

impl SimLink {
    /// Starts the emulated robot.
    ///
    /// # Errors
    /// [`LinkError::Scenario`]
    pub fn open(path: Option<&Path>) -> Result<Self, LinkError> {
        Self::open_repeat(path, 0, [0.0; 2])
    }

    /// Starts the emulated robot with other chance, put down this much further along x and y: the robot of a repeated trial.
    ///
    /// # Errors
    /// [`LinkError::Scenario`]
    pub fn open_repeat(
        path: Option<&Path>,
        repeat: u64,
        further_m: [f64; 2],
    ) -> Result<Self, LinkError> {
        let mut scenario = load_scenario(path)?.repeat(repeat);
        scenario.start.place.x_m += further_m[0];
        scenario.start.place.y_m += further_m[1];
        let robot = robot_of(&scenario)?;
        let line = robot.link();
        Ok(Self {
            uri: PortUri::Sim(path.map(Path::to_owned)),
            robot,
            line,
        })
    }
}

impl Link for SimLink {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.line.write(bytes);
        Ok(())
    }

    fn receive(&mut self, wait: Duration, into: &mut Vec<u8>) -> Result<(), LinkError> {
        if self.line.read(into) == 0 {
            let wait_us = u64::try_from(wait.as_micros()).unwrap_or(u64::MAX).max(1);
            self.robot
                .run_until_readable(self.robot.now_us().saturating_add(wait_us));
            self.line.read(into);
        }
        Ok(())
    }

    fn now(&self) -> Duration {
        Duration::from_micros(self.robot.now_us())
    }

    fn reconnect(&mut self) -> Result<(), LinkError> {
        self.line.reconnect();
        Ok(())
    }

    fn uri(&self) -> &PortUri {
        &self.uri
    }

    fn seen(&self) -> Option<EmulatedLab> {
        EmulatedLab::beside(&self.robot)
    }
}
