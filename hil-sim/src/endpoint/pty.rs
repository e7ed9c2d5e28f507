//! A pseudo-terminal: any program that can open a serial port can be the client.

use std::fs;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serialport::{SerialPort, TTYPort};

use super::{Endpoint, EndpointError};

/// A pseudo-terminal pair.
///
/// The slave side stays open here, or the master would read errors whenever no client is there. Its exclusive flag is
/// never touched: clearing it takes a shared lock that would shut every client out. A pseudo-terminal takes any baud
/// rate and paces nothing: the emulated bus does that, at the rate that the client sets.
#[derive(Debug)]
pub struct Pty {
    master: TTYPort,
    _slave: TTYPort,
    device: String,
    link: Option<PathBuf>,
    /// Rate of a new pseudo-terminal, which no client has set [bit/s].
    unset_baud: Option<u32>,
}

impl Pty {
    /// Opens a pair; with `link` the device can be found under that path, which is removed at the end.
    ///
    /// # Errors
    /// No pseudo-terminal, or the link cannot be made (something that is no link is there).
    pub fn open(link: Option<&Path>) -> Result<Self, EndpointError> {
        let (master, slave) = TTYPort::pair().map_err(|source| EndpointError::Pty { source })?;
        let device = slave.name().unwrap_or_default();
        let mut pty = Self {
            unset_baud: master.baud_rate().ok(),
            master,
            _slave: slave,
            device,
            link: None,
        };
        if let Some(path) = link {
            pty.make_link(path).map_err(|source| EndpointError::Link {
                path: path.to_path_buf(),
                target: pty.device.clone(),
                source,
            })?;
            pty.link = Some(path.to_path_buf());
        }
        Ok(pty)
    }

    /// Path of the device itself.
    #[must_use]
    pub fn device(&self) -> &str {
        &self.device
    }

    /// A link left behind by an earlier run is replaced; anything else is kept and the call fails.
    fn make_link(&self, path: &Path) -> std::io::Result<()> {
        if fs::symlink_metadata(path).is_ok_and(|meta| meta.file_type().is_symlink()) {
            fs::remove_file(path)?;
        }
        symlink(&self.device, path)
    }

    fn broken(&self, source: std::io::Error) -> EndpointError {
        EndpointError::Broken {
            address: self.address(),
            source,
        }
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        if let Some(path) = &self.link {
            // Only our own link; a newer emulation may have replaced it.
            if fs::read_link(path).is_ok_and(|target| target == Path::new(&self.device)) {
                let _ = fs::remove_file(path);
            }
        }
    }
}

impl Endpoint for Pty {
    fn address(&self) -> String {
        self.link
            .as_ref()
            .map_or_else(|| self.device.clone(), |path| path.display().to_string())
    }

    fn baud(&self) -> Option<u32> {
        // Linux keeps the settings of both ends in one place.
        let baud = self.master.baud_rate().ok();
        baud.filter(|baud| *baud > 0 && Some(*baud) != self.unset_baud)
    }

    fn read(&mut self, into: &mut [u8], patience: Duration) -> Result<usize, EndpointError> {
        self.master
            .set_timeout(patience)
            .map_err(|error| self.broken(error.into()))?;
        match self.master.read(into) {
            Ok(count) => Ok(count),
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => {
                Ok(0)
            }
            Err(error) => Err(self.broken(error)),
        }
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), EndpointError> {
        // A client that does not read fills the terminal's buffer: drop, as a wire would.
        match self.master.write_all(bytes) {
            Ok(()) => Ok(()),
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock) => {
                Ok(())
            }
            Err(error) => Err(self.broken(error)),
        }
    }
}
