//! Ctrl-C: asked for once, acted on by whoever holds the robot.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

static COUNT: OnceLock<&'static AtomicU32> = OnceLock::new();
static PRESSED: AtomicU32 = AtomicU32::new(0);

/// Starts to catch Ctrl-C and the termination signal. The second press ends the process at once.
pub fn install() {
    COUNT.get_or_init(|| {
        // Without a handler Ctrl-C still ends the process, and the robot stops when its lease runs out.
        let _ = ctrlc::set_handler(|| {
            if PRESSED.fetch_add(1, Ordering::SeqCst) > 0 {
                std::process::exit(130);
            }
        });
        &PRESSED
    });
}

/// Whether Ctrl-C was pressed since the start.
#[must_use]
pub fn pressed() -> bool {
    PRESSED.load(Ordering::SeqCst) > 0
}
