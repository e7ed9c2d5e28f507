//! A host of a schedule: the program at its desk, its clock, its line, what it keeps of a run. It asks as
//! `rb-host` does: the same bytes four times,
//! HELLO again for another session, a new signature for a voided challenge.

use super::channel::{Frame, Order};
use crate::rng::Rng;
use protocol::link::{
    Client, Digest, FromModule, Key, MAX_FRAME, Nonce, Received, Reject, RunEnd, SampleBlock,
    ToModule, VERSION,
};
use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::future::poll_fn;
use std::rc::Rc;
use std::task::Poll;

/// Times a request is sent, and the wait after each, us: those of `rb-host` with its time-out of one second.
const TRIES: u32 = 4;
const WAIT_US: u64 = 250_000;
/// In one seed of so many the user is hasty.
const HASTY_SEEDS: u64 = 16;
/// Stream number of a host's decisions.
const PURPOSE_HOST: u64 = 0x20;

/// Why a request failed.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Fail {
    /// No answer.
    Timeout,
    /// Refused.
    Refused(Reject),
    /// The module restarted since the last HELLO.
    Restarted,
    /// An answer of another type.
    Unexpected,
}

/// What the laws have to know of what a host saw.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Note {
    /// The STOP of this number was acknowledged.
    Stopped(u64),
    /// The end of a run was told, of a boot.
    Ended(u32, RunEnd),
    /// A gait is on its way to a slot.
    Uploading(u8, Digest),
    /// The module said that a slot holds it.
    Stored(u8, Digest),
    /// The record of this run of a boot is complete, says the module.
    Drained(u32, u16),
    /// A run of this length in ms came to its end.
    Completed(RunEnd, u32),
}

/// What a host keeps of one run.
#[derive(Debug, Clone, Default)]
pub(crate) struct Record {
    /// The module's boot; runs are counted anew in each.
    pub(crate) boot: u32,
    /// Number of the run.
    pub(crate) run: u16,
    /// Samples by index: time, set-points, flags.
    pub(crate) samples: BTreeMap<u32, (u64, [i32; 6], u8)>,
    /// A block could not be read, or two blocks disagree.
    pub(crate) damaged: Option<String>,
}

/// The state of a host that the engine of the schedule moves.
#[derive(Debug)]
pub(crate) struct Desk {
    /// True time, us.
    pub(crate) now_us: u64,
    /// Its own clock against true time.
    pub(crate) clock_ratio: f64,
    /// When it wants to go on, true time, us.
    pub(crate) wake_us: u64,
    /// Frames to send.
    pub(crate) outbox: Vec<Frame>,
    /// What the laws look at.
    pub(crate) notes: Vec<Note>,
    /// Restarts of the module so far.
    pub(crate) resets: u32,
    /// Of each boot that a HELLO told of, how many restarts there had been when it first did.
    epochs: BTreeMap<u32, u32>,
    /// The user puts the joints into the home pose.
    pub(crate) place: bool,
    /// Its user orders runs without a look at the state of the robot, which has to refuse what it cannot do.
    pub(crate) hasty: bool,
    /// What it keeps of the newest run.
    pub(crate) record: Record,
    /// Ends of runs it was told.
    pub(crate) ends: Vec<RunEnd>,
    /// Events it was told.
    pub(crate) events: Vec<protocol::link::Event>,
    /// Its decisions.
    pub(crate) rng: Rng,
    client: Client,
    key: Option<Key>,
    inbox: VecDeque<Received>,
    orders: u64,
    draining: bool,
}

impl Desk {
    /// A host program that was just started; `life` counts its starts.
    pub(crate) fn new(seed: u64, host: u64, life: u64, key: Option<Key>) -> Self {
        let mut rng = Rng::new(seed, PURPOSE_HOST, host * 1_000 + life);
        Self {
            now_us: 0,
            clock_ratio: 1.0,
            wake_us: 0,
            outbox: Vec::new(),
            notes: Vec::new(),
            resets: 0,
            epochs: BTreeMap::new(),
            place: false,
            hasty: seed % HASTY_SEEDS == 2,
            record: Record::default(),
            ends: Vec::new(),
            events: Vec::new(),
            client: Client::new(rng.next_u64() as u16),
            rng,
            key,
            inbox: VecDeque::new(),
            orders: (host * 1_000 + life) << 32,
            draining: false,
        }
    }

