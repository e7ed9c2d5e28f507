//! The end of the road: panic, HardFault and NMI. Outputs safe, a record in RAM that survives, then a reset.

use core::arch::global_asm;
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::addr_of_mut;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};
use embassy_stm32::pac;
use firmware::crash::{BLOCK_BYTES, CrashKind, CrashRecord};

use super::log;
use super::parts::BoardFile;
use crate::board::Chosen;

/// Exit codes of QEMU.
const EXIT_PANIC: i32 = 1;
const EXIT_FAULT: i32 = 2;
const EXIT_STACK: i32 = 3;

/// Configurable fault status register, ARMv7-M B3.2.15.
const CFSR: *const u32 = 0xe000_ed28 as *const u32;

/// Stacking errors in the CFSR: bus fault (bit 12) and memory fault (bit 4) while an exception saved registers.
const STACKING: u32 = 1 << 12 | 1 << 4;
/// Bytes of the frame that an exception saves, ARMv7-M B1.5.6.
const FRAME_BYTES: u32 = 32;

/// Stack of the fault handler: the one that overflowed cannot be used, and a handler that runs into it again locks the core up without a record.
const FAULT_STACK_BYTES: usize = 2048;

#[repr(align(8))]
struct FaultStack(#[allow(dead_code, reason = "used by its address")] [u8; FAULT_STACK_BYTES]);

#[unsafe(no_mangle)]
#[unsafe(link_section = ".uninit.fault_stack")]
static mut FAULT_STACK: MaybeUninit<FaultStack> = MaybeUninit::uninit();

// Entered instead of cortex-m-rt's trampoline: hands over the address of the saved frame and EXC_RETURN's stack, after moving to the stack above. Not a
// single push comes before that.
global_asm!(
    ".section .HardFaultTrampoline, \"ax\"
    .global HardFault
    .type HardFault,%function
    .thumb_func
    HardFault:
        mrs r0, MSP
        tst lr, #4
        it ne
        mrsne r0, PSP
        ldr r1, =FAULT_STACK + {bytes}
        msr MSP, r1
        b _HardFault
    .size HardFault, . - HardFault",
    bytes = const FAULT_STACK_BYTES,
);

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
    Chosen::BUS.cr1().modify(|w| w.set_te(false));
}

fn end(record: &CrashRecord, code: i32) -> ! {
    let mut bytes = [0; BLOCK_BYTES];
    record.encode(&mut bytes);
    // SAFETY: interrupts are off and the application is dead, so nothing else uses the block.
    unsafe { addr_of_mut!(CRASH_BLOCK).write_volatile(MaybeUninit::new(bytes)) };
    log::exit_if_emulated(code);
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

unsafe extern "C" {
    /// Lowest address of the stack, from the board's memory map.
    static _stack_end: u32;
    static _stack_start: u32;
}

#[unsafe(export_name = "_HardFault")]
unsafe extern "C" fn hard_fault(frame: *const ExceptionFrame) -> ! {
    cortex_m::interrupt::disable();
    make_outputs_safe();
    // SAFETY: a system register that every ARMv7-M core has.
    let cfsr = unsafe { CFSR.read_volatile() };
    let (bottom, top) = (&raw const _stack_end as u32, &raw const _stack_start as u32);
    let at = frame as u32;
    let saved = at >= bottom && at.saturating_add(FRAME_BYTES) <= top;
    // Below its end, or where the frame could not be saved: the stack ran out.
    let overflow = at < bottom.saturating_add(FRAME_BYTES) || cfsr & STACKING != 0;
    let kind = if overflow {
        CrashKind::StackOverflow
    } else {
        CrashKind::HardFault
    };
    let mut record = CrashRecord::new(kind, STATE, embassy_time_driver::now());
    record.detail = cfsr;
    if saved && cfsr & STACKING == 0 {
        // SAFETY: the whole frame lies in the stack, and the exception has just saved it there.
        let frame = unsafe { &*frame };
        (record.pc, record.lr) = (frame.pc(), frame.lr());
    }
    defmt::error!(
        "HardFault: stack {=bool} pc {=u32:#x} lr {=u32:#x} cfsr {=u32:#x}",
        overflow,
        record.pc,
        record.lr,
        record.detail
    );
    end(&record, if overflow { EXIT_STACK } else { EXIT_FAULT })
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
