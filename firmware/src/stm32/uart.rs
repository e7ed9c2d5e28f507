//! The ports of the application over UARTs, one interrupt a byte and no more work in it than that byte asks for.
//!
//! embassy-stm32 sets pins, clock and baud rate. Its buffered driver is not used: its interrupt takes 80 instructions a byte, logs framing, noise and
//! overrun errors, stores the damaged byte as data, and drops bytes without a sign when its ring is full.

use core::cell::Cell;
use core::future::poll_fn;
use core::marker::PhantomData;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicUsize, Ordering, compiler_fence};
use core::task::{Context, Poll, Waker};

use critical_section::Mutex;
use embassy_stm32::interrupt::typelevel::{Handler, Interrupt};
use embassy_stm32::mode::Blocking;
use embassy_stm32::pac::usart::Usart;
use embassy_stm32::pac::usart::regs::Icr;
use embassy_stm32::usart::Uart;
use firmware::ports::{BusPort, LinkRx, LinkTx, PortError};

// Bits of ISR; those of the first four and of IDLE are cleared in ICR at the same places (RM0351 sections 40.8.8 and 40.8.9, RM0440 the same).
const PE: u32 = 1 << 0;
const FE: u32 = 1 << 1;
const NE: u32 = 1 << 2;
const ORE: u32 = 1 << 3;
const IDLE: u32 = 1 << 4;
const RXNE: u32 = 1 << 5;
const TXE: u32 = 1 << 7;
const DAMAGED: u32 = PE | FE | NE;

/// Bytes between an interrupt and a task; one of them puts, the other takes. `N` is a power of two. Both run on one core, so the compiler alone
/// must keep the order of accesses.
struct Ring<const N: usize> {
    bytes: [AtomicU8; N],
    /// Bytes put so far, and taken: both wrap.
    put: AtomicUsize,
    taken: AtomicUsize,
}

impl<const N: usize> Ring<N> {
    const MASK: usize = {
        assert!(N.is_power_of_two());
        N - 1
    };

    const fn new() -> Self {
        Self {
            bytes: [const { AtomicU8::new(0) }; N],
            put: AtomicUsize::new(0),
            taken: AtomicUsize::new(0),
        }
    }

    fn waiting(&self) -> usize {
        let taken = self.taken.load(Ordering::Relaxed);
        let waiting = self.put.load(Ordering::Relaxed).wrapping_sub(taken);
        compiler_fence(Ordering::Acquire);
        waiting
    }

    /// The places of `count` bytes, at most `N`, from the one with this number on: up to the end of the array, and from its begin.
    fn places(&self, from: usize, count: usize) -> impl Iterator<Item = &AtomicU8> {
        let start = from & Self::MASK;
        let first = self.bytes.get(start..).unwrap_or(&[]);
        let first = first.get(..count).unwrap_or(first);
        let second = self.bytes.get(..count - first.len()).unwrap_or(&[]);
        first.iter().chain(second)
    }

    /// Puts as many as fit; returns how many.
    fn put(&self, bytes: &[u8]) -> usize {
        let count = bytes.len().min(N.saturating_sub(self.waiting()));
        let put = self.put.load(Ordering::Relaxed);
        let mut bytes = bytes.iter();
        // `for_each` runs the two parts one after the other.
        self.places(put, count).for_each(|place| {
            place.store(bytes.next().copied().unwrap_or(0), Ordering::Relaxed);
        });
        compiler_fence(Ordering::Release);
        self.put.store(put.wrapping_add(count), Ordering::Relaxed);
        count
    }

    /// Returns how many wait then; `None` when there is no room.
    fn push(&self, byte: u8) -> Option<usize> {
        let put = self.put.load(Ordering::Relaxed);
        let waiting = put.wrapping_sub(self.taken.load(Ordering::Relaxed));
        if waiting >= N {
            return None;
        }
        self.bytes
            .get(put & Self::MASK)?
            .store(byte, Ordering::Relaxed);
        compiler_fence(Ordering::Release);
        self.put.store(put.wrapping_add(1), Ordering::Relaxed);
        Some(waiting + 1)
    }

