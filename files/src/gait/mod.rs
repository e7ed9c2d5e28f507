//! `gait.toml`: read into [`control::gait::Gait`] and written back.
//!
//! ```toml
//! format = 1
//! name = "crawl"
//! frequency_hz = 0.2
//! duration_s = 30              # absent: 30 s [paper IV: trial length]
//! rate_a_per_s = 2.0           # absent: 2 [paper: a]
//! coupling = "chain"           # or "none", or [[link]] tables
//! weight = 0.5                 # absent: 0.5 [paper: w]
//! phase_lag_deg = [90, -90, 180, 90, -90]
//! [[oscillator]]               # in joint order
//! amplitude_deg = 40
//! offset_deg = 0
//! initial_phase_deg = 0        # absent on all: the phase-locked start
//! ```
//!
//! Angles end in `_deg` or `_rad`. Unknown keys, numbers that are not finite decimals and values out of range are
//! errors that name file, line, key, value and range.

mod error;
mod walk;
mod write;

use control::gait::{
    AMPLITUDE_RAD, DURATION_S, FREQUENCY_HZ, Gait, Link, MAX_LINKS, MAX_NAME, MAX_OSCILLATORS,
    OFFSET_RAD, Oscillator, PHASE_RAD, RATE_A_PER_S, Range, RawGait, WEIGHT,
};
use control::math::wrap_pi;
use toml::de::DeTable;

pub use error::{Excerpt, GaitFileError, KeyList, ParserText, Problem};
pub(crate) use walk::neat_degrees;
pub use write::to_toml;

use walk::{Allowed, Angle, Section, Source};

/// The format written and read by this version.
pub const FORMAT: i64 = 1;
/// Largest gait file in bytes: 12 oscillators and 24 links with generous comments take under 8 KiB.
pub const MAX_BYTES: usize = 64 * 1024;

/// Trial length of the paper (section IV).
const DEFAULT_DURATION_S: f32 = 30.0;
/// Convergence rate `a` of the paper (section III).
const DEFAULT_RATE_A_PER_S: f32 = 2.0;
/// Coupling weight `w` of the paper (section III).
const DEFAULT_WEIGHT: f32 = 0.5;

const TOP_KEYS: &[&str] = &[
    "format",
    "name",
    "frequency_hz",
    "duration_s",
    "rate_a_per_s",
    "coupling",
    "weight",
    "phase_lag_deg",
    "phase_lag_rad",
    "oscillator",
    "link",
];
const OSCILLATOR_KEYS: &[&str] = &[
    "amplitude_deg",
    "amplitude_rad",
    "offset_deg",
    "offset_rad",
    "initial_phase_deg",
    "initial_phase_rad",
];
const LINK_KEYS: &[&str] = &["from", "to", "weight", "phase_lag_deg", "phase_lag_rad"];
const ANGLES: &[&str] = &["amplitude", "offset", "initial_phase", "phase_lag"];

const AMPLITUDE: Angle = Angle {
    base: "amplitude",
    deg: "amplitude_deg",
    rad: "amplitude_rad",
};
const OFFSET: Angle = Angle {
    base: "offset",
    deg: "offset_deg",
    rad: "offset_rad",
};
const INITIAL_PHASE: Angle = Angle {
    base: "initial_phase",
    deg: "initial_phase_deg",
    rad: "initial_phase_rad",
};
const PHASE_LAG: Angle = Angle {
    base: "phase_lag",
    deg: "phase_lag_deg",
    rad: "phase_lag_rad",
};

/// Reads a gait file. `file_name` is only used in messages.
///
/// A byte order mark at the start is skipped.
///
/// # Errors
/// The first thing wrong, with its line and column.
pub fn parse(file_name: &str, text: &str) -> Result<Gait, GaitFileError> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let source = Source {
        file: file_name,
        text,
    };
    if text.len() > MAX_BYTES {
        let (bytes, max) = (text.len(), MAX_BYTES);
        let mut error = source.error(0, Problem::TooLarge { bytes, max });
        error.source_line.clear();
        return Err(error);
    }
    let document = DeTable::parse(text).map_err(|e| {
        let at = e.span().map_or(0, |span| span.start);
        let parser = ParserText(Excerpt::new(e.message()));
        source.error(at, Problem::Syntax { parser })
    })?;
    let top = Section {
        source,
        table: document.get_ref(),
        start: 0,
        known: TOP_KEYS,
    };
    let raw = read_top(&top)?;
    Gait::try_from(raw).map_err(|e| source.error(0, Problem::Law(e)))
}

