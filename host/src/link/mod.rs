//! The way to a robot: a byte link ([`Link`]: serial, TCP, or the emulated robot in process) and the conversation over it
//! ([`Robot`]: HELLO, requests with retries, orders with proof, unasked telemetry).

pub mod error;
pub mod find;
pub mod keys;
pub mod port;
pub mod robot;
pub mod serial;
pub mod sim;
mod stream;
pub mod tcp;
pub mod telemetry;
pub mod text;

use std::time::Duration;

pub use error::LinkError;
pub use port::PortUri;
pub use robot::{Robot, Stopped};
pub use sim::EmulatedLab;

/// A two-way stream of bytes with its own clock.
pub trait Link {
    /// Sends all bytes.
    ///
    /// # Errors
    /// [`LinkError::Closed`] when the other side is gone.
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError>;

    /// Appends what has arrived to `into`, waiting up to `wait` of the link's time for the first byte. Nothing is no error.
    ///
    /// # Errors
    /// [`LinkError::Closed`] when the other side is gone.
    fn receive(&mut self, wait: Duration, into: &mut Vec<u8>) -> Result<(), LinkError>;

    /// Time of the link: the host's clock, or virtual time of the emulated robot.
    fn now(&self) -> Duration;

    /// Opens the link again after it was lost, trying once.
    ///
    /// # Errors
    /// [`LinkError`]
    fn reconnect(&mut self) -> Result<(), LinkError>;

    /// Where the link goes.
    fn uri(&self) -> &PortUri;

    /// What instruments beside an emulated robot have seen since it was powered; nothing can be known of a real one here.
    fn seen(&self) -> Option<EmulatedLab> {
        None
    }
}

/// Opens a link.
///
/// # Errors
/// [`LinkError`]
pub fn open(uri: &PortUri, baud: u32) -> Result<Box<dyn Link>, LinkError> {
    Ok(match uri {
        PortUri::Serial(path) => Box::new(serial::SerialLink::open(path, baud)?),
        PortUri::Tcp(address) => Box::new(tcp::TcpLink::open(address)?),
        PortUri::Sim(scenario) => Box::new(sim::SimLink::open(scenario.as_deref())?),
    })
}
