//! A stand-in for the robot: the physics crate at 1 ms with other contact settings, its joints either the engine's own or stepped
//! here, noisy and quantised recordings as text.

use std::fmt::Write as _;
use std::sync::Arc;

use files::dataset::{Manifest, Recording};
use files::model::{Key, Model};
use gap::math::Rng;
use physics::{Drive, Options, Params, Start, Trial};

/// Seconds between rows.
const ROW_S: f64 = 0.01;
/// Seconds between set-points.
const TICK_S: f64 = 0.05;

/// What a set holds.
pub(crate) struct Plan {
    pub(crate) gaits: usize,
    pub(crate) repeats: usize,
    pub(crate) seconds: f64,
    pub(crate) seed: u64,
    /// Base pose columns.
    pub(crate) base: bool,
    /// Torque columns.
    pub(crate) effort: bool,
    /// Current, duty and bus voltage, of the catalogue's motors.
    pub(crate) motors: bool,
    /// Voltage of the supply, V.
    pub(crate) bus_v: f64,
    /// What the data set states of its robot, a table of `dataset.toml`.
    pub(crate) stated: &'static str,
    /// Link angle columns.
    pub(crate) link: bool,
    /// Columns of the set-points as each joint's driver echoes them.
    pub(crate) echo: bool,
    /// Column that joint `k` stands in, set-points and readings alike.
    pub(crate) columns: [usize; 6],
}

impl Default for Plan {
    fn default() -> Self {
        Self {
            gaits: 6,
            repeats: 1,
            seconds: 10.0,
            seed: 3,
            base: true,
            effort: true,
            motors: false,
            bus_v: 12.0,
            stated: "",
            link: false,
            echo: false,
            columns: [0, 1, 2, 3, 4, 5],
        }
    }
}

/// Set-points of one run as sent, `[tick][joint]`.
fn set_points(plan: &Plan, gait: usize) -> Vec<[f64; 6]> {
    let mut rng = Rng::new(plan.seed * 1000 + gait as u64);
    let shape: Vec<[f64; 3]> = (0..6)
        .map(|_| {
            [
                0.25 + 0.5 * rng.uniform(),
                0.6 * (rng.uniform() - 0.5),
                std::f64::consts::TAU * rng.uniform(),
            ]
        })
        .collect();
    (0..=(plan.seconds / TICK_S) as usize)
        .map(|i| {
            let t = i as f64 * TICK_S;
            std::array::from_fn(|k| {
                let [r, x, phase] = shape[k];
                x + r
                    * (1.0 - libm::exp(-2.0 * t))
                    * libm::sin(std::f64::consts::TAU * 0.2 * t + phase)
            })
        })
        .collect()
}

/// From set-points sent to set-points that arrive.
pub(crate) type Path = dyn Fn(&[[f64; 6]]) -> Vec<[f64; 6]>;

/// How reality differs: the engine's model, and what happens to set-points on their way (joint, tick -> value).
pub(crate) struct Reality {
    pub(crate) model: Model,
    pub(crate) path: Box<Path>,
    /// Shifts the nominal parameters within their tolerances.
    pub(crate) jitter: bool,
    /// Drift of each joint's reading off its angle, rad/s: the joint follows its reading.
    pub(crate) zero_rad_s: [f64; 6],
}

impl Default for Reality {
    fn default() -> Self {
        Self {
            model: Model::hand_tuned(),
            path: Box::new(|s| s.to_vec()),
            jitter: true,
            zero_rad_s: [0.0; 6],
        }
    }
}

impl Reality {
    pub(crate) fn with(change: impl FnOnce(&mut Model)) -> Self {
        let mut out = Self::default();
        change(&mut out.model);
        out
    }
}

fn jittered(reality: &Reality, seed: u64) -> Model {
    let mut model = reality.model.clone();
    let mut rng = Rng::new(seed ^ 0x7a11);
    // Another contact law than the diagnosis assumes.
    model.set(Key::Erp, 0.3).expect("in range");
    model.set(Key::Cfm, 3e-5).expect("in range");
    if reality.jitter {
        let keys = [
            Key::IntraGain,
            Key::InterGain,
            Key::IntraTorque,
            Key::InterTorque,
            Key::IntraSpeed,
            Key::InterSpeed,
        ];
        for key in keys.into_iter().chain(Key::MASSES) {
            let p = model.parameter(key);
            let value = p.value + p.tolerance * rng.normal().clamp(-2.0, 2.0) * 0.7;
            model.set(key, value).expect("in range");
        }
    }
    model
}

