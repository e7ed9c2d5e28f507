//! An endpoint inside this process.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel as std_channel};
use std::time::Duration;

use super::{Endpoint, EndpointError};

/// One end of a byte stream between two threads.
#[derive(Debug)]
pub struct Channel {
    send: Sender<Vec<u8>>,
    receive: Receiver<Vec<u8>>,
    left: Vec<u8>,
}

/// Two connected ends.
#[must_use]
pub fn channel() -> (Channel, Channel) {
    let (a_to_b, b_from_a) = std_channel();
    let (b_to_a, a_from_b) = std_channel();
    (
        Channel {
            send: a_to_b,
            receive: a_from_b,
            left: Vec::new(),
        },
        Channel {
            send: b_to_a,
            receive: b_from_a,
            left: Vec::new(),
        },
    )
}

impl Endpoint for Channel {
    fn address(&self) -> String {
        "in-process".to_owned()
    }

    fn read(&mut self, into: &mut [u8], patience: Duration) -> Result<usize, EndpointError> {
        if self.left.is_empty() {
            match self.receive.recv_timeout(patience) {
                Ok(bytes) => self.left = bytes,
                Err(RecvTimeoutError::Timeout) => return Ok(0),
                Err(RecvTimeoutError::Disconnected) => return Err(EndpointError::Gone),
            }
        }
        let count = self.left.len().min(into.len());
        for (to, from) in into.iter_mut().zip(self.left.drain(..count)) {
            *to = from;
        }
        Ok(count)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), EndpointError> {
        self.send
            .send(bytes.to_vec())
            .map_err(|_| EndpointError::Gone)
    }
}
