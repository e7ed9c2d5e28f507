// SPDX-License-Identifier: GPL-2.0-or-later
//! The options after `-plugin FILE,`: `key=value` strings.

use std::path::PathBuf;

use crate::wire::RngFault;

/// Instructions are counted from a visit of `begin` to the next visit of one of `ends`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct RegionOption {
    pub(crate) begin: u64,
    pub(crate) ends: Vec<u64>,
}

/// Parsed options.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Options {
    /// `socket=PATH`: where the host side listens.
    pub(crate) socket: PathBuf,
    /// `clock=HZ`: kernel clock of the USARTs.
    pub(crate) clock_hz: u64,
    /// `seed=N`: start of the random number generator's sequence.
    pub(crate) seed: u64,
    /// `rng=silent|seed|seed-once|clock|stuck`: what is wrong with the random number generator.
    pub(crate) rng_fault: Option<RngFault>,
    /// `region=BEGIN:END+END…`, any number of times, addresses in hexadecimal.
    pub(crate) regions: Vec<RegionOption>,
    /// `profile=FILE`: one line `START END` (hexadecimal) per function, in order of address.
    pub(crate) profile: Vec<(u64, u64)>,
    /// `stack=LOW:HIGH`, hexadecimal: the painted stack.
    pub(crate) stack: Option<(u64, u64)>,
}

/// What is wrong with an option.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum OptionError {
    /// No `socket=`.
    NoSocket,
    /// Not `key=value`, or an unknown key, or a value that is no number.
    Bad(String),
}

/// The 80 MHz that the firmware sets up (HSI16 through the PLL).
const DEFAULT_CLOCK_HZ: u64 = 80_000_000;

fn hex(text: &str) -> Option<u64> {
    u64::from_str_radix(text.trim_start_matches("0x"), 16).ok()
}

fn region(value: &str) -> Option<RegionOption> {
    let (begin, ends) = value.split_once(':')?;
    let ends = ends.split('+').map(hex).collect::<Option<Vec<_>>>()?;
    Some(RegionOption {
        begin: hex(begin)?,
        ends,
    })
}

fn rng_fault(value: &str) -> Option<RngFault> {
    RngFault::ALL
        .into_iter()
        .find(|fault| fault.name() == value)
}

fn range(value: &str) -> Option<(u64, u64)> {
    let (low, high) = value.split_once(':')?;
    Some((hex(low)?, hex(high)?)).filter(|(low, high)| low < high)
}

fn profile(path: &str) -> Option<Vec<(u64, u64)>> {
    let text = std::fs::read_to_string(path).ok()?;
    let line = |line: &str| {
        let (start, end) = line.split_once(' ')?;
        Some((hex(start)?, hex(end)?))
    };
    let ranges = text.lines().map(line).collect::<Option<Vec<_>>>()?;
    ranges.is_sorted().then_some(ranges)
}

/// Reads the options.
pub(crate) fn parse<'a>(arguments: impl Iterator<Item = &'a str>) -> Result<Options, OptionError> {
    let mut socket = None;
    let mut options = Options {
        socket: PathBuf::new(),
        clock_hz: DEFAULT_CLOCK_HZ,
        seed: 0,
        rng_fault: None,
        regions: Vec::new(),
        profile: Vec::new(),
        stack: None,
    };
    for argument in arguments {
        let bad = || OptionError::Bad(argument.to_owned());
        let (key, value) = argument.split_once('=').ok_or_else(bad)?;
        match key {
            "socket" => socket = Some(PathBuf::from(value)),
            "clock" => {
                options.clock_hz = value.parse().ok().filter(|&hz| hz > 0).ok_or_else(bad)?
            }
            "seed" => options.seed = value.parse().map_err(|_| bad())?,
            "rng" => options.rng_fault = Some(rng_fault(value).ok_or_else(bad)?),
            "region" => options.regions.push(region(value).ok_or_else(bad)?),
            "profile" => options.profile = profile(value).ok_or_else(bad)?,
            "stack" => options.stack = Some(range(value).ok_or_else(bad)?),
            _ => return Err(bad()),
        }
    }
    options.socket = socket.ok_or(OptionError::NoSocket)?;
    Ok(options)
}
