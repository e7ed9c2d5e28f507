//! The half-duplex bus: bytes take time, everybody hears everybody, and two talkers at once spoil each other.
//!
//! 8N1: ten bit times per byte, 10 us at 1 Mbaud. Deterministic; time is an argument.

use crate::rng::Rng;
use std::collections::VecDeque;

/// Who puts a byte on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Talker {
    /// The MCU or the foreign client.
    Master,
    /// A driver, by its place in the world.
    Driver(usize),
}

/// Wire properties.
#[derive(Clone, Debug, PartialEq)]
pub struct BusParams {
    /// Bits per second.
    pub baud: u32,
    /// True = the master hears its own bytes.
    pub echo: bool,
}

impl Default for BusParams {
    fn default() -> Self {
        // 1 Mbaud: the paper, section II. A transceiver with driver-enable does not echo.
        Self {
            baud: 1_000_000,
            echo: false,
        }
    }
}

impl BusParams {
    /// Time of one byte on the wire [ns]: start bit, eight data bits, stop bit.
    #[must_use]
    pub fn byte_ns(&self) -> u64 {
        10_000_000_000 / u64::from(self.baud.max(1))
    }
}

/// A byte that has fully passed the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Delivery {
    /// Instant of its stop bit [ns].
    pub at_ns: u64,
    /// Who sent it.
    pub from: Talker,
    /// Its value as received.
    pub byte: u8,
    /// False = spoiled by a collision (the receiver may notice a framing error).
    pub clean: bool,
}

/// What the bus has seen.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BusCounters {
    /// Bytes from the master.
    pub master_bytes: u64,
    /// Bytes from drivers.
    pub driver_bytes: u64,
    /// Bytes spoiled because two talked at once.
    pub collided_bytes: u64,
    /// Time with at least one talker [ns].
    pub busy_ns: u64,
}

#[derive(Clone, Debug)]
struct InFlight {
    start_ns: u64,
    end_ns: u64,
    from: Talker,
    byte: u8,
    clean: bool,
}

impl InFlight {
    fn order(&self) -> (u64, Talker) {
        (self.end_ns, self.from)
    }
}

/// The wire.
#[derive(Clone, Debug)]
pub struct Bus {
    params: BusParams,
    /// In order of time.
    in_flight: VecDeque<InFlight>,
    /// Until when each talker is sending [ns].
    talking_until: Vec<(Talker, u64)>,
    busy_until_ns: u64,
    counters: BusCounters,
    noise: Rng,
}

/// Stream number of collision garbage.
const PURPOSE_COLLISION: u64 = 0xB0;

impl Bus {
    /// An idle bus.
    #[must_use]
    pub fn new(params: BusParams, seed: u64) -> Self {
        Self {
            params,
            in_flight: VecDeque::new(),
            talking_until: Vec::new(),
            busy_until_ns: 0,
            counters: BusCounters::default(),
            noise: Rng::new(seed, PURPOSE_COLLISION, 0),
        }
    }

    /// Wire properties.
    #[must_use]
    pub fn params(&self) -> &BusParams {
        &self.params
    }

    /// The master talks at another rate from now on.
    pub fn set_baud(&mut self, baud: u32) {
        self.params.baud = baud;
    }

    /// What the bus has seen.
    #[must_use]
    pub fn counters(&self) -> &BusCounters {
        &self.counters
    }

    /// Puts bytes on the wire from `at_ns` on, after whatever this talker is still sending. Returns the instant of the
    /// last stop bit (transmission complete) [ns].
    pub fn send(&mut self, at_ns: u64, from: Talker, bytes: &[u8]) -> u64 {
        let byte_ns = self.params.byte_ns();
        let mut start_ns = at_ns.max(self.free_from_ns(from));
        let alone = self.in_flight.iter().all(|other| other.from == from);
        for &byte in bytes {
            let end_ns = start_ns + byte_ns;
            let mut clean = true;
            let others = if alone {
                Default::default()
            } else {
                self.in_flight.iter_mut()
            };
            for other in others {
                if other.from != from && other.start_ns < end_ns && start_ns < other.end_ns {
                    clean = false;
                    if other.clean {
                        other.clean = false;
                        self.counters.collided_bytes += 1;
                    }
                }
            }
            self.counters.collided_bytes += u64::from(!clean);
            let late = self.in_flight.back();
            let place = if late.is_none_or(|last| last.order() < (end_ns, from)) {
                self.in_flight.len()
            } else {
                self.in_flight
                    .partition_point(|other| other.order() < (end_ns, from))
            };
            let byte = InFlight {
                start_ns,
                end_ns,
                from,
                byte,
                clean,
            };
            self.in_flight.insert(place, byte);
            self.counters.busy_ns += end_ns - start_ns.max(self.busy_until_ns.min(end_ns));
            self.busy_until_ns = self.busy_until_ns.max(end_ns);
            start_ns = end_ns;
        }
        match from {
            Talker::Master => self.counters.master_bytes += bytes.len() as u64,
            Talker::Driver(_) => self.counters.driver_bytes += bytes.len() as u64,
        }
        match self
            .talking_until
            .iter_mut()
            .find(|(talker, _)| *talker == from)
        {
            Some((_, until)) => *until = start_ns,
            None => self.talking_until.push((from, start_ns)),
        }
        start_ns
    }

