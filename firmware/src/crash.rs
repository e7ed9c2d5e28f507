//! The fault record that survives a reset: layout, encoding, decoding. Pure; the board places the block in `.noinit` RAM.
//!
//! Written by the panic and HardFault handlers just before they reset, read once at the next boot, then cleared.
//! Magic and CRC tell a record from the random content of RAM after power-up.
//!
//! | bytes | content |
//! |---|---|
//! | 0..4 | magic `RBCR`, little endian as all that follows |
//! | 4 | format, 1 |
//! | 5 | kind: see [`CrashKind`] |
//! | 6 | supervisor state at the time, as on the link |
//! | 7 | length of the text |
//! | 8..16 | time since boot, us |
//! | 16..20 | program counter (0: unknown) |
//! | 20..24 | link register (0: unknown) |
//! | 24..28 | first detail word: line of a panic, CFSR of a fault |
//! | 28..92 | text: file name's end of a panic |
//! | 92..96 | CRC-32C of bytes 0..92 |

use heapless::String;

/// Size of the block in bytes.
pub const BLOCK_BYTES: usize = 96;
/// Longest text kept. A path keeps its end, which names the file.
pub const TEXT_BYTES: usize = 64;
const BODY_BYTES: usize = BLOCK_BYTES - 4;
const MAGIC: u32 = u32::from_le_bytes(*b"RBCR");
const FORMAT: u8 = 1;

/// CRC-32C (Castagnoli): Hamming distance 6 up to 256 bytes of payload.
pub(crate) const CRC32C: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISCSI);

/// What ended the last life of the firmware.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum CrashKind {
    /// A Rust panic: text = file, detail = line.
    Panic = 1,
    /// HardFault, bus, usage or memory fault: pc, lr; detail = CFSR.
    HardFault = 2,
    /// The stack ran out: there is no memory below it, so the access faults. pc and lr are 0 where they could not be saved.
    StackOverflow = 3,
    /// Non-maskable interrupt that was not a flash ECC read.
    Nmi = 4,
}

impl CrashKind {
    fn from_byte(byte: u8) -> Option<Self> {
        match byte {
            1 => Some(Self::Panic),
            2 => Some(Self::HardFault),
            3 => Some(Self::StackOverflow),
            4 => Some(Self::Nmi),
            _ => None,
        }
    }
}

/// A decoded fault record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CrashRecord {
    /// What happened.
    pub kind: CrashKind,
    /// Supervisor state at the time, numbered as on the link.
    pub state: u8,
    /// Time since boot in microseconds, 0 when the handler could not read it.
    pub t_us: u64,
    /// Program counter, 0 when unknown.
    pub pc: u32,
    /// Link register, 0 when unknown.
    pub lr: u32,
    /// Line of a panic, CFSR of a fault.
    pub detail: u32,
    /// End of the file name of a panic.
    pub text: String<TEXT_BYTES>,
}

impl CrashRecord {
    /// A record without text.
    #[must_use]
    pub fn new(kind: CrashKind, state: u8, t_us: u64) -> Self {
        Self {
            kind,
            state,
            t_us,
            pc: 0,
            lr: 0,
            detail: 0,
            text: String::new(),
        }
    }

    /// Keeps the end of `text`, at most [`TEXT_BYTES`] bytes, cut at a character boundary.
    pub fn set_text(&mut self, text: &str) {
        self.text.clear();
        let mut start = text.len().saturating_sub(TEXT_BYTES);
        while start < text.len() && !text.is_char_boundary(start) {
            start += 1;
        }
        // Fits by construction; a failure would only leave the text empty.
        let _ = self.text.push_str(text.get(start..).unwrap_or(""));
    }

    /// Writes the record into the block.
    pub fn encode(&self, block: &mut [u8; BLOCK_BYTES]) {
        block.fill(0);
        let (body, tail) = block.split_at_mut(BODY_BYTES);
        let text_len = u8::try_from(self.text.len()).unwrap_or(0);
        let head = [FORMAT, self.kind as u8, self.state, text_len];
        let fields = MAGIC
            .to_le_bytes()
            .into_iter()
            .chain(head)
            .chain(self.t_us.to_le_bytes())
            .chain(self.pc.to_le_bytes())
            .chain(self.lr.to_le_bytes())
            .chain(self.detail.to_le_bytes())
            .chain(self.text.bytes());
        for (place, byte) in body.iter_mut().zip(fields) {
            *place = byte;
        }
        let crc = CRC32C.checksum(body).to_le_bytes();
        for (place, byte) in tail.iter_mut().zip(crc) {
            *place = byte;
        }
    }

    /// Reads a block; `None` when it holds no intact record (power-up content, cleared block, other format).
    #[must_use]
    pub fn decode(block: &[u8; BLOCK_BYTES]) -> Option<Self> {
        let (body, tail) = block.split_first_chunk::<BODY_BYTES>()?;
        let crc = u32::from_le_bytes(*tail.first_chunk::<4>()?);
        if CRC32C.checksum(body) != crc || u32_at(body, 0)? != MAGIC || *body.get(4)? != FORMAT {
            return None;
        }
        let text_len = usize::from(*body.get(7)?);
        let text = core::str::from_utf8(body.get(28..28 + text_len.min(TEXT_BYTES))?).ok()?;
        let mut record = Self {
            kind: CrashKind::from_byte(*body.get(5)?)?,
            state: *body.get(6)?,
            t_us: u64::from(u32_at(body, 8)?) | u64::from(u32_at(body, 12)?) << 32,
            pc: u32_at(body, 16)?,
            lr: u32_at(body, 20)?,
            detail: u32_at(body, 24)?,
            text: String::new(),
        };
        record.set_text(text);
        Some(record)
    }

    /// Makes the block hold no record.
    pub fn clear(block: &mut [u8; BLOCK_BYTES]) {
        block.fill(0);
    }
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk::<4>()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> CrashRecord {
        let mut record = CrashRecord::new(CrashKind::Panic, 4, 0x1_0000_0002);
        record.pc = 0x0800_1234;
        record.lr = 0x0800_4321;
        record.detail = 77;
        record.set_text("firmware/src/app.rs");
        record
    }

    #[test]
    fn a_record_survives_the_round_trip() {
        let mut block = [0xA5; BLOCK_BYTES];
        example().encode(&mut block);
        assert_eq!(CrashRecord::decode(&block), Some(example()));
    }

    #[test]
    fn a_long_path_keeps_its_end() {
        let mut record = CrashRecord::new(CrashKind::Panic, 0, 0);
        record.set_text(&format!("{}é/board.rs", "x".repeat(100)));
        assert!(record.text.ends_with("é/board.rs") && record.text.len() <= TEXT_BYTES);
    }

    #[test]
    fn every_single_bit_flip_and_power_up_content_is_no_record() {
        let mut block = [0; BLOCK_BYTES];
        assert_eq!(CrashRecord::decode(&block), None);
        assert_eq!(CrashRecord::decode(&[0xFF; BLOCK_BYTES]), None);
        example().encode(&mut block);
        for bit in 0..BLOCK_BYTES * 8 {
            let mut flipped = block;
            flipped[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(CrashRecord::decode(&flipped), None, "bit {bit}");
        }
        CrashRecord::clear(&mut block);
        assert_eq!(CrashRecord::decode(&block), None);
    }
}
