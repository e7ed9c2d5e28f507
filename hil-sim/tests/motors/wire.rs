//! The bus as a master sees it: instructions, registers, times, faults.

use hil_sim::bus::BusParams;
use hil_sim::fault::{Fault, FaultKind};
use hil_sim::motor::JointKind;
use hil_sim::world::{World, WorldParams};
use protocol::bus::feedback::{PackedFeedback, status};
use protocol::bus::packet::StatusError;
use protocol::bus::table::{
    Access, PACKED_FEEDBACK, Register, TABLE, WATCHDOG_TRIPPED, ZERO_HERE_MAGIC,
};
use protocol::bus::{Exchange, PACKED_LEN, Request};

const MS: u64 = 1_000_000;
const IDS: [u8; 6] = [1, 2, 3, 4, 5, 6];

fn params() -> WorldParams {
    WorldParams::metamodule(11, JointKind::neutral)
}

fn world() -> World {
    World::on_stand(&params()).expect("valid")
}

/// What one driver answered.
#[derive(Clone, Debug, PartialEq)]
struct Got {
    id: u8,
    error: Option<StatusError>,
    alert: bool,
    data: Vec<u8>,
}

/// Sends a request, listens for `wait_ns` after it, returns every answer.
fn ask(world: &mut World, request: Request, wait_ns: u64) -> Vec<Got> {
    let sent_ns = world.write_bytes(world.now_ns(), request.bytes());
    let mut exchange = Exchange::new(request);
    let mut got = Vec::new();
    while let Some(arrival) = world.advance_to_byte(sent_ns + wait_ns) {
        exchange.push(arrival.byte);
        while let Some(answer) = exchange.next_answer() {
            got.push(Got {
                id: answer.id,
                error: answer.error,
                alert: answer.alert,
                data: answer.data.to_vec(),
            });
        }
    }
    got
}

fn write(world: &mut World, id: u8, register: Register, value: i32) -> Result<(), StatusError> {
    let request = Request::write(id, register, value).expect("short");
    let got = ask(world, request, MS);
    assert_eq!(got.len(), 1, "one answer to a write of {register:?}");
    got[0].error.map_or(Ok(()), Err)
}

fn read(world: &mut World, id: u8, register: Register) -> i32 {
    let request = Request::read(id, register.address(), register.size()).expect("short");
    let got = ask(world, request, MS);
    assert_eq!(
        (got.len(), got.first().and_then(|g| g.error)),
        (1, None),
        "read of {register:?}"
    );
    register.value_of(&got[0].data)
}

fn feedback(world: &mut World) -> Vec<PackedFeedback> {
    let got = ask(world, Request::feedback(&IDS).expect("six"), 5 * MS);
    got.iter()
        .map(|g| {
            PackedFeedback::from_bytes(g.data.as_slice().try_into().expect("length"))
                .expect("block")
        })
        .collect()
}

#[test]
fn ping_finds_each_and_broadcast_finds_all_in_order_without_collision() {
    let mut world = world();
    for id in IDS {
        let got = ask(&mut world, Request::ping(id).expect("short"), MS);
        assert_eq!(got.iter().map(|g| g.id).collect::<Vec<_>>(), [id]);
        assert_eq!(
            got[0].data,
            [0x52, 0x42, 1],
            "model number RB, table version"
        );
    }
    let got = ask(&mut world, Request::ping(254).expect("short"), 50 * MS);
    assert_eq!(got.iter().map(|g| g.id).collect::<Vec<_>>(), IDS);
    assert_eq!(world.bus_counters().collided_bytes, 0);
    assert!(ask(&mut world, Request::ping(9).expect("short"), 5 * MS).is_empty());
}

/// Every register: read, and written at both ends of its range, beyond it, read-only or not, torque on and off.
#[test]
fn every_register_keeps_its_access_class_and_range() {
    for info in TABLE {
        let (register, id) = (info.register, 1);
        let mut world = world();
        let len = info.len;
        read(&mut world, id, register);
        let encodable = |value: i64| {
            len == 4 || (-(1_i64 << (8 * len - 1))..1_i64 << (8 * len)).contains(&value)
        };
        for torque in [0, 1] {
            write(&mut world, id, Register::TorqueEnable, torque).expect("torque");
            let eeprom_locked = info.access == Access::Eeprom && torque == 1;
            if info.access == Access::Read || eeprom_locked {
                assert_eq!(
                    write(&mut world, id, register, info.min),
                    Err(StatusError::Access),
                    "{}",
                    info.name
                );
                continue;
            }
            for outside in [i64::from(info.min) - 1, i64::from(info.max) + 1] {
                // Below zero an unsigned register sees another number.
                let wraps = i32::try_from(outside).is_err()
                    || !encodable(outside)
                    || (!info.signed && outside < 0);
                if !wraps {
                    let result = write(&mut world, id, register, outside as i32);
                    assert_eq!(
                        result,
                        Err(StatusError::DataRange),
                        "{} = {outside}",
                        info.name
                    );
                }
            }
        }
    }
}

