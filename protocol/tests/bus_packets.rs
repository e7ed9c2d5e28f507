//! Packets against the bytes that Robotis publishes, and against damage.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::*;
use protocol::bus::*;

/// Examples of the e-manual, "Protocol 2.0": instruction packets.
#[test]
fn packets_equal_the_published_examples() {
    let cases: &[(&str, Vec<u8>, &[u8])] = &[
        (
            "Ping id 1",
            Request::ping(1).unwrap().bytes().to_vec(),
            &[0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x03, 0x00, 0x01, 0x19, 0x4E],
        ),
        (
            "Broadcast ping",
            Request::ping(BROADCAST).unwrap().bytes().to_vec(),
            &[0xFF, 0xFF, 0xFD, 0x00, 0xFE, 0x03, 0x00, 0x01, 0x31, 0x42],
        ),
        (
            "Read present position (132, 4) of id 1",
            Request::read(1, 132, 4).unwrap().bytes().to_vec(),
            &[
                0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x07, 0x00, 0x02, 0x84, 0x00, 0x04, 0x00, 0x1D, 0x15,
            ],
        ),
        (
            "Write 512 to goal position (116) of id 1",
            Request::write(1, Register::GoalPosition, 512)
                .unwrap()
                .bytes()
                .to_vec(),
            &[
                0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x09, 0x00, 0x03, 0x74, 0x00, 0x00, 0x02, 0x00, 0x00,
                0xCA, 0x89,
            ],
        ),
        (
            "Reboot id 1",
            Request::reboot(1).unwrap().bytes().to_vec(),
            &[0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x03, 0x00, 0x08, 0x2F, 0x4E],
        ),
        (
            "Sync read present position of ids 1, 2",
            Request::sync_read(132, 4, &[1, 2])
                .unwrap()
                .bytes()
                .to_vec(),
            &[
                0xFF, 0xFF, 0xFD, 0x00, 0xFE, 0x09, 0x00, 0x82, 0x84, 0x00, 0x04, 0x00, 0x01, 0x02,
                0xCE, 0xFA,
            ],
        ),
        (
            "Sync write goal position 150 to id 1, 170 to id 2",
            Request::sync_write(Register::GoalPosition, &[(1, 150), (2, 170)])
                .unwrap()
                .bytes()
                .to_vec(),
            &[
                0xFF, 0xFF, 0xFD, 0x00, 0xFE, 0x11, 0x00, 0x83, 0x74, 0x00, 0x04, 0x00, 0x01, 0x96,
                0x00, 0x00, 0x00, 0x02, 0xAA, 0x00, 0x00, 0x00, 0x82, 0x87,
            ],
        ),
    ];
    for (what, ours, published) in cases {
        assert_eq!(&ours[..], *published, "{what}");
    }
}

/// Status packets of the same page.
#[test]
fn published_status_packets_are_read() {
    let ping = [
        0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x07, 0x00, 0x55, 0x00, 0x06, 0x04, 0x26, 0x65, 0x5D,
    ];
    let mut exchange = Exchange::new(Request::ping(1).unwrap());
    let answers = hear(&mut exchange, &ping);
    assert_eq!(answers, [(1, None, vec![0x06, 0x04, 0x26])]);
    assert!(exchange.is_complete());

    let read = [
        0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x08, 0x00, 0x55, 0x00, 0xA6, 0x00, 0x00, 0x00, 0x8C, 0xC0,
    ];
    let mut exchange = Exchange::new(Request::read(1, 132, 4).unwrap());
    for byte in read {
        exchange.push(byte);
    }
    assert_eq!(
        exchange
            .next_answer()
            .unwrap()
            .value(Register::PresentPosition),
        Some(166)
    );

    let second = [
        0xFF, 0xFF, 0xFD, 0x00, 0x02, 0x07, 0x00, 0x55, 0x00, 0x06, 0x04, 0x26, 0x6F, 0x6D,
    ];
    let mut exchange = Exchange::new(Request::ping(BROADCAST).unwrap());
    let answers = hear(&mut exchange, &[ping, second].concat());
    assert_eq!(
        answers.iter().map(|answer| answer.0).collect::<Vec<_>>(),
        [1, 2]
    );
    assert!(!exchange.is_complete(), "more may come");
}

type Heard = (u8, Option<StatusError>, Vec<u8>);

fn hear(exchange: &mut Exchange, bytes: &[u8]) -> Vec<Heard> {
    let mut heard = Vec::new();
    for &byte in bytes {
        exchange.push(byte);
        while let Some(answer) = exchange.next_answer() {
            heard.push((answer.id, answer.error, answer.data.to_vec()));
        }
    }
    heard
}

fn status(id: u8, error: u8, data: &[u8]) -> Vec<u8> {
    packet::Builder::new(id, Instruction::Status)
        .params(&[error])
        .params(data)
        .finish()
        .unwrap()
        .to_vec()
}

