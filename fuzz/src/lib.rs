//! Every reader of bytes from outside as a function of bytes. A target fails by a panic; what holds of its result is checked in it.
//!
//! A mutated byte would mostly break a checksum and test nothing behind it. So the targets of wires, recordings, pictures and flash
//! read the bytes as a list of operations, and put right checksums around them; some operations send the bytes as they are.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a panic is a finding"
)]

pub mod corpus;
mod flash;
mod mutate;
mod pictures;
mod recording;
mod robot;
pub mod seeds;
mod servos;
mod texts;
mod wires;

pub use mutate::Mutator;

/// A reader.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Name on the command line and in file names.
    pub name: &'static str,
    /// Longest input that makes sense, bytes.
    pub longest: usize,
    /// Whether inputs are text: a mutation then knows words and numbers.
    pub text: bool,
    /// Runs it; panics where something does not hold.
    pub run: fn(&[u8]),
}

/// All of them.
pub const TARGETS: &[Target] = &[
    binary("bus", 512, wires::bus),
    binary("servos", 512, servos::servos),
    binary("link", 1024, wires::link),
    binary("robot", 1024, robot::orders),
    binary("flash", 512, flash::operations),
    text("gait", 4096, texts::gait),
    text("model", 8192, texts::model),
    text("structure", 8192, texts::structure),
    text("scenario", 4096, texts::scenario),
    text("dataset", 4096, texts::dataset),
    text("csv", 4096, texts::csv),
    text("index", 1024, pictures::index),
    binary("picture", 2048, pictures::picture),
    binary("mcap", 4096, recording::mcap),
];

const fn binary(name: &'static str, longest: usize, run: fn(&[u8])) -> Target {
    Target {
        name,
        longest,
        text: false,
        run,
    }
}

const fn text(name: &'static str, longest: usize, run: fn(&[u8])) -> Target {
    Target {
        name,
        longest,
        text: true,
        run,
    }
}

/// The target of this name.
#[must_use]
pub fn target(name: &str) -> Option<&'static Target> {
    TARGETS.iter().find(|target| target.name == name)
}

/// Reads operations from the bytes of an input; zeros when they are used up.
pub(crate) struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    pub(crate) fn new(data: &'a [u8]) -> Self {
        Self(data)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(crate) fn byte(&mut self) -> u8 {
        self.take(1).first().copied().unwrap_or(0)
    }

    /// Up to `len` bytes.
    pub(crate) fn take(&mut self, len: usize) -> &'a [u8] {
        let (now, later) = self.0.split_at(len.min(self.0.len()));
        self.0 = later;
        now
    }

    /// As many bytes as the next one says.
    pub(crate) fn block(&mut self) -> &'a [u8] {
        let len = usize::from(self.byte());
        self.take(len)
    }

    pub(crate) fn rest(&mut self) -> &'a [u8] {
        std::mem::take(&mut self.0)
    }
}
