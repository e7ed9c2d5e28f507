//! The records of an MCAP file, damaged or not: every record before a damaged place is given out, and the place is named.

use mcap::records::{ChunkHeader, Record, op};

/// First and last bytes of an MCAP file.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// Opcode and length in front of a record.
const RECORD_HEAD: usize = 9;
/// Largest chunk accepted, uncompressed: bounds the memory a hostile file can ask for.
const MAX_CHUNK: u64 = 256 * 1024 * 1024;

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
    /// A chunk that is larger than this reader accepts.
    #[error("a chunk is larger than 256 MiB; it is not read")]
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

/// Walks over the whole file. Never fails: what cannot be read is told as damage.
pub(super) fn scan(file: &[u8], sink: &mut impl Sink) {
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
        whole_record(offset, opcode, body, sink);
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

fn whole_record(offset: u64, opcode: u8, body: &[u8], sink: &mut impl Sink) {
    match mcap::parse_record(opcode, body) {
        Ok(Record::Chunk { header, data }) => chunk(offset, header, &data, sink),
        Ok(Record::Attachment { header, data, crc }) => {
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
        Ok(record) => sink.record(offset, record),
        Err(_) => sink.damage(Damage {
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
fn chunk(offset: u64, header: ChunkHeader, data: &[u8], sink: &mut impl Sink) {
    if header.uncompressed_size > MAX_CHUNK {
        sink.damage(Damage {
            offset,
            kind: DamageKind::ChunkSize,
        });
        return;
    }
    let damaged = Damage {
        offset,
        kind: DamageKind::ChunkChecksum,
    };
    let records = match mcap::read::ChunkReader::new(header, data) {
        Ok(records) => records,
        Err(mcap::McapError::UnsupportedCompression(_)) => {
            let kind = DamageKind::Compression;
            sink.damage(Damage { offset, kind });
            return;
        }
        Err(_) => {
            sink.damage(damaged);
            return;
        }
    };
    // The checksum is known at the end only, so records wait until then.
    let mut waiting = Vec::new();
    for record in records {
        match record {
            Ok(record) => waiting.push(record.into_owned()),
            Err(_) => {
                sink.damage(damaged);
                return;
            }
        }
    }
    for record in waiting {
        sink.record(offset, record);
    }
}

/// The last, incomplete record. The whole records inside an uncompressed chunk are still used.
fn cut_record(offset: u64, bytes: &[u8], sink: &mut impl Sink) {
    let in_chunk = bytes
        .get(RECORD_HEAD..)
        .filter(|_| bytes.first() == Some(&op::CHUNK));
    if let Some(mut records) = in_chunk.and_then(cut_chunk_records) {
        while let Some((opcode, body, size)) = split(records) {
            if let Ok(record) = mcap::parse_record(opcode, body) {
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
