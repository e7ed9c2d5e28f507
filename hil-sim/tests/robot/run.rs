//! Runs: set-points equal the law's to the bit, telemetry is whole, leases end.

use crate::common::{gait, ready};
use control::cpg;
use hil_sim::robot::host::SimHost;
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::crc::Crc32c;
use protocol::link::telemetry::flags;
use protocol::link::{
    EndReason, EventKind, FromModule, ModuleState, Sample, SampleBlock, TelemetryRate, ToModule,
};
use protocol::units;

fn samples(blocks: &[SampleBlock]) -> Vec<Sample> {
    blocks
        .iter()
        .flat_map(SampleBlock::samples)
        .map(|sample| sample.expect("our own block"))
        .collect()
}

#[test]
fn five_gaits_for_thirty_seconds_equal_control_alone_to_the_bit() {
    for number in 0..5 {
        let (mut robot, mut host, digest) = ready(number);
        host.start(&mut robot, 0, digest, 30_000, TelemetryRate::Cycle)
            .expect("ready");
        let end = host
            .wait_for_end(&mut robot, 45_000_000)
            .expect("the lease ends");
        assert_eq!(
            (end.reason, end.cycles, end.holds, end.dropped),
            (EndReason::Completed, 600, 0, 0)
        );

        let gait = gait(number);
        let mut state = cpg::start(&gait);
        let law: Vec<_> = (0..600)
            .map(|_| cpg::step(&gait, &mut state, control::CYCLE_S))
            .collect();
        let mut crc = Crc32c::new();
        law.iter()
            .flat_map(|points| points.as_slice().to_vec())
            .for_each(|angle| crc.update(&angle.to_le_bytes()));
        assert_eq!(end.setpoint_crc32c, crc.value(), "gait {number}");

        // What the drivers took after t = 0, in order, is the law in wire counts. The zero of ideal drivers is 0.
        for joint in 0..6 {
            let expected: Vec<i32> = law
                .iter()
                .map(|points| units::urad_from_rad(points.as_slice()[joint]).expect("finite"))
                .collect();
            let taken: Vec<i32> = robot
                .motors()
                .borrow()
                .taken(joint)
                .iter()
                .map(|taken| taken.goal_urad)
                .collect();
            assert!(
                taken.windows(600).any(|run| run == expected),
                "gait {number} joint {joint}"
            );
        }

        // The record holds every cycle once, and its set-points are what was sent.
        let record = samples(&host.blocks);
        assert_eq!(record.len() as u32, end.samples);
        let running: Vec<_> = record
            .iter()
            .filter(|sample| sample.cycle > 0 && sample.cycle <= 600)
            .collect();
        assert!(
            running
                .windows(2)
                .all(|pair| pair[1].t_us - pair[0].t_us == 50_000)
        );
        for sample in running.iter().filter(|sample| sample.cycle < 600) {
            let angle = law[sample.cycle as usize - 1].as_slice()[2];
            assert_eq!(
                sample.motors[2].setpoint_urad,
                units::urad_from_rad(angle).expect("finite")
            );
            assert_eq!(
                sample.motors[2].feedback.applied_urad,
                sample.motors[2].setpoint_urad
            );
            assert_eq!(
                (sample.valid_mask, sample.flags),
                (63, flags::TORQUE | flags::NEW_SETPOINT)
            );
        }
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
        .flat_map(|sample| sample.motors)
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

#[test]
fn a_host_that_falls_silent_is_noted_and_the_run_goes_on() {
    let (mut robot, mut host, digest) = ready(1);
    host.start(&mut robot, 0, digest, 12_000, TelemetryRate::Cycle)
        .expect("ready");
    for _ in 0..6 {
        robot.run_for(500_000);
        host.ask(&mut robot, &ToModule::Ping { host_t_us: 5 })
            .expect("in touch");
    }
    robot.run_for(4_000_000);
    host.receive(None);
    assert!(host.saw(|kind| matches!(kind, EventKind::LinkSilent)));
    let before = host.blocks.len();
    robot.run_for(2_000_000);
    host.receive(None);
    assert_eq!(host.blocks.len(), before, "blocks wait for the host");
    host.ask(&mut robot, &ToModule::Ping { host_t_us: 6 })
        .expect("back");
    robot.run_for(15_000_000);
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
