//! The firmware's account of itself: numbered events in two rings, oldest first out, losses counted.
//!
//! What anybody on a link or a bad cable can cause (wrong tags, STOP frames, receiver errors) has a small ring of its own, so that it pushes no fault
//! out. An event that comes again within a second is counted, not kept: one [`EventKind::Repeated`] a second tells how often.

use heapless::Deque;
use protocol::link::{Event, EventKind};

/// Events of the robot kept: a run with a hold, a fault and its stop makes about 15.
pub const KEPT: usize = 64;
/// Events of strangers kept.
pub const STRANGERS_KEPT: usize = 8;
/// Kinds of event whose repetitions are counted at a time.
const WATCHED: usize = 4;
/// Within this time the same event is counted instead of kept, us.
pub const REPEAT_US: u64 = 1_000_000;

/// What was noted last, and how often it came again since.
#[derive(Debug, Clone, Copy)]
struct Last {
    kind: EventKind,
    first: u32,
    noted_us: u64,
    repeats: u32,
}

/// What both rings count.
#[derive(Debug)]
struct Counts {
    next_seq: u32,
    dropped: u32,
}

/// One ring.
#[derive(Debug)]
struct Ring<const N: usize> {
    kept: Deque<Event, N>,
    /// Kinds noted last, newest at the back.
    last: Deque<Last, WATCHED>,
}

impl<const N: usize> Ring<N> {
    const fn new() -> Self {
        Self {
            kept: Deque::new(),
            last: Deque::new(),
        }
    }

    fn push(&mut self, counts: &mut Counts, t_us: u64, kind: EventKind) {
        if let Some(last) = self.last.iter_mut().find(|last| last.kind == kind) {
            if last.repeats > 0 || t_us.saturating_sub(last.noted_us) < REPEAT_US {
                last.repeats = last.repeats.saturating_add(1);
                self.tick(counts, t_us);
                return;
            }
            (last.first, last.noted_us) = (counts.next_seq, t_us);
        } else {
            if self.last.is_full()
                && let Some(oldest) = self.last.pop_front()
            {
                self.note(counts, t_us, oldest);
            }
            // There is room: one was taken out if it was full.
            let _ = self.last.push_back(Last {
                kind,
                first: counts.next_seq,
                noted_us: t_us,
                repeats: 0,
            });
        }
        self.keep(counts, t_us, kind);
    }

    /// Notes the repetitions of an event, if there were any.
    fn note(&mut self, counts: &mut Counts, t_us: u64, last: Last) {
        if last.repeats > 0 {
            let (count, first) = (last.repeats, last.first);
            self.keep(counts, t_us, EventKind::Repeated { count, first });
        }
    }

    /// Notes the repetitions that have waited long enough.
    fn tick(&mut self, counts: &mut Counts, t_us: u64) {
        for _ in 0..self.last.len() {
            let due = |last: &&mut Last| {
                last.repeats > 0 && t_us.saturating_sub(last.noted_us) >= REPEAT_US
            };
            let Some(last) = self.last.iter_mut().find(due) else {
                return;
            };
            let told = *last;
            (last.repeats, last.noted_us) = (0, t_us);
            self.note(counts, t_us, told);
        }
    }

    /// When the ring is full the oldest goes and is counted.
    fn keep(&mut self, counts: &mut Counts, t_us: u64, kind: EventKind) {
        if self.kept.is_full() {
            let _ = self.kept.pop_front();
            counts.dropped = counts.dropped.saturating_add(1);
        }
        // There is room: one was taken out if it was full.
        let _ = self.kept.push_back(Event {
            seq: counts.next_seq,
            t_us,
            kind,
        });
        counts.next_seq = counts.next_seq.wrapping_add(1);
    }

    fn since(&self, from: u32) -> impl Iterator<Item = &Event> {
        self.kept.iter().filter(move |event| event.seq >= from)
    }
}

/// Whether somebody without a key, or a bad cable, can cause this as often as he likes.
fn by_strangers(kind: &EventKind) -> bool {
    matches!(
        kind,
        EventKind::BadTag { .. } | EventKind::Stop { input: false } | EventKind::PortError { .. }
    )
}

/// The log.
#[derive(Debug)]
pub struct EventLog {
    robot: Ring<KEPT>,
    strangers: Ring<STRANGERS_KEPT>,
    counts: Counts,
}

