//! rb-host from the outside: exit codes, messages, files, and a robot at the other end of the wire.

mod bad_gaits;
mod commands;
mod docs;
mod dropout;
mod python;
mod recordings;
mod rig;
