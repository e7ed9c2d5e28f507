//! Frames: what is between two zero bytes.
//!
//! The envelope (header, CRC, COBS) is the same in every version for ever, so that a version mismatch can be named instead of looking like noise.

use cobs::{DecodeResult, DecoderState};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::auth::{Key, Nonce, TAG_LEN, Tag};
use super::message::{FromModule, ToModule};
use crate::crc::crc32c;

/// Protocol version of this crate. Not the release version: it changes when bytes change their meaning.
pub const VERSION: u8 = 1;
/// Bit of `sequence` that requests and answers never have set, and everything a module sends unasked always has.
pub const UNASKED: u16 = 0x8000;
/// `source` of a host. Modules use their robot id, 1..=254.
pub const SOURCE_HOST: u8 = 0;

/// Bytes before the payload: version, source, sequence, boot id, type.
pub const HEADER_LEN: usize = 9;
/// Bytes of the checksum.
pub const CRC_LEN: usize = 4;
/// Largest payload. With it the body takes two COBS codes and a frame fits a 512 byte buffer.
pub const MAX_PAYLOAD: usize = 492;
/// Largest body before COBS.
pub const MAX_BODY: usize = HEADER_LEN + MAX_PAYLOAD + CRC_LEN;
/// Largest frame on the wire, both zeros included.
pub const MAX_FRAME: usize = cobs::max_encoding_length(MAX_BODY) + 2;

const _: () = assert!(MAX_BODY == 505 && MAX_FRAME == 509);
// CRC-32C keeps Hamming distance 6 up to 655 bytes.
const _: () = assert!(MAX_BODY <= 655);

/// Envelope of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Header {
    /// Protocol version of the sender.
    pub version: u8,
    /// [`SOURCE_HOST`] or the robot id.
    pub source: u8,
    /// Of a request: chosen by the host, below [`UNASKED`]. Of an answer: the request's. Of anything else a module sends: its own running count with that bit set.
    pub sequence: u16,
    /// The boot the frame belongs to: the module's, as told by `HelloAck`. A host that does not know it yet sends 0.
    pub boot_id: u32,
}

impl Header {
    /// Whether a module's frame answers a request.
    #[must_use]
    pub fn is_answer(&self) -> bool {
        self.sequence & UNASKED == 0
    }
}

/// A message of one direction.
pub trait Message: Serialize + DeserializeOwned {
    /// Types defined so far: 0..COUNT.
    const COUNT: u8;
    /// The type byte.
    fn kind(&self) -> u8;
}

/// Why a message does not fit a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum EncodeError {
    /// The output buffer is shorter than the frame; [`MAX_FRAME`] always suffices.
    BufferTooSmall,
    /// `encode_signed` of a message that carries no tag.
    NotSignable,
}

/// Why a frame with a good checksum is no message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum DecodeError {
    /// Another protocol version.
    Version {
        /// The sender's version.
        theirs: u8,
    },
    /// A type this version does not know.
    UnknownType {
        /// The type byte.
        kind: u8,
    },
    /// The payload is no value of this type.
    Malformed,
    /// The payload is longer than its message.
    TrailingBytes,
}

/// What the receiver saw and threw away. Counts saturate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LinkCounters {
    /// Frames with a good checksum.
    pub frames: u32,
    /// Wrong checksum.
    pub bad_crc: u32,
    /// COBS code that points past the delimiter, or fewer bytes than an envelope: the rest of a cut frame.
    pub bad_framing: u32,
    /// More bytes than the largest frame without a delimiter.
    pub overflow: u32,
    /// Another protocol version.
    pub bad_version: u32,
    /// Unknown type.
    pub unknown_type: u32,
    /// Payload that is no value of its type.
    pub malformed: u32,
    /// Payload longer than its message.
    pub trailing_bytes: u32,
    /// Frames of this end's own kind: an echo, or two hosts on one line.
    pub foreign: u32,
}

