//! `dataset.toml`: what was recorded, on what, and what is known of it.

use std::collections::BTreeMap;

use super::error::{DatasetError, Warning};
use super::walk::{self, Walk};
use crate::model::{Key, Model, Parameter};

/// What stands on the bench or on the floor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Robot {
    /// One joint on a stand.
    Bench,
    /// Six joints, two modules.
    Metamodule,
}

/// What the set-point column of a bench is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Position, rad or m.
    Position,
    /// Effort, N m or N.
    Effort,
    /// Voltage, V.
    Voltage,
}

/// Rotary (rad, N m, kg m^2) or linear (m, N, kg) bench.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// rad, rad/s, N m.
    Rotary,
    /// m, m/s, N.
    Linear,
}

/// Law of the joint's own controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ControllerKind {
    /// `kp (sp - q)`.
    P,
    /// `kp (sp - q) + ki integral - kd dq`.
    Pid,
    /// `kp kv (sp - q) - kv dq`.
    Cascade,
}

/// What the controller puts out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Output {
    /// Share of the bus voltage, -1..1.
    Duty,
    /// Voltage, V.
    Voltage,
    /// Effort, N m or N.
    Effort,
    /// Velocity, rad/s or m/s.
    Velocity,
}

/// Use of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// May be fitted.
    Fit,
    /// Held out: scored, never fitted.
    Check,
}

/// A value with its relative 1-sigma tolerance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quantity {
    /// Value in the unit of its key.
    pub value: f64,
    /// Relative 1-sigma tolerance; `None` where the file gives none.
    pub tolerance: Option<f64>,
}

/// What is known of the joint's controller. Absent = unknown.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Controller {
    /// Law.
    pub kind: Option<ControllerKind>,
    /// What it puts out.
    pub output: Option<Output>,
    /// Proportional gain, output unit per rad (1/s in a cascade).
    pub kp: Option<Quantity>,
    /// Integral gain.
    pub ki: Option<Quantity>,
    /// Derivative gain.
    pub kd: Option<Quantity>,
    /// Velocity gain of a cascade.
    pub kv: Option<Quantity>,
    /// Largest output.
    pub limit: Option<Quantity>,
    /// Control period, s.
    pub period_s: Option<Quantity>,
}

/// What is known of a bench. Absent = unknown.
#[derive(Debug, Clone, PartialEq)]
pub struct Bench {
    /// Meaning of the set-point column.
    pub command: Command,
    /// Units of the bench.
    pub motion: Motion,
    /// Inertia at the output, kg m^2 or kg.
    pub inertia: Option<Quantity>,
    /// Amplitude of the gravity effort m g l, N m or N; 0 rad hangs down.
    pub gravity: Option<Quantity>,
    /// Supply voltage, V.
    pub supply_v: Option<Quantity>,
    /// Drive gain, effort per volt.
    pub effort_per_volt: Option<Quantity>,
    /// No-load or limited speed, rad/s or m/s.
    pub max_speed: Option<Quantity>,
    /// Largest effort, N m or N.
    pub max_effort: Option<Quantity>,
    /// The joint's controller.
    pub controller: Controller,
}

impl Default for Bench {
    fn default() -> Self {
        Self {
            command: Command::Position,
            motion: Motion::Rotary,
            inertia: None,
            gravity: None,
            supply_v: None,
            effort_per_volt: None,
            max_speed: None,
            max_effort: None,
            controller: Controller::default(),
        }
    }
}

/// What is known of the overhead camera; each entry optional.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Camera {
    /// Known quantities by key (`height_m`, `yaw_rad`, ...).
    pub quantities: BTreeMap<&'static str, Quantity>,
}

/// One recorded run.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// CSV file, relative to the data set folder.
    pub file: String,
    /// Name of the gait or bench motion.
    pub gait: String,
    /// Use; `None` where the tool may split.
    pub role: Option<Role>,
    /// Folder of silhouettes, if any.
    pub frames: Option<String>,
    /// The bench with this run's overrides applied.
    pub bench: Bench,
}

/// A parsed `dataset.toml`.
#[derive(Debug, Clone, PartialEq)]
pub struct Manifest {
    /// Kind of robot.
    pub robot: Robot,
    /// Free text.
    pub name: String,
    /// Canonical header name -> header name in the CSV files.
    pub signals: BTreeMap<String, String>,
    /// The bench before any override (default for a metamodule).
    pub bench: Bench,
    /// Robot model file, relative; `None` = the shipped model.
    pub model: Option<String>,
    /// Supply voltage of a metamodule without load, V, where it is not that of the model.
    pub supply_v: Option<Quantity>,
    /// Camera, if described.
    pub camera: Option<Camera>,
    /// Runs in file order, at least one.
    pub runs: Vec<Run>,
}

