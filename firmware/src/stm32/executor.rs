//! The executor's idle loop: sleep in WFI until an interrupt has made work.
//!
//! The stock thread executor sleeps with WFE, which QEMU treats as a no-operation.

use core::sync::atomic::{AtomicBool, Ordering};

use embassy_executor::{Spawner, raw};
use static_cell::StaticCell;

static WORK: AtomicBool = AtomicBool::new(true);

/// Called by the executor whenever a task has been woken, from interrupts too.
#[unsafe(export_name = "__pender")]
extern "Rust" fn pender(_context: *mut ()) {
    WORK.store(true, Ordering::Release);
}

/// Runs the tasks that `start` spawns, for ever.
pub(crate) fn run(start: impl FnOnce(Spawner)) -> ! {
    static EXECUTOR: StaticCell<raw::Executor> = StaticCell::new();
    let executor: &'static raw::Executor = EXECUTOR.init(raw::Executor::new(core::ptr::null_mut()));
    start(executor.spawner());
    loop {
        // With interrupts masked an interrupt still ends WFI, so work that comes after the test is not slept through. Most interrupts take or give a
        // byte and wake nobody: then nothing else is looked at.
        cortex_m::interrupt::disable();
        let work = WORK.load(Ordering::Relaxed);
        if !work {
            cortex_m::asm::wfi();
        }
        // SAFETY: ends the short critical section begun above.
        unsafe { cortex_m::interrupt::enable() };
        if work {
            WORK.store(false, Ordering::Release);
            // SAFETY: the executor is polled from this loop alone, never from an interrupt and never re-entered.
            unsafe { executor.poll() };
        }
    }
}