    /// Bytes have arrived.
    pub(crate) fn receive(&mut self, bytes: &[u8]) {
        for byte in bytes {
            if let Some(Ok(received)) = self.client.push(*byte) {
                self.inbox.push_back(received);
            }
        }
        // Any HELLO tells of a restart: the answer to a late copy of an old one as well.
        let boot = self.client.boot_id();
        if boot != 0 {
            self.epochs.entry(boot).or_insert(self.resets);
        }
    }

    /// Whether there is something to look at.
    pub(crate) fn is_due(&self) -> bool {
        !self.inbox.is_empty() || self.now_us >= self.wake_us
    }

    fn keep(&mut self, boot: u32, block: &SampleBlock) {
        if (self.record.boot, self.record.run) != (boot, block.run) {
            self.record = Record {
                boot,
                run: block.run,
                ..Record::default()
            };
        }
        for (index, sample) in (block.first..).zip(block.samples()) {
            let Ok(sample) = sample else {
                self.record.damaged = Some(format!("sample {index} cannot be read"));
                return;
            };
            let mut goals = [0; 6];
            for (goal, motor) in goals.iter_mut().zip(&sample.motors) {
                *goal = motor.setpoint_urad;
            }
            let new = (sample.t_us, goals, sample.flags);
            let old = self.record.samples.insert(index, new);
            if old.is_some_and(|old| old != new) {
                self.record.damaged = Some(format!("two versions of sample {index}"));
            }
        }
    }

    /// Takes one message; the answer to `awaited` is given back.
    fn take(&mut self, received: Received, awaited: Option<u16>) -> Option<FromModule> {
        let Received { header, message } = received;
        let answer = awaited == Some(header.sequence);
        match message {
            FromModule::Event(event) => self.events.push(event),
            FromModule::Sample(_) => {}
            FromModule::RunEnd(end) => {
                self.ends.push(end);
                self.notes.push(Note::Ended(header.boot_id, end));
            }
            FromModule::SampleBlock(block) if !(answer && self.draining) => {
                self.keep(header.boot_id, &block);
            }
            message if answer => return Some(message),
            _ => {}
        }
        None
    }
}

/// What a script holds of its host.
#[derive(Debug, Clone)]
pub(crate) struct Hand(pub(crate) Rc<RefCell<Desk>>);

impl Hand {
    /// Waits on the host's clock; what comes meanwhile is kept.
    pub(crate) async fn sleep(&self, us: u64) {
        let until_us = self.0.borrow().later(us);
        while self.message(until_us, None).await.is_some() {}
    }

    /// The answer to `awaited`, or `None` at `until_us`.
    async fn message(&self, until_us: u64, awaited: Option<u16>) -> Option<FromModule> {
        poll_fn(|_| {
            let mut desk = self.0.borrow_mut();
            while let Some(received) = desk.inbox.pop_front() {
                if let Some(answer) = desk.take(received, awaited) {
                    return Poll::Ready(Some(answer));
                }
            }
            if desk.now_us >= until_us {
                return Poll::Ready(None);
            }
            desk.wake_us = until_us;
            Poll::Pending
        })
        .await
    }

    async fn exchange(
        &self,
        message: &ToModule,
        proof: Option<(Key, Nonce)>,
    ) -> Result<FromModule, Fail> {
        let (sequence, frame) = self.0.borrow_mut().frame(message, proof);
        for _ in 0..TRIES {
            let until_us = {
                let mut desk = self.0.borrow_mut();
                desk.outbox.push(frame.clone());
                desk.later(WAIT_US)
            };
            match self.message(until_us, Some(sequence)).await {
                Some(FromModule::Nack { reason, .. }) => return Err(Fail::Refused(reason)),
                Some(answer) => return Ok(answer),
                None => {}
            }
        }
        Err(Fail::Timeout)
    }

    async fn ask_once(&self, message: &ToModule) -> Result<FromModule, Fail> {
        let key = self.0.borrow().key;
        let mut proof = None;
        if let (Some(key), Some(_)) = (key, message.tag()) {
            match self.exchange(&ToModule::GetChallenge, None).await? {
                FromModule::Challenge { nonce } => proof = Some((key, nonce)),
                _ => return Err(Fail::Unexpected),
            }
        }
        self.exchange(message, proof).await
    }

    /// Says HELLO.
    pub(crate) async fn hello(&self) -> Result<(), Fail> {
        let answer = self
            .exchange(&ToModule::Hello { protocol: VERSION }, None)
            .await?;
        let FromModule::Hello(_) = answer else {
            return Err(Fail::Unexpected);
        };
        Ok(())
    }

