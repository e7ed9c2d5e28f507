//! Cases for a blind check of a diagnosis: data set folders of one emulated joint on a stand, with a planted cause.
//!
//! Reality here is the emulated motor (LuGre friction, two-mass transmission, 50 us steps, 1 kHz driver loop); the
//! diagnosis has a model of its own. Every case draws its constants within their tolerances, so "no effect" is not "no
//! difference". Each gait is recorded twice, with fresh disturbance and noise.

mod draw;
mod record;

use std::collections::BTreeMap;
use std::fmt::Write as _;

use hil_sim::motor::JointKind;
use hil_sim::rng::Rng;

use crate::evidence;
use crate::label::{Cause, Label, Scope, Truth};

pub use draw::{Plan, plan};

/// One planted cause.
#[derive(Clone, Debug, PartialEq)]
pub struct Planted {
    /// Name of the shared vocabulary, or of [`hil_sim::effects::OUTSIDE`].
    pub effect: &'static str,
    /// Parameters.
    pub parameters: Vec<(&'static str, f64)>,
}

/// A case: files of the data set folder, and its label.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// File name and text, relative to the case folder.
    pub files: Vec<(String, String)>,
    /// What only the generator knows.
    pub label: Label,
}

/// Gaits of a case.
const GAITS: usize = 6;
/// Repeats of each gait.
const REPEATS: usize = 2;
/// Relative 1-sigma tolerances of what the manifest states.
const TOLERANCE: [(&str, f64); 5] = [
    ("inertia", 0.05),
    ("gravity", 0.03),
    ("supply", 0.02),
    ("speed", 0.03),
    ("effort", 0.03),
];

/// Joint of all cases.
pub(crate) const JOINT: JointKind = JointKind::Intra;

/// Makes case number `index` of the suite `seed`.
#[must_use]
pub fn case(seed: u64, index: usize) -> Case {
    let plan = plan(seed, index);
    let mut files = vec![("dataset.toml".to_string(), manifest(&plan))];
    let recorded: Vec<[Vec<record::Row>; REPEATS]> = (0..GAITS)
        .map(|gait| [0, 1].map(|repeat| record::record(&plan, &plan.planted, gait, Some(repeat))))
        .collect();
    for (gait, repeats) in recorded.iter().enumerate() {
        for (repeat, rows) in repeats.iter().enumerate() {
            files.push((format!("g{gait}_{repeat}.csv"), csv(&plan, rows)));
        }
    }
    let shown = shown(&plan, &recorded);
    let label = label(&plan, &shown);
    Case { files, label }
}

/// The label of what was planted, which shows so much: chi-square of every cause, and what stays of it.
fn label(plan: &Plan, shown: &[(f64, f64)]) -> Label {
    let causes = plan
        .planted
        .iter()
        .zip(shown)
        .map(|(planted, (full, left))| {
            let planted = against_stated(plan, planted);
            let truth = |v: f64| Truth {
                value: v.into(),
                by_joint: [("0".to_owned(), v)].into(),
            };
            let values = planted.parameters.iter();
            let values: BTreeMap<String, Truth> =
                values.map(|(k, v)| ((*k).to_owned(), truth(*v))).collect();
            let stage = draw::stage(planted.effect);
            let once = matches!(stage, "supply") || planted.effect == "clock_skew";
            Cause {
                effect: planted.effect.to_owned(),
                stage: stage.to_owned(),
                scope: if once { Scope::Robot } else { Scope::Joint },
                joints: if once { [].into() } else { [0].into() },
                values,
                also: draw::also(planted.effect),
                compound: None,
                spread: 0.0,
                readings_too: false,
                sigmas: sigmas(&planted),
                delta_chi2: *full,
                delta_chi2_refitted: *left,
                delta_chi2_rival: None,
            }
        });
    let columns = plan.columns.iter().enumerate().filter(|c| *c.1);
    let columns: Vec<&str> = columns.map(|(k, _)| record::NAMES[k]).collect();
    Label {
        name: plan.name.clone(),
        engine: "emulator".to_owned(),
        kind: plan.kind.to_owned(),
        causes: causes.collect(),
        more: [("columns".to_owned(), columns.into())].into(),
    }
}

/// By how many tolerances a nominal number is off.
fn sigmas(planted: &Planted) -> Option<f64> {
    let x = planted.parameters.first()?.1;
    let tolerance = |name: &str| TOLERANCE.iter().find(|t| t.0 == name).map(|t| t.1);
    let (ratio, name) = match planted.effect {
        "inertia" => (x, "inertia"),
        "gravity_load" => (x, "gravity"),
        "supply_voltage" => (x / 12.0, "supply"),
        "motor_constant" => (x, "speed"),
        "winding_resistance" => (x, "effort"),
        _ => return None,
    };
    Some((ratio - 1.0).abs() / tolerance(name)?)
}

/// A cause with its ratios against the stated values: what was planted times what the tolerances drew.
fn against_stated(plan: &Plan, planted: &Planted) -> Planted {
    let drawn = match planted.effect {
        "inertia" => plan.ratios[0],
        "gravity_load" => plan.ratios[1],
        "motor_constant" => plan.ratios[3],
        "winding_resistance" => plan.ratios[4],
        _ => 1.0,
    };
    let parameters = planted.parameters.iter().map(|(k, v)| (*k, v * drawn));
    Planted {
        effect: planted.effect,
        parameters: parameters.collect(),
    }
}

