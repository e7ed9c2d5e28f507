//! MuJoCo and ODE: our C programs around their libraries, and the files that carry robot and trials to them.

use crate::track::{JOINTS, Report, TICKS, Track, set_points};
use physics::mjcf::{self, Servo};
use physics::{Params, Trial};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Points on a great circle of the exported hulls: 5 degrees, 0.06 mm off the ball.
pub(crate) const PER_TURN: usize = 72;

/// Why another engine gave nothing.
#[derive(Debug, thiserror::Error)]
pub enum PeerError {
    /// A file of the exchange cannot be written or read.
    #[error("{}: {error}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// The package folder holds no library.
    #[error("{} holds no libmujoco.so; `pip install mujoco` puts one there", package.display())]
    NoLibrary {
        /// Where it was looked for.
        package: PathBuf,
    },
    /// There is no C compiler.
    #[error("no C compiler: {0}; install cc")]
    NoCompiler(std::io::Error),
    /// The program did not compile.
    #[error("{program} did not compile; {remedy}:\n{said}")]
    Compile {
        /// Which program.
        program: &'static str,
        /// What is needed.
        remedy: &'static str,
        /// What the compiler said.
        said: String,
    },
    /// The program failed.
    #[error("{} failed:\n{said}", program.display())]
    Run {
        /// Which program.
        program: PathBuf,
        /// What it said.
        said: String,
    },
}

/// A folder with the robot and the trials in the forms that the other engines read.
#[derive(Debug)]
pub struct Workplace {
    folder: PathBuf,
}

impl Workplace {
    /// Writes robot and trials into `folder`.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn new(folder: PathBuf, params: &Params, trials: &[Trial]) -> Result<Self, PeerError> {
        std::fs::create_dir_all(&folder).map_err(|error| PeerError::File {
            path: folder.clone(),
            error,
        })?;
        let place = Self { folder };
        for (name, servo) in [
            (model_file(Servo::Constraint), Servo::Constraint),
            (model_file(Servo::Actuator), Servo::Actuator),
        ] {
            let text = mjcf::to_mjcf(params, 0.004, PER_TURN, servo);
            place.write(name, text.as_bytes())?;
        }
        place.write("robot.txt", robot_text(params).as_bytes())?;
        place.write("trials.bin", &trial_bytes(params, trials))?;
        Ok(place)
    }

    fn write(&self, name: &str, bytes: &[u8]) -> Result<PathBuf, PeerError> {
        let path = self.folder.join(name);
        match std::fs::write(&path, bytes) {
            Ok(()) => Ok(path),
            Err(error) => Err(PeerError::File { path, error }),
        }
    }

    /// Compiles one of our programs in the folder.
    fn build(
        &self,
        name: &'static str,
        source: &str,
        remedy: &'static str,
        arguments: &[String],
    ) -> Result<PathBuf, PeerError> {
        let source = self.write(&format!("{name}.c"), source.as_bytes())?;
        let program = self.folder.join(name);
        let done = Command::new("cc")
            .args(["-O2", "-o"])
            .arg(&program)
            .arg(source)
            .args(arguments)
            .output()
            .map_err(PeerError::NoCompiler)?;
        if done.status.success() {
            return Ok(program);
        }
        Err(PeerError::Compile {
            program: name,
            remedy,
            said: String::from_utf8_lossy(&done.stderr).into_owned(),
        })
    }

    /// Standard output of a program run in the folder.
    fn say(&self, program: &Path, args: &[&str]) -> Result<String, PeerError> {
        let failed = |said: String| PeerError::Run {
            program: program.to_owned(),
            said,
        };
        let out = Command::new(program)
            .args(args)
            .current_dir(&self.folder)
            .output()
            .map_err(|error| failed(error.to_string()))?;
        if !out.status.success() {
            return Err(failed(String::from_utf8_lossy(&out.stderr).into_owned()));
        }
        Ok(String::from_utf8_lossy(&out.stdout).into_owned())
    }

    /// Runs a program whose last argument names the file of tracks it writes.
    fn report(&self, program: &Path, args: &[&str], tracks: &str) -> Result<Report, PeerError> {
        let text = self.say(program, &[args, &[tracks]].concat())?;
        let path = self.folder.join(tracks);
        let bytes = std::fs::read(&path).map_err(|error| PeerError::File { path, error })?;
        let (eights, _) = bytes.as_chunks::<8>();
        let numbers: Vec<f64> = eights.iter().map(|b| f64::from_le_bytes(*b)).collect();
        let rows: Track = numbers.as_chunks::<{ 7 + JOINTS }>().0.to_vec();
        Ok(Report {
            tracks: rows.chunks(TICKS + 1).map(<[_]>::to_vec).collect(),
            figures: figures(&text),
        })
    }
}

