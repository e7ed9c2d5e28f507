//! Films: the list of pictures, and pictures.

use std::path::Path;

use camera::depth::{self, Samples};
use camera::picture;
use host::searching::frames;

use crate::Bytes;

/// Every picture that a list names lies in the folder of the film, and its times rise.
pub(crate) fn index(data: &[u8]) {
    let Ok(text) = core::str::from_utf8(data) else {
        return;
    };
    let Ok(listed) = frames::parse_index(Path::new("index.csv"), text) else {
        return;
    };
    assert!(listed.windows(2).all(|pair| pair[0].1 < pair[1].1));
    assert!(
        listed
            .iter()
            .all(|(_, _, file)| files::dataset::is_inside(file))
    );
    let times: Vec<f64> = listed.iter().map(|(_, t_s, _)| *t_s).collect();
    if let Ok(count) = frames::instants(&times, 30.0) {
        assert!(count <= frames::MAX_FRAMES);
    }
}

/// Pictures as they are, and PNG files with right checksums around any header and any data.
pub(crate) fn picture(data: &[u8]) {
    let mut input = Bytes::new(data);
    match input.byte() % 4 {
        0 => silhouette(input.rest()),
        1 => {
            if let Ok(frame) = depth::read_pgm(input.rest(), Samples::BigEndian) {
                let again = depth::read_pgm(&depth::write_pgm(&frame), Samples::BigEndian);
                assert_eq!(again.map(|f| f.raw).ok(), Some(frame.raw));
            }
        }
        _ => silhouette(&png(&mut input)),
    }
}

fn silhouette(bytes: &[u8]) {
    drop(depth::read_png(bytes));
    if let Ok(frame) = picture::read_silhouette_png(bytes) {
        let written = picture::silhouette_png(&frame).expect("a frame");
        let again = picture::read_silhouette_png(&written).expect("what we wrote");
        assert!(again == frame, "the picture says something else");
    }
}

/// Header of 13 bytes, then chunks of any kind; the last one holds stored blocks of pixels.
fn png(input: &mut Bytes<'_>) -> Vec<u8> {
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut header = [0; 13];
    let given = input.take(13);
    header[..given.len()].copy_from_slice(given);
    if input.byte() & 1 == 0 {
        // Small, or nothing is decoded: a picture of 2^31 pixels is refused by its header.
        header[..3].fill(0);
        header[4..7].fill(0);
    }
    chunk(&mut out, *b"IHDR", &header);
    for _ in 0..input.byte() % 4 {
        let mut kind = *b"tEXt";
        let given = input.take(4);
        kind[..given.len()].copy_from_slice(given);
        chunk(&mut out, kind, input.block());
    }
    chunk(&mut out, *b"IDAT", &stored(input.rest()));
    chunk(&mut out, *b"IEND", &[]);
    out
}

fn chunk(out: &mut Vec<u8>, kind: [u8; 4], data: &[u8]) {
    out.extend((data.len() as u32).to_be_bytes());
    let start = out.len();
    out.extend(kind);
    out.extend(data);
    let sum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&out[start..]);
    out.extend(sum.to_be_bytes());
}

/// A zlib stream that stores its bytes (RFC 1950, RFC 1951 section 3.2.4).
fn stored(data: &[u8]) -> Vec<u8> {
    let mut out = vec![0x78, 0x01, 1];
    let len = data.len() as u16;
    out.extend(len.to_le_bytes());
    out.extend((!len).to_le_bytes());
    out.extend(data);
    let (mut a, mut b) = (1_u32, 0_u32);
    for &byte in data {
        a = (a + u32::from(byte)) % 65521;
        b = (b + a) % 65521;
    }
    out.extend((b << 16 | a).to_be_bytes());
    out
}
