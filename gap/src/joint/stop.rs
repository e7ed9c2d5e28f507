//! End stops: where a joint stood still although its set-point went on.

use super::data::RunData;
use crate::math;

/// Part of the range of motion within which a joint stands at its stop: stops give way a little.
const NEAR: f64 = 0.02;
/// The set-point must be further off than this many usual errors, and than this part of the range: no lag is that long.
const USUAL: f64 = 8.0;
const FAR: f64 = 0.1;
/// Least time that the joint must be pushed against a stop, s.
const LEAST_S: f64 = 0.3;
/// The set-point must have travelled this many times as far as the joint did meanwhile.
const TRAVELLED: f64 = 8.0;

/// Lowest and highest angle the recordings show the joint to be stopped at; infinite where it never was. Only asked where no
/// gravity is stated: a motor that is too weak for its load stands still as well.
pub(super) fn travel(runs: &[RunData], dt_s: f64) -> [f64; 2] {
    const FREE: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];
    if runs.iter().any(|r| r.nominal.gravity != 0.0) {
        return FREE;
    }
    let rows: Vec<Vec<(f64, f64, f64)>> = runs.iter().map(|r| errors(r, dt_s)).collect();
    let all = || rows.iter().flatten();
    let usual = math::quantile(&all().map(|r| r.2.abs()).collect::<Vec<_>>(), 0.75);
    let low = all().map(|r| r.1).fold(f64::INFINITY, f64::min);
    let high = all().map(|r| r.1).fold(f64::NEG_INFINITY, f64::max);
    let far = (USUAL * usual).max(FAR * (high - low));
    let stop = |sign: f64, end: f64| {
        let near = |p: f64| (p - end).abs() < NEAR * (high - low);
        let mut pushed_s = 0.0;
        let (mut angles, mut set_points) = (Vec::new(), Vec::new());
        let mut deepest: f64 = 0.0;
        for run in &rows {
            for w in run.windows(2) {
                let (t, p, e) = w[0];
                if near(p) && sign * e > 0.3 * far {
                    pushed_s += w[1].0 - t;
                    deepest = deepest.max(sign * e);
                    angles.push(p);
                    set_points.push(p + e);
                }
            }
        }
        let span = |v: &[f64]| math::quantile(v, 0.95) - math::quantile(v, 0.05);
        let stopped =
            pushed_s > LEAST_S && deepest > far && span(&set_points) > TRAVELLED * span(&angles);
        stopped.then(|| math::median(&angles))
    };
    [
        stop(-1.0, low).unwrap_or(FREE[0]),
        stop(1.0, high).unwrap_or(FREE[1]),
    ]
}

/// Time, angle and set-point less angle of every row in force.
fn errors(run: &RunData, dt_s: f64) -> Vec<(f64, f64, f64)> {
    let mut k = 0;
    let mut out = Vec::new();
    for s in run
        .samples
        .iter()
        .filter(|s| s.enabled && s.measured[0].is_finite())
    {
        let t = (s.step as f64 + s.part) * dt_s;
        while run.command_t_s.get(k + 1).is_some_and(|c| *c <= t) {
            k += 1;
        }
        if let Some(c) = run.command.get(k) {
            out.push((t, s.measured[0], c - s.measured[0]));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use files::dataset::{Manifest, Recording};

    use crate::joint::Problem;

    /// A joint that follows a slow sine 20 ms late, but not below -1 rad if `stopped`; gravity stated or not.
    fn travel(stopped: bool, bench: &str) -> [f64; 2] {
        let text =
            format!("format = 1\nrobot = \"bench\"\n[bench]\n{bench}\n[[run]]\nfile = \"a.csv\"\n");
        let (manifest, _) = Manifest::parse("dataset.toml", &text).expect("valid");
        let mut csv = String::from("t_s,setpoint_rad,position_rad\n");
        for k in 0..1000 {
            let t = f64::from(k) * 0.02;
            let asked = |t: f64| 1.5 * libm::sin(t);
            let low = if stopped { -1.0 } else { -9.0 };
            csv.push_str(&format!(
                "{t:.2},{:.5},{:.5}\n",
                asked(t),
                asked(t - 0.02).max(low)
            ));
        }
        let (recording, _) = Recording::parse("a.csv", &csv, &manifest).expect("valid");
        let problem = Problem::new(&manifest, &[recording], 0).expect("a position");
        problem.runs[0].nominal.travel
    }

    #[test]
    fn a_stop_is_found_where_the_joint_stood() {
        let [low, high] = travel(true, "");
        assert!((low + 1.0).abs() < 1e-9, "{low}");
        assert_eq!(high, f64::INFINITY);
    }

    #[test]
    fn no_stop_without_one_or_where_a_load_may_hold_the_joint() {
        let free = [f64::NEG_INFINITY, f64::INFINITY];
        assert_eq!(travel(false, ""), free);
        assert_eq!(travel(true, "gravity_nm = 1.0"), free);
    }
}
