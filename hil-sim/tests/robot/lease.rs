//! Tethered runs: a robot whose host has died comes to rest; one whose host is there runs to its end.

use crate::common::ready_with;
use hil_sim::robot::host::{AskError, SimHost};
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::link::{
    Digest, EndReason, FromModule, KEY_LEN, Key, ModuleState, Reject, Tag, TelemetryRate, ToModule,
};

const BEAT: ToModule = ToModule::Heartbeat { tag: Tag::NONE };
const LEASE_US: u64 = 1_000_000;
/// The lease is looked at once a cycle.
const CYCLE_US: u64 = 50_000;
/// Ramp and hold of the supervisor.
const REST_US: u64 = 5_000_000;

fn tethered(digest: Digest, duration_ms: u32, lease_ms: u16) -> ToModule {
    ToModule::StartTethered {
        slot: 0,
        digest,
        duration_ms,
        rate: TelemetryRate::Cycle,
        countdown_ms: 0,
        lease_ms,
        tag: Tag::NONE,
    }
}

fn setup() -> Setup {
    Setup {
        link_byte_ns: 0,
        radio: true,
        ..Setup::default()
    }
}

/// Runs until the end of the run is told; then no driver has torque. Returns the time, us.
fn until_the_end(robot: &mut EmulatedRobot, host: &mut SimHost) -> u64 {
    let begin_us = robot.now_us();
    let end = host.wait_for_end(robot, 30_000_000).expect("ends");
    assert_eq!(end.reason, EndReason::HostLost);
    assert!((0..6).all(|joint| !robot.motors().borrow().torque(joint)));
    robot.now_us() - begin_us
}

#[test]
fn a_tethered_robot_stops_when_its_host_dies_and_an_autonomous_one_does_not() {
    // In the approach, at the begin of the run, within it, at every phase of a cycle.
    for alive_us in (0..20).map(|k| k * 123_457) {
        let (mut robot, mut host, digest) = ready_with(setup(), 1);
        host.ask(&mut robot, &tethered(digest, 60_000, 1_000))
            .expect("ready");
        let (begin_us, mut beat_us) = (robot.now_us(), robot.now_us());
        while robot.now_us() < begin_us + alive_us {
            robot.run_for(10_000);
            if robot.now_us() >= beat_us + 250_000 {
                host.ask(&mut robot, &BEAT).expect("a tethered run");
                beat_us = robot.now_us();
            }
        }
        let waited_us = robot.now_us() - beat_us;
        let off_us = until_the_end(&mut robot, &mut host);
        assert!(
            waited_us + off_us <= LEASE_US + CYCLE_US + REST_US,
            "alive for {alive_us} us: torque off after {off_us} us"
        );
    }
    let (mut robot, mut host, digest) = ready_with(setup(), 1);
    host.start(&mut robot, 0, digest, 10_000, TelemetryRate::Cycle)
        .expect("ready");
    let end = host.wait_for_end(&mut robot, 30_000_000).expect("ends");
    assert_eq!((end.reason, end.cycles), (EndReason::Completed, 200));
}

#[test]
fn the_ramp_begins_within_a_cycle_of_the_end_of_the_lease() {
    for lease_ms in [100_u16, 437, 1_000, 5_000] {
        let (mut robot, mut host, digest) = ready_with(setup(), 1);
        host.ask(&mut robot, &tethered(digest, 60_000, lease_ms))
            .expect("ready");
        for _ in 0..80 {
            robot.run_for(50_000);
            host.ask(&mut robot, &BEAT).expect("a tethered run");
        }
        let beat_us = robot.now_us();
        let end = host.wait_for_end(&mut robot, 30_000_000).expect("ends");
        assert_eq!(end.reason, EndReason::HostLost);
        let stopping = host.events.iter().find_map(|event| match event.kind {
            protocol::link::EventKind::State {
                to: ModuleState::Stopping,
                ..
            } => Some(event.t_us),
            _ => None,
        });
        let after_us = stopping.expect("told") - beat_us;
        let lease_us = u64::from(lease_ms) * 1_000;
        assert!(
            (lease_us..=lease_us + CYCLE_US).contains(&after_us),
            "lease {lease_ms} ms: the ramp began after {after_us} us"
        );
    }
}

#[test]
fn a_host_that_keeps_in_touch_sees_its_run_to_the_end() {
    let (mut robot, mut host, digest) = ready_with(setup(), 1);
    host.ask(&mut robot, &tethered(digest, 8_000, 1_000))
        .expect("ready");
    let mut refused = None;
    while host.ends.is_empty() {
        robot.run_for(250_000);
        refused = host.ask(&mut robot, &BEAT).err();
    }
    let end = host.ends[0];
    assert_eq!(
        (end.reason, end.cycles, end.dropped),
        (EndReason::Completed, 160, 0)
    );
    assert_eq!(refused, Some(AskError::Rejected(Reject::NotTethered)));
}

#[test]
fn only_the_owner_keeps_a_tethered_run_alive() {
    let (mut robot, mut cable, digest) = ready_with(setup(), 1);
    let key = Key([7; KEY_LEN]);
    cable
        .ask(&mut robot, &ToModule::SetKey { key })
        .expect("over the cable");
    let mut owner = SimHost::new(robot.radio());
    owner.set_key(Some(key));
    owner.hello(&mut robot).expect("answers");
    owner
        .ask(&mut robot, &tethered(digest, 60_000, 1_000))
        .expect("signed");
    let recorded: Vec<Vec<u8>> = (0..4)
        .map(|_| {
            robot.run_for(250_000);
            let frame = owner.signed_frame(&mut robot, &BEAT).expect("a challenge");
            robot.radio().write(&frame);
            robot.run_for(1_000);
            frame
        })
        .collect();
    // The owner dies. An attacker asks, pings, forges and replays.
    let mut attacker = SimHost::new(robot.radio());
    attacker.set_key(Some(Key([8; KEY_LEN])));
    let begin_us = robot.now_us();
    loop {
        attacker
            .ask(&mut robot, &ToModule::Ping { host_t_us: 1 })
            .ok();
        attacker.ask(&mut robot, &BEAT).expect_err("another key");
        for frame in &recorded {
            robot.radio().write(frame);
        }
        robot.run_for(50_000);
        let answer = cable.ask(&mut robot, &ToModule::GetInfo);
        let Ok(FromModule::Info(info)) = answer else {
            panic!("{answer:?}")
        };
        if info.state == ModuleState::Stopping {
            break;
        }
        assert!(robot.now_us() < begin_us + LEASE_US + 2 * CYCLE_US);
    }
}

#[test]
fn a_lease_out_of_range_is_refused_and_named() {
    let (mut robot, mut host, digest) = ready_with(setup(), 1);
    for lease_ms in [0, 99, 60_001, u16::MAX] {
        assert_eq!(
            host.ask(&mut robot, &tethered(digest, 1_000, lease_ms)),
            Err(AskError::Rejected(Reject::Lease {
                min_ms: 100,
                max_ms: 60_000
            }))
        );
    }
    assert_eq!(
        host.ask(&mut robot, &BEAT),
        Err(AskError::Rejected(Reject::NotTethered))
    );
}
