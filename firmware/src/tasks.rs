//! The async loops around the core: they move bytes between [`App`] and the traits of [`crate::ports`], and nothing else.
//!
//! | task | does | waits for |
//! |---|---|---|
//! | cycle | bus exchange, decision, set-points; pets the watchdog; owns bus and board | the next 50 ms (10 ms) instant |
//! | work | checks a staged gait a few steps at a time, then writes flash; owns the flash | a message; yields between steps |
//! | receive (one per link) | feeds bytes to the link server | bytes |
//! | send (one per link) | replies first, then events, then telemetry as the line has room | something to send |
//!
//! All run on one thread and share [`App`] without holding it across an await.

use crate::app::types::{BUS_BUFFER, BUS_BYTE_US, LINKS};
use crate::app::{App, BoardInputs, BootFacts, Step, Work};
use crate::crash::CrashRecord;
use crate::ports::{Board, BusPort, Clock, LinkKind, LinkPort, LinkRx, LinkTx, SlotStore};
use crate::shared::{Notify, Shared};
use embassy_futures::join::join4;
use embassy_futures::select::{Either, select};
use embassy_futures::yield_now;
use protocol::link::MAX_FRAME;

/// Bytes taken from a link at once: bounds what one poll decodes (64 bytes at 115200 baud take 5.6 ms to arrive).
const RX_CHUNK: usize = 64;
/// Turns of one exchange: a turn that is not the last brings a byte or an error, and a byte takes 10 us. The longest wait is 36 ms: a slice
/// of a raw packet's listening, 30 ms, and the longest packet both ways, 6 ms.
const MAX_TURNS: u32 = 4_000;
/// Wake-ups between the tasks.
struct Wake {
    send: [Notify; LINKS],
    work: Notify,
}

impl Wake {
    fn senders(&self) {
        for sender in &self.send {
            sender.notify();
        }
    }
}

/// Runs the module until it asks for a reboot. `app` comes fresh from [`App::new`].
///
/// One future holds all tasks: a board spawns it as its only task, an emulator polls it. It allocates nothing.
pub async fn run<C, B, S, P, R1, T1, R2, T2>(
    app: &mut App,
    clock: &C,
    bus: &mut B,
    store: &mut S,
    board: &mut P,
    first: LinkPort<R1, T1>,
    second: LinkPort<R2, T2>,
) where
    C: Clock,
    B: BusPort,
    S: SlotStore,
    P: Board,
    R1: LinkRx,
    T1: LinkTx,
    R2: LinkRx,
    T2: LinkTx,
{
    boot(app, clock, store, board, [first.kind, second.kind]);
    let shared = Shared::new(app);
    let wake = Wake {
        send: [Notify::new(), Notify::new()],
        work: Notify::new(),
    };
    let links = async {
        join4(
            receive(0, first.rx, &shared, clock, &wake),
            send(0, first.tx, &shared, &wake),
            receive(1, second.rx, &shared, clock, &wake),
            send(1, second.tx, &shared, &wake),
        )
        .await;
    };
    // The cycle comes first: on every poll the motors are served before anything else.
    select(
        cycle(&shared, clock, bus, board, &wake),
        select(work(&shared, clock, store, &wake), links),
    )
    .await;
}

/// Collects what the last life left and hands it to the core. Blocks for the flash recovery (reads, a few words).
fn boot<C: Clock, S: SlotStore, P: Board>(
    app: &mut App,
    clock: &C,
    store: &mut S,
    board: &mut P,
    kinds: [LinkKind; LINKS],
) {
    let crash = CrashRecord::decode(board.crash_block());
    CrashRecord::clear(board.crash_block());
    let facts = BootFacts {
        cause: board.reset_cause(),
        unique_id: board.unique_id(),
        board: board.name(),
        entropy: board.entropy(),
        flash_readable: board.flash_readable(),
        crash,
        now_us: clock.now_us(),
    };
    app.boot(store, &facts, kinds);
}

async fn cycle<C: Clock, B: BusPort, P: Board>(
    shared: &Shared<&mut App>,
    clock: &C,
    bus: &mut B,
    board: &mut P,
    wake: &Wake,
) {
    let mut tx = [0; BUS_BUFFER];
    let mut due_us = clock.now_us();
    loop {
        clock.sleep_until_us(due_us).await;
        let inputs = BoardInputs {
            battery_mv: board.battery_mv(),
            stop_pressed: board.stop_input(),
        };
        shared.with(|app| app.begin_cycle(due_us, inputs));
        // Bounded: the core hands out at most three tries per request and five kinds of request per cycle.
        while let Step::Exchange {
            len,
            reply_bytes,
            gap_us,
        } = shared.with(|app| app.next_exchange(&mut tx, clock.now_us()))
        {
            let packet = tx.get(..len).unwrap_or(&[]);
            exchange(shared, clock, bus, packet, reply_bytes, gap_us).await;
        }
        let next_us = shared.with(|app| app.end_cycle(clock.now_us()));
        board.pet_watchdog();
        wake.senders();
        if shared.with(|app| app.reboot_due(clock.now_us())) {
            board.reboot();
            return;
        }
        // 0 only if the core could not be borrowed, which the rule of `Shared` excludes.
        due_us = if next_us == 0 {
            due_us.saturating_add(control::CYCLE_US)
        } else {
            next_us
        };
    }
}

