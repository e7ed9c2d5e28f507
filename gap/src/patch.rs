//! The patch: what was found, as a file that a prediction reads back.

use std::fmt::Write as _;

use crate::bench::Diagnosis;
use crate::joint::{Channel, P, Params};
use crate::locate::State;

/// Name of a parameter in the patch file.
fn key(p: P) -> String {
    format!("{p:?}")
        .chars()
        .flat_map(|c| {
            if c.is_uppercase() {
                vec!['_', c.to_ascii_lowercase()]
            } else {
                vec![c]
            }
        })
        .skip(1)
        .collect()
}

/// The found effects under their shared names, and the raw parameters of the joint model.
#[must_use]
pub fn to_toml(d: &Diagnosis) -> String {
    let mut s = String::from("format = 1\nkind = \"joint-patch\"\n");
    for e in &d.verdict.effects {
        let _ = writeln!(
            s,
            "\n[effect.{}.joint_{}]",
            e.effect.name(),
            d.problem.joint
        );
        for (k, v) in &e.parameters {
            let tolerance = (v.ci95[1] - v.ci95[0]) / 3.92;
            let _ = writeln!(
                s,
                "{k} = {{ value = {:?}, tolerance = {tolerance:?}, source = \"gap report\" }}",
                v.value
            );
        }
    }
    s.push_str("\n# The joint model in full; ratios are to the values of dataset.toml.\n[joint]\n");
    for p in P::ALL {
        let v = d.found.params.get(*p);
        if v != Params::neutral(*p) {
            let _ = writeln!(s, "{} = {v:?}", key(*p));
        }
    }
    for c in Channel::ALL {
        let v = d.found.columns[c as usize];
        if v != 1.0 {
            let _ = writeln!(s, "{} = {v:?}", column(c));
        }
    }
    if d.found.arrived {
        let _ = writeln!(s, "{ARRIVED} = 1.0");
    }
    s
}

/// Key of what a column is recorded as, over what it is.
fn column(c: Channel) -> String {
    format!("recorded_{}", format!("{c:?}").to_lowercase())
}

/// Key: 1 if set-points come as the driver's echo shows, not as they were sent.
const ARRIVED: &str = "as_echoed";

/// Why a patch could not be read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PatchError {
    /// A line of the table `[joint]` that is not `name = number` with a known name.
    #[error(
        "line {line}: `{text}` is not a known joint parameter with a number; write the patch with `rb-host gap report --patch`"
    )]
    BadLine {
        /// Line, counted from 1.
        line: usize,
        /// The line.
        text: String,
    },
}

/// Reads the `[joint]` table of a patch.
///
/// # Errors
/// The first line that is no known parameter.
pub fn parse(text: &str) -> Result<State, PatchError> {
    let mut out = State::new(Params::default());
    let mut inside = false;
    for (i, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.starts_with('[') {
            inside = line == "[joint]";
            continue;
        }
        if !inside || line.is_empty() || line.starts_with('#') {
            continue;
        }
        let bad = || PatchError::BadLine {
            line: i + 1,
            text: line.into(),
        };
        let (name, value) = line.split_once('=').ok_or_else(bad)?;
        let name = name.trim();
        let v: f64 = value
            .trim()
            .parse()
            .ok()
            .filter(|v: &f64| v.is_finite())
            .ok_or_else(bad)?;
        let scaled = Channel::ALL.into_iter().find(|c| column(*c) == name);
        match (P::ALL.iter().find(|p| key(**p) == name), scaled) {
            (Some(p), _) => out.params.set(*p, v),
            (None, Some(c)) => out.columns[c as usize] = v,
            (None, None) if name == ARRIVED => out.arrived = v > 0.5,
            (None, None) => return Err(bad()),
        }
    }
    Ok(out)
}
