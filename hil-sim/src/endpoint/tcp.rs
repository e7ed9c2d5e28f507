//! A TCP listener: one client at a time.

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::Duration;

use super::{Endpoint, EndpointError};

/// A listening socket and its client, if one is there.
#[derive(Debug)]
pub struct Tcp {
    listener: TcpListener,
    local: SocketAddr,
    client: Option<TcpStream>,
    clients: u64,
}

impl Tcp {
    /// Listens on `address` (`127.0.0.1:0` = any free port).
    ///
    /// # Errors
    /// The address cannot be bound.
    pub fn listen(address: &str) -> Result<Self, EndpointError> {
        let failed = |source| EndpointError::Listen {
            address: address.to_owned(),
            source,
        };
        let listener = TcpListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let local = listener.local_addr().map_err(failed)?;
        Ok(Self {
            listener,
            local,
            client: None,
            clients: 0,
        })
    }

    /// Bound address.
    #[must_use]
    pub fn local(&self) -> SocketAddr {
        self.local
    }

    fn broken(&self, source: std::io::Error) -> EndpointError {
        EndpointError::Broken {
            address: self.address(),
            source,
        }
    }

    /// Takes a waiting client, if any.
    fn accept(&mut self) -> Result<bool, EndpointError> {
        match self.listener.accept() {
            Ok((stream, _)) => {
                stream
                    .set_nonblocking(false)
                    .map_err(|error| self.broken(error))?;
                stream
                    .set_nodelay(true)
                    .map_err(|error| self.broken(error))?;
                self.client = Some(stream);
                self.clients += 1;
                Ok(true)
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(false),
            Err(error) => Err(self.broken(error)),
        }
    }
}

/// Shortest socket time-out: 0 would mean for ever.
const SHORTEST: Duration = Duration::from_micros(1);

impl Endpoint for Tcp {
    fn address(&self) -> String {
        format!("tcp://{}", self.local)
    }

    fn read(&mut self, into: &mut [u8], patience: Duration) -> Result<usize, EndpointError> {
        if self.client.is_none() && !self.accept()? {
            std::thread::sleep(patience);
            return Ok(0);
        }
        let Some(client) = &mut self.client else {
            return Ok(0);
        };
        let waited = client.set_read_timeout(Some(patience.max(SHORTEST)));
        match waited.and_then(|()| client.read(into)) {
            // The client left; the next one may come.
            Ok(0) => self.client = None,
            Ok(count) => return Ok(count),
            Err(error) => match error.kind() {
                ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted => {}
                _ => self.client = None,
            },
        }
        Ok(0)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), EndpointError> {
        if let Some(client) = &mut self.client
            && client.write_all(bytes).is_err()
        {
            self.client = None;
        }
        Ok(())
    }

    fn clients(&self) -> u64 {
        self.clients
    }
}
