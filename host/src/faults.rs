//! Faults on the command line: `KIND[=PROBABILITY][@FROM[-TO]][:jointN]`, several separated by commas.

use hil_sim::fault::{Fault, FaultKind};

/// Why a fault cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FaultSpecError {
    /// Unknown kind.
    #[error(
        "no fault {0:?}; there are drop, corrupt, request_loss, reply_loss, missing, babble, stuck, stall, brownout, reset"
    )]
    Kind(String),
    /// Not a probability.
    #[error("{0:?} is no probability; give 0 to 1")]
    Probability(String),
    /// Not a time window.
    #[error("{0:?} is no time; write @4 (from 4 s on) or @4-6 (from 4 s to 6 s)")]
    Window(String),
    /// Not a joint.
    #[error("{0:?} is no joint; write :joint0 to :joint5")]
    Joint(String),
}

/// Share of the supply left in a `brownout`.
const BROWN_OUT_RATIO: f64 = 0.4;

/// Reads a list such as `drop=0.01,corrupt=1e-4,stall@4-6:joint2`.
///
/// # Errors
/// [`FaultSpecError`]
pub fn parse(text: &str) -> Result<Vec<Fault>, FaultSpecError> {
    text.split(',')
        .filter(|part| !part.trim().is_empty())
        .map(|part| parse_one(part.trim()))
        .collect()
}

fn parse_one(text: &str) -> Result<Fault, FaultSpecError> {
    let (text, joint) = match text.split_once(':') {
        Some((rest, joint)) => (rest, Some(joint)),
        None => (text, None),
    };
    let (text, window) = match text.split_once('@') {
        Some((rest, window)) => (rest, Some(window)),
        None => (text, None),
    };
    let (kind, chance) = match text.split_once('=') {
        Some((kind, chance)) => (kind, Some(chance)),
        None => (text, None),
    };
    let mut fault = Fault::always(parse_kind(kind)?);
    if let Some(chance) = chance {
        let bad = || FaultSpecError::Probability(chance.to_owned());
        let value: f64 = chance.parse().map_err(|_| bad())?;
        if !(0.0..=1.0).contains(&value) {
            return Err(bad());
        }
        fault = fault.chance(value);
    }
    if let Some(window) = window {
        let (from_s, to_s) = parse_window(window)?;
        fault = fault.during(from_s, to_s);
    }
    if let Some(joint) = joint {
        let index = joint
            .strip_prefix("joint")
            .and_then(|n| n.parse::<usize>().ok())
            .filter(|n| *n < control::machine::MAX_JOINTS);
        fault = fault.on(index.ok_or_else(|| FaultSpecError::Joint(joint.to_owned()))?);
    }
    Ok(fault)
}

fn parse_window(text: &str) -> Result<(f64, f64), FaultSpecError> {
    let bad = || FaultSpecError::Window(text.to_owned());
    let seconds = |t: &str| {
        t.parse::<f64>()
            .ok()
            .filter(|s| s.is_finite() && *s >= 0.0)
            .ok_or_else(bad)
    };
    match text.split_once('-') {
        Some((from, to)) => Ok((seconds(from)?, seconds(to)?)),
        None => Ok((seconds(text)?, f64::INFINITY)),
    }
}

fn parse_kind(text: &str) -> Result<FaultKind, FaultSpecError> {
    Ok(match text {
        "drop" => FaultKind::ByteLoss,
        "corrupt" => FaultKind::Corruption,
        "request_loss" => FaultKind::RequestLoss,
        "reply_loss" => FaultKind::ReplyLoss,
        "missing" => FaultKind::Missing,
        "babble" => FaultKind::Babble,
        "stuck" => FaultKind::StuckEncoder,
        "stall" => FaultKind::Stall,
        "brownout" => FaultKind::BrownOut {
            ratio: BROWN_OUT_RATIO,
        },
        "reset" => FaultKind::Reset,
        other => return Err(FaultSpecError::Kind(other.to_owned())),
    })
}

#[cfg(test)]
mod tests {
    use super::parse;
    use hil_sim::fault::{Fault, FaultKind};

    #[test]
    fn specs_read_as_documented() {
        let faults = parse("drop=0.01,stall@4-6:joint2, reset@5").unwrap();
        let expected = [
            Fault::always(FaultKind::ByteLoss).chance(0.01),
            Fault::always(FaultKind::Stall).during(4.0, 6.0).on(2),
            Fault::always(FaultKind::Reset).during(5.0, f64::INFINITY),
        ];
        assert_eq!(faults, expected);
        for bad in [
            "nothing",
            "drop=2",
            "drop=x",
            "stall@x",
            "stall@-1",
            "stall@1-x",
            "stall:joint12",
            "stall:2",
            "stall@inf",
        ] {
            assert!(parse(bad).is_err(), "{bad}");
        }
    }
}
