//! The slot store in the last pages of the flash, on chips with pages of 2 KiB and words of 64 bits with ECC (STM32L4, STM32G4). They lie in bank 2, so
//! code in bank 1 runs on during an erase.

use embassy_stm32::Peri;
use embassy_stm32::flash::{Blocking, Error, Flash};
use embassy_stm32::pac;
use embassy_stm32::peripherals::FLASH;
use firmware::ports::{FlashError, PAGE_BYTES, PAGE_WORDS, STORE_PAGES, SlotStore, WORD_BYTES};

use super::fault;
use super::parts::BoardFile;
use crate::board::Chosen;

/// Start of flash in the address space.
const FLASH_BASE: usize = 0x0800_0000;
/// First byte of the store, from the start of flash. The board's memory map ends there.
const STORE_OFFSET: usize = Chosen::FLASH_BYTES - STORE_PAGES * PAGE_BYTES;

/// The pages of the store.
pub(crate) struct FlashStore {
    flash: Flash<'static, Blocking>,
}

fn word_offset(page: usize, word: usize) -> Result<usize, FlashError> {
    if page >= STORE_PAGES || word >= PAGE_WORDS {
        return Err(FlashError::Range);
    }
    Ok(STORE_OFFSET + page * PAGE_BYTES + word * WORD_BYTES)
}

/// Empties the data cache: it does not notice erase and programming (RM0351 section 3.3.5).
fn drop_data_cache() {
    let acr = pac::FLASH.acr();
    acr.modify(|w| w.set_dcen(false));
    acr.modify(|w| w.set_dcrst(true));
    acr.modify(|w| w.set_dcrst(false));
    acr.modify(|w| w.set_dcen(true));
}

fn done(result: Result<(), Error>) -> Result<(), FlashError> {
    drop_data_cache();
    result.map_err(|_| FlashError::Controller)
}

impl FlashStore {
    pub(crate) fn new(flash: Peri<'static, FLASH>) -> Self {
        FlashStore {
            flash: Flash::new_blocking(flash),
        }
    }
}

impl SlotStore for FlashStore {
    fn erase(&mut self, page: usize) -> Result<(), FlashError> {
        let start = word_offset(page, 0)? as u32;
        done(self.flash.blocking_erase(start, start + PAGE_BYTES as u32))
    }

    fn program(
        &mut self,
        page: usize,
        word: usize,
        bytes: &[u8; WORD_BYTES],
    ) -> Result<(), FlashError> {
        let start = word_offset(page, word)? as u32;
        done(self.flash.blocking_write(start, bytes))
    }

    fn read(&mut self, page: usize, word: usize) -> Result<[u8; WORD_BYTES], FlashError> {
        let address = FLASH_BASE + word_offset(page, word)?;
        fault::take_ecc_error();
        // SAFETY: an aligned word inside the flash; volatile, because an ECC error is seen by its interrupt.
        let value = unsafe { (address as *const [u8; WORD_BYTES]).read_volatile() };
        // The NMI of a failed read is taken before the barrier ends.
        cortex_m::asm::dsb();
        cortex_m::asm::isb();
        if fault::take_ecc_error() {
            Err(FlashError::Ecc)
        } else {
            Ok(value)
        }
    }
}