impl Manifest {
    /// Number of joints: 1 for a bench, 6 for a metamodule.
    #[must_use]
    pub fn joints(&self) -> usize {
        match self.robot {
            Robot::Bench => 1,
            Robot::Metamodule => 6,
        }
    }

    /// `model` with what the data set states of its robot. A value without a tolerance keeps the model's relative one.
    #[must_use]
    pub fn stated(&self, model: &Model) -> Model {
        let mut out = model.clone();
        if let Some(supply) = self.supply_v {
            let own = model.parameter(Key::SupplyVoltage);
            let relative = supply.tolerance.unwrap_or(own.tolerance / own.value);
            let parameter = Parameter {
                value: supply.value,
                tolerance: relative * supply.value,
                source: "dataset.toml".to_owned(),
            };
            // The reader has held the value to the range of the key.
            let _ = out.set_parameter(Key::SupplyVoltage, parameter);
        }
        out
    }

    /// Parses the text of `dataset.toml`. `file` is only used in messages.
    ///
    /// # Errors
    /// The first key that is missing, of a wrong type or out of range, with its line.
    pub fn parse(file: &str, text: &str) -> Result<(Self, Vec<Warning>), DatasetError> {
        let table = walk::parse(file, text)?;
        let root = Walk::new(file, text, "", &table);
        let mut warnings = Vec::new();
        root.number("format", 1.0, 1.0)?
            .ok_or_else(|| root.missing("format", "write `format = 1`"))?;
        let robots = [("bench", Robot::Bench), ("metamodule", Robot::Metamodule)];
        let robot = root.word("robot", &robots)?.ok_or_else(|| {
            root.missing(
                "robot",
                "write `robot = \"bench\"` or `robot = \"metamodule\"`",
            )
        })?;
        let name = root.text("name")?.unwrap_or("unnamed").to_string();
        let signals = match root.table("signals")? {
            Some(t) => t.pairs()?.into_iter().collect(),
            None => BTreeMap::new(),
        };
        let mut bench = Bench::default();
        if let Some(t) = root.table("bench")? {
            apply_bench(&mut bench, &t, &mut warnings)?;
        }
        let (mut model, mut supply_v) = (None, None);
        if let Some(t) = root.table("metamodule")? {
            model = t.path_inside("model")?.map(str::to_string);
            let range = Key::SupplyVoltage.info();
            let stated = t.quantity("supply_v", range.min, range.max, &mut warnings)?;
            supply_v = stated.map(|(value, tolerance)| Quantity { value, tolerance });
            t.finish(&mut warnings);
        }
        let camera = root
            .table("camera")?
            .map(|t| parse_camera(&t, &mut warnings))
            .transpose()?;
        let mut runs = Vec::new();
        for t in root.tables("run")? {
            runs.push(parse_run(&t, &bench, &mut warnings)?);
        }
        if runs.is_empty() {
            return Err(root.missing("run", "list each CSV file under [[run]]"));
        }
        root.finish(&mut warnings);
        Ok((
            Self {
                robot,
                name,
                signals,
                bench,
                model,
                supply_v,
                camera,
                runs,
            },
            warnings,
        ))
    }
}

fn parse_run(
    t: &Walk<'_, '_>,
    bench: &Bench,
    warnings: &mut Vec<Warning>,
) -> Result<Run, DatasetError> {
    let file = t
        .path_inside("file")?
        .ok_or_else(|| t.missing("file", "name the CSV file of the run"))?;
    let gait = t.text("gait")?.unwrap_or(file);
    let role = t.word("role", &[("fit", Role::Fit), ("check", Role::Check)])?;
    let frames = t.path_inside("frames")?.map(str::to_string);
    let mut bench = bench.clone();
    if let Some(o) = t.table("bench")? {
        apply_bench(&mut bench, &o, warnings)?;
    }
    t.finish(warnings);
    Ok(Run {
        file: file.into(),
        gait: gait.into(),
        role,
        frames,
        bench,
    })
}