/// Current, A, and duty of the motor of joint `k` in row `i`: `duty V = R i + k w` with the catalogue's numbers, referred to the output.
fn motor(outcome: &physics::Outcome, i: usize, k: usize, bus_v: f64) -> [f64; 2] {
    let (nm_per_a, ohm) = if matches!(k, 1 | 4) {
        (12.0 / 2.032, 4.09)
    } else {
        (12.0 / 2.786, 1.9)
    };
    let angle = |row: usize| f64::from(outcome.encoders_rad[row * 6 + k]);
    let (from, to) = (i.saturating_sub(1), i + 1);
    let to = if to * 6 + k < outcome.encoders_rad.len() {
        to
    } else {
        i
    };
    let speed_rad_s = (angle(to) - angle(from)) / ((to - from).max(1) as f64 * ROW_S);
    let current_a = f64::from(outcome.torques_nm[i * 6 + k]) / nm_per_a;
    [
        current_a,
        (ohm * current_a + nm_per_a * speed_rad_s) / bus_v,
    ]
}

/// Simulates and writes the CSV of one run.
fn csv(
    plan: &Plan,
    zero_rad_s: &[f64; 6],
    [sent, reached]: [&[[f64; 6]]; 2],
    outcome: &physics::Outcome,
    rng: &mut Rng,
) -> String {
    let mut s = String::from("t_s");
    for k in plan.columns {
        let _ = write!(s, ",setpoint_rad_{k},position_rad_{k}");
        if plan.echo {
            let _ = write!(s, ",applied_setpoint_rad_{k}");
        }
        if plan.effort {
            let _ = write!(s, ",effort_nm_{k}");
        }
        if plan.motors {
            let _ = write!(s, ",current_a_{k},duty_{k}");
        }
        if plan.link {
            let _ = write!(s, ",link_position_rad_{k}");
        }
    }
    if plan.motors {
        s.push_str(",bus_v");
    }
    if plan.base {
        s.push_str(",base_x_m,base_y_m,base_z_m,base_qw,base_qx,base_qy,base_qz");
    }
    s.push('\n');
    let rows = (plan.seconds / ROW_S) as usize;
    for i in 0..rows {
        let t = i as f64 * ROW_S;
        let _ = write!(s, "{t:.3}");
        let tick = ((t + 1e-6) / TICK_S) as usize;
        for (k, sent) in sent[tick].iter().enumerate() {
            let at = i * 6 + k;
            let q = f64::from(outcome.encoders_rad[at]) + zero_rad_s[k] * t + 2e-4 * rng.normal();
            let _ = write!(s, ",{sent:.6},{q:.4}");
            if plan.echo {
                let _ = write!(s, ",{:.6}", reached[tick][k]);
            }
            if plan.effort {
                let tau = f64::from(outcome.torques_nm[at]) + 0.03 * rng.normal();
                let _ = write!(s, ",{tau:.3}");
            }
            if plan.motors {
                let [current_a, duty] = motor(outcome, i, k, plan.bus_v);
                let current_a = current_a + 0.005 * rng.normal();
                let _ = write!(s, ",{current_a:.4},{duty:.4}");
            }
            if plan.link {
                let _ = write!(
                    s,
                    ",{:.4}",
                    f64::from(outcome.angles_rad[at]) + 2e-4 * rng.normal()
                );
            }
        }
        if plan.motors {
            let _ = write!(s, ",{}", plan.bus_v);
        }
        if plan.base {
            let p = outcome.poses[i];
            for x in p.position_m {
                let _ = write!(s, ",{:.5}", f64::from(x) + 3e-4 * rng.normal());
            }
            for x in p.quaternion {
                let _ = write!(s, ",{:.5}", f64::from(x) + 5e-4 * rng.normal());
            }
        }
        s.push('\n');
    }
    s
}

