//! The records of an MCAP file, damaged or not: every record before a damaged place is given out, and the place is named.

use std::io::Read as _;

use mcap::records::{ChunkHeader, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::record;

/// First and last bytes of an MCAP file.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// Opcode and length in front of a record.
const RECORD_HEAD: usize = 9;
/// What all compressed chunks of a file may unpack to: this, and [`UNPACKED_PER_BYTE`] for every byte of the file. It bounds the memory
/// that a file of a few kilobytes can ask for; our telemetry shrinks to a tenth at best.
const UNPACKED: usize = 64 << 20;
/// See [`UNPACKED`].
const UNPACKED_PER_BYTE: usize = 32;
/// Memory of a record beside its content, bytes.
const RECORD_COST: usize = 256;
/// Most damaged places that are reported; the rest of the file is read all the same.
pub(super) const MAX_DAMAGE: usize = 1000;

/// A damaged place.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Damage {
    /// Offset in the file of the record that is damaged.
    pub offset: u64,
    /// What is wrong there.
    pub kind: DamageKind,
}

/// What is wrong at a damaged place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DamageKind {
    /// Not an MCAP file at all.
    #[error("the file does not start as MCAP does")]
    Magic,
    /// The file ends within a record.
    #[error("the file ends within a record: the recording was cut here")]
    Cut,
    /// The file ends after a whole record but was never closed.
    #[error("the recording was not closed: power or process ended while it was written")]
    NotClosed,
    /// A record whose content cannot be read.
    #[error("a record cannot be read")]
    Record,
    /// A chunk whose checksum is wrong; its records are not used.
    #[error("a chunk has a wrong checksum; its records are not used")]
    ChunkChecksum,
    /// A chunk in a compression that this reader does not have.
    #[error("a chunk is compressed in another way than lz4 or zstd; its records are not used")]
    Compression,
    /// A chunk that unpacks to more than this reader accepts.
    #[error(
        "a chunk unpacks to more than 64 MiB and 32 times the size of the file; it is not read"
    )]
    ChunkSize,
    /// A message that its schema does not describe.
    #[error("a message does not fit its schema")]
    Message,
    /// A message on a channel that was not declared.
    #[error("a message on an undeclared channel")]
    Channel,
    /// An attachment whose checksum is wrong.
    #[error("an attachment has a wrong checksum")]
    Attachment,
    /// Bytes after the end of the recording.
    #[error("the file does not end as MCAP does")]
    End,
}

/// Takes records as they are found.
pub(super) trait Sink {
    /// One record and the offset of its opcode (of its chunk's, for a record inside a chunk).
    fn record(&mut self, offset: u64, record: Record<'_>);
    /// One damaged place.
    fn damage(&mut self, damage: Damage);
}

/// What goes with the reader through the file.
struct Walk<'a, S: Sink> {
    sink: &'a mut S,
    /// Bytes that compressed chunks may still unpack to.
    budget: usize,
}

/// Walks over the whole file. Never fails: what cannot be read is told as damage.
pub(super) fn scan(file: &[u8], sink: &mut impl Sink) {
    let unpacked = file.len().saturating_mul(UNPACKED_PER_BYTE);
    let mut walk = Walk {
        sink,
        budget: unpacked.saturating_add(UNPACKED),
    };
    walk_over(file, &mut walk);
}

fn walk_over(file: &[u8], walk: &mut Walk<'_, impl Sink>) {
    let sink = &mut *walk.sink;
    if !file.starts_with(MAGIC) {
        let kind = if MAGIC.starts_with(file) {
            DamageKind::Cut
        } else {
            DamageKind::Magic
        };
        sink.damage(Damage { offset: 0, kind });
        return;
    }
    let mut at = MAGIC.len();
    loop {
        let sink = &mut *walk.sink;
        let rest = file.get(at..).unwrap_or(&[]);
        let offset = at as u64;
        if rest.is_empty() {
            sink.damage(Damage {
                offset,
                kind: DamageKind::NotClosed,
            });
            return;
        }
        let Some((opcode, body, size)) = split(rest) else {
            cut_record(offset, rest, sink);
            return;
        };
        at += size;
        whole_record(offset, opcode, body, walk);
        let sink = &mut *walk.sink;
        if opcode == op::FOOTER {
            if file.get(at..) != Some(MAGIC) {
                sink.damage(Damage {
                    offset: at as u64,
                    kind: DamageKind::End,
                });
            }
            return;
        }
    }
}

/// Opcode, body and total size of the record at the start of `bytes`, if all of it is there.
fn split(bytes: &[u8]) -> Option<(u8, &[u8], usize)> {
    let (head, rest) = bytes.split_first_chunk::<RECORD_HEAD>()?;
    let [opcode, length @ ..] = *head;
    let length = usize::try_from(u64::from_le_bytes(length)).ok()?;
    let body = rest.get(..length)?;
    Some((opcode, body, RECORD_HEAD + length))
}

