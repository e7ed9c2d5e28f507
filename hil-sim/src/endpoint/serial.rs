//! A real serial port: emulated motors for a real board, through a USB to RS485 stick.

use std::io::{ErrorKind, Read, Write};
use std::time::Duration;

use serialport::SerialPort;

use super::{Endpoint, EndpointError};

/// An open serial port.
pub struct Serial {
    port: Box<dyn SerialPort>,
    path: String,
}

impl Serial {
    /// Opens `path` at `baud`, 8N1.
    ///
    /// # Errors
    /// The port is not there, is taken, or refuses the speed.
    pub fn open(path: &str, baud: u32) -> Result<Self, EndpointError> {
        let port = serialport::new(path, baud)
            .timeout(Duration::from_millis(1))
            .open()
            .map_err(|source| EndpointError::Serial {
                path: path.to_owned(),
                baud,
                source,
            })?;
        Ok(Self {
            port,
            path: path.to_owned(),
        })
    }

    fn broken(&self, source: std::io::Error) -> EndpointError {
        EndpointError::Broken {
            address: self.path.clone(),
            source,
        }
    }
}

impl Endpoint for Serial {
    fn address(&self) -> String {
        self.path.clone()
    }

    fn read(&mut self, into: &mut [u8], patience: Duration) -> Result<usize, EndpointError> {
        self.port
            .set_timeout(patience)
            .map_err(|error| self.broken(error.into()))?;
        match self.port.read(into) {
            Ok(count) => Ok(count),
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => {
                Ok(0)
            }
            Err(error) => Err(self.broken(error)),
        }
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), EndpointError> {
        self.port
            .write_all(bytes)
            .map_err(|error| self.broken(error))
    }
}