/// One packet out, what answers in. Ends when the core has all it asked for, or in silence.
async fn exchange<C: Clock, B: BusPort>(
    shared: &Shared<&mut App>,
    clock: &C,
    bus: &mut B,
    packet: &[u8],
    reply_bytes: usize,
    gap_us: u64,
) {
    let mut rx = [0; RX_CHUNK];
    let start_us = clock.now_us();
    if !packet.is_empty() {
        bus.discard_input();
        let sent = bus.write_all(packet).await;
        shared.with(|app| app.bus_started(sent));
    }
    let bytes = u64::try_from(packet.len().saturating_add(reply_bytes)).unwrap_or(u64::MAX);
    let give_up_us = start_us
        .saturating_add(bytes.saturating_mul(BUS_BYTE_US))
        .saturating_add(gap_us);
    // A line that never falls silent, or a port that reports one error after the other, always has something to read: so the time is asked at every turn,
    // and the turns are counted for a clock that stands still.
    for _ in 0..MAX_TURNS {
        match select(bus.read(&mut rx), clock.sleep_until_us(give_up_us)).await {
            Either::First(Ok(len)) => {
                let bytes = rx.get(..len).unwrap_or(&[]);
                if shared.with(|app| app.bus_received(bytes)) {
                    return;
                }
            }
            Either::First(Err(error)) => shared.with(|app| app.bus_error(error)),
            Either::Second(()) => break,
        }
        if clock.now_us() >= give_up_us {
            break;
        }
    }
    shared.with(|app| app.bus_silent());
}

async fn work<C: Clock, S: SlotStore>(
    shared: &Shared<&mut App>,
    clock: &C,
    store: &mut S,
    wake: &Wake,
) {
    loop {
        match shared.with(|app| app.work(store, clock.now_us())) {
            Work::None => wake.work.wait().await,
            // Everybody else is polled between two steps.
            Work::More => yield_now().await,
            Work::Done => wake.senders(),
        }
    }
}

async fn receive<C: Clock, R: LinkRx>(
    link: usize,
    mut rx: R,
    shared: &Shared<&mut App>,
    clock: &C,
    wake: &Wake,
) {
    let mut chunk = [0; RX_CHUNK];
    loop {
        match rx.read(&mut chunk).await {
            Ok(len) => {
                let bytes = chunk.get(..len).unwrap_or(&[]);
                shared.with(|app| app.link_received(link, bytes, clock.now_us()));
            }
            Err(error) => shared.with(|app| app.link_error(link, error, clock.now_us())),
        }
        wake.senders();
        wake.work.notify();
    }
}

async fn send<T: LinkTx>(link: usize, mut tx: T, shared: &Shared<&mut App>, wake: &Wake) {
    let mut frame = [0; MAX_FRAME];
    loop {
        let len = shared.with(|app| app.next_frame(link, &mut frame));
        let mut left = frame.get(..len).unwrap_or(&[]);
        if left.is_empty()
            && let Some(notify) = wake.send.get(link)
        {
            notify.wait().await;
        }
        while !left.is_empty() {
            match tx.write(left).await {
                Ok(taken) => left = left.get(taken..).unwrap_or(&[]),
                // The rest of this frame is lost; the next one starts with a delimiter.
                Err(_) => left = &[],
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ports::PortError;
    use control::motion::MotionParams;
    use core::cell::Cell;

    /// A bus that always has something to read, and counts how often it was asked.
    struct Babble {
        gives: Result<usize, PortError>,
        reads: u32,
    }

    impl BusPort for Babble {
        async fn write_all(&mut self, _bytes: &[u8]) -> Result<(), PortError> {
            Ok(())
        }
        async fn read(&mut self, into: &mut [u8]) -> Result<usize, PortError> {
            into.fill(0x55);
            self.reads += 1;
            self.gives
        }
        fn discard_input(&mut self) {}
    }

    /// Goes on by `step_us` each time it is read: a processor that takes time.
    struct Slow {
        now_us: Cell<u64>,
        step_us: u64,
    }

    impl Clock for Slow {
        fn now_us(&self) -> u64 {
            self.now_us.set(self.now_us.get() + self.step_us);
            self.now_us.get()
        }
        async fn sleep_until_us(&self, at_us: u64) {
            if self.now_us.get() < at_us {
                core::future::pending::<()>().await;
            }
        }
    }

    #[test]
    fn a_line_that_never_falls_silent_does_not_hold_the_cycle() {
        for gives in [Ok(1), Ok(RX_CHUNK), Err(PortError::Noise)] {
            // Byte times as they are, and a clock that stands still.
            for (step_us, most) in [(BUS_BYTE_US, 300), (0, MAX_TURNS)] {
                let mut app = App::new(MotionParams::default());
                let shared = Shared::new(&mut app);
                let clock = Slow {
                    now_us: Cell::new(1_000),
                    step_us,
                };
                let mut bus = Babble { gives, reads: 0 };
                let packet = [0xFF; 14];
                embassy_futures::block_on(exchange(&shared, &clock, &mut bus, &packet, 180, 600));
                assert!(bus.reads <= most, "{gives:?}: {} readings", bus.reads);
                assert!(clock.now_us.get() <= 1_000 + 14 * 10 + 180 * 10 + 600 + 4 * step_us);
            }
        }
    }
}
