//! What can go wrong between host and robot.

use std::io;
use std::time::Duration;

use protocol::link::{Reject, VERSION};

use super::text;
use crate::failure::{Exit, Failure};

/// What went wrong on the link.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The port cannot be opened.
    #[error("cannot open {port}: {source}")]
    Open {
        /// Port.
        port: String,
        /// Why.
        source: io::Error,
    },
    /// A scenario file of the emulated robot was refused.
    #[error("scenario of the emulated robot: {0}")]
    Scenario(String),
    /// The other side went away.
    #[error("the link to {port} is gone: {source}")]
    Closed {
        /// Port.
        port: String,
        /// Why.
        source: io::Error,
    },
    /// No answer.
    #[error("no answer to {request} within {} ms ({tries} tries)", .waited.as_millis())]
    Timeout {
        /// What was asked.
        request: &'static str,
        /// Total wait.
        waited: Duration,
        /// Times sent.
        tries: u32,
    },
    /// Another protocol version.
    #[error("the robot speaks protocol {theirs}, this rb-host speaks protocol {ours}")]
    Version {
        /// The robot's.
        theirs: u8,
        /// Ours.
        ours: u8,
    },
    /// The module started again, so every order before is void.
    #[error(
        "the robot has restarted (boot id {before:08x} before, {now:08x} now); its orders and zero are void"
    )]
    Restarted {
        /// Boot id of the session.
        before: u32,
        /// Boot id heard now.
        now: u32,
    },
    /// The module said no.
    #[error("the robot refused {request}: {}", text::reject(.reason))]
    Refused {
        /// What was asked.
        request: &'static str,
        /// Why.
        reason: Reject,
    },
    /// The robot takes signed orders only, and this host has no key.
    #[error(
        "robot {robot_id} takes {request} only with proof of its key, and this host has no key for it"
    )]
    NoKey {
        /// What was asked.
        request: &'static str,
        /// Robot.
        robot_id: u8,
    },
    /// An answer that does not belong to the request.
    #[error("the robot answered {request} with something else")]
    WrongAnswer {
        /// What was asked.
        request: &'static str,
    },
    /// A request too large for a frame.
    #[error("{request} does not fit a frame")]
    TooLarge {
        /// What was asked.
        request: &'static str,
    },
    /// A STOP was acknowledged, and not proved with the robot's key.
    #[error(
        "the STOP was acknowledged without the proof of the robot's key: the answer may be forged"
    )]
    Unproved,
    /// The robot proved that it still moves.
    #[error("the robot acknowledged the STOP and still moves")]
    StillMoving,
    /// Ctrl-C.
    #[error("stopped by Ctrl-C")]
    Interrupted,
}

impl LinkError {
    /// Whether trying to connect again can help.
    #[must_use]
    pub fn is_lost_link(&self) -> bool {
        matches!(
            self,
            Self::Closed { .. } | Self::Timeout { .. } | Self::Open { .. }
        )
    }

    /// What a port that was open before tells when it does not open again.
    #[must_use]
    pub(crate) fn gone(self) -> Self {
        match self {
            Self::Open { port, source } => Self::Closed { port, source },
            other => other,
        }
    }

    /// A version mismatch with ours.
    #[must_use]
    pub fn version(theirs: u8) -> Self {
        Self::Version {
            theirs,
            ours: VERSION,
        }
    }

    fn exit(&self) -> Exit {
        match self {
            Self::Open { .. } => Exit::Port,
            Self::Scenario(_) => Exit::BadFile,
            Self::Version { .. } => Exit::Version,
            Self::Refused {
                reason: Reject::Version { .. },
                ..
            } => Exit::Version,
            Self::Refused { .. } | Self::NoKey { .. } => Exit::Refused,
            Self::Interrupted => Exit::Interrupted,
            Self::Closed { .. }
            | Self::Timeout { .. }
            | Self::Restarted { .. }
            | Self::WrongAnswer { .. }
            | Self::Unproved
            | Self::StillMoving
            | Self::TooLarge { .. } => Exit::Link,
        }
    }

    fn hint(&self) -> Option<String> {
        match self {
            Self::Open { source, port } => Some(open_hint(source, port)),
            Self::Version { theirs, ours } if theirs < ours => {
                Some("update the firmware (docs: flashing), or use the rb-host of the firmware's release".to_owned())
            }
            Self::Version { .. } => Some("update rb-host".to_owned()),
            Self::Timeout { .. } => Some("is the robot on, and is this the right port? `rb-host doctor` checks both".to_owned()),
            Self::Restarted { .. } => Some("place the home pose, `rb-host zero`, then order again".to_owned()),
            Self::Refused { reason, .. } => text::remedy(reason).map(str::to_owned),
            Self::NoKey { .. } => Some(
                "copy the key file of this robot here (`rb-host config key path` names it), or set a new key over USB: \
                 `rb-host config key set`"
                    .to_owned(),
            ),
            Self::Unproved => Some(
                "look at the robot, use its STOP button if it moves; if it has lost its key, set one over USB: `rb-host config key set`".to_owned(),
            ),
            Self::StillMoving => Some("use the STOP button on the robot".to_owned()),
            _ => None,
        }
    }
}

fn open_hint(source: &io::Error, port: &str) -> String {
    match source.kind() {
        io::ErrorKind::NotFound => "`rb-host list` shows the ports of this computer".to_owned(),
        io::ErrorKind::PermissionDenied => {
            "join the group that owns the port: sudo usermod -aG dialout $USER, then log in again".to_owned()
        }
        io::ErrorKind::ConnectionRefused if port.starts_with("tcp") => {
            "nothing listens there; start `rb-host emulate robot --tcp ADDRESS` or check the address".to_owned()
        }
        _ if port.contains("rfcomm") => "is the module in range and bound? See docs/how-to/bluetooth.md".to_owned(),
        _ => "another program may hold the port; `rb-host doctor` tells".to_owned(),
    }
}

impl From<LinkError> for Failure {
    fn from(error: LinkError) -> Self {
        let hint = error.hint();
        let failure = Failure::new(error.exit(), error);
        match hint {
            Some(hint) => failure.hint(hint),
            None => failure,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_does_not_open_again_is_a_lost_link() {
        let refused = || LinkError::Open {
            port: "tcp://127.0.0.1:1".to_owned(),
            source: io::ErrorKind::ConnectionRefused.into(),
        };
        assert_eq!(Failure::from(refused()).exit(), Exit::Port);
        assert_eq!(Failure::from(refused().gone()).exit(), Exit::Link);
    }
}
