//! What is said, and where: data on standard output, everything for people on standard error.
//!
//! Every text goes through [`crate::terminal`], so that nothing that stands in a file steers the terminal. A standard output that
//! takes no more ends the command: silently when the reader has gone (`| head`), with exit code 1 when the disk is full.

use std::io::{self, ErrorKind, IsTerminal, Write};
use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use clap::ColorChoice;
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use serde_json::{Value, json};

use crate::failure::{Exit, Failure, Outcome};
use crate::interrupt;
use crate::terminal;

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
    /// The progress bars, so that lines and bars do not write over each other.
    bars: MultiProgress,
    /// Why standard output takes no more.
    lost: Arc<OnceLock<io::Error>>,
}

impl Output {
    /// Decides on colour from the flag, `NO_COLOR` and whether standard error is a terminal.
    #[must_use]
    pub fn new(level: Level, json: bool, color: ColorChoice) -> Self {
        let color = match color {
            ColorChoice::Always => true,
            ColorChoice::Never => false,
            ColorChoice::Auto => {
                io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none()
            }
        };
        Self {
            level,
            json,
            color,
            bars: MultiProgress::new(),
            lost: Arc::default(),
        }
    }

    /// A line of prose on standard error.
    pub fn say(&self, message: impl core::fmt::Display) {
        if self.level >= Level::Normal {
            self.line(&message.to_string());
        }
    }

    /// A detail, shown with `--verbose`.
    pub fn detail(&self, message: impl core::fmt::Display) {
        if self.level >= Level::Verbose {
            self.line(&message.to_string());
        }
    }

    /// Tells that a file or folder was written.
    pub fn wrote(&self, path: &Path) {
        self.say(format_args!("wrote {}", path.display()));
    }

    /// A question at a terminal, shown even with `--quiet`; the answer stands on the same line.
    pub fn ask(&self, question: &str) {
        let mut err = io::stderr();
        let _ = write!(err, "{} ", terminal::clean(question)).and_then(|()| err.flush());
    }

    /// Something the user must not miss, shown even with `--quiet`.
    pub fn warn(&self, message: impl core::fmt::Display) {
        self.labelled("warning", YELLOW, &message.to_string());
    }

    /// An error that does not end the command yet.
    pub fn error(&self, failure: &Failure) {
        self.labelled("error", RED, &failure.to_string());
    }

    fn labelled(&self, word: &str, colour: &str, message: &str) {
        let message = terminal::cut(message);
        let message = terminal::clean(&message);
        let line = if self.color {
            format!("{colour}{word}{PLAIN}: {message}")
        } else {
            format!("{word}: {message}")
        };
        self.raw_line(&line);
    }

    /// A line for people on standard error.
    fn line(&self, message: &str) {
        self.raw_line(&terminal::clean(message));
    }

    /// Standard error may be closed or full; there is nobody left to tell then.
    fn raw_line(&self, line: &str) {
        self.bars.suspend(|| {
            let _ = writeln!(io::stderr(), "{line}");
        });
    }

    /// The result: `text` for people or `value` with its `schema` name for programs.
    pub fn result(&self, schema: &str, value: Value, text: impl FnOnce() -> String) {
        if self.json {
            let document = with_schema(schema, value).to_string();
            self.put(&format!("{}\n", terminal::clean_json(&document)));
            return;
        }
        let text = text();
        let end = if text.is_empty() || text.ends_with('\n') {
            ""
        } else {
            "\n"
        };
        self.put(&format!("{}{end}", terminal::clean(&text)));
    }

    /// A document of the program's own making: a schema, a shell script, a screen.
    pub fn document(&self, text: &str) {
        self.put(text);
    }

    /// The only way to standard output.
    fn put(&self, text: &str) {
        if self.lost.get().is_some() || text.is_empty() {
            return;
        }
        let written = self.bars.suspend(|| {
            let mut out = io::stdout().lock();
            out.write_all(text.as_bytes()).and_then(|()| out.flush())
        });
        if let Err(error) = written {
            let _ = self.lost.set(error);
            interrupt::request();
        }
    }

    /// What a command ended with, once it is known whether its output arrived.
    ///
    /// # Errors
    /// Exit code 1 when standard output could not be written; a reader that has gone is no error.
    pub fn settle(&self, result: Outcome) -> Outcome {
        match (self.lost.get(), result) {
            (Some(lost), Ok(())) if lost.kind() == ErrorKind::BrokenPipe => Ok(()),
            (Some(lost), Err(failure))
                if lost.kind() == ErrorKind::BrokenPipe || failure.exit() != Exit::Interrupted =>
            {
                Err(failure)
            }
            (Some(lost), _) => Err(cannot_print(lost)),
            (None, result) => result,
        }
    }

