//! One run: CSV text into columns.

use super::error::{DatasetError, Warning};
use super::manifest::{Command, Manifest, Motion};

/// A signal that exists once per joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Signal {
    /// Command as sent.
    Setpoint,
    /// Command as the driver applied it.
    AppliedSetpoint,
    /// 1 while a command is in force.
    Enable,
    /// Motor-side encoder divided by the gear ratio.
    Position,
    /// Angle behind the transmission.
    LinkPosition,
    /// Speed as the driver reports it.
    Velocity,
    /// Signed motor current.
    Current,
    /// Unsigned motor current.
    CurrentAbs,
    /// Signed effort.
    Effort,
    /// Unsigned effort.
    EffortAbs,
    /// Duty, -1..1 of bus voltage.
    Duty,
    /// Case temperature.
    Temperature,
}

impl Signal {
    /// All signals, in declaration order.
    pub const ALL: [Self; 12] = [
        Self::Setpoint,
        Self::AppliedSetpoint,
        Self::Enable,
        Self::Position,
        Self::LinkPosition,
        Self::Velocity,
        Self::Current,
        Self::CurrentAbs,
        Self::Effort,
        Self::EffortAbs,
        Self::Duty,
        Self::Temperature,
    ];

    /// Values outside are unit errors: 1e4 rad are 1600 turns, 1e5 N or A no small joint sees.
    fn range(self) -> (f64, f64) {
        match self {
            Self::Enable => (0.0, 1.0),
            Self::Duty => (-1.05, 1.05),
            Self::Temperature => (-80.0, 400.0),
            Self::CurrentAbs | Self::EffortAbs => (0.0, 1e5),
            Self::Current | Self::Effort => (-1e5, 1e5),
            _ => (-1e4, 1e4),
        }
    }
}

/// Header name of a signal without joint suffix.
#[must_use]
pub fn header_name(signal: Signal, motion: Motion) -> &'static str {
    let rotary = motion == Motion::Rotary;
    match signal {
        Signal::Setpoint => ["setpoint_m", "setpoint_rad"][usize::from(rotary)],
        Signal::AppliedSetpoint => {
            ["applied_setpoint_m", "applied_setpoint_rad"][usize::from(rotary)]
        }
        Signal::Enable => "enable",
        Signal::Position => ["position_m", "position_rad"][usize::from(rotary)],
        Signal::LinkPosition => ["link_position_m", "link_position_rad"][usize::from(rotary)],
        Signal::Velocity => ["velocity_m_s", "velocity_rad_s"][usize::from(rotary)],
        Signal::Current => "current_a",
        Signal::CurrentAbs => "current_abs_a",
        Signal::Effort => ["effort_n", "effort_nm"][usize::from(rotary)],
        Signal::EffortAbs => ["effort_n_abs", "effort_nm_abs"][usize::from(rotary)],
        Signal::Duty => "duty",
        Signal::Temperature => "temperature_c",
    }
}

/// Other names a bench's command may have, by what the command is.
fn command_aliases(command: Command, motion: Motion) -> &'static [&'static str] {
    match (command, motion) {
        (Command::Position, _) => &[],
        (Command::Effort, Motion::Rotary) => &["setpoint_nm"],
        (Command::Effort, Motion::Linear) => &["setpoint_n"],
        (Command::Voltage, _) => &["setpoint_v"],
    }
}

/// Columns of one joint. NaN marks "no sample in this row".
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JointColumns {
    columns: [Option<Vec<f64>>; Signal::ALL.len()],
}

impl JointColumns {
    /// The column of `signal`, one entry per row, NaN where there is no sample; `None` if never measured.
    #[must_use]
    pub fn get(&self, signal: Signal) -> Option<&[f64]> {
        self.columns[signal as usize].as_deref()
    }

    /// Replaces or adds a column (grafts of known faults onto recordings). The length must be that of the recording.
    pub fn set(&mut self, signal: Signal, column: Option<Vec<f64>>) {
        self.columns[signal as usize] = column;
    }
}

/// Columns of the whole robot, each optional, NaN marks "no sample".
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Body {
    /// Bus voltage, V.
    pub bus_v: Option<Vec<f64>>,
    /// Angular rate, x, y, z.
    pub gyro_rad_s: [Option<Vec<f64>>; 3],
    /// Specific force, x, y, z.
    pub accel_m_s2: [Option<Vec<f64>>; 3],
    /// Position of body 3 in the world.
    pub base_m: [Option<Vec<f64>>; 3],
    /// Attitude of body 3, Hamilton, w first.
    pub base_q: [Option<Vec<f64>>; 4],
}

/// One run in columns; row `i` was taken at `t_s()[i]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    t_s: Vec<f64>,
    joints: Vec<JointColumns>,
    body: Body,
}

