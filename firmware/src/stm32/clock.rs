//! Time from SysTick: a 1 kHz tick, and microseconds read from the counter in between.
//!
//! embassy's own time drivers need a timer that QEMU does not model; SysTick exists on every Cortex-M and in QEMU.
//! Sleeps end on a tick: exactly on whole milliseconds, up to 1 ms late otherwise.

use core::cell::{Cell, RefCell};
use core::task::Waker;

use cortex_m::peripheral::{SCB, SYST, syst::SystClkSource};
use cortex_m_rt::exception;
use critical_section::{CriticalSection, Mutex};
use embassy_time_driver::Driver;
use embassy_time_queue_utils::Queue;
use firmware::ports::Clock;

/// Tick period in microseconds.
const TICK_US: u32 = 1000;

struct SysTickDriver {
    /// Ticks since boot.
    ticks: Mutex<Cell<u64>>,
    /// Next instant at which a sleeper wants to wake, microseconds.
    alarm_us: Mutex<Cell<u64>>,
    queue: Mutex<RefCell<Queue>>,
    /// Counter steps per microsecond; 0 before [`init`].
    steps_per_us: Mutex<Cell<u32>>,
}

embassy_time_driver::time_driver_impl!(static DRIVER: SysTickDriver = SysTickDriver {
    ticks: Mutex::new(Cell::new(0)),
    alarm_us: Mutex::new(Cell::new(u64::MAX)),
    queue: Mutex::new(RefCell::new(Queue::new())),
    steps_per_us: Mutex::new(Cell::new(0)),
});

/// Starts the tick; `core_hz` is a multiple of 1 MHz.
pub(crate) fn init(mut systick: SYST, core_hz: u32) {
    let steps_per_us = core_hz / 1_000_000;
    critical_section::with(|cs| DRIVER.steps_per_us.borrow(cs).set(steps_per_us));
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(steps_per_us * TICK_US - 1);
    systick.clear_current();
    systick.enable_counter();
    systick.enable_interrupt();
}

impl SysTickDriver {
    fn now_us(&self, cs: CriticalSection<'_>) -> u64 {
        let ticks = self.ticks.borrow(cs).get();
        let steps_per_us = self.steps_per_us.borrow(cs).get();
        if steps_per_us == 0 {
            return 0;
        }
        let mut steps_left = SYST::get_current();
        let mut pending = 0;
        if SCB::is_pendst_pending() {
            // The counter has wrapped and the handler has not run yet: read again, after the wrap for certain.
            steps_left = SYST::get_current();
            pending = 1;
        }
        let within = (steps_per_us * TICK_US - 1).saturating_sub(steps_left) / steps_per_us;
        (ticks + pending) * u64::from(TICK_US) + u64::from(within)
    }

    fn on_tick(&self) {
        critical_section::with(|cs| {
            let ticks = self.ticks.borrow(cs).get() + 1;
            self.ticks.borrow(cs).set(ticks);
            let now = ticks * u64::from(TICK_US);
            if now >= self.alarm_us.borrow(cs).get() {
                let next = self.queue.borrow_ref_mut(cs).next_expiration(now);
                self.alarm_us.borrow(cs).set(next);
            }
        });
    }
}

impl Driver for SysTickDriver {
    fn now(&self) -> u64 {
        critical_section::with(|cs| self.now_us(cs))
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        critical_section::with(|cs| {
            let mut queue = self.queue.borrow_ref_mut(cs);
            if queue.schedule_wake(at, waker) {
                let next = queue.next_expiration(self.now_us(cs));
                self.alarm_us.borrow(cs).set(next);
            }
        });
    }
}

#[exception]
fn SysTick() {
    DRIVER.on_tick();
}

/// The application's clock.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SysTickClock;

impl Clock for SysTickClock {
    fn now_us(&self) -> u64 {
        DRIVER.now()
    }

    async fn sleep_until_us(&self, at_us: u64) {
        embassy_time::Timer::at(embassy_time::Instant::from_micros(at_us)).await;
    }
}
