//! Causes of the gap of one joint on a bench, by the likelihood of [`crate::evidence`].
//!
//! The joint is played from the set-points that reached its driver, through controller, motor, gear and load
//! ([`crate::joint`]); measured positions correct it, so that rows are predicted over a short horizon. Every measured
//! signal gives prediction errors ([`data`]), which a model of their own correlation whitens ([`noise`]). A cause is a
//! few parameters with priors ([`library`]); a set of causes is fitted with all stated numbers free within their
//! tolerances, and weighed by Laplace's evidence ([`fit`], [`search`]).
//! Set-points on their way to the driver are weighed where the driver echoes them ([`transport`]).

mod data;
mod fit;
mod library;
mod lost;
mod model;
mod noise;
mod remainder;
mod rows;
mod search;
mod stated;
mod transport;

use std::collections::BTreeMap;

use files::dataset::{Manifest, Recording};

pub use rows::{Causes, Word};

use crate::decide::{Calibration, Shown};
use crate::evidence::block::White;
use crate::evidence::ensemble::Spreads;
use crate::joint::Channel;
use crate::vocabulary::Effect;
use data::Data;
use library::Kind;
use search::{Found, Search, Set};

/// Why a joint cannot be diagnosed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum BenchError {
    /// No run has both set-points and positions.
    #[error("no run has set-points and positions; record setpoint_rad and position_rad (or _m)")]
    Nothing,
}

/// What is asked.
struct Asked<'a> {
    manifest: &'a Manifest,
    recordings: &'a [Recording],
    withhold: &'a [Effect],
    /// What a cause must add; without it none does.
    calibration: Option<&'a Calibration>,
}

impl Asked<'_> {
    /// What a cause must add where these signals were measured.
    fn ask(&self, data: &Data, kind: Kind) -> f64 {
        self.calibration
            .map_or(f64::INFINITY, |c| c.ask(&shown(data, kind)))
    }
}

/// A cause as a calibration knows it: its effect and the signals that were measured; a compound has no effect.
fn shown(data: &Data, kind: Kind) -> Shown {
    let signals: Vec<&str> = data
        .channels
        .iter()
        .map(|c| library::column(Channel::ALL[*c]))
        .collect();
    match kind {
        Kind::One(effect) => Shown::new(Some(effect), &signals.join("+")),
        other => Shown::new(None, other.name()),
    }
}

/// What was found, with all it was made of.
struct Explained<'a> {
    data: Data,
    transport: transport::Transport,
    search: Search<'a>,
    found: Found,
    remainder: remainder::Remainder,
}

fn explain<'a>(asked: &Asked<'_>, spreads: &'a Spreads) -> Result<Explained<'a>, BenchError> {
    let mut transport = transport::Transport::new(asked.manifest, asked.recordings, asked.withhold);
    let mut data = Data::new(asked.manifest, &transport.cut).ok_or(BenchError::Nothing)?;
    let mut search = Search::new(&data, asked.withhold, transport.cut_off(), spreads);
    let mut found = search.run(&data, &|kind| asked.ask(&data, kind));
    if let Some(lost) = lost(asked, &transport, &data, &search, &found.best)
        && let Some(arrived) = Data::new(asked.manifest, &lost.arrived)
    {
        // What was lost is known: the chain is searched again with what arrived.
        data = arrived;
        search = Search::new(&data, asked.withhold, transport.cut_off(), spreads);
        found = search.run(&data, &|kind| asked.ask(&data, kind));
        transport.read.push(lost.read);
    }
    let remainder = remainder::remainder(&data, &found.before, &found.best.fit.errors);
    Ok(Explained {
        data,
        transport,
        search,
        found,
        remainder,
    })
}

/// Lost set-points that no echo shows, if they are more than joints without a cause seem to lose.
fn lost(
    asked: &Asked<'_>,
    transport: &transport::Transport,
    data: &Data,
    search: &Search<'_>,
    best: &Set,
) -> Option<lost::Lost> {
    if transport.echoed || asked.withhold.contains(&Effect::PacketLoss) {
        return None;
    }
    let point = best.fit.point();
    let noise = search.noise.first()?;
    let lost = lost::lost(asked.manifest, &transport.cut, data, &point, noise)?;
    let least = asked.ask(data, Kind::One(Effect::PacketLoss));
    (lost.read.evidence > least.min(LEAST_LOST)).then_some(lost)
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
    let asked = Asked {
        manifest,
        recordings,
        withhold,
        calibration: Some(calibration),
    };
    let missing = stated::missing(&manifest.bench);
    if !missing.is_empty() {
        return Ok(Causes::too_little(missing, calibration));
    }
    Ok(explain(&asked, &calibration.spreads)?.rows(calibration))
}

/// A joint without a cause, fitted.
struct Healthy<'a> {
    data: Data,
    transport: transport::Transport,
    search: Search<'a>,
    bare: Set,
}

impl<'a> Healthy<'a> {
    fn new(
        manifest: &Manifest,
        recordings: &[Recording],
        spreads: &'a Spreads,
    ) -> Result<Self, BenchError> {
        let asked = Asked {
            manifest,
            recordings,
            withhold: &[],
            calibration: None,
        };
        let mut transport = transport::Transport::new(manifest, recordings, &[]);
        let mut data = Data::new(manifest, &transport.cut).ok_or(BenchError::Nothing)?;
        let mut search = Search::new(&data, &[], transport.cut_off(), spreads);
        let mut bare = search.bare(&data);
        if let Some(lost) = lost(&asked, &transport, &data, &search, &bare)
            && let Some(arrived) = Data::new(manifest, &lost.arrived)
        {
            data = arrived;
            search = Search::new(&data, &[], transport.cut_off(), spreads);
            bare = search.bare(&data);
            transport.read.push(lost.read);
        }
        Ok(Self {
            data,
            transport,
            search,
            bare,
        })
    }
}

/// A joint without a cause as a block of errors: what [`Spreads::learned`] learns from what joints differ by.
///
/// # Errors
/// As [`name_causes`].
pub fn null_block(manifest: &Manifest, recordings: &[Recording]) -> Result<White, BenchError> {
    let none = Spreads::default();
    let own = Healthy::new(manifest, recordings, &none)?;
    Ok(own.search.block(&own.data, &own.bare))
}

/// Evidence of every effect that a joint could have, alone, and what is left without a cause: what a joint without one
/// adds to a calibration, given what such joints differ by.
///
/// # Errors
/// As [`name_causes`].
pub fn strongest(
    manifest: &Manifest,
    recordings: &[Recording],
    spreads: &Spreads,
) -> Result<(BTreeMap<Shown, f64>, f64), BenchError> {
    let mut own = Healthy::new(manifest, recordings, spreads)?;
    let read = own.transport.read.iter();
    let read = read
        .map(|r| (Kind::One(r.effect), r.evidence))
        .collect::<Vec<_>>();
    let alone = own.search.alone(&own.data, &own.bare);
    // Less than none is none: what was not fitted because others explain more shows as little.
    let all = own.search.hypotheses.iter();
    let mut out: BTreeMap<Shown, f64> = all.map(|h| (shown(&own.data, h.kind), 0.0)).collect();
    for (kind, evidence) in alone.into_iter().chain(read) {
        let slot = out.entry(shown(&own.data, kind)).or_insert(0.0);
        *slot = slot.max(evidence);
    }
    let errors = &own.bare.fit.errors;
    Ok((out, remainder::remainder(&own.data, errors, errors).ratio))
}
