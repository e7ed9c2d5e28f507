//! Metrics on the scored runs: per run first, then the mean over runs.

use std::borrow::Cow;
use std::collections::BTreeMap;

use super::body::WINDOW_S;
use super::data::{Data, JOINTS, Run, Track};
use super::nominal::Nominal;
use super::servo::{self, J, JointRun, Load, Trace};
use super::{body, camera, joints, regime};
use crate::math;
use crate::regimes::{Compared, Marks, RegimeRow, Sums};

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
        let plain = conventions.as_sent();
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

    /// Errors by regime of the motion in two states: of every joint, and of the body's windows.
    pub(super) fn regimes(&self, data: &Data, before: &State, after: &State) -> Vec<RegimeRow> {
        let of = |(at, scored): (usize, &Scored)| {
            let mut sums = Sums::default();
            let limit_nm = scored.nominal.max_torque_nm * after.joints[at][J::MaxTorque as usize];
            for (r, with, without) in &scored.runs {
                for (last, state) in [(false, before), (true, after)] {
                    let run = if state.conventions { with } else { without };
                    let theta = &state.joints[at];
                    add(
                        &mut sums,
                        &data.runs[*r],
                        run,
                        (&scored.servo(state), theta, limit_nm),
                        last,
                    );
                }
            }
            sums.rows(Some(scored.joint))
        };
        let joints = self.joints.iter().enumerate().flat_map(of);
        joints.chain(self.blows(data, before, after)).collect()
    }

    /// Errors of the body's windows with a blow and without.
    fn blows(&self, data: &Data, before: &State, after: &State) -> Vec<RegimeRow> {
        let mut sums = Sums::default();
        for (last, state) in [(false, before), (true, after)] {
            let Some(tier) = self.tier(state) else {
                continue;
            };
            let ends = tier.each_end_m(&state.body);
            for (w, end_m) in tier.windows.iter().zip(ends) {
                let blows = data.runs[w.run].blows_s.as_ref();
                if let (Some(blows), Some(end_m)) = (blows, end_m) {
                    let within = |b: &f64| (w.from_s..w.from_s + WINDOW_S).contains(b);
                    let marks = Marks::contact(blows.iter().any(within));
                    sums.add(Compared::Pose, last, marks, end_m);
                }
            }
        }
        sums.rows(None)
    }

    /// The body of a state: as recorded where its conventions are not applied, on the nominal contacts where it is not held otherwise.
    fn tier(&self, state: &State) -> Option<Cow<'_, body::Tier>> {
        let recorded = self.recorded.as_ref().filter(|_| !state.conventions);
        let tier = recorded.or(self.body.as_ref())?;
        Some(if state.held {
            Cow::Borrowed(tier)
        } else {
            Cow::Owned(tier.nominally_gripped())
        })
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
        if let Some(tier) = self.tier(state) {
            let errors = tier.errors(&state.body);
            out.insert("pose_rmse_m", errors.iter().map(|e| e[0]).collect());
            out.insert("heading_rmse_rad", errors.iter().map(|e| e[1]).collect());
        }
        if let Some(tier) = self.camera.as_ref().filter(|_| !state.camera.is_empty()) {
            out.insert("similarity_r", tier.similarity(&state.camera));
        }
        out
    }
}

/// Adds the errors of one run of a joint under `servo`, `theta` and a torque limit.
fn add(
    sums: &mut Sums,
    recorded: &Run,
    run: &JointRun,
    (servo, theta, limit_nm): (&Nominal, &[f64], f64),
    after: bool,
) {
    let mut trace = Trace::default();
    servo::simulate(run, servo, theta, &mut trace);
    let volts = |bus: &Track| -> Vec<f64> {
        let steps = 0..run.path().len();
        steps.map(|i| bus.at(i as f64 * servo::STEP_S)).collect()
    };
    let bus_v = recorded.bus_v.as_ref().map(volts);
    let marks = regime::course(run, &trace, limit_nm, |c| {
        c.marks(bus_v.as_deref(), recorded.blows_s.as_deref())
    });
    let angles = servo::errors(&trace.position, &run.position);
    for (s, error) in run.position.iter().zip(angles) {
        sums.add(Compared::Position, after, marks[s.step()], error);
    }
    let torques = run.effort_errors(&trace, theta);
    for (s, error) in run.effort.iter().zip(torques) {
        sums.add(Compared::Effort, after, marks[s.step()], error);
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
