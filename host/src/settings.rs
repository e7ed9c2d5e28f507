//! Settings and where each came from: flag > environment > rb_ports.toml > rb.toml > user file > default.

use core::fmt;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::cli::{Global, parse_duration};
use crate::failure::{Exit, Failure, Outcome};
use crate::gait_file::read_text;

/// Largest configuration file.
const MAX_BYTES: usize = 64 * 1024;
/// Name of the project's configuration file, looked for in the current folder and upward.
pub const PROJECT_FILE: &str = "rb.toml";
/// Name of the file with this computer's ports; keep it out of version control.
pub const PORTS_FILE: &str = "rb_ports.toml";

/// A setting's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Key {
    /// Port URI.
    Port,
    /// Baud rate.
    Baud,
    /// Longest wait for an answer.
    Timeout,
    /// File with the robot's key.
    KeyFile,
    /// Samples per second of a run.
    TelemetryHz,
}

impl Key {
    /// Every setting.
    pub const ALL: [Self; 5] = [
        Self::Port,
        Self::Baud,
        Self::Timeout,
        Self::KeyFile,
        Self::TelemetryHz,
    ];

    /// The key in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Port => "port",
            Self::Baud => "baud",
            Self::Timeout => "timeout",
            Self::KeyFile => "key_file",
            Self::TelemetryHz => "telemetry_hz",
        }
    }

    /// The environment variable.
    #[must_use]
    pub fn variable(self) -> &'static str {
        match self {
            Self::Port => "RB_PORT",
            Self::Baud => "RB_BAUD",
            Self::Timeout => "RB_TIMEOUT",
            Self::KeyFile => "RB_KEY_FILE",
            Self::TelemetryHz => "RB_TELEMETRY_HZ",
        }
    }

    fn default(self) -> &'static str {
        match self {
            Self::Port | Self::KeyFile => "",
            Self::Baud => "115200",
            Self::Timeout => "2s",
            Self::TelemetryHz => "20",
        }
    }

    /// What a valid value looks like, or `None` when `value` is valid.
    fn complaint(self, value: &str) -> Option<&'static str> {
        let fine = match self {
            Self::Port => value.is_empty() || value.parse::<crate::link::PortUri>().is_ok(),
            Self::KeyFile => true,
            Self::Baud => value
                .parse::<u32>()
                .is_ok_and(|b| (300..=4_000_000).contains(&b)),
            Self::Timeout => parse_duration(value).is_ok_and(|t| t >= Duration::from_millis(10)),
            Self::TelemetryHz => value == "20" || value == "100",
        };
        if fine {
            return None;
        }
        Some(match self {
            Self::Port | Self::KeyFile => "/dev/ttyACM0, /dev/rfcomm0, tcp://host:port or sim:",
            Self::Baud => "300 to 4000000",
            Self::Timeout => "a time of at least 10ms, such as 2s",
            Self::TelemetryHz => "20 or 100",
        })
    }
}

/// Where a value came from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Origin {
    /// Command line.
    Flag,
    /// Environment variable.
    Environment(&'static str),
    /// A file.
    File(PathBuf),
    /// Built in.
    Default,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Flag => f.write_str("command line"),
            Self::Environment(name) => write!(f, "environment variable {name}"),
            Self::File(path) => path.display().fmt(f),
            Self::Default => f.write_str("default"),
        }
    }
}

/// A value with its origin.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setting {
    /// The value as text.
    pub value: String,
    /// Where it came from.
    pub origin: Origin,
}

/// All settings.
#[derive(Debug, Clone, Default)]
pub struct Settings(BTreeMap<Key, Setting>);

impl Settings {
    /// Gathers all sources. A later source never hides an error in an earlier one.
    ///
    /// # Errors
    /// Exit code 3 for a bad file, 2 for a bad environment variable.
    pub fn gather(flags: &Global) -> Outcome<Self> {
        let mut settings = Self::default();
        for path in files(flags.config.as_deref())? {
            settings.add_file(&path)?;
        }
        for key in Key::ALL {
            if let Some(value) = std::env::var(key.variable()).ok().filter(|v| !v.is_empty()) {
                settings.put(key, value, Origin::Environment(key.variable()))?;
            }
        }
        let by_flag = [
            (Key::Port, flags.port.clone()),
            (Key::Baud, flags.baud.map(|b| b.to_string())),
            (
                Key::Timeout,
                flags.timeout.map(|t| format!("{}s", t.as_secs_f64())),
            ),
        ];
        for (key, value) in by_flag {
            if let Some(value) = value {
                settings.put(key, value, Origin::Flag)?;
            }
        }
        Ok(settings)
    }

