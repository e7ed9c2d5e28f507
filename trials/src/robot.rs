//! Cases for a blind check of a diagnosis: data set folders of a whole emulated robot on the ground, with planted
//! causes.
//!
//! Reality here: Table II's servo on DC motors by this crate's own code (LuGre friction, own play and springs, supply,
//! heat), drivers at 1 kHz, sensors with noise. The body is the physics crate's at 1 ms (0.5 ms with play) with 24
//! sweeps, where the simulator's defaults are 4 ms and 12. The body's equations are therefore shared with the
//! simulator, its time step, solver accuracy and every constant are not. Each case draws masses, friction, bounce,
//! ERP, CFM, gains, limits, motor constants and camera height within their tolerances. So "no effect" is not "no
//! difference". `gravity_load` and the effects of body and connector are the body's own switches.
//!
//! Each gait is recorded three times, with fresh ground friction (2 %), heading, homing error, battery, joint torques
//! and noise.

mod draw;
mod drive;
mod machine;
mod oracle;
mod reality;
mod write;

use std::collections::BTreeMap;

use control::gait::Gait;
use hil_sim::rng::Rng;
use thiserror::Error;

use crate::label::{Cause, Label, Scope, Truth};

pub use draw::{effects, planted};

/// Joints of the robot.
pub(crate) const JOINTS: usize = 6;
/// Bus voltage without load, V: that at which Table I's no-load speeds hold.
pub(crate) const SUPPLY_V: f64 = 12.0;
/// Stated height of the camera, m (Table II, hand tuned).
pub(crate) const CAMERA_HEIGHT_M: f64 = 2.6;
/// Driver ticks (1 ms) between two rows of a recording, and between two set-points.
pub(crate) const SAMPLE_TICKS: u64 = 25;
pub(crate) const SEND_TICKS: u64 = 50;
/// Repeats of each gait.
const REPEATS: usize = 3;

/// Kinds with the upper end of their share.
const KINDS: [(&str, f64); 4] = [
    ("null", 0.25),
    ("single", 0.66),
    ("several", 0.92),
    ("outside", 1.0),
];

/// One planted cause, on one joint or on the robot. A cause that joints share is planted on each of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Planted {
    /// Name of the shared vocabulary, or one that no vocabulary holds.
    pub effect: &'static str,
    /// Joint, where the effect has one.
    pub joint: Option<usize>,
    /// Parameters.
    pub parameters: Vec<(&'static str, f64)>,
    /// Convention faults: whether readings stand in the wrong frame too, or the command alone.
    pub readings_too: bool,
    /// Number of the cause that this is part of, from 0.
    pub cause: usize,
    /// Scope of that cause.
    pub scope: Scope,
}

/// What tells where the robot is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeenBy {
    /// Tracker and inertial sensor.
    Tracker,
    /// The same, and an overhead camera.
    TrackerAndCamera,
    /// An overhead camera alone, as in the paper.
    Camera,
}

impl SeenBy {
    /// Whether a camera films the runs.
    #[must_use]
    pub fn camera(self) -> bool {
        self != Self::Tracker
    }

    /// Whether pose, rate and acceleration of the base are recorded.
    #[must_use]
    pub fn tracker(self) -> bool {
        self != Self::Camera
    }
}

/// What a recording may lack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// The set-points that the drivers applied.
    Echo,
    /// Speeds of the joints.
    Velocity,
    /// Currents of the motors.
    Current,
    /// Duty cycles of the motors.
    Duty,
    /// Voltage of the bus.
    Bus,
    /// Temperatures of the motors.
    Temperature,
    /// Torques of the motors.
    Effort,
    /// Rate gyro and accelerometer of the base.
    Inertial,
    /// Pose of the base.
    Pose,
}

impl Signal {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Echo,
        Self::Velocity,
        Self::Current,
        Self::Duty,
        Self::Bus,
        Self::Temperature,
        Self::Effort,
        Self::Inertial,
        Self::Pose,
    ];

    /// Its name on the command line and in files of suites.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Echo => "echo",
            Self::Velocity => "velocity",
            Self::Current => "current",
            Self::Duty => "duty",
            Self::Bus => "bus",
            Self::Temperature => "temperature",
            Self::Effort => "effort",
            Self::Inertial => "inertial",
            Self::Pose => "pose",
        }
    }

    /// The signal of that name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|s| s.name() == name)
    }
}

