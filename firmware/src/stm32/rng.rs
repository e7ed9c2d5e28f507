//! The random number generator by its registers, every wait bounded. The HAL's driver waits for ever for a generator whose clock is dead and takes the
//! words of one whose seed failed.

use embassy_stm32::{Peri, pac, peripherals, rcc};
use firmware::entropy::{self, EntropyError};

/// Readings of the status while a word is awaited: a word takes 40 clocks of 48 MHz (RM0351 section 27.3.3), 67 cycles of the core, and a reading 4 or more.
const PATIENCE: u32 = 10_000;
/// Restarts after a seed error before the generator counts as broken.
const RESTARTS: u32 = 3;

/// The generator, clocked and running.
pub(crate) struct BoardRng {
    _peripheral: Peri<'static, peripherals::RNG>,
}

impl BoardRng {
    pub(crate) fn new(peripheral: Peri<'static, peripherals::RNG>) -> Self {
        rcc::enable_and_reset::<peripherals::RNG>();
        restart();
        Self {
            _peripheral: peripheral,
        }
    }

    /// A tested seed. Takes less than 6 ms, however broken the generator is.
    pub(crate) fn seed(&mut self) -> Result<[u8; 16], EntropyError> {
        // The first word after a start is not used (RM0351 section 27.3.3).
        word()?;
        entropy::collect(word)
    }
}

fn restart() {
    pac::RNG.cr().modify(|w| w.set_rngen(false));
    pac::RNG.sr().modify(|w| {
        w.set_seis(false);
        w.set_ceis(false);
    });
    pac::RNG.cr().modify(|w| w.set_rngen(true));
}

fn word() -> Result<u32, EntropyError> {
    let mut restarts = 0;
    for _ in 0..PATIENCE {
        let status = pac::RNG.sr().read();
        if status.ceis() || status.cecs() {
            return Err(EntropyError::Clock);
        }
        if status.seis() || status.secs() {
            if restarts == RESTARTS {
                return Err(EntropyError::Seed);
            }
            restarts += 1;
            restart();
            continue;
        }
        if status.drdy() {
            return Ok(pac::RNG.dr().read());
        }
    }
    Err(EntropyError::Timeout)
}
