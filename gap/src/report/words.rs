//! Numbers, units and names as a tired person reads them.

use crate::verdict::{Contacts, Law, Verdict, Where, Word};

/// Four significant digits.
pub(crate) fn number(x: f64) -> String {
    let size = x.abs();
    if x == 0.0 {
        "0".into()
    } else if (1e-4..1e5).contains(&size) {
        // Decimals that leave four digits: 3 minus the decimal exponent, between 0 and 7.
        let decimals = (3.0 - libm::floor(libm::log10(size))).clamp(0.0, 7.0) as usize;
        format!("{x:.decimals$}")
    } else {
        format!("{x:.3e}")
    }
}

/// How the ground holds, and from what that is told.
pub(super) fn contacts(c: &Contacts) -> String {
    let own = number(c.left_nominal);
    let mut out = format!(
        "On the nominal model's contacts windows of the body leave {own} squared tolerances a number"
    );
    match c.left_other {
        None => out.push_str("; nothing asks for contacts of another law."),
        Some(other) => {
            let whose = match c.law {
                Law::Nominal => "the contacts are the nominal model's",
                Law::Unclear => "whose contacts these are cannot be told",
                Law::Other => "the contacts are of another law than the nominal model's",
            };
            let (other, ratio) = (number(other), number(other / c.left_nominal));
            out.push_str(&format!(
                ", on contacts of the other law {other} (ratio {ratio}): {whose}."
            ));
        }
    }
    if let Some(left) = c.left_any_make {
        let left = number(left);
        out.push_str(&format!(
            " Beyond what contacts of any make explain {left} stay."
        ));
    }
    if c.law == Law::Other {
        let limit = if c.friction_pyramid {
            "a pyramid of friction"
        } else {
            "a round cone of friction"
        };
        let slip = number(c.contact_slip_m_s_n);
        out.push_str(&format!(
            " The patch has {limit} and a creep of {slip} m/s per N."
        ));
    }
    out
}

/// Text that stands in HTML as it is.
pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// Ends of parameter names, longest first, and the units they stand for.
const UNITS: [(&str, &str); 15] = [
    ("nm_s2_rad2", "N m s²/rad²"),
    ("nm_s_rad", "N m s/rad"),
    ("nm_rad", "N m/rad"),
    ("n_s_m", "N s/m"),
    ("rad_s", "rad/s"),
    ("n_m", "N/m"),
    ("ohm", "ohm"),
    ("rad", "rad"),
    ("nm", "N m"),
    ("m_s", "m/s"),
    ("s", "s"),
    ("m", "m"),
    ("a", "A"),
    ("v", "V"),
    ("n", "N"),
];

/// Name and unit of a parameter key: `delay_s` is `delay` in `s`; what carries no unit has none.
pub(super) fn parameter(key: &str) -> (String, &'static str) {
    for (end, unit) in UNITS {
        if key == end {
            return ("size".into(), unit);
        }
        let name = key.strip_suffix(end).and_then(|k| k.strip_suffix('_'));
        if let Some(name) = name {
            return (name.replace('_', " "), unit);
        }
    }
    (key.replace('_', " "), "")
}

/// A value with its unit; angles of a radian or less in degrees too.
pub(super) fn quantity(x: f64, unit: &str) -> String {
    match unit {
        "" | "1" => number(x),
        "rad" => format!("{} rad ({} deg)", number(x), number(x.to_degrees())),
        _ => format!("{} {unit}", number(x)),
    }
}

/// What a metric measures.
pub(super) fn metric(name: &str) -> &str {
    const PLAIN: [(&str, &str); 10] = [
        ("position_rmse", "angle at the motor, RMS error"),
        ("position_mae", "angle at the motor, mean absolute error"),
        ("link_rmse", "angle behind the gear, RMS error"),
        ("effort_rmse", "torque, RMS error"),
        ("pose_rmse", "place of the body within windows, RMS error"),
        (
            "pose_rollout",
            "place of the body over whole runs, RMS error",
        ),
        ("heading_rmse", "heading, RMS error"),
        ("speed_error", "mean speed, error"),
        ("similarity_r", "overlap of the films (1 is all)"),
        ("current_rmse", "current, RMS error"),
    ];
    let plain = PLAIN.iter().find(|(start, _)| name.starts_with(start));
    plain.map_or(name, |p| p.1)
}