/// Every instruction, to one driver, to all, and to a stranger.
#[test]
fn every_instruction_behaves_as_documented() {
    let raw = |id: u8, instruction, params: &[u8]| {
        use protocol::bus::packet::Builder;
        Builder::new(id, instruction)
            .params(params)
            .finish()
            .expect("short")
    };
    use protocol::bus::packet::Instruction as I;
    // (instruction, parameters, error of a unicast answer, answers to broadcast)
    let table: &[(I, &[u8], u8, usize)] = &[
        (I::Ping, &[], 0, 6),
        (I::Read, &[132, 0, 4, 0], 0, 0),
        (I::Read, &[132, 0], 5, 0),
        (I::Read, &[0xFF, 0x3F, 1, 0], 7, 0),
        (I::Write, &[65, 0, 1], 0, 0),
        (I::Write, &[65], 5, 0),
        (I::Write, &[132, 0, 0, 0, 0, 0], 7, 0),
        (I::RegWrite, &[65, 0, 1], 0, 0),
        (I::Action, &[], 2, 0),
        (I::FactoryReset, &[0xFF], 0, 0),
        (I::FactoryReset, &[0x01], 0, 0),
        (I::Clear, &[1, 0x44, 0x58, 0x4C, 0x22], 0, 0),
        (I::Reboot, &[], 0, 0),
    ];
    for (instruction, bytes, error, to_all) in table {
        for (id, answers) in [(3, 1), (254, *to_all), (77, 0)] {
            let mut world = world();
            let packet = raw(id, *instruction, bytes);
            let sent = world.write_bytes(0, &packet);
            let mut heard = Vec::new();
            while let Some(arrival) = world.advance_to_byte(sent + 50 * MS) {
                heard.push(arrival.byte);
            }
            let headers = heard
                .windows(4)
                .filter(|w| *w == [0xFF, 0xFF, 0xFD, 0])
                .count();
            assert_eq!(headers, answers, "{instruction:?} to {id}: {heard:02X?}");
            if id == 3 {
                assert_eq!(heard[8], *error, "{instruction:?} {bytes:?}: error byte");
            }
        }
    }
}

/// The cycle of the firmware: set-points out, six packed blocks back. Printed, and within 5 % of 50 ms.
#[test]
fn bus_time_of_a_cycle() {
    for (label, fast) in [("Sync Read", false), ("Fast Sync Read", true)] {
        let mut world = world();
        let goals: Vec<_> = IDS.iter().map(|id| (*id, 0)).collect();
        let start = world.now_ns();
        let set = Request::set_points(&goals).expect("six");
        let sent = world.write_bytes(start, set.bytes());
        let request = if fast {
            Request::fast_feedback(&IDS)
        } else {
            Request::feedback(&IDS)
        }
        .expect("six");
        let bytes = set.bytes().len() + request.bytes().len() + request.answer_bytes();
        world.write_bytes(sent, request.bytes());
        let (mut exchange, mut answers, mut last) = (Exchange::new(request), 0, 0);
        while let Some(arrival) = world.advance_to_byte(start + 20 * MS) {
            exchange.push(arrival.byte);
            last = arrival.at_ns;
            while exchange.next_answer().is_some() {
                answers += 1;
            }
        }
        assert_eq!(answers, 6, "{label}");
        let ms = (last - start) as f64 * 1e-6;
        println!(
            "bus time per cycle, Sync Write + {label} of six packed blocks: {bytes} bytes, {ms:.2} ms, {:.2} % of 50 ms",
            ms * 2.0
        );
        assert_eq!(
            last - start,
            bytes as u64 * 10_000,
            "{label}: every byte 10 us, no gap at zero turnaround"
        );
        assert!(ms <= 2.5, "{label}: {ms} ms");
    }
}