    fn pop(&self) -> Option<u8> {
        let taken = self.taken.load(Ordering::Relaxed);
        if taken == self.put.load(Ordering::Relaxed) {
            return None;
        }
        compiler_fence(Ordering::Acquire);
        let byte = self.bytes.get(taken & Self::MASK)?.load(Ordering::Relaxed);
        compiler_fence(Ordering::Release);
        self.taken.store(taken.wrapping_add(1), Ordering::Relaxed);
        Some(byte)
    }

    /// Takes as many as fit; returns how many.
    fn take(&self, into: &mut [u8]) -> usize {
        let count = self.waiting().min(into.len());
        let taken = self.taken.load(Ordering::Relaxed);
        let mut into = into.iter_mut();
        self.places(taken, count).for_each(|byte| {
            if let Some(place) = into.next() {
                *place = byte.load(Ordering::Relaxed);
            }
        });
        compiler_fence(Ordering::Release);
        self.taken
            .store(taken.wrapping_add(count), Ordering::Relaxed);
        count
    }

    fn clear(&self) {
        self.taken
            .store(self.put.load(Ordering::Relaxed), Ordering::Relaxed);
    }
}

/// A task that waits for an interrupt.
struct Waiter(Mutex<Cell<Option<Waker>>>);

impl Waiter {
    const fn new() -> Self {
        Self(Mutex::new(Cell::new(None)))
    }

    fn wait(&self, context: &Context<'_>) {
        critical_section::with(|cs| self.0.borrow(cs).set(Some(context.waker().clone())));
    }

    fn wake(&self) {
        if let Some(waker) = critical_section::with(|cs| self.0.borrow(cs).take()) {
            waker.wake();
        }
    }
}

/// A UART with what waits to go and what has come, as its interrupt and its tasks share it.
pub(crate) struct Port<const TX: usize, const RX: usize> {
    registers: Usart,
    going: Ring<TX>,
    come: Ring<RX>,
    noise: AtomicBool,
    overrun: AtomicBool,
    sender: Waiter,
    receiver: Waiter,
}

impl<const TX: usize, const RX: usize> Port<TX, RX> {
    pub(crate) const fn new(registers: Usart) -> Self {
        Self {
            registers,
            going: Ring::new(),
            come: Ring::new(),
            noise: AtomicBool::new(false),
            overrun: AtomicBool::new(false),
            sender: Waiter::new(),
            receiver: Waiter::new(),
        }
    }

    /// Begins to receive. The UART stays on for ever.
    pub(crate) fn open(&'static self, uart: Uart<'static, Blocking>) {
        core::mem::forget(uart);
        critical_section::with(|_| {
            self.registers.cr1().modify(|w| {
                w.set_rxneie(true);
                w.set_idleie(true);
            });
        });
    }

    /// One byte each way: while there is more the interrupt stays pending. What does not happen at every byte stands apart, so that this stays short.
    #[inline(always)]
    pub(crate) fn on_interrupt(&self) {
        let flags = self.registers.isr().read().0;
        if flags & RXNE != 0 {
            let byte = self.registers.rdr().read().0 as u8;
            if self.come.push(byte).is_none_or(|waiting| waiting >= RX / 2) {
                self.is_filling();
            }
        }
        if flags & (IDLE | ORE | DAMAGED) != 0 {
            self.is_over(flags & (IDLE | ORE | DAMAGED));
        }
        // Without bytes to send TXE stands all the time, and TXEIE is off.
        if flags & TXE != 0 && self.registers.cr1().read().txeie() {
            match self.going.pop() {
                Some(byte) => self.registers.tdr().write(|w| w.0 = u32::from(byte)),
                None => self.is_sent(),
            }
        }
    }

    /// A task is worth waking in time before the ring is full; if it is, the byte has gone nowhere.
    #[inline(never)]
    fn is_filling(&self) {
        if self.come.waiting() >= RX {
            self.overrun.store(true, Ordering::Relaxed);
        }
        self.receiver.wake();
    }

