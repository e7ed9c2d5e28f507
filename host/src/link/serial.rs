//! Serial ports: USB, Bluetooth (rfcomm), pseudo terminals.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

#[cfg(windows)]
use serialport::COMPort as NativePort;
use serialport::SerialPort;
#[cfg(unix)]
use serialport::TTYPort as NativePort;

use super::stream::ByteStream;
use super::{Link, LinkError, PortUri};

/// How long an rfcomm port may take to connect: paging a module in range takes 2 to 5 s, its time-out is 5.12 s
/// (Bluetooth Core, page timeout 0x2000 slots) plus service discovery.
pub const RFCOMM_CONNECT: Duration = Duration::from_secs(8);
/// Wait between tries while an rfcomm port connects.
const RFCOMM_RETRY: Duration = Duration::from_millis(250);
/// A write that takes longer than this has nobody at the other end.
const WRITE_TIMEOUT: Duration = Duration::from_millis(1000);
/// The reader thread looks for its stop flag this often.
const READ_TIMEOUT: Duration = Duration::from_millis(50);

/// A serial port.
#[derive(Debug)]
pub struct SerialLink {
    uri: PortUri,
    path: PathBuf,
    baud: u32,
    open: Option<(NativePort, ByteStream)>,
    started: Instant,
}

impl SerialLink {
    /// Opens the port for itself alone. An rfcomm port gets [`RFCOMM_CONNECT`] to find its module.
    ///
    /// # Errors
    /// [`LinkError::Open`]
    pub fn open(path: &Path, baud: u32) -> Result<Self, LinkError> {
        let uri = PortUri::Serial(path.to_owned());
        let started = Instant::now();
        let mut link = Self {
            uri,
            path: path.to_owned(),
            baud,
            open: None,
            started,
        };
        loop {
            match link.reconnect() {
                Ok(()) => return Ok(link),
                Err(error) => {
                    let may_come = link.uri.is_rfcomm() && is_connecting(&error);
                    if !may_come || started.elapsed() > RFCOMM_CONNECT {
                        return Err(error);
                    }
                    std::thread::sleep(RFCOMM_RETRY);
                }
            }
        }
    }

    fn closed(&self, source: io::Error) -> LinkError {
        LinkError::Closed {
            port: self.uri.to_string(),
            source,
        }
    }
}

/// Errors that a Bluetooth port gives while its module is being paged: not connected, host down, busy, reset.
fn is_connecting(error: &LinkError) -> bool {
    let LinkError::Open { source, .. } = error else {
        return false;
    };
    !matches!(
        source.kind(),
        io::ErrorKind::NotFound | io::ErrorKind::PermissionDenied
    )
}

/// The port's own words, with the kind of error a hint can be chosen by.
fn open_error(error: &serialport::Error) -> io::Error {
    let kind = match error.kind() {
        serialport::ErrorKind::Io(kind) => kind,
        serialport::ErrorKind::NoDevice if error.description.contains("ock") => {
            io::ErrorKind::ResourceBusy
        }
        serialport::ErrorKind::NoDevice => io::ErrorKind::NotFound,
        serialport::ErrorKind::InvalidInput => io::ErrorKind::InvalidInput,
        serialport::ErrorKind::Unknown => io::ErrorKind::Other,
    };
    io::Error::new(kind, error.description.clone())
}

impl Link for SerialLink {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let started = Instant::now();
        let rfcomm = self.uri.is_rfcomm();
        loop {
            let Some((port, _)) = &mut self.open else {
                return Err(self.closed(io::ErrorKind::NotConnected.into()));
            };
            match port.write_all(bytes) {
                Ok(()) => return Ok(()),
                // A non-blocking rfcomm port says "not connected" until the module has answered the page.
                Err(e)
                    if rfcomm
                        && e.kind() == io::ErrorKind::NotConnected
                        && started.elapsed() < RFCOMM_CONNECT =>
                {
                    std::thread::sleep(RFCOMM_RETRY);
                }
                Err(e) => return Err(self.closed(e)),
            }
        }
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
        // The old port must be closed first: it is locked for one program.
        if let Some((port, mut stream)) = self.open.take() {
            stream.stop();
            drop(port);
        }
        let open = || -> serialport::Result<(NativePort, ByteStream)> {
            let path = self.path.to_string_lossy();
            let mut port = serialport::new(path, self.baud)
                .timeout(READ_TIMEOUT)
                .open_native()?;
            let reader = port.try_clone_native()?;
            port.set_timeout(WRITE_TIMEOUT)?;
            Ok((port, ByteStream::start(reader)))
        };
        let opened = open().map_err(|e| LinkError::Open {
            port: self.uri.to_string(),
            source: open_error(&e),
        })?;
        self.open = Some(opened);
        Ok(())
    }

    fn uri(&self) -> &PortUri {
        &self.uri
    }
}
