//! States of a joint, played on runs that no fit saw.

use super::model::Point;
use crate::joint::{Channel, Params, Problem, RunData, Trace, simulate};
use crate::math;

/// A state of the joint's model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct State {
    pub(super) point: Point,
    /// No servo is known: the position is the set-point.
    pub(super) ideal: bool,
    /// Set-points come as the driver's echo shows, not as they were sent.
    pub(super) arrived: bool,
}

/// Runs that figures are taken on.
pub(super) struct Scored {
    /// The joint with set-points as they were sent.
    pub(super) sent: Problem,
    /// The same as they arrived; `None` where no echo shows it.
    pub(super) arrived: Option<Problem>,
    /// Numbers of the runs.
    pub(super) runs: Vec<usize>,
}

impl Scored {
    /// A run and its rows as a state of the model has them, as they would be recorded.
    fn played(&self, state: &State, run: usize) -> (&RunData, Trace) {
        let arrived = self.arrived.as_ref().filter(|_| state.arrived);
        let problem = arrived.unwrap_or(&self.sent);
        let data = &problem.runs[run];
        let mut trace = Trace::new();
        let params: &Params = &state.point.params;
        simulate(data, params, problem.dt_s, &mut trace);
        for row in &mut trace {
            if state.ideal {
                row[Channel::Position as usize] = row[Channel::Applied as usize];
            }
            let columns = row.iter_mut().zip(&state.point.columns);
            columns.for_each(|(y, c)| *y *= c);
        }
        (data, trace)
    }

    /// Errors in `channel` at the enabled rows of each run.
    pub(super) fn errors(&self, state: &State, channel: Channel) -> Vec<Vec<f64>> {
        let c = channel as usize;
        let one = |r: &usize| {
            let (run, trace) = self.played(state, *r);
            let rows = run.samples.iter().zip(&trace);
            rows.filter(|(s, _)| s.enabled && s.measured[c].is_finite())
                .map(|(s, y)| y[c] - s.measured[c])
                .collect()
        };
        self.runs.iter().map(one).collect()
    }

    /// Root mean square of `channel`, mean over the runs.
    pub(super) fn rmse(&self, state: &State, channel: Channel) -> f64 {
        let all = self.errors(state, channel);
        math::mean(&all.iter().map(|e| math::rms(e)).collect::<Vec<_>>())
    }
}
