//! Where defmt frames go: RTT on silicon, semihosting in QEMU. Chosen at run time, so that it is one image.
//!
//! A semihosting breakpoint without a debugger is a HardFault on silicon; RTT has no reader in QEMU.

use core::cell::RefCell;

use critical_section::{Mutex, RestoreState};
use rtt_target::{ChannelMode, UpChannel, rtt_init};
use semihosting::io::{Stdout, Write};

/// Bytes of the RTT buffer.
const RTT_BYTES: usize = 1024;

enum Sink {
    None,
    Rtt(UpChannel),
    Semihosting(Stdout),
}

struct State {
    sink: RefCell<Sink>,
    encoder: RefCell<defmt::Encoder>,
    restore: RefCell<Option<RestoreState>>,
}

static STATE: Mutex<State> = Mutex::new(State {
    sink: RefCell::new(Sink::None),
    encoder: RefCell::new(defmt::Encoder::new()),
    restore: RefCell::new(None),
});

/// True in QEMU: its `DBGMCU.IDCODE` reads 0, on silicon it holds the device number (RM0351 section 48.6.1).
pub(crate) fn emulated() -> bool {
    embassy_stm32::pac::DBGMCU.idcode().read().0 == 0
}

/// Opens the sink; frames before that are dropped. Called once.
pub(crate) fn init() {
    let sink = if emulated() {
        semihosting::io::stdout().map_or(Sink::None, Sink::Semihosting)
    } else {
        let channels = rtt_init! { up: { 0: { size: RTT_BYTES, mode: ChannelMode::NoBlockSkip, name: "defmt" } } };
        Sink::Rtt(channels.up.0)
    };
    critical_section::with(|cs| *STATE.borrow(cs).sink.borrow_mut() = sink);
}

/// In QEMU: ends the emulator with this exit code. On silicon: returns.
pub(crate) fn exit_if_emulated(code: i32) {
    if emulated() {
        semihosting::process::exit(code);
    }
}

#[defmt::global_logger]
struct Logger;

fn with_state(action: impl FnOnce(&State)) {
    critical_section::with(|cs| action(STATE.borrow(cs)));
}

fn put(state: &State, bytes: &[u8]) {
    match &mut *state.sink.borrow_mut() {
        Sink::None => {}
        Sink::Rtt(channel) => {
            channel.write(bytes);
        }
        Sink::Semihosting(out) => {
            // A log that cannot be written is lost; there is nowhere to say so.
            let _ = out.write_all(bytes);
        }
    }
}

// SAFETY: `acquire` enters a critical section that `release` leaves, so frames of different contexts never interleave.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        // SAFETY: paired with the release in `Logger::release`, which defmt calls exactly once per acquire.
        let restore = unsafe { critical_section::acquire() };
        with_state(|state| {
            *state.restore.borrow_mut() = Some(restore);
            state
                .encoder
                .borrow_mut()
                .start_frame(|bytes| put(state, bytes));
        });
    }

    unsafe fn flush() {}

    unsafe fn release() {
        let mut restore = None;
        with_state(|state| {
            state
                .encoder
                .borrow_mut()
                .end_frame(|bytes| put(state, bytes));
            restore = state.restore.borrow_mut().take();
        });
        if let Some(restore) = restore {
            // SAFETY: the token is the one that `acquire` stored; critical sections nest as a stack.
            unsafe { critical_section::release(restore) };
        }
    }

    unsafe fn write(bytes: &[u8]) {
        with_state(|state| {
            state
                .encoder
                .borrow_mut()
                .write(bytes, |part| put(state, part))
        });
    }
}

defmt::timestamp!("{=u64:us}", embassy_time_driver::now());
