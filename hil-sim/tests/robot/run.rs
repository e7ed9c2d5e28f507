//! Runs: set-points equal the law's to the bit, telemetry is whole, leases end.

use crate::common::{check_set_points, gait, ready, ready_on, ready_with, shipped};
use control::cpg;
use control::gait::Gait;
use hil_sim::robot::host::SimHost;
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::crc::Crc32c;
use protocol::link::telemetry::flags;
use protocol::link::{
    EndReason, EventKind, FromModule, ModuleState, RunEnd, Sample, SampleBlock, TelemetryRate,
    ToModule,
};
use protocol::units;

fn samples(blocks: &[SampleBlock]) -> Vec<Sample> {
    blocks
        .iter()
        .flat_map(SampleBlock::samples)
        .map(|sample| sample.expect("our own block"))
        .collect()
}

/// What `control` alone gives: 30 s at 20 Hz.
fn law(gait: &Gait) -> Vec<[f32; 6]> {
    let mut state = cpg::start(gait);
    (0..600)
        .map(|_| {
            cpg::step(gait, &mut state, control::CYCLE_S)
                .joints()
                .expect("six")
        })
        .collect()
}

fn crc(law: &[[f32; 6]]) -> u32 {
    let mut crc = Crc32c::new();
    for angle in law.iter().flatten() {
        crc.update(&angle.to_le_bytes());
    }
    crc.value()
}

fn urad(law: &[[f32; 6]], joint: usize) -> Vec<i32> {
    law.iter()
        .map(|angles| units::urad_from_rad(angles[joint]).expect("finite"))
        .collect()
}

#[test]
fn every_shipped_gait_for_thirty_seconds_equals_control_alone_to_the_bit() {
    let gaits = shipped();
    assert!(gaits.len() >= 5, "{} gaits", gaits.len());
    for (name, gait) in gaits {
        let setup = Setup {
            link_byte_ns: 0,
            ..Setup::default()
        };
        let (mut robot, mut host, digest) = ready_on(setup, &gait);
        host.start(&mut robot, 0, digest, 30_000, TelemetryRate::Cycle)
            .expect("ready");
        let end = host
            .wait_for_end(&mut robot, 60_000_000)
            .expect("the lease ends");
        let law = law(&gait);
        assert_eq!(
            (
                end.reason,
                end.cycles,
                end.holds,
                end.dropped,
                end.setpoint_crc32c
            ),
            (EndReason::Completed, 600, 0, 0, crc(&law)),
            "{name}"
        );
        // What the drivers took after t = 0, in order, is the law in wire counts. The zero of ideal drivers is 0.
        for joint in 0..6 {
            let taken = robot.motors().borrow().taken(joint);
            let goals: Vec<i32> = taken.iter().map(|taken| taken.goal_urad).collect();
            let expected = urad(&law, joint);
            assert!(
                goals.windows(600).any(|run| run == expected),
                "{name} joint {joint}"
            );
        }
        check_set_points(&robot);
        check_record(&samples(&host.blocks), &end, &law);
        println!(
            "{name}: 600 cycles, CRC-32C of the set-points {:08x}",
            end.setpoint_crc32c
        );
    }
}

/// The record holds every cycle once, and its set-points are what was sent.
fn check_record(record: &[Sample], end: &RunEnd, law: &[[f32; 6]]) {
    assert_eq!(record.len() as u32, end.samples);
    assert!(
        record
            .windows(2)
            .all(|pair| pair[1].t_us - pair[0].t_us == 50_000)
    );
    let sent = urad(law, 2);
    for sample in record
        .iter()
        .filter(|sample| (1..600).contains(&sample.cycle))
    {
        let motor = &sample.motors[2];
        assert_eq!(motor.setpoint_urad, sent[sample.cycle as usize - 1]);
        assert_eq!(motor.feedback.applied_urad, motor.setpoint_urad);
        assert_eq!(
            (sample.valid_mask, sample.flags),
            (63, flags::TORQUE | flags::NEW_SETPOINT)
        );
    }
}