#[test]
fn stuffing_comes_back_and_no_header_stays_inside() {
    let mut rng = Rng(3);
    let mut parser = Parser::new();
    for _ in 0..20_000 {
        let params: Vec<u8> = (0..rng.below(40))
            .map(|_| [0xFF, 0xFF, 0xFD, 0xFD, 0x00, 0x55][rng.below(6)])
            .collect();
        let packet = packet::Builder::new(9, Instruction::Write)
            .params(&params)
            .finish()
            .unwrap();
        assert!(
            !packet[4..packet.len() - 2]
                .windows(4)
                .any(|w| w == packet::HEADER),
            "{packet:02X?}"
        );
        for byte in &packet {
            parser.push(*byte);
        }
        let got = parser.next_packet().unwrap();
        assert_eq!((got.id, got.instruction, got.params), (9, 3, &params[..]));
        assert!(parser.is_empty());
    }
}

#[test]
fn echo_stray_wrong_id_and_duplicates_are_told_apart() {
    let request = Request::feedback(&[1, 2, 3]).unwrap();
    let block = |id: u8| status(id, 0, &feedback(i32::from(id)).to_bytes());
    let echo = request.bytes().to_vec();
    let mut half_echo = echo.clone();
    half_echo.truncate(11);
    for (what, before) in [
        ("no echo", vec![]),
        ("echo", echo.clone()),
        ("cut echo", half_echo.clone()),
        ("late start of echo", echo[5..].to_vec()),
        ("noise", vec![0xFF, 0x00, 0xFF, 0xFF]),
        (
            "false header",
            vec![0xFF, 0xFF, 0xFD, 0x00, 0x05, 0x18, 0x00],
        ),
    ] {
        let mut exchange = Exchange::new(request.clone());
        let stream = [before, block(1), block(2), block(2), block(9), block(3)].concat();
        let mut ids: Vec<u8> = hear(&mut exchange, &stream)
            .iter()
            .map(|heard| heard.0)
            .collect();
        exchange.finish();
        ids.extend(hear(&mut exchange, &[]).iter().map(|heard| heard.0));
        while let Some(answer) = exchange.next_answer() {
            ids.push(answer.id);
        }
        assert_eq!(ids, [1, 2, 3], "{what}");
        assert!(exchange.is_complete(), "{what}");
        let counters = exchange.counters();
        assert_eq!((counters.wrong_id, counters.duplicates), (1, 1), "{what}");
        assert_eq!(counters.echoes, u32::from(what == "echo"), "{what}");
    }
}

#[test]
fn a_wrong_length_or_an_error_is_told() {
    let mut exchange = Exchange::new(Request::read(4, 132, 4).unwrap());
    assert_eq!(hear(&mut exchange, &status(4, 0, &[1, 2])), []);
    assert_eq!(exchange.counters().wrong_length, 1);
    assert_eq!(exchange.missing().collect::<Vec<_>>(), [4]);
    assert_eq!(
        hear(&mut exchange, &status(4, 0x87, &[])),
        [(4, Some(StatusError::Access), vec![])]
    );
    assert!(exchange.is_complete());
}

#[test]
fn the_packed_block_comes_back_and_never_needs_stuffing() {
    let mut rng = Rng(11);
    for round in 0..200_000 {
        // Extremes first: all ones make the most FF bytes.
        let mut word = || {
            if round < 100 {
                u64::MAX - rng.below(3) as u64
            } else {
                rng.next()
            }
        };
        let block = PackedFeedback {
            tick_4us: word() as u16,
            applied_urad: (word() as i32) >> 4,
            position_urad: (word() as i32) >> 4,
            velocity: word() as i16,
            current_ma: word() as i16 >> 2,
            duty: word() as i16 >> 4,
            voltage_5mv: word() as u16 >> 4,
            temperature_c: i16::from(word() as u8) - 40,
            status: word() as u8,
            boots: word() as u8 & 7,
        };
        let bytes = block.to_bytes();
        assert_eq!(PackedFeedback::from_bytes(&bytes), Some(block));
        // Id before, any checksum after: no three bytes FF FF FD begin or end inside.
        let around = [&[252][..], &bytes, &[0xFF, 0xFD, 0xFD]].concat();
        assert!(
            !around
                .windows(3)
                .take(PACKED_LEN + 1)
                .any(|w| w == [0xFF, 0xFF, 0xFD])
        );
    }
    let mut not_ours = PackedFeedback::default().to_bytes();
    not_ours[3] |= 0x80;
    assert_eq!(PackedFeedback::from_bytes(&not_ours), None);
    let beyond = PackedFeedback {
        current_ma: i16::MAX,
        applied_urad: i32::MIN,
        temperature_c: 999,
        ..PackedFeedback::default()
    };
    let back = PackedFeedback::from_bytes(&beyond.to_bytes()).unwrap();
    assert_eq!(
        (back.current_ma, back.applied_urad, back.temperature_c),
        (8191, -(1 << 27), 215)
    );
}

