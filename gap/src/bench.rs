//! Causes of the gap of one joint on a bench, by the likelihood of [`crate::evidence`].
//!
//! The joint is played from the set-points that reached its driver, through controller, motor, gear and load
//! ([`crate::joint`]); measured positions correct it, so that rows are predicted over the horizon at which they are
//! likeliest. Every measured signal gives prediction errors ([`data`]), which a model of their own correlation whitens
//! ([`noise`]). A cause is a few parameters with priors ([`library`]); all are scanned around a fit ([`scan`]). A set of
//! causes is fitted with all stated numbers free within their tolerances, and weighed by Laplace's evidence under the
//! noise that it leaves ([`fit`], [`search`]). Set-points on their way to the driver are weighed where it echoes them
//! ([`transport`]); their losses show without an echo too ([`lost`]).

mod data;
mod diagnosis;
mod fit;
mod healthy;
mod library;
mod lost;
mod model;
mod next;
mod noise;
mod refit;
mod remainder;
mod rows;
mod scan;
mod search;
mod split;
mod stated;
mod transport;
mod verdict;

use std::collections::BTreeMap;

use files::dataset::{Manifest, Output, Recording};

pub use diagnosis::{Diagnosis, HeldOut, Settings, diagnose, predicted};
pub use healthy::Differ;
pub use rows::{Causes, Word};
pub(crate) use stated::missing;

use crate::decide::{CLASS, Calibration, Shown};
use crate::evidence::block::White;
use crate::evidence::ensemble::Spreads;
use crate::joint::nominal::nominal;
use crate::locate::State;
use crate::vocabulary::Effect;
use crate::watch::Watch;
use data::Data;
use library::Kind;
use search::{Found, Known, Search, Set};
use transport::Transport;

/// Why a joint cannot be diagnosed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum BenchError {
    /// No run has a position.
    #[error("no run measured position; record position_rad (or _m) to get a diagnosis")]
    NoPosition,
    /// Nothing to fit.
    #[error("no run with role \"fit\" measured position; give at least one run role = \"fit\"")]
    NoFitRuns,
    /// No run has both set-points and positions.
    #[error("no run has set-points and positions; record setpoint_rad and position_rad (or _m)")]
    Nothing,
}

/// What is asked.
struct Asked<'s, 'a> {
    manifest: &'s Manifest,
    recordings: &'s [Recording],
    withhold: &'s [Effect],
    /// What a cause must add; without it none does.
    calibration: Option<&'s Calibration>,
    /// The joint as it was diagnosed before.
    baseline: Option<State>,
    watch: Watch<'a>,
}

impl Asked<'_, '_> {
    /// What a cause must add where these signals were measured.
    fn ask(&self, data: &Data<'_>, kind: Kind) -> f64 {
        self.calibration
            .map_or(f64::INFINITY, |c| c.ask(&shown(data, kind)))
    }
}

/// A cause as a calibration knows it: its effect, or its name where it has none, and what the joint's controller puts out.
fn shown(data: &Data<'_>, kind: Kind) -> Shown {
    let output = data.problem.runs.first().map(|r| r.nominal.output);
    let by = output.map_or("", drive_of);
    match kind {
        Kind::One(effect) => Shown::new(Some(effect), by),
        other => Shown::new(None, &format!("{} {by}", other.name())),
    }
}

fn drive_of(output: Output) -> &'static str {
    match output {
        Output::Duty => "duty",
        Output::Voltage => "voltage",
        Output::Effort => "effort",
        Output::Velocity => "velocity",
    }
}

/// What a joint's controller puts out, as `dataset.toml` spells it: healthy joints are compared with their like.
#[must_use]
pub fn drive(manifest: &Manifest) -> &'static str {
    drive_of(nominal(&manifest.bench).output)
}

/// What was found, with all it was made of.
struct Explained<'a> {
    data: Data<'a>,
    /// The recordings of the data.
    recordings: Vec<Recording>,
    transport: Transport,
    search: Search<'a>,
    /// Without a cause, and with the causes.
    bare: Set,
    found: Found,
    remainder: remainder::Remainder,
}

/// A joint fitted without a cause.
struct Bare<'a> {
    data: Data<'a>,
    recordings: Vec<Recording>,
    transport: Transport,
    search: Search<'a>,
    bare: Set,
}

impl<'a> Bare<'a> {
    /// The joint over whole runs.
    fn new(asked: &Asked<'_, 'a>, known: Known<'a>) -> Result<Self, BenchError> {
        let error = search::model_error(known.spreads);
        let transport = Transport::new(asked.manifest, asked.recordings, asked.withhold, error);
        let recordings = transport.cut.clone();
        Self::of(asked, known, &recordings, transport).ok_or(BenchError::Nothing)
    }

