//! A host link of the board: bytes on their way to the guest.

use std::collections::VecDeque;

use super::wire::{Port, TimedByte};

/// How a byte passes a host link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Passage {
    /// As it was sent.
    Whole,
    /// With a framing error.
    Damaged,
    /// It ends with the byte before.
    AtOnce,
}

/// One direction of a host link: bytes on their way to the guest.
#[derive(Clone, Debug, Default)]
pub(super) struct Line {
    waiting: VecDeque<(u8, Passage)>,
    pub(super) travelling: VecDeque<TimedByte>,
    pub(super) received: Vec<u8>,
}

impl Line {
    /// Queues bytes towards the guest.
    pub(super) fn queue(&mut self, bytes: &[u8], passage: Passage) {
        self.waiting
            .extend(bytes.iter().map(|&byte| (byte, passage)));
    }

    /// Puts waiting bytes on the wire, one after the other. While the guest's port is off they keep waiting.
    pub(super) fn launch(&mut self, port: Port, now_ns: u64, byte_ns: u64) {
        if byte_ns == 0 {
            return;
        }
        let mut free_at = self.travelling.back().map_or(now_ns, |last| last.end_ns);
        for (byte, passage) in self.waiting.drain(..) {
            if passage != Passage::AtOnce {
                free_at += byte_ns;
            }
            self.travelling.push_back(TimedByte {
                port,
                byte,
                end_ns: free_at,
                damaged: passage == Passage::Damaged,
            });
        }
    }
}
