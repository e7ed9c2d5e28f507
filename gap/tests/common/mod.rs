//! Data sets made with the diagnosis' own simulator. Said plainly: recovering what one's own simulator planted is an
//! inverse crime; it checks the search and the arithmetic, not the physics. The emulated motor checks the physics.

use std::fmt::Write as _;

use files::dataset::{Manifest, Recording};
use gap::joint::{Params, Problem, Trace, simulate};
use gap::math::Rng;

/// A geared joint whose nominal values are known: 0.08 kg m^2, 2 N m of gravity, 27 N m at standstill, 2.8 rad/s.
const BENCH: &str = "format = 1\nrobot = \"bench\"\nname = \"made\"\n[bench]\ninertia_kg_m2 = { value = 0.08, tolerance = 0.05 }\n\
    gravity_nm = { value = 2.0, tolerance = 0.03 }\nsupply_v = { value = 12.0, tolerance = 0.02 }\n\
    max_speed_rad_s = { value = 2.8, tolerance = 0.03 }\nmax_effort_nm = { value = 27.0, tolerance = 0.03 }\n\
    [bench.controller]\nkind = \"cascade\"\nkp = 10.0\nkv = 0.8\noutput = \"duty\"\nlimit = 1.0\nperiod_s = 0.001\n";

fn wave(gait: usize, t: f64) -> f64 {
    use gap::math::sin;
    match gait {
        0 => 0.7 * sin(2.0 * t),
        1 => 0.4 * sin(4.0 * t) + 0.5,
        2 => [0.0, 0.5, -0.4, 0.2, -0.1][(t / 1.2) as usize % 5],
        3 => 0.3 * sin(1.3 * t) + 0.3 * sin(5.1 * t) - 0.2,
        4 => 0.9 * sin(1.1 * t) - 0.3,
        _ => 0.25 * sin(t * (0.5 + 0.8 * t)),
    }
}

/// A data set of six gaits, two recordings each, with `planted` in the joint and seeded noise on what is measured.
pub(crate) fn data(planted: &Params, seed: u64) -> (Manifest, Vec<Recording>) {
    data_of(|_| *planted, seed)
}

/// The same with what is planted by run.
pub(crate) fn data_of(planted: impl Fn(usize) -> Params, seed: u64) -> (Manifest, Vec<Recording>) {
    let mut text = String::from(BENCH);
    for g in 0..6 {
        for r in 0..2 {
            let _ = write!(text, "[[run]]\nfile = \"g{g}_{r}.csv\"\ngait = \"g{g}\"\n");
        }
    }
    let (manifest, _) = Manifest::parse("dataset.toml", &text).expect("valid");
    let mut rng = Rng::new(seed);
    let mut recordings = Vec::new();
    for (i, run) in manifest.runs.iter().enumerate() {
        let mut csv =
            String::from("t_s,setpoint_rad,position_rad,current_a,duty,bus_v,link_position_rad\n");
        for k in 0..400 {
            let t = f64::from(k) * 0.01;
            // Set-points at 20 Hz.
            let sp = wave(i / 2, f64::from(k / 5) * 0.05);
            let _ = writeln!(csv, "{t:.3},{sp:.6},{:.6},0,0,12,0", wave(i / 2, 0.0));
        }
        let (shell, _) = Recording::parse(&run.file, &csv, &manifest).expect("valid");
        recordings.push(shell);
    }
    let problem = Problem::new(&manifest, &recordings, 0).expect("position is there");
    for (k, (rec, run)) in recordings.iter_mut().zip(&problem.runs).enumerate() {
        let mut trace = Trace::new();
        simulate(run, &planted(k), problem.dt_s, &mut trace);
        fill(rec, &trace, &mut rng);
    }
    (manifest, recordings)
}

/// Puts a simulation into the columns that are measured, with their noise.
pub(crate) fn fill(rec: &mut Recording, trace: &Trace, rng: &mut Rng) {
    use files::dataset::Signal;
    let columns = [
        (Signal::Position, 0, 4e-4),
        (Signal::Current, 1, 0.01),
        (Signal::Duty, 2, 3e-3),
        (Signal::LinkPosition, 4, 4e-4),
    ];
    for (signal, k, noise) in columns {
        let v = trace.iter().map(|y| y[k] + noise * rng.normal()).collect();
        rec.joint_mut(0).expect("one joint").set(signal, Some(v));
    }
}
