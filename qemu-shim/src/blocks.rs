// SPDX-License-Identifier: GPL-2.0-or-later
//! Register models of what QEMU 10.0 leaves out of the STM32L475: PWR, FLASH with its last pages, IWDG, ADC1, RNG, and the cause of
//! a reset in RCC.
//!
//! As little as the HAL needs, pure: time is an argument. Sources: RM0351 sections 3.7, 5.4, 6.4.29, 18.6, 27.4, 36.4.

use crate::wire::RngFault;

/// A block of registers that only remembers what was written: PWR.
#[derive(Debug)]
pub(crate) struct RegisterFile {
    cells: [u32; 256],
}

impl RegisterFile {
    /// All zero but for these offsets.
    pub(crate) fn new(initial: &[(u64, u32)]) -> Self {
        let mut file = RegisterFile { cells: [0; 256] };
        for &(offset, value) in initial {
            file.write(offset, value);
        }
        file
    }

    pub(crate) fn read(&self, offset: u64) -> u32 {
        self.cells.get((offset / 4) as usize).copied().unwrap_or(0)
    }

    pub(crate) fn write(&mut self, offset: u64, value: u32) {
        if let Some(cell) = self.cells.get_mut((offset / 4) as usize) {
            *cell = value;
        }
    }
}

const CSR_LSION: u32 = 1 << 0;
const CSR_LSIRDY: u32 = 1 << 1;
const CSR_RMVF: u32 = 1 << 23;
const CSR_PINRSTF: u32 = 1 << 26;
const CSR_BORRSTF: u32 = 1 << 27;
const CSR_SFTRSTF: u32 = 1 << 28;
const CSR_IWDGRSTF: u32 = 1 << 29;
const CSR_FLAGS: u32 = 0xff << 24;
/// MSI range after standby: 4 MHz.
const CSR_RANGE: u32 = 6 << 8;

/// RCC_CSR: what the last resets came from, until software clears it, and the slow oscillator.
#[derive(Debug)]
pub(crate) struct ResetFlags {
    value: u32,
}

impl ResetFlags {
    /// As power comes up.
    pub(crate) fn new() -> Self {
        ResetFlags {
            value: CSR_BORRSTF | CSR_PINRSTF | CSR_RANGE,
        }
    }

    /// A reset from within pulls the pin too.
    pub(crate) fn reset(&mut self, by_watchdog: bool) {
        let cause = if by_watchdog {
            CSR_IWDGRSTF
        } else {
            CSR_SFTRSTF
        };
        self.value = self.value & CSR_FLAGS | cause | CSR_PINRSTF | CSR_RANGE;
    }

    pub(crate) fn read(&self) -> u32 {
        let ready = if self.value & CSR_LSION == 0 {
            0
        } else {
            CSR_LSIRDY
        };
        self.value | ready
    }

    pub(crate) fn write(&mut self, value: u32) {
        let flags = if value & CSR_RMVF == 0 {
            self.value & CSR_FLAGS
        } else {
            0
        };
        self.value = flags | value & (CSR_LSION | CSR_RANGE);
    }
}

/// First byte of the modelled flash pages: the store of the firmware, 20 pages at the end of bank 2.
pub(crate) const STORE_ADDRESS: u64 = 0x080f_6000;
/// Length of the modelled flash pages.
pub(crate) const STORE_BYTES: usize = 20 * PAGE_BYTES;
const PAGE_BYTES: usize = 2048;
/// Page number within bank 2 of the first modelled page.
const FIRST_PAGE: u32 = 256 - 20;

const FLASH_ACR: u64 = 0x00;
const FLASH_KEYR: u64 = 0x08;
const FLASH_SR: u64 = 0x10;
const FLASH_CR: u64 = 0x14;
const FLASH_ECCR: u64 = 0x18;
const FLASH_OPTR: u64 = 0x20;
/// Option bytes as a chip leaves the factory: no readout protection.
const OPTR_SHIPPED: u32 = 0xffef_f8aa;
const KEYS: [u32; 2] = [0x4567_0123, 0xcdef_89ab];
const CR_PG: u32 = 1 << 0;
const CR_PER: u32 = 1 << 1;
const CR_BKER: u32 = 1 << 11;
const CR_STRT: u32 = 1 << 16;
const CR_LOCK: u32 = 1 << 31;
const SR_PROGERR: u32 = 1 << 3;
const SR_WRPERR: u32 = 1 << 4;
const SR_PGSERR: u32 = 1 << 7;
const ECCR_ECCD: u32 = 1 << 31;

