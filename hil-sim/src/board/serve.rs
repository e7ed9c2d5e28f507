//! A board in QEMU for clients outside this process: its cable on a pseudo-terminal, TCP or a serial port, guest time
//! tied to the wall clock. Bytes from outside come when they come, so such a run does not repeat.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use thiserror::Error;

use super::runner::{BoardError, BoardRunner, BusPeer};
use super::wire::Port;
use crate::endpoint::{Endpoint, EndpointError};

/// Longest wait for a byte from the client.
const PATIENCE: Duration = Duration::from_millis(2);
/// Longest stretch caught up with, ns: if QEMU is slower than the wall clock, time goes on from there. No byte of a client arrives meanwhile. No
/// tethered run may end by it: of the lease of `rb-host`, 1 s, a quarter may be over when it begins. A quarter is left for the next heartbeat.
const LONGEST_JUMP_NS: u64 = 500_000_000;
/// Between two status reports.
const STATUS_EVERY: Duration = Duration::from_millis(100);

/// Why serving ended.
#[derive(Debug, Error)]
pub enum ServeError {
    /// The board.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// The client's side.
    #[error(transparent)]
    Endpoint(#[from] EndpointError),
}

/// What happens while serving.
#[derive(Clone, Debug, PartialEq)]
pub enum BoardEvent {
    /// Clients can connect.
    Ready {
        /// What to connect to.
        address: String,
    },
    /// About ten times a second.
    Status {
        /// Guest time, s.
        guest_s: f64,
        /// Real time left out because QEMU was too slow, in all, s.
        behind_s: f64,
        /// Clients so far, where the endpoint can tell.
        clients: u64,
    },
}

/// Guest time that should have been reached, and what was left out.
struct Pacer {
    start: Instant,
    begin_ns: u64,
    behind_ns: u64,
}

impl Pacer {
    fn target_ns(&mut self, now_ns: u64) -> u64 {
        let elapsed_ns = u64::try_from(self.start.elapsed().as_nanos()).unwrap_or(u64::MAX);
        let wanted_ns = (self.begin_ns + elapsed_ns).saturating_sub(self.behind_ns);
        let late_ns = wanted_ns.saturating_sub(now_ns + LONGEST_JUMP_NS);
        self.behind_ns += late_ns;
        wanted_ns - late_ns
    }
}

/// Serves the board's cable on `endpoint` until `on_event` breaks.
///
/// # Errors
/// The board ended itself or QEMU is gone; the endpoint is gone for good.
pub fn serve<B: BusPeer>(
    board: &mut BoardRunner<B>,
    endpoint: &mut dyn Endpoint,
    on_event: &mut dyn FnMut(&BoardEvent) -> ControlFlow<()>,
) -> Result<(), ServeError> {
    let address = endpoint.address();
    if on_event(&BoardEvent::Ready { address }).is_break() {
        return Ok(());
    }
    let start = Instant::now();
    let begin_ns = board.now_ns();
    let mut pacer = Pacer {
        start,
        begin_ns,
        behind_ns: 0,
    };
    let mut last_status = start;
    let mut input = [0; 1024];
    loop {
        let count = endpoint.read(&mut input, PATIENCE)?;
        board.send(Port::Wire, input.get(..count).unwrap_or(&[]));
        let target_ns = pacer.target_ns(board.now_ns());
        board.run_until(target_ns)?;
        // Nobody reads the log of the bus here.
        board.take_bus_log();
        let output = board.receive(Port::Wire);
        if !output.is_empty() {
            endpoint.write(&output)?;
        }
        if last_status.elapsed() >= STATUS_EVERY {
            last_status = Instant::now();
            let status = BoardEvent::Status {
                guest_s: board.now_ns() as f64 * 1e-9,
                behind_s: pacer.behind_ns as f64 * 1e-9,
                clients: endpoint.clients(),
            };
            if on_event(&status).is_break() {
                return Ok(());
            }
        }
    }
}
