//! Hostile bytes through everything the module links: frames → orders → gait → CPG → planner and pre-check → supervisor, and the motor bus from both ends.
//!
//! The panic handler calls a function that exists nowhere. So this program links only if the optimiser proved that no panic can be reached
//! in `control` and `protocol` from what is called here, whatever the bytes are. Linking is the test; nothing runs it.
//!
//! `cargo build --release --manifest-path tests/panic-free/Cargo.toml --target thumbv7em-none-eabihf`
//! The same with `--features bite` must fail.
#![no_std]
#![no_main]

mod bus;
mod law;
mod link;

use core::panic::PanicInfo;

unsafe extern "C" {
    /// Defined nowhere. "undefined symbol: a_panic_is_reachable" in the linker's output means just that.
    fn a_panic_is_reachable() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    // SAFETY: never linked, so never called.
    unsafe { a_panic_is_reachable() }
}

/// Words the optimiser knows nothing about.
pub(crate) struct Hostile;

impl Hostile {
    pub(crate) fn word(&mut self) -> u32 {
        // SAFETY: RDR of USART3 on the STM32L475 (RM0351, 40.8.11), aligned and readable.
        unsafe { core::ptr::read_volatile(0x4000_4824 as *const u32) }
    }

    pub(crate) fn byte(&mut self) -> u8 {
        self.word() as u8
    }

    pub(crate) fn time(&mut self) -> u64 {
        (u64::from(self.word()) << 32) | u64::from(self.word())
    }

    pub(crate) fn float(&mut self) -> f32 {
        f32::from_bits(self.word())
    }

    pub(crate) fn floats<const N: usize>(&mut self) -> [f32; N] {
        let mut out = [0.0; N];
        for f in &mut out {
            *f = self.float();
        }
        out
    }

    pub(crate) fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let mut out = [0; N];
        for b in &mut out {
            *b = self.byte();
        }
        out
    }
}

/// Keeps a result alive.
pub(crate) fn sink<T>(value: T) {
    core::hint::black_box(value);
}

/// Entry point of the image.
#[unsafe(no_mangle)]
pub extern "C" fn _start() -> ! {
    let mut hostile = Hostile;
    loop {
        law::drive(&mut hostile);
        link::drive(&mut hostile);
        bus::drive(&mut hostile);
        #[cfg(feature = "bite")]
        sink([1u8, 2, 3][hostile.word() as usize]);
    }
}
