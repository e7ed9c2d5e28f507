//! A gait as text, so that reading it again gives the same bits.

use core::fmt::Write as _;

use control::gait::{Gait, Link, RawGait};

use super::FORMAT;
use super::walk::radians;

/// Writes `gait` as a `gait.toml`. [`super::parse`] of the result gives back the same gait, bit for bit.
///
/// Angles are written in degrees where a short decimal gives the same bits, else in radians.
#[must_use]
pub fn to_toml(gait: &Gait) -> String {
    let raw = gait.raw();
    let mut out = String::new();
    let _ = writeln!(out, "format = {FORMAT}");
    let _ = writeln!(
        out,
        "name = {}",
        toml::Value::String(raw.name.as_str().to_owned())
    );
    let _ = writeln!(out, "frequency_hz = {}", number(raw.frequency_hz));
    let _ = writeln!(out, "duration_s = {}", number(raw.duration_s));
    let _ = writeln!(out, "rate_a_per_s = {}", number(raw.rate_a_per_s));
    let chain = chain_weight(&raw);
    if let Some(weight) = chain {
        let lags: Vec<f32> = raw.links.iter().map(|l| l.phase_lag_rad).collect();
        let _ = writeln!(out, "coupling = \"chain\"\nweight = {}", number(weight));
        out.push_str(&angles("phase_lag", &lags));
    } else if raw.links.is_empty() {
        out.push_str("coupling = \"none\"\n");
    }
    for oscillator in &raw.oscillators {
        out.push_str("\n[[oscillator]]\n");
        out.push_str(&angle("amplitude", oscillator.amplitude_rad));
        out.push_str(&angle("offset", oscillator.offset_rad));
        out.push_str(&angle("initial_phase", oscillator.initial_phase_rad));
    }
    if chain.is_none() {
        raw.links.iter().for_each(|l| out.push_str(&link_table(l)));
    }
    out
}

/// The common weight, if the links are exactly the chain 0-1, 1-2, … in order.
fn chain_weight(raw: &RawGait) -> Option<f32> {
    let first = raw.links.first()?;
    let in_chain = |(i, l): (usize, &Link)| {
        usize::from(l.from) == i
            && usize::from(l.to) == i + 1
            && l.weight.to_bits() == first.weight.to_bits()
    };
    let complete = raw.links.len() + 1 == raw.oscillators.len();
    (complete && raw.links.iter().enumerate().all(in_chain)).then_some(first.weight)
}

fn link_table(link: &Link) -> String {
    let Link {
        from,
        to,
        weight,
        phase_lag_rad,
    } = *link;
    format!(
        "\n[[link]]\nfrom = {from}\nto = {to}\nweight = {}\n{}",
        number(weight),
        angle("phase_lag", phase_lag_rad)
    )
}

/// Shortest decimal that reads back to the same single-precision bits.
fn number(value: f32) -> String {
    format!("{value:?}")
}

fn angle(base: &str, rad: f32) -> String {
    match degrees(rad) {
        Some(deg) => format!("{base}_deg = {deg}\n"),
        None => format!("{base}_rad = {}\n", number(rad)),
    }
}

fn angles(base: &str, rad: &[f32]) -> String {
    let in_degrees: Option<Vec<String>> = rad.iter().map(|r| degrees(*r)).collect();
    match in_degrees {
        Some(list) => format!("{base}_deg = [{}]\n", list.join(", ")),
        None => {
            let list: Vec<String> = rad.iter().map(|r| number(*r)).collect();
            format!("{base}_rad = [{}]\n", list.join(", "))
        }
    }
}

/// The shortest decimal in degrees (at most 4 places) that reads back to the bits of `rad`.
fn degrees(rad: f32) -> Option<String> {
    let deg = f64::from(rad) * (180.0 / core::f64::consts::PI);
    (0..=4).find_map(|places| {
        let text = format!("{deg:.places$}");
        let back: f64 = text.parse().ok()?;
        (radians(back).to_bits() == rad.to_bits()).then_some(text)
    })
}
