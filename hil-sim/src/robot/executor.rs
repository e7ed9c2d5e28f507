//! A deterministic single-thread executor on a virtual clock.
//!
//! One future holds all tasks of the robot (they are joined, so one poll reaches each of them). Whoever waits for an
//! instant says so on every poll; when nothing can go on, the clock jumps to the earliest of these instants.

use firmware::ports::Clock;
use std::cell::Cell;
use std::future::{Future, poll_fn};
use std::pin::Pin;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, Wake, Waker};

#[derive(Debug, Default)]
struct Time {
    now_us: Cell<u64>,
    next_us: Cell<u64>,
}

/// Handle to the virtual clock; clones show the same time.
#[derive(Debug, Clone, Default)]
pub struct VirtualClock(Rc<Time>);

impl VirtualClock {
    /// Asks to be polled again at `at_us` at the latest. Valid until the next poll.
    pub fn poll_again_at(&self, at_us: u64) {
        self.0.next_us.set(self.0.next_us.get().min(at_us));
    }
}

impl Clock for VirtualClock {
    fn now_us(&self) -> u64 {
        self.0.now_us.get()
    }

    async fn sleep_until_us(&self, at_us: u64) {
        poll_fn(|_| {
            if self.now_us() >= at_us {
                return Poll::Ready(());
            }
            self.poll_again_at(at_us);
            Poll::Pending
        })
        .await;
    }
}

#[derive(Debug, Default)]
struct Flag(AtomicBool);

impl Wake for Flag {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// The executor: one future, one clock.
pub struct Executor {
    clock: VirtualClock,
    tasks: Option<Pin<Box<dyn Future<Output = ()>>>>,
    woken: Arc<Flag>,
    waker: Waker,
    polls: u64,
}

impl std::fmt::Debug for Executor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Executor")
            .field("now_us", &self.clock.now_us())
            .field("polls", &self.polls)
            .finish()
    }
}

/// Polls at one instant after which a future that keeps waking itself is taken for hung.
const MAX_POLLS_PER_INSTANT: u32 = 10_000;

impl Executor {
    /// An executor without tasks at virtual time 0.
    #[must_use]
    pub fn new() -> Self {
        let woken = Arc::new(Flag::default());
        Self {
            clock: VirtualClock::default(),
            tasks: None,
            waker: Waker::from(woken.clone()),
            woken,
            polls: 0,
        }
    }

    /// The clock of this executor.
    #[must_use]
    pub fn clock(&self) -> VirtualClock {
        self.clock.clone()
    }

    /// Replaces the tasks. The old ones are dropped where they stood, as in a reset.
    pub fn spawn(&mut self, tasks: impl Future<Output = ()> + 'static) {
        self.tasks = Some(Box::pin(tasks));
    }

    /// Drops the tasks: the processor is off.
    pub fn halt(&mut self) {
        self.tasks = None;
    }

    /// Polls since the beginning.
    #[must_use]
    pub fn polls(&self) -> u64 {
        self.polls
    }

    /// Runs until virtual time `until_us`, or until `stop` says so after a poll. Time never passes `until_us`.
    ///
    /// # Panics
    /// When the tasks keep waking themselves at one instant.
    pub fn run_until(&mut self, until_us: u64, mut stop: impl FnMut() -> bool) {
        loop {
            self.settle();
            if stop() {
                return;
            }
            let next = self.clock.0.next_us.get();
            if next > until_us || self.tasks.is_none() {
                let now = self.clock.0.now_us.get();
                self.clock.0.now_us.set(now.max(until_us));
                return;
            }
            self.clock.0.now_us.set(next);
        }
    }

    /// Polls until nobody asks to go on at the present instant.
    fn settle(&mut self) {
        for _ in 0..MAX_POLLS_PER_INSTANT {
            let Some(tasks) = self.tasks.as_mut() else {
                return;
            };
            self.clock.0.next_us.set(u64::MAX);
            self.woken.0.store(false, Ordering::Relaxed);
            self.polls += 1;
            if tasks
                .as_mut()
                .poll(&mut Context::from_waker(&self.waker))
                .is_ready()
            {
                self.tasks = None;
                return;
            }
            let again = self.woken.0.load(Ordering::Relaxed)
                || self.clock.0.next_us.get() <= self.clock.now_us();
            if !again {
                return;
            }
        }
        panic!(
            "the tasks keep waking themselves at {} us",
            self.clock.now_us()
        );
    }
}

impl Default for Executor {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    #[test]
    fn time_jumps_to_the_next_wake_up_and_order_is_kept() {
        let mut executor = Executor::new();
        let clock = executor.clock();
        let log = Rc::new(RefCell::new(Vec::new()));
        let sink = log.clone();
        executor.spawn(async move {
            let ticker = async |name: &'static str, period_us: u64| {
                for k in 1..=3 {
                    clock.sleep_until_us(k * period_us).await;
                    sink.borrow_mut().push((clock.now_us(), name));
                }
            };
            let (mut a, mut b) = (
                std::pin::pin!(ticker("a", 10)),
                std::pin::pin!(ticker("b", 15)),
            );
            let (mut a_done, mut b_done) = (false, false);
            poll_fn(|context| {
                a_done = a_done || a.as_mut().poll(context).is_ready();
                b_done = b_done || b.as_mut().poll(context).is_ready();
                if a_done && b_done {
                    Poll::Ready(())
                } else {
                    Poll::Pending
                }
            })
            .await;
        });
        executor.run_until(25, || false);
        assert_eq!(*log.borrow(), [(10, "a"), (15, "b"), (20, "a")]);
        assert_eq!(executor.clock().now_us(), 25);
        executor.run_until(1000, || false);
        assert_eq!(log.borrow().len(), 6);
        assert!(executor.polls() < 12, "no busy polling");
    }
}
