//! A conversation with one robot.

use std::collections::VecDeque;
use std::time::Duration;

use control::machine::Machine;
use control::robot::RobotModel;
use protocol::link::{
    Client, FromModule, Hello, Info, Key, MAX_FRAME, ModuleState, Nonce, Reject, Tag, ToModule,
    VERSION,
};

use super::keys::{KeyStore, new_nonce};
use super::{Link, LinkError};
use crate::interrupt;

/// Times a request is sent before it counts as unanswered. The module does a repeated request once.
const TRIES: u32 = 4;
/// Longest single wait for bytes: how late Ctrl-C is noticed.
const SLICE: Duration = Duration::from_millis(20);
/// Unasked messages kept for [`Robot::next`] while an answer is awaited; beyond that the oldest go (they can be drained).
const INBOX: usize = 4096;

/// Round trip and clock of the module.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pong {
    /// Round-trip time.
    pub round_trip: Duration,
    /// Module clock, us since boot.
    pub module_us: u64,
    /// Link time at the middle of the round trip.
    pub host: Duration,
}

/// What is known after a STOP.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stopped {
    /// Somebody acknowledged it; without a key nobody can say who.
    Acknowledged,
    /// The robot proved with its key that it stops.
    Proved,
}

/// A robot that said HELLO.
pub struct Robot {
    link: Box<dyn Link>,
    client: Client,
    timeout: Duration,
    key: Option<Key>,
    hello: Hello,
    inbox: VecDeque<FromModule>,
    heed_interrupt: bool,
    _grace: interrupt::Guard,
}

impl core::fmt::Debug for Robot {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Robot")
            .field("uri", self.link.uri())
            .field("hello", &self.hello)
            .finish_non_exhaustive()
    }
}

/// Name of a request in messages to people.
fn name(message: &ToModule) -> &'static str {
    match message {
        ToModule::Hello { .. } => "HELLO",
        ToModule::GetInfo => "info",
        ToModule::GetChallenge => "challenge",
        ToModule::PutGait { .. } => "upload",
        ToModule::GetGait { .. } => "download",
        ToModule::ListSlots => "slots",
        ToModule::ActivateSlot { .. } => "activate",
        ToModule::EraseSlot { .. } => "erase",
        ToModule::Start { .. } => "start",
        ToModule::Stop => "STOP",
        ToModule::ClearFault { .. } => "clear fault",
        ToModule::Zero { .. } => "zero",
        ToModule::Ping { .. } => "ping",
        ToModule::Subscribe { .. } => "subscribe",
        ToModule::GetEvents { .. } => "events",
        ToModule::Drain { .. } => "drain",
        ToModule::BusRaw { .. } => "bus order",
        ToModule::SetKey { .. } => "set key",
        ToModule::Reset { .. } => "reset",
        ToModule::GetCrash => "crash record",
        ToModule::StartTethered { .. } => "start",
        ToModule::Heartbeat { .. } => "heartbeat",
        ToModule::ProveState { .. } => "proof of its state",
        ToModule::ChangeGait { .. } => "change of gait",
        ToModule::SetDrivers { .. } => "change of drivers",
        ToModule::GetDrivers => "drivers",
        ToModule::SetRobot { .. } => "change of robot",
        ToModule::GetRobot => "robot",
    }
}

impl Robot {
    /// Says HELLO over an open link. The key for orders is looked up under the robot's id.
    ///
    /// # Errors
    /// [`LinkError`]; [`LinkError::Version`] names both versions.
    pub fn connect(
        link: Box<dyn Link>,
        timeout: Duration,
        keys: &KeyStore,
    ) -> Result<Self, LinkError> {
        let nothing = Hello {
            protocol: VERSION,
            robot_id: 0,
            boot_id: 0,
            firmware: heapless::String::new(),
            model_digest: protocol::link::Digest::default(),
            keyed: false,
        };
        let mut robot = Self {
            link,
            client: Client::new(first_sequence()),
            timeout,
            key: None,
            hello: nothing,
            inbox: VecDeque::new(),
            heed_interrupt: true,
            _grace: interrupt::grace("stopping"),
        };
        robot.say_hello()?;
        robot.key = keys.load(robot.hello.robot_id);
        Ok(robot)
    }

