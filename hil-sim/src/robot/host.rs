//! A host for tests and benches: asks over the emulated cable and waits in virtual time.

use super::EmulatedRobot;
use super::link::LinkLine;
use super::wire::MotorBus;
use control::gait::Gait;
use control::machine::all_joints;
use protocol::link::{
    Client, Digest, Event, EventKind, FromModule, Key, MAX_FRAME, Nonce, Reject, RunEnd, Sample,
    SampleBlock, Tag, TelemetryRate, ToModule, WireGait,
};

/// How long an answer may take, us of virtual time.
pub const PATIENCE_US: u64 = 2_000_000;

/// Why a request failed.
#[derive(Debug, Clone, PartialEq)]
pub enum AskError {
    /// No answer in [`PATIENCE_US`].
    Timeout,
    /// The module refused.
    Rejected(Reject),
    /// An answer of another type.
    Unexpected(Box<FromModule>),
}

/// The host's end of the cable and what has come unasked.
#[derive(Debug)]
pub struct SimHost {
    client: Client,
    line: LinkLine,
    key: Option<Key>,
    draining: bool,
    /// Events received unasked.
    pub events: Vec<Event>,
    /// Blocks received unasked.
    pub blocks: Vec<SampleBlock>,
    /// Live samples received.
    pub live: Vec<Sample>,
    /// Ends of runs received.
    pub ends: Vec<RunEnd>,
}

impl SimHost {
    /// A host on this line that has not said HELLO yet.
    #[must_use]
    pub fn new(line: LinkLine) -> Self {
        Self {
            client: Client::new(1),
            line,
            key: None,
            draining: false,
            events: Vec::new(),
            blocks: Vec::new(),
            live: Vec::new(),
            ends: Vec::new(),
        }
    }

    /// The key to sign orders with.
    pub fn set_key(&mut self, key: Option<Key>) {
        self.key = key;
    }

    /// The bytes of a request, for tests that damage them. Not sent.
    pub fn frame(&mut self, message: &ToModule) -> Vec<u8> {
        let mut out = [0; MAX_FRAME];
        let (_, len) = self
            .client
            .request(message, None, &mut out)
            .expect("MAX_FRAME suffices");
        out[..len].to_vec()
    }

    /// The bytes of an order, signed for the challenge that is open now. Not sent.
    ///
    /// # Errors
    /// See [`SimHost::ask`].
    pub fn signed_frame<M: MotorBus>(
        &mut self,
        robot: &mut EmulatedRobot<M>,
        message: &ToModule,
    ) -> Result<Vec<u8>, AskError> {
        let proof = self.proof(robot, message)?;
        let mut out = [0; MAX_FRAME];
        let proof = proof.as_ref().map(|(key, nonce)| (key, nonce));
        let (_, len) = self
            .client
            .request(message, proof, &mut out)
            .expect("MAX_FRAME suffices");
        Ok(out[..len].to_vec())
    }

    fn proof<M: MotorBus>(
        &mut self,
        robot: &mut EmulatedRobot<M>,
        message: &ToModule,
    ) -> Result<Option<(Key, Nonce)>, AskError> {
        match (self.key, message.tag()) {
            (Some(key), Some(_)) => match self.ask(robot, &ToModule::GetChallenge)? {
                FromModule::Challenge { nonce } => Ok(Some((key, nonce))),
                other => Err(AskError::Unexpected(Box::new(other))),
            },
            _ => Ok(None),
        }
    }

    /// Sends a request and waits for its answer; everything else that comes is kept.
    ///
    /// # Errors
    /// [`AskError::Timeout`], or [`AskError::Rejected`] for a refusal.
    pub fn ask<M: MotorBus>(
        &mut self,
        robot: &mut EmulatedRobot<M>,
        message: &ToModule,
    ) -> Result<FromModule, AskError> {
        let nonce = self.proof(robot, message)?;
        let mut out = [0; MAX_FRAME];
        let proof = nonce.as_ref().map(|(key, nonce)| (key, nonce));
        let (sequence, len) = self
            .client
            .request(message, proof, &mut out)
            .expect("MAX_FRAME suffices");
        self.line.write(&out[..len]);
        self.draining = matches!(message, ToModule::Drain { .. });
        let give_up_us = robot.now_us() + PATIENCE_US;
        while robot.now_us() < give_up_us {
            if let Some(answer) = self.receive(Some(sequence)) {
                return match answer {
                    FromModule::Nack { reason, .. } => Err(AskError::Rejected(reason)),
                    answer => Ok(answer),
                };
            }
            robot.run_until((robot.now_us() + 1_000).min(give_up_us));
        }
        Err(AskError::Timeout)
    }

