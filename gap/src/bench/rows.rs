//! Causes in words and numbers: `rb.gap/2`.

use std::collections::BTreeMap;

use serde::Serialize;

use super::data::Data;
use super::diagnosis::HeldOut;
use super::library::{Hypothesis, Kind};
use super::search::Set;
use super::{Explained, shown};
use crate::decide::{CLASS, Calibration, LEVEL, MOST, ORDINARY, Shown};
use crate::evidence::cause::Scope;
use crate::names;
use crate::vocabulary::{Compound, Effect};
use crate::whole::{Alternative, Probabilities, Row, Value};

/// One word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Word {
    /// Nothing is there that joints without a cause do not show.
    None,
    /// Stated numbers beyond their tolerance, and as much is left as joints without a cause leave.
    Parametric,
    /// Causes are named, and as much is left as joints without a cause leave.
    Explained,
    /// Causes are named, and more is left.
    PartlyExplained,
    /// What is there has no effect's shape, or too little is stated.
    Unknown,
}

/// The causes of a joint's gap.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Causes {
    /// Always `rb.gap/2`.
    pub schema: &'static str,
    /// One word.
    pub verdict: Word,
    /// One sentence.
    pub sentence: String,
    /// Causes, strongest first.
    pub causes: Vec<Row>,
    /// None and unknown.
    pub probabilities: Probabilities,
    /// How far the gap shrinks on runs that no fit saw.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held_out: Option<HeldOut>,
    /// Keys of `dataset.toml` without which no cause can be named.
    pub to_state: Vec<&'static str>,
    /// Chance that a joint without a cause leaves as much.
    pub remainder_p: Option<f64>,
    /// Evidence that a cause must add at least; each is asked for its own. How many joints without a cause say so.
    pub least_evidence: f64,
    /// How many.
    pub null_joints: usize,
}

/// A cause that a signal shows by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Read {
    pub(super) effect: Effect,
    key: &'static str,
    value: f64,
    error: f64,
    pub(super) evidence: f64,
}

impl Read {
    pub(super) fn new(
        effect: Effect,
        key: &'static str,
        [value, error]: [f64; 2],
        evidence: f64,
    ) -> Self {
        Self {
            effect,
            key,
            value,
            error,
            evidence,
        }
    }

    fn row(&self, data: &Data<'_>, calibration: &Calibration) -> Row {
        let shown = shown(data, Kind::One(self.effect));
        let p_value = calibration.p_value(&shown, self.evidence);
        let off = 1.96 * self.error;
        let value = Value {
            value: self.value,
            ci95: [self.value - off, self.value + off],
            by_joint: BTreeMap::from([(0, self.value)]),
        };
        let robot = !self.effect.info().per_joint();
        Row {
            effect: Some(self.effect.name()),
            stage: Some(self.effect.stage().name()),
            scope: if robot { Scope::Robot } else { Scope::Joint },
            joints: if robot { Vec::new() } else { vec![0] },
            kind: "structural",
            values: BTreeMap::from([(self.key, value)]),
            probability: 1.0 - p_value,
            p_value,
            evidence: self.evidence,
            asked: calibration.ask(&shown),
            alternatives: Vec::new(),
            without: BTreeMap::new(),
            alone: BTreeMap::new(),
        }
    }
}

/// Alternatives that are listed.
const LISTED: usize = 5;

impl Causes {
    pub(super) fn too_little(missing: Vec<&'static str>, calibration: &Calibration) -> Self {
        Self {
            schema: "rb.gap/2",
            verdict: Word::Unknown,
            sentence: format!(
                "Too little is stated to name a cause; state {} in dataset.toml.",
                missing.join(", ")
            ),
            causes: Vec::new(),
            probabilities: Probabilities {
                none: 0.0,
                unknown: 1.0,
            },
            held_out: None,
            to_state: missing,
            remainder_p: None,
            least_evidence: calibration.ask(&Shown::default()),
            null_joints: calibration.strongest.len(),
        }
    }
}

