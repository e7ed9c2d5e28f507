//! What is said, and where: data on standard output, everything for people on standard error.

use std::io::{IsTerminal, Write};
use std::time::Duration;

use clap::ColorChoice;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::{Value, json};

use crate::failure::{Exit, Failure};

/// How talkative the command is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Errors only.
    Quiet,
    /// Results and progress.
    Normal,
    /// Details too.
    Verbose,
}

/// Where and how to print.
#[derive(Debug, Clone)]
pub struct Output {
    /// Talkativeness.
    pub level: Level,
    /// JSON instead of text on standard output.
    pub json: bool,
    /// Colour on standard error.
    pub color: bool,
}

impl Output {
    /// Decides on colour from the flag, `NO_COLOR` and whether standard error is a terminal.
    #[must_use]
    pub fn new(level: Level, json: bool, color: ColorChoice) -> Self {
        let color = match color {
            ColorChoice::Always => true,
            ColorChoice::Never => false,
            ColorChoice::Auto => {
                std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none()
            }
        };
        Self { level, json, color }
    }

    /// A line of prose on standard error.
    pub fn say(&self, message: impl core::fmt::Display) {
        if self.level >= Level::Normal {
            eprintln!("{message}");
        }
    }

    /// A detail, shown with `--verbose`.
    pub fn detail(&self, message: impl core::fmt::Display) {
        if self.level >= Level::Verbose {
            eprintln!("{message}");
        }
    }

    /// Something the user must not miss, shown even with `--quiet`.
    pub fn warn(&self, message: impl core::fmt::Display) {
        if self.color {
            eprintln!("\u{1b}[33mwarning\u{1b}[0m: {message}");
        } else {
            eprintln!("warning: {message}");
        }
    }

    /// The result: `text` for people or `value` with its `schema` name for programs.
    ///
    /// A closed pipe downstream (`| head`) ends the output quietly.
    pub fn result(&self, schema: &str, value: Value, text: impl FnOnce() -> String) {
        let mut out = std::io::stdout().lock();
        let _ = if self.json {
            writeln!(out, "{}", with_schema(schema, value))
        } else {
            let text = text();
            let end = if text.is_empty() || text.ends_with('\n') {
                ""
            } else {
                "\n"
            };
            write!(out, "{text}{end}")
        };
        let _ = out.flush();
    }

    /// A progress bar, hidden when standard error is no terminal or `--quiet` was given.
    #[must_use]
    pub fn progress(&self, length: u64, what: &str) -> ProgressBar {
        let bar = ProgressBar::new(length);
        if self.level == Level::Quiet || !std::io::stderr().is_terminal() {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        let style = ProgressStyle::with_template("{msg:12} [{bar:40}] {pos}/{len} {elapsed}");
        if let Ok(style) = style {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_message(what.to_owned());
        bar.enable_steady_tick(Duration::from_millis(250));
        bar
    }
}

/// Puts the schema name in front of an object.
fn with_schema(schema: &str, value: Value) -> Value {
    let mut object = serde_json::Map::new();
    object.insert("schema".to_owned(), Value::from(schema));
    match value {
        Value::Object(fields) => object.extend(fields),
        other => {
            object.insert("value".to_owned(), other);
        }
    }
    Value::Object(object)
}

/// The last words of a failed command.
pub fn print_failure(failure: &Failure, json: bool) {
    let exit = failure.exit();
    if json {
        let error = json!({
            "exit": exit.code(), "kind": exit.word(), "message": failure.to_string(), "hint": failure.hint_text(),
        });
        println!("{}", with_schema("rb.error/1", error));
    }
    let word = if exit == Exit::Interrupted {
        "stopped"
    } else {
        "error"
    };
    eprintln!("{word}: {failure}");
    if let Some(hint) = failure.hint_text() {
        eprintln!("hint: {hint}");
    }
}
