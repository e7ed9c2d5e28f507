//! The real firmware image in QEMU, in lock-step with the emulated motors: virtual time, same bits on every run.
//!
//! - [`runner`]: starts QEMU, exchanges bytes and time with the plugin
//! - [`peer`]: emulated motors on its bus; [`host`]: a host on its cable
//! - [`wire`]: the messages between the two
//! - [`elf`]: symbols and sizes of the image
//! - [`serve`]: its cable for clients outside, in real time
//! - [`stack`]: bound of the stack from the image alone
//! - [`table`]: size, stack and instructions of the image
//! - [`tools`]: finds QEMU, builds image and plugin for tests
//!
//! Everything needs a Unix socket; elsewhere the module is absent.

pub mod elf;
pub mod host;
mod line;
pub mod peer;
pub mod runner;
pub mod serve;
pub mod stack;
pub mod table;
pub mod tools;
pub mod wire;