/// The flash controller and the pages of the store. Programming and erasing take no guest time.
#[derive(Debug)]
pub(crate) struct Flash {
    registers: RegisterFile,
    status: u32,
    control: u32,
    eccr: u32,
    keys_given: usize,
    first_half: Option<(usize, u32)>,
    cells: Vec<u8>,
    unreadable: Vec<usize>,
}

impl Flash {
    /// Erased, locked.
    pub(crate) fn new() -> Self {
        Flash {
            registers: RegisterFile::new(&[(FLASH_ACR, 0x0000_0600), (FLASH_OPTR, OPTR_SHIPPED)]),
            status: 0,
            control: CR_LOCK,
            eccr: 0,
            keys_given: 0,
            first_half: None,
            cells: vec![0xff; STORE_BYTES],
            unreadable: Vec::new(),
        }
    }

    /// Registers as after reset; the cells stay.
    pub(crate) fn reset(&mut self) {
        let cells = std::mem::take(&mut self.cells);
        let unreadable = std::mem::take(&mut self.unreadable);
        *self = Flash {
            cells,
            unreadable,
            ..Flash::new()
        };
    }

    /// Makes the 64-bit word at this byte of the store uncorrectable until its page is erased.
    pub(crate) fn damage(&mut self, byte: usize) {
        self.unreadable.push(byte / 8);
    }

    pub(crate) fn read(&self, offset: u64) -> u32 {
        match offset {
            FLASH_SR => self.status,
            FLASH_CR => self.control,
            FLASH_ECCR => self.eccr,
            _ => self.registers.read(offset),
        }
    }

    pub(crate) fn write(&mut self, offset: u64, value: u32) {
        match offset {
            FLASH_KEYR => self.unlock(value),
            FLASH_SR => self.status &= !value,
            FLASH_CR if self.control & CR_LOCK != 0 => {}
            FLASH_CR => {
                self.control = value & !CR_STRT;
                self.first_half = None;
                if value & (CR_STRT | CR_PER) == CR_STRT | CR_PER {
                    self.erase(value);
                }
            }
            FLASH_ECCR => self.eccr &= !(value & ECCR_ECCD),
            _ => self.registers.write(offset, value),
        }
    }

    fn unlock(&mut self, key: u32) {
        if KEYS.get(self.keys_given) == Some(&key) {
            self.keys_given += 1;
        }
        if self.keys_given == KEYS.len() {
            self.keys_given = 0;
            self.control &= !CR_LOCK;
        }
    }

    fn erase(&mut self, control: u32) {
        let page = (control >> 3) & 0xff;
        match page.checked_sub(FIRST_PAGE) {
            Some(page) if control & CR_BKER != 0 => {
                let start = page as usize * PAGE_BYTES;
                self.cells[start..start + PAGE_BYTES].fill(0xff);
                self.unreadable
                    .retain(|word| word * 8 / PAGE_BYTES != page as usize);
            }
            // The image itself is not to be erased.
            _ => self.status |= SR_WRPERR,
        }
    }

    /// Guest load from the store; the second value is true if it met an uncorrectable word: the NMI rises.
    pub(crate) fn load(&mut self, offset: u64, width: u32) -> (u32, bool) {
        let start = offset as usize;
        let bytes = self.cells.get(start..start + width as usize).unwrap_or(&[]);
        let value = bytes
            .iter()
            .rev()
            .fold(0, |value, &byte| (value << 8) | u32::from(byte));
        let bad = self.unreadable.contains(&(start / 8));
        if bad {
            self.eccr |= ECCR_ECCD;
        }
        (value, bad)
    }

