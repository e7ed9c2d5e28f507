//! Recordings: MCAP files with the `ros2` profile and CDR messages.
//!
//! [`Recorder`] appends whole chunks and flushes each to the disk, so a file cut by a power failure is complete up to its
//! last chunk. [`read`] keeps every record before a damaged place and says where the damage is. [`csv`] and [`dataset`]
//! write the columns and the folder of the data set format; [`check`] compares a recording with itself and the law,
//! [`folder`] checks a data set folder as others will read it, [`load`] reads it.

pub mod beside;
pub mod cdr;
pub mod check;
pub mod csv;
pub mod dataset;
mod decode;
pub mod folder;
mod load;
mod reader;
mod record;
pub mod rows;
mod scan;
pub mod schema;
pub mod set;
pub mod timing;
mod writer;

pub use load::{LoadError, Loaded, load, run_text};
pub use reader::{Attachment, ChannelCount, ReadError, Recording, RunData, parse, read};
pub use rows::{EventRow, Feedback, JointRow, RunEndRow, RunStart, SampleRow, joint_names};
pub use scan::{Damage, DamageKind};
pub use writer::{Header, Recorder, RecorderError};

/// Profile of the file: tools read it as a ROS 2 bag.
pub const PROFILE: &str = "ros2";
/// Name under which the run metadata stands.
pub const RUN_METADATA: &str = "rb.run";
/// Version of the topics, fields and metadata described in docs/how-to/record.md.
pub const FORMAT: u32 = 1;
