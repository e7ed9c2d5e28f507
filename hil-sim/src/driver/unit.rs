//! A whole driver on the bus: loop, registers, and the protocol's server.

use protocol::bus::Framing;
use protocol::bus::server::{DriverServer, Reply};

use super::feetech::Servo;
use super::registers::{Front, Registers};
use super::{Driver, DriverParams};

/// Frames that a driver speaks.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant, reason = "a dozen live at a time")]
enum End {
    Dynamixel(DriverServer),
    Feetech(Box<Servo>),
}

/// One driver with its end of the bus.
#[derive(Clone, Debug)]
pub struct Unit {
    /// Loop and supervision.
    pub driver: Driver,
    /// Control table.
    pub registers: Registers,
    end: End,
}

impl Unit {
    /// A driver that was powered at time 0. `byte_ns`: one byte on the wire.
    #[must_use]
    pub fn new(id: u8, params: DriverParams, seed: u64, joint: usize, byte_ns: u64) -> Self {
        let profile = params.profile;
        let mut driver = Driver::new(params, seed, joint, 0);
        let registers = Registers::new(id, &mut driver);
        let end = match profile.info().framing {
            Framing::Dynamixel2 => End::Dynamixel(DriverServer::new(byte_ns)),
            Framing::Feetech => End::Feetech(Box::new(Servo::new(profile, id))),
        };
        Self {
            driver,
            registers,
            end,
        }
    }

    /// A byte passed the wire, whole at `now_ns`.
    pub fn hear(&mut self, byte: u8, now_ns: u64) -> Option<Reply> {
        let mut front = Front {
            driver: &mut self.driver,
            registers: &mut self.registers,
        };
        match &mut self.end {
            End::Dynamixel(server) => server.push(byte, now_ns, &mut front),
            End::Feetech(servo) => servo.push(byte, now_ns, &mut front),
        }
    }

    /// Bits per second that it listens at.
    #[must_use]
    pub fn baud(&self) -> u32 {
        match &self.end {
            End::Dynamixel(_) => self.registers.baud(),
            End::Feetech(servo) => servo.baud(),
        }
    }

    /// When [`Self::poll`] is due, if nobody talks before [ns].
    #[must_use]
    pub fn deadline_ns(&self) -> Option<u64> {
        match &self.end {
            End::Dynamixel(server) => server.deadline_ns(),
            End::Feetech(servo) => servo.deadline_ns(),
        }
    }

    /// Nobody talked until now.
    pub fn poll(&mut self, now_ns: u64) -> Option<Reply> {
        match &mut self.end {
            End::Dynamixel(server) => server.poll(now_ns),
            End::Feetech(servo) => servo.poll(now_ns),
        }
    }

    /// Restart from outside: brown-out, fault.
    pub fn restart(&mut self, now_ns: u64) {
        self.registers.restart(&mut self.driver, now_ns);
        if let End::Feetech(servo) = &mut self.end {
            servo.restart();
        }
    }
}
