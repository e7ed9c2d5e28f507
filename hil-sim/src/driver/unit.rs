//! A whole driver on the bus: loop, registers, and the protocol's server.

use protocol::bus::server::{DriverServer, Reply};

use super::registers::{Front, Registers};
use super::{Driver, DriverParams};

/// One driver with its end of the bus.
#[derive(Clone, Debug)]
pub struct Unit {
    /// Loop and supervision.
    pub driver: Driver,
    /// Control table.
    pub registers: Registers,
    server: DriverServer,
}

impl Unit {
    /// A driver that was powered at time 0. `byte_ns`: one byte on the wire.
    #[must_use]
    pub fn new(id: u8, params: DriverParams, seed: u64, joint: usize, byte_ns: u64) -> Self {
        let mut driver = Driver::new(params, seed, joint, 0);
        let registers = Registers::new(id, &mut driver);
        Self {
            driver,
            registers,
            server: DriverServer::new(byte_ns),
        }
    }

    /// A byte passed the wire, whole at `now_ns`.
    pub fn hear(&mut self, byte: u8, now_ns: u64) -> Option<Reply> {
        let mut front = Front {
            driver: &mut self.driver,
            registers: &mut self.registers,
        };
        self.server.push(byte, now_ns, &mut front)
    }

    /// When [`Self::poll`] is due, if nobody talks before [ns].
    #[must_use]
    pub fn deadline_ns(&self) -> Option<u64> {
        self.server.deadline_ns()
    }

    /// Nobody talked until now.
    pub fn poll(&mut self, now_ns: u64) -> Option<Reply> {
        self.server.poll(now_ns)
    }

    /// Restart from outside: brown-out, fault.
    pub fn restart(&mut self, now_ns: u64) {
        self.registers.restart(&mut self.driver, now_ns);
    }
}