impl LinkCounters {
    /// Counts one frame that was no message.
    pub fn count(&mut self, error: DecodeError) {
        let counter = match error {
            DecodeError::Version { .. } => &mut self.bad_version,
            DecodeError::UnknownType { .. } => &mut self.unknown_type,
            DecodeError::Malformed => &mut self.malformed,
            DecodeError::TrailingBytes => &mut self.trailing_bytes,
        };
        *counter = counter.saturating_add(1);
    }
}

/// One received frame with a good checksum; the message inside is not yet looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Envelope.
    pub header: Header,
    /// Type byte, then payload.
    message: &'a [u8],
}

impl<'a> Frame<'a> {
    /// Checks length and checksum of a body (between COBS and message).
    fn parse(body: &'a [u8]) -> Result<Self, FrameError> {
        let (rest, crc) = body
            .split_last_chunk::<CRC_LEN>()
            .ok_or(FrameError::Short)?;
        let (&[version, source, s0, s1, b0, b1, b2, b3], message) = rest
            .split_first_chunk::<{ HEADER_LEN - 1 }>()
            .ok_or(FrameError::Short)?;
        if message.is_empty() {
            return Err(FrameError::Short);
        }
        if crc32c(rest) != u32::from_le_bytes(*crc) {
            return Err(FrameError::Crc);
        }
        let header = Header {
            version,
            source,
            sequence: u16::from_le_bytes([s0, s1]),
            boot_id: u32::from_le_bytes([b0, b1, b2, b3]),
        };
        Ok(Self { header, message })
    }

    /// The type byte.
    #[must_use]
    pub fn kind(&self) -> u8 {
        self.message.first().copied().unwrap_or(u8::MAX)
    }

    /// The payload: the message without its type byte.
    #[must_use]
    pub fn payload(&self) -> &'a [u8] {
        self.message.get(1..).unwrap_or(&[])
    }

    /// CRC-32C over type and payload: tells a repeated request from another one with the same number.
    #[must_use]
    pub fn fingerprint(&self) -> u32 {
        crc32c(self.message)
    }

    /// The message inside.
    ///
    /// # Errors
    /// [`DecodeError`]: another version, an unknown type, a payload that is not exactly one value of its type.
    pub fn decode<M: Message>(&self) -> Result<M, DecodeError> {
        if self.header.version != VERSION {
            return Err(DecodeError::Version {
                theirs: self.header.version,
            });
        }
        if self.kind() >= M::COUNT {
            return Err(DecodeError::UnknownType { kind: self.kind() });
        }
        match postcard::take_from_bytes::<M>(self.message) {
            Ok((message, [])) => Ok(message),
            Ok(_) => Err(DecodeError::TrailingBytes),
            Err(_) => Err(DecodeError::Malformed),
        }
    }
}

enum FrameError {
    Short,
    Crc,
}

