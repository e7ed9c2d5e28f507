//! The firmware's account of itself: numbered events in a ring, oldest first out, losses counted.

use heapless::Deque;
use protocol::link::{Event, EventKind};

/// Events kept: a run with a hold, a fault and its stop makes about 15.
pub const KEPT: usize = 64;

/// Ring of events.
#[derive(Debug)]
pub struct EventLog {
    ring: Deque<Event, KEPT>,
    next_seq: u32,
    dropped: u32,
}

impl EventLog {
    /// No events yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            ring: Deque::new(),
            next_seq: 0,
            dropped: 0,
        }
    }

    /// Notes an event. When the ring is full the oldest goes and is counted.
    pub fn push(&mut self, t_us: u64, kind: EventKind) {
        if self.ring.is_full() {
            let _ = self.ring.pop_front();
            self.dropped = self.dropped.saturating_add(1);
        }
        // There is room: one was taken out if it was full.
        let _ = self.ring.push_back(Event {
            seq: self.next_seq,
            t_us,
            kind,
        });
        self.next_seq = self.next_seq.wrapping_add(1);
    }

    /// Number of the next event.
    #[must_use]
    pub fn next_seq(&self) -> u32 {
        self.next_seq
    }

    /// Events that left the ring before anybody could ask for them again.
    #[must_use]
    pub fn dropped(&self) -> u32 {
        self.dropped
    }

    /// Events from number `since` on, oldest first. A number from another boot or the future gives all that are kept.
    pub fn since(&self, since: u32) -> impl Iterator<Item = &Event> {
        let oldest = self.oldest();
        let skip = if since.wrapping_sub(oldest) <= self.next_seq.wrapping_sub(oldest) {
            since.wrapping_sub(oldest)
        } else {
            0
        };
        self.ring
            .iter()
            .skip(usize::try_from(skip).unwrap_or(usize::MAX))
    }

    /// How many events from `since` on are no longer kept.
    #[must_use]
    pub fn lost_since(&self, since: u32) -> u32 {
        let oldest = self.oldest();
        oldest.saturating_sub(since)
    }

    fn oldest(&self) -> u32 {
        self.ring.front().map_or(self.next_seq, |event| event.seq)
    }
}

impl Default for EventLog {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ring_keeps_the_newest_and_counts_the_rest() {
        let mut log = EventLog::new();
        for t_us in 0..100 {
            log.push(t_us, EventKind::KeySet);
        }
        assert_eq!(
            (log.next_seq(), log.dropped(), log.lost_since(0)),
            (100, 36, 36)
        );
        let seqs: Vec<u32> = log.since(0).map(|event| event.seq).collect();
        assert_eq!(seqs, (36..100).collect::<Vec<_>>());
        assert_eq!(
            log.since(98).map(|event| event.seq).collect::<Vec<_>>(),
            [98, 99]
        );
        assert_eq!(log.since(100).count(), 0);
        assert_eq!(
            log.since(5000).count(),
            KEPT,
            "a number from another boot gives everything"
        );
    }
}