/// Where a place is: stage and joint.
pub(super) fn place(stage: &str, joint: Option<usize>) -> String {
    match (stage, joint) {
        ("unexplained", _) => "not explained".into(),
        (stage, Some(k)) => format!("{stage}, joint {k}"),
        (stage, None) => stage.into(),
    }
}

/// What a stage is, in a few words.
pub(super) fn stage(name: &str) -> &'static str {
    match name {
        "conventions" => "order, sign, unit and zero of the joints",
        "cpg" => "set-points made from the gait",
        "transport" => "set-points on their way to the driver",
        "driver" => "the controller in the motor driver",
        "electrical" => "motor and current",
        "supply" => "battery and bus voltage",
        "drivetrain" => "friction, inertia and load of the gear",
        "transmission" => "play and softness between motor and link",
        "body" => "ground, contacts and masses",
        "camera" => "place and clock of the camera",
        _ => "no effect of the library",
    }
}

/// When most of a share shows, as the end of a line.
pub(super) fn regime(w: &Where) -> &'static str {
    match w.regime.as_str() {
        "saturation" => ", most of it at the limits of the motor",
        "reversal" => ", most of it where the joint turns round",
        "low_speed" => ", most of it at low speed",
        "high_load" => ", most of it under high load",
        "warm_up" => ", most of it while the motor warms up",
        _ => "",
    }
}

/// The verdict's word as in the JSON.
pub(super) fn word(v: &Verdict) -> &'static str {
    match v.verdict {
        Word::Explained => "explained",
        Word::PartlyExplained => "partly_explained",
        Word::Parametric => "parametric",
        Word::None => "none",
        Word::Unknown => "unknown",
    }
}

/// Where the floor comes from.
pub(super) fn floor(v: &Verdict) -> &'static str {
    match v.gap.floor_source.as_str() {
        "repeats" => "how far repeats of one motion differ",
        "tolerance" => {
            "what windows and loads may be off by, since they start from measured states"
        }
        _ => "noise of the signal; the data set has no repeats",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_four_digits() {
        let table = [
            (0.0, "0"),
            (0.084, "0.08400"),
            (-1.5, "-1.500"),
            (12345.6, "12346"),
            (2.5e-7, "2.500e-7"),
        ];
        for (x, text) in table {
            assert_eq!(number(x), text);
        }
    }

    #[test]
    fn contacts_are_told_with_what_either_law_leaves() {
        let of = |law, left_other| Contacts {
            law,
            left_nominal: 4.0,
            left_other,
            left_any_make: left_other.map(|_| 2.5),
            friction_pyramid: law == Law::Other,
            contact_slip_m_s_n: if law == Law::Other { 0.002 } else { 0.0 },
        };
        for (c, says, not) in [
            (of(Law::Nominal, None), "nothing asks", "patch"),
            (of(Law::Nominal, Some(5.0)), "ratio 1.250", "patch"),
            (of(Law::Unclear, Some(4.2)), "cannot be told", "patch"),
            (
                of(Law::Other, Some(3.2)),
                "creep of 0.002000 m/s per N",
                "asks",
            ),
        ] {
            let text = contacts(&c);
            assert!(text.contains(says) && !text.contains(not), "{text}");
        }
    }

    #[test]
    fn every_parameter_of_the_vocabulary_reads_well() {
        for effect in crate::vocabulary::Effect::ALL {
            for key in effect.parameters().iter().map(|p| p.key) {
                let (name, unit) = parameter(key);
                let bare = [
                    "permutation",
                    "sign",
                    "ratio",
                    "probability",
                    "fraction",
                    "periods",
                ];
                let none = bare.contains(&key) || key == "coefficient";
                assert!(!name.is_empty() && none == unit.is_empty(), "{key}");
            }
        }
        assert_eq!(parameter("delay_s"), ("delay".into(), "s"));
        assert_eq!(parameter("half_width_rad"), ("half width".into(), "rad"));
        assert_eq!(parameter("nm_s_rad"), ("size".into(), "N m s/rad"));
        assert_eq!(parameter("stiffness_n_m"), ("stiffness".into(), "N/m"));
    }
}
