//! Module side of the link: from bytes to calls of [`ModuleHandler`] and back to bytes. Real firmware and emulators share it.
//!
//! Everything that can be refused without knowing the robot is refused here: other versions and sessions, unknown types, wrong proofs, keys over
//! radio, a second order while one is being carried out. What changes state is done once: the answer to the last such request is kept and given again.

mod handler;
mod orders;

pub use handler::{BusAnswer, Completed, Drivers, ModuleHandler, Outcome, StartOrder, StoredGait};

use heapless::Vec;

use super::auth::{Key, Nonce, TAG_LEN, Tag};
use super::frame::{
    DecodeError, Decoder, Frame, Header, LinkCounters, MAX_FRAME, Message, SOURCE_HOST, UNASKED,
    VERSION, encode, encode_proof,
};
use super::message::{FromModule, MAX_BUS_BYTES, ToModule};
use super::reject::Reject;
use orders::carry_out;

/// The medium of a link, as the board knows it; a frame cannot claim it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Port {
    /// A cable: whoever uses it holds the robot in his hands.
    Wire,
    /// Bluetooth or another radio: whoever is in range can send.
    Radio,
}

/// Age of an open challenge at which it is void, us of the module's clock: an order that was held back on its way moves nothing later than this. Long
/// enough for four tries over a slow radio.
pub const CHALLENGE_LIFE_US: u64 = 5_000_000;

/// Wrong tags that a port looks at one after the other.
pub const TAG_TRIES: u64 = 16;
/// From then on it looks at one in this time, us. A tag of 128 bits cannot be guessed at any rate; the limit bounds what a flood of forged orders costs.
pub const TAG_TRY_US: u64 = 125_000;

/// Largest frame that answers a state-changing request: a `BusReply`.
const MAX_KEPT: usize = cobs::max_encoding_length(13 + 1 + 2 + MAX_BUS_BYTES) + 2;

/// The last state-changing request and its answer.
#[derive(Debug)]
struct Kept {
    sequence: u16,
    fingerprint: u32,
    request: u8,
    /// Empty while the order is being carried out.
    answer: Vec<u8, MAX_KEPT>,
    pending: bool,
}

/// A challenge that was handed out and not yet used.
#[derive(Debug, Clone, Copy)]
struct Challenge {
    nonce: Nonce,
    since_us: u64,
}

/// How many wrong tags came of late: a bucket that holds [`TAG_TRIES`] and loses one every [`TAG_TRY_US`].
#[derive(Debug, Clone, Copy)]
struct Tries {
    empty_at_us: u64,
}

impl Tries {
    fn count(&mut self, now_us: u64) {
        self.empty_at_us = self.empty_at_us.max(now_us).saturating_add(TAG_TRY_US);
    }

    /// Time until the next tag is looked at, us; `None` = now.
    fn wait_us(&self, now_us: u64) -> Option<u64> {
        let filled_us = self.empty_at_us.saturating_sub(now_us);
        let most_us = TAG_TRY_US.saturating_mul(TAG_TRIES.saturating_sub(1));
        filled_us
            .checked_sub(most_us)
            .filter(|wait_us| *wait_us > 0)
    }
}

/// One port's end of the link.
#[derive(Debug)]
pub struct Server {
    port: Port,
    robot_id: u8,
    boot_id: u32,
    decoder: Decoder,
    challenge: Option<Challenge>,
    tries: Tries,
    kept: Option<Kept>,
    next_sequence: u16,
}

#[allow(clippy::large_enum_variant, reason = "no heap to box into")]
enum Reply {
    Message(FromModule),
    /// A message that ends with a tag over the host's nonce.
    Proved(FromModule, Nonce, Key),
    /// The frame of the kept answer.
    Again,
    Nothing,
}

impl Server {
    /// `robot_id` 1..=254, `boot_id` random per boot and not 0.
    #[must_use]
    pub const fn new(port: Port, robot_id: u8, boot_id: u32) -> Self {
        Self {
            port,
            robot_id,
            boot_id,
            decoder: Decoder::new(),
            challenge: None,
            tries: Tries { empty_at_us: 0 },
            kept: None,
            next_sequence: 0,
        }
    }

    /// What was received and discarded so far.
    #[must_use]
    pub fn counters(&self) -> &LinkCounters {
        self.decoder.counters()
    }