fn read_top(top: &Section<'_, '_>) -> Result<RawGait, GaitFileError> {
    read_format(top)?;
    top.check_keys(ANGLES)?;
    let name = read_name(top)?;
    let frequency_hz = top
        .quantity("frequency_hz", range(FREQUENCY_HZ, "Hz"))?
        .ok_or_else(|| top.missing("frequency_hz", "frequency_hz = 0.2"))?;
    let duration_s = top
        .quantity("duration_s", range(DURATION_S, "s"))?
        .unwrap_or(DEFAULT_DURATION_S);
    let rate_a_per_s = top
        .quantity("rate_a_per_s", range(RATE_A_PER_S, "1/s"))?
        .unwrap_or(DEFAULT_RATE_A_PER_S);
    let oscillators = read_oscillators(top)?;
    let links = read_coupling(top, oscillators.len())?;
    let locked_start = wants_locked_start(top, &oscillators)?;
    let mut raw = RawGait {
        name,
        frequency_hz,
        rate_a_per_s,
        duration_s,
        oscillators: heapless::Vec::new(),
        links: heapless::Vec::new(),
    };
    for read in &oscillators {
        // Lengths were checked against the same constants; a full vector cannot happen.
        let _ = raw.oscillators.push(Oscillator {
            amplitude_rad: read.amplitude_rad,
            offset_rad: read.offset_rad,
            initial_phase_rad: read.initial_phase_rad.unwrap_or(0.0),
        });
    }
    for link in links {
        let _ = raw.links.push(link);
    }
    if locked_start {
        raw.lock_phases();
        check_locked(top, &raw)?;
    }
    Ok(raw)
}

/// Sum of lags around a loop may miss a full turn by this much: a tenth of a degree, well under the rounding of lags
/// written in whole degrees and well over that of single precision.
const LOOP_TOLERANCE_RAD: f32 = 0.0017;

/// Whether the phase-locked start is wanted: no initial phase at all.
fn wants_locked_start(
    top: &Section<'_, '_>,
    rows: &[OscillatorRow],
) -> Result<bool, GaitFileError> {
    let without = |row: &&OscillatorRow| row.initial_phase_rad.is_none();
    match rows.iter().filter(without).count() {
        0 => Ok(false),
        n if n == rows.len() => Ok(true),
        _ => {
            let at = rows.iter().find(without).map_or(0, |row| row.start);
            Err(top.source.error(at, Problem::SomePhases))
        }
    }
}

/// Refuses a ring of links that no set of phases can lock.
fn check_locked(top: &Section<'_, '_>, raw: &RawGait) -> Result<(), GaitFileError> {
    let phase = |i: u8| {
        raw.oscillators
            .get(usize::from(i))
            .map_or(0.0, |o| o.initial_phase_rad)
    };
    let closed = |link: &Link| {
        wrap_pi(phase(link.to) - phase(link.from) - link.phase_lag_rad).abs() < LOOP_TOLERANCE_RAD
    };
    if raw.links.iter().all(closed) {
        Ok(())
    } else {
        Err(top.source.error(0, Problem::OpenLoop))
    }
}

/// One `[[oscillator]]` before the start phases are known.
struct OscillatorRow {
    amplitude_rad: f32,
    offset_rad: f32,
    initial_phase_rad: Option<f32>,
    start: usize,
}

/// A limit such as 0.01 as written, without the tail of single precision.
pub(crate) fn neat(limit: f32) -> f64 {
    limit.to_string().parse().unwrap_or(f64::from(limit))
}

fn range(limits: Range, unit: &'static str) -> Allowed {
    Allowed {
        min: neat(limits.min),
        max: neat(limits.max),
        unit,
    }
}