/// Finds frames in a stream of bytes, whatever the bytes are. Holds at most one frame.
#[derive(Debug)]
pub struct Decoder {
    cobs: DecoderState,
    body: [u8; MAX_BODY],
    len: usize,
    /// Discards up to the next delimiter.
    skipping: bool,
    counters: LinkCounters,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// A decoder that waits for a frame.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            cobs: DecoderState::Idle,
            body: [0; MAX_BODY],
            len: 0,
            skipping: false,
            counters: LinkCounters {
                frames: 0,
                bad_crc: 0,
                bad_framing: 0,
                overflow: 0,
                bad_version: 0,
                unknown_type: 0,
                malformed: 0,
                trailing_bytes: 0,
                foreign: 0,
            },
        }
    }

    /// What was received and discarded so far.
    #[must_use]
    pub fn counters(&self) -> &LinkCounters {
        &self.counters
    }

    /// Counts a frame whose message could not be used.
    pub fn count(&mut self, error: DecodeError) {
        self.counters.count(error);
    }

    /// Counts a frame that came from this end of the link.
    pub fn count_foreign(&mut self) {
        self.counters.foreign = self.counters.foreign.saturating_add(1);
    }

    /// Forgets a half-received frame: after a UART error or a reconnect. The next frame is found at its delimiter.
    pub fn restart(&mut self) {
        self.cobs = DecoderState::Idle;
        self.len = 0;
        self.skipping = true;
    }

    /// Takes one byte; returns a frame when this byte ended one with a good checksum.
    pub fn push(&mut self, byte: u8) -> Option<Frame<'_>> {
        if self.skipping {
            self.skipping = byte != 0;
            return None;
        }
        match self.cobs.feed(byte) {
            Ok(DecodeResult::NoData) => None,
            Ok(DecodeResult::DataStart) => {
                self.len = 0;
                None
            }
            Ok(DecodeResult::DataContinue(data)) => {
                self.store(data);
                None
            }
            Ok(DecodeResult::DataComplete) => self.complete(),
            Err(_) => {
                // The byte was a delimiter inside a run: the frame was cut here, and the next one may start.
                self.counters.bad_framing = self.counters.bad_framing.saturating_add(1);
                None
            }
        }
    }

    fn store(&mut self, data: u8) {
        match self.body.get_mut(self.len) {
            Some(place) => {
                *place = data;
                self.len = self.len.saturating_add(1);
            }
            None => {
                self.counters.overflow = self.counters.overflow.saturating_add(1);
                self.restart();
            }
        }
    }

    fn complete(&mut self) -> Option<Frame<'_>> {
        let body = self.body.get(..self.len).unwrap_or(&[]);
        let counter = match Frame::parse(body) {
            Ok(frame) => {
                self.counters.frames = self.counters.frames.saturating_add(1);
                return Some(frame);
            }
            Err(FrameError::Short) => &mut self.counters.bad_framing,
            Err(FrameError::Crc) => &mut self.counters.bad_crc,
        };
        *counter = counter.saturating_add(1);
        None
    }
}

/// Writes one frame into `out`; returns its length. `out` of [`MAX_FRAME`] bytes always suffices.
///
/// # Errors
/// [`EncodeError::BufferTooSmall`].
pub fn encode<M: Message>(
    header: &Header,
    message: &M,
    out: &mut [u8],
) -> Result<usize, EncodeError> {
    let mut body = [0; MAX_BODY];
    let len = place(message, &mut body)?.len();
    envelope(header, &mut body, len, out)
}

/// As [`encode`], with the order's last field, its tag, replaced by the tag for this key and nonce.
///
/// # Errors
/// [`EncodeError::NotSignable`] when the message is shorter than a tag, else as [`encode`].
pub fn encode_signed(
    header: &Header,
    message: &ToModule,
    key: &Key,
    nonce: &Nonce,
    out: &mut [u8],
) -> Result<usize, EncodeError> {
    let sign = |kind, payload: &[u8]| key.sign(nonce, kind, payload);
    encode_tagged(header, message, sign, out)
}

/// As [`encode_signed`] for [`super::FromModule::State`] and the host's nonce.
///
/// # Errors
/// As [`encode_signed`].
pub fn encode_proof(
    header: &Header,
    message: &FromModule,
    key: &Key,
    nonce: &Nonce,
    out: &mut [u8],
) -> Result<usize, EncodeError> {
    let sign = |kind, payload: &[u8]| key.sign_state(nonce, kind, payload);
    encode_tagged(header, message, sign, out)
}

fn encode_tagged<M: Message>(
    header: &Header,
    message: &M,
    sign: impl FnOnce(u8, &[u8]) -> Tag,
    out: &mut [u8],
) -> Result<usize, EncodeError> {
    let mut body = [0; MAX_BODY];
    let used = place(message, &mut body)?;
    let len = used.len();
    let (signed, tag) = used
        .split_last_chunk_mut::<TAG_LEN>()
        .ok_or(EncodeError::NotSignable)?;
    let (kind, payload) = signed.split_first().ok_or(EncodeError::NotSignable)?;
    *tag = sign(*kind, payload).0;
    envelope(header, &mut body, len, out)
}

