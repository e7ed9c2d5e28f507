//! Table profiles against the manuals: packets byte by byte, units against their definition, and frames that survive noise.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use proptest::prelude::*;
use protocol::bus::feedback::status;
use protocol::bus::profile::{Framing, WATCHDOG_COUNTS};
use protocol::bus::table::Register;
use protocol::bus::*;
use std::f64::consts::TAU;

const SERVOS: [Profile; 5] = [
    Profile::Xl330,
    Profile::Xc330,
    Profile::Xm430,
    Profile::Sts,
    Profile::Scs,
];

/// The number is stored in modules and sent on the link; names stand in files. **Do not change this table**: add to its end.
#[test]
fn numbers_and_names_are_frozen() {
    let names = ["packed", "xl330", "xc330", "xm430", "sts", "scs"];
    assert_eq!(Profile::ALL.len(), names.len());
    for (number, (profile, name)) in Profile::ALL.into_iter().zip(names).enumerate() {
        assert_eq!(profile as usize, number);
        assert_eq!(profile.info().profile, profile);
        assert_eq!(profile.info().name, name);
        assert_eq!(Profile::from_name(name), Some(profile));
        assert_eq!(Profile::from_number(number as u8), Some(profile));
    }
    assert_eq!(Profile::from_number(6), None);
    assert_eq!(Profile::from_name("XL330"), None);
}

#[test]
fn a_model_belongs_to_one_profile() {
    for profile in Profile::ALL {
        let info = profile.info();
        assert!(!info.models.is_empty());
        for model in info.models {
            assert_eq!(Profile::of_model(info.framing, *model), Some(profile));
        }
    }
    assert_eq!(Profile::of_model(Framing::Dynamixel2, 777), None);
    assert_eq!(Profile::of_model(Framing::Feetech, 1200), None);
}

/// Packets as printed in the manuals.
#[test]
fn requests_have_the_bytes_of_the_manuals() {
    let xl = Profile::Xl330.info();
    let sts = Profile::Sts.info();
    let scs = Profile::Scs.info();
    let turns = |counts: i32| (f64::from(counts) * TAU / 4096.0 * 1e6).round() as i32;
    for (what, request, want) in [
        // Robotis e-manual, Protocol 2.0, Sync Write: goal positions 150 and 170.
        (
            "X goals",
            xl.set_points(&[(1, turns(150)), (2, turns(170))]),
            "FFFFFD00FE110083740004000196000000 02AA0000008287",
        ),
        // The same page, Read: present position of ID 1.
        (
            "X read",
            xl.read(1, 132, 4),
            "FFFFFD00010700028400 04001D15",
        ),
        // The same page, Write: 512 to the goal position of ID 1.
        (
            "X write",
            xl.write(1, 116, &[0, 2, 0, 0]),
            "FFFFFD000109000374000002 0000CA89",
        ),
        // Feetech protocol manual, 1.3.1: ping of ID 1.
        ("STS ping", sts.ping(1), "FFFF010201FB"),
        // 1.3.2: two bytes from 0x38, the present position, of ID 1.
        ("STS read", sts.read(1, 0x38, 2), "FFFF0104023802BE"),
        // 1.3.3: position 2048, time 0, speed 1000 to ID 1.
        (
            "STS write",
            sts.write(1, 0x2A, &[0, 8, 0, 0, 0xE8, 3]),
            "FFFF0109032A00080000E803D5",
        ),
        // 1.3.7: eight bytes from 0x38 of IDs 1 and 2 (ours are 31 from 0x28).
        (
            "STS sync read",
            sts.read_feedback(&[1, 2]),
            "FFFFFE0682281F010 22F",
        ),
        (
            "SCS torque",
            scs.sync_write(&scs.torque, &[(1, 1), (2, 1)]),
            "FFFFFE0883280101010201 48",
        ),
    ] {
        let bytes: Vec<u8> = request.unwrap().bytes().to_vec();
        let hex: String = bytes.iter().map(|byte| format!("{byte:02X}")).collect();
        assert_eq!(hex, want.replace(' ', ""), "{what}");
    }
    // One driver too: all of a bus latch at the same kind of packet.
    assert_eq!(sts.read_feedback(&[1]).unwrap().bytes()[4], 0x82);
    assert!(scs.read_feedback(&[1, 2]).is_err(), "SCS has no Sync Read");
    assert_eq!(scs.read_feedback(&[7]).unwrap().ids(), [7]);
}