#[test]
fn the_fast_rate_gives_a_hundred_readings_a_second_and_the_same_set_points() {
    let (mut robot, mut host, digest) = ready(1);
    host.start(&mut robot, 0, digest, 5_000, TelemetryRate::Fast)
        .expect("ready");
    let end = host
        .wait_for_end(&mut robot, 20_000_000)
        .expect("the lease ends");
    assert_eq!(
        (end.reason, end.cycles, end.dropped),
        (EndReason::Completed, 100, 0)
    );
    let record = samples(&host.blocks);
    let times: Vec<u64> = record.iter().map(|sample| sample.t_us).collect();
    assert!(
        times.windows(2).all(|pair| pair[1] - pair[0] == 10_000),
        "{times:?}"
    );
    let new = record
        .iter()
        .filter(|sample| sample.flags & flags::NEW_SETPOINT != 0)
        .count();
    assert!(
        (new * 5).abs_diff(record.len()) <= 15,
        "one reading in five has a new set-point: {new} of {}",
        record.len()
    );
}

#[test]
fn live_samples_come_without_a_run() {
    let mut robot = EmulatedRobot::ideal(Setup::default());
    let mut host = SimHost::new(robot.link());
    host.home(&mut robot).expect("drivers answer");
    host.ask(
        &mut robot,
        &ToModule::Subscribe {
            rate: TelemetryRate::Cycle,
        },
    )
    .expect("allowed in every state");
    robot.run_for(1_000_000);
    host.receive(None);
    assert!((18..=21).contains(&host.live.len()), "{}", host.live.len());
    assert!(host.live.iter().all(|sample| sample.valid_mask == 63));
}

#[test]
fn a_cut_link_does_not_stop_the_run_and_its_record_is_drained_afterwards() {
    let (mut robot, mut host, digest) = ready(2);
    host.start(&mut robot, 0, digest, 15_000, TelemetryRate::Cycle)
        .expect("ready");
    robot.run_for(1_000_000);
    host.receive(None);
    host.ask(&mut robot, &ToModule::Ping { host_t_us: 1 })
        .expect("the link is up");
    let before = samples(&host.blocks).len() as u32;
    robot.link().cut();
    robot.run_for(25_000_000);
    robot.link().reconnect();
    host.restart();
    let FromModule::Info(info) = host
        .ask(&mut robot, &ToModule::GetInfo)
        .expect("the link is back")
    else {
        panic!()
    };
    assert_eq!(info.state, ModuleState::Idle, "the lease ended by itself");
    let drained = host.drain(&mut robot, before).expect("the record is kept");
    let mut cycles: Vec<u32> = samples(&drained)
        .iter()
        .map(|sample| sample.cycle)
        .collect();
    cycles.dedup();
    assert_eq!(*cycles.last().expect("not empty"), 300);
    assert_eq!(
        drained[0].first, before,
        "nothing is missing before the first drained sample"
    );
    assert!(
        drained
            .windows(2)
            .all(|pair| pair[0].end() == pair[1].first)
    );
}

/// The end of the run before waited behind its record, came in the next run, and the host took it for that of its own.
#[test]
fn the_end_of_a_run_is_not_told_in_the_next_one() {
    let (mut robot, mut host, digest) = ready_with(Setup::default(), 2);
    host.start(&mut robot, 0, digest, 3_000, TelemetryRate::Fast)
        .expect("ready");
    robot.run_for(1_000_000);
    robot.link().cut();
    robot.run_for(12_000_000);
    robot.link().reconnect();
    host.restart();
    host.hello(&mut robot).expect("the link is back");
    assert!(host.ends.is_empty(), "its record comes first");
    host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Cycle)
        .expect("the run is over");
    let end = host.wait_for_end(&mut robot, 20_000_000).expect("ends");
    assert_eq!((end.run, end.cycles), (2, 20));
}

