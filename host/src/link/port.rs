//! Port URIs.

use core::fmt;
use core::str::FromStr;
use std::path::PathBuf;

/// Where a robot is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PortUri {
    /// A serial port or pseudo terminal by its path, such as `/dev/ttyACM0` or `/dev/rfcomm0`.
    Serial(PathBuf),
    /// `tcp://host:port`.
    Tcp(String),
    /// `sim:` or `sim:scenario.toml`: the emulated robot in this process.
    Sim(Option<PathBuf>),
}

impl PortUri {
    /// Whether the port is a Bluetooth serial port, which connects when it is opened or first written.
    #[must_use]
    pub fn is_rfcomm(&self) -> bool {
        matches!(self, Self::Serial(path) if path.to_string_lossy().contains("rfcomm"))
    }

    /// Whether this is the emulated robot in this process.
    #[must_use]
    pub fn is_sim(&self) -> bool {
        matches!(self, Self::Sim(_))
    }
}

/// A port that cannot be understood.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PortUriError {
    /// Nothing given.
    #[error("the port is empty; give /dev/ttyACM0, /dev/rfcomm0, tcp://host:port or sim:")]
    Empty,
    /// `tcp://` without host and port.
    #[error("{0:?} lacks host or port; write tcp://host:port")]
    Tcp(String),
    /// A scheme that does not exist here.
    #[error(
        "{0:?} is no known kind of port; give /dev/ttyACM0, /dev/rfcomm0, tcp://host:port or sim:"
    )]
    Scheme(String),
}

impl FromStr for PortUri {
    type Err = PortUriError;

    fn from_str(text: &str) -> Result<Self, PortUriError> {
        if text.trim().is_empty() {
            return Err(PortUriError::Empty);
        }
        if let Some(scenario) = text.strip_prefix("sim:") {
            return Ok(Self::Sim(
                (!scenario.is_empty()).then(|| PathBuf::from(scenario)),
            ));
        }
        if let Some(address) = text.strip_prefix("tcp://") {
            let (host, port) = address.rsplit_once(':').unwrap_or((address, ""));
            if host.is_empty() || port.parse::<u16>().is_err() {
                return Err(PortUriError::Tcp(text.to_owned()));
            }
            return Ok(Self::Tcp(address.to_owned()));
        }
        if text.contains("://") {
            return Err(PortUriError::Scheme(text.to_owned()));
        }
        Ok(Self::Serial(PathBuf::from(text)))
    }
}

impl fmt::Display for PortUri {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial(path) => path.display().fmt(f),
            Self::Tcp(address) => write!(f, "tcp://{address}"),
            Self::Sim(None) => f.write_str("sim:"),
            Self::Sim(Some(path)) => write!(f, "sim:{}", path.display()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::PortUri;

    #[test]
    fn uris_read_back_as_written() {
        for text in [
            "/dev/ttyACM0",
            "/dev/rfcomm0",
            "COM3",
            "tcp://robot:5000",
            "tcp://[::1]:5000",
            "sim:",
            "sim:s.toml",
        ] {
            assert_eq!(text.parse::<PortUri>().unwrap().to_string(), text);
        }
        for text in [
            "",
            "  ",
            "tcp://",
            "tcp://host",
            "tcp://host:",
            "tcp://:1",
            "tcp://h:99999",
            "http://h:1",
        ] {
            assert!(text.parse::<PortUri>().is_err(), "{text}");
        }
    }
}