/// Per cause what it adds to chi-square, and what stays of that once the stated numbers were fitted within their
/// tolerances.
fn shown(plan: &Plan, recorded: &[[Vec<record::Row>; REPEATS]]) -> Vec<(f64, f64)> {
    if plan.planted.is_empty() {
        return Vec::new();
    }
    let play = |plan: &Plan, planted: &[Planted]| -> Vec<Vec<record::Row>> {
        (0..GAITS)
            .map(|gait| record::record(plan, planted, gait, None))
            .collect()
    };
    let clean = play(plan, &plan.planted);
    let floor = floor(recorded);
    // Repeats differ by random torques of 0.2 s: so many rows say the same.
    let alike = 0.2 * 1000.0 / record::ROW_TICKS as f64;
    let difference = |other: &[Vec<record::Row>]| -> Vec<f64> {
        let rows = clean.iter().flatten().zip(other.iter().flatten());
        let channels = (0..record::CHANNELS).filter(|k| plan.columns[*k]);
        let channels: Vec<usize> = channels.collect();
        rows.flat_map(|(x, y)| {
            let weighted = |k: &usize| {
                let correlated = (floor[*k].powi(2) - record::NOISE[*k].powi(2)).max(0.0);
                let sigma = libm::sqrt(record::NOISE[*k].powi(2) + alike * correlated);
                (x.channels[*k] - y.channels[*k]) / sigma.max(1e-5)
            };
            channels.iter().map(weighted).collect::<Vec<_>>()
        })
        .collect()
    };
    let less = |k: usize| {
        let mut others = plan.planted.clone();
        others.remove(k);
        difference(&play(plan, &others))
    };
    let off = |k: usize| {
        let mut other = plan.clone();
        other.ratios[k] *= 1.0 + TOLERANCE[k].1;
        difference(&play(&other, &other.planted))
    };
    let causes: Vec<Vec<f64>> = (0..plan.planted.len()).map(less).collect();
    let nuisances: Vec<Vec<f64>> = (0..TOLERANCE.len()).map(off).collect();
    let both = |(full, left)| (REPEATS as f64 * full, REPEATS as f64 * left);
    evidence::remaining(&causes, &nuisances)
        .into_iter()
        .map(both)
        .collect()
}

/// Spread of each channel between the two recordings of every gait.
fn floor(recorded: &[[Vec<record::Row>; REPEATS]]) -> [f64; record::CHANNELS] {
    let mut sum = [0.0; record::CHANNELS];
    let mut n = 0.0;
    for [a, b] in recorded {
        for (x, y) in a.iter().zip(b) {
            n += 1.0;
            for (s, (x, y)) in sum.iter_mut().zip(x.channels.iter().zip(&y.channels)) {
                *s += 0.5 * (x - y) * (x - y);
            }
        }
    }
    sum.map(|s| libm::sqrt(s / n).max(1e-9))
}

fn manifest(plan: &Plan) -> String {
    let motor = JOINT.neutral().motor;
    let inertia = plan.nominal_link_inertia + motor.reflected_inertia_kg_m2();
    let control = hil_sim::driver::control::ControlParams::default();
    let t = |name: &str| TOLERANCE.iter().find(|x| x.0 == name).map_or(0.05, |x| x.1);
    let mut s = String::new();
    let _ = write!(
        s,
        "format = 1\nrobot = \"bench\"\nname = \"blind case {}\"\n\n[bench]\ncommand = \"position\"\nmotion = \"rotary\"\n\
         inertia_kg_m2 = {{ value = {:.6}, tolerance = {} }}\ngravity_nm = {{ value = {:.4}, tolerance = {} }}\n\
         supply_v = {{ value = 12.0, tolerance = {} }}\nmax_speed_rad_s = {{ value = {:.5}, tolerance = {} }}\n\
         max_effort_nm = {{ value = {:.4}, tolerance = {} }}   # at standstill with the full supply\n\n[bench.controller]\n\
         kind = \"cascade\"\nkp = {:?}\nkv = {:?}\noutput = \"duty\"\nlimit = 1.0\nperiod_s = 0.001\n",
        plan.name,
        inertia,
        t("inertia"),
        plan.nominal_gravity,
        t("gravity"),
        t("supply"),
        motor.no_load_speed_rad_s(12.0),
        t("speed"),
        motor.stall_torque_nm(12.0),
        t("effort"),
        control.kp_1_s,
        control.kv_s_rad,
    );
    for gait in 0..GAITS {
        for repeat in 0..REPEATS {
            let _ = write!(
                s,
                "\n[[run]]\nfile = \"g{gait}_{repeat}.csv\"\ngait = \"g{gait}\"\n"
            );
        }
    }
    s
}

fn csv(plan: &Plan, rows: &[record::Row]) -> String {
    let columns: Vec<usize> = (0..record::CHANNELS).filter(|k| plan.columns[*k]).collect();
    let mut s = String::from("t_s,setpoint_rad");
    for k in &columns {
        let _ = write!(s, ",{}", record::NAMES[*k]);
    }
    s.push('\n');
    for r in rows {
        let _ = write!(s, "{:.4},{:.6}", r.t_s, r.setpoint_rad);
        for k in &columns {
            let _ = write!(s, ",{:.*}", record::DIGITS[*k], r.channels[*k]);
        }
        s.push('\n');
    }
    s
}

/// Draws a number whose logarithm is uniform between `low` and `high`.
pub fn log_uniform(rng: &mut Rng, low: f64, high: f64) -> f64 {
    low * libm::exp(rng.uniform() * libm::log(high / low))
}
