//! Bulk instructions, registered writes, factory reset, turns and indirect addresses, as the Protocol 2.0 page of the e-manual has them.

use super::*;
use protocol::bus::indirect::Indirect;
use protocol::bus::packet::{Builder, HEADER};
use protocol::bus::server::Keep;
use protocol::crc::crc16;

/// A packet from its parts; a slice of parameters.
fn packet(id: u8, instruction: Instruction, params: &[u8]) -> PacketBuf {
    Builder::new(id, instruction)
        .params(params)
        .finish()
        .unwrap()
}

/// Status packets on the wire: id, error byte, data.
fn statuses(heard: &[u8]) -> Vec<(u8, u8, Vec<u8>)> {
    let mut parser = Parser::new();
    let mut found = Vec::new();
    for byte in heard {
        parser.push(*byte);
        while let Some(packet) = parser.next_packet() {
            let (error, data) = packet.status().unwrap();
            found.push((packet.id, error, data.to_vec()));
        }
    }
    found
}

impl Bus {
    fn send(&mut self, id: u8, instruction: Instruction, params: &[u8]) -> Vec<(u8, u8, Vec<u8>)> {
        let heard = self.exchange(&packet(id, instruction, params));
        assert_eq!(self.collisions, 0);
        statuses(&heard)
    }
}

#[test]
fn a_bulk_write_gives_each_driver_its_own_registers() {
    let mut bus = Bus::new(&[1, 2, 3]);
    // Goal position of 1, LED of 3; 9 does not exist; the last entry is cut.
    let params = [
        &[1, 116, 0, 4, 0, 10, 0, 0, 0][..],
        &[9, 65, 0, 1, 0, 1],
        &[3, 65, 0, 1, 0, 1],
        &[2, 65, 0, 1, 0],
    ]
    .concat();
    assert_eq!(bus.send(BROADCAST, Instruction::BulkWrite, &params), []);
    let writes = |bus: &mut Bus, id| bus.driver(id).writes.clone();
    assert_eq!(writes(&mut bus, 1), [(Register::GoalPosition, 10)]);
    assert_eq!(writes(&mut bus, 2), []);
    assert_eq!(writes(&mut bus, 3), [(Register::Led, 1)]);
}

#[test]
fn a_bulk_read_is_answered_in_its_order_with_lengths_of_its_own() {
    let mut bus = Bus::new(&[1, 2, 3]);
    let params = [
        &[3, 132, 0, 4, 0][..],
        &[7, 132, 0, 4, 0],
        &[1, 0, 0, 2, 0],
        &[2, 146, 0, 1, 0],
    ]
    .concat();
    let begun_ns = bus.now_ns;
    let answers = bus.send(BROADCAST, Instruction::BulkRead, &params);
    let temperature = bus.driver(2).read(Register::PresentTemperature) as u8;
    assert_eq!(
        answers,
        [
            (3, 0, 1003_i32.to_le_bytes().to_vec()),
            (1, 0, vec![0x52, 0x42]),
            (2, 0, vec![temperature]),
        ]
    );
    // The missing one is waited for and skipped; all measured at the same instant.
    assert!(bus.now_ns - begun_ns < 4_000_000);
    let latched: Vec<_> = [1, 2, 3].map(|id| bus.driver(id).latched_ns.clone()).into();
    assert!(
        latched.iter().all(|times| *times == latched[0]),
        "{latched:?}"
    );
    bus.driver(1).registers.set(Register::StatusReturnLevel, 0);
    assert_eq!(
        bus.send(BROADCAST, Instruction::BulkRead, &[1, 0, 0, 2, 0]),
        []
    );
}

#[test]
fn a_fast_bulk_read_is_one_packet_with_a_checksum_after_each_part() {
    let mut bus = Bus::new(&[1, 2, 3]);
    let params = [&[3, 132, 0, 4, 0][..], &[1, 0, 0, 2, 0], &[2, 200, 3, 1, 0]].concat();
    let heard = bus.exchange(&packet(BROADCAST, Instruction::FastBulkRead, &params));
    assert_eq!(bus.collisions, 0);
    let goal = 1003_i32.to_le_bytes();
    let mut want = [&HEADER[..], &[0xFE, 20, 0, 0x55, 0, 3], &goal].concat();
    want.extend(crc16(&want).to_le_bytes());
    want.extend([0, 1, 0x52, 0x42]);
    want.extend(crc16(&want).to_le_bytes());
    // No such address: an access error in its place.
    want.extend([7, 2, 0]);
    want.extend(crc16(&want).to_le_bytes());
    assert_eq!(heard, want);
}

/// A damaged length swallows what follows it. Found again too late, a request is not answered: its time on the bus is over.
#[test]
fn a_request_that_is_found_late_is_not_answered() {
    let sync = [&[132, 0, 4, 0][..], &[1, 2]].concat();
    let bulk = [&[1, 132, 0, 4, 0][..], &[2, 132, 0, 4, 0]].concat();
    for (instruction, params) in [
        (Instruction::SyncRead, &sync),
        (Instruction::FastSyncRead, &sync),
        (Instruction::BulkRead, &bulk),
        (Instruction::FastBulkRead, &bulk),
    ] {
        let inside = [
            packet(BROADCAST, instruction, params),
            packet(9, Instruction::Ping, &[]),
        ]
        .concat();
        let len = (inside.len() as u16).to_le_bytes();
        let swallowed = [&HEADER[..], &[2], &len, &inside].concat();
        let mut bus = Bus::new(&[1, 2]);
        assert_eq!(bus.exchange(&swallowed), [], "{instruction:?}");
        // The servers are whole: the next request is answered.
        assert_eq!(bus.send(1, Instruction::Ping, &[]).len(), 1);
    }
}