    fn say_hello(&mut self) -> Result<(), LinkError> {
        match self.ask(&ToModule::Hello { protocol: VERSION })? {
            FromModule::Hello(hello) if hello.protocol == VERSION => {
                self.hello = hello;
                Ok(())
            }
            FromModule::Hello(hello) => Err(LinkError::version(hello.protocol)),
            _ => Err(LinkError::WrongAnswer { request: "HELLO" }),
        }
    }

    /// What the module said about itself.
    #[must_use]
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// The link.
    #[must_use]
    pub fn link(&self) -> &dyn Link {
        self.link.as_ref()
    }

    /// Uses another key from now on.
    pub fn set_key(&mut self, key: Key) {
        self.key = Some(key);
        self.hello.keyed = true;
    }

    /// Whether this host has a key for the robot.
    #[must_use]
    pub fn has_key(&self) -> bool {
        self.key.is_some()
    }

    /// Keeps going when Ctrl-C is pressed: for the orders that bring the robot to rest.
    pub fn finish_in_peace(&mut self) {
        self.heed_interrupt = false;
    }

    /// Sends a request, signed if it is an order, and returns its answer. A refusal is an error.
    ///
    /// # Errors
    /// [`LinkError`]
    pub fn ask(&mut self, message: &ToModule) -> Result<FromModule, LinkError> {
        match self.ask_once(message) {
            // The module forgot the session (it restarted, or another host said HELLO): introduce ourselves and see.
            Err(LinkError::Refused {
                reason: Reject::OtherSession,
                ..
            }) if !matches!(message, ToModule::Hello { .. }) => {
                self.resume()?;
                self.ask_once(message)
            }
            // The challenge was voided between its answer and the order, by its age or by somebody's STOP or HELLO: nothing has changed, sign anew.
            Err(LinkError::Refused {
                reason: Reject::NoChallenge,
                ..
            }) if self.key.is_some() && message.tag().is_some() => self.ask_once(message),
            // Somebody tries tags on this link: our order was not looked at.
            Err(LinkError::Refused {
                reason: Reject::TooManyTags { wait_ms },
                ..
            }) => {
                self.wait(Duration::from_millis(wait_ms.into()))?;
                self.ask_once(message)
            }
            other => other,
        }
    }

    /// Listens for this long.
    fn wait(&mut self, time: Duration) -> Result<(), LinkError> {
        let until = self.link.now() + time;
        while self.link.now() < until {
            self.check_interrupt()?;
            let wait = until.saturating_sub(self.link.now()).min(SLICE);
            self.pump(wait, None)?;
        }
        Ok(())
    }

    /// HELLO again after a reconnect: fails if the module has restarted since.
    ///
    /// # Errors
    /// [`LinkError::Restarted`] and those of [`Robot::ask`].
    pub fn resume(&mut self) -> Result<(), LinkError> {
        let before = self.hello.boot_id;
        self.client.restart();
        self.say_hello()?;
        let now = self.hello.boot_id;
        if now == before {
            Ok(())
        } else {
            Err(LinkError::Restarted { before, now })
        }
    }

    /// Opens the link again, trying until `patience` of the link's time has passed, and resumes the session.
    ///
    /// # Errors
    /// The last [`LinkError`] when patience is at an end, or [`LinkError::Restarted`].
    pub fn reconnect(&mut self, patience: Duration) -> Result<(), LinkError> {
        let until = self.link.now() + patience;
        loop {
            let result = self.link.reconnect().and_then(|()| self.resume());
            match result {
                Err(error) if error.is_lost_link() && self.link.now() < until => {
                    self.check_interrupt()?;
                    std::thread::sleep(Duration::from_millis(200));
                }
                // The port was open before: that it does not open again is a matter of the link.
                other => return other.map_err(LinkError::gone),
            }
        }
    }

