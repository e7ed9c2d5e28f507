//! Frames against every damage a serial line can do.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::*;
use proptest::prelude::*;
use protocol::link::*;

/// Every frame the decoder accepts out of these bytes, as (sequence, type, payload).
fn accepted(decoder: &mut Decoder, bytes: &[u8]) -> Vec<(u16, u8, Vec<u8>)> {
    let mut frames = Vec::new();
    for &byte in bytes {
        if let Some(frame) = decoder.push(byte) {
            frames.push((
                frame.header.sequence,
                frame.kind(),
                frame.payload().to_vec(),
            ));
        }
    }
    frames
}

fn all_frames() -> Vec<Vec<u8>> {
    let mut frames: Vec<_> = to_module()
        .iter()
        .map(|message| frame(&host_header(0x0102), message))
        .collect();
    frames.extend(
        from_module()
            .iter()
            .map(|message| frame(&module_header(0x0102), message)),
    );
    frames
}

#[test]
fn every_message_comes_back() {
    let mut decoder = Decoder::new();
    for message in to_module() {
        let bytes = frame(&host_header(5), &message);
        let got = bytes
            .iter()
            .find_map(|byte| decoder.push(*byte).map(|frame| frame.decode::<ToModule>()));
        assert_eq!(got, Some(Ok(message)));
    }
    for message in from_module() {
        let bytes = frame(&module_header(5), &message);
        let got = bytes.iter().find_map(|byte| {
            decoder
                .push(*byte)
                .map(|frame| frame.decode::<FromModule>())
        });
        assert_eq!(got, Some(Ok(message)));
    }
    assert_eq!(
        decoder.counters().frames as usize,
        to_module().len() + from_module().len()
    );
}

#[test]
fn the_largest_gait_fits_with_its_tag() {
    let message = ToModule::PutGait {
        slot: 255,
        activate: true,
        gait: largest_gait(),
        tag: Tag([0xFF; TAG_LEN]),
    };
    let bytes = frame(&host_header(u16::MAX), &message);
    assert!(bytes.len() <= MAX_FRAME);
    // Slot, flag, gait 431, tag 16; header 9, CRC 4; two COBS codes, two zeros.
    assert_eq!(bytes.len(), 2 + 431 + 16 + 9 + 4 + 2 + 2);
    let mut decoder = Decoder::new();
    let got = accepted(&mut decoder, &bytes);
    assert_eq!(got.len(), 1);
}

#[test]
fn no_single_wire_flip_makes_another_frame() {
    let mut decoder = Decoder::new();
    let (mut flips, mut lost_both) = (0, 0);
    let mut bytes = Vec::new();
    for frame_bytes in all_frames() {
        let next = frame(&host_header(0x0304), &ToModule::Ping { host_t_us: 42 });
        let good = accepted(&mut decoder, &frame_bytes);
        let good_next = accepted(&mut decoder, &next);
        let mut stream = frame_bytes.clone();
        stream.extend_from_slice(&next);
        let bits = bits_of(&stream);
        for flip in 0..frame_bytes.len() * 10 {
            let mut damaged = bits.clone();
            damaged[flip] = !damaged[flip];
            bytes_of(&damaged, &mut bytes);
            // A zero ends what the flip may have left open, as the next frame's leading zero does on a real line.
            bytes.push(0);
            for got in accepted(&mut decoder, &bytes) {
                assert!(
                    got == good[0] || got == good_next[0],
                    "flip {flip} made {got:?}"
                );
            }
            flips += 1;
            lost_both += u32::from(accepted(&mut decoder, &next) != good_next);
        }
    }
    assert_eq!(lost_both, 0, "the frame after the next must always be read");
    assert!(flips > 15_000, "{flips}");
}

#[test]
fn no_double_wire_flip_makes_another_frame() {
    let mut rng = Rng(0x5EED_0001);
    let mut decoder = Decoder::new();
    let mut bytes = Vec::new();
    for frame_bytes in all_frames() {
        let good = accepted(&mut decoder, &frame_bytes);
        let bits = bits_of(&frame_bytes);
        let mut check = |first: usize, second: usize| {
            let mut damaged = bits.clone();
            damaged[first] = !damaged[first];
            damaged[second] = !damaged[second];
            bytes_of(&damaged, &mut bytes);
            bytes.push(0);
            for got in accepted(&mut decoder, &bytes) {
                assert_eq!(got, good[0], "flips {first} {second}");
            }
        };
        // Neighbours within 24 bits all, the rest sampled.
        for first in 0..bits.len() {
            for second in first + 1..(first + 25).min(bits.len()) {
                check(first, second);
            }
        }
        for _ in 0..20_000 {
            check(rng.below(bits.len()), rng.below(bits.len()));
        }
    }
}