/// The data set of a plan.
pub(crate) fn record(plan: &Plan, reality: &Reality) -> (Manifest, Vec<Recording>) {
    let params = Arc::new(Params::try_from(&jittered(reality, plan.seed)).expect("simulable"));
    let options = Options {
        time_step_s: 0.001,
        sweeps: 30,
        sample_rate_hz: 1.0 / ROW_S,
        record_angles: true,
        record_motors: true,
        ..Options::default()
    };
    let mut text = String::from("format = 1\nrobot = \"metamodule\"\nname = \"stand-in\"\n");
    text.push_str(plan.stated);
    let mut sent = Vec::new();
    let mut trials = Vec::new();
    for gait in 0..plan.gaits {
        for repeat in 0..plan.repeats {
            let _ = write!(
                text,
                "[[run]]\nfile = \"g{gait}r{repeat}.csv\"\ngait = \"g{gait}\"\n"
            );
            let points = set_points(plan, gait);
            let mut rng = Rng::new(plan.seed + 77 * repeat as u64);
            let drifted = |(i, p): (usize, &[f64; 6])| -> [f64; 6] {
                std::array::from_fn(|k| p[k] - reality.zero_rad_s[k] * i as f64 * TICK_S)
            };
            let values: Vec<f32> = (reality.path)(&points)
                .iter()
                .enumerate()
                .flat_map(drifted)
                // Repeats differ by a little of everything; here by the set-points' last bits of play.
                .map(|x| {
                    (x + if plan.repeats > 1 {
                        5e-4 * rng.normal()
                    } else {
                        0.0
                    }) as f32
                })
                .collect();
            trials.push(Trial {
                params: Arc::clone(&params),
                start: Start::Home,
                drive: Drive::SetPoints {
                    period_s: TICK_S,
                    values_rad: Arc::from(values),
                },
                duration_s: plan.seconds,
            });
            sent.push(points);
        }
    }
    let (manifest, _) = Manifest::parse("dataset.toml", &text).expect("valid");
    let outcomes = physics::run(&trials, &options).expect("runs");
    let mut rng = Rng::new(plan.seed + 5);
    let recordings = outcomes
        .iter()
        .zip(&sent)
        .map(|(o, s)| {
            let reached = (reality.path)(s);
            Recording::parse(
                "run.csv",
                &csv(plan, &reality.zero_rad_s, [s, &reached], o, &mut rng),
                &manifest,
            )
            .expect("valid")
            .0
        })
        .collect();
    (manifest, recordings)
}

/// Films of recorded runs as a camera at `view` would take them, five frames a second, labelled `shift_s` early.
pub(crate) fn films(
    manifest: &Manifest,
    recordings: &[Recording],
    view: &camera::View,
    shift_s: f64,
) -> Vec<gap::whole::Film> {
    use control::linalg::{Pose, Rot3, Vec3};
    let robot = control::robot::RobotModel::default();
    let solids = camera::Solid::meta_module(&robot);
    let data = gap::whole::data::Data::new(manifest, recordings, &Model::hand_tuned());
    let film = |run: &gap::whole::data::Run| {
        let base = run.base.as_ref().expect("tracked");
        let frame = |i: usize| {
            let label = i as f64 * 0.2;
            let t = label + shift_s;
            let [w, x, y, z] = [0, 1, 2, 3].map(|k: usize| base.quaternion[k].at(t) as f32);
            let sine = (x * x + y * y + z * z).sqrt().max(1e-9);
            let axis = Vec3::new(x / sine, y / sine, z / sine);
            let pose = Pose {
                position_m: Vec3::new(
                    base.position_m[0].at(t) as f32,
                    base.position_m[1].at(t) as f32,
                    base.position_m[2].at(t) as f32,
                ),
                rotation: Rot3::about(axis, 2.0 * libm::atan2f(sine, w)),
            };
            let q = [0, 1, 2, 3, 4, 5]
                .map(|k: usize| run.joints[k].position.as_ref().expect("measured").at(t) as f32);
            let bodies = control::kinematics::forward(&robot, &q)
                .rebased(3, &pose)
                .bodies()
                .to_vec();
            (run.t0_s + label, view.render(&solids, &bodies))
        };
        let count = ((run.length_s - shift_s) / 0.2) as usize;
        gap::whole::Film {
            run: run.index,
            frames: (0..count).map(frame).collect(),
        }
    };
    data.runs.iter().map(film).collect()
}
