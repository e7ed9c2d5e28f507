//! The rest of the emulated board: battery, STOP input, watchdog, reset cause, fault block.

use super::executor::VirtualClock;
use firmware::crash::BLOCK_BYTES;
use firmware::entropy::EntropyError;
use firmware::ports::{Board, Clock, ResetCause};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::cell::RefCell;
use std::rc::Rc;

/// Period of the emulated independent watchdog, us (the board's limit).
pub const WATCHDOG_US: u64 = 200_000;

/// What outlives a reset of the processor.
#[derive(Debug)]
struct State {
    battery_mv: Option<u16>,
    stop_pressed: bool,
    cause: ResetCause,
    crash_block: [u8; BLOCK_BYTES],
    last_pet_us: u64,
    longest_pet_gap_us: u64,
    reboot: bool,
    rng: ChaCha8Rng,
    broken_rng: Option<u32>,
    unique_id: [u8; 12],
    flash_readable: bool,
}

/// Handle to the emulated board; clones are the same board.
#[derive(Debug, Clone)]
pub struct EmulatedBoard {
    clock: VirtualClock,
    state: Rc<RefCell<State>>,
}

impl EmulatedBoard {
    /// A board that has just been powered.
    #[must_use]
    pub fn new(clock: VirtualClock, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut unique_id = *b"emulated\0\0\0\0";
        for (place, byte) in unique_id.iter_mut().skip(8).zip(seed.to_le_bytes()) {
            *place = byte;
        }
        // What RAM holds at power-up is arbitrary; the firmware must not take it for a record.
        let mut crash_block = [0; BLOCK_BYTES];
        rng.fill_bytes(&mut crash_block);
        let state = State {
            battery_mv: Some(8_000),
            stop_pressed: false,
            cause: ResetCause::PowerOn,
            crash_block,
            last_pet_us: 0,
            longest_pet_gap_us: 0,
            reboot: false,
            rng,
            broken_rng: None,
            unique_id,
            flash_readable: false,
        };
        Self {
            clock,
            state: Rc::new(RefCell::new(state)),
        }
    }

    /// Sets what the battery ADC reads; `None` = no reading.
    pub fn set_battery_mv(&self, battery_mv: Option<u16>) {
        self.state.borrow_mut().battery_mv = battery_mv;
    }

    /// From the next boot on the random number generator gives this word for ever; `None` = works.
    pub fn break_rng(&self, word: Option<u32>) {
        self.state.borrow_mut().broken_rng = word;
    }

    /// From the next boot on the chip has this id; the random numbers stay those of the seed.
    pub fn set_unique_id(&self, unique_id: [u8; 12]) {
        self.state.borrow_mut().unique_id = unique_id;
    }

    /// Takes the readout protection away, or sets it.
    pub fn set_flash_readable(&self, readable: bool) {
        self.state.borrow_mut().flash_readable = readable;
    }

    /// Presses or releases the STOP input.
    pub fn set_stop_input(&self, pressed: bool) {
        self.state.borrow_mut().stop_pressed = pressed;
    }

    /// Overwrites the fault block, as a panic handler does before it resets.
    pub fn set_crash_block(&self, block: [u8; BLOCK_BYTES]) {
        self.state.borrow_mut().crash_block = block;
    }

    /// Longest time between two pets of the watchdog so far, us.
    #[must_use]
    pub fn longest_pet_gap_us(&self) -> u64 {
        self.state.borrow().longest_pet_gap_us
    }

    /// Whether the firmware asked for a reset, or the watchdog bit.
    pub(super) fn wants_reset(&self) -> Option<ResetCause> {
        let state = self.state.borrow();
        let starved = self.clock.now_us().saturating_sub(state.last_pet_us) > WATCHDOG_US;
        if state.reboot {
            Some(ResetCause::Software)
        } else if starved {
            Some(ResetCause::Watchdog)
        } else {
            None
        }
    }

    /// Latest instant at which the watchdog bites if it is not petted, us.
    pub(super) fn watchdog_us(&self) -> u64 {
        self.state.borrow().last_pet_us + WATCHDOG_US + 1
    }

    /// The processor restarts; gives the board as this life of the firmware sees it.
    pub(super) fn restart(&self, cause: ResetCause, supply: Supply) -> BoardOfOneBoot {
        let mut state = self.state.borrow_mut();
        state.cause = cause;
        state.reboot = false;
        state.last_pet_us = self.clock.now_us();
        let crash_block = std::mem::replace(&mut state.crash_block, [0; BLOCK_BYTES]);
        BoardOfOneBoot {
            supply,
            board: self.clone(),
            crash_block,
        }
    }
}

/// Reads the battery that the motors share, mV; `None` = the board's own setting counts.
pub(super) type Supply = Rc<dyn Fn() -> Option<u16>>;

/// The board between two resets.
pub struct BoardOfOneBoot {
    supply: Supply,
    board: EmulatedBoard,
    crash_block: [u8; BLOCK_BYTES],
}

impl Board for BoardOfOneBoot {
    fn battery_mv(&mut self) -> Option<u16> {
        (self.supply)().or(self.board.state.borrow().battery_mv)
    }

    fn reset_cause(&self) -> ResetCause {
        self.board.state.borrow().cause
    }

    fn name(&self) -> &'static str {
        protocol::link::status::EMULATED
    }

    fn unique_id(&self) -> [u8; 12] {
        self.board.state.borrow().unique_id
    }

    fn entropy(&mut self) -> Result<[u8; 16], EntropyError> {
        let state = &mut *self.board.state.borrow_mut();
        let rng = &mut state.rng;
        match state.broken_rng {
            Some(word) => firmware::entropy::collect(|| Ok(word)),
            None => {
                let mut bytes = [0; 16];
                rng.fill_bytes(&mut bytes);
                Ok(bytes)
            }
        }
    }

    fn flash_readable(&self) -> bool {
        self.board.state.borrow().flash_readable
    }

    fn pet_watchdog(&mut self) {
        let now_us = self.board.clock.now_us();
        let state = &mut *self.board.state.borrow_mut();
        state.longest_pet_gap_us = state
            .longest_pet_gap_us
            .max(now_us.saturating_sub(state.last_pet_us));
        state.last_pet_us = now_us;
    }

    fn stop_input(&mut self) -> bool {
        self.board.state.borrow().stop_pressed
    }

    fn crash_block(&mut self) -> &mut [u8; BLOCK_BYTES] {
        &mut self.crash_block
    }

    fn reboot(&mut self) {
        self.board.state.borrow_mut().reboot = true;
    }
}
