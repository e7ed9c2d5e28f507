//! What to record next: the motion whose play the causes found and their rivals explain least alike.

use super::Explained;
use super::data::Data;
use super::diagnosis::Diagnosis;
use super::fit::Fit;
use super::model::{Model, Point};
use super::noise::Noise;
use super::rows::Word;
use super::search::model_error;
use crate::experiment::{self, Experiment};
use crate::joint::{Channel, Problem};
use crate::math::{Rng, mean, rms};
use crate::names;
use crate::report::words::listed;
use crate::verdict::{Ambiguous, NextExperiment};
use crate::vocabulary::Effect;

/// Steps of the fit of a rival to a play.
const STEPS: usize = 5;

/// Noise that a channel would have which this data set lacks, as a share of its spread: what two honest simulators of one
/// law differ by there (see [`crate::floor`]).
fn expected(c: Channel) -> f64 {
    match c {
        Channel::Link => 5e-4,
        Channel::Duty => 0.01,
        _ => 0.05,
    }
}

fn column(problem: &Problem, c: Channel) -> impl Iterator<Item = f64> {
    let rows = problem.runs.iter().flat_map(|r| &r.samples);
    rows.map(move |s| s.measured[c as usize])
}

/// A joint and where its fit starts.
type Start = (Model, Point);

/// What a play is judged with.
struct Judge<'a> {
    e: &'a Explained<'a>,
    truth: Start,
    rivals: Vec<Start>,
    seed: u64,
}

impl Judge<'_> {
    /// Standard deviation of the noise of a channel: what the causes leave of it in the recordings, or what is expected.
    fn noise(&self, played: &Problem, c: Channel) -> f64 {
        let data = &self.e.data;
        match data.channels.iter().position(|k| *k == c as usize) {
            Some(k) => {
                let errors = &self.e.found.best.fit.errors[data.series(k)];
                let all: Vec<f64> = errors.iter().flatten().copied().collect();
                rms(&all).max(data.own_noise(k))
            }
            None => {
                let all: Vec<f64> = column(played, c).collect();
                let middle = mean(&all);
                let off: Vec<f64> = all.iter().map(|x| x - middle).collect();
                expected(c) * rms(&off)
            }
        }
    }

    /// Standard deviations between the joint and the rival that explains a play of it best.
    fn separation(&self, mut played: Problem, added: &[Channel]) -> f64 {
        let known = |c: &Channel| self.e.data.channels.contains(&(*c as usize));
        let used = Channel::ALL.into_iter();
        let used: Vec<Channel> = used.filter(|c| known(c) || added.contains(c)).collect();
        let mut rng = Rng::new(self.seed);
        for c in Channel::ALL {
            let noise = self.noise(&played, c);
            let rows = played.runs.iter_mut().flat_map(|r| &mut r.samples);
            for s in rows {
                let y = &mut s.measured[c as usize];
                *y = if used.contains(&c) {
                    *y + noise * rng.normal()
                } else {
                    f64::NAN
                };
            }
        }
        let channels = used.iter().map(|c| *c as usize).collect();
        let data = Data::of(played, channels, self.e.data.stop);
        let errors = data.errors(&[self.truth.1]).remove(0);
        let noise = Noise::new(&data, &errors, &[], model_error(self.e.search.spreads));
        let cost = |(model, start): &Start| {
            Fit::new(&data, &noise, model.clone(), &model.start(start), STEPS).cost
        };
        let least = self.rivals.iter().map(cost).fold(f64::INFINITY, f64::min);
        (2.0 * (least - cost(&self.truth)).max(0.0)).sqrt()
    }
}

/// The judge of a class: the causes found, and each with a rival of one of them in its place.
fn judge<'a>(e: &'a Explained<'a>, class: &Ambiguous, seed: u64) -> Option<Judge<'a>> {
    let best = &e.found.best;
    let kind = |h: usize| e.search.hypotheses[h].kind.name();
    let member = class.effects.first()?.name();
    let at = best.members.iter().position(|m| kind(*m) == member)?;
    let rivals = e.found.rivals.get(at)?.iter();
    let own = rivals.filter(|r| class.effects.iter().any(|e| e.name() == kind(r.hypothesis)));
    let rivals = own.map(|r| {
        let mut members = best.members.clone();
        members[at] = r.hypothesis;
        (e.search.model(&members), r.point)
    });
    Some(Judge {
        e,
        truth: (e.search.model(&best.members), best.fit.point()),
        rivals: rivals.collect(),
        seed,
    })
}

fn list(effects: &[Effect]) -> String {
    let names: Vec<&str> = effects.iter().map(|e| e.plain()).collect();
    listed(&names, names.len(), "and")
}

/// The next experiment: what tells the first class apart, else what shows more of a gap that nothing explains, or whose
/// causes are `tentative`.
pub(super) fn proposed(
    d: &Diagnosis,
    e: &Explained<'_>,
    tentative: bool,
    seed: u64,
) -> (Option<Experiment>, Option<NextExperiment>) {
    let word = d.causes.verdict;
    let left = matches!(word, Word::Unknown | Word::PartlyExplained);
    let open = left || (tentative && word != Word::None);
    let (experiment, separates, advice) = match d.verdict.ambiguous.first() {
        Some(class) => {
            let judge = judge(e, class, seed).filter(|j| !j.rivals.is_empty());
            let best = match judge {
                None => experiment::survey(&d.problem),
                Some(judge) => experiment::separating(&d.problem, &d.found.params, &|p, added| {
                    judge.separation(p, added)
                }),
            };
            let advice = format!(
                "To distinguish {}: {}.",
                list(&class.effects),
                names::separate_by(&class.effects, &d.problem)
            );
            (best, class.effects.clone(), advice)
        }
        None if open => {
            let advice = "Record signed current, duty and bus voltage at 100 Hz; they tell the driver, the electrical part and the gear apart.";
            (experiment::survey(&d.problem), Vec::new(), advice.into())
        }
        None => return (None, None),
    };
    let text = match &experiment {
        Some(e) if e.separation.is_some() => experiment::words(e, &separates, d.problem.linear),
        Some(e) => {
            let motion = experiment::words(e, &separates, d.problem.linear);
            format!("{motion} {advice}")
        }
        None => advice,
    };
    let next = NextExperiment {
        text,
        separates,
        gait: None,
    };
    (experiment, Some(next))
}
