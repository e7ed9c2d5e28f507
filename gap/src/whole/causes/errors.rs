//! Squares of errors by signal, joint and run, and their roots.

use std::collections::BTreeMap;

/// Signals, with their units.
pub(super) const SIGNALS: [(&str, &str); 5] = [
    ("position_rmse_rad", "rad"),
    ("effort_rmse_nm", "N m"),
    ("link_rmse_rad", "rad"),
    ("pose_rmse_m", "m"),
    ("heading_rmse_rad", "rad"),
];

/// Angles, torques, links, places and headings of the base, by their places in [`SIGNALS`].
pub(super) const ANGLE: usize = 0;
pub(super) const TORQUE: usize = 1;
pub(super) const LINK: usize = 2;
pub(super) const POSE: usize = 3;
pub(super) const HEADING: usize = 4;

/// Sums of squares and their numbers by signal, joint and run.
#[derive(Default)]
pub(super) struct Sums(BTreeMap<(usize, Option<usize>, usize), (f64, f64)>);

/// Root of the mean of some sums; `None` without any.
fn root<'a>(sums: impl Iterator<Item = &'a (f64, f64)>) -> Option<f64> {
    let (square, count) = sums.fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
    (count > 0.0).then(|| (square / count).sqrt())
}

impl Sums {
    /// Adds an error of a signal, of a joint or of the robot, in a run.
    pub(super) fn add(&mut self, signal: usize, (joint, run): (Option<usize>, usize), error: f64) {
        let sum = self.0.entry((signal, joint, run)).or_default();
        sum.0 += error * error;
        sum.1 += 1.0;
    }

    /// By signal, over all joints and runs.
    pub(super) fn roots(&self) -> BTreeMap<&'static str, f64> {
        let all = SIGNALS.iter().enumerate();
        all.filter_map(|(i, (name, _))| {
            let own = self.0.iter().filter(|s| s.0.0 == i);
            Some((*name, root(own.map(|s| s.1))?))
        })
        .collect()
    }

    /// By signal, each run by itself.
    pub(super) fn by_run(&self) -> BTreeMap<&'static str, Vec<f64>> {
        let mut runs: BTreeMap<(usize, usize), Vec<(f64, f64)>> = BTreeMap::new();
        for ((signal, _, run), sum) in &self.0 {
            runs.entry((*signal, *run)).or_default().push(*sum);
        }
        let mut out: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
        for ((signal, _), sums) in runs {
            let own = out.entry(SIGNALS[signal].0).or_default();
            own.extend(root(sums.iter()));
        }
        out
    }

    /// A signal of joint `k`, over all runs.
    pub(super) fn of_joint(&self, signal: usize, k: usize) -> Option<f64> {
        let own = self
            .0
            .iter()
            .filter(|s| (s.0.0, s.0.1) == (signal, Some(k)));
        root(own.map(|s| s.1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_add_up_by_signal_run_and_joint() {
        let mut sums = Sums::default();
        for (joint, run, error) in [(0, 0, 3.0), (0, 1, 4.0), (2, 1, 0.0), (2, 1, 0.0)] {
            sums.add(ANGLE, (Some(joint), run), error);
        }
        sums.add(POSE, (None, 5), 2.0);
        let roots = sums.roots();
        assert_eq!(roots["position_rmse_rad"], 2.5);
        assert_eq!(roots["pose_rmse_m"], 2.0);
        assert_eq!(roots.len(), 2);
        assert_eq!(
            sums.by_run()["position_rmse_rad"],
            [3.0, (16.0_f64 / 3.0).sqrt()]
        );
        assert_eq!(sums.of_joint(ANGLE, 0), Some(12.5_f64.sqrt()));
        assert_eq!(sums.of_joint(ANGLE, 1), None);
        assert_eq!(sums.of_joint(TORQUE, 0), None);
    }
}
