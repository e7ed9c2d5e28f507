//! The verdict: the public JSON contract `rb.gap/1`.

pub(crate) mod causes;

use std::collections::BTreeMap;

use serde::Serialize;

use crate::regimes::RegimeRow;
use crate::vocabulary::{Compound, Effect};

/// One word for the whole.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Word {
    /// The effects found explain the gap down to the floor.
    Explained,
    /// They explain a part of it.
    PartlyExplained,
    /// Only base parameters are off by more than their tolerance.
    Parametric,
    /// The model explains the data to the floor.
    #[default]
    None,
    /// A significant remainder that no known effect explains.
    Unknown,
}

/// A value with its 95 % interval.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Estimate {
    /// Best value.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
}

/// The primary metric before and after.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Gap {
    /// Name of the metric.
    pub metric: String,
    /// Its unit.
    pub unit: String,
    /// Nominal model.
    pub before: f64,
    /// Known parameters calibrated within their tolerances, unknown ones fitted.
    pub after_calibration: f64,
    /// With the effects found.
    pub after: f64,
    /// Repeats of the hardware, else the stated noise estimate, or what a piece that starts from measured states may be off by.
    pub floor: f64,
    /// Where the floor comes from: `repeats`, `noise` or `tolerance`.
    pub floor_source: String,
    /// 95 % interval of `after` over held-out runs.
    pub ci95_after: [f64; 2],
    /// 1 - after/before.
    pub shrink: f64,
    /// 1 - after/after_calibration.
    pub shrink_after_calibration: f64,
    /// (before - after)/(before - floor); null without repeats.
    pub shrink_of_achievable: Option<f64>,
    /// Runs the figures were taken on.
    pub held_out_runs: Vec<String>,
}

/// A share of the gap.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Where {
    /// Stage, or `unexplained`.
    pub stage: String,
    /// Joint; null for shared stages.
    pub joint: Option<usize>,
    /// Regime in which most of it sits.
    pub regime: String,
    /// Share of the gap of section "before".
    pub share: f64,
    /// 95 % interval over runs.
    pub ci95: [f64; 2],
}

/// A rival of an effect.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Alternative {
    /// Which.
    pub effect: Effect,
    /// Whether this data can tell them apart.
    pub distinguishable: bool,
    /// How much worse the rival explains the data, in standard deviations.
    pub margin: f64,
}

/// An effect found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EffectRow {
    /// Which.
    pub effect: Effect,
    /// The one cause that has this effect beside others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub part_of: Option<Compound>,
    /// Its stage.
    pub stage: String,
    /// Its joint.
    pub joint: Option<usize>,
    /// Its parameters.
    pub parameters: BTreeMap<String, Estimate>,
    /// Probability; all of them, `none` and `unknown` sum to 1.
    pub confidence: f64,
    /// Rivals.
    pub alternatives: Vec<Alternative>,
    /// Gap with this effect alone on top of the calibrated model.
    pub gap_added_alone: f64,
    /// Gap with all effects but this one.
    pub gap_removed_from_full: f64,
    /// `structural` or `parametric`.
    pub kind: String,
    /// Whether the value is physically plausible.
    pub plausible: bool,
}

/// Probabilities of the verdicts that are no effects.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Probabilities {
    /// No gap beyond the floor.
    pub none: f64,
    /// Something outside the library.
    pub unknown: f64,
}

/// An effect that this data could never show.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Unseen {
    /// Which.
    pub effect: Effect,
    /// Why.
    pub why: String,
}

/// A member of a class that this data cannot separate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Member {
    /// Which.
    pub effect: Effect,
    /// Its stage.
    pub stage: String,
    /// Its joint.
    pub joint: Option<usize>,
    /// Its share of the class's probability.
    pub probability: f64,
}

/// A class of effects that this data cannot separate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Ambiguous {
    /// Names, most probable first.
    pub effects: Vec<Effect>,
    /// Members in full.
    pub members: Vec<Member>,
    /// What would separate them.
    pub separate_by: String,
}

/// Notes in `rows` which rivals stand in one of the `classes` with the effect: how much worse a rival fits does not tell them apart there.
pub(crate) fn keep_together(rows: &mut [EffectRow], classes: &[Ambiguous]) {
    for row in rows {
        let own = |m: &Member| (m.effect, m.joint) == (row.effect, row.joint);
        let Some(class) = classes.iter().find(|c| c.members.iter().any(own)) else {
            continue;
        };
        for rival in &mut row.alternatives {
            rival.distinguishable &= !class.effects.contains(&rival.effect);
        }
    }
}