    /// A setting, or its default.
    #[must_use]
    pub fn get(&self, key: Key) -> Setting {
        let default = || Setting {
            value: key.default().to_owned(),
            origin: Origin::Default,
        };
        self.0.get(&key).cloned().unwrap_or_else(default)
    }

    fn put(&mut self, key: Key, value: String, origin: Origin) -> Outcome {
        if let Some(expected) = key.complaint(&value) {
            let message = format!(
                "{} = {value:?} ({origin}) is not valid; give {expected}",
                key.name()
            );
            let exit = if matches!(origin, Origin::File(_)) {
                Exit::BadFile
            } else {
                Exit::Usage
            };
            return Err(Failure::say(exit, message));
        }
        self.0.insert(key, Setting { value, origin });
        Ok(())
    }

    fn add_file(&mut self, path: &Path) -> Outcome {
        let text = read_text(path, MAX_BYTES).map_err(|e| Failure::new(Exit::BadFile, e))?;
        let complain = |at: usize, what: String| {
            let line = text.get(..at).unwrap_or("").matches('\n').count() + 1;
            Failure::say(Exit::BadFile, format!("{}:{line}: {what}", path.display()))
        };
        let document = DeTable::parse(&text).map_err(|e| {
            let words = files::gait::Excerpt::new(e.message());
            complain(
                e.span().map_or(0, |s| s.start),
                format!("not valid TOML: {words}"),
            )
        })?;
        for (name, value) in document.get_ref() {
            let at = value.span().start;
            let known = Key::ALL
                .into_iter()
                .find(|k| k.name() == name.get_ref().as_ref());
            match (name.get_ref().as_ref(), known) {
                ("format", _) if as_text(value).as_deref() == Some("1") => {}
                (_, Some(key)) => {
                    let Some(value) = as_text(value) else {
                        return Err(complain(
                            at,
                            format!("{} must be text or a number", key.name()),
                        ));
                    };
                    self.put(key, value, Origin::File(path.to_owned()))?;
                }
                (other, None) => {
                    let known: Vec<&str> = Key::ALL.iter().map(|k| k.name()).collect();
                    let other = files::gait::Excerpt::new(other);
                    return Err(complain(
                        at,
                        format!(
                            "unknown key or format `{other}`; known: format = 1, {}",
                            known.join(", ")
                        ),
                    ));
                }
            }
        }
        Ok(())
    }
}

fn as_text(value: &Spanned<DeValue<'_>>) -> Option<String> {
    match value.get_ref() {
        DeValue::String(text) => Some(text.to_string()),
        DeValue::Integer(number) if number.radix() == 10 => Some(number.as_str().to_owned()),
        _ => None,
    }
}

/// Files that exist, weakest first.
fn files(named: Option<&Path>) -> Outcome<Vec<PathBuf>> {
    let mut files = Vec::new();
    if let Some(path) = user_file().filter(|p| p.is_file()) {
        files.push(path);
    }
    let from_variable = std::env::var_os("RB_CONFIG")
        .filter(|v| !v.is_empty())
        .map(PathBuf::from);
    match named.map(Path::to_owned).or(from_variable) {
        Some(path) => files.push(path),
        None => files.extend(upward(PROJECT_FILE)),
    }
    files.extend(upward(PORTS_FILE));
    Ok(files)
}

/// The nearest file of this name, from the current folder upward.
#[must_use]
pub fn upward(name: &str) -> Option<PathBuf> {
    let here = std::env::current_dir().ok()?;
    here.ancestors()
        .map(|folder| folder.join(name))
        .find(|path| path.is_file())
}

/// Folder of the user's own settings.
#[must_use]
pub fn user_folder() -> Option<PathBuf> {
    let base = std::env::var_os("XDG_CONFIG_HOME")
        .filter(|v| !v.is_empty())
        .map(PathBuf::from);
    let home = || std::env::var_os("HOME").map(|home| PathBuf::from(home).join(".config"));
    base.or_else(home).map(|base| base.join("rb-host"))
}

/// The user's own settings file.
#[must_use]
pub fn user_file() -> Option<PathBuf> {
    user_folder().map(|folder| folder.join("config.toml"))
}