    /// From when a talker's own line is free [ns].
    #[must_use]
    pub fn free_from_ns(&self, from: Talker) -> u64 {
        self.talking_until
            .iter()
            .find(|(talker, _)| *talker == from)
            .map_or(0, |(_, until)| *until)
    }

    /// Instant of the next byte's stop bit, if any byte is on the wire [ns].
    #[must_use]
    pub fn next_delivery_ns(&self) -> Option<u64> {
        self.in_flight.front().map(|byte| byte.end_ns)
    }

    /// When the master has heard `count` of the bytes on the wire, or nobody has been heard for more than `idle_ns` after one of them: the first of
    /// both [ns]. `None` with nothing on the wire.
    #[must_use]
    pub fn pause_ns(&self, count: usize, idle_ns: u64) -> Option<u64> {
        let (mut heard, mut last_ns) = (0, None);
        for byte in &self.in_flight {
            if last_ns.is_some_and(|last_ns| byte.end_ns > last_ns + idle_ns) {
                break;
            }
            last_ns = Some(byte.end_ns);
            heard += usize::from(byte.from != Talker::Master || self.params.echo);
            if heard >= count {
                break;
            }
        }
        last_ns
    }

    /// Every byte on its way to the master, in order of time, as it will arrive if nobody else starts to talk.
    #[must_use]
    pub fn towards_master(&self) -> Vec<Delivery> {
        self.in_flight
            .iter()
            .filter(|byte| byte.from != Talker::Master || self.params.echo)
            .map(|byte| Delivery {
                at_ns: byte.end_ns,
                from: byte.from,
                byte: byte.byte,
                clean: byte.clean,
            })
            .collect()
    }

    /// Who sends the next byte that passes.
    #[must_use]
    pub fn next_talker(&self) -> Option<Talker> {
        self.in_flight.front().map(|byte| byte.from)
    }

    /// Appends up to `most` bytes that have passed by `until_ns`, all clean, all of one talker and without a pause. Gives the instant of the last.
    pub fn deliver_run(&mut self, until_ns: u64, most: usize, into: &mut Vec<u8>) -> Option<u64> {
        let from = self.next_talker()?;
        let byte_ns = self.params.byte_ns();
        let mut last_ns = None;
        for _ in 0..most {
            let next = self.in_flight.front().filter(|next| {
                let follows = last_ns.is_none_or(|last_ns: u64| next.end_ns <= last_ns + byte_ns);
                follows && next.clean && next.from == from && next.end_ns <= until_ns
            });
            let Some(next) = next else { break };
            into.push(next.byte);
            last_ns = Some(next.end_ns);
            self.in_flight.pop_front();
        }
        last_ns
    }

    /// Takes the next byte that has fully passed by `until_ns`.
    pub fn deliver(&mut self, until_ns: u64) -> Option<Delivery> {
        if self.in_flight.front()?.end_ns > until_ns {
            return None;
        }
        let passed = self.in_flight.pop_front()?;
        let byte = if passed.clean {
            passed.byte
        } else {
            // What two drivers of a pair against each other leave is neither byte: any other value.
            passed.byte ^ (1 + (self.noise.next_u64() % 255) as u8)
        };
        Some(Delivery {
            at_ns: passed.end_ns,
            from: passed.from,
            byte,
            clean: passed.clean,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_byte_takes_ten_bits() {
        let mut bus = Bus::new(BusParams::default(), 0);
        assert_eq!(bus.send(500, Talker::Master, &[1, 2, 3]), 30_500);
        assert_eq!(bus.next_delivery_ns(), Some(10_500));
        assert_eq!(bus.deliver(10_499), None);
        let first = bus.deliver(10_500).expect("due");
        assert_eq!((first.at_ns, first.byte, first.clean), (10_500, 1, true));
        assert_eq!(
            BusParams {
                baud: 115_200,
                echo: false
            }
            .byte_ns(),
            86_805
        );
    }

    #[test]
    fn overlapping_talkers_spoil_each_other_and_are_counted() {
        let mut bus = Bus::new(BusParams::default(), 0);
        bus.send(0, Talker::Master, &[0x55; 4]);
        bus.send(15_000, Talker::Driver(0), &[0xAA]);
        let all: Vec<_> = std::iter::from_fn(|| bus.deliver(u64::MAX)).collect();
        let spoiled: Vec<_> = all
            .iter()
            .filter(|d| !d.clean)
            .map(|d| (d.at_ns, d.from))
            .collect();
        assert_eq!(
            spoiled,
            [
                (20_000, Talker::Master),
                (25_000, Talker::Driver(0)),
                (30_000, Talker::Master)
            ]
        );
        assert_eq!(bus.counters().collided_bytes, 3);
        let sent = |from| if from == Talker::Master { 0x55 } else { 0xAA };
        assert!(
            all.iter()
                .filter(|d| !d.clean)
                .all(|d| d.byte != sent(d.from))
        );
    }

    #[test]
    fn one_talker_never_collides_with_itself() {
        let mut bus = Bus::new(BusParams::default(), 0);
        bus.send(0, Talker::Driver(1), &[1, 2]);
        // Asked to start early: queued behind its own bytes.
        assert_eq!(bus.send(5_000, Talker::Driver(1), &[3]), 30_000);
        assert_eq!(bus.counters().collided_bytes, 0);
        assert_eq!(bus.counters().busy_ns, 30_000);
    }
}
