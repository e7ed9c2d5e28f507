//! The command line: global options and the command tree.

use std::path::PathBuf;

use clap::{Arg, Args, ColorChoice, CommandFactory, Parser};

use crate::cmd::Command;
use crate::output::{Level, Output};

/// The whole command line.
#[derive(Debug, Parser)]
#[command(
    name = "rb-host",
    version,
    about = "Upload, run, record, search, match and diagnose gaits of Roombots-like modular robots",
    after_help = "Exit codes: 0 ok, 1 other, 2 usage, 3 bad file, 4 no port, 5 link, 6 version, 7 refused, 8 check failed, 130 Ctrl-C.\n\
                  Without --port, and with no robot attached, commands talk to an emulated robot in this process and say so.",
    max_term_width = 110,
    propagate_version = true,
    arg_required_else_help = true
)]
pub struct Cli {
    /// Options every command knows.
    #[command(flatten)]
    pub global: Global,
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// Options every command knows.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Global options")]
pub struct Global {
    /// Robot: /dev/ttyACM0, /dev/rfcomm0, tcp://host:port, sim: or sim:scenario.toml [env: RB_PORT]
    #[arg(short, long, global = true, value_name = "URI")]
    pub port: Option<String>,
    /// Baud rate of a serial port [env: RB_BAUD] [default: 115200]
    #[arg(short, long, global = true, hide_short_help = true, value_name = "N")]
    pub baud: Option<u32>,
    /// Longest wait for an answer, such as 2s or 500ms [env: RB_TIMEOUT] [default: 2s]
    #[arg(long, global = true, hide_short_help = true, value_name = "TIME", value_parser = parse_duration)]
    pub timeout: Option<std::time::Duration>,
    /// Configuration file instead of rb.toml [env: RB_CONFIG]
    #[arg(
        short,
        long,
        global = true,
        hide_short_help = true,
        value_name = "FILE"
    )]
    pub config: Option<PathBuf>,
    /// One JSON document (streams: one per line) on standard output
    #[arg(long, global = true)]
    pub json: bool,
    /// Say nothing but errors
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Say more
    #[arg(short, long, global = true)]
    pub verbose: bool,
    /// Colour of messages (NO_COLOR is respected)
    #[arg(
        long,
        global = true,
        hide_short_help = true,
        value_name = "WHEN",
        default_value = "auto"
    )]
    pub color: ColorChoice,
    /// Do not ask, answer yes
    #[arg(long, global = true, hide_short_help = true)]
    pub yes: bool,
}

/// The whole command line with the examples at the end of every help.
#[must_use]
pub fn command() -> clap::Command {
    let command = crate::examples::add(Cli::command());
    let all = command.get_arguments();
    let global: Vec<Arg> = all.filter(|a| a.is_global_set()).cloned().collect();
    command.mut_subcommands(|sub| {
        let Some((_, kept)) = WITH_FEW.iter().find(|row| row.0 == sub.get_name()) else {
            return sub;
        };
        let without = global
            .iter()
            .filter(|a| !kept.contains(&a.get_id().as_str()));
        sub.args(without.map(|a| a.clone().hide(true)))
    })
}

/// Commands that read neither settings nor robot, with the global options that mean something there; the others are taken and not shown.
const WITH_FEW: [(&str, &[&str]); 3] = [
    ("completions", &[]),
    ("man", &["quiet", "color"]),
    ("version", &["json"]),
];

impl Global {
    /// Where and how to print.
    #[must_use]
    pub fn output(&self) -> Output {
        let level = match (self.quiet, self.verbose) {
            (true, _) => Level::Quiet,
            (_, true) => Level::Verbose,
            _ => Level::Normal,
        };
        Output::new(level, self.json, self.color)
    }
}

/// Reads `30s`, `500ms`, `2min`, `1h` or a plain number of seconds.
///
/// # Errors
/// A sentence for the command line.
pub fn parse_duration(text: &str) -> Result<std::time::Duration, DurationError> {
    let text = text.trim();
    let digits = text
        .find(|c: char| !(c.is_ascii_digit() || c == '.'))
        .unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let value: f64 = number.parse().map_err(|_| DurationError)?;
    let scale = match unit.trim() {
        "" | "s" | "sec" => 1.0,
        "ms" => 1e-3,
        "min" | "m" => 60.0,
        "h" => 3600.0,
        _ => return Err(DurationError),
    };
    let seconds = value * scale;
    // A day is far more than the battery lasts.
    if !(0.0..=86_400.0).contains(&seconds) {
        return Err(DurationError);
    }
    Ok(std::time::Duration::from_secs_f64(seconds))
}

/// A time that cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("write a time such as 30s, 500ms, 2min or 1h, at most a day")]
pub struct DurationError;

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests {
    use super::*;

    /// The long options in the help of a command.
    fn shown(words: &[&str]) -> String {
        let line = ["rb-host"].iter().chain(words).chain(&["--help"]);
        let help = command().try_get_matches_from(line).unwrap_err();
        help.to_string()
    }

    #[test]
    fn a_help_shows_the_global_options_that_mean_something_there() {
        let root = command();
        let global: Vec<&str> = root
            .get_arguments()
            .filter(|a| a.is_global_set())
            .filter_map(Arg::get_long)
            .collect();
        assert_eq!(global.len(), 9);
        for (name, kept) in WITH_FEW {
            let help = shown(&[name]);
            for long in &global {
                let there = help.contains(&format!("--{long}"));
                assert_eq!(there, kept.contains(long), "{name} --{long}: {help}");
            }
        }
        let help = shown(&["run"]);
        assert!(
            global
                .iter()
                .all(|long| help.contains(&format!("--{long}"))),
            "{help}"
        );
    }

    #[test]
    fn options_that_are_not_shown_are_taken_all_the_same() {
        let line = ["rb-host", "completions", "bash", "--quiet", "-p", "sim:"];
        let matches = command().try_get_matches_from(line).unwrap();
        let cli = <Cli as clap::FromArgMatches>::from_arg_matches(&matches).unwrap();
        assert!(cli.global.quiet);
        assert_eq!(cli.global.port.as_deref(), Some("sim:"));
    }
}
