//! Motor bus: Dynamixel Protocol 2.0 over RS485, 1 Mbaud 8N1, half duplex.
//!
//! * [`packet`]: packets, byte stuffing, the parser that resynchronises.
//! * [`table`]: the control table, X-series addresses plus our own block.
//! * [`feedback`]: the packed block that is read every cycle.
//! * [`server`]: driver side, over [`server::DriverHandler`].
//! * [`master`]: module side: requests and the parser of their answers.

pub mod feedback;

pub use feedback::PackedFeedback;