    fn ask_once(&mut self, message: &ToModule) -> Result<FromModule, LinkError> {
        let request = name(message);
        let proof = self.proof(message)?;
        let mut frame = [0; MAX_FRAME];
        let proof = proof.as_ref().map(|(key, nonce)| (key, nonce));
        let (sequence, length) = self
            .client
            .request(message, proof, &mut frame)
            .map_err(|_| LinkError::TooLarge { request })?;
        for _ in 0..TRIES {
            self.link.send(&frame[..length])?;
            let until = self.link.now() + self.timeout / TRIES;
            while self.link.now() < until {
                self.check_interrupt()?;
                let wait = until.saturating_sub(self.link.now()).min(SLICE);
                if let Some(answer) = self.pump(wait, Some((sequence, message)))? {
                    return match answer {
                        FromModule::Nack { reason, .. } => Err(refusal(request, reason)),
                        answer => Ok(answer),
                    };
                }
            }
        }
        Err(LinkError::Timeout {
            request,
            waited: self.timeout,
            tries: TRIES,
        })
    }

    /// Key and nonce for an order; none for other messages, and none without a key (a module without key takes orders on
    /// its wire port).
    fn proof(&mut self, message: &ToModule) -> Result<Option<(Key, Nonce)>, LinkError> {
        if message.tag().is_none() || !self.hello.keyed {
            return Ok(None);
        }
        let Some(key) = self.key else {
            return Err(LinkError::NoKey {
                request: name(message),
                robot_id: self.hello.robot_id,
            });
        };
        match self.ask(&ToModule::GetChallenge)? {
            FromModule::Challenge { nonce } => Ok(Some((key, nonce))),
            _ => Err(LinkError::WrongAnswer {
                request: "challenge",
            }),
        }
    }

    /// Reads for up to `wait`; returns the answer to `request` (its sequence number) if it came. Everything unasked goes to
    /// the inbox.
    fn pump(
        &mut self,
        wait: Duration,
        request: Option<(u16, &ToModule)>,
    ) -> Result<Option<FromModule>, LinkError> {
        let awaited = request.map(|(sequence, _)| sequence);
        let draining = matches!(request, Some((_, ToModule::Drain { .. })));
        let mut bytes = Vec::new();
        self.link.receive(wait, &mut bytes)?;
        let mut answer = None;
        for byte in bytes {
            let before = self.client.boot_id();
            let received = match self.client.push(byte) {
                None => continue,
                Some(Err(protocol::link::DecodeError::Version { theirs })) => {
                    return Err(LinkError::version(theirs));
                }
                Some(Err(_)) => continue,
                Some(Ok(received)) => received,
            };
            let unasked = is_unasked(&received.message, draining);
            if !unasked && awaited == Some(received.header.sequence) {
                answer = Some(received.message);
            } else if unasked
                || matches!(
                    received.message,
                    FromModule::SampleBlock(_) | FromModule::SampleBlockOf(_)
                )
            {
                let now = received.header.boot_id;
                if before != 0 && now != before {
                    return Err(LinkError::Restarted { before, now });
                }
                if self.inbox.len() == INBOX {
                    self.inbox.pop_front();
                }
                self.inbox.push_back(received.message);
            }
        }
        Ok(answer)
    }

    /// The next unasked message, waiting up to `wait`.
    ///
    /// # Errors
    /// [`LinkError`]
    pub fn next(&mut self, wait: Duration) -> Result<Option<FromModule>, LinkError> {
        let until = self.link.now() + wait;
        loop {
            if let Some(message) = self.inbox.pop_front() {
                return Ok(Some(message));
            }
            let now = self.link.now();
            if now >= until {
                return Ok(None);
            }
            self.check_interrupt()?;
            self.pump((until - now).min(SLICE), None)?;
        }
    }

    /// Forgets the end and the record of runs that came so far: a run that has just been accepted is another one.
    pub fn forget_runs(&mut self) {
        self.inbox.retain(|message| {
            !matches!(
                message,
                FromModule::RunEnd(_) | FromModule::SampleBlock(_) | FromModule::SampleBlockOf(_)
            )
        });
    }

    fn check_interrupt(&self) -> Result<(), LinkError> {
        if self.heed_interrupt && interrupt::pressed() {
            Err(LinkError::Interrupted)
        } else {
            Ok(())
        }
    }

    /// State of the module.
    ///
    /// # Errors
    /// [`LinkError`]
    pub fn info(&mut self) -> Result<Info, LinkError> {
        match self.ask(&ToModule::GetInfo)? {
            FromModule::Info(info) => Ok(info),
            _ => Err(LinkError::WrongAnswer { request: "info" }),
        }
    }

