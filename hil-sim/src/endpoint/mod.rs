//! Where a foreign byte stream comes in: pseudo-terminal, TCP, real serial port, or a channel inside this process.
//!
//! Together with [`crate::pace`] the only code here that touches the operating system.

mod channel;
#[cfg(unix)]
mod pty;
mod serial;
mod tcp;

use std::io;
use std::path::PathBuf;
use std::time::Duration;

use thiserror::Error;

pub use channel::{Channel, channel};
#[cfg(unix)]
pub use pty::Pty;
pub use serial::Serial;
pub use tcp::Tcp;

/// A byte stream of the emulation's side.
pub trait Endpoint: Send {
    /// What a person types to connect: a device path, `tcp://address`, or a name.
    fn address(&self) -> String;

    /// Waits up to `patience` for bytes; 0 = none came.
    ///
    /// # Errors
    /// The stream is gone for good. A client that leaves is no error: the next one may come.
    fn read(&mut self, into: &mut [u8], patience: Duration) -> Result<usize, EndpointError>;

    /// Sends all bytes. Without a client they are dropped, as on a wire without a listener.
    ///
    /// # Errors
    /// The stream is gone for good.
    fn write(&mut self, bytes: &[u8]) -> Result<(), EndpointError>;

    /// Clients that came while another one is there: `answer` gets what one of them sends, and gives what it hears. A stream of one wire has none.
    ///
    /// # Errors
    /// The stream is gone for good.
    fn others(&mut self, _answer: &mut dyn FnMut(&[u8]) -> Vec<u8>) -> Result<(), EndpointError> {
        Ok(())
    }

    /// Whether a client is there, where the stream can tell.
    fn connected(&self) -> bool {
        true
    }

    /// Bits per second that the client has set, where the stream can tell.
    fn baud(&self) -> Option<u32> {
        None
    }

    /// Clients that have connected since the start, where the stream can tell.
    fn clients(&self) -> u64 {
        0
    }
}

/// Why an endpoint does not work.
#[derive(Debug, Error)]
pub enum EndpointError {
    /// No pseudo-terminal to be had.
    #[error("no pseudo-terminal: {source}; is /dev/pts mounted?")]
    Pty {
        /// Cause.
        source: serialport::Error,
    },
    /// This system has no pseudo-terminals.
    #[error("pseudo-terminals exist on Unix only; give --tcp ADDRESS or --serial PORT")]
    NoPty,
    /// The link to the pseudo-terminal could not be made.
    #[error("cannot link {path} to {target}: {source}; name another path, or remove what is there")]
    Link {
        /// Link wanted.
        path: PathBuf,
        /// Pseudo-terminal.
        target: String,
        /// Cause.
        source: io::Error,
    },
    /// The serial port could not be opened.
    #[error(
        "cannot open serial port {path} at {baud} baud: {source}; check the cable, the path and who else has it open"
    )]
    Serial {
        /// Port.
        path: String,
        /// Speed.
        baud: u32,
        /// Cause.
        source: serialport::Error,
    },
    /// The TCP address could not be bound.
    #[error("cannot listen on {address}: {source}; choose another port (0 = any free one)")]
    Listen {
        /// Address wanted.
        address: String,
        /// Cause.
        source: io::Error,
    },
    /// The stream broke.
    #[error("{address}: {source}")]
    Broken {
        /// Endpoint.
        address: String,
        /// Cause.
        source: io::Error,
    },
    /// The other end of a channel is gone.
    #[error("the client inside this process is gone")]
    Gone,
}
