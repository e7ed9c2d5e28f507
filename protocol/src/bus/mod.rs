//! Motor bus: Dynamixel Protocol 2.0, or Feetech's protocol, over RS485, 1 Mbaud 8N1, half duplex.
//!
//! * [`packet`]: packets, byte stuffing, the parser that resynchronises.
//! * [`profile`]: what differs between families of drivers, ours and off-the-shelf ones.
//! * [`feetech`]: packets of Feetech servos.
//! * [`table`]: the control table, X-series addresses plus our own block.
//! * [`feedback`]: the packed block that is read every cycle.
//! * [`server`]: driver side, over [`server::DriverHandler`].
//! * [`master`]: module side: requests and the parser of their answers.
//!
//! CRC-16 is weak on an 8N1 wire (one flipped bit passed as a wrong packet about once in 10^6, measured), so a driver refuses implausible set-points and
//! tells which set-point it applies, and the module compares.

mod access;
pub mod feedback;
pub mod feetech;
pub mod field;
mod group;
pub mod indirect;
pub mod master;
mod orders;
pub mod packet;
pub mod profile;
pub mod server;
pub mod table;

pub use feedback::{PACKED_LEN, PackedFeedback};
pub use field::Field;
pub use master::{Answer, Exchange, Request};
pub use packet::{
    BROADCAST, Instruction, MAX_ID, MAX_PACKET, Packet, PacketBuf, Parser, StatusError, TooLong,
};
pub use profile::{Framing, Profile, ProfileInfo};
pub use server::{DriverHandler, DriverServer, Reply};
pub use table::{Register, RegisterFile};
