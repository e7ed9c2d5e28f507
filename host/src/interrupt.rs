//! Ctrl-C and the termination signal.
//!
//! Without more ado the first one ends the process, even where it waits for a file to open. A command that holds a robot or a search
//! asks for [`grace`]: then the first one is a request that the command reads from [`pressed`], and the second ends the process.

use std::io::Write;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

static PRESSED: AtomicU32 = AtomicU32::new(0);
static SILENT: AtomicBool = AtomicBool::new(false);
/// What the first press does, the innermost command last.
static WAYS: Mutex<Vec<(u64, Way)>> = Mutex::new(Vec::new());

/// What the first press does.
#[derive(Debug, Clone, Copy)]
enum Way {
    /// The command is asked to stop; the words say what it does now.
    Ask(&'static str),
    /// The process ends; the words say what that leaves behind.
    End(&'static str),
}

/// While it lives, the first press does what it was made for.
#[derive(Debug)]
#[must_use]
pub struct Guard(u64);

impl Drop for Guard {
    fn drop(&mut self) {
        ways().retain(|(id, _)| *id != self.0);
    }
}

fn ways() -> std::sync::MutexGuard<'static, Vec<(u64, Way)>> {
    WAYS.lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
}

fn add(way: Way) -> Guard {
    let mut ways = ways();
    let id = ways.iter().map(|(id, _)| *id).max().unwrap_or(0) + 1;
    ways.push((id, way));
    Guard(id)
}

/// Starts to catch Ctrl-C and the termination signal; `silent` leaves the words away.
pub fn install(silent: bool) {
    static INSTALLED: AtomicBool = AtomicBool::new(false);
    SILENT.store(silent, Ordering::SeqCst);
    if INSTALLED.swap(true, Ordering::SeqCst) {
        return;
    }
    // Without a handler Ctrl-C still ends the process, and the robot stops when its lease runs out.
    let _ = ctrlc::set_handler(|| {
        let first = PRESSED.fetch_add(1, Ordering::SeqCst) == 0;
        let way = ways().last().map(|(_, way)| *way);
        match way {
            Some(Way::Ask(words)) if first => {
                say(&format!("{words}; Ctrl-C again ends rb-host at once"));
            }
            way => {
                if let Some(Way::End(words)) = way {
                    say(words);
                }
                std::process::exit(130);
            }
        }
    });
}

fn say(words: &str) {
    if !SILENT.load(Ordering::SeqCst) {
        let _ = writeln!(std::io::stderr(), "{words}");
    }
}

/// From here on the first press only asks: the command reads [`pressed`] and comes to its end. `words` say what it does.
pub fn grace(words: &'static str) -> Guard {
    add(Way::Ask(words))
}

/// From here on the first press ends the process, whatever the caller has asked for. `words` say what that leaves behind.
pub fn at_once(words: &'static str) -> Guard {
    add(Way::End(words))
}

/// Asks the command to stop, as the first press does.
pub fn request() {
    PRESSED.fetch_max(1, Ordering::SeqCst);
}

/// Whether the command was asked to stop.
#[must_use]
pub fn pressed() -> bool {
    PRESSED.load(Ordering::SeqCst) > 0
}