    /// Whether an order is being carried out.
    #[must_use]
    pub fn is_pending(&self) -> bool {
        self.kept.as_ref().is_some_and(|kept| kept.pending)
    }

    /// Forgets a half-received frame: after a UART error or a reconnect.
    pub fn restart(&mut self) {
        self.decoder.restart();
    }

    /// Voids the open challenge: what was signed for it and has not arrived will not be carried out. After STOP on any port, at the end of a run and when
    /// the link is lost; age and HELLO are looked after here.
    pub fn void_challenge(&mut self) {
        self.challenge = None;
    }

    /// Takes one byte; when it ended a frame for us, carries it out and returns the length of the answer in `out`.
    /// `now_us` is the time of reception, us since boot.
    pub fn push<H: ModuleHandler>(
        &mut self,
        byte: u8,
        now_us: u64,
        handler: &mut H,
        out: &mut [u8; MAX_FRAME],
    ) -> Option<usize> {
        let frame = self.decoder.push(byte)?;
        let header = frame.header;
        if header.source != SOURCE_HOST {
            self.decoder.count_foreign();
            return None;
        }
        let fingerprint = frame.fingerprint();
        let kind = frame.kind();
        let decoded = frame.decode::<ToModule>();
        let young = |open: &Challenge| now_us.saturating_sub(open.since_us) < CHALLENGE_LIFE_US;
        self.challenge = self.challenge.filter(young);
        let nonce = self.challenge.map(|open| open.nonce);
        let proof = match self.tries.wait_us(now_us) {
            Some(wait_us) if handler.key().is_some() => Proof::Unseen { wait_us },
            _ => Proof::check(&frame, &decoded, nonce.as_ref(), handler),
        };
        if let Err(error) = decoded {
            self.decoder.count(error);
        }
        let is_stop = kind == ToModule::Stop.kind();
        let reply = match decoded {
            // Type numbers never change, so STOP is understood from any version and whatever follows it.
            _ if is_stop => {
                self.challenge = None;
                handler.stop();
                Reply::Message(FromModule::Ack { request: kind })
            }
            Ok(message) => self.dispatch(&header, fingerprint, &message, proof, now_us, handler),
            Err(error) => Reply::Message(FromModule::Nack {
                request: kind,
                reason: refusal(error),
            }),
        };
        self.answer(header.sequence, reply, out)
    }

    /// Ends the pending order; returns the length of its answer in `out`. `None` when nothing was pending.
    pub fn complete(
        &mut self,
        result: Result<Completed, Reject>,
        out: &mut [u8; MAX_FRAME],
    ) -> Option<usize> {
        let kept = self.kept.as_ref().filter(|kept| kept.pending)?;
        let (request, sequence) = (kept.request, kept.sequence);
        let message = match result {
            Ok(completed) => completed.into_message(request),
            Err(reason) => FromModule::Nack { request, reason },
        };
        let len = self.write(sequence, &message, out)?;
        self.keep(out.get(..len).unwrap_or(&[]));
        Some(len)
    }

    /// Writes a message that answers nothing (sample, block, event, end of run) into `out`; returns its length.
    pub fn send(&mut self, message: &FromModule, out: &mut [u8; MAX_FRAME]) -> Option<usize> {
        let sequence = self.next_sequence | UNASKED;
        self.next_sequence = self.next_sequence.wrapping_add(1);
        self.write(sequence, message, out)
    }

    fn answer(&mut self, sequence: u16, reply: Reply, out: &mut [u8; MAX_FRAME]) -> Option<usize> {
        match reply {
            Reply::Nothing => None,
            Reply::Message(message) => self.write(sequence, &message, out),
            Reply::Proved(message, nonce, key) => {
                encode_proof(&self.header(sequence), &message, &key, &nonce, out).ok()
            }
            Reply::Again => {
                let answer = &self.kept.as_ref()?.answer;
                out.get_mut(..answer.len())?.copy_from_slice(answer);
                Some(answer.len())
            }
        }
    }

    fn write(
        &self,
        sequence: u16,
        message: &FromModule,
        out: &mut [u8; MAX_FRAME],
    ) -> Option<usize> {
        encode(&self.header(sequence), message, out).ok()
    }

    fn header(&self, sequence: u16) -> Header {
        Header {
            version: VERSION,
            source: self.robot_id,
            sequence,
            boot_id: self.boot_id,
        }
    }

