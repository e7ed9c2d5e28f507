//! The motor bus of a schedule: ideal drivers behind a wire that loses, delays, doubles and swaps packets, and the
//! notes of what passed.

use crate::rng::Rng;
use crate::robot::ideal::{IdealMotors, Noise};
use crate::robot::wire::{MotorBus, Received};
use protocol::bus::packet::Parser;
use protocol::bus::{Instruction, PACKED_LEN};
use std::collections::VecDeque;

/// Time of a byte on the motor bus, ns: 1 Mbaud 8N1.
const BYTE_NS: u64 = 10_000;
/// A packet that is to be overtaken waits no longer than this, ns.
const OVERTAKEN_NS: u64 = 8_000_000;

/// What happens to whole packets of the module.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct PacketFaults {
    /// Share of packets lost.
    pub(crate) loss: f64,
    /// Share of packets that arrive late, and by how much, ns.
    pub(crate) delay: (f64, u64),
    /// Share of packets that the next one overtakes.
    pub(crate) reorder: f64,
    /// Share of packets that arrive twice.
    pub(crate) duplicate: f64,
}

/// One packet that the module put on the wire.
#[derive(Debug, Clone)]
pub(crate) struct Sent {
    /// When its first byte left, us.
    pub(crate) at_us: u64,
    /// The bytes, before the wire did anything to them.
    pub(crate) bytes: Vec<u8>,
    /// When a whole and new measurement of each driver had last reached the module by then, us.
    pub(crate) heard_us: [Option<u64>; 6],
    /// Where each driver stood then, urad.
    pub(crate) stood_urad: [i32; 6],
    /// Whether its torque was on.
    pub(crate) torque: [bool; 6],
}

/// Ideal motors on a bad wire.
pub(crate) struct Watched {
    /// The drivers.
    pub(crate) motors: IdealMotors,
    faults: PacketFaults,
    rng: Rng,
    /// Packets that are still to reach the drivers, and when, ns.
    held: VecDeque<(u64, Vec<u8>)>,
    /// What the module sent since the last look.
    pub(crate) sent: Vec<Sent>,
    /// When the module's task goes on after the last stall, us.
    pub(crate) stalled_until_us: u64,
    heard_us: [Option<u64>; 6],
    last: [Vec<u8>; 6],
    parser: Parser,
}

/// Stream number of packet faults.
const PURPOSE_PACKETS: u64 = 0x1E;

impl Watched {
    /// Six ideal drivers on a good wire.
    #[must_use]
    pub(crate) fn new(seed: u64) -> Self {
        let mut motors = IdealMotors::new(seed.is_multiple_of(8));
        motors.reseed(seed);
        // Faster than any joint of the paper's Table I, slower than a jump of an encoder.
        motors.set_speed(3);
        Self {
            motors,
            faults: PacketFaults::default(),
            rng: Rng::new(seed, PURPOSE_PACKETS, 0),
            held: VecDeque::new(),
            sent: Vec::new(),
            stalled_until_us: 0,
            heard_us: [None; 6],
            last: Default::default(),
            parser: Parser::new(),
        }
    }

    /// What the wire does from now on.
    pub(crate) fn set_faults(&mut self, faults: PacketFaults, noise: Noise) {
        self.faults = faults;
        self.motors.set_noise(noise);
    }

    /// Hands over what was held back until `now_ns`.
    fn release(&mut self, now_ns: u64) {
        while let Some(at) = (0..self.held.len()).find(|at| self.held[*at].0 <= now_ns) {
            let (at_ns, bytes) = self.held.remove(at).unwrap_or_default();
            self.motors.put(at_ns, &bytes);
        }
    }

    /// Puts a packet on the bad wire. Returns when its last bit has left the module, ns.
    fn pass(&mut self, now_ns: u64, bytes: &[u8]) -> u64 {
        let end_ns = now_ns + BYTE_NS * bytes.len() as u64;
        let PacketFaults {
            loss,
            delay: (late, by_ns),
            reorder,
            duplicate,
        } = self.faults;
        if self.rng.chance(loss) {
            return end_ns;
        }
        if self.rng.chance(late) {
            self.held.push_back((now_ns + by_ns, bytes.to_vec()));
            return end_ns;
        }
        if self.rng.chance(reorder) {
            self.held.push_back((now_ns + OVERTAKEN_NS, bytes.to_vec()));
            return end_ns;
        }
        let end_ns = self.motors.put(now_ns, bytes);
        if self.rng.chance(duplicate) {
            self.motors.put(end_ns, bytes);
        }
        for (at_ns, _) in &mut self.held {
            // Overtaken: it may go as soon as this one has passed.
            if reorder > 0.0 {
                *at_ns = (*at_ns).min(end_ns);
            }
        }
        end_ns
    }

    /// Notes measurements that reach the module.
    fn note(&mut self, now_ns: u64, received: &Received) {
        let Received::Byte(byte) = received else {
            self.parser.clear();
            return;
        };
        self.parser.push(*byte);
        while let Some(packet) = self.parser.next_packet() {
            let joint = usize::from(packet.id.wrapping_sub(1));
            let answer = packet.instruction == Instruction::Status as u8;
            let data = packet.status().map_or(&[][..], |(_, data)| data);
            let (Some(last), true) = (self.last.get_mut(joint), answer) else {
                continue;
            };
            // The same measurement again says nothing new.
            if data.len() == PACKED_LEN && *last != data {
                data.clone_into(last);
                self.heard_us[joint] = Some(now_ns / 1_000);
            }
        }
    }
}

impl MotorBus for Watched {
    fn transmit(&mut self, now_ns: u64, bytes: &[u8]) -> u64 {
        self.release(now_ns);
        self.parser.clear();
        self.motors.advance(now_ns);
        self.sent.push(Sent {
            at_us: now_ns / 1_000,
            bytes: bytes.to_vec(),
            heard_us: self.heard_us,
            stood_urad: std::array::from_fn(|joint| self.motors.position_urad(joint)),
            torque: std::array::from_fn(|joint| self.motors.torque(joint)),
        });
        let end_ns = self.pass(now_ns, bytes);
        // The task stands still, the wire does not.
        let stall_ns = self.motors.take_stall();
        if stall_ns > 0 {
            self.stalled_until_us = (end_ns + stall_ns).div_ceil(1_000);
        }
        end_ns + stall_ns
    }

    fn receive(&mut self, now_ns: u64, into: &mut VecDeque<Received>) {
        self.release(now_ns);
        let before = into.len();
        self.motors.receive(now_ns, into);
        for received in into.range(before..) {
            self.note(now_ns, received);
        }
    }

    fn advance(&mut self, now_ns: u64) {
        self.release(now_ns);
        self.motors.advance(now_ns);
    }

    fn next_event_ns(&self) -> Option<u64> {
        let held = self.held.iter().map(|(at_ns, _)| *at_ns).min();
        self.motors.next_event_ns().into_iter().chain(held).min()
    }
    fn next_pause_ns(&self, count: usize, idle_ns: u64) -> Option<u64> {
        let held = self.held.iter().map(|(at_ns, _)| *at_ns).min();
        let pause = self.motors.next_pause_ns(count, idle_ns);
        pause.into_iter().chain(held).min()
    }
}