/// Value of a parameter at which its cause is not there.
fn neutral(kind: Kind, key: &str) -> f64 {
    match kind {
        Kind::One(effect) => {
            let own = effect.parameters().iter().find(|p| p.key == key);
            own.map_or(0.0, |p| p.neutral)
        }
        _ if key.ends_with("ratio") => 1.0,
        _ => 0.0,
    }
}

/// The values of a hypothesis: their deviations by slopes along the set's coordinates, and those of a law that is off
/// by a share of the size.
fn values(e: &Explained<'_>, set: &Set, h: &Hypothesis, law: f64) -> BTreeMap<&'static str, Value> {
    let read = |x: &[f64]| -> Vec<(&'static str, f64)> {
        let point = set.fit.model.point(x);
        match &h.candidate {
            Some(c) => names::parameters(&e.data.problem, c, &point.params),
            None => h
                .coordinates
                .iter()
                .map(|c| (key(h, c.axis), point.get(c.axis)))
                .collect(),
        }
    };
    let here = read(&set.fit.x);
    let n = set.fit.x.len();
    let covariance = set.fit.covariance();
    let mut slopes = vec![vec![0.0; n]; here.len()];
    for j in 0..n {
        let step = set.fit.model.coordinates[j].step(set.fit.x[j]);
        let mut moved = set.fit.x.clone();
        moved[j] += step;
        for (k, (_, v)) in read(&moved).iter().enumerate() {
            slopes[k][j] = (v - here[k].1) / step;
        }
    }
    here.iter()
        .zip(&slopes)
        .map(|((key, value), g)| {
            let mut variance = 0.0;
            for i in 0..n {
                for j in 0..n {
                    variance += g[i] * g[j] * covariance[i * n + j];
                }
            }
            // What gives without end is not there: a law is linear in one over a stiffness.
            let neutral = neutral(h.kind, key);
            let size = value - if neutral.is_finite() { neutral } else { 0.0 };
            let off = 1.96 * libm::hypot(variance.max(0.0).sqrt(), law * size);
            let value = Value {
                value: *value,
                ci95: [value - off, value + off],
                by_joint: BTreeMap::from([(0, *value)]),
            };
            (*key, value)
        })
        .collect()
}

/// Keys of compounds, which the vocabulary does not name.
fn key(h: &Hypothesis, axis: super::model::Axis) -> &'static str {
    use super::model::Axis;
    use crate::joint::P;
    let payload = h.kind == super::library::Kind::Many(Compound::Payload);
    match (payload, axis) {
        (true, Axis::Joint(P::Inertia)) => "inertia_ratio",
        (true, _) => "ratio",
        (_, Axis::Joint(P::Supply)) => "supply_ratio",
        (_, Axis::Joint(P::Sag)) => "resistance_ohm",
        _ => "ratio",
    }
}

