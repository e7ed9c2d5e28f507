//! MCAP recordings, whole and damaged.

use host::recording::{csv, parse};

use crate::Bytes;

const MAGIC: &[u8] = b"\x89MCAP0\r\n";
const CHUNK: u8 = 6;

/// Bytes as they are, records with right lengths, and records in a chunk with a right checksum.
pub(crate) fn mcap(data: &[u8]) {
    let mut input = Bytes::new(data);
    let file = match input.byte() % 4 {
        0 => input.rest().to_vec(),
        1 => [MAGIC, input.rest()].concat(),
        2 => [MAGIC, &records(&mut input), MAGIC].concat(),
        _ => {
            let inside = records(&mut input);
            [MAGIC, &chunk(&inside), MAGIC].concat()
        }
    };
    let recording = parse(&file);
    for run in &recording.runs {
        assert!(
            run.samples
                .windows(2)
                .all(|pair| pair[0].t_us < pair[1].t_us)
        );
        drop(csv::to_csv(run));
    }
    let _ = (recording.text("gait.toml"), recording.foreign_topics());
}

fn records(input: &mut Bytes<'_>) -> Vec<u8> {
    let mut out = Vec::new();
    while !input.is_empty() {
        record(&mut out, input.byte(), input.block());
    }
    out
}

fn record(out: &mut Vec<u8>, opcode: u8, body: &[u8]) {
    out.push(opcode);
    out.extend((body.len() as u64).to_le_bytes());
    out.extend(body);
}

fn chunk(inside: &[u8]) -> Vec<u8> {
    let sum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(inside);
    let mut body = vec![0; 16];
    body.extend((inside.len() as u64).to_le_bytes());
    body.extend(sum.to_le_bytes());
    body.extend(0_u32.to_le_bytes());
    body.extend((inside.len() as u64).to_le_bytes());
    body.extend(inside);
    let mut out = Vec::new();
    record(&mut out, CHUNK, &body);
    out
}
