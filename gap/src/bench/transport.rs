//! Set-points on their way to the driver.

use files::dataset::{Manifest, Recording, Signal};

use super::rows::Read;
use crate::joint::Problem;
use crate::joint::arrival::regularity;
use crate::names::jitter_s;
use crate::vocabulary::Effect;

/// What the echo shows of the way, and the recordings that the chain is played from.
#[derive(Debug, Clone)]
pub(super) struct Transport {
    /// Recordings whose set-points are those that the driver applied, where these come irregularly.
    pub(super) cut: Vec<Recording>,
    /// Causes that the echo shows by itself.
    pub(super) read: Vec<Read>,
    irregular: bool,
    /// Whether the driver echoes its set-points.
    pub(super) echoed: bool,
}

impl Transport {
    pub(super) fn new(
        manifest: &Manifest,
        recordings: &[Recording],
        withhold: &[Effect],
        error: f64,
    ) -> Self {
        let echoed = recordings.iter().all(|r| echo(r).is_some());
        let read = Problem::new(manifest, recordings, 0)
            .filter(|_| echoed)
            .and_then(|p| irregular(&p, error))
            .filter(|r| !withhold.contains(&r.effect));
        let cut = if read.is_some() {
            as_applied(recordings)
        } else {
            recordings.to_vec()
        };
        Self {
            cut,
            echoed,
            irregular: read.is_some(),
            read: read.into_iter().collect(),
        }
    }

    /// Effects that are read from the way of set-points: without an echo their losses are.
    pub(super) fn looked_for(&self) -> &'static [Effect] {
        const ALL: [Effect; 2] = [Effect::PacketLoss, Effect::Jitter];
        &ALL[..1 + usize::from(self.echoed)]
    }

    /// Whether the chain begins at the echo.
    pub(super) fn cut_off(&self) -> bool {
        self.irregular
    }
}

/// Recordings whose set-points are those that the driver echoes.
pub(super) fn as_applied(recordings: &[Recording]) -> Vec<Recording> {
    let mut out = recordings.to_vec();
    for r in &mut out {
        let applied = echo(r);
        if let Some(j) = r.joint_mut(0).filter(|_| applied.is_some()) {
            j.set(Signal::Setpoint, applied);
            j.set(Signal::AppliedSetpoint, None);
        }
    }
    out
}

fn echo(r: &Recording) -> Option<Vec<f64>> {
    let j = r.joint(0)?;
    j.get(Signal::Setpoint)?;
    Some(j.get(Signal::AppliedSetpoint)?.to_vec())
}

/// Delays beyond this many row times between them are no rounding of one: it falls into one row or, at its edge, two.
const ROWS: f64 = 1.5;
/// Share of set-points of which one is lost by chance: a damaged frame in a hundred.
const CHANCE: f64 = 0.01;

/// Set-points that come unevenly, or not at all; `error` is the model error in any one direction, as a share of the
/// noise.
fn irregular(problem: &Problem, error: f64) -> Option<Read> {
    let way = regularity(&problem.runs)?;
    let lost = way.lost * way.sent;
    let arrived = way.sent - lost;
    if way.range_s > ROWS * way.doubt_s {
        let sigma = jitter_s(problem, &way);
        let off = sigma * (0.5 / arrived).sqrt() + 0.1 * way.doubt_s;
        let counts = 1.0 / (1.0 + arrived * error * error);
        let evidence = counts * arrived * libm::log(way.range_s / way.doubt_s);
        return Some(Read::new(Effect::Jitter, "sigma_s", [sigma, off], evidence));
    }
    if way.lost <= CHANCE {
        return None;
    }
    // Binomial likelihoods of the share that was lost and of chance, with Schwarz's price of the share.
    let evidence = lost * libm::log(way.lost / CHANCE)
        + arrived * libm::log((1.0 - way.lost) / (1.0 - CHANCE))
        - 0.5 * libm::log(way.sent);
    let off = (way.lost * (1.0 - way.lost) / way.sent).sqrt();
    Some(Read::new(
        Effect::PacketLoss,
        "probability",
        [way.lost, off],
        evidence,
    ))
}
