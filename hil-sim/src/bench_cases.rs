//! Cases for a blind check of a diagnosis: data set folders of one emulated joint on a stand, with a planted cause.
//!
//! Reality here is the emulated motor (LuGre friction, two-mass transmission, 50 us steps, 1 kHz driver loop); the
//! diagnosis has a model of its own. Every case draws its constants within their tolerances, so "no effect" is not "no
//! difference". Each gait is recorded twice, with fresh disturbance and noise.

mod draw;
mod record;

use std::fmt::Write as _;

use crate::motor::JointKind;
use crate::rng::Rng;

pub use draw::{Plan, plan};

/// One planted cause.
#[derive(Clone, Debug, PartialEq)]
pub struct Planted {
    /// Name of the shared vocabulary, or of [`crate::effects::OUTSIDE`].
    pub effect: &'static str,
    /// Parameters.
    pub parameters: Vec<(&'static str, f64)>,
}

/// What only the generator knows.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    /// Case name.
    pub name: String,
    /// `null`, `single`, `pair`, `triple` or `outside`.
    pub kind: &'static str,
    /// Planted causes.
    pub planted: Vec<Planted>,
    /// Position error that each cause makes, in floors (spread of repeats): what an oracle could gain by it.
    pub floors: Vec<f64>,
    /// Same over all recorded channels, each in its own noise.
    pub floors_any: Vec<f64>,
}

/// A case: files of the data set folder, and its label.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// File name and text, relative to the case folder.
    pub files: Vec<(String, String)>,
    /// Label.
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
    let (floors, floors_any) = sizes(&plan, &recorded);
    let label = Label {
        name: plan.name.clone(),
        kind: plan.kind,
        planted: plan
            .planted
            .iter()
            .map(|p| against_stated(&plan, p))
            .collect(),
        floors,
        floors_any,
    };
    Case { files, label }
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

/// What is lost without each of the causes, see [`size`].
fn sizes(plan: &Plan, recorded: &[[Vec<record::Row>; REPEATS]]) -> (Vec<f64>, Vec<f64>) {
    if plan.planted.is_empty() {
        return (Vec::new(), Vec::new());
    }
    let clean: Vec<Vec<record::Row>> = (0..GAITS)
        .map(|gait| record::record(plan, &plan.planted, gait, None))
        .collect();
    let repeats = floor(recorded);
    (0..plan.planted.len())
        .map(|k| {
            let mut others = plan.planted.clone();
            others.remove(k);
            size(plan, &others, &clean, &repeats)
        })
        .unzip()
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

/// What is lost without one of the causes: in floors of the position, and the largest over the channels.
fn size(
    plan: &Plan,
    others: &[Planted],
    clean: &[Vec<record::Row>],
    floor: &[f64; record::CHANNELS],
) -> (f64, f64) {
    let mut sum = [0.0; record::CHANNELS];
    let mut n = 0.0;
    for (gait, with) in clean.iter().enumerate() {
        let without = record::record(plan, others, gait, None);
        for (x, y) in with.iter().zip(&without) {
            n += 1.0;
            for (s, (x, y)) in sum.iter_mut().zip(x.channels.iter().zip(&y.channels)) {
                *s += (x - y) * (x - y);
            }
        }
    }
    let size: Vec<f64> = sum
        .iter()
        .zip(floor)
        .map(|(s, f)| libm::sqrt(s / n) / f)
        .collect();
    let recorded = |k: &usize| plan.link || *k != record::LINK;
    (
        size[record::POSITION],
        (0..size.len())
            .filter(recorded)
            .map(|k| size[k])
            .fold(0.0, f64::max),
    )
}

fn manifest(plan: &Plan) -> String {
    let motor = JOINT.neutral().motor;
    let inertia = plan.nominal_link_inertia + motor.reflected_inertia_kg_m2();
    let control = crate::driver::control::ControlParams::default();
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
    let mut s =
        String::from("t_s,setpoint_rad,applied_setpoint_rad,position_rad,current_a,duty,bus_v");
    s.push_str(if plan.link {
        ",link_position_rad\n"
    } else {
        "\n"
    });
    for r in rows {
        let c = &r.channels;
        let _ = write!(
            s,
            "{:.4},{:.6},{:.6},{:.6},{:.4},{:.4},{:.3}",
            r.t_s,
            r.setpoint_rad,
            c[record::APPLIED],
            c[record::POSITION],
            c[record::CURRENT],
            c[record::DUTY],
            c[record::BUS]
        );
        if plan.link {
            let _ = write!(s, ",{:.6}", c[record::LINK]);
        }
        s.push('\n');
    }
    s
}

/// Draws a number whose logarithm is uniform between `low` and `high`.
pub fn log_uniform(rng: &mut Rng, low: f64, high: f64) -> f64 {
    low * libm::exp(rng.uniform() * libm::log(high / low))
}