    /// The end of a burst, or a fault in it.
    #[inline(never)]
    fn is_over(&self, events: u32) {
        self.registers.icr().write_value(Icr(events));
        if events & DAMAGED != 0 {
            self.noise.store(true, Ordering::Relaxed);
        }
        if events & ORE != 0 {
            self.overrun.store(true, Ordering::Relaxed);
        }
        if events & IDLE != 0 {
            self.receiver.wake();
        }
    }

    #[inline(never)]
    fn is_sent(&self) {
        self.registers.cr1().modify(|w| w.set_txeie(false));
        self.sender.wake();
    }

    /// An error since the last call.
    fn error(&self) -> Option<PortError> {
        if self.overrun.swap(false, Ordering::Relaxed) {
            Some(PortError::Overrun)
        } else if self.noise.swap(false, Ordering::Relaxed) {
            Some(PortError::Noise)
        } else {
            None
        }
    }

    /// Waits for bytes; an error comes before the bytes that waited with it, which the next call returns.
    async fn read(&self, into: &mut [u8]) -> Result<usize, PortError> {
        poll_fn(|context| {
            if self.come.waiting() == 0 {
                self.receiver.wait(context);
                // Asked again, so that a byte that came between the two is not slept through.
                if self.come.waiting() == 0 {
                    return Poll::Pending;
                }
            }
            Poll::Ready(match self.error() {
                Some(error) => Err(error),
                None => Ok(self.come.take(into)),
            })
        })
        .await
    }

    /// Waits until nothing waits to go, then takes as many bytes as fit; returns how many.
    async fn write(&self, bytes: &[u8]) -> usize {
        let count = poll_fn(|context| {
            if self.going.waiting() > 0 {
                self.sender.wait(context);
                if self.going.waiting() > 0 {
                    return Poll::Pending;
                }
            }
            Poll::Ready(self.going.put(bytes))
        })
        .await;
        // The interrupt changes this register too.
        critical_section::with(|_| self.registers.cr1().modify(|w| w.set_txeie(true)));
        count
    }
}

/// Where the port of an interrupt stands.
pub(crate) trait Served: Interrupt {
    /// Serves it.
    fn on_interrupt();
}

/// The interrupt handler of a port.
pub(crate) struct Service<T>(PhantomData<T>);

impl<T: Served> Handler<T> for Service<T> {
    unsafe fn on_interrupt() {
        T::on_interrupt();
    }
}

/// The motor bus.
pub(crate) struct UartBus<const TX: usize, const RX: usize>(pub(crate) &'static Port<TX, RX>);

impl<const TX: usize, const RX: usize> BusPort for UartBus<TX, RX> {
    async fn write_all(&mut self, mut bytes: &[u8]) -> Result<(), PortError> {
        while !bytes.is_empty() {
            let sent = self.0.write(bytes).await;
            bytes = bytes.get(sent..).unwrap_or(&[]);
        }
        Ok(())
    }

    async fn read(&mut self, into: &mut [u8]) -> Result<usize, PortError> {
        self.0.read(into).await
    }

    fn discard_input(&mut self) {
        self.0.come.clear();
        // Errors of what was thrown away went with it.
        let _ = (self.0.error(), self.0.error());
    }
}

/// Receiving half of a host link.
pub(crate) struct UartLinkRx<const TX: usize, const RX: usize>(pub(crate) &'static Port<TX, RX>);

impl<const TX: usize, const RX: usize> LinkRx for UartLinkRx<TX, RX> {
    async fn read(&mut self, into: &mut [u8]) -> Result<usize, PortError> {
        self.0.read(into).await
    }
}

/// Sending half of a host link.
pub(crate) struct UartLinkTx<const TX: usize, const RX: usize>(pub(crate) &'static Port<TX, RX>);

impl<const TX: usize, const RX: usize> LinkTx for UartLinkTx<TX, RX> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, PortError> {
        Ok(self.0.write(bytes).await)
    }
}
