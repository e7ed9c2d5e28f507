//! Metrics on the scored runs: per run first, then the mean over runs.

use std::collections::BTreeMap;

use super::data::{Data, JOINTS};
use super::echo::Echo;
use super::nominal::Nominal;
use super::servo::{self, JointRun, Load, Trace};
use super::{body, camera, joints};
use crate::math;

/// One joint's scored runs.
pub(super) struct Scored {
    pub(super) joint: usize,
    pub(super) nominal: Nominal,
    /// Index of the scored run, and the run prepared; with the conventions found, and as sent.
    pub(super) runs: Vec<(usize, JointRun, JointRun)>,
}

/// A state of the whole model.
#[derive(Debug, Clone)]
pub(super) struct State {
    /// Coordinates of each joint, in the order of the joints found.
    pub(super) joints: Vec<Vec<f64>>,
    /// Coordinates of the body.
    pub(super) body: Vec<f64>,
    /// Coordinates of the camera.
    pub(super) camera: Vec<f64>,
    /// Whether the conventions found are applied.
    pub(super) conventions: bool,
    /// Whether the body stands on the contacts that windows show, not on those of the nominal model.
    pub(super) held: bool,
}

/// Values of every metric by run or gait.
pub(super) type Metrics = BTreeMap<&'static str, Vec<f64>>;

/// Errors of one joint before and after.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct JointRow {
    pub(super) joint: usize,
    pub(super) angle_rad: Option<[f64; 2]>,
    pub(super) torque_nm: Option<[f64; 2]>,
}

/// What is scored.
pub(super) struct Score {
    pub(super) joints: Vec<Scored>,
    pub(super) body: Option<body::Tier>,
    /// The body as it was recorded, where its joints were found to read in another order or sense.
    pub(super) recorded: Option<body::Tier>,
    pub(super) camera: Option<camera::Tier>,
    pub(super) runs: Vec<usize>,
}

/// Unit of a metric.
pub(super) fn unit(metric: &str) -> &'static str {
    match metric {
        "pose_rmse_m" => "m",
        "effort_rmse_nm" => "N m",
        "similarity_r" | "speed_error" => "1",
        _ => "rad",
    }
}

impl Scored {
    /// The servo of a state: what was read off the motors and the supply is no part of the nominal one.
    fn servo(&self, state: &State) -> Nominal {
        if state.conventions {
            return self.nominal;
        }
        Nominal {
            winding_ohm: 0.0,
            ..self.nominal
        }
    }
}

impl Score {
    /// Prepares the runs `runs`.
    pub(super) fn new(
        data: &Data,
        found: &[joints::Found],
        body: Option<body::Tier>,
        runs: &[usize],
        conventions: &super::Conventions,
        loads: &[[Load; JOINTS]],
    ) -> Self {
        let plain = super::Conventions {
            order: std::array::from_fn(|k| k),
            echo_at: std::array::from_fn(|k| k),
            echo: [Echo::NEUTRAL; JOINTS],
            ..conventions.clone()
        };
        let of = |f: &joints::Found| {
            let k = f.tier.joint;
            let prepare =
                |r: usize, c| joints::prepare(&data.runs[r], k, c, &f.tier.nominal, &loads[r][k]);
            Scored {
                joint: k,
                nominal: f.tier.nominal,
                runs: runs
                    .iter()
                    .filter_map(|r| Some((*r, prepare(*r, conventions)?, prepare(*r, &plain)?)))
                    .collect(),
            }
        };
        Self {
            joints: found.iter().map(of).collect(),
            body,
            recorded: None,
            camera: None,
            runs: runs.to_vec(),
        }
    }

    /// Errors joint by joint in two states, mean over runs.
    pub(super) fn by_joint(&self, before: &State, after: &State) -> Vec<JointRow> {
        let mut trace = Trace::default();
        let mut one = |(at, scored): (usize, &Scored)| {
            let mut sums = [Vec::new(), Vec::new(), Vec::new(), Vec::new()];
            for (_, with, without) in &scored.runs {
                for (s, state) in [before, after].into_iter().enumerate() {
                    let run = if state.conventions { with } else { without };
                    servo::simulate(run, &scored.servo(state), &state.joints[at], &mut trace);
                    let angle: Vec<f64> = servo::errors(&trace.position, &run.position).collect();
                    let torque: Vec<f64> = run.effort_errors(&trace, &state.joints[at]).collect();
                    sums[s].push(math::rms(&angle));
                    if !torque.is_empty() {
                        sums[2 + s].push(math::rms(&torque));
                    }
                }
            }
            let pair = |i: usize| {
                (!sums[i].is_empty()).then(|| [math::mean(&sums[i]), math::mean(&sums[i + 1])])
            };
            JointRow {
                joint: scored.joint,
                angle_rad: pair(0),
                torque_nm: pair(2),
            }
        };
        self.joints.iter().enumerate().map(&mut one).collect()
    }

    /// All metrics of a state.
    pub(super) fn metrics(&self, state: &State) -> Metrics {
        let mut out = Metrics::new();
        let mut trace = Trace::default();
        for r in &self.runs {
            let mut sums: BTreeMap<&'static str, (f64, f64)> = BTreeMap::new();
            for (scored, theta) in self.joints.iter().zip(&state.joints) {
                let Some((_, with, without)) = scored.runs.iter().find(|x| x.0 == *r) else {
                    continue;
                };
                let run = if state.conventions { with } else { without };
                servo::simulate(run, &scored.servo(state), theta, &mut trace);
                for (name, v) in [
                    (
                        "position_rmse_rad",
                        servo::errors(&trace.position, &run.position).collect::<Vec<_>>(),
                    ),
                    ("effort_rmse_nm", run.effort_errors(&trace, theta).collect()),
                    ("link_rmse_rad", run.link_errors(&trace)),
                ] {
                    if !v.is_empty() {
                        let s = sums.entry(name).or_default();
                        s.0 += math::rms(&v).powi(2);
                        s.1 += 1.0;
                    }
                }
            }
            for (name, (sum, n)) in sums {
                out.entry(name).or_default().push((sum / n).sqrt());
            }
        }
        let recorded = self.recorded.as_ref().filter(|_| !state.conventions);
        if let Some(tier) = recorded.or(self.body.as_ref()) {
            let errors = if state.held {
                tier.errors(&state.body)
            } else {
                tier.nominally_gripped().errors(&state.body)
            };
            out.insert("pose_rmse_m", errors.iter().map(|e| e[0]).collect());
            out.insert("heading_rmse_rad", errors.iter().map(|e| e[1]).collect());
        }
        if let Some(tier) = self.camera.as_ref().filter(|_| !state.camera.is_empty()) {
            out.insert("similarity_r", tier.similarity(&state.camera));
        }
        out
    }
}

/// 95 % interval of the mean by bootstrap.
pub(super) fn bootstrap(values: &[f64], seed: u64) -> [f64; 2] {
    if values.is_empty() {
        return [0.0, 0.0];
    }
    let mut rng = math::Rng::new(seed);
    let mut all = Vec::with_capacity(400);
    for _ in 0..400 {
        let draw: f64 = values.iter().map(|_| values[rng.index(values.len())]).sum();
        all.push(draw / values.len() as f64);
    }
    [math::quantile(&all, 0.025), math::quantile(&all, 0.975)]
}