#[test]
fn set_points_over_the_bus_move_six_joints_and_are_echoed() {
    let mut world = world();
    for id in IDS {
        write(&mut world, id, Register::TorqueEnable, 1).expect("torque");
    }
    let mut goal = 0;
    for _ in 0..10 {
        goal += 50_000;
        let goals: Vec<_> = IDS
            .iter()
            .map(|id| (*id, goal * i32::from(*id % 2 * 2) - goal))
            .collect();
        ask(&mut world, Request::set_points(&goals).expect("six"), 0);
        world.advance_to(world.now_ns() + 50 * MS);
    }
    world.advance_to(world.now_ns() + 2_000 * MS);
    let blocks = feedback(&mut world);
    assert_eq!(blocks.len(), 6);
    for (id, block) in IDS.iter().zip(&blocks) {
        let expected = if id % 2 == 1 { 500_000 } else { -500_000 };
        assert_eq!(block.applied_urad, expected);
        assert!((block.position_urad - expected).abs() < 200, "{block:?}");
        assert_eq!(block.status, status::TORQUE, "{block:?}");
        assert_eq!(block.voltage_5mv, 2_400);
        assert_eq!(block.temperature_c, 22);
    }
    // Ticks of 4 us on the driver's own clock: two reads 30 ms apart.
    world.advance_to(world.now_ns() + 30 * MS);
    let later = feedback(&mut world);
    let ticks = later[0].tick_4us.wrapping_sub(blocks[0].tick_4us);
    assert!((7_500..9_500).contains(&ticks), "{ticks}");
}

#[test]
fn implausible_goals_are_refused_with_an_error_and_a_status_bit() {
    let mut world = world();
    write(&mut world, 1, Register::TorqueEnable, 1).expect("torque");
    assert_eq!(write(&mut world, 1, Register::GoalAngle, 349_000), Ok(()));
    assert_eq!(
        write(&mut world, 1, Register::GoalAngle, 900_000),
        Err(StatusError::DataLimit)
    );
    assert_eq!(
        feedback(&mut world)[0].status & status::REFUSED,
        status::REFUSED
    );
    assert_eq!(
        feedback(&mut world)[0].status & status::REFUSED,
        0,
        "read once, then gone"
    );
    assert_eq!(read(&mut world, 1, Register::GoalAngle), 349_000);
}

#[test]
fn watchdog_register_trips_latches_and_clears() {
    let mut world = world();
    write(&mut world, 2, Register::TorqueEnable, 1).expect("torque");
    write(&mut world, 2, Register::BusWatchdog, 7).expect("140 ms");
    world.advance_to(world.now_ns() + 130 * MS);
    assert_eq!(read(&mut world, 2, Register::BusWatchdog), 7);
    // Traffic for others does not feed it.
    for _ in 0..8 {
        world.advance_to(world.now_ns() + 20 * MS);
        read(&mut world, 3, Register::PresentAngle);
    }
    assert_eq!(read(&mut world, 2, Register::BusWatchdog), WATCHDOG_TRIPPED);
    assert_eq!(
        write(&mut world, 2, Register::GoalAngle, 1_000),
        Err(StatusError::Access)
    );
    assert_eq!(
        feedback(&mut world)[1].status & status::WATCHDOG,
        status::WATCHDOG
    );
    write(&mut world, 2, Register::BusWatchdog, 0).expect("cleared");
    write(&mut world, 2, Register::GoalAngle, 1_000).expect("goals again");
}

#[test]
fn reboot_over_the_bus_drops_torque_zero_and_ram_but_keeps_eeprom() {
    let mut world = world();
    write(&mut world, 4, Register::ReturnDelay, 10).expect("eeprom");
    write(&mut world, 4, Register::ZeroHere, ZERO_HERE_MAGIC).expect("zero");
    assert_eq!(read(&mut world, 4, Register::ZeroHere), 1);
    write(&mut world, 4, Register::TorqueEnable, 1).expect("torque");
    write(&mut world, 4, Register::PositionPGain, 400).expect("gain");
    let before = feedback(&mut world)[3].boots;
    ask(&mut world, Request::reboot(4).expect("short"), MS);
    let after = feedback(&mut world)[3];
    assert_eq!(after.boots, before + 1);
    assert_eq!(after.status, 0, "torque off, zero unknown");
    assert!(after.tick_4us < 2_500, "clock from 0: {}", after.tick_4us);
    assert_eq!(read(&mut world, 4, Register::PositionPGain), 800);
    assert_eq!(read(&mut world, 4, Register::ReturnDelay), 10);
}

