//! A TCP listener: one client at a time. Others are answered that it is there.

use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

use super::{Endpoint, EndpointError};

/// A listening socket and its client, if one is there.
#[derive(Debug)]
pub struct Tcp {
    listener: TcpListener,
    local: SocketAddr,
    client: Option<Client>,
    /// Who came while it was there.
    others: Vec<Client>,
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
            others: Vec::new(),
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

    /// A client that waits, if any.
    fn accept(&mut self) -> Result<Option<Client>, EndpointError> {
        match self.listener.accept() {
            Ok((stream, _)) => Ok(Some(
                Client::new(stream).map_err(|error| self.broken(error))?,
            )),
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(None),
            Err(error) => Err(self.broken(error)),
        }
    }

    /// Takes a client, if one is there.
    fn take_client(&mut self) -> Result<bool, EndpointError> {
        self.client = match self.others.pop() {
            Some(waiting) => Some(waiting),
            None => self.accept()?,
        };
        self.clients += u64::from(self.client.is_some());
        Ok(self.client.is_some())
    }
}

/// Parts of a client's bytes that wait to be taken, at most; the socket holds the rest back.
const WAITING: usize = 16;
/// Clients that are told that another one is there; more wait without a word.
const OTHERS: usize = 4;
/// Bytes read at once.
const PART: usize = 4096;
/// A client that takes nothing for this long has hung: it is dropped, or it would hold the emulation up.
const WRITE_PATIENCE: Duration = Duration::from_secs(1);

/// A client. A thread of its own waits for its bytes: a socket's own time-out is good to 4 ms only, longer than a whole exchange on the bus.
#[derive(Debug)]
struct Client {
    stream: TcpStream,
    input: Receiver<Vec<u8>>,
    left: VecDeque<u8>,
}

impl Client {
    fn new(stream: TcpStream) -> std::io::Result<Self> {
        stream.set_nonblocking(false)?;
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(WRITE_PATIENCE))?;
        let mut reader = stream.try_clone()?;
        let (send, input) = sync_channel(WAITING);
        std::thread::spawn(move || {
            let mut part = [0; PART];
            loop {
                match reader.read(&mut part) {
                    Ok(0) => break,
                    Ok(count) if send.send(part[..count].to_vec()).is_err() => break,
                    Ok(_) => {}
                    Err(error) if error.kind() == ErrorKind::Interrupted => {}
                    Err(_) => break,
                }
            }
        });
        Ok(Self {
            stream,
            input,
            left: VecDeque::new(),
        })
    }

    /// `None`: the client left.
    fn read(&mut self, into: &mut [u8], patience: Duration) -> Option<usize> {
        if self.left.is_empty() {
            match self.input.recv_timeout(patience) {
                Ok(bytes) => self.left.extend(bytes),
                Err(RecvTimeoutError::Timeout) => return Some(0),
                Err(RecvTimeoutError::Disconnected) => return None,
            }
        }
        let count = self.left.len().min(into.len());
        for (to, from) in into.iter_mut().zip(self.left.drain(..count)) {
            *to = from;
        }
        Some(count)
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        // Ends the thread that reads; a socket that is closed already needs no word.
        let _ = self.stream.shutdown(Shutdown::Both);
    }
}

impl Endpoint for Tcp {
    fn address(&self) -> String {
        format!("tcp://{}", self.local)
    }

    fn read(&mut self, into: &mut [u8], patience: Duration) -> Result<usize, EndpointError> {
        if self.client.is_none() && !self.take_client()? {
            std::thread::sleep(patience);
            return Ok(0);
        }
        let count = self
            .client
            .as_mut()
            .and_then(|client| client.read(into, patience));
        if count.is_none() {
            // The client left; the next one may come.
            self.client = None;
        }
        Ok(count.unwrap_or(0))
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), EndpointError> {
        if let Some(client) = &mut self.client
            && client.stream.write_all(bytes).is_err()
        {
            self.client = None;
        }
        Ok(())
    }

    fn others(&mut self, answer: &mut dyn FnMut(&[u8]) -> Vec<u8>) -> Result<(), EndpointError> {
        if self.client.is_none() {
            return Ok(());
        }
        if self.others.len() < OTHERS {
            let other = self.accept()?;
            self.others.extend(other);
        }
        let mut part = [0; PART];
        self.others.retain_mut(|other| {
            let Some(count) = other.read(&mut part, Duration::ZERO) else {
                return false;
            };
            count == 0 || other.stream.write_all(&answer(&part[..count])).is_ok()
        });
        Ok(())
    }

    fn connected(&self) -> bool {
        self.client.is_some()
    }

    fn clients(&self) -> u64 {
        self.clients
    }
}
