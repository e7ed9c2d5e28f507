//! The emulated robot in this process: firmware, bus and motors on a virtual clock that runs as fast as the host can.

use std::path::Path;
use std::time::Duration;

use super::{Link, LinkError, PortUri};

/// The emulated robot as a link.
#[derive(Debug)]
pub struct SimLink {
    uri: PortUri,
}

impl SimLink {
    /// Starts the emulated robot.
    ///
    /// # Errors
    /// [`LinkError::Scenario`]
    pub fn open(scenario: Option<&Path>) -> Result<Self, LinkError> {
        let uri = PortUri::Sim(scenario.map(Path::to_owned));
        Ok(Self { uri })
    }
}

impl Link for SimLink {
    fn send(&mut self, _bytes: &[u8]) -> Result<(), LinkError> {
        Ok(())
    }
    fn receive(&mut self, _wait: Duration, _into: &mut Vec<u8>) -> Result<(), LinkError> {
        Ok(())
    }
    fn now(&self) -> Duration {
        Duration::ZERO
    }
    fn reconnect(&mut self) -> Result<(), LinkError> {
        Ok(())
    }
    fn uri(&self) -> &PortUri {
        &self.uri
    }
}