/// STS sends the low byte first and a sign bit, SCS the high byte first and no negative numbers.
#[test]
fn byte_order_and_sign_of_the_two_feetech_series() {
    let goal = |profile: Profile, counts: i32| profile.info().goal.bytes_of(counts)[..2].to_vec();
    assert_eq!(goal(Profile::Sts, 2048), [0x00, 0x08]);
    assert_eq!(goal(Profile::Sts, -2048), [0x00, 0x88]);
    assert_eq!(goal(Profile::Scs, 511), [0x01, 0xFF]);
    for profile in SERVOS {
        let info = profile.info();
        for counts in [0, 1, 1023] {
            let bytes = info.goal.bytes_of(counts);
            assert_eq!(info.goal.value_of(&bytes), counts, "{}", info.name);
        }
    }
    let sts = Profile::Sts.info();
    for counts in -30_719..=30_719 {
        assert_eq!(sts.goal.value_of(&sts.goal.bytes_of(counts)), counts);
    }
}

/// What each place of the indirect block stands for, by the registers of the table.
#[test]
fn the_map_of_the_x_servos_names_the_registers_of_the_table() {
    for profile in [Profile::Xl330, Profile::Xc330, Profile::Xm430] {
        let info = profile.info();
        let map = info
            .settings
            .iter()
            .find(|setting| setting.address == 168)
            .unwrap();
        let targets: Vec<u16> = map
            .bytes
            .chunks_exact(2)
            .map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
            .collect();
        let mut want = Vec::new();
        for (register, bytes) in [
            (Register::TorqueEnable, 1),
            (Register::HardwareError, 1),
            (Register::BusWatchdog, 1),
            (Register::GoalPosition, 3),
            (Register::RealtimeTick, 2),
            (Register::PresentPwm, 2),
            (Register::PresentCurrent, 2),
            (Register::PresentVelocity, 2),
            (Register::PresentPosition, 3),
            (Register::PresentInputVoltage, 2),
            (Register::PresentTemperature, 1),
        ] {
            want.extend((0..bytes).map(|k| register.address() + k));
        }
        assert_eq!(targets, want);
        assert_eq!(usize::from(info.feedback_len), targets.len());
        // Torque goes off first and the watchdog on last: it is what tells of a restart.
        assert_eq!(info.settings.first().unwrap().address, 64);
        let last = info.settings.last().unwrap();
        assert_eq!((last.address, last.bytes), (98, &[WATCHDOG_COUNTS][..]));
        for address in [info.torque, info.goal, info.hardware_error] {
            assert!(Register::at(address.address).is_some());
        }
    }
}

#[test]
fn an_x_reading_comes_out_in_our_units() {
    let block: Vec<u8> = [
        &[1, 0x20, 8][..],
        &(-5000_i32).to_le_bytes()[..3],
        &1234_u16.to_le_bytes(),
        &(-885_i16).to_le_bytes(),
        &100_i16.to_le_bytes(),
        &(-100_i16).to_le_bytes(),
        &70_000_i32.to_le_bytes()[..3],
        &74_u16.to_le_bytes(),
        &[41],
    ]
    .concat();
    for (profile, ma) in [
        (Profile::Xl330, 100),
        (Profile::Xc330, 100),
        (Profile::Xm430, 269),
    ] {
        let reading = profile.info().decode(&block, 0).unwrap();
        let angle = |counts: f64| (counts * TAU / 4096.0 * 1e6).round() as i32;
        assert!(reading.applied_urad.abs_diff(angle(-5000.0)) <= 2);
        assert!(reading.position_urad.abs_diff(angle(70_000.0)) <= 10);
        assert_eq!(reading.tick_4us, (1_234_000_u32 / 4) as u16);
        assert_eq!((reading.duty, reading.current_ma), (-2000, ma));
        // 22.9 rpm = 2.398 rad/s = 4796 steps of 0.5 mrad/s.
        assert_eq!(reading.velocity, -4796);
        assert_eq!((reading.voltage_5mv, reading.temperature_c), (1480, 41));
        assert_eq!(
            reading.status,
            status::TORQUE | status::HARDWARE_ERROR | status::MOVING
        );
        assert_eq!(profile.info().decode(&block[1..], 0), None);
        // After a restart the places stand for themselves and read 0.
        let restarted = profile.info().decode(&[0; 20], 0).unwrap();
        assert_eq!(restarted.status, status::RESTARTED);
        let mut tripped = block.clone();
        tripped[2] = 0xFF;
        let tripped = profile.info().decode(&tripped, 0).unwrap();
        assert_ne!(tripped.status & status::WATCHDOG, 0);
    }
}

