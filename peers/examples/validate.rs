//! The tables of docs/explanation/physics.md: this engine, MuJoCo, ODE and Rapier on the same gaits, and convergence in the step.
//!
//! `cargo run --release -p peers --features rapier --example validate -- [GAITS] [coarse]`; `coarse` leaves out the 0.5 ms runs, which
//! take most of the time. Needs cc, libode-dev and target/venv with mujoco for the engines that are not Rust.
#![allow(clippy::print_stdout)]

use peers::{Cone, JOINTS, Mujoco, Ode, PeerError, Report, TICKS, Track, Workplace, ours};
use physics::mjcf::Servo;
use physics::{Level, Params, Trial};
use std::path::{Path, PathBuf};

/// Samples at 20 Hz of the instants that the tables compare, s.
const INSTANTS_S: [f64; 5] = [0.5, 1.0, 2.0, 10.0, 30.0];

fn apart(a: &Track, b: &Track, tick: usize) -> f64 {
    (0..3)
        .map(|k| (a[tick][k] - b[tick][k]).powi(2))
        .sum::<f64>()
        .sqrt()
}

/// Angle between two orientations, rad.
fn turned(a: &Track, b: &Track, tick: usize) -> f64 {
    let dot: f64 = (3..7).map(|k| a[tick][k] * b[tick][k]).sum();
    2.0 * dot.abs().min(1.0).acos()
}

fn joint_rms(a: &Track, b: &Track, ticks: usize) -> f64 {
    let mut sum = 0.0;
    for (x, y) in a.iter().zip(b).take(ticks + 1) {
        for k in 7..7 + JOINTS {
            sum += (x[k] - y[k]).powi(2);
        }
    }
    (sum / ((ticks + 1) * JOINTS) as f64).sqrt()
}

fn distance(a: &Track) -> f64 {
    (a[TICKS][0] - a[0][0]).hypot(a[TICKS][1] - a[0][1])
}

fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut out = vec![0.0; values.len()];
    for (rank, k) in order.into_iter().enumerate() {
        out[k] = rank as f64;
    }
    out
}

/// Spearman's rank correlation.
fn rank_correlation(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (ranks(a), ranks(b));
    let n = a.len() as f64;
    let mean = (n - 1.0) / 2.0;
    let cross: f64 = a.iter().zip(&b).map(|(x, y)| (x - mean) * (y - mean)).sum();
    let own: f64 = a.iter().map(|x| (x - mean).powi(2)).sum();
    cross / own
}

/// Kolmogorov and Smirnov's distance of two samples, 0 = same distribution.
fn ks(a: &[f64], b: &[f64]) -> f64 {
    let share =
        |set: &[f64], x: f64| set.iter().filter(|v| **v <= x).count() as f64 / set.len() as f64;
    a.iter()
        .chain(b)
        .map(|x| (share(a, *x) - share(b, *x)).abs())
        .fold(0.0, f64::max)
}

/// One line of a table; an engine that did not finish all trials must not be compared with one that did.
fn row(name: &str, report: &Report, reference: &Report) {
    assert_eq!(report.tracks.len(), reference.tracks.len(), "{name}");
    let pairs = || report.tracks.iter().zip(&reference.tracks);
    let joints = median(pairs().map(|(a, b)| joint_rms(a, b, 40)).collect()).to_degrees();
    print!("| {name} | {joints:.3} |");
    for t in INSTANTS_S {
        let tick = (t * 20.0) as usize;
        let d = median(pairs().map(|(a, b)| apart(a, b, tick)).collect());
        print!(" {:.2} |", d * 100.0);
    }
    let angle = median(pairs().map(|(a, b)| turned(a, b, 40)).collect()).to_degrees();
    let own: Vec<f64> = report.tracks.iter().map(distance).collect();
    let other: Vec<f64> = reference.tracks.iter().map(distance).collect();
    let mean = own.iter().sum::<f64>() / own.len() as f64;
    println!(
        " {angle:.2} | {:.1} | {:.1} | {:.2} | {:.2} |",
        mean * 100.0,
        median(own.clone()) * 100.0,
        rank_correlation(&own, &other),
        ks(&own, &other),
    );
}

fn heading(reference: &str) {
    println!("\nReference: {reference}\n");
    println!(
        "| engine, step | joints 2 s [deg] | 0.5 s [cm] | 1 s | 2 s | 10 s | 30 s | orientation 2 s [deg] | mean distance [cm] | median | rank corr. | KS |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
}

/// Middle value.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    if values.is_empty() {
        f64::NAN
    } else {
        values[values.len() / 2]
    }
}

