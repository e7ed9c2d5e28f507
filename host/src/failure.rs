//! Why a command ended without success, and the exit code that says so to a script.

use core::fmt;

/// Documented exit codes of `rb-host` (docs/reference/command-line.md).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Done.
    Ok = 0,
    /// Anything without a code of its own, such as a full disk.
    Other = 1,
    /// The command line is wrong.
    Usage = 2,
    /// A file was refused.
    BadFile = 3,
    /// No robot, or several and no choice made.
    Port = 4,
    /// The link failed: no answer in time, or it broke.
    Link = 5,
    /// Host and robot speak different protocol versions.
    Version = 6,
    /// The robot (or the same check on the host) refused the order.
    Refused = 7,
    /// A check ran and its result is below what was asked.
    Check = 8,
    /// Stopped by Ctrl-C, after the robot was stopped.
    Interrupted = 130,
}

impl Exit {
    /// The number given to the shell.
    #[must_use]
    pub fn code(self) -> u8 {
        self as u8
    }

    /// The word used in `--json` errors.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Exit::Ok => "ok",
            Exit::Other => "other",
            Exit::Usage => "usage",
            Exit::BadFile => "bad_file",
            Exit::Port => "port",
            Exit::Link => "link",
            Exit::Version => "version",
            Exit::Refused => "refused",
            Exit::Check => "check",
            Exit::Interrupted => "interrupted",
        }
    }
}

/// A command's failure: an exit code, the error, and what to do next.
#[derive(Debug)]
pub struct Failure {
    exit: Exit,
    error: anyhow::Error,
    hint: Option<String>,
}

impl Failure {
    /// A failure with its exit code.
    pub fn new(exit: Exit, error: impl Into<anyhow::Error>) -> Self {
        let error = error.into();
        Self {
            exit,
            error,
            hint: None,
        }
    }

    /// A failure told by a sentence.
    pub fn say(
        exit: Exit,
        message: impl fmt::Display + fmt::Debug + Send + Sync + 'static,
    ) -> Self {
        Self::new(exit, anyhow::Error::msg(message))
    }

    /// Adds what to do next.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// The exit code.
    #[must_use]
    pub fn exit(&self) -> Exit {
        self.exit
    }

    /// What to do next, if anything is known to help.
    #[must_use]
    pub fn hint_text(&self) -> Option<&str> {
        self.hint.as_deref()
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut said = self.error.to_string();
        f.write_str(&said)?;
        for cause in self.error.chain().skip(1) {
            // Some errors tell their cause themselves.
            let cause = cause.to_string();
            if !said.contains(&cause) {
                write!(f, ": {cause}")?;
                said = cause;
            }
        }
        Ok(())
    }
}

impl From<anyhow::Error> for Failure {
    fn from(error: anyhow::Error) -> Self {
        Self::new(Exit::Other, error)
    }
}

impl From<files::gait::GaitFileError> for Failure {
    fn from(error: files::gait::GaitFileError) -> Self {
        Self::new(Exit::BadFile, error)
    }
}

/// What every command returns.
pub type Outcome<T = ()> = Result<T, Failure>;
