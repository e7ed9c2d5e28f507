//! The verdict `rb.gap/1` of the causes that were found.

use std::collections::BTreeMap;

use super::advice;
use super::causes::{self, Beside, Causes, Row, Word as Found};
use super::data::Data;
use crate::math;
use crate::regimes::{Aspect, RegimeRow};
use crate::sentence::{body_off, sentence};
use crate::verdict::causes as parts;
use crate::verdict::*;
use crate::vocabulary::{Effect, Stage};

/// Signals that the gap may be told in, in the order of preference where no cause is named.
const PRIMARY: [&str; 4] = [
    "pose_rmse_m",
    "position_rmse_rad",
    "effort_rmse_nm",
    "link_rmse_rad",
];
/// Error of the body's windows, over what their starts explain, from which a verdict of `none` says so.
const BEYOND: f64 = 1.25;
/// Share of the gap by which a regime must exceed its share of time to be named.
const EXCESS: f64 = 0.1;
/// What a verdict is made of.
pub(super) struct Told<'a> {
    pub(super) data: &'a Data,
    pub(super) found: &'a Causes,
    pub(super) beside: &'a Beside,
    pub(super) seed: u64,
}

/// RMS difference of repeated runs over root two, rad, mean over the joints; `None` without repeats.
fn repeats_rad(data: &Data) -> Option<f64> {
    let mut joints: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for (i, a) in data.runs.iter().enumerate() {
        let Some(b) = data.runs[..i].iter().find(|b| b.repeat == a.repeat) else {
            continue;
        };
        for (k, (x, y)) in a.joints.iter().zip(&b.joints).enumerate() {
            if let (Some(x), Some(y)) = (&x.position, &y.position) {
                let d: Vec<f64> = x.t_s.iter().zip(&x.v).map(|(t, v)| v - y.at(*t)).collect();
                let own = joints.entry(k).or_default();
                own.push(math::rms(&d) / 2.0_f64.sqrt());
            }
        }
    }
    let each: Vec<f64> = joints.values().map(|all| math::median(all)).collect();
    (!each.is_empty()).then(|| math::mean(&each))
}

/// An error before and after; `None` where it was not measured.
type Channel = fn(&RegimeRow) -> Option<[f64; 2]>;

/// The regime of the motion in which the error of joint `k` falls most above its share of the time; where it does not fall, in
/// which most of it stays.
fn regime(rows: &[RegimeRow], k: usize) -> &'static str {
    let own: Vec<&RegimeRow> = rows
        .iter()
        .filter(|r| r.joint == Some(k) && r.aspect == Aspect::Motion)
        .collect();
    let channels: [Channel; 2] = [|r| r.position_rmse_rad, |r| r.effort_rmse_nm];
    let squares = |of: &Channel| -> Vec<[f64; 2]> {
        let one = |r: &&RegimeRow| of(r).map_or([0.0; 2], |e| e.map(|x| r.time * x * x));
        own.iter().map(one).collect()
    };
    let fall = |all: &[[f64; 2]]| {
        let [before, after] = [0, 1].map(|i| all.iter().map(|x| x[i]).sum::<f64>());
        1.0 - after / before.max(1e-30)
    };
    let both = channels.iter().map(squares);
    let Some(best) = both.max_by(|a, b| fall(a).total_cmp(&fall(b))) else {
        return "all";
    };
    let gained = fall(&best) > 0.0;
    let gap = |x: &[f64; 2]| if gained { x[0] - x[1] } else { x[1] };
    let all: f64 = best.iter().map(gap).sum();
    let excess = |i: usize| gap(&best[i]) / all.max(1e-30) - own[i].time;
    let most = (0..own.len()).max_by(|a, b| excess(*a).total_cmp(&excess(*b)));
    most.filter(|i| excess(*i) > EXCESS)
        .map_or("all", |i| own[i].regime)
}