fn figures(text: &str) -> Vec<(String, f64)> {
    text.lines()
        .filter_map(|l| l.split_once(' '))
        .filter_map(|(n, v)| Some((n.to_owned(), v.trim().parse().ok()?)))
        .collect()
}

/// MJCF file of each form of the servo.
fn model_file(servo: Servo) -> &'static str {
    match servo {
        Servo::Constraint => "model.xml",
        Servo::Actuator => "actuator.xml",
    }
}

/// The folder of the Python package `mujoco`, which holds library and headers: of the environment in `venv` when there is one, else of the
/// `python3` that the shell finds.
#[must_use]
pub fn mujoco_package(venv: &Path) -> Option<PathBuf> {
    let ask = |python: &Path| {
        let code = "import mujoco; print(mujoco.__path__[0])";
        let out = Command::new(python).args(["-c", code]).output().ok()?;
        let path = PathBuf::from(String::from_utf8_lossy(&out.stdout).trim());
        (out.status.success() && path.is_dir()).then_some(path)
    };
    let absolute = |path: PathBuf| path.canonicalize().ok();
    ask(&venv.join("bin/python"))
        .or_else(|| ask(Path::new("python3")))
        .and_then(absolute)
}

/// How a contact limits friction in MuJoCo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cone {
    /// Its default: a pyramid, cheaper, direction-dependent.
    Pyramidal,
    /// Coulomb's round cone, as this engine has it.
    Elliptic,
}

/// MuJoCo around the exported model.
#[derive(Debug)]
pub struct Mujoco<'a> {
    place: &'a Workplace,
    program: PathBuf,
}

impl<'a> Mujoco<'a> {
    /// Builds our program against the library of the Python package in `package` ([`mujoco_package`]).
    ///
    /// # Errors
    /// No library there, no C compiler, or a program that does not compile.
    pub fn build(place: &'a Workplace, package: &Path) -> Result<Self, PeerError> {
        let missing = || PeerError::NoLibrary {
            package: package.to_owned(),
        };
        let entries = std::fs::read_dir(package).map_err(|_| missing())?;
        let library = entries
            .flatten()
            .map(|entry| entry.path())
            .find(|path| path.to_string_lossy().contains("libmujoco.so"))
            .ok_or_else(missing)?;
        let shown = package.display();
        let arguments = [
            library.display().to_string(),
            format!("-I{shown}/include"),
            format!("-Wl,-rpath,{shown}"),
            "-lm".to_owned(),
        ];
        let source = include_str!("../programs/mujoco_run.c");
        let remedy = "it needs the headers of the Python package mujoco";
        Ok(Self {
            place,
            program: place.build("mujoco_run", source, remedy, &arguments)?,
        })
    }

