//! Emulated motors on the bus of a board in QEMU.

use std::collections::VecDeque;

use super::runner::BusPeer;
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
}

impl<M: MotorBus> Motors<M> {
    /// These motors, at their time 0.
    pub fn new(motors: M) -> Self {
        Self {
            motors,
            now_ns: 0,
            received: VecDeque::new(),
        }
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

    fn arrivals(&mut self, into: &mut Vec<(u8, u64)>) {
        let now_ns = self.now_ns;
        match self.motors.wire() {
            // What has been received was announced while it was on the wire.
            Some(bus) => {
                self.received.clear();
                let coming = bus.towards_master().into_iter();
                into.extend(
                    coming
                        .filter(|byte| byte.at_ns > now_ns)
                        .map(|byte| (if byte.clean { byte.byte } else { SPOILED }, byte.at_ns)),
                );
            }
            None => into.extend(self.received.drain(..).map(|received| match received {
                Received::Byte(byte) => (byte, now_ns),
                Received::Spoiled => (SPOILED, now_ns),
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