fn read_format(top: &Section<'_, '_>) -> Result<(), GaitFileError> {
    let Some((format, span)) = top.integer("format")? else {
        return Err(top.missing("format", "format = 1"));
    };
    if format != FORMAT {
        let value = top.source.excerpt(&span);
        let supported = FORMAT;
        let problem = Problem::Format { value, supported };
        return Err(top.source.error(span.start, problem));
    }
    Ok(())
}

fn read_name(top: &Section<'_, '_>) -> Result<heapless::String<MAX_NAME>, GaitFileError> {
    let Some(value) = top.get("name") else {
        return Err(top.missing("name", "name = \"crawl\""));
    };
    let span = value.span();
    let Some(text) = value.get_ref().as_str() else {
        return Err(top
            .source
            .wrong_type("name", &span, value.get_ref(), "a string"));
    };
    if let Some(c) = text.chars().find(|c| error::is_unprintable(*c)) {
        let character = Excerpt::new(&c.to_string());
        return Err(top
            .source
            .error(span.start, Problem::NameCharacter { character }));
    }
    let length = Problem::NameLength {
        bytes: text.len(),
        max: MAX_NAME,
    };
    if text.trim().is_empty() {
        return Err(top.source.error(span.start, length));
    }
    heapless::String::try_from(text).map_err(|_| top.source.error(span.start, length))
}

fn read_oscillators(top: &Section<'_, '_>) -> Result<Vec<OscillatorRow>, GaitFileError> {
    let Some((tables, at)) = top.tables("oscillator")? else {
        return Err(top.missing("oscillator", "[[oscillator]]"));
    };
    if tables.is_empty() || tables.len() > MAX_OSCILLATORS {
        let problem = Problem::Count {
            key: "oscillator",
            found: tables.len(),
            min: 1,
            max: MAX_OSCILLATORS,
            why: ", one per joint",
        };
        return Err(top.source.error(at, problem));
    }
    tables
        .into_iter()
        .map(|(table, start)| {
            read_oscillator(&Section {
                source: top.source,
                table,
                start,
                known: OSCILLATOR_KEYS,
            })
        })
        .collect()
}

fn read_oscillator(section: &Section<'_, '_>) -> Result<OscillatorRow, GaitFileError> {
    section.check_keys(ANGLES)?;
    Ok(OscillatorRow {
        amplitude_rad: section
            .angle(&AMPLITUDE, AMPLITUDE_RAD)?
            .ok_or_else(|| section.missing("amplitude_deg", "amplitude_deg = 40"))?,
        offset_rad: section.angle(&OFFSET, OFFSET_RAD)?.unwrap_or(0.0),
        initial_phase_rad: section.angle(&INITIAL_PHASE, PHASE_RAD)?,
        start: section.start,
    })
}

fn read_coupling(top: &Section<'_, '_>, oscillators: usize) -> Result<Vec<Link>, GaitFileError> {
    if let Some((tables, at)) = top.tables("link")? {
        for key in ["coupling", "weight", "phase_lag_deg", "phase_lag_rad"] {
            if let Some(value) = top.get(key) {
                let other = "[[link]]";
                let problem = Problem::Conflict { key, other };
                return Err(top.source.error(value.span().start, problem));
            }
        }
        return read_links(top, &tables, at, oscillators);
    }
    let coupling = top
        .get("coupling")
        .ok_or_else(|| top.missing("coupling", "coupling = \"chain\""))?;
    match coupling.get_ref().as_str() {
        Some("chain") => read_chain(top, oscillators),
        Some("none") => {
            for key in ["weight", "phase_lag_deg", "phase_lag_rad"] {
                if let Some(value) = top.get(key) {
                    let other = "coupling = \"none\"";
                    let problem = Problem::Conflict { key, other };
                    return Err(top.source.error(value.span().start, problem));
                }
            }
            Ok(Vec::new())
        }
        _ => {
            let span = coupling.span();
            let problem = Problem::NotOneOf {
                key: "coupling",
                value: top.source.excerpt(&span),
                allowed: "\"chain\", \"none\", or leave it out and write [[link]] tables",
            };
            Err(top.source.error(span.start, problem))
        }
    }
}