#[test]
fn return_delay_and_baud_change_the_time() {
    let answer_ns = |baud, delay_ns| {
        let mut params = params();
        params.bus = BusParams { baud, echo: false };
        params.joints[0].driver.return_delay_ns = delay_ns;
        let mut world = World::on_stand(&params).expect("valid");
        let request = Request::ping(1).expect("short");
        let sent = world.write_bytes(0, request.bytes());
        world
            .advance_to_byte(sent + 100 * MS)
            .expect("answers")
            .at_ns
            - sent
    };
    assert_eq!(answer_ns(1_000_000, 0), 10_000);
    assert_eq!(answer_ns(1_000_000, 500_000), 510_000);
    assert_eq!(answer_ns(115_200, 0), 86_805);
}

#[test]
fn echo_is_heard_byte_for_byte_when_on() {
    let mut params = params();
    params.bus.echo = true;
    let mut world = World::on_stand(&params).expect("valid");
    let request = Request::ping(1).expect("short");
    let sent = world.write_bytes(0, request.bytes());
    let mut heard = Vec::new();
    while let Some(arrival) = world.advance_to_byte(sent + MS) {
        heard.push(arrival.byte);
    }
    assert_eq!(&heard[..request.bytes().len()], request.bytes());
    assert_eq!(heard.len(), request.bytes().len() + 14);
}

/// Each fault does what its name says, is counted, and stays inside its window.
#[test]
fn faults_strike_and_are_counted() {
    let with = |fault: Fault| {
        let mut params = params();
        params.faults = vec![fault];
        World::on_stand(&params).expect("valid")
    };
    let answers = |world: &mut World| {
        let mut ids = Vec::new();
        for _ in 0..20 {
            let got = ask(world, Request::feedback(&IDS).expect("six"), 8 * MS);
            ids.extend(
                got.iter()
                    .filter(|g| g.error.is_none() && g.data.len() == PACKED_LEN)
                    .map(|g| g.id),
            );
        }
        ids
    };
    let count = |world: &World| world.fault_counts()[0].count;

    for kind in [FaultKind::ReplyLoss, FaultKind::RequestLoss] {
        let mut world = with(Fault::always(kind).on(2).chance(0.5));
        let lost = 120 - answers(&mut world).len();
        assert!((4..=16).contains(&lost), "{kind:?}: {lost}");
        assert_eq!(count(&world), lost as u64, "{kind:?}");
    }
    for kind in [FaultKind::ByteLoss, FaultKind::Corruption] {
        let mut world = with(Fault::always(kind).chance(0.002));
        let heard = answers(&mut world).len();
        assert!(
            heard < 120 && count(&world) > 0,
            "{kind:?}: {heard} answers, {} faults",
            count(&world)
        );
    }
    let mut world = with(Fault::always(FaultKind::Missing).on(0));
    assert!(!answers(&mut world).contains(&1));
    assert_eq!(count(&world), 1);
    let mut world = with(Fault::always(FaultKind::Babble).on(5).chance(0.05));
    assert!(answers(&mut world).len() < 120);
    assert!(count(&world) > 0 && world.bus_counters().collided_bytes > 0);
    let mut world = with(Fault::always(FaultKind::DuplicateId { id: 1 }).on(1));
    let pings = ask(&mut world, Request::ping(1).expect("short"), MS);
    assert!(
        pings.is_empty() && world.bus_counters().collided_bytes > 0,
        "{pings:?}"
    );
    let mut world = with(Fault::always(FaultKind::ReplyDelay { delay_s: 0.003 }).on(0));
    let request = Request::ping(1).expect("short");
    let sent = world.write_bytes(0, request.bytes());
    assert_eq!(
        world
            .advance_to_byte(sent + 10 * MS)
            .expect("late answer")
            .at_ns
            - sent,
        3_010_000
    );
}

