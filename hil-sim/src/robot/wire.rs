//! The robot's end of the motor bus: the firmware's `BusPort` over whatever plays the drivers.

use super::executor::VirtualClock;
use crate::bus::Bus;
use crate::world::World;
use firmware::ports::{BusPort, Clock, PortError};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::Poll;

/// What hangs on the motor bus. Time never goes backwards between calls.
pub trait MotorBus {
    /// The master puts bytes on the wire at `now_ns`. Returns the end of the last stop bit, ns.
    fn transmit(&mut self, now_ns: u64, bytes: &[u8]) -> u64;

    /// Brings everything to `now_ns` and appends what the master has received by then.
    fn receive(&mut self, now_ns: u64, into: &mut VecDeque<Received>);

    /// Brings everything to `now_ns`; what the master receives meanwhile waits for [`MotorBus::receive`].
    fn advance(&mut self, now_ns: u64);

    /// Battery voltage that the module's ADC sees, mV; `None` = the board's own setting counts.
    fn battery_mv(&self) -> Option<u16> {
        None
    }

    /// When the next byte passes the wire, if one is on its way, ns.
    fn next_event_ns(&self) -> Option<u64>;

    /// The first instant at which a master that gathers `count` bytes, or waits for `idle_ns` of silence, has something to take [ns]. A
    /// bus that cannot tell says when the next byte passes.
    fn next_pause_ns(&self, _count: usize, _idle_ns: u64) -> Option<u64> {
        self.next_event_ns()
    }

    /// The wire itself, if what is on it arrives as it is: a look ahead for a master that cannot ask at every byte.
    /// `None` while something may still change or swallow bytes.
    fn wire(&self) -> Option<&Bus> {
        None
    }
}

/// One byte as the UART sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Received {
    /// A byte.
    Byte(u8),
    /// A byte with a framing error: spoiled on the wire.
    Spoiled,
}

impl MotorBus for World {
    fn transmit(&mut self, now_ns: u64, bytes: &[u8]) -> u64 {
        self.advance_to(now_ns);
        self.write_bytes(now_ns, bytes)
    }

    fn receive(&mut self, now_ns: u64, into: &mut VecDeque<Received>) {
        self.advance_to(now_ns);
        while let Some(arrival) = self.next_byte() {
            into.push_back(if arrival.clean {
                Received::Byte(arrival.byte)
            } else {
                Received::Spoiled
            });
        }
    }

    fn advance(&mut self, now_ns: u64) {
        self.advance_to(now_ns);
    }

    fn battery_mv(&self) -> Option<u16> {
        // One battery feeds motors and module.
        Some((self.plant().bus_v() * 1e3) as u16)
    }

    fn next_event_ns(&self) -> Option<u64> {
        World::next_event_ns(self)
    }

    fn wire(&self) -> Option<&Bus> {
        self.undisturbed_bus()
    }
}

/// Bytes the receiver gathers before it hands them over, as a UART ring with an idle line interrupt does.
const GATHER_BYTES: usize = 32;
/// Silence after which it hands over what it has, ns: two byte times at 1 Mbaud.
const IDLE_NS: u64 = 20_000;

/// The firmware's bus port.
pub struct BusEnd<M> {
    clock: VirtualClock,
    motors: Rc<RefCell<M>>,
    inbox: VecDeque<Received>,
}

impl<M: MotorBus> BusEnd<M> {
    /// A port on the given motors.
    pub fn new(clock: VirtualClock, motors: Rc<RefCell<M>>) -> Self {
        Self {
            clock,
            motors,
            inbox: VecDeque::new(),
        }
    }

    fn now_ns(&self) -> u64 {
        self.clock.now_us() * 1000
    }

    /// Takes what has arrived; nothing while more is about to come.
    fn take(&mut self, into: &mut [u8]) -> Option<Result<usize, PortError>> {
        let now_ns = self.now_ns();
        let motors = &mut *self.motors.borrow_mut();
        motors.receive(now_ns, &mut self.inbox);
        let next_ns = motors.next_event_ns();
        let busy = next_ns.is_some_and(|at| at <= now_ns + IDLE_NS);
        if self.inbox.is_empty() || self.inbox.len() < GATHER_BYTES && busy {
            let wanted = GATHER_BYTES.saturating_sub(self.inbox.len()).max(1);
            if let Some(at_ns) = motors.next_pause_ns(wanted, IDLE_NS) {
                self.clock.poll_again_at(at_ns.div_ceil(1000));
            }
            return None;
        }
        if self.inbox.front() == Some(&Received::Spoiled) {
            self.inbox.pop_front();
            return Some(Err(PortError::Noise));
        }
        let mut count = 0;
        while let (Some(place), Some(Received::Byte(byte))) =
            (into.get_mut(count), self.inbox.front())
        {
            *place = *byte;
            self.inbox.pop_front();
            count += 1;
        }
        Some(Ok(count))
    }
}

impl<M: MotorBus> BusPort for BusEnd<M> {
    async fn write_all(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        let end_ns = self.motors.borrow_mut().transmit(self.now_ns(), bytes);
        self.clock.sleep_until_us(end_ns.div_ceil(1000)).await;
        Ok(())
    }

    async fn read(&mut self, into: &mut [u8]) -> Result<usize, PortError> {
        poll_fn(|_| self.take(into).map_or(Poll::Pending, Poll::Ready)).await
    }

    fn discard_input(&mut self) {
        let now_ns = self.now_ns();
        self.motors.borrow_mut().receive(now_ns, &mut self.inbox);
        self.inbox.clear();
    }
}