/// What a case is made of, all of it drawn from a seed.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Case name.
    pub name: String,
    /// `null`, `single`, `several` or `outside`.
    pub kind: &'static str,
    /// Seed of tolerances, disturbance and noise.
    pub seed: u64,
    /// Causes.
    pub planted: Vec<Planted>,
    /// Who saw the robot move.
    pub seen_by: SeenBy,
    /// What was not recorded.
    pub without: Vec<Signal>,
    /// Length of a run, s.
    pub duration_s: f64,
}

impl Plan {
    /// Numbers of the causes.
    pub(crate) fn causes(&self) -> usize {
        self.planted.iter().map(|p| p.cause + 1).max().unwrap_or(0)
    }

    /// The label of what was planted, which shows so much: chi-square of every cause, and what stays of it.
    fn label(&self, gaits: usize, shown: &[(f64, f64)]) -> Label {
        let causes = shown.iter().enumerate().filter_map(|(k, (full, left))| {
            let parts: Vec<&Planted> = self.planted.iter().filter(|p| p.cause == k).collect();
            let first = parts.first()?;
            let mut values: BTreeMap<String, Truth> = BTreeMap::new();
            for part in &parts {
                for (key, value) in &part.parameters {
                    let truth = values.entry((*key).to_owned()).or_default();
                    if truth.value.is_null() {
                        truth.value = (*value).into();
                    }
                    if let Some(joint) = part.joint {
                        truth.by_joint.insert(joint.to_string(), *value);
                    }
                }
            }
            let off = parts.iter().filter_map(|p| reality::tolerances_off(p));
            Some(Cause {
                effect: first.effect.to_owned(),
                stage: draw::stage(first.effect).to_owned(),
                scope: first.scope,
                joints: parts.iter().filter_map(|p| p.joint).collect(),
                values,
                also: Vec::new(),
                compound: None,
                spread: f64::from(u8::from(parts.len() > 1)),
                readings_too: first.readings_too,
                sigmas: off.reduce(f64::max),
                delta_chi2: *full,
                delta_chi2_refitted: *left,
                delta_chi2_rival: None,
            })
        });
        // Every robot of a suite has its pose where it is tracked: labels do not list it.
        let may_lack = Signal::ALL.iter().filter(|s| **s != Signal::Pose);
        let recorded = may_lack.filter(|s| !self.without.contains(s));
        let columns: Vec<&str> = recorded.map(|s| s.name()).collect();
        Label {
            name: self.name.clone(),
            engine: "emulator".to_owned(),
            kind: self.kind.to_owned(),
            causes: causes.collect(),
            more: [
                ("gaits".to_owned(), gaits.into()),
                ("columns".to_owned(), columns.into()),
            ]
            .into(),
        }
    }
}

/// A case: files of the data set folder, and its label.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// File name and content, relative to the case folder.
    pub files: Vec<(String, Vec<u8>)>,
    /// Label.
    pub label: Label,
}

/// Why a case cannot be made.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RobotCaseError {
    /// No such effect.
    #[error("no effect `{effect}`; see the effect vocabulary in docs/reference/effects.md")]
    UnknownEffect {
        /// Name given.
        effect: String,
    },
    /// A joint is missing or too much.
    #[error("`{effect}` {}", if *per_joint { "acts on one joint: write effect@JOINT, 0 to 5" } else { "has no joint" })]
    Joint {
        /// Effect.
        effect: &'static str,
        /// Whether it has a joint.
        per_joint: bool,
    },
    /// More numbers than parameters.
    #[error("`{effect}` has {most} parameters")]
    TooMany {
        /// Effect.
        effect: &'static str,
        /// Its parameters.
        most: usize,
    },
    /// The physics refuses the parameters, or the robot flies apart.
    #[error("no robot can have these parameters; make the effect smaller")]
    Impossible,
}

/// The plan of case number `index` of the suite `seed`; `index` from 1000 on makes cases without effect only.
#[must_use]
pub fn plan(seed: u64, index: usize) -> Plan {
    plan_anew(seed, index, 0)
}