enum Target {
    Time,
    Joint(usize, Signal),
    Shared(usize),
    Skip,
}

const SHARED: [&str; 14] = [
    "bus_v",
    "gyro_rad_s_x",
    "gyro_rad_s_y",
    "gyro_rad_s_z",
    "accel_m_s2_x",
    "accel_m_s2_y",
    "accel_m_s2_z",
    "base_x_m",
    "base_y_m",
    "base_z_m",
    "base_qw",
    "base_qx",
    "base_qy",
    "base_qz",
];

fn classify(header: &str, headers: &[String], manifest: &Manifest) -> Target {
    let canonical = manifest
        .signals
        .iter()
        .find(|(_, column)| *column == header)
        .map(|(name, _)| name.as_str());
    // A canonical name whose signal stands in another column of this file is not that signal.
    let taken = |column: &String| column != header && headers.contains(column);
    if canonical.is_none() && manifest.signals.get(header).is_some_and(taken) {
        return Target::Skip;
    }
    let name = canonical.unwrap_or(header);
    if name == "t_s" {
        return Target::Time;
    }
    if let Some(i) = SHARED.iter().position(|s| *s == name) {
        return Target::Shared(i);
    }
    let joints = manifest.joints();
    let (base, joint) = match name.rsplit_once('_') {
        Some((base, k)) if k.len() == 1 && k.as_bytes()[0].is_ascii_digit() => {
            (base, k.parse().unwrap_or(usize::MAX))
        }
        _ if joints == 1 => (name, 0),
        _ => return Target::Skip,
    };
    if joint >= joints {
        return Target::Skip;
    }
    let motion = manifest.bench.motion;
    if command_aliases(manifest.bench.command, motion).contains(&base) {
        return Target::Joint(joint, Signal::Setpoint);
    }
    let found = Signal::ALL
        .into_iter()
        .find(|s| header_name(*s, motion) == base);
    found.map_or(Target::Skip, |s| Target::Joint(joint, s))
}

/// Header that `[signals]` gives for a signal of the first joint.
fn renamed<'a>(manifest: &'a Manifest, name: &str) -> Option<&'a str> {
    let first = |n: &str| n.strip_suffix("_0").unwrap_or(n) == name;
    let mut of = manifest.signals.iter().filter(|(n, _)| first(n));
    of.next().map(|(_, column)| column.as_str())
}

struct Reader<'a> {
    file: &'a str,
    headers: Vec<String>,
    targets: Vec<Target>,
}

impl<'a> Reader<'a> {
    fn new(
        file: &'a str,
        headers: Vec<String>,
        manifest: &Manifest,
        warnings: &mut Vec<Warning>,
    ) -> Result<Self, DatasetError> {
        for (i, h) in headers.iter().enumerate() {
            if headers[..i].contains(h) {
                return Err(DatasetError::DoubleColumn {
                    file: file.into(),
                    column: h.clone(),
                });
            }
        }
        for (name, column) in &manifest.signals {
            if !headers.contains(column) && !headers.contains(name) {
                warnings.push(Warning::Renamed {
                    file: file.into(),
                    name: name.clone(),
                    column: column.clone(),
                });
            }
        }
        let targets: Vec<Target> = headers
            .iter()
            .map(|h| classify(h, &headers, manifest))
            .collect();
        for (h, t) in headers.iter().zip(&targets) {
            if matches!(t, Target::Skip) {
                warnings.push(Warning::UnknownColumn {
                    file: file.into(),
                    column: h.clone(),
                });
            }
        }
        let reader = Self {
            file,
            headers,
            targets,
        };
        reader.joints_without(manifest, warnings);
        reader.require(
            |t| matches!(t, Target::Time),
            "t_s",
            "every run needs the device time in seconds",
        )?;
        let name = header_name(Signal::Setpoint, manifest.bench.motion);
        let is_setpoint = |t: &Target| {
            matches!(
                t,
                Target::Joint(_, Signal::Setpoint | Signal::AppliedSetpoint)
            )
        };
        let column = renamed(manifest, name).unwrap_or(name);
        let hint = "every run needs its command; name its column under [signals]";
        reader.require(is_setpoint, column, hint)?;
        Ok(reader)
    }

    /// Warns of joints that lack a column that another joint has.
    fn joints_without(&self, manifest: &Manifest, warnings: &mut Vec<Warning>) {
        let has = |k: usize, s: Signal| {
            let is = |t: &Target| matches!(t, Target::Joint(j, of) if *j == k && *of == s);
            self.targets.iter().any(is)
        };
        for signal in Signal::ALL {
            let (with, without): (Vec<usize>, Vec<usize>) =
                (0..manifest.joints()).partition(|k| has(*k, signal));
            if with.is_empty() {
                continue;
            }
            for joint in without {
                let name = header_name(signal, manifest.bench.motion);
                warnings.push(Warning::JointWithout {
                    file: self.file.into(),
                    column: format!("{name}_{joint}"),
                });
            }
        }
    }

