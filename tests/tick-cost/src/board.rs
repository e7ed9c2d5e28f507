//! Reset, console and counter of the emulated board.

use core::fmt;

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    exit(0x2_0024)
}

/// Console through the semihosting of QEMU.
pub(crate) struct Console;

impl fmt::Write for Console {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for byte in text.bytes() {
            // SYS_WRITEC takes the address of one character (Arm semihosting, 5.22).
            semihost(0x03, &raw const byte as u32);
        }
        Ok(())
    }
}

fn semihost(operation: u32, argument: u32) {
    // SAFETY: the breakpoint is the semihosting call of Armv7-M; `argument` is a number or points to a live byte.
    unsafe { core::arch::asm!("bkpt 0xab", inout("r0") operation => _, in("r1") argument) }
}

/// SYS_EXIT with a reason: 0x20026 is a normal end, anything else a failure.
fn exit(reason: u32) -> ! {
    loop {
        semihost(0x18, reason);
    }
}

const SYST_CSR: *mut u32 = 0xe000_e010 as *mut u32;
const SYST_RVR: *mut u32 = 0xe000_e014 as *mut u32;
const SYST_CVR: *const u32 = 0xe000_e018 as *const u32;
const CPACR: *mut u32 = 0xe000_ed88 as *mut u32;
/// SysTick runs at 25 MHz on this board, and one instruction takes 1 ns of guest time.
pub(crate) const INSTRUCTIONS_PER_TICK: u32 = 40;

/// Instructions of a call, to 40, and its result. At most 671 million.
pub(crate) fn cost<T>(call: impl FnOnce() -> T) -> (u32, T) {
    // SAFETY: reads a counter of the core.
    let now = || unsafe { core::ptr::read_volatile(SYST_CVR) };
    let before = now();
    let result = core::hint::black_box(call());
    let ticks = before.wrapping_sub(now()) & 0x00ff_ffff;
    (ticks * INSTRUCTIONS_PER_TICK, result)
}

/// Every exception but reset ends in reset too; there are none.
#[unsafe(link_section = ".vectors")]
#[used]
static VECTORS: [unsafe extern "C" fn() -> !; 15] = [reset; 15];

/// Entry point: FPU on, SysTick on, measure, exit.
#[unsafe(no_mangle)]
unsafe extern "C" fn reset() -> ! {
    // SAFETY: core registers, written once before anything uses them.
    unsafe {
        core::ptr::write_volatile(CPACR, 0xf << 20);
        core::arch::asm!("dsb", "isb");
        core::ptr::write_volatile(SYST_RVR, 0x00ff_ffff);
        core::ptr::write_volatile(SYST_CSR, 0b101);
    }
    crate::main();
    exit(0x2_0026)
}