/// The plan that takes the place of case number `index` where `times` others before it turned out impossible.
pub fn plan_anew(seed: u64, index: usize, times: u32) -> Plan {
    let mut rng = Rng::new(seed, 0xB2 + 0x100 * u64::from(times), index as u64);
    let (kind, planted) = if index >= 1000 {
        ("null", Vec::new())
    } else {
        draw::causes(&mut rng)
    };
    let camera = planted
        .iter()
        .any(|p| p.effect.starts_with("camera") || p.effect == "frame_drop");
    Plan {
        name: format!("robot_{index:04}"),
        kind,
        seed: rng.next_u64(),
        seen_by: if rng.chance(0.25) || camera {
            SeenBy::TrackerAndCamera
        } else {
            SeenBy::Tracker
        },
        planted,
        without: draw::without(&mut rng),
        // Chosen: two cycles of the paper's 0.2 Hz and a bit.
        duration_s: 12.0,
    }
}

/// One run of a robot, as a tracker and a camera saw it: every [`Ride::PERIOD_S`].
#[derive(Clone, Debug, PartialEq)]
pub struct Ride {
    /// Poses of body 3, from t = 0.
    pub base: Vec<physics::Pose>,
    /// Link angles at the same instants, rad.
    pub link_rad: Vec<[f32; JOINTS]>,
}

impl Ride {
    /// Time between two instants, s.
    pub const PERIOD_S: f64 = SAMPLE_TICKS as f64 * 1e-3;
}

/// Plays one gait on the robot of a plan; `run` draws what differs between runs.
///
/// # Errors
/// [`RobotCaseError::Impossible`] for parameters that the physics refuses.
pub fn play(plan: &Plan, gait: &Gait, run: u64) -> Result<Ride, RobotCaseError> {
    let truth =
        reality::Reality::new(plan.seed, &plan.planted).ok_or(RobotCaseError::Impossible)?;
    let mut machine = machine::Machine::new(&truth, gait, Some((plan.seed ^ 0x52, run)))
        .ok_or(RobotCaseError::Impossible)?;
    let track = machine.record((plan.duration_s / Ride::PERIOD_S) as usize + 1);
    Ok(Ride {
        base: track.iter().map(|s| s.base).collect(),
        link_rad: track.iter().map(|s| s.link_rad).collect(),
    })
}

/// Makes a case from its plan, playing each of `gaits`.
///
/// # Errors
/// [`RobotCaseError::Impossible`] for parameters that the physics refuses or with which the robot flies apart.
pub fn case(plan: &Plan, gaits: &[Gait]) -> Result<Case, RobotCaseError> {
    let truth =
        reality::Reality::new(plan.seed, &plan.planted).ok_or(RobotCaseError::Impossible)?;
    let mut files = vec![
        (
            "dataset.toml".to_owned(),
            write::manifest(plan, gaits).into_bytes(),
        ),
        (
            "model.toml".to_owned(),
            reality::stated_model().to_toml().into_bytes(),
        ),
    ];
    for gait in gaits {
        let text = files::gait::to_toml(gait).into_bytes();
        files.push((format!("gaits/{}.toml", gait.name()), text));
    }
    let samples = (plan.duration_s * 1000.0) as usize / SAMPLE_TICKS as usize;
    for (g, gait) in gaits.iter().enumerate() {
        for repeat in 0..REPEATS {
            let run = (plan.seed, (g * REPEATS + repeat) as u64);
            let mut machine =
                machine::Machine::new(&truth, gait, Some(run)).ok_or(RobotCaseError::Impossible)?;
            let track = machine.record(samples);
            if track.iter().any(machine::Sample::is_absurd) {
                return Err(RobotCaseError::Impossible);
            }
            let name = write::run_name(gait, repeat);
            let mut noise = Rng::new(plan.seed, 0x4E, run.1);
            files.push((
                format!("{name}.csv"),
                write::csv(&track, plan, &mut noise).into_bytes(),
            ));
            if plan.seen_by.camera() {
                files.extend(write::film(&truth.camera, &track, &name, &mut noise));
            }
        }
    }
    let shown = oracle::evidence(plan, gaits, &truth).ok_or(RobotCaseError::Impossible)?;
    Ok(Case {
        files,
        label: plan.label(gaits.len(), &shown),
    })
}