    fn of(
        asked: &Asked<'_, 'a>,
        known: Known<'a>,
        recordings: &[Recording],
        transport: Transport,
    ) -> Option<Self> {
        let data = Data::new(asked.manifest, recordings, asked.watch.wish())?;
        let mut search = Search::new(&data, asked, transport.cut_off(), known);
        let bare = search.bare(&data);
        Some(Self {
            data,
            recordings: recordings.to_vec(),
            transport,
            search,
            bare,
        })
    }

    /// The same over another horizon.
    fn over(&self, data: Data<'a>, search: Search<'a>, bare: Set) -> Self {
        Self {
            recordings: self.recordings.clone(),
            transport: self.transport.clone(),
            data,
            search,
            bare,
        }
    }

    /// Logarithm of the likelihood of the joint with a set.
    fn total(&self, set: &Set) -> f64 {
        self.search.noise.log_likelihood() + set.evidence
    }

    /// The same with the set-points that arrived, if some are lost that no echo shows: more than joints without a cause
    /// seem to lose around `set`.
    fn without_losses(&self, asked: &Asked<'_, 'a>, known: Known<'a>, set: &Set) -> Option<Self> {
        let read = |e: &rows::Read| e.effect == Effect::PacketLoss;
        let known_already = self.transport.echoed || self.transport.read.iter().any(read);
        if known_already || asked.withhold.contains(&Effect::PacketLoss) || self.data.stop.asked() {
            return None;
        }
        let (cut, point) = (&self.transport.cut, set.fit.point());
        let lost = lost::lost(asked.manifest, cut, &self.data, &point)?;
        let least = asked.ask(&self.data, Kind::One(Effect::PacketLoss));
        if lost.read.evidence <= least.min(LEAST_LOST) {
            return None;
        }
        let mut again = Self::of(asked, known, &lost.arrived, self.transport.clone())?;
        again.transport.read.push(lost.read);
        Some(again)
    }

    /// The joint and a set over the horizon at which the joint is likeliest with it; `None` if that is the present one.
    fn likeliest(&self, set: &Set) -> Option<(Self, Set)> {
        let mut most = self.total(set);
        let mut out = None;
        for horizon_s in data::HORIZONS_S {
            let data = self.data.over(horizon_s);
            let (search, here) = self.search.around(&data, set);
            let total = search.noise.log_likelihood() + here.evidence;
            if total > most && !self.data.stop.asked() {
                most = total;
                out = Some((data, search, here));
            }
        }
        let (data, search, here) = out?;
        let bare = if here.members.is_empty() {
            here.clone()
        } else {
            search.set_at(&data, Vec::new(), &self.bare.fit.point())
        };
        Some((self.over(data, search, bare), here))
    }

    /// The joint without a cause over the horizon at which all hypotheses together could make it likeliest, fitted there
    /// from its start; `None` if around the present set they make it as likely. A loop that swings is out of step with
    /// whole runs, and no set of these leads to its cause.
    fn afresh(&self, asked: &Asked<'_, 'a>, known: Known<'a>) -> Option<Self> {
        let mut most = self.search.noise.reach() + CLASS;
        let mut out = None;
        for horizon_s in data::HORIZONS_S {
            let data = self.data.over(horizon_s);
            let cut = self.transport.cut_off();
            let search = Search::from(&data, asked, cut, known, self.search.start);
            let reach = search.noise.reach();
            if reach > most && !self.data.stop.asked() {
                most = reach;
                out = Some((data, search));
            }
        }
        let (data, mut search) = out?;
        let bare = search.bare(&data);
        Some(self.over(data, search, bare))
    }

    /// The joint over the horizon at which it is likeliest without a cause.
    fn nearest(self, asked: &Asked<'_, 'a>, known: Known<'a>) -> Self {
        let own = self.likeliest(&self.bare).map_or(self, |near| near.0);
        match own.afresh(asked, known) {
            Some(other) if other.total(&other.bare) > own.total(&own.bare) => other,
            _ => own,
        }
    }

    /// Searches for causes over whole runs, from those over the horizon at which the joint is likeliest with them, and
    /// afresh over the one at which all hypotheses could make it likelier still.
    fn found(mut self, asked: &Asked<'_, 'a>, known: Known<'a>) -> (Self, Found) {
        // What is asked depends on what was measured, not on the horizon.
        let data = self.data.clone();
        let ask = |kind| asked.ask(&data, kind);
        let mut found = self.search.run(&self.data, &self.bare, &ask, asked.watch);
        if let Some((mut near, set)) = self.likeliest(&found.best) {
            let mut other = near.search.run(&near.data, &set, &ask, asked.watch);
            let grown = found.steps.iter().cloned();
            other.steps = grown.chain(other.steps).collect();
            if other.partial {
                found.partial = true;
            } else if near.total(&other.best) > self.total(&found.best) {
                (self, found) = (near, other);
            }
        }
        if let Some(mut fresh) = self.afresh(asked, known) {
            let other = fresh
                .search
                .run(&fresh.data, &fresh.bare, &ask, asked.watch);
            if other.partial {
                found.partial = true;
            } else if fresh.total(&other.best) > self.total(&found.best) {
                (self, found) = (fresh, other);
            }
        }
        // Other horizons may not have been tried.
        found.partial |= self.data.stop.asked();
        (self, found)
    }
}

