//! Speed and quality of this engine beside MuJoCo on the same robot, gaits and time step, on one core.

use crate::foreign::{Cone, Mujoco, PeerError};
use crate::gaits::with_effects;
use crate::track::{JOINTS, TICKS};
use physics::mjcf::Servo;
use physics::{
    Body, JointDrive, Level, Options, Outcome, Params, Pose, Probe, Stage, Trial, Twist, run_at,
    run_probed,
};
use std::sync::Arc;
use std::time::Instant;

/// Trials that MuJoCo and scalar code run; they need a hundred times longer for each.
pub const MUJOCO_TRIALS: usize = 16;
/// Gauss-Seidel sweeps of the engine's default.
const SWEEPS: u32 = 12;

/// How well a run did what it was asked, so that speeds are compared at equal quality.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Mean depth of the contact points, mm.
    pub depth_mean_mm: f64,
    /// Deepest contact point, mm.
    pub depth_worst_mm: f64,
    /// Root mean square of set-point minus joint angle at the ticks, rad.
    pub tracking_rms_rad: f64,
    /// Largest relative deviation of a limp robot's energy in the air over 10 s; not measured with effects, which take energy out.
    pub energy_drift: Option<f64>,
}

/// One engine in one setting.
#[derive(Clone, Debug, PartialEq)]
pub struct SpeedRow {
    /// Engine and setting.
    pub name: String,
    /// Simulated seconds per second of processor time.
    pub speed: f64,
    /// Speed over that of MuJoCo's fastest form at this time step; none without MuJoCo.
    pub ratio: Option<f64>,
    /// Quality of the same run.
    pub quality: Quality,
}

/// All engines at one time step.
#[derive(Clone, Debug, PartialEq)]
pub struct SpeedTable {
    /// Time step, s.
    pub time_step_s: f64,
    /// MuJoCo first, when present.
    pub rows: Vec<SpeedRow>,
    /// Levels that this processor lacks.
    pub missing: Vec<Level>,
}

/// Runs all engines at one time step.
///
/// # Errors
/// When MuJoCo's program fails.
pub fn speed_table(
    params: &Arc<Params>,
    trials: &[Trial],
    time_step_s: f64,
    mujoco: Option<&Mujoco<'_>>,
) -> Result<SpeedTable, PeerError> {
    let mut rows = Vec::new();
    if let Some(mujoco) = mujoco {
        rows = mujoco_rows(mujoco, time_step_s)?;
    }
    let fastest = rows.iter().map(|row| row.speed).reduce(f64::max);
    let energy = energy_drift(params, time_step_s);
    let mut missing = Vec::new();
    for level in [Level::Avx512, Level::Avx2, Level::Sse2, Level::Scalar] {
        if !level.available() {
            missing.push(level);
            continue;
        }
        let count = if level.lanes() == 1 {
            trials.len().min(MUJOCO_TRIALS)
        } else {
            trials.len()
        };
        let trials = trials.get(..count).unwrap_or_default();
        let name = format!("ours, {}", level_name(level));
        rows.push(measured(&name, trials, level, time_step_s, Some(energy)));
        let name = format!("ours, {}, eight effects on", level_name(level));
        let rich = with_effects(trials);
        rows.push(measured(&name, &rich, level, time_step_s, None));
    }
    for row in &mut rows {
        row.ratio = fastest.map(|mujoco| row.speed / mujoco);
    }
    Ok(SpeedTable {
        time_step_s,
        rows,
        missing,
    })
}

fn level_name(level: Level) -> String {
    match level {
        Level::Reference => "scalar f64".to_owned(),
        Level::Scalar => "scalar f32".to_owned(),
        Level::Sse2 => "SSE2, 4 lanes".to_owned(),
        Level::Avx2 => "AVX2, 8 lanes".to_owned(),
        Level::Avx512 => "AVX-512, 16 lanes".to_owned(),
    }
}

/// The servo as the exact constraint and as MuJoCo's own actuator, with the round cone and with MuJoCo's default pyramid.
fn mujoco_rows(mujoco: &Mujoco<'_>, h: f64) -> Result<Vec<SpeedRow>, PeerError> {
    let drift = mujoco.energy_drift(h)?;
    let mut rows = Vec::new();
    for (servo, cone) in [
        (Servo::Constraint, Cone::Elliptic),
        (Servo::Actuator, Cone::Elliptic),
        (Servo::Actuator, Cone::Pyramidal),
    ] {
        let report = mujoco.run(h, servo, cone)?;
        let form = match servo {
            Servo::Constraint => "servo as constraint",
            Servo::Actuator => "velocity actuator",
        };
        let named = |name: &str, words: &[&str]| -> String {
            let at = report.figure(name) as usize;
            words
                .get(at)
                .map_or_else(|| format!("{name} {at}"), |word| (*word).to_owned())
        };
        // MuJoCo's own numbering of its options (mjmodel.h).
        let solver = named("solver", &["PGS", "CG", "Newton"]);
        let cone = named("cone", &["pyramidal", "elliptic"]);
        let integrator = named("integrator", &["Euler", "RK4", "implicit", "implicitfast"]);
        let version = version(report.figure("version") as u32);
        let iterations = report.figure("iterations");
        rows.push(SpeedRow {
            name: format!(
                "MuJoCo {version}, {form} ({solver}, {iterations} iterations, {cone} cone, {integrator})"
            ),
            speed: report.figure("speed"),
            ratio: None,
            quality: Quality {
                depth_mean_mm: report.figure("depth_mean_mm"),
                depth_worst_mm: report.figure("depth_worst_mm"),
                tracking_rms_rad: report.figure("tracking_rms_rad"),
                energy_drift: Some(drift).filter(|_| servo == Servo::Constraint),
            },
        });
    }
    Ok(rows)
}