    /// An order answered with nothing but "done".
    ///
    /// # Errors
    /// [`LinkError`]
    pub fn order(&mut self, message: &ToModule) -> Result<(), LinkError> {
        match self.ask(message)? {
            FromModule::Ack { .. } => Ok(()),
            _ => Err(LinkError::WrongAnswer {
                request: name(message),
            }),
        }
    }

    /// STOP, and the proof that it was this robot that stopped, if this host has its key.
    ///
    /// # Errors
    /// [`LinkError::Unproved`] when the answer is not the robot's, [`LinkError::StillMoving`] when it is and the robot moves.
    pub fn stop(&mut self) -> Result<Stopped, LinkError> {
        self.order(&ToModule::Stop)?;
        let Some(key) = self.key else {
            return Ok(Stopped::Acknowledged);
        };
        let nonce = new_nonce().map_err(|_| LinkError::Unproved)?;
        let answer = match self.ask(&ToModule::ProveState { nonce }) {
            Err(LinkError::Refused { .. }) => return Err(LinkError::Unproved),
            answer => answer?,
        };
        match answer {
            FromModule::State { state, .. } if key.proves(&nonce, &answer) => match state {
                ModuleState::Armed | ModuleState::Run => Err(LinkError::StillMoving),
                _ => Ok(Stopped::Proved),
            },
            _ => Err(LinkError::Unproved),
        }
    }

    /// Tells the robot of a tethered run that this host is still there, within `patience`.
    ///
    /// # Errors
    /// [`LinkError`]
    pub fn heartbeat(&mut self, patience: Duration) -> Result<(), LinkError> {
        let timeout = core::mem::replace(&mut self.timeout, patience);
        let result = self.order(&ToModule::Heartbeat { tag: Tag::NONE });
        self.timeout = timeout;
        result
    }

    /// Round trip and module clock.
    ///
    /// # Errors
    /// [`LinkError`]
    pub fn ping(&mut self) -> Result<Pong, LinkError> {
        let sent = self.link.now();
        let host_t_us = u64::try_from(sent.as_micros()).unwrap_or(u64::MAX);
        match self.ask(&ToModule::Ping { host_t_us })? {
            FromModule::Pong { module_t_us, .. } => {
                let round_trip = self.link.now().saturating_sub(sent);
                Ok(Pong {
                    round_trip,
                    module_us: module_t_us,
                    host: sent + round_trip / 2,
                })
            }
            _ => Err(LinkError::WrongAnswer { request: "ping" }),
        }
    }
}

impl Robot {
    /// Which robot it is. One whose firmware is older than the question is a meta-module.
    ///
    /// # Errors
    /// [`LinkError`]
    pub fn machine(&mut self) -> Result<Machine, LinkError> {
        match self.ask(&ToModule::GetRobot) {
            Ok(FromModule::Robot(robot)) => {
                let machine = robot.machine(&RobotModel::default());
                machine.map_err(|_| LinkError::WrongAnswer { request: "robot" })
            }
            Ok(_) => Err(LinkError::WrongAnswer { request: "robot" }),
            Err(LinkError::Refused {
                reason: Reject::UnknownType { .. } | Reject::Unsupported,
                ..
            }) => Ok(Machine::default()),
            Err(error) => Err(error),
        }
    }
}

fn refusal(request: &'static str, reason: Reject) -> LinkError {
    match reason {
        Reject::Version { ours, .. } => LinkError::version(ours),
        reason => LinkError::Refused { request, reason },
    }
}

/// Messages that a module sends by itself. A sample block is the answer to `Drain`, but also comes unasked.
fn is_unasked(message: &FromModule, draining: bool) -> bool {
    match message {
        FromModule::Sample(_)
        | FromModule::SampleOf(_)
        | FromModule::Event(_)
        | FromModule::RunEnd(_) => true,
        FromModule::SampleBlock(_) | FromModule::SampleBlockOf(_) => !draining,
        _ => false,
    }
}

/// Differs between runs of this program, so that a late answer to an earlier one is not taken for ours.
fn first_sequence() -> u16 {
    let since = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .unwrap_or_default();
    (since.as_millis() as u16) ^ (std::process::id() as u16)
}