/// An engine in one setting and what it did.
type Run = (String, Report);

fn our_runs(trials: &[Trial], finest: f64) -> Vec<Run> {
    let mut runs = Vec::new();
    for (h, sweeps) in [
        (0.0005, 50),
        (0.001, 12),
        (0.002, 12),
        (0.004, 12),
        (0.008, 12),
        (0.004, 4),
        (0.004, 8),
        (0.004, 30),
        (0.004, 100),
    ] {
        if h >= finest {
            let report = ours(Level::Reference, trials, h, sweeps);
            runs.push((format!("ours f64, {} ms, {sweeps} sweeps", h * 1e3), report));
        }
    }
    let report = ours(Level::detect(), trials, 0.004, 12);
    runs.push(("ours f32 lanes, 4 ms, 12 sweeps".to_owned(), report));
    runs
}

fn ode_runs(place: &Workplace, finest: f64) -> Result<Vec<Run>, PeerError> {
    let ode = Ode::build(place)?;
    let mut runs = Vec::new();
    for (h, stepper) in [
        (0.0005, "step"),
        (0.001, "step"),
        (0.002, "quick"),
        (0.004, "step"),
    ] {
        if h >= finest {
            runs.push((
                format!("ODE {stepper}, {} ms", h * 1e3),
                ode.run(h, stepper)?,
            ));
        }
    }
    Ok(runs)
}

fn mujoco_runs(place: &Workplace, target: &Path, finest: f64) -> Result<Vec<Run>, PeerError> {
    let package = peers::mujoco_package(&target.join("venv")).unwrap_or_default();
    let mujoco = Mujoco::build(place, &package)?;
    let mut runs = Vec::new();
    for h in [0.0005, 0.001, 0.002, 0.004] {
        if h >= finest {
            let report = mujoco.run(h, Servo::Constraint, Cone::Elliptic)?;
            runs.push((format!("MuJoCo, {} ms", h * 1e3), report));
        }
    }
    Ok(runs)
}

#[cfg(feature = "rapier")]
fn rapier_runs(params: &Params, trials: &[Trial]) -> Vec<Run> {
    // Its substeps are a sixteenth of these.
    [0.002, 0.004]
        .into_iter()
        .map(|h| {
            let report = peers::rapier::run(params, trials, h);
            let figures = &report.figures;
            eprintln!("Rapier {} ms: {figures:?}", h * 1e3);
            (format!("Rapier, {} ms", h * 1e3), report)
        })
        .collect()
}

#[cfg(not(feature = "rapier"))]
fn rapier_runs(_: &Params, _: &[Trial]) -> Vec<Run> {
    eprintln!("Rapier LEFT OUT: build with --features rapier");
    Vec::new()
}

fn main() -> Result<(), PeerError> {
    let count = std::env::args()
        .nth(1)
        .and_then(|a| a.parse().ok())
        .unwrap_or(60);
    let coarse = std::env::args().nth(2).is_some_and(|a| a == "coarse");
    let params = peers::bounceless();
    let trials = peers::clear_trials(&params, count);
    let target = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../target");
    let place = Workplace::new(target.join("validation"), &params, &trials)?;
    println!(
        "{count} random gaits, amplitude 0.5 to 1.2 rad, offset up to 0.5 rad, 0.2 Hz, friction 1, no bounce, 30 s, start at home."
    );
    let finest = if coarse { 0.001 } else { 0.0005 };
    let mut engines = our_runs(&trials, finest);
    for foreign in [
        ode_runs(&place, finest),
        mujoco_runs(&place, &target, finest),
    ] {
        match foreign {
            Ok(runs) => engines.extend(runs),
            Err(error) => eprintln!("LEFT OUT: {error}"),
        }
    }
    engines.extend(rapier_runs(&params, &trials));
    let finest_ms = finest * 1e3;
    let sweeps = if coarse { 12 } else { 50 };
    for name in [
        format!("ODE step, {finest_ms} ms"),
        format!("MuJoCo, {finest_ms} ms"),
        "Rapier, 2 ms".to_owned(),
        format!("ours f64, {finest_ms} ms, {sweeps} sweeps"),
    ] {
        if let Some((_, reference)) = engines.iter().find(|(n, _)| *n == name) {
            heading(&name);
            for (n, report) in engines.iter().filter(|(n, _)| *n != name) {
                row(n, report, reference);
            }
        }
    }
    Ok(())
}
