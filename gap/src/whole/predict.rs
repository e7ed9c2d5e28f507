//! What a model predicts for recorded runs: the whole chain from set-points to base pose, in the body simulator.

use std::fmt::Write as _;
use std::sync::Arc;

use files::dataset::{Manifest, Recording};
use files::model::Model;
use physics::{CONTROL_RATE_HZ, Drive, Options, Outcome, Params, ParamsError, Start, Trial};

use super::data::{Data, JOINTS, Run};
use super::windows;
use crate::math;

/// Rows per second of a prediction.
pub(super) const RATE_HZ: f64 = 50.0;

/// The run as a trial: from the measured start, driven by the set-points that were sent; `None` without them.
pub(super) fn trial(run: &Run, params: &Arc<Params>) -> Option<Trial> {
    let ticks = (run.length_s * CONTROL_RATE_HZ) as usize + 1;
    let mut values = Vec::with_capacity(ticks * JOINTS);
    for i in 0..ticks {
        for j in &run.joints {
            let track = j.command.as_ref().or(j.applied.as_ref())?;
            // A hair later than the tick, so that a row at the tick's own time counts.
            values.push(track.held(i as f64 / CONTROL_RATE_HZ + 1e-3) as f32);
        }
    }
    let angles: Option<Vec<f32>> = run
        .joints
        .iter()
        .map(|j| {
            j.link
                .as_ref()
                .or(j.position.as_ref())
                .map(|p| p.v[0] as f32)
        })
        .collect();
    let start = run.base.as_ref().and_then(|b| {
        let (base, _) = windows::base_state(b, b.t_s[0])?;
        Some(Start::State {
            base,
            twist: physics::Twist::default(),
            angles_rad: angles?,
            speeds_rad_s: vec![0.0; JOINTS],
        })
    });
    Some(Trial {
        params: Arc::clone(params),
        start: start.unwrap_or(Start::Home),
        drive: Drive::SetPoints {
            period_s: 1.0 / CONTROL_RATE_HZ,
            values_rad: Arc::from(values),
        },
        duration_s: run.length_s.max(0.1),
    })
}

/// Simulates `runs`; `None` for a run without set-points.
pub(super) fn rollouts(data: &Data, runs: &[usize], params: &Arc<Params>) -> Vec<Option<Outcome>> {
    let trials: Vec<Option<Trial>> = runs.iter().map(|r| trial(&data.runs[*r], params)).collect();
    let known: Vec<Trial> = trials.iter().flatten().cloned().collect();
    let options = Options {
        sample_rate_hz: RATE_HZ,
        record_angles: true,
        record_motors: true,
        ..Options::default()
    };
    let mut outcomes = windows::run(&known, &options).into_iter();
    trials
        .iter()
        .map(|t| t.as_ref().and_then(|_| outcomes.next()))
        .collect()
}

/// Error of whole runs, restarted nowhere, with their numbers: position of the base, m, and mean speed, m/s.
pub(super) fn errors(data: &Data, runs: &[usize], params: &Arc<Params>) -> Vec<(usize, [f64; 2])> {
    let mut out = Vec::new();
    for (r, o) in runs.iter().zip(rollouts(data, runs, params)) {
        let run = &data.runs[*r];
        let (Some(o), Some(base)) = (o, run.base.as_ref()) else {
            continue;
        };
        let mut square = Vec::new();
        for (i, p) in o.poses.iter().enumerate() {
            let t = i as f64 / RATE_HZ;
            let d = (0..3).map(|k| (f64::from(p.position_m[k]) - base.position_m[k].at(t)).powi(2));
            square.push(d.sum::<f64>().sqrt());
        }
        let ends = |k: usize| base.position_m[k].at(run.length_s) - base.position_m[k].at(0.0);
        let speed = libm::hypot(ends(0), ends(1)) / run.length_s.max(1e-9);
        out.push((*r, [math::rms(&square), (o.speed_m_s - speed).abs()]));
    }
    out
}

fn csv(run: &Run, o: &Outcome) -> String {
    let mut s = String::from("t_s");
    for k in 0..JOINTS {
        let _ = write!(
            s,
            ",setpoint_rad_{k},position_rad_{k},link_position_rad_{k},effort_nm_{k}"
        );
    }
    s.push_str(",base_x_m,base_y_m,base_z_m,base_qw,base_qx,base_qy,base_qz\n");
    for (i, pose) in o.poses.iter().enumerate() {
        let t = i as f64 / RATE_HZ;
        let _ = write!(s, "{:.3}", run.t0_s + t);
        for (k, j) in run.joints.iter().enumerate() {
            let sent = j
                .command
                .as_ref()
                .or(j.applied.as_ref())
                .map_or(0.0, |c| c.held(t + 1e-3));
            let at = |v: &[f32]| v.get(i * JOINTS + k).copied().unwrap_or(0.0);
            let _ = write!(
                s,
                ",{sent:.5},{:.5},{:.5},{:.4}",
                at(&o.encoders_rad),
                at(&o.angles_rad),
                at(&o.torques_nm)
            );
        }
        for x in pose.position_m.iter().chain(&pose.quaternion) {
            let _ = write!(s, ",{x:.5}");
        }
        s.push('\n');
    }
    s
}

/// Name and CSV text of every run as `model` predicts it, in the columns of a data set; runs without set-points are left out.
///
/// # Errors
/// A model that the simulator refuses.
pub fn predict(
    manifest: &Manifest,
    recordings: &[Recording],
    model: &Model,
) -> Result<Vec<(String, String)>, ParamsError> {
    let data = Data::new(manifest, recordings, model);
    let params = Arc::new(Params::try_from(model)?);
    let runs: Vec<usize> = (0..data.runs.len()).collect();
    let outcomes = rollouts(&data, &runs, &params);
    Ok(data
        .runs
        .iter()
        .zip(outcomes)
        .filter_map(|(r, o)| Some((r.name.clone(), csv(r, &o?))))
        .collect())
}