/// Writes the message to its place in a body: behind the header, with room for the checksum.
fn place<'a, M: Message>(
    message: &M,
    body: &'a mut [u8; MAX_BODY],
) -> Result<&'a mut [u8], EncodeError> {
    let room = body
        .get_mut(HEADER_LEN - 1..MAX_BODY - CRC_LEN)
        .ok_or(EncodeError::BufferTooSmall)?;
    postcard::to_slice(message, room).map_err(|_| EncodeError::BufferTooSmall)
}

/// Puts header and CRC around the `len` bytes of the message in `body`, and all of it through COBS between two zeros.
fn envelope(
    header: &Header,
    body: &mut [u8; MAX_BODY],
    len: usize,
    out: &mut [u8],
) -> Result<usize, EncodeError> {
    let [s0, s1] = header.sequence.to_le_bytes();
    let [b0, b1, b2, b3] = header.boot_id.to_le_bytes();
    let head = [header.version, header.source, s0, s1, b0, b1, b2, b3];
    for (place, byte) in body.iter_mut().zip(head) {
        *place = byte;
    }
    let checked = head.len().saturating_add(len);
    let crc = crc32c(body.get(..checked).unwrap_or(&[])).to_le_bytes();
    for (place, byte) in body.iter_mut().skip(checked).zip(crc) {
        *place = byte;
    }
    let body = body.get(..checked.saturating_add(CRC_LEN)).unwrap_or(&[]);
    frame(body, out).ok_or(EncodeError::BufferTooSmall)
}

/// COBS between two zeros; `None` when there is too little room. The crate `cobs` takes twice as long for a byte.
fn frame(body: &[u8], out: &mut [u8]) -> Option<usize> {
    let room = out.len();
    let mut places = out.iter_mut();
    *places.next()? = 0;
    // A code says how far the next zero is: at most 254 bytes lie between. It is known when the bytes behind it are written.
    let mut code_place = places.next()?;
    let mut code = 1_u8;
    for byte in body {
        if code == u8::MAX {
            // No zero after this stretch.
            *code_place = code;
            code_place = places.next()?;
            code = 1;
        }
        let place = places.next()?;
        if *byte == 0 {
            *code_place = code;
            code_place = place;
            code = 1;
        } else {
            *place = *byte;
            code = code.wrapping_add(1);
        }
    }
    *code_place = code;
    *places.next()? = 0;
    Some(room.saturating_sub(places.len()))
}

#[cfg(test)]
mod tests {
    use super::frame;

    #[test]
    fn codes_are_those_of_the_crate() {
        let mut bytes = [0; 505];
        for seed in 0..2_000_u32 {
            let len = (seed * 7919 % 506) as usize;
            let often = seed % 5;
            let mut state = seed;
            for byte in &mut bytes {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                // No zeros, few, many, only zeros.
                *byte = match (often, state >> 24) {
                    (0, high) => (high | 1) as u8,
                    (1, high) if high < 4 => 0,
                    (2, high) if high < 128 => 0,
                    (3, _) => 0,
                    (_, high) => high as u8,
                };
            }
            let (mut out, mut wanted) = ([7; 512], [7; 512]);
            let len_wanted = cobs::encode_including_sentinels(&bytes[..len], &mut wanted);
            let found = frame(&bytes[..len], &mut out);
            assert_eq!(found, Some(len_wanted), "{len} bytes, seed {seed}");
            assert_eq!(out[..len_wanted], wanted[..len_wanted], "seed {seed}");
            assert_eq!(frame(&bytes[..len], &mut out[..len_wanted - 1]), None);
        }
    }
}
