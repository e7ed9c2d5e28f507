//! The ports of the application over embassy's buffered UARTs, with the receive errors that these swallow.
//!
//! embassy's interrupt handler logs framing, noise and overrun errors, stores the damaged byte as data and drops bytes without a sign when its ring is
//! full. So [`ErrorHook`] runs before it in the same interrupt, reads the flags before they are cleared, and counts what goes into the ring.

use core::marker::PhantomData;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use embassy_stm32::interrupt::typelevel::{Handler, Interrupt};
use embassy_stm32::pac::usart::Usart;
use embassy_stm32::usart::{BufferedUartRx, BufferedUartTx, Error};
use embedded_io::ReadReady;
use embedded_io_async::{BufRead, Read, Write};
use firmware::ports::{BusPort, LinkRx, LinkTx, PortError};

/// What the interrupt of one UART has seen.
pub(crate) struct Watch {
    registers: Usart,
    /// Bytes that its receive ring holds.
    ring: u32,
    received: AtomicU32,
    taken: AtomicU32,
    noise: AtomicBool,
    overrun: AtomicBool,
}

impl Watch {
    pub(crate) const fn new(registers: Usart, ring: usize) -> Self {
        Self {
            registers,
            ring: ring as u32,
            received: AtomicU32::new(0),
            taken: AtomicU32::new(0),
            noise: AtomicBool::new(false),
            overrun: AtomicBool::new(false),
        }
    }

    /// In the interrupt, before embassy's handler clears the flags.
    fn look(&self) {
        let flags = self.registers.isr().read();
        if flags.fe() || flags.ne() || flags.pe() {
            self.noise.store(true, Ordering::Relaxed);
        }
        if flags.ore() {
            self.overrun.store(true, Ordering::Relaxed);
        }
        if flags.rxne() {
            let received = self.received.load(Ordering::Relaxed);
            let waiting = received.wrapping_sub(self.taken.load(Ordering::Relaxed));
            if waiting >= self.ring {
                // The ring is full: this byte goes nowhere.
                self.overrun.store(true, Ordering::Relaxed);
            } else {
                self.received
                    .store(received.wrapping_add(1), Ordering::Relaxed);
            }
        }
    }

    fn took(&self, bytes: usize) {
        // Only the task that reads this port writes here.
        let taken = self.taken.load(Ordering::Relaxed);
        self.taken
            .store(taken.wrapping_add(bytes as u32), Ordering::Relaxed);
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
}

/// Where the watch of an interrupt stands.
pub(crate) trait Watched: Interrupt {
    /// It.
    fn watch() -> &'static Watch;
}

/// The interrupt handler that looks before embassy's.
pub(crate) struct ErrorHook<T>(PhantomData<T>);

impl<T: Watched> Handler<T> for ErrorHook<T> {
    unsafe fn on_interrupt() {
        T::watch().look();
    }
}

fn port_error(error: Error) -> PortError {
    match error {
        Error::Overrun | Error::BufferTooLong => PortError::Overrun,
        _ => PortError::Noise,
    }
}

/// Waits for bytes; an error comes before the bytes that waited with it, which the next call returns.
async fn receive(
    rx: &mut BufferedUartRx<'static>,
    watch: &Watch,
    into: &mut [u8],
) -> Result<usize, PortError> {
    rx.fill_buf().await.map_err(port_error)?;
    if let Some(error) = watch.error() {
        return Err(error);
    }
    // Returns at once: there is something to read.
    let count = Read::read(rx, into).await.map_err(port_error)?;
    watch.took(count);
    Ok(count)
}

/// Hands `bytes` to the transmit ring, which holds `ring` bytes.
///
/// embassy's `write` forgets to register its waker when the ring has too little room, and would sleep for ever. So a
/// write waits until the ring is empty and never brings more than fits.
async fn send(
    tx: &mut BufferedUartTx<'static>,
    ring: usize,
    bytes: &[u8],
) -> Result<usize, PortError> {
    let part = bytes.get(..ring).unwrap_or(bytes);
    tx.flush().await.map_err(port_error)?;
    tx.write(part).await.map_err(port_error)
}

/// Bytes thrown away at a time.
const DRAIN: usize = 64;

/// The motor bus.
pub(crate) struct UartBus<const RING: usize> {
    pub(crate) tx: BufferedUartTx<'static>,
    pub(crate) rx: BufferedUartRx<'static>,
    pub(crate) watch: &'static Watch,
}

impl<const RING: usize> BusPort for UartBus<RING> {
    async fn write_all(&mut self, mut bytes: &[u8]) -> Result<(), PortError> {
        while !bytes.is_empty() {
            let sent = send(&mut self.tx, RING, bytes).await?;
            bytes = bytes.get(sent..).unwrap_or(&[]);
        }
        Ok(())
    }

    async fn read(&mut self, into: &mut [u8]) -> Result<usize, PortError> {
        receive(&mut self.rx, self.watch, into).await
    }

    fn discard_input(&mut self) {
        let mut drain = [0; DRAIN];
        // A ring full and one more: a line that babbles faster than this loop would keep it here for ever.
        for _ in 0..=self.watch.ring as usize / DRAIN {
            if !self.rx.read_ready().unwrap_or(false) {
                break;
            }
            // Returns at once: there is something to read.
            if let Ok(count) = embedded_io::Read::read(&mut self.rx, &mut drain) {
                self.watch.took(count);
            }
        }
        // Errors of what was thrown away went with it.
        let _ = (self.watch.error(), self.watch.error());
    }
}

/// Receiving half of a host link.
pub(crate) struct UartLinkRx(
    pub(crate) BufferedUartRx<'static>,
    pub(crate) &'static Watch,
);

impl LinkRx for UartLinkRx {
    async fn read(&mut self, into: &mut [u8]) -> Result<usize, PortError> {
        receive(&mut self.0, self.1, into).await
    }
}

/// Sending half of a host link.
pub(crate) struct UartLinkTx<const RING: usize>(pub(crate) BufferedUartTx<'static>);

impl<const RING: usize> LinkTx for UartLinkTx<RING> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, PortError> {
        send(&mut self.0, RING, bytes).await
    }
}
