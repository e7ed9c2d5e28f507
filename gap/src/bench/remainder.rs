//! What the best set leaves, against what the recording's own noise leaves.

use super::data::{Data, Errors};

/// What is left, by itself and as a part of what was there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Remainder {
    /// Logarithm of the largest ratio, over channels, of what is left to the noise of the channel.
    pub(super) ratio: f64,
    /// Share of the squares beyond the noise that stays, in the channel that showed most.
    pub(super) share: f64,
}

/// Mean square of a channel.
fn square(data: &Data, errors: &Errors, k: usize) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for s in data.series(k) {
        for (e, w) in errors[s].iter().zip(&data.weights[s]) {
            sum += w * e * e;
            n += w;
        }
    }
    if n > 0.0 { sum / n } else { 0.0 }
}

/// Compares the errors before and after.
pub(super) fn remainder(data: &Data, before: &Errors, after: &Errors) -> Remainder {
    let mut out = Remainder {
        ratio: f64::NEG_INFINITY,
        share: 1.0,
    };
    let mut most = 0.0;
    for k in 0..data.channels.len() {
        let noise = data.own_noise(k).max(1e-300);
        let noise = noise * noise;
        let [was, is] = [before, after].map(|e| square(data, e, k));
        out.ratio = out.ratio.max(0.5 * libm::log((is / noise).max(1e-300)));
        if was / noise > most {
            most = was / noise;
            out.share = (is - noise).max(0.0) / (was - noise).max(1e-3 * noise);
        }
    }
    out
}
