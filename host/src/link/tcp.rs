//! TCP: serial servers, Wi-Fi bridges, and `rb-host emulate robot --tcp`.

use std::io::{self, Write};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use super::stream::ByteStream;
use super::{Link, LinkError, PortUri};

/// Longest wait for a connection.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// A write that takes longer than this has nobody at the other end.
const WRITE_TIMEOUT: Duration = Duration::from_millis(1000);
/// The reader thread looks for its stop flag this often.
const READ_TIMEOUT: Duration = Duration::from_millis(50);

/// A TCP connection.
#[derive(Debug)]
pub struct TcpLink {
    uri: PortUri,
    address: String,
    open: Option<(TcpStream, ByteStream)>,
    started: Instant,
}

impl TcpLink {
    /// Connects.
    ///
    /// # Errors
    /// [`LinkError::Open`]
    pub fn open(address: &str) -> Result<Self, LinkError> {
        let uri = PortUri::Tcp(address.to_owned());
        let mut link = Self {
            uri,
            address: address.to_owned(),
            open: None,
            started: Instant::now(),
        };
        link.reconnect()?;
        Ok(link)
    }

    fn connect(&self) -> io::Result<(TcpStream, ByteStream)> {
        let mut last = io::Error::new(io::ErrorKind::NotFound, "the name has no address");
        for address in self.address.to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, CONNECT_TIMEOUT) {
                Ok(stream) => {
                    stream.set_nodelay(true)?;
                    stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
                    stream.set_read_timeout(Some(READ_TIMEOUT))?;
                    let reader = stream.try_clone()?;
                    return Ok((stream, ByteStream::start(reader)));
                }
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    fn closed(&self, source: io::Error) -> LinkError {
        LinkError::Closed {
            port: self.uri.to_string(),
            source,
        }
    }
}

impl Link for TcpLink {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let Some((stream, _)) = &mut self.open else {
            return Err(self.closed(io::ErrorKind::NotConnected.into()));
        };
        stream.write_all(bytes).map_err(|e| self.closed(e))
    }

    fn receive(&mut self, wait: Duration, into: &mut Vec<u8>) -> Result<(), LinkError> {
        let Some((_, stream)) = &mut self.open else {
            return Err(self.closed(io::ErrorKind::NotConnected.into()));
        };
        stream.receive(wait, into).map_err(|e| self.closed(e))
    }

    fn now(&self) -> Duration {
        self.started.elapsed()
    }

    fn reconnect(&mut self) -> Result<(), LinkError> {
        if let Some((stream, mut reader)) = self.open.take() {
            let _ = stream.shutdown(Shutdown::Both);
            reader.stop();
        }
        let opened = self.connect().map_err(|source| LinkError::Open {
            port: self.uri.to_string(),
            source,
        })?;
        self.open = Some(opened);
        Ok(())
    }

    fn uri(&self) -> &PortUri {
        &self.uri
    }
}