/// 6 motors at 20 Hz and 1 Mbaud: set-points and packed feedback in at most 5 % of the bus.
#[test]
fn one_cycle_takes_less_than_five_percent_of_the_bus() {
    let ids = [1, 2, 3, 4, 5, 6];
    let write = Request::set_points(&ids.map(|id| (id, 123_456))).unwrap();
    for (read, expected) in [
        (Request::feedback(&ids).unwrap(), 244),
        (Request::fast_feedback(&ids).unwrap(), 210),
    ] {
        let bytes = write.bytes().len() + read.bytes().len() + read.answer_bytes();
        assert_eq!(bytes, expected);
        let busy_us = bytes * 10;
        assert!(busy_us * 100 <= 5 * 50_000, "{busy_us} us");
    }
}

/// The packets of a cycle, request and answers.
fn cyclic_packets() -> Vec<Vec<u8>> {
    let ids = [1, 2, 3, 4, 5, 6];
    let mut packets = vec![
        Request::set_points(&ids.map(|id| (id, 100_000 * i32::from(id) - 300_000)))
            .unwrap()
            .bytes()
            .to_vec(),
        Request::feedback(&ids).unwrap().bytes().to_vec(),
        Request::fast_feedback(&ids).unwrap().bytes().to_vec(),
        Request::ping(BROADCAST).unwrap().bytes().to_vec(),
        Request::write(3, Register::TorqueEnable, 1)
            .unwrap()
            .bytes()
            .to_vec(),
    ];
    packets.extend(ids.map(|id| status(id, 0, &feedback(i32::from(id)).to_bytes())));
    packets
}

/// Packets that these line levels give and that are neither of the two.
fn wrong_packets(bits: &[bool], good: &[u8], next: &[u8], bytes: &mut Vec<u8>) -> u32 {
    bytes_of(bits, bytes);
    let mut parser = Parser::new();
    for byte in &*bytes {
        parser.push(*byte);
    }
    parser.end();
    let mut wrong = 0;
    while let Some(packet) = parser.next_packet() {
        wrong += u32::from(packet.bytes != good && packet.bytes != next);
    }
    wrong
}

/// CRC-16 cannot promise what CRC-32C does. None of the packets of a cycle turns into another one by a single flipped wire bit; by two, at most one in 10^5.
#[test]
fn wire_flips_of_the_cyclic_packets() {
    let next = Request::ping(5).unwrap().bytes().to_vec();
    let mut rng = Rng(0x5EED_0002);
    let (mut pairs, mut wrong_pairs, mut bytes) = (0, 0, Vec::new());
    for good in &cyclic_packets() {
        let mut bits = bits_of(&[&good[..], &next[..]].concat());
        for flip in 0..good.len() * 10 {
            bits[flip] = !bits[flip];
            assert_eq!(
                wrong_packets(&bits, good, &next, &mut bytes),
                0,
                "flip {flip}"
            );
            bits[flip] = !bits[flip];
        }
        for _ in 0..20_000 {
            let (first, second) = (rng.below(good.len() * 10), rng.below(good.len() * 10));
            bits[first] = !bits[first];
            bits[second] = !bits[second];
            wrong_pairs += wrong_packets(&bits, good, &next, &mut bytes);
            bits[first] = !bits[first];
            bits[second] = !bits[second];
            pairs += 1;
        }
    }
    println!("{wrong_pairs} wrong packets of {pairs} double flips");
    assert!(wrong_pairs * 100_000 <= pairs);
}

#[test]
fn hostile_bytes_never_stop_the_parser() {
    let mut rng = Rng(99);
    let mut parser = Parser::new();
    for round in 0..400_000 {
        // Mostly header bytes and lengths, to reach deep into the search.
        let byte = if round % 3 == 0 {
            rng.next() as u8
        } else {
            [0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x05][rng.below(6)]
        };
        parser.push(byte);
        while parser.next_packet().is_some() {}
    }
    let good = status(3, 0, &[1]);
    for byte in [0; MAX_PACKET] {
        parser.push(byte);
        while parser.next_packet().is_some() {}
    }
    let mut found = 0;
    for byte in good {
        parser.push(byte);
        while parser.next_packet().is_some() {
            found += 1;
        }
    }
    assert_eq!(found, 1);
}