    /// Every trial, with either form of the servo; but for the cone at MuJoCo's defaults. Figures: `speed` (simulated s per s of processor time),
    /// `depth_mean_mm`, `depth_worst_mm`, `tracking_rms_rad`, `contacts_per_step`, and what it ran with: `version`, `solver`,
    /// `iterations`, `cone`, `integrator`.
    ///
    /// # Errors
    /// When the program fails.
    pub fn run(&self, time_step_s: f64, servo: Servo, cone: Cone) -> Result<Report, PeerError> {
        let step = time_step_s.to_string();
        let cone = match cone {
            Cone::Pyramidal => "0",
            Cone::Elliptic => "1",
        };
        let args = [model_file(servo), &step, cone, "trials.bin"];
        self.place.report(&self.program, &args, "mujoco.bin")
    }

    /// Largest relative energy drift of a limp robot that turns in the air for 10 s.
    ///
    /// # Errors
    /// When the program fails.
    pub fn energy_drift(&self, time_step_s: f64) -> Result<f64, PeerError> {
        let step = time_step_s.to_string();
        let args = [model_file(Servo::Constraint), &step, "energy"];
        let text = self.place.say(&self.program, &args)?;
        Ok(figures(&text).first().map_or(f64::NAN, |(_, v)| *v))
    }
}

/// ODE with its own hinges, motors and contacts.
#[derive(Debug)]
pub struct Ode<'a> {
    place: &'a Workplace,
    program: PathBuf,
}

impl<'a> Ode<'a> {
    /// Builds our program against the system's ODE.
    ///
    /// # Errors
    /// No ODE, no C compiler.
    pub fn build(place: &'a Workplace) -> Result<Self, PeerError> {
        let source = include_str!("../programs/ode_run.c");
        let remedy = "it needs ODE (Debian: libode-dev)";
        let libraries = ["-lode".to_owned(), "-lm".to_owned()];
        Ok(Self {
            place,
            program: place.build("ode_run", source, remedy, &libraries)?,
        })
    }

    /// Every trial; `stepper` is `step` or `quick`.
    ///
    /// # Errors
    /// When the program fails.
    pub fn run(&self, time_step_s: f64, stepper: &str) -> Result<Report, PeerError> {
        let step = time_step_s.to_string();
        let args = ["robot.txt", &step, stepper, "trials.bin"];
        self.place.report(&self.program, &args, "ode.bin")
    }
}

fn trial_bytes(params: &Params, trials: &[Trial]) -> Vec<u8> {
    let mut out = Vec::new();
    for n in [trials.len(), TICKS, JOINTS] {
        out.extend((n as i32).to_le_bytes());
    }
    for j in params.joints.iter().take(JOINTS) {
        for x in [j.gain_per_s, j.max_speed_rad_s, j.max_torque_nm] {
            out.extend(x.to_le_bytes());
        }
    }
    for trial in trials {
        for x in set_points(trial) {
            out.extend(x.to_le_bytes());
        }
    }
    out
}

fn robot_text(params: &Params) -> String {
    let raw = params.robot.raw();
    let rigid = mjcf::rigid_bodies(params);
    let mut out = String::new();
    let _ = writeln!(
        out,
        "{} {} {} {}",
        params.cfm,
        params.erp,
        params.friction,
        raw.bodies.len()
    );
    let mut list = |values: &[f64]| {
        for v in values {
            let _ = write!(out, "{v} ");
        }
        out.push('\n');
    };
    for (b, r) in raw.bodies.iter().zip(&rigid) {
        list(&[b.parent.map_or(-1.0, |p| p as f64)]);
        list(&b.offset_m);
        list(&b.axis);
        list(&[b.joint.map_or(-1.0, |j| j as f64), r.mass_kg]);
        list(&r.com_m);
        list(&r.inertia_kg_m2);
    }
    list(&[raw.halves.len() as f64]);
    for (h, half) in raw.halves.iter().enumerate() {
        let points = mjcf::surface(&params.robot, h, PER_TURN);
        list(&[half.body as f64]);
        list(&half.centre_m);
        list(&[points.len() as f64]);
        list(&points.into_iter().flatten().collect::<Vec<f64>>());
    }
    out
}
