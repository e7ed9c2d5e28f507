//! `scenario.toml`: which motors, which effects, which faults. `docs/reference/scenario.md` describes the format.
//!
//! Pure: the caller reads the file.

mod error;
mod lab;
mod reader;

use std::sync::Arc;

use control::machine::Machine;
use files::model::Model;
use files::structure::{NoMachine, Structure};
use thiserror::Error;
use toml::de::DeTable;

pub use error::{ScenarioError, ScenarioProblem};
pub use lab::StartParams;
use reader::{Source, Table};

use crate::drawn;
use crate::effects;
use crate::fault::{Fault, FaultKind};
use crate::ground::{Ground, Place};
use crate::lab::{Lab, LabParams};
use crate::motor::{JointKind, JointParams, ParamError};
use crate::rng::Rng;
use crate::world::{World, WorldParams};

/// A scenario ready to be run.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// Free text for reports.
    pub name: String,
    /// Motors, drivers, supply, bus and faults.
    pub world: WorldParams,
    /// What the joints carry.
    pub body: BodyKind,
    /// File of the body's model as the scenario names it; the caller reads it into [`Self::model`].
    pub model_file: Option<String>,
    /// Model of the body on the ground; the shipped one until the caller replaces it.
    pub model: Model,
    /// Whether the motors are those of the model ([`drawn::motors_of`]).
    pub motors_of_model: bool,
    /// Where the robot on the ground is put down.
    pub start: StartParams,
    /// What watches the robot on the ground.
    pub lab: LabParams,
    /// The robot as its firmware is built for it.
    pub machine: Machine,
}

/// What the joints carry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BodyKind {
    /// Each joint its own load, in the air ([`World::on_stand`]).
    Stand,
    /// The whole robot, lying on the ground at home ([`Ground`]).
    Ground,
}