#[test]
fn a_registered_write_waits_for_its_action() {
    let mut bus = Bus::new(&[1, 2]);
    let goal = [116, 0, 99, 0, 0, 0];
    assert_eq!(bus.send(1, Instruction::Action, &[]), [(1, 2, vec![])]);
    assert_eq!(bus.send(1, Instruction::RegWrite, &goal), [(1, 0, vec![])]);
    assert_eq!(
        bus.send(1, Instruction::Read, &[69, 0, 1, 0]),
        [(1, 0, vec![1])]
    );
    assert_eq!(bus.driver(1).writes, []);
    // A refused one is answered at once and leaves the first.
    for (params, error) in [
        (&[132, 0, 1, 0, 0, 0][..], 7),
        (&[84, 0, 0x20, 0x4E], 4),
        (&[116, 0, 1], 5),
        (&[116], 5),
    ] {
        assert_eq!(
            bus.send(1, Instruction::RegWrite, params),
            [(1, error, vec![])],
            "{params:?}"
        );
    }
    assert_eq!(bus.send(BROADCAST, Instruction::Action, &[]), []);
    assert_eq!(bus.driver(1).writes, [(Register::GoalPosition, 99)]);
    assert_eq!(bus.driver(2).writes, []);
    assert_eq!(
        bus.send(1, Instruction::Read, &[69, 0, 1, 0]),
        [(1, 0, vec![0])]
    );
    // A reboot forgets it.
    bus.send(1, Instruction::RegWrite, &goal);
    bus.send(1, Instruction::Reboot, &[]);
    assert_eq!(bus.send(1, Instruction::Action, &[]), [(1, 2, vec![])]);
}

#[test]
fn a_factory_reset_names_what_it_keeps() {
    let mut bus = Bus::new(&[1, 2]);
    for (params, error) in [
        (&[0x01][..], 0),
        (&[0x02], 0),
        (&[0xFF], 0),
        (&[0x03], 4),
        (&[], 4),
    ] {
        assert_eq!(
            bus.send(1, Instruction::FactoryReset, params),
            [(1, error, vec![])]
        );
    }
    assert_eq!(
        bus.driver(1).resets,
        [Keep::Id, Keep::IdAndBaud, Keep::Nothing]
    );
    // For all at once it would give every driver the same id.
    assert_eq!(bus.send(BROADCAST, Instruction::FactoryReset, &[0xFF]), []);
    assert_eq!(bus.driver(2).resets, []);
    assert_eq!(bus.send(BROADCAST, Instruction::FactoryReset, &[0x01]), []);
    assert_eq!(bus.driver(2).resets, [Keep::Id]);
}

#[test]
fn turns_are_cleared_by_the_whole_word_alone() {
    let mut bus = Bus::new(&[1]);
    assert_eq!(bus.send(1, Instruction::Clear, &[1]), [(1, 4, vec![])]);
    assert_eq!(bus.driver(1).turns, 3);
    assert_eq!(
        bus.send(1, Instruction::Clear, &[0x01, 0x44, 0x58, 0x4C, 0x22]),
        [(1, 0, vec![])]
    );
    assert_eq!(bus.driver(1).turns, 0);
}

#[test]
fn indirect_data_stands_for_the_bytes_that_were_named() {
    for (profile, data) in [(Profile::Xl330, 208_u8), (Profile::Xm430, 224)] {
        let mut bus = Bus::new(&[1]);
        bus.driver(1).indirect = Indirect::of(profile);
        // Untouched, a place stands for itself and reads 0.
        assert_eq!(
            bus.send(1, Instruction::Read, &[168, 0, 2, 0]),
            [(1, 0, vec![data, 0])]
        );
        // Temperature, then the goal position, through places 1 to 5.
        let map = [168, 0, 146, 0, 116, 0, 117, 0, 118, 0, 119, 0];
        assert_eq!(bus.send(1, Instruction::Write, &map), [(1, 0, vec![])]);
        assert_eq!(
            bus.send(1, Instruction::Write, &[data + 1, 0, 9, 0, 0, 0]),
            [(1, 0, vec![])]
        );
        assert_eq!(bus.driver(1).writes, [(Register::GoalPosition, 9)]);
        bus.driver(1)
            .registers
            .set(Register::PresentTemperature, 31);
        assert_eq!(
            bus.send(1, Instruction::Read, &[data, 0, 5, 0]),
            [(1, 0, vec![31, 9, 0, 0, 0])]
        );
        // Below the RAM area; half a register; beyond the data; our own block.
        for (params, error) in [
            (&[168, 0, 7, 0][..], 4),
            (&[168, 0, 7], 5),
            (&[data + 1, 0, 9], 5),
            (&[0, 4, 1, 0, 0, 0], 7),
        ] {
            assert_eq!(
                bus.send(1, Instruction::Write, params),
                [(1, error, vec![])],
                "{params:?}"
            );
        }
        for params in [[250, 0, 9, 0], [0x28, 4, 19, 0], [150, 0, 1, 0]] {
            assert_eq!(
                bus.send(1, Instruction::Read, &params),
                [(1, 7, vec![])],
                "{params:?}"
            );
        }
    }
}
