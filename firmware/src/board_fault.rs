//! The end of the road: panic, HardFault and NMI. Outputs safe, a record in RAM that survives, then a reset.

use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::addr_of_mut;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};
use embassy_stm32::pac;
use firmware::crash::{BLOCK_BYTES, CrashKind, CrashRecord};

use crate::board_log;

/// Exit codes of QEMU.
const EXIT_PANIC: i32 = 1;
const EXIT_FAULT: i32 = 2;

/// Configurable fault status register, ARMv7-M B3.2.15.
const CFSR: *const u32 = 0xe000_ed28 as *const u32;

/// In `.uninit`: neither the start-up code nor a reset touches it.
#[unsafe(link_section = ".uninit.crash")]
static mut CRASH_BLOCK: MaybeUninit<[u8; BLOCK_BYTES]> = MaybeUninit::uninit();

static BLOCK_TAKEN: AtomicBool = AtomicBool::new(false);
static ECC_ERROR: AtomicBool = AtomicBool::new(false);
/// The supervisor's state is not known here; the record carries the state after boot.
const STATE: u8 = 0;

/// The block for the application, once. The handlers below write it only when the application will never run again.
pub(crate) fn take_block() -> Option<&'static mut [u8; BLOCK_BYTES]> {
    if BLOCK_TAKEN.swap(true, Ordering::AcqRel) {
        return None;
    }
    // SAFETY: handed out once; any bytes are a valid array, and RAM holds some value after power-up.
    Some(unsafe { (*addr_of_mut!(CRASH_BLOCK)).assume_init_mut() })
}

/// True if a flash read since the last call met an uncorrectable error.
pub(crate) fn take_ecc_error() -> bool {
    ECC_ERROR.swap(false, Ordering::AcqRel)
}

/// Silences the motor bus: the transmitter off releases driver enable, and the drivers' own watchdogs damp the motors.
fn make_outputs_safe() {
    pac::USART2.cr1().modify(|w| w.set_te(false));
}

fn end(record: &CrashRecord, code: i32) -> ! {
    let mut bytes = [0; BLOCK_BYTES];
    record.encode(&mut bytes);
    // SAFETY: interrupts are off and the application is dead, so nothing else uses the block.
    unsafe { addr_of_mut!(CRASH_BLOCK).write_volatile(MaybeUninit::new(bytes)) };
    board_log::exit_if_emulated(code);
    SCB::sys_reset()
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    make_outputs_safe();
    let mut record = CrashRecord::new(CrashKind::Panic, STATE, embassy_time_driver::now());
    if let Some(place) = info.location() {
        record.detail = place.line();
        record.set_text(place.file());
        defmt::error!("panic at {=str}:{=u32}", place.file(), place.line());
    }
    end(&record, EXIT_PANIC)
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    cortex_m::interrupt::disable();
    make_outputs_safe();
    let mut record = CrashRecord::new(CrashKind::HardFault, STATE, embassy_time_driver::now());
    record.pc = frame.pc();
    record.lr = frame.lr();
    // SAFETY: a system register that every ARMv7-M core has.
    record.detail = unsafe { CFSR.read_volatile() };
    defmt::error!(
        "HardFault: pc {=u32:#x} lr {=u32:#x} cfsr {=u32:#x}",
        record.pc,
        record.lr,
        record.detail
    );
    end(&record, EXIT_FAULT)
}

/// Flash ECC raises the NMI. A two-bit error becomes a flag that the slot store turns into an error value.
#[exception]
unsafe fn NonMaskableInt() {
    let ecc = pac::FLASH.eccr().read();
    if ecc.eccd() {
        // Writing one clears; the read that caused it then returns, with unusable data.
        pac::FLASH.eccr().write_value(ecc);
        ECC_ERROR.store(true, Ordering::Release);
        return;
    }
    cortex_m::interrupt::disable();
    make_outputs_safe();
    let record = CrashRecord::new(CrashKind::Nmi, STATE, embassy_time_driver::now());
    end(&record, EXIT_FAULT)
}