#[test]
fn motors_with_physics_follow_the_gait() {
    use hil_sim::world::{World, WorldParams};
    let world = World::on_stand(&WorldParams::metamodule(
        3,
        hil_sim::motor::JointKind::catalogue_joint,
    ))
    .expect("nominal parameters");
    let mut robot = EmulatedRobot::with_motors(
        Setup {
            link_byte_ns: 0,
            ..Setup::default()
        },
        world,
    );
    let mut host = SimHost::new(robot.link());
    host.home(&mut robot).expect("drivers answer");
    let digest = host.upload(&mut robot, 0, &gait(1)).expect("clear");
    host.start(&mut robot, 0, digest, 10_000, TelemetryRate::Cycle)
        .expect("ready");
    let end = host
        .wait_for_end(&mut robot, 30_000_000)
        .expect("the lease ends");
    assert_eq!(
        (end.reason, end.cycles, end.holds),
        (EndReason::Completed, 200, 0)
    );
    let record = samples(&host.blocks);
    let worst = record
        .iter()
        .flat_map(|sample| sample.motors.clone())
        .map(|motor| (motor.feedback.position_urad - motor.setpoint_urad).abs())
        .max();
    assert!(
        worst.is_some_and(|urad| urad > 100 && urad < 150_000),
        "lag {worst:?} urad: real motors lag, but follow"
    );
}

#[test]
fn what_a_slow_link_cannot_carry_is_kept_then_dropped_and_every_drop_is_counted() {
    use crate::common::ready_with;
    // 4800 baud: 2.08 ms per byte, 480 byte/s against about 4 kB/s of 100 Hz telemetry.
    let (mut robot, mut host, digest) = ready_with(
        Setup {
            link_byte_ns: 2_083_333,
            ..Setup::default()
        },
        1,
    );
    host.start(&mut robot, 0, digest, 30_000, TelemetryRate::Fast)
        .expect("ready");
    let end = host
        .wait_for_end(&mut robot, 240_000_000)
        .expect("told behind the record");
    assert_eq!((end.reason, end.cycles), (EndReason::Completed, 600));
    let received = samples(&host.blocks).len() as u32;
    assert!(
        end.dropped > 0 && received > 500,
        "{end:?}, {received} received"
    );
    assert_eq!(
        received + end.dropped,
        end.samples,
        "every sample is either there or counted"
    );
    let FromModule::Info(info) = host.ask(&mut robot, &ToModule::GetInfo).expect("answers") else {
        panic!()
    };
    assert_eq!(
        (info.counters.samples_dropped, info.counters.overruns),
        (end.dropped, 0)
    );
}

/// Three seconds of a run in which the host asks every half second.
fn keep_in_touch(robot: &mut EmulatedRobot, host: &mut SimHost) {
    for _ in 0..6 {
        robot.run_for(500_000);
        host.ask(robot, &ToModule::Ping { host_t_us: 5 })
            .expect("in touch");
    }
}

#[test]
fn a_host_that_falls_silent_is_noted_and_the_run_goes_on() {
    let (mut robot, mut host, digest) = ready(1);
    host.start(&mut robot, 0, digest, 12_000, TelemetryRate::Cycle)
        .expect("ready");
    keep_in_touch(&mut robot, &mut host);
    robot.run_for(4_000_000);
    host.receive(None);
    assert!(host.saw(|kind| matches!(kind, EventKind::LinkSilent)));
    let before = host.blocks.len();
    robot.run_for(2_000_000);
    host.receive(None);
    assert_eq!(host.blocks.len(), before, "blocks wait for the host");
    host.ask(&mut robot, &ToModule::Ping { host_t_us: 6 })
        .expect("back");
    robot.run_for(500_000);
    host.receive(None);
    let came = host.blocks.len() - before;
    assert!(
        (4..=6).contains(&came),
        "{came} blocks in ten cycles: one every second cycle, not the rate of the line"
    );
    robot.run_for(14_500_000);
    host.receive(None);
    host.ends.clear();
    host.ask(&mut robot, &ToModule::Ping { host_t_us: 7 })
        .expect("back again after the end");
    robot.run_for(100_000);
    host.receive(None);
    let end = host.ends.pop().expect("the end is told again");
    assert_eq!(
        (end.reason, end.cycles, end.dropped),
        (EndReason::Completed, 240, 0)
    );
    assert!(host.saw(|kind| matches!(kind, EventKind::LinkBack)));
    assert_eq!(samples(&host.blocks).len() as u32, end.samples);
}