    /// The last words of a failed command.
    pub fn failure(&self, failure: &Failure) {
        let exit = failure.exit();
        let message = failure.to_string();
        if self.json && self.lost.get().is_none() {
            let error = json!({
                "exit": exit.code(), "kind": exit.word(), "message": terminal::cut(&message), "hint": failure.hint_text(),
            });
            let document = with_schema("rb.error/1", error).to_string();
            let _ = writeln!(io::stdout(), "{}", terminal::clean_json(&document));
        }
        match exit {
            Exit::Interrupted => self.labelled("stopped", YELLOW, &message),
            _ => self.labelled("error", RED, &message),
        }
        if let Some(hint) = failure.hint_text() {
            self.labelled("hint", CYAN, hint);
        }
    }

    /// A progress bar, hidden when standard error is no terminal or `--quiet` was given.
    #[must_use]
    pub fn progress(&self, length: u64, what: &str) -> ProgressBar {
        let template = "{msg:16} [{bar:30}] {pos}/{len} {elapsed}, {eta} left";
        self.bar(ProgressBar::new(length), template, what)
    }

    /// Phases of work of unequal length, hidden as [`Self::progress`].
    #[must_use]
    pub fn phases(&self, what: &str) -> Phases {
        let template = "{spinner} {msg}, {elapsed}{left}";
        let bar = self.bar(ProgressBar::new_spinner(), template, what);
        let begun = Arc::new(Mutex::new(Begun::default()));
        let key = Arc::clone(&begun);
        let left = move |state: &ProgressState, out: &mut dyn core::fmt::Write| {
            let begun = *key.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(left_s) = begun.left_s(state.elapsed().as_secs_f64()) {
                let _ = write!(out, ", about {left_s:.0} s left");
            }
        };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.with_key("left", left));
        }
        Phases { bar, begun }
    }

    fn bar(&self, bar: ProgressBar, template: &str, what: &str) -> ProgressBar {
        if self.level == Level::Quiet || !io::stderr().is_terminal() {
            bar.set_draw_target(ProgressDrawTarget::hidden());
            return bar;
        }
        let bar = self.bars.add(bar);
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_message(terminal::clean(what).into_owned());
        bar.enable_steady_tick(Duration::from_millis(250));
        bar
    }
}

/// When the present phase began, and which share of the work is usually done by then.
#[derive(Debug, Clone, Copy, Default)]
struct Begun {
    share: f64,
    at_s: f64,
}

impl Begun {
    /// About how long the rest takes, s; `None` in the first phase, when nobody knows.
    fn left_s(self, now_s: f64) -> Option<f64> {
        let Self { share, at_s } = self;
        let whole_s = at_s / share;
        (share > 0.0).then(|| (whole_s - now_s).max(1.0))
    }
}

/// A line on the terminal with the present phase, the time so far and about how long the rest takes; it goes when dropped.
#[derive(Debug)]
pub struct Phases {
    bar: ProgressBar,
    begun: Arc<Mutex<Begun>>,
}

impl Phases {
    /// A phase begins, at which this share of the work is usually done, from 0 to 1.
    pub fn begin(&self, what: &str, share: f64) {
        let at_s = self.bar.elapsed().as_secs_f64();
        *self.begun.lock().unwrap_or_else(PoisonError::into_inner) = Begun { share, at_s };
        self.bar.set_message(terminal::clean(what).into_owned());
    }
}

impl Drop for Phases {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

const RED: &str = "\u{1b}[31m";
const YELLOW: &str = "\u{1b}[33m";
const CYAN: &str = "\u{1b}[36m";
const PLAIN: &str = "\u{1b}[0m";

/// Standard output takes no more.
#[must_use]
pub fn cannot_print(error: &io::Error) -> Failure {
    Failure::say(
        Exit::Other,
        format!("cannot write to standard output: {error}"),
    )
    .hint("what was printed is not complete; free some space and run the command again")
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

#[cfg(test)]
mod tests {
    use super::Begun;

    #[test]
    fn the_rest_is_what_the_shares_of_the_phases_say() {
        let begun = |share, at_s| Begun { share, at_s };
        assert_eq!(begun(0.0, 0.0).left_s(9.0), None);
        assert_eq!(begun(0.25, 10.0).left_s(10.0), Some(30.0));
        assert_eq!(begun(0.25, 10.0).left_s(25.0), Some(15.0));
        // A phase that takes longer than usual is about to end.
        assert_eq!(begun(0.5, 10.0).left_s(60.0), Some(1.0));
    }
}