fn explain<'a>(asked: &Asked<'_, 'a>, known: Known<'a>) -> Result<Explained<'a>, BenchError> {
    let (mut own, mut found) = Bare::new(asked, known)?.found(asked, known);
    // Losses show around the causes; what they explain the search may explain better.
    if let Some(again) = own.without_losses(asked, known, &found.best) {
        let (again, other) = again.found(asked, known);
        if other.partial {
            found.partial = true;
        } else if again.total(&other.best) > own.total(&found.best) {
            (own, found) = (again, other);
        }
    }
    let [before, after] = [&own.bare, &found.best].map(|s| s.fit.point());
    let remainder = remainder::remainder(&own.data, &before, &after);
    Ok(Explained {
        remainder,
        data: own.data,
        recordings: own.recordings,
        transport: own.transport,
        search: own.search,
        bare: own.bare,
        found,
    })
}

/// Evidence from which losses are taken out before the search of what else is there; a joint without a cause of a
/// calibration takes them out too.
const LEAST_LOST: f64 = 8.0;

/// The causes of a joint's gap, decided by `calibration`.
///
/// # Errors
/// A data set without set-points or positions.
pub fn name_causes(
    manifest: &Manifest,
    recordings: &[Recording],
    withhold: &[Effect],
    calibration: &Calibration,
) -> Result<Causes, BenchError> {
    let missing = stated::missing(manifest);
    if !missing.is_empty() {
        return Ok(Causes::too_little(missing, calibration));
    }
    let settings = Settings {
        withhold: withhold.to_vec(),
        ..Settings::default()
    };
    let found = diagnose(manifest, recordings, &settings, calibration, Watch::NOBODY)?;
    Ok(found.causes)
}

/// A joint without a cause, fitted, over the horizon at which it is likeliest.
fn healthy<'a>(
    manifest: &Manifest,
    recordings: &[Recording],
    spreads: &'a Spreads,
) -> Result<Bare<'a>, BenchError> {
    // Laws are off by shares of causes, of which there are none.
    const NONE: &BTreeMap<String, f64> = &BTreeMap::new();
    let asked = Asked {
        manifest,
        recordings,
        withhold: &[],
        calibration: None,
        baseline: None,
        watch: Watch::NOBODY,
    };
    let known = Known {
        spreads,
        laws: NONE,
    };
    let own = Bare::new(&asked, known)?.nearest(&asked, known);
    let again = own.without_losses(&asked, known, &own.bare);
    let again = again.map(|again| again.nearest(&asked, known));
    let likelier = again.filter(|a| a.total(&a.bare) > own.total(&own.bare));
    Ok(likelier.unwrap_or(own))
}

/// A joint without a cause as a block of errors: what [`Spreads::learned`] learns from what joints differ by.
///
/// # Errors
/// As [`name_causes`].
pub fn null_block(manifest: &Manifest, recordings: &[Recording]) -> Result<White, BenchError> {
    let none = Spreads::default();
    let own = healthy(manifest, recordings, &none)?;
    Ok(own.search.block(&own.data, &own.bare))
}

/// What a joint without a cause adds to a calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct Healthy {
    /// Evidence of every effect that it could have, alone.
    pub evidence: BTreeMap<Shown, f64>,
    /// What is left of each column over its noise, dB.
    pub left_db: Vec<(String, f64)>,
}

/// Evidence of every effect that a joint could have, alone, and what is left of each column without a cause, dB: what a joint without one
/// adds to a calibration, given what such joints differ by.
///
/// # Errors
/// As [`name_causes`].
pub fn strongest(
    manifest: &Manifest,
    recordings: &[Recording],
    spreads: &Spreads,
) -> Result<Healthy, BenchError> {
    let mut own = healthy(manifest, recordings, spreads)?;
    let read = own.transport.read.iter();
    let read = read
        .map(|r| (Kind::One(r.effect), r.evidence))
        .collect::<Vec<_>>();
    let alone = own.search.alone(&own.data, &own.bare);
    // Less than none is none: what was not fitted because others explain more shows as little.
    let all = own.search.hypotheses.iter();
    let mut out: BTreeMap<Shown, f64> = all.map(|h| (shown(&own.data, h.kind), 0.0)).collect();
    for &effect in own.transport.looked_for() {
        out.insert(shown(&own.data, Kind::One(effect)), 0.0);
    }
    for (kind, evidence) in alone.into_iter().chain(read) {
        let slot = out.entry(shown(&own.data, kind)).or_insert(0.0);
        *slot = slot.max(evidence);
    }
    let bare = own.bare.fit.point();
    let left = remainder::remainder(&own.data, &bare, &bare).left_db;
    Ok(Healthy {
        evidence: out,
        left_db: left,
    })
}
