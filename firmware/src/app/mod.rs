//! The sans-I/O core of the module: bytes and readings in, set-points, replies and telemetry out. It reads no clock.
//!
//! [`App`] is what the tasks drive. Its parts:
//!
//! * [`types`]: what several parts share. [`core`]: the state. No part imports one that imports it; a test holds them to it.
//! * [`timing`]: the 50 ms grid and overruns. [`exchange`], [`packets`]: the packets of a cycle. `raw`: a host's packet for the bus. [`motors`]: what is believed of a reading.
//! * [`cycle`]: supervisor, planner and set-points. [`run`]: one run; its record is a `protocol::link::telemetry::SampleLog`.
//! * [`session`]: what a host may ask. [`outbox`], [`events`]: what goes back. [`storage`], [`dry_run`]: upload and boot.

pub mod core;
pub mod cycle;
pub mod dry_run;
pub mod events;
pub mod exchange;
pub mod motors;
pub mod outbox;
pub mod packets;
mod raw;
pub mod run;
pub mod session;
pub mod setup;
pub mod storage;
pub mod timing;
pub mod types;

use self::core::Core;
use self::exchange::Master;
use self::outbox::Outbox;
use self::session::Visitor;
pub use self::storage::BootFacts;
use self::timing::Slot;
use self::types::{BUS_BUFFER, LINKS};
pub use self::types::{BoardInputs, Step};
use crate::ports::{LinkKind, PortError, SlotStore};
use control::motion::MotionParams;
use control::supervisor::Supervisor;
use protocol::link::{EventKind, FromModule, LinkCounters, MAX_FRAME, Port, PortFault, Server};

/// Largest size of the state: two thirds of the L475's 96 KiB, the rest is for stack, drivers and the executor.
const MAX_APP_BYTES: usize = 64 * 1024;
const _: () = assert!(size_of::<App>() <= MAX_APP_BYTES);

/// How far background work is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Work {
    /// Nothing to do.
    #[default]
    None,
    /// More steps to come.
    More,
    /// Finished; an answer waits.
    Done,
}

/// The whole application state of a module.
pub struct App {
    core: Core,
    master: Master,
    servers: [Server; LINKS],
    outboxes: [Outbox; LINKS],
}

impl App {
    /// State before the first boot step, for the given robot. Large: on a board see [`App::blank`].
    #[must_use]
    pub fn new(motion: MotionParams) -> Self {
        let mut app = Self::blank();
        app.fit(motion);
        app
    }

    /// Sets robot and motion settings; before [`App::boot`].
    pub fn fit(&mut self, motion: MotionParams) {
        self.core.fit(motion);
    }

    /// State without its robot: a constant that a board puts into a static, because it would not fit on the stack. [`App::fit`] comes next.
    #[must_use]
    pub const fn blank() -> Self {
        Self {
            core: Core::blank(),
            master: Master::new(),
            servers: [const { Server::new(Port::Radio, 1, 1) }; LINKS],
            outboxes: [const { Outbox::new() }; LINKS],
        }
    }

    /// Reads the flash and starts the supervisor. Once, before anything else.
    pub fn boot<S: SlotStore>(
        &mut self,
        store: &mut S,
        facts: &BootFacts,
        kinds: [LinkKind; LINKS],
    ) {
        self.core.boot(store, facts);
        for (server, kind) in self.servers.iter_mut().zip(kinds) {
            let port = match kind {
                LinkKind::Wire => Port::Wire,
                LinkKind::Radio => Port::Radio,
            };
            *server = Server::new(port, self.core.robot_id, self.core.boot_id);
        }
    }

    /// Begins the instant `due_us` of the grid.
    // Not inlined: the instruction counts of a cycle begin at this symbol.
    #[inline(never)]
    pub fn begin_cycle(&mut self, due_us: u64, inputs: BoardInputs) {
        let slot = self.core.begin_cycle(due_us, inputs);
        self.master.begin(slot, &self.core);
    }

    /// The next packet for the bus.
    pub fn next_exchange(&mut self, tx: &mut [u8; BUS_BUFFER], now_us: u64) -> Step {
        self.master.next(&mut self.core, tx, now_us)
    }

    /// The packet is on its way, or could not be sent.
    pub fn bus_started(&mut self, sent: Result<(), PortError>) {
        self.master.started(&mut self.core, sent);
    }

    /// Bytes came from the bus; true when all answers are in.
    pub fn bus_received(&mut self, bytes: &[u8]) -> bool {
        self.master.received(&mut self.core, bytes)
    }

    /// The bus receiver reported an error.
    pub fn bus_error(&mut self, error: PortError) {
        self.core.port_error(LINKS, error);
        self.master.error(&mut self.core, error);
    }

    /// The waiting time of the exchange is over.
    pub fn bus_silent(&mut self) {
        self.master.silent(&mut self.core);
    }

    /// Ends the instant; returns when the next one is due, us.
    pub fn end_cycle(&mut self, now_us: u64) -> u64 {
        self.master.end(&mut self.core);
        if self.core.timing.slot() == Slot::Reading {
            self.core.take_sample(Slot::Reading);
            self.core.pace_record();
        }
        if let Some((link, result)) = self.master.take_raw(&mut self.core) {
            self.complete(link, result);
        }
        let next_us = self.core.end_cycle(now_us);
        self.void_challenges();
        next_us
    }

    /// Voids the open challenges of all links if something asked for it.
    fn void_challenges(&mut self) {
        if ::core::mem::take(&mut self.core.void_challenges) {
            self.servers.iter_mut().for_each(Server::void_challenge);
        }
    }