fn read_chain(top: &Section<'_, '_>, oscillators: usize) -> Result<Vec<Link>, GaitFileError> {
    let weight = top
        .quantity("weight", range(WEIGHT, ""))?
        .unwrap_or(DEFAULT_WEIGHT);
    let joints = oscillators.saturating_sub(1);
    let Some((value, unit)) = top.either(&PHASE_LAG)? else {
        if joints == 0 {
            return Ok(Vec::new());
        }
        return Err(top.missing("phase_lag_deg", "phase_lag_deg = [90, -90, 180, 90, -90]"));
    };
    let list = top.list("phase_lag", value)?;
    if list.len() != joints {
        let problem = Problem::Count {
            key: "phase_lag",
            found: list.len(),
            min: joints,
            max: joints,
            why: ", one fewer than oscillators",
        };
        return Err(top.source.error(value.span().start, problem));
    }
    let lags = list.iter().enumerate().map(|(i, lag)| {
        let phase_lag_rad = walk::read_angle(&top.source, &PHASE_LAG, unit, lag, PHASE_RAD)?;
        Ok(link(i, i + 1, weight, phase_lag_rad))
    });
    lags.collect()
}

fn read_links(
    top: &Section<'_, '_>,
    tables: &[(&DeTable<'_>, usize)],
    at: usize,
    oscillators: usize,
) -> Result<Vec<Link>, GaitFileError> {
    if tables.len() > MAX_LINKS {
        let problem = Problem::Count {
            key: "link",
            found: tables.len(),
            min: 0,
            max: MAX_LINKS,
            why: "",
        };
        return Err(top.source.error(at, problem));
    }
    let mut links: Vec<Link> = Vec::new();
    for (table, start) in tables {
        let section = Section {
            source: top.source,
            table,
            start: *start,
            known: LINK_KEYS,
        };
        let link = read_link(&section, oscillators, &links)?;
        links.push(link);
    }
    Ok(links)
}

fn read_link(
    section: &Section<'_, '_>,
    oscillators: usize,
    before: &[Link],
) -> Result<Link, GaitFileError> {
    section.check_keys(ANGLES)?;
    let (from, from_span) = section
        .integer("from")?
        .ok_or_else(|| section.missing("from", "from = 0"))?;
    let (to, _) = section
        .integer("to")?
        .ok_or_else(|| section.missing("to", "to = 1"))?;
    let refuse = |why| {
        let last = oscillators.saturating_sub(1);
        let problem = Problem::Link {
            from,
            to,
            why,
            last,
        };
        Err(section.source.error(from_span.start, problem))
    };
    let inside = |end: i64| usize::try_from(end).ok().filter(|end| *end < oscillators);
    let (Some(a), Some(b)) = (inside(from), inside(to)) else {
        return refuse("no such oscillator");
    };
    if a == b {
        return refuse("links an oscillator to itself");
    }
    let same = |l: &&Link| {
        let ends = (usize::from(l.from), usize::from(l.to));
        ends == (a, b) || ends == (b, a)
    };
    if before.iter().find(same).is_some() {
        return refuse("given twice (one entry links both ways)");
    }
    let weight = section
        .quantity("weight", range(WEIGHT, ""))?
        .unwrap_or(DEFAULT_WEIGHT);
    let lag = section
        .angle(&PHASE_LAG, PHASE_RAD)?
        .ok_or_else(|| section.missing("phase_lag_deg", "phase_lag_deg = 30"))?;
    Ok(link(a, b, weight, lag))
}

/// Ends are below [`MAX_OSCILLATORS`], so they fit a byte.
fn link(from: usize, to: usize, weight: f32, phase_lag_rad: f32) -> Link {
    Link {
        from: u8::try_from(from).unwrap_or(u8::MAX),
        to: u8::try_from(to).unwrap_or(u8::MAX),
        weight,
        phase_lag_rad,
    }
}

#[cfg(test)]
mod tests;