impl Explained<'_> {
    fn row(&self, i: usize, calibration: &Calibration) -> Row {
        let set = &self.found.best;
        let h = &self.search.hypotheses[set.members[i]];
        let scope = |h: &Hypothesis| {
            if h.kind.of_robot() {
                Scope::Robot
            } else {
                Scope::Joint
            }
        };
        let joints = |h: &Hypothesis| {
            if h.kind.of_robot() {
                Vec::new()
            } else {
                vec![0]
            }
        };
        let mut seen = vec![h.kind];
        let mut alternatives = Vec::new();
        for r in &self.found.rivals[i] {
            let other = &self.search.hypotheses[r.hypothesis];
            if seen.contains(&other.kind) {
                continue;
            }
            seen.push(other.kind);
            alternatives.push(Alternative {
                effect: Some(other.kind.name()),
                scope: scope(other),
                joints: joints(other),
                margin: r.margin,
                distinguishable: r.margin > CLASS,
            });
        }
        alternatives.truncate(LISTED);
        let evidence = self.found.gains[i];
        let shown = shown(&self.data, h.kind);
        let p_value = calibration.p_value(&shown, evidence);
        let others: f64 = alternatives
            .iter()
            .map(|a| libm::exp(-a.margin.max(-20.0)))
            .sum();
        Row {
            effect: Some(h.kind.name()),
            stage: Some(h.kind.stage().name()),
            scope: scope(h),
            joints: joints(h),
            kind: if h.kind.parametric() {
                "parametric"
            } else {
                "structural"
            },
            values: values(self, set, h, calibration.law(h.kind.stage())),
            probability: (1.0 - p_value) / (1.0 + others),
            p_value,
            evidence,
            asked: calibration.ask(&shown),
            alternatives,
            without: BTreeMap::new(),
            alone: BTreeMap::new(),
        }
    }

    /// Causes that a signal shows by itself and that have the evidence that is asked.
    pub(super) fn named(&self, calibration: &Calibration) -> Vec<Read> {
        let asked = |r: &Read| calibration.ask(&shown(&self.data, Kind::One(r.effect)));
        let read = self.transport.read.iter();
        read.filter(|r| r.evidence > asked(r)).copied().collect()
    }

    /// Causes in words and numbers, decided by `calibration`.
    pub(super) fn rows(&self, calibration: &Calibration) -> Causes {
        let members = 0..self.found.best.members.len();
        let mut named: Vec<(Row, String)> = members
            .map(|i| {
                let kind = self.search.hypotheses[self.found.best.members[i]].kind;
                (self.row(i, calibration), kind.plain())
            })
            .collect();
        let strong = self.named(calibration);
        let strong = strong.iter();
        let row = |r: &Read| (r.row(&self.data, calibration), r.effect.plain().to_owned());
        named.extend(strong.map(row));
        named.sort_by(|a, b| b.0.evidence.total_cmp(&a.0.evidence));
        let (causes, plain): (Vec<Row>, Vec<String>) = named.into_iter().unzip();
        let remainder_p = self.remainder.p_value(calibration);
        let more = remainder_p < LEVEL;
        let ordinary = remainder_p >= ORDINARY;
        let verdict = match causes.first() {
            _ if more && (causes.is_empty() || self.remainder.share > MOST) => Word::Unknown,
            None => Word::None,
            Some(_) if !ordinary => Word::PartlyExplained,
            Some(_) if causes.iter().all(|r| r.kind == "parametric") => Word::Parametric,
            Some(_) => Word::Explained,
        };
        let nearest = |(kind, adds)| calibration.p_value(&shown(&self.data, kind), adds);
        let none = match self.found.next {
            Some(next) if causes.is_empty() => nearest(next),
            None if causes.is_empty() => 1.0,
            _ => 0.0,
        };
        let unknown = if verdict == Word::Unknown {
            1.0 - none
        } else {
            0.0
        };
        Causes {
            schema: "rb.gap/2",
            verdict,
            sentence: sentence(verdict, &plain, more),
            causes,
            probabilities: Probabilities { none, unknown },
            held_out: None,
            to_state: Vec::new(),
            remainder_p: Some(remainder_p),
            least_evidence: self.least(calibration),
            null_joints: calibration.strongest.len(),
        }
    }

    /// The least that is asked of any cause.
    fn least(&self, calibration: &Calibration) -> f64 {
        let all = self.search.hypotheses.iter();
        let asks = all.map(|h| calibration.ask(&shown(&self.data, h.kind)));
        asks.fold(f64::INFINITY, f64::min)
    }
}

/// `more`: no joint without a cause leaves as much.
fn sentence(word: Word, causes: &[String], more: bool) -> String {
    let list = causes.join("; ");
    match word {
        Word::None => "No cause shows that joints without a cause do not show as well.".into(),
        Word::Unknown => {
            "More is left than joints without a cause leave, and no effect explains it.".into()
        }
        Word::Parametric | Word::Explained => format!("Causes, strongest first: {list}."),
        Word::PartlyExplained => {
            let joints = if more { "joints" } else { "most joints" };
            format!(
                "Causes, strongest first: {list}. More is left than {joints} without a cause leave."
            )
        }
    }
}
