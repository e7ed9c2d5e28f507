//! Runs a world against the wall clock for a foreign client, or as fast as it talks.
//!
//! The only reader of the wall clock in this crate.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use crate::bus::BusCounters;
use crate::endpoint::{Endpoint, EndpointError};
use crate::fault::FaultCount;
use crate::world::World;

/// How virtual time follows real time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// A reply leaves when its last byte has passed the emulated wire.
    Real,
    /// A reply leaves at once; virtual time still follows the wall clock between requests.
    Prompt,
}

/// What happens while serving.
#[derive(Clone, Debug, PartialEq)]
pub enum ServeEvent {
    /// Clients can connect.
    Ready {
        /// What to connect to.
        address: String,
    },
    /// About ten times a second.
    Status {
        /// Virtual time [s].
        virtual_s: f64,
        /// Real time left out because the machine was too slow or asleep, in all [s].
        behind_s: f64,
        /// Bytes so far.
        bus: BusCounters,
        /// Faults so far.
        faults: Vec<FaultCount>,
        /// Clients so far, where the endpoint can tell.
        clients: u64,
    },
}

/// Longest wait for a byte. Short enough that nobody notices the delay of a stop.
const PATIENCE: Duration = Duration::from_millis(2);
/// Shortest sleep towards a byte that is due: below this the scheduler rounds up anyway.
const SHORTEST_SLEEP: Duration = Duration::from_micros(50);
/// Longest stretch simulated without looking at the endpoint [ns]; what is beyond is left out. A client waits meanwhile: on a machine so loaded that
/// the world runs at half the speed of the wall clock for 200 ms, where clients wait for half a second.
const LONGEST_JUMP_NS: u64 = 100_000_000;
/// How far a prompt reply may run ahead of the wall clock [ns]: longer than any cycle of twelve drivers.
const PROMPT_AHEAD_NS: u64 = 20_000_000;
/// Between two status events.
const STATUS_EVERY: Duration = Duration::from_millis(100);

/// Serves `world` on `endpoint` until `on_event` breaks.
///
/// # Errors
/// The endpoint is gone for good.
pub fn serve(
    world: &mut World,
    endpoint: &mut dyn Endpoint,
    pace: Pace,
    on_event: &mut dyn FnMut(&ServeEvent) -> ControlFlow<()>,
) -> Result<(), EndpointError> {
    let mut clock = Clock {
        start: Instant::now(),
        offset_ns: world.now_ns(),
    };
    let mut last_status = Instant::now();
    let mut behind_ns = 0;
    let ready = ServeEvent::Ready {
        address: endpoint.address(),
    };
    if on_event(&ready).is_break() {
        return Ok(());
    }
    let mut input = [0_u8; 1024];
    loop {
        let count = endpoint.read(&mut input, patience(world, &clock))?;
        behind_ns += clock.skip_if_late(world.now_ns());
        let now_ns = clock.now_ns();
        if now_ns > world.now_ns() {
            world.advance_to(now_ns);
        }
        if let Some(baud) = endpoint.baud() {
            world.set_baud(baud);
        }
        if let Some(bytes) = input.get(..count).filter(|bytes| !bytes.is_empty()) {
            world.write_bytes(now_ns, bytes);
        }
        if pace == Pace::Prompt {
            run_ahead(world, now_ns);
        }
        let mut output = Vec::new();
        while let Some(arrival) = world.next_byte() {
            output.push(arrival.byte);
        }
        if !output.is_empty() {
            endpoint.write(&output)?;
        }
        if last_status.elapsed() >= STATUS_EVERY {
            last_status = Instant::now();
            let status = ServeEvent::Status {
                virtual_s: world.now_ns() as f64 * 1e-9,
                behind_s: behind_ns as f64 * 1e-9,
                bus: world.bus_counters().clone(),
                faults: world.fault_counts(),
                clients: endpoint.clients(),
            };
            if on_event(&status).is_break() {
                return Ok(());
            }
        }
    }
}

/// Wall clock as virtual time.
struct Clock {
    start: Instant,
    offset_ns: u64,
}

impl Clock {
    fn now_ns(&self) -> u64 {
        self.offset_ns + self.start.elapsed().as_nanos() as u64
    }

    /// Leaves out time that is too much to catch up with. Returns what was left out [ns].
    fn skip_if_late(&mut self, world_ns: u64) -> u64 {
        let late_ns = self
            .now_ns()
            .saturating_sub(world_ns)
            .saturating_sub(LONGEST_JUMP_NS);
        self.offset_ns = self.offset_ns.saturating_sub(late_ns);
        late_ns
    }
}

/// How long to listen: until the next byte on the wire is due, but not for ever.
fn patience(world: &World, clock: &Clock) -> Duration {
    match world.next_wire_ns() {
        Some(due_ns) => Duration::from_nanos(due_ns.saturating_sub(clock.now_ns()))
            .clamp(SHORTEST_SLEEP, PATIENCE),
        None => PATIENCE,
    }
}

/// Lets everything under way on the wire come through now.
fn run_ahead(world: &mut World, now_ns: u64) {
    let limit_ns = now_ns + PROMPT_AHEAD_NS;
    while let Some(due_ns) = world.next_wire_ns().filter(|&due_ns| due_ns <= limit_ns) {
        world.advance_to(due_ns);
    }
}

#[cfg(test)]
mod tests {
    use super::{Clock, Duration, Instant, LONGEST_JUMP_NS};

    #[test]
    fn a_client_waits_for_a_tenth_of_a_second_of_lost_time_at_most() {
        let late = Duration::from_secs(2);
        let mut clock = Clock {
            start: Instant::now().checked_sub(late).expect("up for so long"),
            offset_ns: 5_000_000_000,
        };
        let world_ns = 5_000_000_000;
        let left_out_ns = clock.skip_if_late(world_ns);
        assert!(left_out_ns >= 2_000_000_000 - LONGEST_JUMP_NS);
        // What passes between the two looks at the clock is not late.
        assert_eq!(clock.skip_if_late(world_ns + 1_000_000_000), 0);
        let ahead_ns = clock.now_ns() - world_ns;
        assert!(
            (LONGEST_JUMP_NS..1_000_000_000).contains(&ahead_ns),
            "{ahead_ns}"
        );
    }
}