/// Why a scenario cannot be built.
#[derive(Debug, Error)]
pub enum BuildError {
    /// A joint that cannot exist, or a step too coarse for it.
    #[error(transparent)]
    Joint(#[from] ParamError),
    /// The shipped body model was refused.
    #[error("the robot on the ground: {0}")]
    Params(#[from] physics::ParamsError),
    /// The body's time step was refused.
    #[error("the robot on the ground: {0}")]
    Body(#[from] physics::RunError),
}

/// Time step of the robot on the ground [s]. Chosen: base path within 5 % of that at 2 ms after 10 s of a gait, a
/// quarter of the simulator's own default step.
const GROUND_STEP_S: f64 = 0.001;

impl Scenario {
    /// The world of this scenario at time 0.
    ///
    /// # Errors
    /// Parameters that a step or the body refuses.
    pub fn build(&self) -> Result<World, BuildError> {
        if self.body == BodyKind::Stand {
            return Ok(World::on_stand(&self.world)?);
        }
        let params = Arc::new(physics::Params::try_from(&self.model)?);
        let options = physics::Options {
            time_step_s: GROUND_STEP_S,
            ..physics::Options::default()
        };
        let mut ground = Ground::new(params, &options)?;
        let mut world = self.motors();
        ground.put_down(&self.place())?;
        let loads = world.joints.iter();
        let sigma_nm: Vec<f64> = loads.map(|joint| joint.load.disturbance_nm).collect();
        ground.disturb(&sigma_nm, world.seed);
        if !self.lab.is_empty() {
            ground.watch(Lab::new(self.lab, world.seed));
        }
        ground.suit(&mut world);
        Ok(World::new(&world, Box::new(ground))?)
    }

    /// The motors as they will be built.
    #[must_use]
    pub fn motors(&self) -> WorldParams {
        let mut world = self.world.clone();
        if self.motors_of_model {
            drawn::motors_of(&self.model, &mut world);
        }
        world
    }

    /// The scenario with other chance, for a repeat; `repeat` 0 is the scenario itself.
    #[must_use]
    pub fn repeat(mut self, repeat: u64) -> Self {
        // Streams are named by a hash of the seed, so near seeds share nothing.
        self.world.seed = self.world.seed.wrapping_add(repeat);
        self
    }

    /// Where this seed puts the robot down.
    fn place(&self) -> Place {
        let StartParams {
            place,
            sigma_m,
            sigma_rad,
        } = self.start;
        let mut rng = Rng::new(self.world.seed, PURPOSE_PLACE, 0);
        let [x, y, yaw] = [sigma_m, sigma_m, sigma_rad].map(|sigma| sigma * rng.normal());
        Place {
            x_m: place.x_m + x,
            y_m: place.y_m + y,
            yaw_rad: place.yaw_rad + yaw,
        }
    }
}

/// Stream number of the place where the robot is put down.
const PURPOSE_PLACE: u64 = 0xD4;

/// Longest file. Chosen: a thousand times what a scenario needs.
const MAX_BYTES: usize = 1 << 20;
/// The only format so far.
const FORMAT: u64 = 1;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Motor {
    Catalogue,
    Neutral,
    Model,
}

#[derive(Clone, Copy)]
enum Robot {
    Metamodule,
    Bench,
}

/// Reads a scenario. `file` is its name in messages. An empty file is six catalogue motors without faults.
///
/// # Errors
/// The first thing wrong, with its line.
pub fn parse(file: &str, text: &str) -> Result<Scenario, ScenarioError> {
    let source = Source { file, text };
    if text.len() > MAX_BYTES {
        let problem = ScenarioProblem::TooLong {
            bytes: text.len(),
            limit: MAX_BYTES,
        };
        return Err(source.error(0, problem));
    }
    let table = DeTable::parse(text).map_err(|error| {
        let at = error.span().map_or(0, |span| span.start);
        source.error(at, ScenarioProblem::Syntax(error))
    })?;
    let mut top = Table::new(source, table.get_ref(), "the file".to_owned(), 0);
    if let Some(format) = top.whole("format", FORMAT)?
        && format != FORMAT
    {
        let problem = ScenarioProblem::OutOfRange {
            key: "format".to_owned(),
            value: format as f64,
            min: 1.0,
            max: 1.0,
        };
        return Err(source.error(0, problem));
    }
    let name = top
        .text("name")?
        .map_or_else(String::new, |(name, _)| name.to_owned());
    let seed = top.whole("seed", u64::MAX)?.unwrap_or(1);
    let (mut world, motors_of_model) = motors(&mut top, seed)?;
    let body = body(&mut top, world.joints.len())?;
    let on_ground = body == BodyKind::Ground;
    let model_file = model_file(&mut top, on_ground)?;
    if motors_of_model && !on_ground {
        let problem = ScenarioProblem::KeyNeedsGround {
            key: "motor = \"model\"",
        };
        return Err(source.error(0, problem));
    }
    let (start, lab) = lab::read(&mut top, on_ground)?;
    bus(&mut top, &mut world)?;
    stand(&mut top, &mut world)?;
    drivers(&mut top, &mut world)?;
    noise(&mut top, &mut world)?;
    if let Some(table) = top.table("effect")? {
        effect_tables(&table, &mut world)?;
    }
    for table in top.tables("fault")? {
        let fault = fault(table, world.joints.len())?;
        world.faults.push(fault);
    }
    top.finish()?;
    for setup in &world.joints {
        setup
            .joint
            .validate()
            .map_err(|error| source.error(0, error.into()))?;
    }
    Ok(Scenario {
        name,
        world,
        body,
        model_file,
        model: Model::hand_tuned(),
        motors_of_model,
        start,
        lab,
        machine: Machine::default(),
    })
}

/// The robot of a `robot.toml` on stands: catalogue motors without faults, one for each of its joints, on drivers of ours.
///
/// # Errors
/// It is no robot that the firmware drives.
pub fn of_structure(structure: &Structure) -> Result<Scenario, NoMachine> {
    let machine = structure.machine()?;
    let mut kinds: Vec<(usize, JointKind)> = Vec::new();
    for hinge in structure.bodies.iter().flatten() {
        match hinge.motor {
            files::structure::Motor::Intra => kinds.push((hinge.joint, JointKind::Intra)),
            files::structure::Motor::Inter => kinds.push((hinge.joint, JointKind::Inter)),
            files::structure::Motor::Connector => {}
        }
    }
    kinds.sort_unstable_by_key(|(joint, _)| *joint);
    let joints: Vec<JointParams> = kinds
        .into_iter()
        .map(|(_, kind)| kind.catalogue_joint())
        .collect();
    Ok(Scenario {
        name: structure.name.clone(),
        world: WorldParams::of(1, &joints),
        body: BodyKind::Stand,
        model_file: None,
        model: Model::hand_tuned(),
        motors_of_model: false,
        start: StartParams::default(),
        lab: LabParams::default(),
        machine,
    })
}

/// The body's model file.
fn model_file(top: &mut Table<'_>, on_ground: bool) -> Result<Option<String>, ScenarioError> {
    let Some((file, start)) = top.text("model")? else {
        return Ok(None);
    };
    if !on_ground {
        return Err(top.error(start, ScenarioProblem::KeyNeedsGround { key: "model" }));
    }
    Ok(Some(file.to_owned()))
}

/// The motors, and whether the model is to make them over.
fn motors(top: &mut Table<'_>, seed: u64) -> Result<(WorldParams, bool), ScenarioError> {
    let robot = top.word(
        "robot",
        &[("metamodule", Robot::Metamodule), ("bench", Robot::Bench)],
    )?;
    let words = [
        ("catalogue", Motor::Catalogue),
        ("neutral", Motor::Neutral),
        ("model", Motor::Model),
    ];
    let motor = top.word("motor", &words)?.unwrap_or(Motor::Catalogue);
    let make: fn(JointKind) -> JointParams = match motor {
        Motor::Catalogue | Motor::Model => JointKind::catalogue_joint,
        Motor::Neutral => JointKind::neutral,
    };
    let kind = top.word(
        "kind",
        &[("intra", JointKind::Intra), ("inter", JointKind::Inter)],
    )?;
    let mut world = match robot.unwrap_or(Robot::Metamodule) {
        Robot::Metamodule => WorldParams::metamodule(seed, make),
        Robot::Bench => WorldParams::bench(seed, make(kind.unwrap_or(JointKind::Intra))),
    };
    if let Some(step_us) = top.number("step_us", 1.0, 1_000.0)? {
        world.step_ns = (step_us * 1e3) as u64;
    }
    Ok((world, motor == Motor::Model))
}

fn body(top: &mut Table<'_>, joints: usize) -> Result<BodyKind, ScenarioError> {
    let mut words = vec![("stand", BodyKind::Stand)];
    // A bench joint is no robot.
    if joints == JointKind::METAMODULE.len() {
        words.push(("ground", BodyKind::Ground));
    }
    Ok(top.word("body", &words)?.unwrap_or(BodyKind::Stand))
}

fn bus(top: &mut Table<'_>, world: &mut WorldParams) -> Result<(), ScenarioError> {
    let Some(mut table) = top.table("bus")? else {
        return Ok(());
    };
    if let Some(baud) = table.whole("baud", 10_000_000)? {
        world.bus.baud = (baud as u32).max(1_200);
    }
    if let Some(echo) = table.flag("echo")? {
        world.bus.echo = echo;
    }
    if let Some(delay_us) = table.number("return_delay_us", 0.0, 508.0)? {
        for setup in &mut world.joints {
            setup.driver.return_delay_ns = (delay_us * 1e3) as u64;
        }
    }
    table.finish()
}

fn stand(top: &mut Table<'_>, world: &mut WorldParams) -> Result<(), ScenarioError> {
    let Some(mut table) = top.table("stand")? else {
        return Ok(());
    };
    let inertia = table.number("inertia_kg_m2", 1e-6, 10.0)?;
    let gravity = table.number("gravity_nm", 0.0, 100.0)?;
    let hang = table.number("hang_deg", -360.0, 360.0)?;
    for setup in &mut world.joints {
        let load = &mut setup.load;
        load.inertia_kg_m2 = inertia.unwrap_or(load.inertia_kg_m2);
        load.gravity_nm = gravity.unwrap_or(load.gravity_nm);
        load.hang_rad = hang.map_or(load.hang_rad, f64::to_radians);
    }
    table.finish()
}

fn drivers(top: &mut Table<'_>, world: &mut WorldParams) -> Result<(), ScenarioError> {
    if let Some(mut table) = top.table("control")? {
        let kp = table.number("kp_1_s", 0.0, 1_000.0)?;
        let kv = table.number("kv_s_rad", 0.0, 100.0)?;
        let ki = table.number("ki_1_rad_s", 0.0, 10_000.0)?;
        let duty = table.number("duty_limit", 0.0, 1.0)?;
        for setup in &mut world.joints {
            let control = &mut setup.driver.control;
            control.kp_1_s = kp.unwrap_or(control.kp_1_s);
            control.kv_s_rad = kv.unwrap_or(control.kv_s_rad);
            control.ki_1_rad_s = ki.unwrap_or(control.ki_1_rad_s);
            control.duty_limit = duty.unwrap_or(control.duty_limit);
        }
        table.finish()?;
    }
    if let Some(mut table) = top.table("guard")? {
        let overheat = table.number("overheat_c", 0.0, 100.0)?;
        let undervolt = table.number("undervolt_v", 3.1, 16.0)?;
        let overvolt = table.number("overvolt_v", 3.1, 16.8)?;
        let brownout = table.number("brownout_v", 0.0, 16.0)?;
        let overload = table.number("overload_s", 0.01, 1e9)?;
        for setup in &mut world.joints {
            let guard = &mut setup.driver.guard;
            guard.overheat_c = overheat.unwrap_or(guard.overheat_c);
            guard.undervolt_v = undervolt.unwrap_or(guard.undervolt_v);
            guard.overvolt_v = overvolt.unwrap_or(guard.overvolt_v);
            guard.brownout_v = brownout.unwrap_or(guard.brownout_v);
            guard.overload_s = overload.unwrap_or(guard.overload_s);
        }
        table.finish()?;
    }
    Ok(())
}

fn noise(top: &mut Table<'_>, world: &mut WorldParams) -> Result<(), ScenarioError> {
    let Some(mut table) = top.table("noise")? else {
        return Ok(());
    };
    let disturbance = table.number("disturbance_nm", 0.0, 10.0)?;
    let current = table.number("current_a", 0.0, 1.0)?;
    let voltage = table.number("voltage_v", 0.0, 1.0)?;
    for setup in &mut world.joints {
        setup.load.disturbance_nm = disturbance.unwrap_or(setup.load.disturbance_nm);
        setup.driver.noise.current_a = current.unwrap_or(setup.driver.noise.current_a);
        setup.driver.noise.voltage_v = voltage.unwrap_or(setup.driver.noise.voltage_v);
    }
    table.finish()
}

/// `[effect.NAME]` for all joints, then `[effect.NAME.joint_K]` for one.
fn effect_tables(all: &Table<'_>, world: &mut WorldParams) -> Result<(), ScenarioError> {
    for (name, _, value) in all.entries() {
        let table = all.inner(name, value)?;
        let (joints, plain): (Vec<_>, Vec<_>) = table
            .entries()
            .into_iter()
            .partition(|(key, _, _)| key.starts_with("joint_"));
        for (key, start, value) in plain {
            let number = table.as_number(key, value)?;
            effects::set(world, name, None, key, number)
                .map_err(|error| table.error(start, error.into()))?;
        }
        for (key, start, value) in joints {
            let Ok(joint) = key.trim_start_matches("joint_").parse() else {
                let problem = ScenarioProblem::WrongType {
                    key: key.to_owned(),
                    expected: "joint_0 to joint_5",
                };
                return Err(table.error(start, problem));
            };
            let inner = table.inner(key, value)?;
            for (key, start, value) in inner.entries() {
                let number = inner.as_number(key, value)?;
                effects::set(world, name, Some(joint), key, number)
                    .map_err(|error| inner.error(start, error.into()))?;
            }
        }
    }
    Ok(())
}

/// Kinds without a parameter of their own.
const PLAIN_FAULTS: [(&str, FaultKind); 13] = [
    ("byte_loss", FaultKind::ByteLoss),
    ("corruption", FaultKind::Corruption),
    ("request_loss", FaultKind::RequestLoss),
    ("reply_loss", FaultKind::ReplyLoss),
    ("reply_delay", FaultKind::ReplyDelay { delay_s: 0.0 }),
    ("missing", FaultKind::Missing),
    ("babble", FaultKind::Babble),
    ("stuck_encoder", FaultKind::StuckEncoder),
    ("encoder_jump", FaultKind::EncoderJump { jump_rad: 0.0 }),
    ("stall", FaultKind::Stall),
    ("brown_out", FaultKind::BrownOut { ratio: 1.0 }),
    ("reset", FaultKind::Reset),
    ("duplicate_id", FaultKind::DuplicateId { id: 0 }),
];

fn fault(mut table: Table<'_>, joints: usize) -> Result<Fault, ScenarioError> {
    let kind = table
        .word("kind", &PLAIN_FAULTS)?
        .ok_or_else(|| table.missing("kind"))?;
    let kind = match kind {
        FaultKind::ReplyDelay { .. } => FaultKind::ReplyDelay {
            delay_s: needed(&mut table, "delay_s", 0.0, 10.0)?,
        },
        FaultKind::EncoderJump { .. } => FaultKind::EncoderJump {
            jump_rad: needed(&mut table, "jump_rad", -100.0, 100.0)?,
        },
        FaultKind::BrownOut { .. } => FaultKind::BrownOut {
            ratio: needed(&mut table, "ratio", 0.0, 2.0)?,
        },
        FaultKind::DuplicateId { .. } => FaultKind::DuplicateId {
            id: needed(&mut table, "id", 0.0, 252.0)? as u8,
        },
        plain => plain,
    };
    let mut fault = Fault::always(kind);
    fault.joint = table
        .whole("joint", joints.saturating_sub(1) as u64)?
        .map(|joint| joint as usize);
    fault.from_s = table.number("from_s", 0.0, 1e9)?.unwrap_or(0.0);
    fault.to_s = table.number("to_s", 0.0, 1e9)?.unwrap_or(f64::INFINITY);
    fault.probability = table.number("probability", 0.0, 1.0)?.unwrap_or(1.0);
    if fault.to_s <= fault.from_s {
        return Err(table.error(table.start(), ScenarioProblem::EmptyWindow));
    }
    table.finish()?;
    Ok(fault)
}

fn needed(
    table: &mut Table<'_>,
    key: &'static str,
    min: f64,
    max: f64,
) -> Result<f64, ScenarioError> {
    table
        .number(key, min, max)?
        .ok_or_else(|| table.missing(key))
}
