//! Host side of the link, without the port: numbers and signs requests, decodes what comes back.

use super::auth::{Key, Nonce};
use super::frame::{
    DecodeError, Decoder, EncodeError, Header, LinkCounters, SOURCE_HOST, UNASKED, VERSION, encode,
    encode_signed,
};
use super::message::{FromModule, ToModule};

/// One frame from a module.
#[derive(Debug, Clone, PartialEq)]
pub struct Received {
    /// `sequence` tells which request it answers, if it is an answer ([`Header::is_answer`]); a `boot_id` other than [`Client::boot_id`] tells that the module has restarted.
    pub header: Header,
    /// The message.
    pub message: FromModule,
}

/// State of a host's end of a link.
#[derive(Debug)]
pub struct Client {
    decoder: Decoder,
    next_sequence: u16,
    boot_id: u32,
}

impl Client {
    /// `first_sequence` should differ from run to run of the host program (time of day, random), so that an answer to an earlier run is not taken for ours.
    #[must_use]
    pub const fn new(first_sequence: u16) -> Self {
        Self {
            decoder: Decoder::new(),
            next_sequence: first_sequence & !UNASKED,
            boot_id: 0,
        }
    }

    /// The boot that requests are addressed to; 0 until the module said HELLO.
    #[must_use]
    pub fn boot_id(&self) -> u32 {
        self.boot_id
    }

    /// What was received and discarded so far.
    #[must_use]
    pub fn counters(&self) -> &LinkCounters {
        self.decoder.counters()
    }

    /// Writes a request; returns its sequence number and length. To repeat it after a time-out send the same bytes again: the module does it once.
    /// `proof` signs orders that carry a tag ([`ToModule::tag`]); other messages ignore it.
    ///
    /// # Errors
    /// As [`encode`]; a buffer of [`super::MAX_FRAME`] always suffices.
    pub fn request(
        &mut self,
        message: &ToModule,
        proof: Option<(&Key, &Nonce)>,
        out: &mut [u8],
    ) -> Result<(u16, usize), EncodeError> {
        let header = Header {
            version: VERSION,
            source: SOURCE_HOST,
            sequence: self.next_sequence,
            boot_id: self.boot_id,
        };
        let len = match proof {
            Some((key, nonce)) if message.tag().is_some() => {
                encode_signed(&header, message, key, nonce, out)?
            }
            _ => encode(&header, message, out)?,
        };
        self.next_sequence = self.next_sequence.wrapping_add(1) & !UNASKED;
        Ok((header.sequence, len))
    }

    /// Forgets a half-received frame, after a reconnect. The session goes on; a restarted module is noticed by its boot id.
    pub fn restart(&mut self) {
        self.decoder.restart();
    }

    /// Takes one byte; returns a message, or why a good frame held none, when this byte ended a frame of a module.
    /// A `Hello` sets [`Client::boot_id`].
    pub fn push(&mut self, byte: u8) -> Option<Result<Received, DecodeError>> {
        let frame = self.decoder.push(byte)?;
        let header = frame.header;
        if header.source == SOURCE_HOST {
            self.decoder.count_foreign();
            return None;
        }
        let decoded = frame.decode::<FromModule>();
        if let Err(error) = decoded {
            self.decoder.count(error);
        }
        Some(decoded.map(|message| {
            if let FromModule::Hello(hello) = &message {
                self.boot_id = hello.boot_id;
            }
            Received { header, message }
        }))
    }
}