    /// Whether the reset that was ordered is due.
    #[must_use]
    pub fn reboot_due(&self, now_us: u64) -> bool {
        self.core.reboot_at_us.is_some_and(|at_us| now_us >= at_us)
    }

    /// One step of background work.
    pub fn work<S: SlotStore>(&mut self, store: &mut S, now_us: u64) -> Work {
        self.core.now_us = self.core.now_us.max(now_us);
        match self.core.work(store) {
            None => Work::None,
            Some(None) => Work::More,
            Some(Some((link, result))) => {
                self.complete(link, result);
                Work::Done
            }
        }
    }

    fn complete(
        &mut self,
        link: usize,
        result: Result<protocol::link::Completed, protocol::link::Reject>,
    ) {
        let mut frame = [0; MAX_FRAME];
        let Some(server) = self.servers.get_mut(link) else {
            return;
        };
        if let Some(len) = server.complete(result, &mut frame) {
            self.queue(link, frame.get(..len).unwrap_or(&[]));
        }
    }

    fn queue(&mut self, link: usize, frame: &[u8]) {
        if let Some(outbox) = self.outboxes.get_mut(link) {
            outbox.push(frame);
        }
    }

    /// Bytes came over a link at `now_us`.
    pub fn link_received(&mut self, link: usize, bytes: &[u8], now_us: u64) {
        self.core.now_us = self.core.now_us.max(now_us);
        let mut frame = [0; MAX_FRAME];
        for byte in bytes {
            let Some(server) = self.servers.get_mut(link) else {
                return;
            };
            let frames = server.counters().frames;
            let in_run = self.core.run.is_some();
            let mut visitor = Visitor {
                core: &mut self.core,
                link,
            };
            let answer = server.push(*byte, now_us, &mut visitor, &mut frame);
            if server.counters().frames != frames {
                self.core.heard(link, now_us, in_run);
            }
            self.void_challenges();
            if let Some(len) = answer {
                self.queue(link, frame.get(..len).unwrap_or(&[]));
            }
        }
    }

    /// The receiver of a link reported an error: what was half received is lost. A link that is gone ends its session.
    pub fn link_error(&mut self, link: usize, error: PortError, now_us: u64) {
        self.core.now_us = self.core.now_us.max(now_us);
        if let Some(server) = self.servers.get_mut(link) {
            server.restart();
            if error == PortError::Closed {
                server.void_challenge();
                self.core.hung_up(link);
            }
        }
        self.core.port_error(link, error);
    }

    /// The next frame for a link: answers, then events, the record of the run, its end, live samples. 0 = nothing now.
    pub fn next_frame(&mut self, link: usize, frame: &mut [u8; MAX_FRAME]) -> usize {
        let answer = self
            .outboxes
            .get_mut(link)
            .map_or(0, |outbox| outbox.pop(frame));
        if answer > 0 {
            return answer;
        }
        let Some(message) = self.core.next_message(link) else {
            return 0;
        };
        self.servers
            .get_mut(link)
            .and_then(|server| server.send(&message, frame))
            .unwrap_or(0)
    }

    /// The state machine, for tests and indicators.
    #[must_use]
    pub fn supervisor(&self) -> &Supervisor {
        &self.core.supervisor
    }

    /// What a link's receiver has seen and discarded.
    #[must_use]
    pub fn link_counters(&self, link: usize) -> Option<&LinkCounters> {
        self.servers.get(link).map(Server::counters)
    }
}

impl Core {
    /// A receiver reported an error; the bus comes after the links.
    fn port_error(&mut self, port: usize, error: PortError) {
        let fault = match error {
            PortError::Overrun => PortFault::Overrun,
            PortError::Noise => PortFault::Noise,
            PortError::Closed => PortFault::Closed,
        };
        // Three ports.
        let port = port as u8;
        self.event(EventKind::PortError { port, fault });
    }

    /// The host of a link is gone. What a run records waits for it from now on, and the end of the run is told when it is back.
    fn hung_up(&mut self, link: usize) {
        let in_run = self.run.as_ref().is_some_and(|run| run.link == link);
        let session = self.sessions.get_mut(link);
        if let Some(session) = session.filter(|session| in_run && !session.silent) {
            session.silent = true;
            self.event(EventKind::LinkSilent);
        }
    }

    /// A frame of a host came; `in_run`: a run was under way before it was carried out.
    fn heard(&mut self, link: usize, now_us: u64, in_run: bool) {
        let Some(session) = self.sessions.get_mut(link) else {
            return;
        };
        session.heard_us = now_us;
        session.beats = session.beats.saturating_add(u8::from(in_run));
        if session.silent {
            session.silent = false;
            // The end was told to nobody.
            session.end_due = self.run_end.is_some();
            self.event(EventKind::LinkBack);
        }
    }

    /// What goes to a link unasked. The record waits for a host that kept in touch and fell silent. In a run it goes out at the pace of
    /// [`Core::pace_record`]: a host that comes back does not get it at the rate of the line.
    fn next_message(&mut self, link: usize) -> Option<FromModule> {
        let session = self.sessions.get_mut(link).filter(|session| session.open)?;
        if let Some(event) = self.events.since(session.next_event).next() {
            session.next_event = event.seq.wrapping_add(1);
            return Some(FromModule::Event(*event));
        }
        let recorder = link == self.run_link;
        if recorder
            && !session.silent
            && (self.block_due || self.run.is_none())
            && let Some(block) = self.telemetry.next_unsent()
        {
            self.block_due = false;
            return Some(block.clone().into());
        }
        if session.end_due
            && let Some(end) = self.run_end
        {
            session.end_due = false;
            return Some(FromModule::RunEnd(end));
        }
        if session.live {
            session.live = false;
            return Some(self.live.clone().into());
        }
        None
    }
}
