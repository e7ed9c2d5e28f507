//! Emulated motors on the bus of a board in QEMU.

use std::collections::VecDeque;

use super::runner::{Arrival, BusPeer};
use crate::robot::wire::{MotorBus, Received};

/// What a receiver makes of a byte that collided: any value, here always the same.
const SPOILED: u8 = 0xa5;
/// Byte time at 1 Mbaud.
const BYTE_NS: u64 = 10_000;

/// Adapter from [`MotorBus`].
#[derive(Debug)]
pub struct Motors<M> {
    motors: M,
    now_ns: u64,
    received: VecDeque<Received>,
    spoiled_until_ns: u64,
}

impl<M: MotorBus> Motors<M> {
    /// These motors, at their time 0.
    pub fn new(motors: M) -> Self {
        Self {
            motors,
            now_ns: 0,
            received: VecDeque::new(),
            spoiled_until_ns: 0,
        }
    }

    /// Everything that the board receives before this guest time is damaged on the wire.
    pub fn spoil_until(&mut self, until_ns: u64) {
        self.spoiled_until_ns = until_ns;
    }

    /// The motors.
    pub fn motors(&mut self) -> &mut M {
        &mut self.motors
    }
}

impl<M: MotorBus> BusPeer for Motors<M> {
    fn sent(&mut self, byte: u8, end_ns: u64) {
        self.motors
            .transmit(end_ns.saturating_sub(BYTE_NS), &[byte]);
    }

    fn advance_to(&mut self, now_ns: u64) {
        self.motors.receive(now_ns, &mut self.received);
        self.now_ns = now_ns;
    }

    fn arrivals(&mut self, into: &mut Vec<Arrival>) {
        let (now_ns, spoiled_until_ns) = (self.now_ns, self.spoiled_until_ns);
        let arrival = |byte: Option<u8>, end_ns| {
            let whole = byte.filter(|_| end_ns >= spoiled_until_ns);
            Arrival {
                byte: whole.unwrap_or(SPOILED),
                end_ns,
                damaged: whole.is_none(),
            }
        };
        match self.motors.wire() {
            // What has been received was announced while it was on the wire.
            Some(bus) => {
                self.received.clear();
                let coming = bus.towards_master().into_iter();
                into.extend(
                    coming
                        .filter(|byte| byte.at_ns > now_ns)
                        .map(|byte| arrival(byte.clean.then_some(byte.byte), byte.at_ns)),
                );
            }
            None => into.extend(self.received.drain(..).map(|received| match received {
                Received::Byte(byte) => arrival(Some(byte), now_ns),
                Received::Spoiled => arrival(None, now_ns),
            })),
        }
    }

    fn next_event_ns(&self) -> Option<u64> {
        let last = self
            .motors
            .wire()
            .and_then(|bus| bus.towards_master().last().map(|byte| byte.at_ns));
        last.or_else(|| self.motors.next_event_ns())
    }
}
