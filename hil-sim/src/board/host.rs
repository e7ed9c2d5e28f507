//! A host for tests and benches: asks the board over its cable and waits in guest time.

use control::gait::Gait;
use protocol::link::{
    Client, Digest, EncodeError, FromModule, Key, MAX_FRAME, Reject, RunEnd, SampleBlock, Tag,
    TelemetryRate, ToModule,
};
use thiserror::Error;

use super::runner::{BoardError, BoardRunner, BusPeer};
use super::wire::Port;
use crate::robot::host::put;

/// How long an answer may take, ns of guest time.
pub const PATIENCE_NS: u64 = 2_000_000_000;
/// Guest time after power-up until the drivers have been read.
const SETTLE_NS: u64 = 200_000_000;

/// Why a request failed.
#[derive(Debug, Error)]
pub enum AskError {
    /// The board itself.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// The request cannot be put into a frame.
    #[error("the request does not fit a frame: {0:?}")]
    Request(EncodeError),
    /// No answer in [`PATIENCE_NS`].
    #[error("no answer within 2 s of guest time")]
    Timeout,
    /// The module refused.
    #[error("the module refused: {0:?}")]
    Rejected(Reject),
    /// An answer of another type.
    #[error("unexpected answer: {0:?}")]
    Unexpected(Box<FromModule>),
}

/// The host's end of one link and what has come unasked.
#[derive(Debug)]
pub struct BoardHost {
    client: Client,
    port: Port,
    key: Option<Key>,
    /// Telemetry received unasked.
    pub blocks: Vec<SampleBlock>,
    /// Ends of runs received.
    pub ends: Vec<RunEnd>,
}

impl BoardHost {
    /// A host on this port that has not said HELLO yet.
    #[must_use]
    pub fn new(port: Port) -> Self {
        Self {
            client: Client::new(1),
            port,
            key: None,
            blocks: Vec::new(),
            ends: Vec::new(),
        }
    }

    /// The key to sign orders with.
    pub fn set_key(&mut self, key: Option<Key>) {
        self.key = key;
    }

    /// Sends a request and waits for its answer; everything else that comes is kept.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn ask<B: BusPeer>(
        &mut self,
        board: &mut BoardRunner<B>,
        message: &ToModule,
    ) -> Result<FromModule, AskError> {
        let proof = match (self.key, message.tag()) {
            (Some(key), Some(_)) => match self.ask(board, &ToModule::GetChallenge)? {
                FromModule::Challenge { nonce } => Some((key, nonce)),
                other => return Err(AskError::Unexpected(Box::new(other))),
            },
            _ => None,
        };
        let mut out = [0; MAX_FRAME];
        let proof = proof.as_ref().map(|(key, nonce)| (key, nonce));
        let request = self.client.request(message, proof, &mut out);
        let (sequence, length) = request.map_err(AskError::Request)?;
        board.send(self.port, &out[..length]);
        let give_up_ns = board.now_ns() + PATIENCE_NS;
        while board.now_ns() < give_up_ns {
            board.run_until_received(self.port, give_up_ns)?;
            match self.receive(board, Some(sequence)) {
                Some(FromModule::Nack { reason, .. }) => return Err(AskError::Rejected(reason)),
                Some(answer) => return Ok(answer),
                None => {}
            }
        }
        Err(AskError::Timeout)
    }

    /// Takes what has arrived; returns the answer to `sequence` if it is among it.
    pub fn receive<B: BusPeer>(
        &mut self,
        board: &mut BoardRunner<B>,
        sequence: Option<u16>,
    ) -> Option<FromModule> {
        let mut answer = None;
        for byte in board.receive(self.port) {
            let Some(Ok(received)) = self.client.push(byte) else {
                continue;
            };
            let asked = Some(received.header.sequence) == sequence;
            match received.message {
                FromModule::SampleBlock(block) if !asked => self.blocks.push(block),
                FromModule::RunEnd(end) => self.ends.push(end),
                // Events and live samples number themselves.
                FromModule::Event(_) | FromModule::Sample(_) | FromModule::SampleOf(_) => {}
                other if asked => answer = Some(other),
                _ => {}
            }
        }
        answer
    }

    /// HELLO, and zero on all joints once the drivers have been read.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn home<B: BusPeer>(&mut self, board: &mut BoardRunner<B>) -> Result<(), AskError> {
        board.run_until(board.now_ns() + SETTLE_NS)?;
        let protocol = protocol::link::VERSION;
        self.ask(board, &ToModule::Hello { protocol })?;
        let zero = ToModule::Zero {
            joint_mask: 63,
            tag: Tag::NONE,
        };
        self.ask(board, &zero).map(drop)
    }

    /// Uploads a gait; returns the fingerprint that the module read back.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn upload<B: BusPeer>(
        &mut self,
        board: &mut BoardRunner<B>,
        slot: u8,
        gait: &Gait,
    ) -> Result<Digest, AskError> {
        match self.ask(board, &put(slot, gait))? {
            FromModule::GaitStored { digest, .. } => Ok(digest),
            other => Err(AskError::Unexpected(Box::new(other))),
        }
    }

    /// Starts a slot.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn start<B: BusPeer>(
        &mut self,
        board: &mut BoardRunner<B>,
        slot: u8,
        digest: Digest,
        duration_ms: u32,
    ) -> Result<(), AskError> {
        let order = ToModule::Start {
            slot,
            digest,
            duration_ms,
            rate: TelemetryRate::Cycle,
            countdown_ms: 0,
            tag: Tag::NONE,
        };
        self.ask(board, &order).map(drop)
    }

    /// Runs the board and collects what comes, until a run has ended or `limit_ns` of guest time have passed.
    ///
    /// # Errors
    /// Those of the board.
    pub fn wait_for_end<B: BusPeer>(
        &mut self,
        board: &mut BoardRunner<B>,
        limit_ns: u64,
    ) -> Result<Option<RunEnd>, AskError> {
        let (before, until_ns) = (self.ends.len(), board.now_ns() + limit_ns);
        while self.ends.len() == before && board.now_ns() < until_ns {
            board.run_until_received(self.port, until_ns)?;
            self.receive(board, None);
        }
        Ok(self.ends.get(before).copied())
    }
}
