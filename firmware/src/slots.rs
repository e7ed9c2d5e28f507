//! Records in flash that are old or new after any power cut, never mixed: gait slots, settings, fault record.
//!
//! Every record owns a pair of pages. A write goes to the page that does not hold the valid record, so the old one
//! stays untouched until the new one is certain. Each 64-bit word is programmed once between two erases.
//!
//! ```text
//! page   word 0        magic, format, pair, length            \  CRC-32C over word 0, sequence and payload
//!        word 1        sequence u32, CRC-32C u32              /
//!        words 2..     payload, padded with ones
//!        words 224..   verdict log: COMMIT or VOID words, appended one by one; the last readable one counts
//! ```
//!
//! Why a log of verdicts: a word whose programming was cut may read right today and as an ECC error tomorrow, so
//! one commit word cannot be trusted after a cut. A write appends [`CERTAIN`] COMMIT words before it is
//! acknowledged. At boot a record whose last [`CERTAIN`] verdicts do not agree gets more of them before its content is
//! used: COMMIT if the last readable verdict says so, else VOID. What one boot has shown, every later boot shows too,
//! unless [`CERTAIN`] cuts in a row each leave a word that reads right once.

use crate::crash::CRC32C;
use crate::ports::{FlashError, PAGE_WORDS, STORE_PAGES, SlotStore, WORD_BYTES};

/// Gait slots that a robot has.
pub const GAIT_SLOTS: usize = 8;
/// Pair of the settings record (key, active slot).
pub const SETTINGS_PAIR: usize = GAIT_SLOTS;
/// Pair of the last fault record.
pub const CRASH_PAIR: usize = GAIT_SLOTS + 1;
/// Pairs in all.
pub const PAIRS: usize = GAIT_SLOTS + 2;
const _: () = assert!(PAIRS * 2 == STORE_PAGES);

/// Agreeing verdict words that make a record certain: one more than the nested cuts it must survive.
pub const CERTAIN: usize = 3;
const LOG_START: usize = 224;
const PAYLOAD_START: usize = 2;
/// Longest payload of one record.
pub const PAYLOAD_BYTES: usize = (LOG_START - PAYLOAD_START) * WORD_BYTES;

const MAGIC: [u8; 2] = *b"RS";
const FORMAT: u8 = 1;
/// Far apart in Hamming distance from each other, from all ones and all zeros.
const COMMIT: [u8; WORD_BYTES] = *b"COMMIT:)";
const VOID: [u8; WORD_BYTES] = [0xA5, 0x12, 0x3C, 0xE7, 0x81, 0x5A, 0x0F, 0xD2];
const ERASED: [u8; WORD_BYTES] = [0xFF; WORD_BYTES];

/// Why a record could not be written or read. The previous record is still there after any of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SlotError {
    /// Pair number not below [`PAIRS`].
    NoSuchSlot,
    /// Payload longer than [`PAYLOAD_BYTES`] or than the caller's buffer.
    TooLong,
    /// The slot holds no record.
    Empty,
    /// The flash refused or the read-back differed, twice.
    Flash,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Entry {
    page: usize,
    seq: u32,
    len: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    Commit,
    Void,
}

/// What [`Slots::recover`] found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Recovery {
    /// Words that could not be read (two-bit ECC errors).
    pub ecc_errors: u16,
    /// Verdict words that had to be appended: a write was cut before this boot.
    pub settled: u16,
}

/// Directory of the records, rebuilt from flash at boot.
#[derive(Debug)]
pub struct Slots {
    valid: [Option<Entry>; PAIRS],
}

