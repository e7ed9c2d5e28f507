//! Numbers, units and names as a tired person reads them: three digits, mrad, mm, ms and N m.

use crate::verdict::{Verdict, Where};

/// Three significant digits.
pub(crate) fn number(x: f64) -> String {
    let size = x.abs();
    if x == 0.0 {
        "0".into()
    } else if (1e-4..1e5).contains(&size) {
        // Decimals that leave three digits: 2 minus the decimal exponent, between 0 and 6.
        let decimals = (2.0 - libm::floor(libm::log10(size))).clamp(0.0, 6.0) as usize;
        format!("{x:.decimals$}")
    } else {
        format!("{x:.2e}")
    }
}

/// `a`, `a and b`, `a, b and c`; beyond `most` names `a, b, c and 2 more`.
pub(crate) fn listed<S: AsRef<str>>(names: &[S], most: usize, joined_by: &str) -> String {
    let named = names.iter().take(most).map(|n| n.as_ref().to_owned());
    let mut shown: Vec<String> = named.collect();
    if names.len() > most {
        shown.push(format!("{} more", names.len() - most));
    }
    match shown.split_last() {
        Some((last, [])) => last.clone(),
        Some((last, others)) => format!("{} {joined_by} {last}", others.join(", ")),
        None => String::new(),
    }
}

/// Factor to, and name of, the unit that values up to `largest` are shown in. Angles are always in mrad.
pub(crate) fn shown_in(unit: &str, largest: f64) -> (f64, &str) {
    let small = largest.abs() < 1.0;
    match unit {
        "rad" => (1e3, "mrad"),
        "m" if small => (1e3, "mm"),
        "s" if small => (1e3, "ms"),
        "1" => (1.0, ""),
        _ => (1.0, unit),
    }
}

fn with_unit(x: f64, unit: &str) -> String {
    let space = if unit.is_empty() { "" } else { " " };
    format!("{}{space}{unit}", number(x))
}

/// A value with its unit.
pub(crate) fn quantity(x: f64, unit: &str) -> String {
    let (factor, unit) = shown_in(unit, x);
    with_unit(factor * x, unit)
}

/// Two values in one unit: the first without its name.
pub(crate) fn range(ends: [f64; 2], unit: &str) -> [String; 2] {
    let (factor, unit) = shown_in(unit, ends[0].abs().max(ends[1].abs()));
    [number(factor * ends[0]), with_unit(factor * ends[1], unit)]
}

/// Shares and ratios are per cent.
fn is_ratio(key: &str) -> bool {
    ["ratio", "fraction", "probability"].contains(&key)
}

fn per_cent(x: f64) -> String {
    let p = 100.0 * x;
    // Two decimals where a clock's rate differs from one.
    if (p - 100.0).abs() < 1.0 {
        format!("{p:.2} %")
    } else if p >= 1000.0 && p.is_finite() {
        // A ratio beyond ten is no plausible one: its fourth digit says nothing.
        let step = libm::pow(10.0, libm::floor(libm::log10(p)) - 2.0);
        format!("{} %", number((p / step).round() * step))
    } else {
        format!("{} %", number(p))
    }
}

/// Unit on a linear joint.
fn linear_unit(unit: &'static str) -> &'static str {
    match unit {
        "rad" => "m",
        "rad/s" => "m/s",
        "N m" => "N",
        "N m s/rad" => "N s/m",
        "N m s²/rad²" => "N s²/m²",
        "N m/rad" => "N/m",
        other => other,
    }
}

/// One value of parameter `key`, or two that are its ends; of a `linear` joint or a rotary one.
pub(super) fn size(key: &str, [low, high]: [f64; 2], linear: bool) -> String {
    let unit = parameter(key).1;
    let unit = if linear { linear_unit(unit) } else { unit };
    let [from, to] = if is_ratio(key) {
        [per_cent(low), per_cent(high)]
    } else {
        range([low, high], unit)
    };
    if to == from
        || to
            .strip_prefix(&from)
            .is_some_and(|rest| rest.starts_with(' '))
    {
        to
    } else {
        format!("{from} to {to}")
    }
}

/// First letter large.
pub(super) fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| {
        first.to_uppercase().chain(letters).collect()
    })
}

