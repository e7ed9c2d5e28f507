//! What the application needs from the world: clock, motor bus, host links, slot flash, board.
//!
//! A board file (or the emulated robot) implements these traits and hands them to [`crate::tasks::run`].
//! Every method says what the implementer owes. None of them may block longer than its documentation allows,
//! because all tasks share one thread and the 20 Hz cycle runs on it.

use crate::entropy::EntropyError;
use core::future::Future;

/// Monotonic time since boot. Never wraps within the life of a boot (u64 microseconds).
pub trait Clock {
    /// Time since boot in microseconds. Two calls in a row never go backwards.
    fn now_us(&self) -> u64;

    /// Resolves at or after `at_us`; at once if that instant has passed. Dropping the future is harmless.
    fn sleep_until_us(&self, at_us: u64) -> impl Future<Output = ()>;
}

/// Why a byte port gave nothing. The caller drops what it has, resynchronises on the next frame start and counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PortError {
    /// Bytes were lost: receive overrun or a full receive ring.
    Overrun,
    /// Framing, parity or noise error.
    Noise,
    /// The other side is gone (closed connection, cable). The port may come back later.
    Closed,
}

/// The half-duplex motor bus, 1 Mbaud 8N1, driver enable switched by hardware.
pub trait BusPort {
    /// Sends all bytes. May resolve before the last stop bit has left (a buffered UART does); the caller allows for
    /// the byte times. The transceiver must be back in receive at most one byte time after the last stop bit.
    fn write_all(&mut self, bytes: &[u8]) -> impl Future<Output = Result<(), PortError>>;

    /// Waits for at least one byte, then returns how many bytes of `into` were filled (>= 1).
    /// Cancel-safe: dropping the future loses no byte. After an error reception goes on by itself.
    /// The bus may or may not echo what was sent; both are handled by the caller.
    fn read(&mut self, into: &mut [u8]) -> impl Future<Output = Result<usize, PortError>>;

    /// Throws away everything received so far, without waiting.
    fn discard_input(&mut self);
}

/// Which medium a link runs over. The key of the robot is set over [`LinkKind::Wire`] only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LinkKind {
    /// A cable that somebody holds in the hand (USB serial).
    Wire,
    /// Bluetooth, Wi-Fi bridge: whoever is in range can send.
    Radio,
}

/// Receiving half of a host link.
pub trait LinkRx {
    /// Waits for at least one byte and returns how many were filled (>= 1). Cancel-safe.
    /// On [`PortError::Closed`] the next call waits until the link is back.
    fn read(&mut self, into: &mut [u8]) -> impl Future<Output = Result<usize, PortError>>;
}

/// Sending half of a host link.
pub trait LinkTx {
    /// Takes as many bytes as fit (>= 1), waiting for room; returns how many.
    /// A link that nobody reads may wait for ever: only the link's own task waits with it.
    fn write(&mut self, bytes: &[u8]) -> impl Future<Output = Result<usize, PortError>>;
}

/// One host link: both halves and the medium.
#[derive(Debug)]
pub struct LinkPort<R, T> {
    /// Cable or radio.
    pub kind: LinkKind,
    /// Receiving half.
    pub rx: R,
    /// Sending half.
    pub tx: T,
}

/// A link half that is not fitted: never receives, takes every byte.
#[derive(Debug, Clone, Copy, Default)]
pub struct NotFitted;

impl LinkRx for NotFitted {
    async fn read(&mut self, _into: &mut [u8]) -> Result<usize, PortError> {
        core::future::pending().await
    }
}

impl LinkTx for NotFitted {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, PortError> {
        Ok(bytes.len())
    }
}

/// Flash page size in bytes: STM32L475, RM0351 section 3.3.1; STM32G474 with two banks too.
pub const PAGE_BYTES: usize = 2048;
/// Smallest programmable unit in bytes: one 64-bit word with its 8 ECC bits, RM0351 section 3.3.7.
pub const WORD_BYTES: usize = 8;
/// Words per page.
pub const PAGE_WORDS: usize = PAGE_BYTES / WORD_BYTES;
/// Pages that the slot store uses: see [`crate::slots`] for the layout.
pub const STORE_PAGES: usize = 20;

/// Why a flash operation failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FlashError {
    /// Two-bit ECC error on read (on the L4 it raises the NMI; the board turns it into this value).
    Ecc,
    /// Page or word number outside the store.
    Range,
    /// The controller refused: word not erased, write protection, supply too low.
    Controller,
}

/// The flash pages that hold gait slots, the key and the fault record. Pages are numbered from 0 within the store.
///
/// Each word is programmed at most once between two erases of its page.
pub trait SlotStore {
    /// Erases one page to all ones. May block for the erase time (22 to 25 ms); never called while a gait runs.
    fn erase(&mut self, page: usize) -> Result<(), FlashError>;

    /// Programs one 64-bit word. May block for the programming time (about 90 us).
    fn program(
        &mut self,
        page: usize,
        word: usize,
        bytes: &[u8; WORD_BYTES],
    ) -> Result<(), FlashError>;

    /// Reads one word. An uncorrectable ECC error is [`FlashError::Ecc`], never a hang or a reset.
    fn read(&mut self, page: usize, word: usize) -> Result<[u8; WORD_BYTES], FlashError>;
}

/// Why the processor started.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum ResetCause {
    /// Supply came up (or a power reset that cannot be told from it).
    PowerOn = 0,
    /// Supply fell below the brown-out level.
    BrownOut = 1,
    /// Reset pin.
    Pin = 2,
    /// Software asked for it: the reset order, or the end of the panic and fault handlers.
    Software = 3,
    /// Independent watchdog: the cycle task stopped checking in.
    Watchdog = 4,
    /// Option bytes, firewall, low power: not expected in this application.
    Other = 5,
}

/// The rest of the board.
pub trait Board {
    /// Battery voltage in mV, `None` when it cannot be measured (no divider, ADC fault).
    fn battery_mv(&mut self) -> Option<u16>;

    /// Cause of this boot, the same value on every call.
    fn reset_cause(&self) -> ResetCause;

    /// Name of the board, the last word of the firmware's name in HELLO: at most 16 characters. [`protocol::link::status::EMULATED`] says that
    /// nothing real moves.
    fn name(&self) -> &'static str;

    /// The chip's unique id (96 bits on the STM32).
    fn unique_id(&self) -> [u8; 12];

    /// 16 bytes that differ at every boot. A hardware random number generator on silicon; an emulator gives seeded bytes.
    /// They seed the boot id and the challenges; a generator that fails its test ([`crate::entropy::collect`]) gives an error, never a guess. Bounded.
    fn entropy(&mut self) -> Result<[u8; 16], EntropyError>;

    /// Whether a debug probe can read the flash, and the key in it.
    fn flash_readable(&self) -> bool;

    /// Restarts the independent watchdog (period <= 200 ms). Called once per complete cycle and nowhere else.
    fn pet_watchdog(&mut self);

    /// True while the STOP input is active (button pressed or its wire broken).
    fn stop_input(&mut self) -> bool;

    /// The fault record block in RAM that survives a reset, as raw bytes: see [`crate::crash`].
    fn crash_block(&mut self) -> &mut [u8; crate::crash::BLOCK_BYTES];

    /// Resets the processor. On a board it does not return; an emulator notes the wish and lets the tasks be dropped.
    fn reboot(&mut self);
}