impl Slots {
    /// An empty directory; [`Slots::recover`] fills it.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            valid: [None; PAIRS],
        }
    }

    /// Reads all pages, settles what a power cut left open, and builds the directory.
    pub fn recover<S: SlotStore>(&mut self, store: &mut S) -> Recovery {
        let mut report = Recovery::default();
        for (pair, valid) in self.valid.iter_mut().enumerate() {
            let mut newest: Option<Entry> = None;
            for page in [2 * pair, 2 * pair + 1] {
                let Some(entry) = scan(store, pair, page, &mut report.ecc_errors) else {
                    continue;
                };
                let committed = settle(store, page, &mut report.settled) == Verdict::Commit;
                if committed && newest.is_none_or(|best| entry.seq > best.seq) {
                    newest = Some(entry);
                }
            }
            *valid = newest;
        }
        report
    }

    /// Payload length of a record, `None` when the slot is empty.
    #[must_use]
    pub fn len(&self, pair: usize) -> Option<usize> {
        self.valid
            .get(pair)
            .copied()
            .flatten()
            .map(|entry| entry.len)
            .filter(|len| *len > 0)
    }

    /// Sequence number of a record: one more than any before it, over all pairs.
    #[must_use]
    pub fn sequence(&self, pair: usize) -> Option<u32> {
        self.valid
            .get(pair)
            .copied()
            .flatten()
            .map(|entry| entry.seq)
    }

    /// Copies the payload of a record and returns its length. The CRC is checked again.
    pub fn read<S: SlotStore>(
        &self,
        store: &mut S,
        pair: usize,
        into: &mut [u8],
    ) -> Result<usize, SlotError> {
        let entry = self
            .valid
            .get(pair)
            .ok_or(SlotError::NoSuchSlot)?
            .ok_or(SlotError::Empty)?;
        if entry.len == 0 {
            return Err(SlotError::Empty);
        }
        let into = into.get_mut(..entry.len).ok_or(SlotError::TooLong)?;
        let mut errors = 0;
        if scan(store, pair, entry.page, &mut errors) != Some(entry) {
            return Err(SlotError::Flash);
        }
        for (index, chunk) in into.chunks_mut(WORD_BYTES).enumerate() {
            let word = store
                .read(entry.page, PAYLOAD_START + index)
                .map_err(|_| SlotError::Flash)?;
            for (place, byte) in chunk.iter_mut().zip(word) {
                *place = byte;
            }
        }
        Ok(entry.len)
    }

    /// Writes a record, reads it back and commits it. Blocks for one erase and up to 230 words: not while a gait runs.
    pub fn write<S: SlotStore>(
        &mut self,
        store: &mut S,
        pair: usize,
        payload: &[u8],
    ) -> Result<(), SlotError> {
        let seq = self
            .valid
            .iter()
            .flatten()
            .map(|entry| entry.seq)
            .max()
            .unwrap_or(0)
            .saturating_add(1);
        let valid = self.valid.get_mut(pair).ok_or(SlotError::NoSuchSlot)?;
        if payload.len() > PAYLOAD_BYTES {
            return Err(SlotError::TooLong);
        }
        let page = valid.map_or(2 * pair, |entry| entry.page ^ 1);
        let entry = Entry {
            page,
            seq,
            len: payload.len(),
        };
        // A second attempt covers a word that failed to program; the page is erased again for it.
        for _attempt in 0..2 {
            if program_record(store, pair, entry, payload).is_ok() {
                *valid = Some(entry);
                return Ok(());
            }
        }
        Err(SlotError::Flash)
    }

    /// Makes a slot empty, as atomically as a write.
    pub fn erase<S: SlotStore>(&mut self, store: &mut S, pair: usize) -> Result<(), SlotError> {
        match self.len(pair) {
            Some(_) => self.write(store, pair, &[]),
            None if pair < PAIRS => Ok(()),
            None => Err(SlotError::NoSuchSlot),
        }
    }
}

impl Default for Slots {
    fn default() -> Self {
        Self::new()
    }
}

fn head_word(pair: usize, len: usize) -> [u8; WORD_BYTES] {
    // Both fit: pair < PAIRS, len <= PAYLOAD_BYTES.
    let pair = u8::try_from(pair).unwrap_or(u8::MAX);
    let [low, high] = u16::try_from(len).unwrap_or(u16::MAX).to_le_bytes();
    let [m0, m1] = MAGIC;
    [m0, m1, FORMAT, pair, low, high, 0, 0]
}

fn sequence_word(seq: u32, crc: u32) -> [u8; WORD_BYTES] {
    let [s0, s1, s2, s3] = seq.to_le_bytes();
    let [c0, c1, c2, c3] = crc.to_le_bytes();
    [s0, s1, s2, s3, c0, c1, c2, c3]
}