#[test]
fn a_feetech_reading_comes_out_in_our_units() {
    for (profile, big) in [(Profile::Sts, false), (Profile::Scs, true)] {
        let info = profile.info();
        let mut block = vec![0; 31];
        let mut put = |address: usize, value: u16| {
            let bytes = if big {
                value.to_be_bytes()
            } else {
                value.to_le_bytes()
            };
            block[address - 40..address - 38].copy_from_slice(&bytes);
        };
        put(42, 1000);
        put(46, 7000);
        put(56, if big { 900 } else { 0x8000 | 900 });
        put(58, 0x8000 | 100);
        put(60, 0x400 | 250);
        put(69, 20);
        block[0] = 1;
        block[22] = 74;
        block[23] = 35;
        block[25] = 0x20;
        let reading = info.decode(&block, 4_000).unwrap();
        let count = if big {
            300_f64.to_radians() / 1024.0
        } else {
            TAU / 4096.0
        };
        let angle = |counts: f64| (counts * count * 1e6).round() as i32;
        assert!(reading.applied_urad.abs_diff(angle(1000.0)) <= 2);
        let position = if big { 900.0 } else { -900.0 };
        assert!(reading.position_urad.abs_diff(angle(position)) <= 2);
        let velocity = (-100.0 * count / 5e-4) as i16;
        assert!(
            reading.velocity.abs_diff(velocity) <= 1,
            "{}",
            reading.velocity
        );
        assert_eq!((reading.duty, reading.current_ma), (-500, 130));
        assert_eq!((reading.voltage_5mv, reading.temperature_c), (1480, 35));
        assert_eq!(reading.tick_4us, 1000, "the time of the request");
        let bits = status::TORQUE | status::HARDWARE_ERROR | status::MOVING;
        assert_eq!(reading.status, bits);
        // A cleared Goal Speed tells of a restart of an STS; an SCS forgets nothing that counts.
        let restarted = info.decode(&[0; 31], 0).unwrap().status;
        assert_eq!(restarted, if big { 0 } else { status::RESTARTED });
    }
}

#[test]
fn set_points_stay_within_what_a_driver_takes() {
    for (profile, most_rad) in [
        (Profile::Packed, 134.2),
        (Profile::Xl330, 134.2),
        (Profile::Sts, 47.12),
    ] {
        let info = profile.info();
        let urad = (most_rad * 1e6) as i32;
        assert!(info.goal_counts(urad).is_some(), "{}", info.name);
        assert!(info.goal_counts(-urad).is_some(), "{}", info.name);
    }
    let (sts, scs) = (Profile::Sts.info(), Profile::Scs.info());
    assert_eq!(sts.goal_counts(47_200_000), None);
    assert_eq!(scs.goal_counts(-10_000), None);
    assert_eq!(scs.goal_counts(2_617_994), Some(512));
    assert_eq!(scs.goal_counts(5_250_000), None);
    // Who cannot take his set-point is left out.
    let request = scs.set_points(&[(1, 0), (2, -1_000_000)]).unwrap();
    let alone = scs.set_points(&[(1, 0)]).unwrap();
    assert_eq!(request.bytes(), alone.bytes());
}

#[test]
fn a_feetech_exchange_takes_answers_echoes_and_errors() {
    let info = Profile::Sts.info();
    let request = info.read(1, 3, 2).unwrap();
    assert_eq!(request.answer_bytes(), 8);
    let mut exchange = Exchange::new(request.clone());
    let other = feetech::packet(2, 0, &[&[9, 9]]).unwrap();
    let short = feetech::packet(1, 0, &[&[9]]).unwrap();
    // Overload: the data is good all the same.
    let answer = feetech::packet(1, 0x20, &[&[9, 3]]).unwrap();
    let stream = [
        request.bytes(),
        &other,
        &short,
        &[0xFF, 0x12],
        &answer,
        &answer,
    ]
    .concat();
    let mut heard = Vec::new();
    for byte in stream {
        exchange.push(byte);
        while let Some(answer) = exchange.next_answer() {
            assert_eq!(answer.error, None);
            heard.push((answer.id, answer.alert, answer.data.to_vec()));
        }
    }
    assert_eq!(heard, [(1, true, vec![9, 3])]);
    assert!(exchange.is_complete());
    let counters = exchange.counters();
    let counted = (
        counters.echoes,
        counters.wrong_id,
        counters.wrong_length,
        counters.duplicates,
    );
    assert_eq!(counted, (1, 1, 1, 1));
}