#[test]
fn byte_faults_of_an_upload_never_make_another_gait() {
    let upload = frame(
        &host_header(1),
        &ToModule::PutGait {
            slot: 1,
            activate: true,
            gait: gait(),
            tag: Tag([3; TAG_LEN]),
        },
    );
    let next = frame(&host_header(2), &ToModule::GetInfo);
    let mut decoder = Decoder::new();
    let good = accepted(&mut decoder, &upload);
    let good_next = accepted(&mut decoder, &next);
    let mut check = |damaged: &[u8], what: &str| {
        let mut stream = damaged.to_vec();
        stream.extend_from_slice(&next);
        let got = accepted(&mut decoder, &stream);
        assert!(got.contains(&good_next[0]), "{what}: next frame lost");
        for one in &got {
            assert!(
                *one == good[0] || *one == good_next[0],
                "{what}: wrong frame {one:?}"
            );
        }
    };
    for at in 0..=upload.len() {
        check(&upload[..at], &format!("cut at {at}"));
    }
    for at in 0..upload.len() {
        let mut dropped = upload.clone();
        dropped.remove(at);
        check(&dropped, &format!("byte {at} dropped"));
        let mut twice = upload.clone();
        twice.insert(at, upload[at]);
        check(&twice, &format!("byte {at} twice"));
        for other in at + 1..(at + 17).min(upload.len()) {
            let mut swapped = upload.clone();
            swapped.swap(at, other);
            check(&swapped, &format!("bytes {at} and {other} swapped"));
        }
        for value in [0x00, 0x01, 0x7F, 0x80, 0xFE, 0xFF] {
            let mut replaced = upload.clone();
            replaced[at] = value;
            check(&replaced, &format!("byte {at} = {value}"));
        }
    }
}

#[test]
fn hostile_bytes_are_bounded_and_counted() {
    let mut decoder = Decoder::new();
    let next = frame(&host_header(2), &ToModule::GetInfo);
    // Endless frame without a delimiter.
    for _ in 0..100_000 {
        assert!(decoder.push(0x55).is_none());
    }
    assert_eq!(decoder.counters().overflow, 1);
    assert_eq!(accepted(&mut decoder, &next).len(), 1);
    // Flood of delimiters.
    for _ in 0..100_000 {
        assert!(decoder.push(0).is_none());
    }
    assert_eq!(accepted(&mut decoder, &next).len(), 1);
    // Noise.
    let mut rng = Rng(7);
    for _ in 0..2_000_000 {
        assert!(decoder.push(rng.next() as u8).is_none());
    }
    decoder.push(0);
    assert_eq!(accepted(&mut decoder, &next).len(), 1);
    assert!(decoder.counters().bad_crc > 0 && decoder.counters().bad_framing > 1000);
}

#[test]
fn version_type_and_length_are_told_apart() {
    let mut decoder = Decoder::new();
    let mut other = host_header(1);
    other.version = 9;
    let mut decode = |bytes: &[u8]| {
        bytes
            .iter()
            .find_map(|byte| decoder.push(*byte).map(|frame| frame.decode::<ToModule>()))
    };
    assert_eq!(
        decode(&frame(&other, &ToModule::GetInfo)),
        Some(Err(DecodeError::Version { theirs: 9 }))
    );

    // The envelope written by hand, with the cobs crate and the published CRC only.
    let by_hand = |message: &[u8]| {
        let mut body = vec![1, 0, 1, 0, 0, 0, 0, 0];
        body.extend_from_slice(message);
        body.extend_from_slice(
            &crc::Crc::<u32>::new(&crc::CRC_32_ISCSI)
                .checksum(&body)
                .to_le_bytes(),
        );
        let mut out = vec![0; cobs::max_encoding_length(body.len()) + 2];
        let len = cobs::encode(&body, &mut out[1..]);
        out.truncate(len + 2);
        out
    };
    assert_eq!(decode(&by_hand(&[1])), Some(Ok(ToModule::GetInfo)));
    assert_eq!(
        decode(&by_hand(&[ToModule::COUNT])),
        Some(Err(DecodeError::UnknownType {
            kind: ToModule::COUNT
        }))
    );
    assert_eq!(
        decode(&by_hand(&[0xFF, 1, 2])),
        Some(Err(DecodeError::UnknownType { kind: 255 }))
    );
    assert_eq!(
        decode(&by_hand(&[1, 0])),
        Some(Err(DecodeError::TrailingBytes))
    );
    assert_eq!(decode(&by_hand(&[4])), Some(Err(DecodeError::Malformed)));
    assert_eq!(decode(&by_hand(&[])), None);
}