    fn keep(&mut self, frame: &[u8]) {
        if let Some(kept) = &mut self.kept {
            kept.pending = false;
            kept.answer.clear();
            // MAX_KEPT is the largest answer of any state-changing request.
            let _ = kept.answer.extend_from_slice(frame);
        }
    }

    fn dispatch<H: ModuleHandler>(
        &mut self,
        header: &Header,
        fingerprint: u32,
        message: &ToModule,
        proof: Proof,
        now_us: u64,
        handler: &mut H,
    ) -> Reply {
        let request = message.kind();
        let nack = |reason| Reply::Message(FromModule::Nack { request, reason });
        if header.boot_id != self.boot_id
            && !matches!(message, ToModule::Hello { .. } | ToModule::GetInfo)
        {
            return nack(Reject::OtherSession);
        }
        if let ToModule::ProveState { nonce } = message {
            let info = handler.info();
            let answer = FromModule::State {
                state: info.state,
                uptime_us: info.uptime_us,
                tag: Tag::NONE,
            };
            return match handler.key() {
                Some(key) => Reply::Proved(answer, *nonce, key),
                None => Reply::Message(answer),
            };
        }
        if !message.changes_state() {
            return Reply::Message(self.read(message, now_us, handler));
        }
        if let Some(kept) = &self.kept {
            if kept.sequence == header.sequence && kept.fingerprint == fingerprint {
                return if kept.pending {
                    Reply::Nothing
                } else {
                    Reply::Again
                };
            }
            if kept.pending {
                return nack(Reject::Busy);
            }
        }
        if let Err(reason) = self.admit(message, proof, now_us, handler) {
            return nack(reason);
        }
        self.kept = Some(Kept {
            sequence: header.sequence,
            fingerprint,
            request,
            answer: Vec::new(),
            pending: true,
        });
        let result = match carry_out(message, handler) {
            Ok(None) => return Reply::Nothing,
            Ok(Some(completed)) => Ok(completed),
            Err(reason) => Err(reason),
        };
        let mut out = [0; MAX_FRAME];
        match self.complete(result, &mut out) {
            Some(_) => Reply::Again,
            None => Reply::Nothing,
        }
    }

    /// Whether a state-changing request may be carried out. An accepted tag consumes its nonce.
    fn admit<H: ModuleHandler>(
        &mut self,
        message: &ToModule,
        proof: Proof,
        now_us: u64,
        handler: &mut H,
    ) -> Result<(), Reject> {
        if message.tag().is_none() {
            return match self.port {
                Port::Wire => Ok(()),
                Port::Radio => Err(Reject::WirePortOnly),
            };
        }
        match (proof, self.port) {
            (Proof::NoKey, Port::Wire) => Ok(()),
            (Proof::NoKey, Port::Radio) => Err(Reject::NoKey),
            (Proof::NoNonce, _) => Err(Reject::NoChallenge),
            (Proof::Right, _) => {
                self.challenge = None;
                Ok(())
            }
            (Proof::Wrong, _) => {
                self.tries.count(now_us);
                handler.bad_tag(message.kind());
                Err(Reject::BadTag)
            }
            (Proof::Unseen { wait_us }, _) => Err(Reject::TooManyTags {
                // At most one TAG_TRY_US.
                wait_ms: u16::try_from(wait_us.div_ceil(1_000)).unwrap_or(u16::MAX),
            }),
        }
    }