/// A nominal value that calibration took beyond its tolerance, with no effect of that name found: the model reaches its
/// error only so. It takes the place of whatever the data shows, as its own effect or as an equivalent of another.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Displaced {
    /// The base effect whose parameter it is.
    pub effect: Effect,
    /// Its stage.
    pub stage: String,
    /// Its joint.
    pub joint: Option<usize>,
    /// Ratio to the stated value; an effort where none was stated.
    pub value: f64,
    /// Distance from the stated value, in tolerances.
    pub tolerances: f64,
}

/// The next experiment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NextExperiment {
    /// What to do.
    pub text: String,
    /// What it separates.
    pub separates: Vec<Effect>,
    /// File with the motion, written beside the report; null when none is needed.
    pub gait: Option<String>,
}

/// Gap after each step of the search.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Stair {
    /// What was added.
    pub step: String,
    /// Primary metric on the held-out runs.
    pub gap: f64,
}

/// Where the figures come from.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Provenance {
    /// Tool and version.
    pub tool: String,
    /// Commit of the tool, if known.
    pub commit: Option<String>,
    /// SHA-256 over the files of the data set.
    pub data_sha256: String,
    /// Seed.
    pub seed: u64,
    /// How runs were split.
    pub split: String,
    /// Wall time, s.
    pub wall_time_s: f64,
    /// What the reader of the data set left out or assumed, such as a key that it does not know.
    pub warnings: Vec<String>,
}

/// The verdict.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Verdict {
    /// Always `rb.gap/1`.
    pub schema: String,
    /// One word.
    pub verdict: Word,
    /// One sentence for a tired person.
    pub sentence: String,
    /// True when a limit stopped the search early.
    pub partial: bool,
    /// Primary metric.
    pub gap: Gap,
    /// All metrics: name -> before, after calibration, after.
    pub metrics: BTreeMap<String, [f64; 3]>,
    /// The way down.
    pub staircase: Vec<Stair>,
    /// Where.
    #[serde(rename = "where")]
    pub place: Vec<Where>,
    /// Errors by joint and regime of the motion, before and after.
    pub regimes: Vec<RegimeRow>,
    /// Which.
    pub effects: Vec<EffectRow>,
    /// None and unknown.
    pub probabilities: Probabilities,
    /// What this data could not show.
    pub unseen: Vec<Unseen>,
    /// What it could not separate.
    pub ambiguous: Vec<Ambiguous>,
    /// What to record next.
    pub next_experiment: Option<NextExperiment>,
    /// Nominal parameters after calibration that left three sigma of their tolerance.
    pub pulled: BTreeMap<String, f64>,
    /// Those of them that are the parameter of a base effect, by the effect's name, beyond three tolerances of all that is stated.
    pub displaced: Vec<Displaced>,
    /// Provenance.
    pub provenance: Provenance,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stands_in_one_class_is_not_told_apart() {
        let rival = |effect| Alternative {
            effect,
            distinguishable: true,
            margin: 5.5,
        };
        let mut rows = [EffectRow {
            part_of: None,
            effect: Effect::Backlash,
            stage: Effect::Backlash.stage().name().into(),
            joint: Some(0),
            parameters: BTreeMap::new(),
            confidence: 0.6,
            alternatives: vec![rival(Effect::Deadband), rival(Effect::Quantisation)],
            gap_added_alone: 0.0,
            gap_removed_from_full: 0.0,
            kind: "structural".into(),
            plausible: true,
        }];
        let member = |effect: Effect| Member {
            effect,
            stage: effect.stage().name().into(),
            joint: Some(0),
            probability: 0.5,
        };
        let class = Ambiguous {
            effects: vec![Effect::Backlash, Effect::Deadband],
            members: vec![member(Effect::Backlash), member(Effect::Deadband)],
            separate_by: String::new(),
        };
        keep_together(&mut rows, &[class]);
        let told: Vec<bool> = rows[0]
            .alternatives
            .iter()
            .map(|a| a.distinguishable)
            .collect();
        assert_eq!(told, [false, true]);
    }
}