impl EventLog {
    /// No events yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            robot: Ring::new(),
            strangers: Ring::new(),
            counts: Counts {
                next_seq: 0,
                dropped: 0,
            },
        }
    }

    /// Notes an event.
    pub fn push(&mut self, t_us: u64, kind: EventKind) {
        if by_strangers(&kind) {
            self.strangers.push(&mut self.counts, t_us, kind);
        } else {
            self.robot.push(&mut self.counts, t_us, kind);
        }
    }

    /// Once a cycle: tells of repetitions that have waited long enough.
    pub fn tick(&mut self, t_us: u64) {
        self.robot.tick(&mut self.counts, t_us);
        self.strangers.tick(&mut self.counts, t_us);
    }

    /// Number of the next event.
    #[must_use]
    pub fn next_seq(&self) -> u32 {
        self.counts.next_seq
    }

    /// Events that left their ring before anybody could ask for them again.
    #[must_use]
    pub fn dropped(&self) -> u32 {
        self.counts.dropped
    }

    /// Events from number `since` on, in order. A number from another boot or the future gives all that are kept.
    pub fn since(&self, since: u32) -> impl Iterator<Item = &Event> {
        let from = if since > self.counts.next_seq {
            0
        } else {
            since
        };
        let mut robot = self.robot.since(from).peekable();
        let mut strangers = self.strangers.since(from).peekable();
        core::iter::from_fn(move || {
            let of_robot = match (robot.peek(), strangers.peek()) {
                (Some(a), Some(b)) => a.seq < b.seq,
                (a, _) => a.is_some(),
            };
            if of_robot {
                robot.next()
            } else {
                strangers.next()
            }
        })
    }

    /// How many events from `since` on are no longer kept.
    #[must_use]
    pub fn lost_since(&self, since: u32) -> u32 {
        let asked = self.counts.next_seq.saturating_sub(since);
        let kept = if asked == 0 {
            0
        } else {
            self.since(since).count()
        };
        asked.saturating_sub(u32::try_from(kept).unwrap_or(u32::MAX))
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
    use protocol::link::PortFault;

    fn battery(battery_mv: u16) -> EventKind {
        EventKind::BatteryLow { battery_mv }
    }

    fn seqs(log: &EventLog, since: u32) -> Vec<u32> {
        log.since(since).map(|event| event.seq).collect()
    }

    #[test]
    fn the_ring_keeps_the_newest_and_counts_the_rest() {
        let mut log = EventLog::new();
        for number in 0..100_u16 {
            log.push(u64::from(number), battery(number));
        }
        assert_eq!(
            (log.next_seq(), log.dropped(), log.lost_since(0)),
            (100, 36, 36)
        );
        assert_eq!(seqs(&log, 0), (36..100).collect::<Vec<_>>());
        assert_eq!(seqs(&log, 98), [98, 99]);
        assert_eq!(log.since(100).count(), 0);
        assert_eq!(
            log.since(5000).count(),
            KEPT,
            "a number from another boot gives everything"
        );
        assert_eq!(log.lost_since(5000), 0);
    }

    #[test]
    fn strangers_push_nothing_of_the_robot_out() {
        let mut log = EventLog::new();
        log.push(0, battery(1));
        log.push(1, EventKind::KeySet);
        for number in 0..1000_u64 {
            // Five wrong tags in turn: more kinds than are watched for repetitions.
            let request = (number % 5) as u8;
            log.push(number * 1000, EventKind::BadTag { request });
            log.push(
                number * 1000,
                EventKind::PortError {
                    port: request,
                    fault: PortFault::Noise,
                },
            );
        }
        log.push(2_000_000, battery(2));
        let robots: Vec<u32> = log
            .since(0)
            .filter(|event| !by_strangers(&event.kind))
            .map(|event| event.seq)
            .collect();
        assert_eq!(robots, [0, 1, 2002]);
        let all = seqs(&log, 0);
        assert_eq!(all.len(), 3 + STRANGERS_KEPT);
        assert!(all.is_sorted(), "in order over both rings: {all:?}");
        assert_eq!(log.lost_since(0), 2000 - STRANGERS_KEPT as u32);
        assert_eq!(log.dropped(), log.lost_since(0));
    }

    #[test]
    fn an_event_that_comes_again_is_counted_and_told_once_a_second() {
        let mut log = EventLog::new();
        let bad = EventKind::BadTag { request: 8 };
        // 60 within 6 s: one a tenth of a second, a cycle between two.
        for number in 0..60_u64 {
            log.push(number * 100_000, bad);
            log.tick(number * 100_000 + 50_000);
        }
        log.tick(20_000_000);
        let told: u32 = log
            .since(0)
            .map(|event| match event.kind {
                EventKind::Repeated { count, first } => {
                    assert_eq!(first, 0);
                    count
                }
                kind => {
                    assert_eq!(kind, bad);
                    1
                }
            })
            .sum();
        assert_eq!((told, log.dropped()), (60, 0), "{:?}", seqs(&log, 0));
        assert!(log.since(0).count() <= 8);
    }

    #[test]
    fn a_kind_that_leaves_the_watch_tells_its_repetitions() {
        let mut log = EventLog::new();
        for t_us in 0..5 {
            log.push(t_us, battery(6000));
        }
        for number in 1..=WATCHED as u16 {
            log.push(6, battery(number));
        }
        let kinds: Vec<EventKind> = log.since(0).map(|event| event.kind).collect();
        let note = EventKind::Repeated { count: 4, first: 0 };
        let expected = [6000, 1, 2, 3].map(battery).into_iter();
        assert_eq!(
            kinds,
            expected.chain([note, battery(4)]).collect::<Vec<_>>()
        );
    }
}