/// Text that stands in HTML as it is; no line breaks before a per cent sign.
pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
        .replace(" %", "\u{a0}%")
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
pub(crate) fn parameter(key: &str) -> (String, &'static str) {
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

/// What a metric measures.
pub(super) fn metric(name: &str) -> &str {
    const PLAIN: [(&str, &str); 10] = [
        ("position_rmse", "position, RMS error"),
        ("position_mae", "position, mean absolute error"),
        ("link_rmse", "angle behind the gear, RMS error"),
        ("effort_rmse", "torque, RMS error"),
        ("pose_rmse", "place of the body after 1 s, RMS error"),
        (
            "pose_rollout",
            "place of the body over whole runs, RMS error",
        ),
        ("heading_rmse", "heading, RMS error"),
        ("speed_error", "mean speed, relative error"),
        ("similarity_r", "overlap of the films (1 is all)"),
        ("current_rmse", "current, RMS error"),
    ];
    let plain = PLAIN.iter().find(|(start, _)| name.starts_with(start));
    plain.map_or(name, |p| p.1)
}

/// Values of a metric before, calibrated and after, in one unit, and its name with that unit.
pub(super) fn metric_row(key: &str, values: [f64; 3]) -> (String, [String; 3]) {
    let bare = key.starts_with("speed_error") || key.starts_with("similarity");
    let unit = if bare { "" } else { parameter(key).1 };
    let largest = values.into_iter().fold(0.0, |a: f64, x| a.max(x.abs()));
    let (factor, unit) = shown_in(unit, largest);
    let name = match unit {
        "" => metric(key).to_owned(),
        unit => format!("{} [{unit}]", metric(key)),
    };
    (name, values.map(|x| number(factor * x)))
}

/// When most of a share shows, as the end of a line.
pub(super) fn regime(w: &Where) -> &'static str {
    match w.regime.as_str() {
        "saturation" => "most of it at the limits of the motor",
        "reversal" => "most of it where the joint reverses",
        "low_speed" => "most of it at low speed",
        "high_load" => "most of it under high load",
        "warm_up" => "most of it while the motor warms up",
        _ => "",
    }
}

/// Where the floor comes from.
pub(super) fn floor(v: &Verdict) -> &'static str {
    match v.gap.floor_source.as_str() {
        "repeats" => "how far repeats of one motion differ",
        "tolerance" => "what the uncertainty of the measured starts and loads explains",
        _ => "noise of the signal; the data set has no repeats",
    }
}

/// The floor with what it is, where it is first named.
pub(super) fn floor_explained(v: &Verdict) -> &'static str {
    match v.gap.floor_source.as_str() {
        "repeats" => "repeatability floor (what two takes of one motion differ by)",
        "tolerance" => "floor (what the uncertainty of starts and loads explains)",
        _ => "floor (noise of the signal)",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_three_digits_and_one_unit() {
        let table = [
            (0.0, "0"),
            (0.084, "0.0840"),
            (-1.5, "-1.50"),
            (12345.6, "12346"),
            (2.5e-7, "2.50e-7"),
        ];
        for (x, text) in table {
            assert_eq!(number(x), text);
        }
        for (x, unit, text) in [
            (0.0213, "rad", "21.3 mrad"),
            (1.6, "rad", "1600 mrad"),
            (0.0123, "m", "12.3 mm"),
            (1.25, "s", "1.25 s"),
            (0.5, "N m", "0.500 N m"),
            (0.5, "", "0.500"),
        ] {
            assert_eq!(quantity(x, unit), text);
        }
        assert_eq!(range([0.5, 1.5], "s"), ["0.500", "1.50 s"]);
    }

    #[test]
    fn sizes_are_one_value_or_two_ends() {
        for (key, ends, linear, text) in [
            ("torque_nm", [0.6, 0.8], false, "0.600 to 0.800 N m"),
            ("torque_nm", [0.6, 0.6], true, "0.600 N"),
            ("half_width_rad", [0.009, 0.009], false, "9.00 mrad"),
            ("half_width_rad", [0.009, 0.009], true, "9.00 mm"),
            ("ratio", [0.8, 1.25], false, "80.0 % to 125 %"),
            ("ratio", [1.0003, 1.0003], false, "100.03 %"),
            ("ratio", [24.45, 24.45], false, "2450 %"),
            ("ratio", [123.45, 123.45], false, "12300 %"),
            ("periods", [12.0, 12.0], false, "12.0"),
        ] {
            assert_eq!(size(key, ends, linear), text);
        }
    }

    #[test]
    fn long_lists_are_counted() {
        let names = ["a", "b", "c", "d", "e"];
        let table = [
            (0, ""),
            (1, "a"),
            (2, "a and b"),
            (3, "a, b and c"),
            (5, "a, b, c and 2 more"),
        ];
        for (count, text) in table {
            assert_eq!(listed(&names[..count], 3, "and"), text);
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