    /// Guest store into the store: two 32-bit halves of a 64-bit word in order.
    pub(crate) fn store(&mut self, offset: u64, value: u32, width: u32) {
        let start = offset as usize;
        if self.control & (CR_PG | CR_LOCK) != CR_PG || width != 4 {
            self.status |= SR_PGSERR;
            return;
        }
        match self.first_half.take() {
            None if start.is_multiple_of(8) => self.first_half = Some((start, value)),
            Some((first, low)) if start == first + 4 => {
                self.program(first, u64::from(low) | (u64::from(value) << 32))
            }
            _ => self.status |= SR_PGSERR,
        }
    }

    fn program(&mut self, start: usize, value: u64) {
        let Some(word) = self.cells.get_mut(start..start + 8) else {
            return;
        };
        // A word that is not erased takes only zeros (RM0351 section 3.3.7).
        if word.iter().any(|&byte| byte != 0xff) && value != 0 {
            self.status |= SR_PROGERR;
            return;
        }
        word.copy_from_slice(&value.to_le_bytes());
    }
}

const IWDG_KR: u64 = 0x00;
const IWDG_PR: u64 = 0x04;
const IWDG_RLR: u64 = 0x08;
const KEY_RELOAD: u32 = 0xaaaa;
const KEY_START: u32 = 0xcccc;
/// LSI, datasheet DS10969 section 6.3.8.
const LSI_HZ: u64 = 32_000;

/// The independent watchdog.
#[derive(Debug)]
pub(crate) struct Watchdog {
    prescaler: u32,
    reload: u32,
    started: bool,
    bites_at_ns: Option<u64>,
}

impl Watchdog {
    pub(crate) fn new() -> Self {
        Watchdog {
            prescaler: 0,
            reload: 0xfff,
            started: false,
            bites_at_ns: None,
        }
    }

    /// When it resets the chip, if nobody pets it.
    pub(crate) fn bites_at_ns(&self) -> Option<u64> {
        self.bites_at_ns
    }

    pub(crate) fn read(&self, offset: u64) -> u32 {
        match offset {
            IWDG_PR => self.prescaler,
            IWDG_RLR => self.reload,
            _ => 0,
        }
    }

    pub(crate) fn write(&mut self, offset: u64, value: u32, now_ns: u64) {
        match (offset, value) {
            (IWDG_KR, KEY_START) => self.started = true,
            (IWDG_KR, KEY_RELOAD) => {}
            (IWDG_KR, _) => return,
            (IWDG_PR, _) => self.prescaler = value & 7,
            (IWDG_RLR, _) => self.reload = value & 0xfff,
            _ => return,
        }
        if self.started {
            let steps = (u64::from(self.reload) + 1) * (4 << self.prescaler.min(6));
            self.bites_at_ns = Some(now_ns + steps * 1_000_000_000 / LSI_HZ);
        }
    }
}

const ADC_ISR: u64 = 0x00;
const ADC_CR: u64 = 0x08;
const ADC_DR: u64 = 0x40;
const ADC_ADRDY: u32 = 1 << 0;
const ADC_EOC_EOS: u32 = (1 << 2) | (1 << 3);
const ADC_ADEN: u32 = 1 << 0;
const ADC_ADDIS: u32 = 1 << 1;
const ADC_ADSTART: u32 = 1 << 2;
/// ADVREGEN and DEEPPWD: plain memory.
const ADC_POWER: u32 = (1 << 28) | (1 << 29);

/// ADC1: every conversion gives the same sample, at once.
#[derive(Debug)]
pub(crate) struct Adc {
    registers: RegisterFile,
    status: u32,
    control: u32,
    sample: u16,
}

impl Adc {
    pub(crate) fn new(sample: u16) -> Self {
        Adc {
            registers: RegisterFile::new(&[]),
            status: 0,
            control: 1 << 29,
            sample,
        }
    }

    /// What the pin's voltage converts to.
    pub(crate) fn set_sample(&mut self, sample: u16) {
        self.sample = sample;
    }