    fn require(
        &self,
        test: impl Fn(&Target) -> bool,
        column: &str,
        hint: &str,
    ) -> Result<(), DatasetError> {
        if self.targets.iter().any(test) {
            return Ok(());
        }
        Err(DatasetError::MissingColumn {
            file: self.file.into(),
            column: column.into(),
            hint: hint.into(),
        })
    }

    fn cell(&self, text: &str, column: usize, line: usize) -> Result<f64, DatasetError> {
        let text = text.trim();
        if text.is_empty() && !matches!(self.targets[column], Target::Time) {
            return Ok(f64::NAN);
        }
        let name = || self.headers[column].clone();
        let value = text
            .parse::<f64>()
            .ok()
            .filter(|x| x.is_finite())
            .ok_or_else(|| DatasetError::NotANumber {
                file: self.file.into(),
                line,
                column: name(),
                text: text.chars().take(40).collect(),
            })?;
        let (low, high) = match self.targets[column] {
            Target::Joint(_, s) => s.range(),
            // Seconds of any epoch; a clock in milliseconds or finer since 1970 is a unit error.
            Target::Time => (-1e10, 1e10),
            Target::Shared(0) => (-1.0, 1000.0),
            _ => (-1e9, 1e9),
        };
        if !(low..=high).contains(&value) {
            return Err(DatasetError::Range {
                file: self.file.into(),
                line,
                column: name(),
                value,
                low,
                high,
            });
        }
        Ok(value)
    }
}

/// Lines of a text by rising positions. The CSV reader's own count is one too small after `\r\n` and ignores empty lines.
struct Lines<'a> {
    text: &'a [u8],
    at: usize,
    line: usize,
}

impl<'a> Lines<'a> {
    fn of(text: &'a str) -> Self {
        Self {
            text: text.as_bytes(),
            at: 0,
            line: 1,
        }
    }

    /// Line, from 1, of the first row at or after a position.
    fn at(&mut self, byte: u64) -> usize {
        let byte = usize::try_from(byte).unwrap_or(usize::MAX);
        while let Some(next) = self.text.get(self.at) {
            // Line ends between two rows belong to neither.
            if self.at >= byte && !matches!(next, b'\r' | b'\n') {
                break;
            }
            self.line += usize::from(*next == b'\n');
            self.at += 1;
        }
        self.line
    }
}

/// The CSV reader's reason without its own place, which is wrong in a file with `\r\n`.
fn reason(error: &csv::Error) -> String {
    match error.kind() {
        csv::ErrorKind::UnequalLengths {
            expected_len, len, ..
        } => format!("this row has {len} cells, the rows above have {expected_len}"),
        csv::ErrorKind::Utf8 { .. } => "not UTF-8 text; save the file as UTF-8".to_owned(),
        _ => error.to_string(),
    }
}

impl Recording {
    /// Parses the text of one CSV file of the data set `manifest`.
    ///
    /// # Errors
    /// The first missing column, bad cell or step back in time, with line and column.
    pub fn parse(
        file: &str,
        text: &str,
        manifest: &Manifest,
    ) -> Result<(Self, Vec<Warning>), DatasetError> {
        let mut warnings = Vec::new();
        let content = text.trim_start_matches('\u{feff}');
        let mut csv = csv::ReaderBuilder::new()
            .has_headers(true)
            .from_reader(content.as_bytes());
        let fail = |e: csv::Error| DatasetError::Csv {
            file: file.into(),
            line: e.position().map_or(1, |p| Lines::of(content).at(p.byte())),
            reason: reason(&e),
        };
        let headers = csv
            .headers()
            .map_err(fail)?
            .iter()
            .map(|h| h.trim().to_string())
            .collect();
        let reader = Reader::new(file, headers, manifest, &mut warnings)?;
        let mut columns: Vec<Vec<f64>> = vec![Vec::new(); reader.targets.len()];
        let mut lines: Vec<usize> = Vec::new();
        let mut record = csv::StringRecord::new();
        let mut line_of = Lines::of(content);
        while csv.read_record(&mut record).map_err(fail)? {
            let line = record.position().map_or(0, |p| line_of.at(p.byte()));
            lines.push(line);
            for (k, column) in columns.iter_mut().enumerate() {
                if !matches!(reader.targets[k], Target::Skip) {
                    column.push(reader.cell(record.get(k).unwrap_or(""), k, line)?);
                }
            }
        }
        let recording = assemble(&reader, columns, manifest.joints());
        recording.check(file, &lines, &reader, &mut warnings)?;
        Ok((recording, warnings))
    }