/// Reads and checks one page; `None` unless head, length and CRC are those of a record of this pair.
fn scan<S: SlotStore>(
    store: &mut S,
    pair: usize,
    page: usize,
    ecc_errors: &mut u16,
) -> Option<Entry> {
    let mut word = |index: usize| match store.read(page, index) {
        Ok(bytes) => Some(bytes),
        Err(_) => {
            *ecc_errors = ecc_errors.saturating_add(1);
            None
        }
    };
    let head = word(0)?;
    let [_, _, _, _, low, high, _, _] = head;
    let len = usize::from(u16::from_le_bytes([low, high]));
    if head != head_word(pair, len) || len > PAYLOAD_BYTES {
        return None;
    }
    let [s0, s1, s2, s3, c0, c1, c2, c3] = word(1)?;
    let mut digest = CRC32C.digest();
    digest.update(&head);
    digest.update(&[s0, s1, s2, s3]);
    let mut left = len;
    for index in PAYLOAD_START..LOG_START {
        if left == 0 {
            break;
        }
        let bytes = word(index)?;
        let take = left.min(WORD_BYTES);
        digest.update(bytes.get(..take)?);
        left -= take;
    }
    let seq = u32::from_le_bytes([s0, s1, s2, s3]);
    (digest.finalize() == u32::from_le_bytes([c0, c1, c2, c3])).then_some(Entry { page, seq, len })
}

/// Decides whether the record on `page` counts, and appends verdicts until that is certain.
fn settle<S: SlotStore>(store: &mut S, page: usize, appended: &mut u16) -> Verdict {
    let mut last = None;
    let mut agreeing = 0;
    let mut free = LOG_START;
    for index in LOG_START..PAGE_WORDS {
        let verdict = match store.read(page, index) {
            Ok(COMMIT) => Some(Verdict::Commit),
            Ok(VOID) => Some(Verdict::Void),
            Ok(ERASED) => continue,
            Ok(_) | Err(_) => None,
        };
        free = index + 1;
        if verdict.is_some() {
            agreeing = if verdict == last { agreeing + 1 } else { 1 };
            last = verdict;
        }
    }
    let verdict = last.unwrap_or(Verdict::Void);
    while agreeing < CERTAIN && free < PAGE_WORDS {
        if append(store, page, free, verdict).is_ok() {
            agreeing += 1;
            *appended = appended.saturating_add(1);
        }
        free += 1;
    }
    verdict
}

fn append<S: SlotStore>(
    store: &mut S,
    page: usize,
    word: usize,
    verdict: Verdict,
) -> Result<(), FlashError> {
    let bytes = match verdict {
        Verdict::Commit => COMMIT,
        Verdict::Void => VOID,
    };
    program_checked(store, page, word, &bytes)
}

fn program_checked<S: SlotStore>(
    store: &mut S,
    page: usize,
    word: usize,
    bytes: &[u8; WORD_BYTES],
) -> Result<(), FlashError> {
    store.program(page, word, bytes)?;
    if store.read(page, word)? == *bytes {
        Ok(())
    } else {
        Err(FlashError::Controller)
    }
}

fn program_record<S: SlotStore>(
    store: &mut S,
    pair: usize,
    entry: Entry,
    payload: &[u8],
) -> Result<(), FlashError> {
    let page = entry.page;
    store.erase(page)?;
    let head = head_word(pair, entry.len);
    let mut digest = CRC32C.digest();
    digest.update(&head);
    digest.update(&entry.seq.to_le_bytes());
    digest.update(payload);
    for (index, chunk) in payload.chunks(WORD_BYTES).enumerate() {
        let mut word = ERASED;
        for (place, byte) in word.iter_mut().zip(chunk) {
            *place = *byte;
        }
        // A word of all ones is what the erase left; programming it would only spend it.
        if word != ERASED {
            program_checked(store, page, PAYLOAD_START + index, &word)?;
        }
    }
    program_checked(store, page, 0, &head)?;
    program_checked(store, page, 1, &sequence_word(entry.seq, digest.finalize()))?;
    let mut errors = 0;
    if scan(store, pair, page, &mut errors) != Some(entry) {
        return Err(FlashError::Controller);
    }
    let mut appended = 0;
    for word in LOG_START..PAGE_WORDS {
        if append(store, page, word, Verdict::Commit).is_ok() {
            appended += 1;
        }
        if appended == CERTAIN {
            return Ok(());
        }
    }
    Err(FlashError::Controller)
}
