//! What the tasks share: state that one task at a time borrows, and a wake-up between tasks.
//!
//! All tasks run on one thread and never hold a borrow across an await, so a borrow cannot fail; if it ever did, the
//! caller gets the default value and the refusal is counted, instead of a panic.

use core::cell::{Cell, RefCell};
use core::future::poll_fn;
use core::task::{Poll, Waker};

/// State shared by tasks of one thread.
#[derive(Debug)]
pub struct Shared<T> {
    inner: RefCell<T>,
    refused: Cell<u32>,
}

impl<T> Shared<T> {
    /// Wraps the state.
    pub const fn new(inner: T) -> Self {
        Self {
            inner: RefCell::new(inner),
            refused: Cell::new(0),
        }
    }

    /// Runs `work` on the state. `work` cannot await, so nobody else sees the state half changed.
    pub fn with<R: Default>(&self, work: impl FnOnce(&mut T) -> R) -> R {
        match self.inner.try_borrow_mut() {
            Ok(mut inner) => work(&mut inner),
            Err(_) => {
                self.refused.set(self.refused.get().saturating_add(1));
                R::default()
            }
        }
    }

    /// Borrows that failed: 0 unless a task broke the rule above.
    pub fn refused(&self) -> u32 {
        self.refused.get()
    }
}

/// Wakes one waiting task. A notification with nobody waiting is kept.
#[derive(Default)]
pub struct Notify {
    set: Cell<bool>,
    waiter: Cell<Option<Waker>>,
}

impl Notify {
    /// Not notified, nobody waiting.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            set: Cell::new(false),
            waiter: Cell::new(None),
        }
    }

    /// Wakes the waiter, now or when it comes.
    pub fn notify(&self) {
        self.set.set(true);
        if let Some(waker) = self.waiter.take() {
            waker.wake();
        }
    }

    /// Waits for a notification and takes it. Cancel-safe.
    pub async fn wait(&self) {
        poll_fn(|context| {
            if self.set.replace(false) {
                return Poll::Ready(());
            }
            self.waiter.set(Some(context.waker().clone()));
            Poll::Pending
        })
        .await;
    }
}