/// What cannot be a packet is skipped, whatever its checksum, and the packet behind it is found.
#[test]
fn a_feetech_packet_of_no_possible_length_or_id_is_none() {
    let good = feetech::packet(3, 2, &[&[7]]).unwrap();
    // Length counts instruction and checksum: 0 and 1 are too short, 157 is more than a parser holds; 255 is no id.
    let bad: [(u8, u8); 6] = [(1, 0), (1, 1), (1, 157), (1, 255), (253, 1), (255, 2)];
    for (id, length) in bad {
        let mut parser = feetech::Parser::new();
        let mut bytes = vec![0xFF, 0xFF, id, length];
        // The checksum that a packet without content would have.
        bytes.push(!(id.wrapping_add(length)));
        bytes.extend_from_slice(&good);
        bytes.iter().for_each(|byte| parser.push(*byte));
        let found = parser.next_packet().map(|packet| (packet.id, packet.code));
        assert_eq!(found, Some((3, 2)), "id {id}, length {length}");
        assert!(parser.next_packet().is_none());
        assert_eq!(parser.counters().packets, 1);
    }
}

/// A parser keeps what may become a header, and no other byte; once no more will come it keeps nothing.
#[test]
fn a_feetech_parser_waits_for_a_header_only() {
    for (bytes, waits) in [
        (&[0xFF][..], true),
        (&[0xFF, 0xFF], true),
        (&[0xFF, 0xFF, 3], true),
        (&[0x00], false),
        (&[0xFF, 0x05], false),
        (&[0x05, 0xFF, 0x04], false),
        (&[0x05, 0x04, 0xFF], true),
    ] {
        let mut parser = feetech::Parser::new();
        bytes.iter().for_each(|byte| parser.push(*byte));
        assert!(parser.next_packet().is_none());
        assert_eq!(!parser.is_empty(), waits, "{bytes:02x?}");
        parser.end();
        assert!(parser.next_packet().is_none());
        assert!(parser.is_empty(), "{bytes:02x?}");
        assert_eq!(parser.counters().stray_bytes, bytes.len() as u32);
    }
}

proptest! {
    /// Packets between stray bytes that hold no header are found, whole and in order.
    #[test]
    fn feetech_packets_survive_noise(
        packets in prop::collection::vec((0_u8..=252, 0_u8..=0xFE, prop::collection::vec(any::<u8>(), 0..32)), 1..8),
        noise in prop::collection::vec(prop::collection::vec(0_u8..=0xFE, 0..6), 8),
    ) {
        let mut parser = feetech::Parser::new();
        let mut found = Vec::new();
        for ((id, code, params), noise) in packets.iter().zip(&noise) {
            let packet = feetech::packet(*id, *code, &[params]).unwrap();
            for byte in noise.iter().chain(&packet) {
                parser.push(*byte);
                while let Some(packet) = parser.next_packet() {
                    found.push((packet.id, packet.code, packet.params.to_vec()));
                }
            }
        }
        prop_assert_eq!(found, packets);
    }

    /// Whatever comes, nothing breaks, and what is found has a good checksum.
    #[test]
    fn a_feetech_parser_takes_any_bytes(bytes in prop::collection::vec(prop_oneof![Just(0xFF_u8), any::<u8>()], 0..600)) {
        let mut parser = feetech::Parser::new();
        for (k, byte) in bytes.iter().enumerate() {
            parser.push(*byte);
            if k + 1 == bytes.len() {
                parser.end();
            }
            while let Some(packet) = parser.next_packet() {
                let (sum, body) = packet.bytes.split_last().unwrap();
                prop_assert_eq!(feetech::checksum(&body[2..]), *sum);
            }
        }
        prop_assert!(bytes.is_empty() || parser.is_empty());
    }

    /// A set-point that goes out and comes back as the applied one is the same within half a count.
    #[test]
    fn angles_come_back(urad in -47_000_000_i32..47_000_000) {
        for profile in Profile::ALL {
            let info = profile.info();
            if let Some(counts) = info.goal_counts(urad) {
                let half = info.units.turn_urad / info.units.counts / 2 + 1;
                prop_assert!(info.angle_urad(counts).abs_diff(urad) <= half.unsigned_abs());
            }
        }
    }
}
