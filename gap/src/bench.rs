//! Causes of the gap of one joint on a bench, by the likelihood of [`crate::evidence`].
//!
//! The joint is played from the set-points that reached its driver, through controller, motor, gear and load
//! ([`crate::joint`]). Every measured signal gives prediction errors ([`data`]), which a model of their own
//! correlation whitens. A cause is a few parameters with priors ([`library`]); a set of causes is fitted with all
//! stated numbers free within their tolerances, and weighed by Laplace's evidence ([`fit`], [`search`]).
//! Set-points on their way to the driver are weighed where the driver echoes them ([`transport`]).

mod data;
mod fit;
mod library;
mod lost;
mod model;
mod remainder;
mod rows;
mod search;
mod stated;
mod transport;

use files::dataset::{Manifest, Recording};

pub use rows::{Causes, Word};

use crate::decide::Calibration;
use crate::vocabulary::Effect;
use data::Data;
use search::{Found, Search};

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
    least: f64,
}

/// What was found, with all it was made of.
struct Explained {
    data: Data,
    transport: transport::Transport,
    search: Search,
    found: Found,
    remainder: remainder::Remainder,
}

fn explain(asked: &Asked<'_>) -> Result<Explained, BenchError> {
    let mut transport = transport::Transport::new(asked.manifest, asked.recordings, asked.withhold);
    let mut data = Data::new(asked.manifest, &transport.cut).ok_or(BenchError::Nothing)?;
    let mut search = Search::new(&data, asked.withhold, transport.cut_off());
    let mut found = search.run(&data, asked.least);
    if let Some(lost) = lost(asked, &transport, &data, &search, &found)
        && let Some(arrived) = Data::new(asked.manifest, &lost.arrived)
    {
        // What was lost is known: the chain is searched again with what arrived.
        data = arrived;
        search = Search::new(&data, asked.withhold, transport.cut_off());
        found = search.run(&data, asked.least);
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
    search: &Search,
    found: &Found,
) -> Option<lost::Lost> {
    if transport.echoed || asked.withhold.contains(&Effect::PacketLoss) {
        return None;
    }
    let point = found.best.fit.point();
    let noise = search.noise.first()?;
    let lost = lost::lost(asked.manifest, &transport.cut, data, &point, noise)?;
    (lost.read.evidence > asked.least.min(LEAST_LOST)).then_some(lost)
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
        least: calibration.least(),
    };
    let missing = stated::missing(&manifest.bench);
    if !missing.is_empty() {
        return Ok(Causes::too_little(missing, calibration));
    }
    Ok(explain(&asked)?.rows(calibration))
}

/// Evidence of the strongest cause, named or not, and what the best set leaves: what a joint without a cause adds to
/// a calibration.
///
/// # Errors
/// As [`name_causes`].
pub fn strongest(manifest: &Manifest, recordings: &[Recording]) -> Result<[f64; 2], BenchError> {
    let asked = Asked {
        manifest,
        recordings,
        withhold: &[],
        least: f64::INFINITY,
    };
    let found = explain(&asked)?;
    Ok([found.strongest(), found.remainder.ratio])
}