    /// Requests that change nothing but what this port sends.
    fn read<H: ModuleHandler>(
        &mut self,
        message: &ToModule,
        now_us: u64,
        handler: &mut H,
    ) -> FromModule {
        let request = message.kind();
        let nack = |reason| FromModule::Nack { request, reason };
        match *message {
            ToModule::Hello { protocol } if protocol != VERSION => nack(Reject::Version {
                theirs: protocol,
                ours: VERSION,
            }),
            ToModule::Hello { .. } => {
                // Another host, or the same one anew: what was signed before is of another session.
                self.challenge = None;
                FromModule::Hello(handler.hello())
            }
            ToModule::GetInfo => {
                let mut info = handler.info();
                info.counters.link = *self.decoder.counters();
                FromModule::Info(info)
            }
            ToModule::GetChallenge => match self.open_challenge(now_us, handler) {
                Ok(nonce) => FromModule::Challenge { nonce },
                Err(reason) => nack(reason),
            },
            ToModule::GetGait { slot } => match handler.get_gait(slot) {
                Ok((digest, gait)) => FromModule::GaitData { slot, digest, gait },
                Err(reason) => nack(reason),
            },
            ToModule::ListSlots => {
                let (active, slots) = handler.slots();
                FromModule::Slots { active, slots }
            }
            ToModule::Ping { host_t_us } => FromModule::Pong {
                host_t_us,
                module_t_us: now_us,
            },
            ToModule::Subscribe { rate } => match handler.subscribe(rate) {
                Ok(()) => FromModule::Ack { request },
                Err(reason) => nack(reason),
            },
            ToModule::GetEvents { since } => {
                let mut events = Vec::new();
                let (next, lost) = handler.events(since, &mut events);
                FromModule::Events { next, lost, events }
            }
            ToModule::Drain { from_sample } => match handler.drain(from_sample) {
                Ok(block) => block.into(),
                Err(reason) => nack(reason),
            },
            ToModule::GetCrash => FromModule::Crash(handler.crash()),
            ToModule::GetDrivers => {
                let (profile, wrong) = handler.drivers();
                FromModule::Drivers { profile, wrong }
            }
            ToModule::GetRobot => match handler.robot() {
                Ok(robot) => FromModule::Robot(robot),
                Err(reason) => nack(reason),
            },
            // These are answered before; orders go through `carry_out`.
            ToModule::Stop
            | ToModule::ProveState { .. }
            | ToModule::StartTethered { .. }
            | ToModule::Heartbeat { .. }
            | ToModule::ChangeGait { .. }
            | ToModule::SetDrivers { .. }
            | ToModule::SetRobot { .. }
            | ToModule::PutGait { .. }
            | ToModule::ActivateSlot { .. }
            | ToModule::EraseSlot { .. }
            | ToModule::Start { .. }
            | ToModule::ClearFault { .. }
            | ToModule::Zero { .. }
            | ToModule::BusRaw { .. }
            | ToModule::SetKey { .. }
            | ToModule::Reset { .. } => nack(Reject::Unsupported),
        }
    }

    /// The open challenge, or a new one.
    fn open_challenge<H: ModuleHandler>(
        &mut self,
        now_us: u64,
        handler: &mut H,
    ) -> Result<Nonce, Reject> {
        if let Some(open) = self.challenge {
            return Ok(open.nonce);
        }
        let nonce = handler.fresh_nonce()?;
        self.challenge = Some(Challenge {
            nonce,
            since_us: now_us,
        });
        Ok(nonce)
    }
}

/// What the tag of an order is worth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Proof {
    /// No key is set.
    NoKey,
    /// No challenge is open.
    NoNonce,
    /// Right.
    Right,
    /// Wrong, or the message carries none.
    Wrong,
    /// Not looked at: too many were wrong.
    Unseen {
        /// For so long, us.
        wait_us: u64,
    },
}

impl Proof {
    /// Checks the bytes as received, not as re-encoded. The tag is the end of the payload.
    fn check<H: ModuleHandler>(
        frame: &Frame<'_>,
        decoded: &Result<ToModule, DecodeError>,
        nonce: Option<&Nonce>,
        handler: &H,
    ) -> Self {
        let Some(tag) = decoded.as_ref().ok().and_then(ToModule::tag) else {
            return Self::Wrong;
        };
        let Some(key) = handler.key() else {
            return Self::NoKey;
        };
        let Some(nonce) = nonce else {
            return Self::NoNonce;
        };
        let signed = frame
            .payload()
            .split_last_chunk::<TAG_LEN>()
            .map_or(frame.payload(), |(signed, _)| signed);
        if key.verify(nonce, frame.kind(), signed, tag) {
            Self::Right
        } else {
            Self::Wrong
        }
    }
}

fn refusal(error: DecodeError) -> Reject {
    match error {
        DecodeError::Version { theirs } => Reject::Version {
            theirs,
            ours: VERSION,
        },
        DecodeError::UnknownType { kind } => Reject::UnknownType { kind },
        DecodeError::Malformed => Reject::Malformed,
        DecodeError::TrailingBytes => Reject::TrailingBytes,
    }
}
