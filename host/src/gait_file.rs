//! Gait files from disk, with the checks the robot will make, made before anything is sent.

use std::io::Read;
use std::path::{Path, PathBuf};

use control::gait::{Gait, RobotMismatch};
use control::machine::{Angles, Machine};
use control::precheck::{MARGIN_M, Verdict};

use crate::failure::{Exit, Failure, Outcome};
use crate::link::text;

/// Why a text file could not be read.
#[derive(Debug, thiserror::Error)]
pub enum TextFileError {
    /// Opening or reading failed.
    #[error("cannot read {path}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Not UTF-8.
    #[error("{path}: byte {at} is not UTF-8 text; save the file as UTF-8")]
    NotText {
        /// The file.
        path: PathBuf,
        /// First bad byte.
        at: usize,
    },
}

/// Reads at most `limit` + 1 bytes of a text file: an endless device does not fill the memory.
///
/// # Errors
/// [`TextFileError`]
pub fn read_text(path: &Path, limit: usize) -> Result<String, TextFileError> {
    let io = |source| TextFileError::Io {
        path: path.to_owned(),
        source,
    };
    read(std::fs::File::open(path).map_err(io)?, path, limit)
}

fn read(input: impl Read, path: &Path, limit: usize) -> Result<String, TextFileError> {
    let io = |source| TextFileError::Io {
        path: path.to_owned(),
        source,
    };
    let mut bytes = Vec::new();
    input
        .take(limit as u64 + 1)
        .read_to_end(&mut bytes)
        .map_err(io)?;
    String::from_utf8(bytes).map_err(|e| {
        let at = e.utf8_error().valid_up_to();
        TextFileError::NotText {
            path: path.to_owned(),
            at,
        }
    })
}

/// Reads and validates a gait file: TOML, or the JSON that `gait convert` writes. `-` is standard input.
///
/// # Errors
/// Exit code 3, with file, line and what to do.
pub fn load(path: &Path) -> Outcome<Gait> {
    let (name, text) = if path == Path::new("-") {
        let input = std::io::stdin().lock();
        (
            "standard input".to_owned(),
            read(input, path, files::gait::MAX_BYTES),
        )
    } else {
        let text = read_text(path, files::gait::MAX_BYTES);
        (path.display().to_string(), text)
    };
    let text = text.map_err(|e| Failure::new(Exit::BadFile, e))?;
    parse(&name, &text)
}

/// Validates the text of a gait file, TOML or JSON.
///
/// # Errors
/// Exit code 3, with file, line and what to do.
pub fn parse(name: &str, text: &str) -> Outcome<Gait> {
    if text.trim_start().starts_with('{') && text.len() <= files::gait::MAX_BYTES {
        return from_json(name, text);
    }
    Ok(files::gait::parse(name, text)?)
}

/// A gait as JSON has the keys and values of its TOML.
fn from_json(name: &str, text: &str) -> Outcome<Gait> {
    let value: toml::Table = serde_json::from_str(text).map_err(|e| {
        Failure::say(
            Exit::BadFile,
            format!("{name}:{}: not valid JSON: {e}", e.line()),
        )
    })?;
    let toml =
        toml::to_string(&value).map_err(|e| Failure::say(Exit::BadFile, format!("{name}: {e}")))?;
    // Lines of the TOML are not those of the file; the key says where.
    let name = format!("{name} (JSON, read as TOML)");
    Ok(files::gait::parse(&name, &toml)?)
}

/// What the host check found out about an acceptable gait.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GaitCheck {
    /// Moves looked at.
    pub moves: u32,
    /// Smallest certified clearance over the run, m; infinite for a robot that nobody checks.
    pub clearance_m: f32,
    /// Highest share of a joint's no-load speed that the gait asks for, 0 to 1.
    pub speed_share: f32,
    /// The joint with that share.
    pub fastest_joint: usize,
}

impl GaitCheck {
    /// For people.
    #[must_use]
    pub fn words(&self) -> String {
        let speed = format!(
            "fastest {} at {:.0} % of its no-load speed",
            text::joint(self.fastest_joint as u8),
            self.speed_share * 100.0
        );
        if self.clearance_m.is_finite() {
            let clear_mm = self.clearance_m * 1e3;
            format!(
                "{speed}, {} moves clear by {clear_mm:.1} mm or more",
                self.moves
            )
        } else {
            format!("{speed}; nothing checks whether this robot meets itself")
        }
    }
}

/// Why the robot would not run a gait.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Unfit {
    /// Too many joints, or too fast.
    #[error("{0}")]
    Robot(#[source] RobotMismatch),
    /// It would hit itself.
    #[error(
        "the robot would hit itself {at_s:.2} s after the start: bodies {first} and {last} within {clearance_mm:.1} mm; lower the amplitude or offset of A.M2 and B.M0"
    )]
    Collision {
        /// When, s.
        at_s: f32,
        /// Body of module A.
        first: u8,
        /// Body of module B.
        last: u8,
        /// Certified clearance, mm; below the margin of the pre-check.
        clearance_mm: f32,
    },
}

/// Runs the whole gait through the checks of the firmware: joint speeds, then every 50 ms move through the swept pre-check.
///
/// # Errors
/// [`Unfit`]
pub fn check(gait: &Gait, machine: &Machine) -> Result<GaitCheck, Unfit> {
    gait.check_speed(machine.limits()).map_err(Unfit::Robot)?;
    let shares = gait
        .oscillators()
        .iter()
        .zip(machine.limits())
        .map(|(oscillator, joint)| {
            oscillator.amplitude_rad * core::f32::consts::TAU * gait.frequency_hz()
                / joint.no_load_speed_rad_s
        });
    let (fastest_joint, speed_share) =
        shares.enumerate().fold(
            (0, 0.0),
            |best, (k, share)| if share > best.1 { (k, share) } else { best },
        );
    let mut state = control::cpg::start(gait);
    let mut at: Option<Angles> = None;
    let mut clearance_m = f32::INFINITY;
    let moves = (gait.duration_s() / control::CYCLE_S).ceil() as u32;
    for cycle in 0..=moves {
        let Some(next) = control::cpg::step(gait, &mut state, control::CYCLE_S).angles() else {
            break;
        };
        match machine.swept(&at.unwrap_or(next), &next, MARGIN_M) {
            Verdict::Clear { clearance_m: clear } => clearance_m = clearance_m.min(clear),
            Verdict::Blocked(blocked) => {
                return Err(Unfit::Collision {
                    at_s: cycle as f32 * control::CYCLE_S,
                    first: blocked.pair.first,
                    last: blocked.pair.last,
                    clearance_mm: blocked.clearance_m * 1e3,
                });
            }
        }
        at = Some(next);
    }
    Ok(GaitCheck {
        moves,
        clearance_m,
        speed_share,
        fastest_joint,
    })
}
