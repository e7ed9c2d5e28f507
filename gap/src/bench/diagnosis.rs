//! How far the causes of a joint shrink the gap on runs that no fit saw.

use std::collections::BTreeMap;

use files::dataset::{Manifest, Recording};
use serde::Serialize;

use super::model::Point;
use super::rows::{Causes, Read};
use super::search::Known;
use super::split::Split;
use super::state::{Scored, State};
use super::transport::as_applied;
use super::{Asked, BenchError, Explained, explain};
use crate::candidates::measured;
use crate::decide::Calibration;
use crate::joint::{Channel, Problem};
use crate::math;
use crate::vocabulary::Effect;
use crate::whole::Shrink;

/// The gap on runs that no fit saw.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HeldOut {
    /// Names of the runs.
    pub runs: Vec<String>,
    /// How they were chosen.
    pub split: String,
    /// Mean over the runs of the root mean square error, by signal.
    pub errors: BTreeMap<&'static str, Shrink>,
}

/// Errors of a state by signal.
type Errors = BTreeMap<&'static str, f64>;

/// Name, unit and channel of each signal.
fn signals(linear: bool) -> [(&'static str, &'static str, Channel); 3] {
    if linear {
        [
            ("position_rmse_m", "m", Channel::Position),
            ("link_rmse_m", "m", Channel::Link),
            ("effort_rmse_n", "N", Channel::Effort),
        ]
    } else {
        [
            ("position_rmse_rad", "rad", Channel::Position),
            ("link_rmse_rad", "rad", Channel::Link),
            ("effort_rmse_nm", "N m", Channel::Effort),
        ]
    }
}

/// Name of the mean absolute error of the position, and its unit.
fn absolute(linear: bool) -> (&'static str, &'static str) {
    if linear {
        ("position_mae_m", "m")
    } else {
        ("position_mae_rad", "rad")
    }
}

/// What was explained, and the runs on which states of it are compared.
struct Whole<'a> {
    e: &'a Explained<'a>,
    scored: Scored,
    /// Causes that the echo shows by itself.
    read: Vec<Read>,
}

impl Whole<'_> {
    fn errors(&self, state: &State) -> Errors {
        let linear = self.scored.sent.linear;
        let known = signals(linear)
            .into_iter()
            .filter(|s| measured(&self.scored.sent, s.2));
        let mut out: Errors = known
            .map(|(name, _, channel)| (name, self.scored.rmse(state, channel)))
            .collect();
        let each = self.scored.errors(state, Channel::Position);
        let mean = |e: &Vec<f64>| e.iter().map(|x| x.abs()).sum::<f64>() / e.len().max(1) as f64;
        let means: Vec<f64> = each.iter().map(mean).collect();
        out.insert(absolute(linear).0, math::mean(&means));
        out
    }

    /// Where the chain begins at the echo, its set-points are those that arrived.
    fn state(&self, point: Point, arrived: bool) -> State {
        State {
            point,
            ideal: false,
            arrived: arrived && self.e.transport.cut_off(),
        }
    }

    /// As stated, with what is not stated where it fits best; with stated values where they fit best; with the causes.
    fn three(&self) -> [State; 3] {
        let known = self.scored.sent.known;
        let e = self.e;
        let stated = State {
            ideal: known.kp.is_none() && !known.effort_unit,
            ..self.state(e.search.start, false)
        };
        [
            stated,
            self.state(e.bare.fit.point(), self.read.is_empty()),
            self.state(e.found.best.fit.point(), true),
        ]
    }

    fn held_out(&self, how: &str) -> HeldOut {
        let linear = self.scored.sent.linear;
        let [before, calibrated, after] = self.three().map(|s| self.errors(&s));
        let unit = |name: &str| {
            let own = signals(linear).into_iter().find(|s| s.0 == name);
            own.map_or(absolute(linear).1, |s| s.1)
        };
        let shrink = |(name, own): (&&'static str, &f64)| {
            let all = Shrink {
                unit: unit(name),
                before: before[name],
                calibrated: calibrated[name],
                after: *own,
            };
            (*name, all)
        };
        let runs = self.scored.runs.iter();
        HeldOut {
            runs: runs
                .map(|r| self.scored.sent.runs[*r].name.clone())
                .collect(),
            split: how.into(),
            errors: after.iter().map(shrink).collect(),
        }
    }

    /// Errors without the cause that is called `name`.
    fn without(&self, name: Option<&str>) -> Errors {
        let (e, [_, _, found]) = (self.e, self.three());
        let kind = |m: &usize| Some(e.search.hypotheses[*m].kind.name()) == name;
        let member = e.found.best.members.iter().position(kind);
        let state = match member.and_then(|i| e.found.without.get(i)) {
            Some(point) => self.state(*point, true),
            // Without what the echo shows, set-points come as they were sent.
            None => State {
                arrived: false,
                ..found
            },
        };
        self.errors(&state)
    }
}

/// Names the causes of a joint on some of its runs, and compares the others.
pub(super) fn named(
    manifest: &Manifest,
    recordings: &[Recording],
    withhold: &[Effect],
    calibration: &Calibration,
) -> Result<Causes, BenchError> {
    let problem = Problem::new(manifest, recordings, 0).ok_or(BenchError::NoPosition)?;
    let split = Split::new(manifest, recordings, &problem)?;
    let asked = Asked {
        manifest: &split.manifest,
        recordings: &split.recordings,
        withhold,
        calibration: Some(calibration),
    };
    let known = Known {
        spreads: &calibration.spreads,
        laws: &calibration.laws,
    };
    let explained = explain(&asked, known)?;
    let own = Whole {
        scored: Scored {
            arrived: Problem::new(manifest, &as_applied(recordings), 0),
            sent: problem,
            runs: split.score,
        },
        read: explained.named(calibration),
        e: &explained,
    };
    let mut out = explained.rows(calibration);
    for row in &mut out.causes {
        row.without = own.without(row.effect);
    }
    out.held_out = Some(own.held_out(split.how));
    Ok(out)
}
