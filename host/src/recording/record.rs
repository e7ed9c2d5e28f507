//! One record of an MCAP file. The `mcap` crate takes memory for a text of any length that four bytes claim, and panics at an
//! attachment that is cut, so lengths are looked at first.

use mcap::records::{Record, op};

/// A field whose length stands in the file, and what lies between such fields.
#[derive(Clone, Copy)]
enum Field {
    /// So many bytes.
    Fixed(usize),
    /// Its length as u32, then its bytes.
    Long,
    /// As [`Field::Long`]; inside it are texts, each with its own length.
    Texts,
}

/// The fields of a record up to the last one with a length (MCAP specification, section "Records").
fn fields(opcode: u8) -> &'static [Field] {
    use Field::{Fixed, Long, Texts};
    match opcode {
        op::HEADER => &[Long, Long],
        op::SCHEMA => &[Fixed(2), Long, Long, Long],
        op::CHANNEL => &[Fixed(4), Long, Long, Texts],
        op::CHUNK => &[Fixed(28), Long],
        op::MESSAGE_INDEX => &[Fixed(2), Long],
        op::CHUNK_INDEX => &[Fixed(32), Long, Fixed(8), Long],
        // The length of the content and the checksum come after the names: the crate panics where they are cut off.
        op::ATTACHMENT => &[Fixed(16), Long, Long, Fixed(12)],
        op::ATTACHMENT_INDEX => &[Fixed(40), Long, Long],
        op::STATISTICS => &[Fixed(42), Long],
        op::METADATA => &[Long, Texts],
        op::METADATA_INDEX => &[Fixed(16), Long],
        _ => &[],
    }
}

/// The record, if its body holds all that it claims to hold.
pub(super) fn parse(opcode: u8, body: &[u8]) -> Option<Record<'_>> {
    let mut rest = body;
    for field in fields(opcode) {
        rest = match *field {
            Field::Fixed(length) => rest.get(length..)?,
            Field::Long => long(rest)?.1,
            Field::Texts => {
                let (mut texts, rest) = long(rest)?;
                while !texts.is_empty() {
                    texts = long(texts)?.1;
                }
                rest
            }
        };
    }
    mcap::parse_record(opcode, body).ok()
}

/// A field that begins with its length, and what comes after it.
fn long(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    rest.split_at_checked(usize::try_from(u32::from_le_bytes(*length)).ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A text that claims four gigabytes is refused by its length, wherever it stands.
    #[test]
    fn no_record_claims_more_than_it_holds() {
        let metadata = [
            &4_u32.to_le_bytes()[..],
            b"name",
            &8_u32.to_le_bytes(),
            &u32::MAX.to_le_bytes(),
            &[0; 4],
        ]
        .concat();
        assert!(parse(op::METADATA, &metadata).is_none());
        for opcode in 0..=0x10 {
            for fixed in [0, 2, 4, 16, 28, 32, 40, 42] {
                let body = [&vec![0; fixed][..], &(u32::MAX - 8).to_le_bytes(), &[0; 24]].concat();
                // Within the memory of this test whatever the opcode; the lengths of messages and footers are fixed.
                let _ = parse(opcode, &body);
            }
        }
        let named = [&4_u32.to_le_bytes()[..], b"name", &0_u32.to_le_bytes()].concat();
        assert!(parse(op::METADATA, &named).is_some());
    }
}