/// The host took the end of the run before for that of this one, and its record for whole.
#[test]
fn a_host_back_from_silence_in_a_run_is_not_sent_the_end_of_the_run_before() {
    let (mut robot, mut host, digest) = ready(1);
    host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Cycle)
        .expect("ready");
    assert!(host.wait_for_end(&mut robot, 20_000_000).is_some());
    host.ends.clear();
    host.start(&mut robot, 0, digest, 12_000, TelemetryRate::Cycle)
        .expect("ready again");
    keep_in_touch(&mut robot, &mut host);
    robot.run_for(4_000_000);
    host.ask(&mut robot, &ToModule::Ping { host_t_us: 6 })
        .expect("back");
    robot.run_for(500_000);
    host.receive(None);
    assert!(host.saw(|kind| matches!(kind, EventKind::LinkBack)));
    assert!(host.ends.is_empty(), "{:?}", host.ends);
    let end = host.wait_for_end(&mut robot, 30_000_000).expect("its end");
    assert_eq!((end.run, end.cycles), (2, 240));
}

/// Bytes of a host come at every phase of the cycle, also while the drivers are read. They change no set-point, no sample's time and no length of a run.
#[test]
fn a_busy_link_moves_neither_the_samples_nor_the_end_of_a_run() {
    let (mut robot, mut host, digest) = ready(2);
    host.start(&mut robot, 0, digest, 3_000, TelemetryRate::Cycle)
        .expect("ready");
    let mut sent = 0_u64;
    while host.ends.is_empty() {
        robot.run_for(700);
        sent += 1;
        let ping = host.frame(&ToModule::Ping { host_t_us: sent });
        robot.link().write(&ping);
        host.receive(None);
    }
    let end = host.ends[0];
    assert_eq!(
        (end.reason, end.cycles, end.dropped),
        (EndReason::Completed, 60, 0)
    );
    let record = samples(&host.blocks);
    assert_eq!(record.len() as u32, end.samples);
    let on_grid = |pair: &[Sample]| pair[1].t_us - pair[0].t_us == 50_000;
    assert!(record.windows(2).all(on_grid));
    assert!(sent > 5_000);
}

/// The hold after a run ends between two cycles. An order in that gap must wait for the cycle that lets the drivers go and tells the end.
#[test]
fn a_start_at_the_very_end_of_a_hold_swallows_no_run() {
    for offset_us in [100, 700, 1_300, 2_900] {
        let (mut robot, mut host, digest) = ready(0);
        host.start(&mut robot, 0, digest, 300, TelemetryRate::Cycle)
            .expect("ready");
        robot.run_for(offset_us);
        let mut refused = 0;
        while host
            .start(&mut robot, 0, digest, 300, TelemetryRate::Cycle)
            .is_err()
        {
            robot.run_for(1_000);
            refused += 1;
            assert!(refused < 20_000, "the first run never ends");
        }
        host.receive(None);
        assert_eq!(host.ends.len(), 1, "the first run's end is told");
        assert_eq!(host.ends[0].reason, EndReason::Completed);
        let end = host
            .wait_for_end(&mut robot, 30_000_000)
            .expect("the second run ends");
        assert_eq!((end.run, end.reason), (2, EndReason::Completed));
        check_set_points(&robot);
    }
}
