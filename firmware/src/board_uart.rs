//! The ports of the application over embassy's buffered UARTs.

use embassy_stm32::usart::{BufferedUartRx, BufferedUartTx, Error};
use embedded_io::ReadReady;
use embedded_io_async::{Read, Write};
use firmware::ports::{BusPort, LinkRx, LinkTx, PortError};

fn port_error(error: Error) -> PortError {
    match error {
        Error::Overrun | Error::BufferTooLong => PortError::Overrun,
        _ => PortError::Noise,
    }
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

/// The motor bus.
pub(crate) struct UartBus<const RING: usize> {
    pub(crate) tx: BufferedUartTx<'static>,
    pub(crate) rx: BufferedUartRx<'static>,
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
        Read::read(&mut self.rx, into).await.map_err(port_error)
    }

    fn discard_input(&mut self) {
        let mut drain = [0; 64];
        while self.rx.read_ready().unwrap_or(false) {
            // Returns at once: there is something to read.
            let _ = embedded_io::Read::read(&mut self.rx, &mut drain);
        }
    }
}

/// Receiving half of a host link.
pub(crate) struct UartLinkRx(pub(crate) BufferedUartRx<'static>);

impl LinkRx for UartLinkRx {
    async fn read(&mut self, into: &mut [u8]) -> Result<usize, PortError> {
        Read::read(&mut self.0, into).await.map_err(port_error)
    }
}

/// Sending half of a host link.
pub(crate) struct UartLinkTx<const RING: usize>(pub(crate) BufferedUartTx<'static>);

impl<const RING: usize> LinkTx for UartLinkTx<RING> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, PortError> {
        send(&mut self.0, RING, bytes).await
    }
}
