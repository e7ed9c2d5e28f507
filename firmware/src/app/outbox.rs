//! Frames that wait for a link, as bytes in a bounded ring.

use heapless::Deque;
use protocol::link::MAX_FRAME;

/// Room for replies per link: four largest frames. A host waits for the answer before it asks again.
const BYTES: usize = 2048;

/// First in, first out. A frame that does not fit is dropped whole and counted.
#[derive(Debug)]
pub struct Outbox {
    bytes: Deque<u8, BYTES>,
    dropped: u32,
}

impl Outbox {
    /// Empty.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            bytes: Deque::new(),
            dropped: 0,
        }
    }

    /// Queues one frame.
    pub fn push(&mut self, frame: &[u8]) {
        let len = u16::try_from(frame.len()).unwrap_or(u16::MAX);
        let room = BYTES.saturating_sub(self.bytes.len());
        if frame.is_empty() || frame.len() > MAX_FRAME || frame.len().saturating_add(2) > room {
            self.dropped = self.dropped.saturating_add(1);
            return;
        }
        for byte in len.to_le_bytes().into_iter().chain(frame.iter().copied()) {
            // There is room: checked above.
            let _ = self.bytes.push_back(byte);
        }
    }

    /// Takes the oldest frame into `into`; returns its length, 0 when there is none.
    pub fn pop(&mut self, into: &mut [u8; MAX_FRAME]) -> usize {
        let (Some(low), Some(high)) = (self.bytes.pop_front(), self.bytes.pop_front()) else {
            return 0;
        };
        let len = usize::from(u16::from_le_bytes([low, high])).min(MAX_FRAME);
        for place in into.iter_mut().take(len) {
            *place = self.bytes.pop_front().unwrap_or(0);
        }
        len
    }

    /// Frames dropped for want of room.
    #[must_use]
    pub fn dropped(&self) -> u32 {
        self.dropped
    }

    /// Forgets everything: the session is over.
    pub fn clear(&mut self) {
        self.bytes.clear();
    }
}

impl Default for Outbox {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_come_out_whole_and_in_order_and_overflow_is_counted() {
        let mut outbox = Outbox::new();
        for number in 0..10_u8 {
            outbox.push(&[number; 300]);
        }
        assert_eq!(outbox.dropped(), 4, "six frames of 302 bytes fit 2048");
        let mut frame = [0; MAX_FRAME];
        for number in 0..6_u8 {
            assert_eq!(outbox.pop(&mut frame), 300);
            assert!(frame[..300].iter().all(|byte| *byte == number));
        }
        assert_eq!(outbox.pop(&mut frame), 0);
    }
}