    /// Asks as `rb-host` does.
    pub(crate) async fn ask(&self, message: &ToModule) -> Result<FromModule, Fail> {
        match self.ask_once(message).await {
            Err(Fail::Refused(Reject::OtherSession)) => {
                let before = self.0.borrow().client.boot_id();
                self.hello().await?;
                if before == self.0.borrow().client.boot_id() {
                    self.ask_once(message).await
                } else {
                    Err(Fail::Restarted)
                }
            }
            Err(Fail::Refused(Reject::NoChallenge)) if message.tag().is_some() => {
                self.ask_once(message).await
            }
            other => other,
        }
    }

    /// STOP; true when it was acknowledged.
    pub(crate) async fn stop(&self) -> bool {
        let stopped = self.exchange(&ToModule::Stop, None).await.is_ok();
        if stopped {
            let mut desk = self.0.borrow_mut();
            let number = desk.orders;
            desk.notes.push(Note::Stopped(number));
        }
        stopped
    }

    /// Asks for all blocks of the last run that it lacks, until the module has no more.
    pub(crate) async fn drain(&self) -> Result<(), Fail> {
        loop {
            let of = |desk: &Desk| (desk.record.boot, desk.record.run);
            let (from_sample, asked) = {
                let desk = self.0.borrow();
                (desk.record.first_missing(), of(&desk))
            };
            self.0.borrow_mut().draining = true;
            let answer = self.ask(&ToModule::Drain { from_sample }).await;
            let mut desk = self.0.borrow_mut();
            desk.draining = false;
            let FromModule::SampleBlock(block) = answer? else {
                return Err(Fail::Unexpected);
            };
            if block.count == 0 {
                let boot = desk.client.boot_id();
                // A record begun since: what it lacks was not asked for.
                if of(&desk) == (boot, block.run) && asked != of(&desk) {
                    continue;
                }
                desk.notes.push(Note::Drained(boot, block.run));
                return Ok(());
            }
            let before = desk.record.samples.len();
            let boot = desk.client.boot_id();
            let same = (desk.record.boot, desk.record.run) == (boot, block.run);
            desk.keep(boot, &block);
            if same && desk.record.samples.len() == before {
                return Err(Fail::Unexpected);
            }
        }
    }
}

impl Record {
    /// Index of the first sample that is not there.
    fn first_missing(&self) -> u32 {
        let mut missing = 0;
        for index in self.samples.keys() {
            if *index != missing {
                break;
            }
            missing += 1;
        }
        missing
    }
}

impl Desk {
    /// True time when `us` of the host's own clock have passed, us.
    fn later(&self, us: u64) -> u64 {
        self.now_us + (us as f64 / self.clock_ratio) as u64
    }

    fn frame(&mut self, message: &ToModule, proof: Option<(Key, Nonce)>) -> (u16, Frame) {
        let mut out = [0; MAX_FRAME];
        let proof = proof.as_ref().map(|(key, nonce)| (key, nonce));
        let (sequence, length) = self
            .client
            .request(message, proof, &mut out)
            .expect("MAX_FRAME suffices");
        self.orders += 1;
        let order = order_of(message).map(|order| (self.orders, order));
        let epoch = self.epochs.get(&self.client.boot_id());
        let epoch = epoch.copied().unwrap_or(u32::MAX);
        let frame = Frame {
            bytes: out[..length].to_vec(),
            order,
            made_us: self.now_us,
            epoch,
        };
        (sequence, frame)
    }
}

/// Longest approach to the start pose, us: the supervisor's limit.
const ARM_MAX_US: u64 = 30_000_000;

fn order_of(message: &ToModule) -> Option<Order> {
    let runs = |duration_ms: u32, countdown_ms: u16| {
        u64::from(duration_ms) * 1_000 + u64::from(countdown_ms) * 1_000 + ARM_MAX_US
    };
    match message {
        ToModule::Start {
            duration_ms,
            countdown_ms,
            ..
        } => Some(Order::Start {
            runs_us: runs(*duration_ms, *countdown_ms),
            lease_us: None,
        }),
        ToModule::StartTethered {
            duration_ms,
            countdown_ms,
            lease_ms,
            ..
        } => Some(Order::Start {
            runs_us: runs(*duration_ms, *countdown_ms),
            lease_us: Some(u64::from(*lease_ms) * 1_000),
        }),
        ToModule::Heartbeat { .. } => Some(Order::Beat),
        ToModule::Stop => Some(Order::Stop),
        ToModule::Zero { joint_mask, .. } => Some(Order::Zero {
            joint_mask: *joint_mask,
        }),
        _ => None,
    }
}
