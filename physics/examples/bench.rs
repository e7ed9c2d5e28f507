//! Speed and quality of this engine beside MuJoCo on the same robot, gaits and time step, on one core, in one run.
//!
//! `cargo run --release -p physics --example bench [TRIALS]`; MuJoCo needs cc and target/venv with mujoco. TRIALS defaults to 64.
#![allow(clippy::print_stdout)]

#[path = "../tests/common/mod.rs"]
mod common;
#[path = "../validation/tools.rs"]
mod tools;

use files::model::{Effect, Model};
use physics::mjcf::Servo;
use physics::{
    Body, JointDrive, Level, Options, Outcome, Params, Pose, Probe, Stage, Trial, Twist, run_probed,
};
use std::sync::Arc;
use std::time::Instant;
use tools::{Bench, JOINTS, TICKS};

/// Trials that MuJoCo runs; it needs some seconds for each.
const MUJOCO_TRIALS: usize = 16;

struct Row {
    name: String,
    speed: f64,
    depth_mean_mm: f64,
    depth_worst_mm: f64,
    tracking_rad: f64,
    energy: f64,
}

fn measured(name: &str, trials: &[Trial], level: Level, h: f64, sweeps: u32) -> Row {
    let options = Options {
        time_step_s: h,
        sweeps,
        ..Options::default()
    };
    let start_s = tools::cpu_s();
    let out: Vec<Outcome> = physics::run_at(level, trials, &options).expect("valid trials");
    let spent_s = tools::cpu_s() - start_s;
    let n = trials.len() as f64;
    let mean = |f: &dyn Fn(&Outcome) -> f64| out.iter().map(f).sum::<f64>() / n;
    Row {
        name: name.to_owned(),
        speed: n * TICKS as f64 / 20.0 / spent_s,
        depth_mean_mm: 1e3 * mean(&|o| o.penetration_m.0),
        depth_worst_mm: 1e3 * out.iter().map(|o| o.penetration_m.1).fold(0.0, f64::max),
        tracking_rad: mean(&|o| o.tracking_rms_rad * o.tracking_rms_rad).sqrt(),
        energy: f64::NAN,
    }
}

/// Largest relative drift of the energy of a limp robot that turns in the air without gravity, over 10 s.
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

fn print(row: &Row, mujoco: Option<f64>) {
    let ratio = mujoco.map_or(f64::NAN, |m| row.speed / m);
    let energy = if row.energy.is_nan() {
        "not measured".to_owned()
    } else {
        format!("{:.2} %", 100.0 * row.energy)
    };
    println!(
        "| {} | {:.0} | {ratio:.1} | {:.3} | {:.2} | {:.4} | {energy} |",
        row.name, row.speed, row.depth_mean_mm, row.depth_worst_mm, row.tracking_rad,
    );
}

fn table(bench: &Bench, params: &Arc<Params>, trials: &[Trial], h: f64) {
    println!("\nTime step {} ms\n", h * 1e3);
    println!(
        "| engine | simulated s per s | x MuJoCo | mean penetration [mm] | worst [mm] | tracking RMS [rad] | energy drift 10 s |"
    );
    println!("|---|---|---|---|---|---|---|");
    let mut mujoco_speed: Option<f64> = None;
    for (name, servo) in [
        ("MuJoCo, servo as constraint", Servo::Constraint),
        ("MuJoCo, servo as velocity actuator", Servo::Actuator),
    ] {
        let Some(report) = bench.run_mujoco(h, servo) else {
            continue;
        };
        let row = Row {
            name: name.to_owned(),
            speed: report.figure("speed"),
            depth_mean_mm: report.figure("depth_mean_mm"),
            depth_worst_mm: report.figure("depth_worst_mm"),
            tracking_rad: report.figure("tracking_rms_rad"),
            energy: bench.mujoco_energy(h).unwrap_or(f64::NAN),
        };
        // Ratios are to the faster of the two.
        mujoco_speed = Some(mujoco_speed.unwrap_or(0.0).max(row.speed));
        print(&row, mujoco_speed);
        println!(
            "|  | version {}, solver {} (2 = Newton), {} iterations, cone {} (1 = elliptic), integrator {} (0 = Euler, 3 = implicitfast), {:.2} contacts a step | | | | | |",
            report.figure("version"),
            report.figure("solver"),
            report.figure("iterations"),
            report.figure("cone"),
            report.figure("integrator"),
            report.figure("contacts_per_step"),
        );
    }
    let energy = energy_drift(params, h);
    for (level, sweeps) in [
        (Level::Avx512, 12),
        (Level::Avx2, 12),
        (Level::Sse2, 12),
        (Level::Scalar, 12),
        (Level::Reference, 12),
        (Level::Avx512, 30),
    ] {
        if !level.available() {
            println!("| {level:?} not on this processor | | | | | | |");
            continue;
        }
        let count = if level.lanes() == 1 {
            trials.len().min(MUJOCO_TRIALS)
        } else {
            trials.len()
        };
        let name = format!("ours, {level:?}, {sweeps} sweeps");
        let mut row = measured(&name, &trials[..count], level, h, sweeps);
        row.energy = energy;
        print(&row, mujoco_speed);
    }
    let rich = with_effects(trials);
    for level in [Level::Avx512, Level::Avx2] {
        if level.available() {
            let name = format!("ours, {level:?}, 12 sweeps, eight effects on");
            print(&measured(&name, &rich, level, h, 12), mujoco_speed);
        }
    }
}