impl Told<'_> {
    fn metric(&self) -> &'static str {
        let named = !self.found.causes.is_empty();
        parts::metric(&PRIMARY, &self.found.held_out.errors, named).unwrap_or(PRIMARY[1])
    }

    /// Error below which a metric tells nothing, and where that comes from.
    fn floor(&self, metric: &str) -> (f64, &'static str) {
        let repeats = repeats_rad(self.data).filter(|_| metric == PRIMARY[1]);
        let noise = self.beside.noise.get(metric).copied();
        match (metric, repeats) {
            (_, Some(spread)) => (spread, "repeats"),
            ("pose_rmse_m", _) => (noise.unwrap_or(0.0), "tolerance"),
            _ => (noise.unwrap_or(0.0), "noise"),
        }
    }

    fn gap(&self, metric: &'static str) -> Gap {
        let held_out = &self.found.held_out;
        let by_run = held_out.parts.by_run.get(metric);
        parts::gap(
            (metric, &held_out.errors),
            self.floor(metric),
            (&held_out.runs, by_run.map_or(&[], |v| v)),
            self.seed,
        )
    }

    fn probabilities(&self) -> Probabilities {
        let named = self.found.causes.iter().any(|r| r.effect.is_some());
        parts::probabilities(self.found.probabilities, named)
    }

    /// One row a joint of each cause that an effect of the library has.
    fn effects(&self, metric: &'static str) -> Vec<EffectRow> {
        let named = self.found.causes.iter().filter(|r| r.effect.is_some());
        let all: Vec<_> = named.map(|r| (r, r.parts())).collect();
        parts::effects(&all, self.probabilities(), metric)
    }

    fn ambiguous(&self) -> Vec<Ambiguous> {
        let by = |effects: &[Effect]| advice::separate_by(effects, self.beside.echoed);
        parts::ambiguous(&self.found.causes, &by)
    }

    fn places(&self) -> Vec<Where> {
        let rows = &self.found.held_out.parts.regimes;
        let one = |p: &causes::Place| Where {
            stage: p.stage.into(),
            joint: p.joint,
            regime: p.joint.map_or("all", |k| regime(rows, k)).into(),
            share: p.share,
            ci95: p.ci95.unwrap_or([0.0, 1.0]),
        };
        let mut out: Vec<Where> = self.found.places.iter().map(one).collect();
        if out.is_empty() {
            // Nothing is named: the gap is what stays.
            out.push(Where {
                stage: causes::UNEXPLAINED.into(),
                joint: None,
                regime: "all".into(),
                share: 1.0,
                ci95: [1.0, 1.0],
            });
        }
        out
    }

    /// The verdict.
    pub(super) fn verdict(&self) -> Verdict {
        let metric = self.metric();
        let gap = self.gap(metric);
        let word = match self.found.verdict {
            Found::None => Word::None,
            Found::Parametric => Word::Parametric,
            Found::PartlyExplained => Word::PartlyExplained,
            Found::Unknown => Word::Unknown,
        };
        let mut effects = self.effects(metric);
        let ambiguous = self.ambiguous();
        keep_together(&mut effects, &ambiguous);
        let place = self.places();
        let before_driver = [Stage::Transport.name(), Stage::Driver.name()];
        // What is left beside a cause that is named is as open as what is unknown.
        let open = match self.found.left.as_slice() {
            [] => word,
            _ => Word::Unknown,
        };
        let late = !self.beside.echoed && before_driver.contains(&place[0].stage.as_str());
        let errors = self.found.held_out.errors.iter();
        let metrics = errors
            .map(|(name, e)| ((*name).to_owned(), [e.before, e.calibrated, e.after]))
            .collect();
        let mut verdict = Verdict {
            schema: "rb.gap/1".into(),
            verdict: word,
            sentence: String::new(),
            partial: false,
            next_experiment: advice::next(&ambiguous, open, late),
            unseen: self.beside.unseen.clone(),
            pulled: BTreeMap::new(),
            displaced: Vec::new(),
            metrics,
            staircase: staircase(&gap, &self.found.causes, metric),
            gap,
            place,
            regimes: self.found.held_out.parts.regimes.clone(),
            effects,
            probabilities: self.probabilities(),
            ambiguous,
            provenance: Provenance {
                tool: concat!("rb-gap ", env!("CARGO_PKG_VERSION")).into(),
                commit: None,
                data_sha256: String::new(),
                seed: self.seed,
                split: self.found.held_out.split.clone(),
                wall_time_s: 0.0,
                warnings: Vec::new(),
            },
        };
        let off = body_off(&verdict.gap, BEYOND).filter(|_| word == Word::None);
        verdict.sentence = sentence(&verdict, true) + &off.unwrap_or_default();
        verdict
    }
}

/// The way down: each cause by itself.
fn staircase(gap: &Gap, rows: &[Row], metric: &str) -> Vec<Stair> {
    let stair = |step: String, gap: f64| Stair { step, gap };
    let mut out = vec![
        stair("before".into(), gap.before),
        stair("after calibration".into(), gap.after_calibration),
    ];
    for row in rows {
        let alone = row.alone.get(metric);
        if let (Some(effect), Some(alone)) = (row.effect, alone) {
            let list: Vec<String> = row.joints.iter().map(ToString::to_string).collect();
            let at = match list.as_slice() {
                [] => String::new(),
                [one] => format!(" joint {one}"),
                all => format!(" joints {}", all.join(", ")),
            };
            out.push(stair(format!("{effect}{at} alone"), *alone));
        }
    }
    out.push(stair("after".into(), gap.after));
    out
}