#[test]
fn requests_nobody_answers_are_complete_at_once() {
    for request in [
        Request::set_points(&[(1, 5)]).unwrap(),
        Request::reboot(BROADCAST).unwrap(),
        Request::write(BROADCAST, Register::TorqueEnable, 0).unwrap(),
    ] {
        assert!(!request.is_answered());
        assert_eq!(
            (request.answer_bytes(), request.patience_ns(10_000)),
            (0, 0)
        );
        assert!(Exchange::new(request).is_complete());
    }
    // A broadcast ping listens for every slot: 253 of 154 us.
    let all = Request::ping(BROADCAST).unwrap();
    assert!(all.is_answered() && all.ids().is_empty());
    assert!(all.patience_ns(10_000) >= 253 * 154_000);
}

#[test]
fn what_does_not_fit_is_refused_before_it_is_sent() {
    let ids: Vec<u8> = (1..=13).collect();
    assert_eq!(
        Request::sync_read(132, 4, &ids[..12]).map(|request| request.ids().len()),
        Ok(12)
    );
    assert_eq!(Request::sync_read(132, 4, &ids), Err(TooLong));
    assert_eq!(Request::fast_sync_read(0, 148, &ids[..3]), Err(TooLong));
    assert_eq!(Request::read(1, 0, 1000), Err(TooLong));
    assert!(Request::read(1, 0, 148).is_ok());
    let many: Vec<(u8, i32)> = (0..100).map(|id| (id, 0)).collect();
    assert_eq!(Request::set_points(&many), Err(TooLong));
}

#[test]
fn every_error_number_is_named() {
    let names = [
        None,
        Some(StatusError::Result),
        Some(StatusError::Instruction),
        Some(StatusError::Crc),
        Some(StatusError::DataRange),
        Some(StatusError::DataLength),
        Some(StatusError::DataLimit),
        Some(StatusError::Access),
        Some(StatusError::Other),
    ];
    for (byte, name) in (0..).zip(names) {
        assert_eq!(StatusError::from_byte(byte), name);
        assert_eq!(StatusError::from_byte(byte | packet::ALERT), name);
        if let Some(error) = name.filter(|error| *error != StatusError::Other) {
            assert_eq!(error as u8, byte);
        }
    }
}

#[test]
fn a_second_master_is_noticed() {
    let mut exchange = Exchange::new(Request::ping(1).unwrap());
    assert_eq!(hear(&mut exchange, Request::ping(2).unwrap().bytes()), []);
    assert_eq!(
        (exchange.counters().foreign, exchange.counters().echoes),
        (1, 0)
    );
    assert_eq!(exchange.parser_counters().packets, 1);
}

/// A common answer by hand: error, id, data, then a checksum over everything so far, for each driver.
fn common_answer(parts: &[(u8, u8, &[u8])], len: usize) -> Vec<u8> {
    let length = (parts.len() * (len + 4) + 1) as u16;
    let mut bytes = packet::HEADER.to_vec();
    bytes.push(BROADCAST);
    bytes.extend(length.to_le_bytes());
    bytes.push(0x55);
    for (error, id, data) in parts {
        bytes.extend([*error, *id]);
        bytes.extend_from_slice(data);
        bytes.extend(protocol::crc::crc16(&bytes).to_le_bytes());
    }
    bytes
}

#[test]
fn a_common_answer_is_taken_apart() {
    let ask = || Exchange::new(Request::fast_sync_read(132, 4, &[3, 7, 4]).unwrap());
    // FF FF FD inside: nothing is unstuffed there.
    let good = common_answer(
        &[
            (0, 3, &[0xFF, 0xFF, 0xFD, 0xFD]),
            (0x80, 7, &[1, 2, 3, 4]),
            (0, 4, &[5; 4]),
        ],
        4,
    );
    let mut exchange = ask();
    assert_eq!(
        hear(&mut exchange, &good),
        [
            (3, None, vec![0xFF, 0xFF, 0xFD, 0xFD]),
            (7, None, vec![1, 2, 3, 4]),
            (4, None, vec![5; 4])
        ]
    );
    assert!(exchange.is_complete());

    let mut exchange = ask();
    let short = common_answer(&[(0, 3, &[1; 4]), (0, 7, &[1; 3])], 4);
    let mut short_framed = short.clone();
    short_framed[5] -= 1;
    let crc = protocol::crc::crc16(&short_framed[..short_framed.len() - 2]).to_le_bytes();
    let end = short_framed.len() - 2;
    short_framed[end..].copy_from_slice(&crc);
    assert_eq!(hear(&mut exchange, &short_framed), [(3, None, vec![1; 4])]);
    assert_eq!(exchange.counters().wrong_length, 1);
    assert_eq!(exchange.missing().collect::<Vec<_>>(), [7, 4]);

    let mut exchange = ask();
    assert_eq!(
        hear(
            &mut exchange,
            &common_answer(&[(0, 9, &[1; 4]), (0, 4, &[2; 4])], 4)
        ),
        [(4, None, vec![2; 4])]
    );
    assert_eq!(exchange.counters().wrong_id, 1);
}
