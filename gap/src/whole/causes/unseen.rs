//! What these signals could not show, and up to which size.

use rayon::prelude::*;

use super::Explained;
use crate::decide::{Calibration, PLAUSIBLE};
use crate::evidence::cause::Cause;
use crate::report::words::{parameter, quantity};
use crate::verdict::Unseen;
use crate::vocabulary::{Effect, Stage};

/// What was recorded.
#[derive(Debug, Clone, Copy)]
pub(super) struct Recorded {
    /// The pose of the base.
    pub(super) tracked: bool,
    /// That pose was read off a film.
    pub(super) filmed: bool,
    /// Films beside the pose.
    pub(super) films: bool,
    /// Set-points as drivers echo them.
    pub(super) echoed: bool,
}

impl Recorded {
    /// Whether what would be read off the signals and was not found is not there.
    fn shows(self, effect: Effect) -> bool {
        match effect {
            Effect::JointOrder | Effect::JointSign => true,
            Effect::FrameDrop => self.films,
            _ => effect.stage() == Stage::Transport && self.echoed,
        }
    }
}

/// Why no signal shows an effect at all.
fn missing(effect: Effect, recorded: Recorded) -> &'static str {
    match effect.stage() {
        Stage::Drivetrain => {
            "a servo that is strong enough hides it; record effort_nm or current_a"
        }
        Stage::Electrical | Stage::Supply => {
            "record duty_ratio, current_a and bus_voltage_v; the model must state supply and windings"
        }
        Stage::Body if !recorded.tracked => "no run has the base pose and all six positions",
        Stage::Camera if recorded.filmed => {
            "the base pose was read off the film itself; record base_* to judge the camera"
        }
        Stage::Camera => "no run has a film beside the base pose",
        _ => "no signal of this data set shows it, or the model holds no nominal value for it",
    }
}

impl Explained {
    /// Size of `cause` at which it is expected to be named, in standard deviations of its prior.
    ///
    /// Of information `i` about a coefficient of standard deviation 1, beside all others, a size `z` adds
    /// `z^2 i^2 / (1 + i) / 2 - log(1 + i) / 2`.
    fn nameable(&self, c: usize, ask: f64) -> f64 {
        let mut members = vec![c];
        members.extend(&self.found.best.members);
        let posterior = self.problem().posterior(&members);
        let information = (1.0 / posterior.covariance[0].max(1e-12) - 1.0).max(1e-12);
        let needed = ask - self.causes[c].log_prior + 0.5 * libm::log1p(information);
        (2.0 * needed.max(0.0) * (1.0 + information)).sqrt() / information
    }

    /// Why `effect` could not be seen; `None` where it would have been.
    fn why(&self, effect: Effect, calibration: &Calibration, recorded: Recorded) -> Option<String> {
        let single = |c: &Cause| c.effect == Some(effect) && c.joints.len() <= 1;
        let own: Vec<usize> = (0..self.causes.len())
            .filter(|c| single(&self.causes[*c]) && !self.causes[*c].latents.is_empty())
            .collect();
        if own.is_empty() && recorded.shows(effect) {
            return None;
        }
        if own.is_empty() {
            return Some(missing(effect, recorded).into());
        }
        let sizes = own.into_par_iter().map(|c| {
            let ask = calibration.ask(&(&self.causes[c]).into());
            (c, self.nameable(c, ask))
        });
        let (c, size) = sizes.min_by(|a, b| a.1.total_cmp(&b.1))?;
        if size < PLAUSIBLE {
            return None;
        }
        let number = self.causes[c].numbers.first()?;
        let known = effect.info().parameters.iter();
        if !known.map(|p| p.key).any(|key| key == number.key) {
            // What the search moves is not what people call its size.
            return Some("no plausible size of it would be named".into());
        }
        let unit: f64 = number.of_latents.iter().map(|l| l.1 * l.1).sum();
        let change = (number.scale * size * unit.sqrt()).abs();
        let (name, unit) = parameter(number.key);
        let at = number
            .joint
            .map_or_else(String::new, |k| format!(" at joint {k}"));
        Some(format!(
            "only a {name} off by {}{at} would be named: more than is plausible",
            quantity(change, unit)
        ))
    }

    /// Effects that these signals could not show, but for those `withheld`.
    pub(super) fn unseen(
        &self,
        calibration: &Calibration,
        withheld: &[Effect],
        recorded: Recorded,
    ) -> Vec<Unseen> {
        let members = &self.found.best.members;
        let named = |e: Effect| members.iter().any(|m| self.causes[*m].effect == Some(e));
        Effect::ALL
            .iter()
            .filter(|e| !withheld.contains(e) && !named(**e))
            .filter_map(|e| {
                let why = self.why(*e, calibration, recorded)?;
                Some(Unseen { effect: *e, why })
            })
            .collect()
    }
}