    /// Takes what has arrived; returns the answer to `sequence` if it is among it.
    pub fn receive(&mut self, sequence: Option<u16>) -> Option<FromModule> {
        let mut bytes = Vec::new();
        self.line.read(&mut bytes);
        let mut answer = None;
        for byte in bytes {
            let Some(Ok(received)) = self.client.push(byte) else {
                continue;
            };
            match received.message {
                FromModule::Event(event) => self.events.push(event),
                // Unasked messages count their own sequence, so a block is an answer only to `Drain`.
                FromModule::SampleBlock(block) | FromModule::SampleBlockOf(block)
                    if !self.draining || Some(received.header.sequence) != sequence =>
                {
                    self.blocks.push(block);
                }
                FromModule::Sample(sample) | FromModule::SampleOf(sample) => {
                    self.live.push(sample);
                }
                FromModule::RunEnd(end) => self.ends.push(end),
                other if Some(received.header.sequence) == sequence => answer = Some(other),
                _ => {}
            }
        }
        answer
    }

    /// Forgets half-received bytes after a reconnect.
    pub fn restart(&mut self) {
        self.client.restart();
    }

    /// Says HELLO.
    ///
    /// # Errors
    /// See [`SimHost::ask`].
    pub fn hello<M: MotorBus>(
        &mut self,
        robot: &mut EmulatedRobot<M>,
    ) -> Result<FromModule, AskError> {
        self.ask(
            robot,
            &ToModule::Hello {
                protocol: protocol::link::VERSION,
            },
        )
    }

    /// HELLO and zero on all joints, once the drivers have been read.
    ///
    /// # Errors
    /// See [`SimHost::ask`].
    pub fn home<M: MotorBus>(&mut self, robot: &mut EmulatedRobot<M>) -> Result<(), AskError> {
        robot.run_for(200_000);
        self.hello(robot)?;
        let joints = match self.ask(robot, &ToModule::GetRobot)? {
            FromModule::Robot(robot) => robot.speeds_rad_s.len() as u8,
            other => return Err(AskError::Unexpected(Box::new(other))),
        };
        let (joint_mask, tag) = (all_joints(joints), Tag::NONE);
        self.ask(robot, &ToModule::Zero { joint_mask, tag })?;
        Ok(())
    }

    /// Uploads a gait; returns the fingerprint that the module read back.
    ///
    /// # Errors
    /// See [`SimHost::ask`].
    pub fn upload<M: MotorBus>(
        &mut self,
        robot: &mut EmulatedRobot<M>,
        slot: u8,
        gait: &Gait,
    ) -> Result<Digest, AskError> {
        let message = put(slot, gait);
        match self.ask(robot, &message)? {
            FromModule::GaitStored { digest, .. } => Ok(digest),
            other => Err(AskError::Unexpected(Box::new(other))),
        }
    }

    /// Starts a slot.
    ///
    /// # Errors
    /// See [`SimHost::ask`].
    pub fn start<M: MotorBus>(
        &mut self,
        robot: &mut EmulatedRobot<M>,
        slot: u8,
        digest: Digest,
        duration_ms: u32,
        rate: TelemetryRate,
    ) -> Result<FromModule, AskError> {
        self.ask(
            robot,
            &ToModule::Start {
                slot,
                digest,
                duration_ms,
                rate,
                countdown_ms: 0,
                tag: Tag::NONE,
            },
        )
    }

    /// Runs the robot and collects what comes, until a run has ended or `limit_us` of virtual time have passed.
    pub fn wait_for_end<M: MotorBus>(
        &mut self,
        robot: &mut EmulatedRobot<M>,
        limit_us: u64,
    ) -> Option<RunEnd> {
        let (before, until_us) = (self.ends.len(), robot.now_us() + limit_us);
        while self.ends.len() == before && robot.now_us() < until_us {
            robot.run_for(20_000);
            self.receive(None);
        }
        self.ends.get(before).copied()
    }

    /// Asks for all blocks of the last run from a sample on.
    ///
    /// # Errors
    /// See [`SimHost::ask`].
    pub fn drain<M: MotorBus>(
        &mut self,
        robot: &mut EmulatedRobot<M>,
        from_sample: u32,
    ) -> Result<Vec<SampleBlock>, AskError> {
        let mut blocks: Vec<SampleBlock> = Vec::new();
        loop {
            let from_sample = blocks
                .last()
                .map_or(from_sample, |block| block.first + u32::from(block.count));
            match self.ask(robot, &ToModule::Drain { from_sample })? {
                FromModule::SampleBlock(block) | FromModule::SampleBlockOf(block) => {
                    if block.count == 0 {
                        return Ok(blocks);
                    }
                    blocks.push(block);
                }
                other => return Err(AskError::Unexpected(Box::new(other))),
            }
        }
    }

    /// Whether an event like this came unasked.
    pub fn saw(&self, test: impl Fn(&EventKind) -> bool) -> bool {
        self.events.iter().any(|event| test(&event.kind))
    }
}

/// The upload of a gait.
#[must_use]
pub fn put(slot: u8, gait: &Gait) -> ToModule {
    ToModule::PutGait {
        slot,
        activate: false,
        gait: WireGait::from(gait),
        tag: Tag::NONE,
    }
}