    pub(crate) fn reset(&mut self) {
        *self = Adc::new(self.sample);
    }

    pub(crate) fn read(&mut self, offset: u64) -> u32 {
        match offset {
            ADC_ISR => self.status,
            ADC_CR => self.control,
            ADC_DR => {
                self.status &= !(1 << 2);
                u32::from(self.sample)
            }
            _ => self.registers.read(offset),
        }
    }

    pub(crate) fn write(&mut self, offset: u64, value: u32) {
        match offset {
            ADC_ISR => self.status &= !value,
            ADC_CR => {
                // Calibration, stop and start end within the store; enable stays until disabled.
                self.control = (self.control & ADC_ADEN) | (value & ADC_POWER);
                if value & ADC_ADEN != 0 {
                    self.control |= ADC_ADEN;
                    self.status |= ADC_ADRDY;
                }
                if value & ADC_ADDIS != 0 {
                    self.control &= !ADC_ADEN;
                    self.status &= !ADC_ADRDY;
                }
                if value & ADC_ADSTART != 0 && self.control & ADC_ADEN != 0 {
                    self.status |= ADC_EOC_EOS;
                }
            }
            _ => self.registers.write(offset, value),
        }
    }
}

const RNG_CR: u64 = 0x00;
const RNG_SR: u64 = 0x04;
const RNG_DR: u64 = 0x08;
const RNG_RNGEN: u32 = 1 << 2;
const RNG_DRDY: u32 = 1 << 0;
/// CECS and CEIS: the clock is too slow now, and was.
const RNG_CLOCK_ERROR: u32 = (1 << 1) | (1 << 5);
/// SECS and SEIS: the seed is bad now, and was.
const RNG_SEED_ERROR: u32 = (1 << 2) | (1 << 6);
const RNG_SEIS: u32 = 1 << 6;
/// Words that a generator gives before its seed fails once.
const WORDS_BEFORE_SEED_ERROR: u32 = 10;

/// The random number generator: a fixed sequence that goes on over resets, so that boots differ and runs repeat.
#[derive(Debug)]
pub(crate) struct Rng {
    control: u32,
    state: u64,
    fault: Option<RngFault>,
    words: u32,
    seed_failed: bool,
}

impl Rng {
    pub(crate) fn new(seed: u64, fault: Option<RngFault>) -> Self {
        Rng {
            control: 0,
            state: seed,
            fault,
            words: 0,
            seed_failed: false,
        }
    }

    fn status(&self) -> u32 {
        match self.fault {
            Some(RngFault::Clock) => RNG_CLOCK_ERROR,
            Some(RngFault::Seed) => RNG_SEED_ERROR,
            Some(RngFault::Silent) => 0,
            _ if self.seed_failed => RNG_SEED_ERROR,
            _ if self.control & RNG_RNGEN != 0 => RNG_DRDY,
            _ => 0,
        }
    }

    fn word(&mut self) -> u32 {
        if self.status() & RNG_DRDY == 0 {
            return 0;
        }
        self.words = self.words.saturating_add(1);
        if self.fault == Some(RngFault::SeedOnce) && self.words == WORDS_BEFORE_SEED_ERROR {
            self.seed_failed = true;
        }
        if self.fault == Some(RngFault::Stuck) {
            return self.state as u32;
        }
        self.next()
    }

    pub(crate) fn read(&mut self, offset: u64) -> u32 {
        match offset {
            RNG_CR => self.control,
            RNG_SR => self.status(),
            RNG_DR => self.word(),
            _ => 0,
        }
    }

    pub(crate) fn write(&mut self, offset: u64, value: u32) {
        match offset {
            RNG_CR => self.control = value,
            // Cleared by a 0, with the generator off (RM0351 section 27.3.5).
            RNG_SR if value & RNG_SEIS == 0 && self.control & RNG_RNGEN == 0 => {
                self.seed_failed = false;
            }
            _ => {}
        }
    }

    /// SplitMix64 (Steele, Lea, Flood 2014), upper half.
    fn next(&mut self) -> u32 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 32) as u32
    }
}