#[test]
fn a_short_buffer_is_refused_at_every_length() {
    for message in from_module() {
        let whole = frame(&module_header(1), &message);
        for len in 0..whole.len() {
            let mut out = vec![0; len];
            assert_eq!(
                encode(&module_header(1), &message, &mut out),
                Err(EncodeError::BufferTooSmall)
            );
        }
        let mut exact = vec![0; whole.len()];
        assert_eq!(
            encode(&module_header(1), &message, &mut exact),
            Ok(whole.len())
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_gait_comes_back_bit_for_bit(
        numbers in proptest::collection::vec(any::<u32>(), 3 + 3 * 12 + 2 * 24),
        ends in proptest::collection::vec(any::<(u8, u8)>(), 0..=24),
        oscillators in 0..=12_usize,
        name in "[a-z\u{e4}\u{20ac}]{0,10}",
        header in any::<(u8, u16, u32)>(),
    ) {
        let mut numbers = numbers.into_iter().map(f32::from_bits);
        let mut number = || numbers.next().unwrap();
        let mut gait = WireGait { name: name.as_str().try_into().unwrap(), ..WireGait::default() };
        (gait.frequency_hz, gait.rate_a_per_s, gait.duration_s) = (number(), number(), number());
        for _ in 0..oscillators {
            let oscillator =
                WireOscillator { amplitude_rad: number(), offset_rad: number(), initial_phase_rad: number() };
            gait.oscillators.push(oscillator).unwrap();
        }
        for (from, to) in ends {
            gait.links.push(WireLink { from, to, weight: number(), phase_lag_rad: number() }).unwrap();
        }
        let header = Header { version: VERSION, source: header.0, sequence: header.1, boot_id: header.2 };
        let bytes = frame(&header, &ToModule::PutGait { slot: 0, activate: false, gait: gait.clone(), tag: Tag::NONE });
        let mut decoder = Decoder::new();
        let got = bytes.iter().find_map(|byte| decoder.push(*byte).map(|frame| (frame.header, frame.decode::<ToModule>())));
        let Some((got_header, Ok(ToModule::PutGait { gait: got, .. }))) = got else { panic!("{got:?}") };
        prop_assert_eq!(got_header, header);
        // Bits, not values: NaN is unequal to itself.
        let mut buffers = [[0; protocol::link::gait::MAX_GAIT]; 2];
        let [first, second] = &mut buffers;
        prop_assert_eq!(gait.to_bytes(first), got.to_bytes(second));
        prop_assert_eq!(gait.digest(), got.digest());
    }

    #[test]
    fn any_payload_is_read_or_refused(kind in 0..24_u8, payload in proptest::collection::vec(any::<u8>(), 0..MAX_PAYLOAD)) {
        let mut body = vec![VERSION, SOURCE_HOST, 0, 0, 0, 0, 0, 0, kind];
        body.extend_from_slice(&payload);
        body.extend_from_slice(&protocol::crc::crc32c(&body).to_le_bytes());
        let mut bytes = cobs::encode_vec(&body);
        bytes.push(0);
        let mut decoder = Decoder::new();
        let got = bytes.iter().find_map(|byte| {
            decoder.push(*byte).map(|frame| (frame.decode::<ToModule>(), frame.decode::<FromModule>()))
        });
        let (to, from) = got.unwrap();
        prop_assert_eq!(to == Err(DecodeError::UnknownType { kind }), kind >= ToModule::COUNT);
        prop_assert_eq!(from == Err(DecodeError::UnknownType { kind }), kind >= FromModule::COUNT);
    }
}

/// Numbers of a host stay below those that the module gives what it sends unasked.
#[test]
fn a_hosts_numbers_wrap_below_those_of_the_module() {
    for first in [0, UNASKED - 2, u16::MAX] {
        let mut host = Client::new(first);
        let mut out = [0; MAX_FRAME];
        let mut last = None;
        for _ in 0..5 {
            let (sequence, _) = host.request(&ToModule::GetInfo, None, &mut out).unwrap();
            assert!(sequence < UNASKED, "{sequence:#06x}");
            assert_ne!(Some(sequence), last);
            last = Some(sequence);
        }
    }
}