/// Limits of the numbers, for the reader and the schema.
pub(crate) mod bounds {
    /// Upper bound: far above any joint, low enough to catch a wrong power of ten in a unit.
    pub(crate) const HIGH: f64 = 1e7;
    /// Smallest positive value that still makes sense for an inertia, a voltage or a speed.
    pub(crate) const POSITIVE: f64 = 1e-9;
    /// Shortest control period, s.
    pub(crate) const PERIOD_S: f64 = 1e-6;
    /// Camera numbers lie within this of zero, in the unit of their key.
    pub(crate) const CAMERA_LIMIT: f64 = 1e6;
    /// What may be known of a camera.
    pub(crate) const CAMERA_KEYS: [&str; 9] = [
        "height_m",
        "x_m",
        "y_m",
        "yaw_rad",
        "width_px",
        "height_px",
        "focal_px",
        "rate_hz",
        "clock_offset_s",
    ];
}
use bounds::{CAMERA_KEYS, CAMERA_LIMIT, HIGH, PERIOD_S, POSITIVE};

fn parse_camera(t: &Walk<'_, '_>, warnings: &mut Vec<Warning>) -> Result<Camera, DatasetError> {
    let mut quantities = BTreeMap::new();
    for key in CAMERA_KEYS {
        if let Some((value, tolerance)) = t.quantity(key, -CAMERA_LIMIT, CAMERA_LIMIT, warnings)? {
            quantities.insert(key, Quantity { value, tolerance });
        }
    }
    t.finish(warnings);
    Ok(Camera { quantities })
}

/// Reads one quantity into `slot`; an override without a tolerance keeps the one that stood there.
fn set(
    slot: &mut Option<Quantity>,
    t: &Walk<'_, '_>,
    keys: &[&'static str],
    low: f64,
    warnings: &mut Vec<Warning>,
) -> Result<(), DatasetError> {
    for key in keys {
        if let Some((value, tolerance)) = t.quantity(key, low, HIGH, warnings)? {
            let tolerance = tolerance.or(slot.and_then(|q| q.tolerance));
            *slot = Some(Quantity { value, tolerance });
        }
    }
    Ok(())
}

fn apply_bench(
    bench: &mut Bench,
    t: &Walk<'_, '_>,
    warnings: &mut Vec<Warning>,
) -> Result<(), DatasetError> {
    let commands = [
        ("position", Command::Position),
        ("effort", Command::Effort),
        ("voltage", Command::Voltage),
    ];
    if let Some(c) = t.word("command", &commands)? {
        bench.command = c;
    }
    if let Some(m) = t.word(
        "motion",
        &[("rotary", Motion::Rotary), ("linear", Motion::Linear)],
    )? {
        bench.motion = m;
    }
    set(
        &mut bench.inertia,
        t,
        &["inertia_kg_m2", "mass_kg"],
        POSITIVE,
        warnings,
    )?;
    set(
        &mut bench.gravity,
        t,
        &["gravity_nm", "gravity_n"],
        -HIGH,
        warnings,
    )?;
    set(&mut bench.supply_v, t, &["supply_v"], POSITIVE, warnings)?;
    set(
        &mut bench.effort_per_volt,
        t,
        &["effort_per_volt"],
        POSITIVE,
        warnings,
    )?;
    set(
        &mut bench.max_speed,
        t,
        &["max_speed_rad_s", "max_speed_m_s"],
        POSITIVE,
        warnings,
    )?;
    set(
        &mut bench.max_effort,
        t,
        &["max_effort_nm", "max_effort_n"],
        POSITIVE,
        warnings,
    )?;
    if let Some(c) = t.table("controller")? {
        apply_controller(&mut bench.controller, &c, warnings)?;
    }
    t.finish(warnings);
    Ok(())
}

fn apply_controller(
    c: &mut Controller,
    t: &Walk<'_, '_>,
    warnings: &mut Vec<Warning>,
) -> Result<(), DatasetError> {
    let kinds = [
        ("p", ControllerKind::P),
        ("pid", ControllerKind::Pid),
        ("cascade", ControllerKind::Cascade),
    ];
    c.kind = t.word("kind", &kinds)?.or(c.kind);
    let outputs = [
        ("duty", Output::Duty),
        ("voltage", Output::Voltage),
        ("effort", Output::Effort),
        ("velocity", Output::Velocity),
    ];
    c.output = t.word("output", &outputs)?.or(c.output);
    set(&mut c.kp, t, &["kp"], 0.0, warnings)?;
    set(&mut c.ki, t, &["ki"], 0.0, warnings)?;
    set(&mut c.kd, t, &["kd"], 0.0, warnings)?;
    set(&mut c.kv, t, &["kv"], 0.0, warnings)?;
    set(&mut c.limit, t, &["limit"], POSITIVE, warnings)?;
    set(&mut c.period_s, t, &["period_s"], PERIOD_S, warnings)?;
    t.finish(warnings);
    Ok(())
}