/// The same trials with friction, ripple and compliance on every joint, anisotropic and torsional friction and a slope on the ground.
fn with_effects(trials: &[Trial]) -> Vec<Trial> {
    let mut model = Model::hand_tuned();
    let mut on = |effect, joint, values: &[f64]| {
        model
            .set_effect(effect, joint, values)
            .expect("values are in range");
    };
    for joint in (0..6).map(Some) {
        on(Effect::CoulombFriction, joint, &[0.2]);
        on(Effect::StribeckFriction, joint, &[0.1, 0.05]);
        on(Effect::LoadDependentFriction, joint, &[0.1]);
        on(Effect::TorqueRipple, joint, &[0.1, 4.0, 0.0]);
        on(Effect::Compliance, joint, &[80.0]);
    }
    on(Effect::FrictionAnisotropy, None, &[1.3, 0.2]);
    on(Effect::TorsionalFriction, None, &[0.005]);
    on(Effect::GroundSlope, None, &[0.01, 0.0]);
    let params = Arc::new(Params::try_from(&model).expect("all of them are simulated"));
    let with = |t: &Trial| Trial {
        params: Arc::clone(&params),
        ..t.clone()
    };
    trials.iter().map(with).collect()
}

fn main() {
    let count = std::env::args()
        .nth(1)
        .and_then(|a| a.parse().ok())
        .unwrap_or(64);
    let params = tools::params();
    let trials = tools::trials(&params, count);
    let bench = Bench::new("bench", &params, &trials[..trials.len().min(MUJOCO_TRIALS)]);
    println!(
        "One core, processor time. {count} random gaits for this engine, the first {MUJOCO_TRIALS} for MuJoCo; 30 s each from home, friction 1, no bounce, CPG included, no lead-in."
    );
    for h in [0.002, 0.004] {
        table(&bench, &params, &trials, h);
    }
    profile(&trials);
}

struct Clock {
    last: Instant,
    spent_s: Vec<(Stage, f64)>,
}

impl Probe for Clock {
    fn ended(&mut self, stage: Stage) {
        let now = Instant::now();
        let dt = (now - self.last).as_secs_f64();
        match self.spent_s.iter_mut().find(|(s, _)| *s == stage) {
            Some((_, sum)) => *sum += dt,
            None => self.spent_s.push((stage, dt)),
        }
        self.last = now;
    }
}

fn profile(trials: &[Trial]) {
    let options = Options::default();
    let mut clock = Clock {
        last: Instant::now(),
        spent_s: Vec::new(),
    };
    run_probed(trials, &options, &mut clock).expect("valid trials");
    let total: f64 = clock.spent_s.iter().map(|(_, s)| s).sum();
    let steps = trials.len() as f64 * TICKS as f64 / 20.0 / options.time_step_s;
    println!(
        "\nWhere the time of a 4 ms step goes, {:?}, clock included:\n",
        Level::detect()
    );
    println!("| stage | share | ns per lane and step |\n|---|---|---|");
    for (stage, spent_s) in clock.spent_s {
        println!(
            "| {stage:?} | {:.1} % | {:.1} |",
            100.0 * spent_s / total,
            1e9 * spent_s / steps
        );
    }
}