    fn check(
        &self,
        file: &str,
        lines: &[usize],
        reader: &Reader<'_>,
        warnings: &mut Vec<Warning>,
    ) -> Result<(), DatasetError> {
        let t = &self.t_s;
        if t.len() < 2 {
            return Err(DatasetError::TooShort {
                file: file.into(),
                rows: t.len(),
            });
        }
        for (pair, line) in t.windows(2).zip(&lines[1..]) {
            if pair[1] < pair[0] {
                let (t_s, previous_s) = (pair[1], pair[0]);
                return Err(DatasetError::TimeOrder {
                    file: file.into(),
                    line: *line,
                    t_s,
                    previous_s,
                });
            }
        }
        if let Some((row, column)) = self.twice(reader) {
            warnings.push(Warning::SameTime {
                file: file.into(),
                line: lines[row],
                column,
                t_s: t[row],
            });
        }
        let step_s = self.step_s();
        // Ten usual steps without a row: the recording stopped, or the bus did.
        let hole = t
            .windows(2)
            .position(|p| p[1] - p[0] > 10.0 * step_s && p[1] - p[0] > 0.1);
        if let Some(i) = hole {
            let gap_s = t[i + 1] - t[i];
            warnings.push(Warning::Gap {
                file: file.into(),
                line: lines[i + 1],
                gap_s,
                step_s,
            });
        }
        for (h, target) in reader.headers.iter().zip(&reader.targets) {
            let Target::Joint(k, s @ (Signal::Position | Signal::LinkPosition)) = target else {
                continue;
            };
            let values = self.joints[*k].get(*s).unwrap_or_default();
            if values
                .iter()
                .filter(|v| !v.is_nan())
                .all(|v| *v == values[0])
            {
                warnings.push(Warning::Constant {
                    file: file.into(),
                    column: h.clone(),
                });
            }
        }
        Ok(())
    }

    /// The first row with the time of the row before and a value in a column in which that one has a value too.
    fn twice(&self, reader: &Reader<'_>) -> Option<(usize, String)> {
        let same = |i: &usize| self.t_s[*i] == self.t_s[*i - 1];
        (1..self.t_s.len()).filter(same).find_map(|i| {
            let mut columns = reader.headers.iter().zip(&reader.targets);
            columns.find_map(|(header, target)| {
                let Target::Joint(k, s) = target else {
                    return None;
                };
                let values = self.joints[*k].get(*s)?;
                let both = !values[i].is_nan() && !values[i - 1].is_nan();
                both.then(|| (i, header.clone()))
            })
        })
    }

    /// Number of rows, at least 2.
    #[must_use]
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// Never true; a run has at least two rows.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// Device time of every row, s, never decreasing.
    #[must_use]
    pub fn t_s(&self) -> &[f64] {
        &self.t_s
    }

    /// Columns of joint `k`, if there is such a joint.
    #[must_use]
    pub fn joint(&self, k: usize) -> Option<&JointColumns> {
        self.joints.get(k)
    }

    /// Columns of joint `k`, to be changed.
    pub fn joint_mut(&mut self, k: usize) -> Option<&mut JointColumns> {
        self.joints.get_mut(k)
    }

    /// Columns of the whole robot.
    #[must_use]
    pub fn body(&self) -> &Body {
        &self.body
    }

    /// Median time between rows, s.
    #[must_use]
    pub fn step_s(&self) -> f64 {
        let mut d: Vec<f64> = self.t_s.windows(2).map(|p| p[1] - p[0]).collect();
        d.sort_by(f64::total_cmp);
        d.get(d.len() / 2).copied().unwrap_or(0.0)
    }

    /// Same rows at other times (grafts of clock faults). Times must not decrease.
    #[must_use]
    pub fn with_times(mut self, t_s: Vec<f64>) -> Self {
        if t_s.len() == self.t_s.len() && t_s.windows(2).all(|p| p[1] >= p[0]) {
            self.t_s = t_s;
        }
        self
    }
}

fn assemble(reader: &Reader<'_>, columns: Vec<Vec<f64>>, joints: usize) -> Recording {
    let mut out = Recording {
        t_s: Vec::new(),
        joints: vec![JointColumns::default(); joints],
        body: Body::default(),
    };
    for (target, column) in reader.targets.iter().zip(columns) {
        match target {
            Target::Time => out.t_s = column,
            Target::Joint(k, s) => out.joints[*k].set(*s, Some(column)),
            Target::Shared(0) => out.body.bus_v = Some(column),
            Target::Shared(i @ 1..=3) => out.body.gyro_rad_s[i - 1] = Some(column),
            Target::Shared(i @ 4..=6) => out.body.accel_m_s2[i - 4] = Some(column),
            Target::Shared(i @ 7..=9) => out.body.base_m[i - 7] = Some(column),
            Target::Shared(i) => out.body.base_q[i - 10] = Some(column),
            Target::Skip => {}
        }
    }
    out
}