/// MuJoCo 4 counts major, minor and patch in thousands, earlier ones in tens.
fn version(number: u32) -> String {
    let base = if number >= 1_000_000 { 1000 } else { 10 };
    let [major, minor, patch] = [number / base / base, number / base % base, number % base];
    format!("{major}.{minor}.{patch}")
}

fn measured(
    name: &str,
    trials: &[Trial],
    level: Level,
    time_step_s: f64,
    energy_drift: Option<f64>,
) -> SpeedRow {
    let options = Options {
        time_step_s,
        sweeps: SWEEPS,
        ..Options::default()
    };
    let start_s = cpu_s();
    let out: Vec<Outcome> = run_at(level, trials, &options).expect("valid trials");
    let spent_s = cpu_s() - start_s;
    let n = trials.len() as f64;
    let mean = |f: &dyn Fn(&Outcome) -> f64| out.iter().map(f).sum::<f64>() / n;
    let worst_m = out.iter().map(|o| o.penetration_m.1).fold(0.0, f64::max);
    SpeedRow {
        name: name.to_owned(),
        speed: n * TICKS as f64 / 20.0 / spent_s,
        ratio: None,
        quality: Quality {
            depth_mean_mm: 1e3 * mean(&|o| o.penetration_m.0),
            depth_worst_mm: 1e3 * worst_m,
            tracking_rms_rad: mean(&|o| o.tracking_rms_rad * o.tracking_rms_rad).sqrt(),
            energy_drift,
        },
    }
}

/// Largest relative drift of the energy of a limp robot that turns in the air without gravity, over 10 s, in double precision.
fn energy_drift(params: &Arc<Params>, h: f64) -> f64 {
    let weightless = Params {
        gravity_m_s2: [0.0; 3],
        ..(**params).clone()
    };
    let options = Options {
        time_step_s: h,
        ..Options::default()
    };
    let mut body = Body::new(Arc::new(weightless), &options).expect("valid step");
    let high = Pose {
        position_m: [0.0, 0.0, 100.0],
        quaternion: [1.0, 0.0, 0.0, 0.0],
    };
    let twist = Twist {
        linear_m_s: [0.3, 0.0, 0.0],
        angular_rad_s: [1.0, -2.0, 1.5],
    };
    let angles = [0.3, -0.5, 0.7, -0.2, 0.4, 0.1];
    body.place(&high, &twist, &angles, &[2.0, -1.0, 1.5, -2.0, 1.0, 0.5])
        .expect("six joints");
    let (start, _) = body.energy_j();
    let mut worst: f64 = 0.0;
    for _ in 0..(10.0 / h) as u32 {
        body.step(&[JointDrive::Torque { nm: 0.0 }; JOINTS]);
        worst = worst.max((body.energy_j().0 - start).abs() / start);
    }
    worst
}

/// What one stage of a step costs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Share {
    /// The stage.
    pub stage: Stage,
    /// Its share of all, 0 to 1.
    pub share: f64,
    /// Wall clock time per trial and step, the clock's own included, ns.
    pub ns_per_step: f64,
}

/// No stage takes this long, s (the longest takes tens of microseconds): in between, another process had the core.
const PREEMPTED_S: f64 = 0.5e-3;

struct Clock {
    last: Instant,
    spent_s: Vec<(Stage, f64)>,
}

impl Probe for Clock {
    fn ended(&mut self, stage: Stage) {
        let now = Instant::now();
        let dt = (now - self.last).as_secs_f64();
        self.last = now;
        if dt > PREEMPTED_S {
            return;
        }
        match self.spent_s.iter_mut().find(|(s, _)| *s == stage) {
            Some((_, sum)) => *sum += dt,
            None => self.spent_s.push((stage, dt)),
        }
    }
}

/// Where the time of a step goes at the fastest level of this processor, most expensive stage first. On a busy machine only the shares
/// mean something.
#[must_use]
pub fn profile(trials: &[Trial], time_step_s: f64) -> Vec<Share> {
    let options = Options {
        time_step_s,
        ..Options::default()
    };
    let mut clock = Clock {
        last: Instant::now(),
        spent_s: Vec::new(),
    };
    run_probed(trials, &options, &mut clock).expect("valid trials");
    let total_s: f64 = clock.spent_s.iter().map(|(_, s)| s).sum();
    let steps = trials.len() as f64 * TICKS as f64 / 20.0 / options.time_step_s;
    let share = |(stage, spent_s): (Stage, f64)| Share {
        stage,
        share: spent_s / total_s,
        ns_per_step: 1e9 * spent_s / steps,
    };
    let mut shares: Vec<Share> = clock.spent_s.into_iter().map(share).collect();
    shares.sort_by(|a, b| b.share.total_cmp(&a.share));
    shares
}

/// Processor time of this process, s: the machine may be busy with other work. Linux keeps it in nanoseconds; elsewhere the wall clock.
pub(crate) fn cpu_s() -> f64 {
    let spent = std::fs::read_to_string("/proc/self/schedstat")
        .ok()
        .and_then(|t| t.split(' ').next().and_then(|n| n.parse::<f64>().ok()));
    let wall = || {
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        now.map_or(0.0, |d| d.as_secs_f64())
    };
    spent.map_or_else(wall, |ns| ns * 1e-9)
}