#[test]
fn faults_of_joint_and_supply() {
    let run = |kind: FaultKind| {
        let mut params = params();
        params.faults = vec![Fault::always(kind).on(0).during(0.2, 5.0)];
        let mut world = World::on_stand(&params).expect("valid");
        write(&mut world, 1, Register::TorqueEnable, 1).expect("torque");
        write(&mut world, 1, Register::GoalPosition, 650).expect("1 rad");
        world.advance_to(4_500 * MS);
        let count = world.fault_counts()[0].count;
        assert_eq!(count, 1, "{kind:?}");
        (
            feedback(&mut world)[0],
            world.joint(0).expect("joint").link_rad,
        )
    };
    let (block, angle) = run(FaultKind::Stall);
    assert!(
        angle < 0.9 && block.status & status::HARDWARE_ERROR != 0,
        "{angle} {block:?}"
    );
    let (block, _) = run(FaultKind::StuckEncoder);
    assert!(
        block.status & status::HARDWARE_ERROR != 0 && block.status & status::TORQUE == 0,
        "{block:?}"
    );
    let (block, angle) = run(FaultKind::EncoderJump { jump_rad: 0.3 });
    assert!(
        (angle - 0.697).abs() < 0.01,
        "the joint follows the jump: {angle}"
    );
    assert!((block.position_urad - 997_000).abs() < 2_000, "{block:?}");
    let (block, _) = run(FaultKind::Reset);
    // Frictionless and released, it coasts on.
    assert!(
        block.boots == 1 && block.status == status::MOVING,
        "{block:?}"
    );
    let mut params = params();
    params.faults = vec![Fault::always(FaultKind::BrownOut { ratio: 0.3 }).during(0.2, 0.3)];
    let mut world = World::on_stand(&params).expect("valid");
    write(&mut world, 1, Register::TorqueEnable, 1).expect("torque");
    world.advance_to(250 * MS);
    assert!(
        ask(&mut world, Request::ping(1).expect("short"), MS).is_empty(),
        "no supply, no answer"
    );
    world.advance_to(400 * MS);
    let blocks = feedback(&mut world);
    assert!(
        blocks.iter().all(|b| b.boots != 0 && b.status == 0),
        "{blocks:?}"
    );
}

/// Equal seeds give equal traces under every fault at once; another seed another trace.
#[test]
fn seeded_faults_repeat() {
    let trace = |seed| {
        let mut params = params();
        params.seed = seed;
        params.faults = vec![
            Fault::always(FaultKind::Corruption).chance(1e-3),
            Fault::always(FaultKind::ByteLoss).chance(1e-3),
            Fault::always(FaultKind::ReplyLoss).chance(0.1),
            Fault::always(FaultKind::Babble).on(3).chance(1e-3),
        ];
        let mut world = World::on_stand(&params).expect("valid");
        let mut all = Vec::new();
        for k in 1..=40_u64 {
            let request = Request::feedback(&IDS).expect("six");
            world.write_bytes(k * 50 * MS, request.bytes());
            while let Some(arrival) = world.advance_to_byte((k + 1) * 50 * MS - 1) {
                all.push((arrival.at_ns, arrival.byte));
            }
        }
        (
            all,
            world
                .fault_counts()
                .iter()
                .map(|c| c.count)
                .collect::<Vec<_>>(),
        )
    };
    assert_eq!(trace(1), trace(1));
    assert_ne!(trace(1), trace(2));
}

/// A packed block anywhere in the table is whole or refused; addresses next to it are not.
#[test]
fn packed_block_is_read_whole() {
    let mut world = world();
    let whole = ask(
        &mut world,
        Request::read(1, PACKED_FEEDBACK, PACKED_LEN as u16).expect("short"),
        MS,
    );
    assert_eq!(whole[0].data.len(), PACKED_LEN);
    let beyond = ask(
        &mut world,
        Request::read(1, PACKED_FEEDBACK, 60).expect("short"),
        2 * MS,
    );
    assert_eq!(beyond[0].error, Some(StatusError::Access));
}

/// 30 s of six catalogue motors under the firmware's cycle: equal bits twice; the speed is printed.
#[test]
fn thirty_seconds_repeat_bit_for_bit() {
    let run = || {
        let mut world = World::on_stand(&WorldParams::metamodule(11, JointKind::catalogue_joint))
            .expect("valid");
        for id in IDS {
            write(&mut world, id, Register::TorqueEnable, 1).expect("torque");
        }
        let mut bits = Vec::new();
        for k in 1..=600_u64 {
            world.advance_to(k * 50 * MS);
            let phase = k as f64 * 0.05 * 0.2 * std::f64::consts::TAU;
            let goals: Vec<_> = IDS
                .iter()
                .map(|id| (*id, (0.7e6 * (phase + f64::from(*id)).sin()) as i32))
                .collect();
            let goals: Vec<_> = if k < 20 {
                goals
                    .iter()
                    .map(|(id, g)| (*id, g * k as i32 / 20))
                    .collect()
            } else {
                goals
            };
            ask(&mut world, Request::set_points(&goals).expect("six"), 0);
            let blocks = feedback(&mut world);
            bits.extend(blocks.iter().map(|b| b.position_urad));
        }
        bits.push(
            (0..6)
                .map(|k| world.joint(k).expect("joint").link_rad.to_bits() as i32)
                .fold(0, |a, b| a ^ b),
        );
        bits
    };
    let begun = std::time::Instant::now();
    let first = run();
    let ratio = 30.0 / begun.elapsed().as_secs_f64();
    println!("emulated motors: 30 s of six drives at {ratio:.0} times real time");
    assert_eq!(first, run());
}