fn whole_record(offset: u64, opcode: u8, body: &[u8], walk: &mut Walk<'_, impl Sink>) {
    let sink = &mut *walk.sink;
    match record::parse(opcode, body) {
        Some(Record::Chunk { header, data }) => chunk(offset, &header, body, &data, walk),
        Some(Record::Attachment { header, data, crc }) => {
            let covered = body.len().saturating_sub(4);
            if crc != 0 && crc32(body.get(..covered).unwrap_or(&[])) != crc {
                sink.damage(Damage {
                    offset,
                    kind: DamageKind::Attachment,
                });
            } else {
                sink.record(offset, Record::Attachment { header, data, crc });
            }
        }
        Some(record) => sink.record(offset, record),
        None => sink.damage(Damage {
            offset,
            kind: DamageKind::Record,
        }),
    }
}

/// The CRC-32 that MCAP uses (IEEE 802.3).
fn crc32(bytes: &[u8]) -> u32 {
    crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(bytes)
}

/// A whole chunk: its records are used if its checksum is right.
fn chunk(
    offset: u64,
    header: &ChunkHeader,
    body: &[u8],
    data: &[u8],
    walk: &mut Walk<'_, impl Sink>,
) {
    if header.compression.is_empty() {
        return plain_chunk(offset, header, data, walk);
    }
    match unpack(body, &mut walk.budget) {
        Ok(records) => {
            for record in records {
                walk.sink.record(offset, record);
            }
        }
        Err(kind) => walk.sink.damage(Damage { offset, kind }),
    }
}

/// An uncompressed chunk is checked first and read in place.
fn plain_chunk(offset: u64, header: &ChunkHeader, data: &[u8], walk: &mut Walk<'_, impl Sink>) {
    let size = usize::try_from(header.compressed_size).ok();
    let checked = size.and_then(|size| data.get(..size)).filter(|data| {
        let right = header.uncompressed_crc == 0 || crc32(data) == header.uncompressed_crc;
        right && Records(data).all(|record| record.is_some())
    });
    match checked {
        Some(data) => {
            for record in Records(data).flatten() {
                walk.sink.record(offset, record);
            }
        }
        None => walk.sink.damage(Damage {
            offset,
            kind: DamageKind::ChunkChecksum,
        }),
    }
}

/// The records in a piece of a file; `None` for one that cannot be read, and then no more.
struct Records<'a>(&'a [u8]);

impl<'a> Iterator for Records<'a> {
    type Item = Option<Record<'a>>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.0.is_empty() {
            return None;
        }
        let rest = std::mem::take(&mut self.0);
        Some(split(rest).and_then(|(opcode, body, size)| {
            let record = record::parse(opcode, body)?;
            self.0 = rest.get(size..)?;
            Some(record)
        }))
    }
}

/// The records of a compressed chunk. Its checksum is known at the end only, so they wait until then.
fn unpack(body: &[u8], budget: &mut usize) -> Result<Vec<Record<'static>>, DamageKind> {
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_validate_chunk_crcs(true)
        .with_record_length_limit(*budget);
    let mut reader = LinearReader::new_with_options(options);
    let mut head = vec![op::CHUNK];
    head.extend((body.len() as u64).to_le_bytes());
    let mut input = head.chain(body);
    let mut waiting = Vec::new();
    while let Some(event) = reader.next_event() {
        match event.map_err(|error| damage_of(&error))? {
            LinearReadEvent::ReadRequest(need) => {
                let into = reader.insert(need);
                let read = input.read(into).map_err(|_| DamageKind::Record)?;
                reader.notify_read(read);
            }
            LinearReadEvent::Record { data, opcode } => {
                let cost = data.len() + RECORD_COST;
                *budget = budget.checked_sub(cost).ok_or(DamageKind::ChunkSize)?;
                let record = record::parse(opcode, data).ok_or(DamageKind::ChunkChecksum)?;
                waiting.push(record.into_owned());
            }
        }
    }
    Ok(waiting)
}

fn damage_of(error: &mcap::McapError) -> DamageKind {
    match error {
        mcap::McapError::UnsupportedCompression(_) => DamageKind::Compression,
        mcap::McapError::RecordTooLarge { .. } | mcap::McapError::ChunkTooLarge(_) => {
            DamageKind::ChunkSize
        }
        _ => DamageKind::ChunkChecksum,
    }
}

/// The last, incomplete record. The whole records inside an uncompressed chunk are still used.
fn cut_record(offset: u64, bytes: &[u8], sink: &mut impl Sink) {
    let in_chunk = bytes
        .get(RECORD_HEAD..)
        .filter(|_| bytes.first() == Some(&op::CHUNK));
    if let Some(mut records) = in_chunk.and_then(cut_chunk_records) {
        while let Some((opcode, body, size)) = split(records) {
            if let Some(record) = record::parse(opcode, body) {
                sink.record(offset, record);
            }
            records = records.get(size..).unwrap_or(&[]);
        }
    }
    sink.damage(Damage {
        offset,
        kind: DamageKind::Cut,
    });
}

/// The records part of a cut chunk body, if it is uncompressed: start, end, size (8 each), CRC (4), compression name, length (8).
fn cut_chunk_records(body: &[u8]) -> Option<&[u8]> {
    let name_length = body.get(28..32)?;
    if name_length != [0; 4] {
        return None;
    }
    body.get(40..)
}
