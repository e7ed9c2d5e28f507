// SPDX-License-Identifier: GPL-2.0-or-later
//! Guest sleep on the processor's own thread.
//!
//! QEMU lets a processor that sleeps in WFI hand over to its main thread, which moves guest time to the next timer, runs it and wakes the processor's
//! thread again. That costs two changes of thread for every interrupt, more than all that the guest computes. Here the same
//! is done just before WFI, with the same times: then WFI finds work and does not sleep.

use std::ffi::{c_int, c_uint, c_void};
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};

use crate::ffi::{self, Opaque};

/// The instruction WFI (Armv7-M Architecture Reference Manual, WFI, encoding T1), in memory order.
const WFI: [u8; 2] = 0xbf30_u16.to_le_bytes();
/// Place of `qemu_icount_bias` in `TimersState` (`system/timers-state.h` of QEMU 10.0), bytes: what is added to the time of the instructions executed.
const BIAS_AT: usize = 0x28;
/// `QEMU_TIMER_ATTR_ALL` without `QEMU_TIMER_ATTR_EXTERNAL`: what QEMU itself asks for before it moves time.
const GUEST_TIMERS: c_int = !1;
/// Timers run before one WFI; then QEMU's own way takes over. Between two ticks of the guest's clock there are 200 byte times at most.
const MOST_TIMERS: u32 = 1_000;

/// Whether [`BIAS_AT`] is right.
static USABLE: AtomicBool = AtomicBool::new(false);
/// A reset was asked for: QEMU's main thread carries it out, and until then time stands.
static RESETTING: AtomicBool = AtomicBool::new(false);

/// Tries whether guest time can be moved from here. Called once, before the first instruction.
pub(crate) fn prepare() {
    let before = now();
    move_time(1);
    let moved = now() - before == 1;
    move_time(-1);
    if !moved {
        eprintln!("rb-shim: another layout of QEMU's clock than in 10.0: the guest runs slowly");
    }
    USABLE.store(moved, Ordering::Relaxed);
}

/// Whether a reset has been asked for and not been carried out.
pub(crate) fn set_resetting(resetting: bool) {
    RESETTING.store(resetting, Ordering::Relaxed);
}

fn now() -> i64 {
    // SAFETY: reads a clock; called where that is allowed.
    unsafe { ffi::qemu_clock_get_ns(ffi::CLOCK_VIRTUAL) }
}

fn move_time(by_ns: i64) {
    let state = (&raw mut ffi::timers_state).cast::<u8>();
    // SAFETY: `TimersState` of 10.0 is larger than this and aligned to 8 bytes; `prepare` finds out whether it is the field. QEMU's own writers hold
    // the big lock, as every caller here does, and its readers take the field at once on a 64-bit host.
    let bias = unsafe { AtomicI64::from_ptr(state.add(BIAS_AT).cast()) };
    bias.fetch_add(by_ns, Ordering::SeqCst);
}

/// Watches for WFI in a block that is being translated.
pub(crate) fn watch(instruction: *mut Opaque) {
    let mut bytes = [0; 2];
    // SAFETY: the instruction belongs to the block being translated; the buffer has the length given; the callback needs no data.
    unsafe {
        let copied = ffi::qemu_plugin_insn_data(instruction, bytes.as_mut_ptr().cast(), 2);
        if copied == bytes.len() && bytes == WFI {
            ffi::qemu_plugin_register_vcpu_insn_exec_cb(
                instruction,
                about_to_sleep,
                ffi::CB_NO_REGS,
                std::ptr::null_mut(),
            );
        }
    }
}

/// Brings guest time up to this instruction, and on to the next interrupt. QEMU counts a slice's instructions only when the processor's thread is back
/// from it. Between WFI and then its main thread may find the processor asleep, and would skip to the next timer from
/// the time at which the slice began.
extern "C" fn about_to_sleep(_vcpu: c_uint, _user: *mut c_void) {
    // WFI is the last instruction of its block, where the clock may be read: that counts what has run.
    now();
    // SAFETY: the queue's first member is its first processor, the only one of this machine.
    let cpu = unsafe { ffi::cpus_queue };
    if cpu.is_null() || !USABLE.load(Ordering::Relaxed) {
        return;
    }
    // SAFETY: the processor's thread does not hold the big lock while it executes instructions; timers run under it. `cpu_exit` makes QEMU reckon anew
    // how many instructions there are until the next timer.
    unsafe {
        ffi::bql_lock_impl(c"sleep.rs".as_ptr(), 0);
        for _ in 0..MOST_TIMERS {
            if ffi::cpu_has_work(cpu) || RESETTING.load(Ordering::Relaxed) {
                break;
            }
            let wait_ns = ffi::qemu_clock_deadline_ns_all(ffi::CLOCK_VIRTUAL, GUEST_TIMERS);
            if wait_ns < 0 {
                break;
            }
            move_time(wait_ns);
            ffi::qemu_clock_run_timers(ffi::CLOCK_VIRTUAL);
        }
        ffi::cpu_exit(cpu);
        ffi::bql_unlock();
    }
}
