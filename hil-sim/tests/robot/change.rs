//! A gait that is changed in mid-run: smooth, the law's own, checked and recorded.

use crate::common::{check_set_points, gait, ready};
use control::cpg;
use control::gait::Gait;
use hil_sim::robot::EmulatedRobot;
use hil_sim::robot::host::{AskError, SimHost};
use protocol::link::{
    Digest, EndReason, EventKind, FromModule, ModuleState, Reject, SampleBlock, Tag, TelemetryRate,
    ToModule,
};
use protocol::units;

fn change(slot: u8, digest: Digest) -> ToModule {
    ToModule::ChangeGait {
        slot,
        digest,
        tag: Tag::NONE,
    }
}

/// Two gaits of one family, and what `control` alone gives when the second takes over before cycle `at`.
fn law(first: &Gait, second: &Gait, at: usize, cycles: usize, joint: usize) -> Vec<i32> {
    let mut state = cpg::start(first);
    (0..cycles)
        .map(|cycle| {
            let gait = if cycle < at { first } else { second };
            let joints = cpg::step(gait, &mut state, control::CYCLE_S).joints();
            units::urad_from_rad(joints.expect("six")[joint]).expect("finite")
        })
        .collect()
}

fn run_until_in_run(robot: &mut EmulatedRobot, host: &mut SimHost) {
    loop {
        robot.run_for(50_000);
        match host.ask(robot, &ToModule::GetInfo) {
            Ok(FromModule::Info(info)) if info.state == ModuleState::Run => return,
            Ok(_) => {}
            Err(error) => panic!("{error:?}"),
        }
    }
}

#[test]
fn a_change_is_the_laws_own_to_the_bit_and_is_recorded() {
    let (first, second) = (gait(1), gait(4));
    let (mut robot, mut host, digest) = ready(1);
    let other = host.upload(&mut robot, 1, &second).expect("clear");
    host.start(&mut robot, 0, digest, 20_000, TelemetryRate::Cycle)
        .expect("ready");
    run_until_in_run(&mut robot, &mut host);
    robot.run_for(3_000_000);
    host.ask(&mut robot, &change(1, other)).expect("in a run");
    assert_eq!(
        host.ask(&mut robot, &change(0, digest)),
        Err(AskError::Rejected(Reject::Busy)),
        "one change at a time"
    );
    while host.ends.is_empty() {
        // A host that keeps in touch.
        host.ask(&mut robot, &ToModule::Ping { host_t_us: 1 })
            .expect("answers");
        robot.run_for(500_000);
        host.receive(None);
    }
    let end = host.ends[0];
    assert_eq!((end.reason, end.cycles), (EndReason::Completed, 400));
    check_set_points(&robot);

    let told = host.events.iter().find(|event| {
        event.kind
            == EventKind::GaitChanged {
                slot: 1,
                digest: other,
            }
    });
    assert!(told.is_some());
    let taken = |joint| -> Vec<i32> {
        let taken = robot.motors().borrow().taken(joint);
        taken.iter().map(|taken| taken.goal_urad).collect()
    };
    let is_there = |goals: &[i32], law: &[i32]| goals.windows(law.len()).any(|run| run == law);
    let goals = taken(0);
    let switch = (0..200).find(|&at| is_there(&goals, &law(&first, &second, at, 400, 0)));
    let switch = switch.expect("one cycle from which the second gait governs");
    // Three seconds and the way of the order, then one look-ahead.
    assert!((60..=90).contains(&switch), "cycle {switch}");
    for joint in 1..6 {
        let law = law(&first, &second, switch, 400, joint);
        assert!(is_there(&taken(joint), &law), "joint {joint}");
    }
    let samples = host
        .blocks
        .iter()
        .map(|block: &SampleBlock| u32::from(block.count));
    assert_eq!(samples.sum::<u32>(), end.samples);
}

#[test]
fn a_change_is_refused_at_rest_of_an_unknown_gait_and_of_an_empty_slot() {
    let (mut robot, mut host, digest) = ready(1);
    let other = host.upload(&mut robot, 1, &gait(2)).expect("clear");
    let refused = |host: &mut SimHost, robot: &mut EmulatedRobot, slot, digest, reason| {
        let answer = host.ask(robot, &change(slot, digest));
        assert_eq!(answer, Err(AskError::Rejected(reason)));
    };
    let state = ModuleState::Idle;
    refused(&mut host, &mut robot, 1, other, Reject::State { state });
    host.start(&mut robot, 0, digest, 10_000, TelemetryRate::Cycle)
        .expect("ready");
    let state = ModuleState::Armed;
    refused(&mut host, &mut robot, 1, other, Reject::State { state });
    run_until_in_run(&mut robot, &mut host);
    let stored = other;
    refused(
        &mut host,
        &mut robot,
        1,
        digest,
        Reject::OtherGait { stored },
    );
    refused(&mut host, &mut robot, 2, other, Reject::SlotEmpty);
    refused(
        &mut host,
        &mut robot,
        99,
        other,
        Reject::NoSuchSlot { slots: 8 },
    );
    let end = host.wait_for_end(&mut robot, 60_000_000).expect("ends");
    assert_eq!((end.reason, end.cycles), (EndReason::Completed, 200));
    let expected = law(&gait(1), &gait(1), 0, 200, 0);
    let taken = robot.motors().borrow().taken(0);
    let goals: Vec<i32> = taken.iter().map(|taken| taken.goal_urad).collect();
    assert!(goals.windows(200).any(|run| run == expected), "unchanged");
}

#[test]
fn a_run_can_be_stopped_while_a_change_is_under_way() {
    for after_us in [0, 500_000, 1_500_000, 3_000_000] {
        let (mut robot, mut host, digest) = ready(1);
        let other = host.upload(&mut robot, 1, &gait(3)).expect("clear");
        host.start(&mut robot, 0, digest, 60_000, TelemetryRate::Cycle)
            .expect("ready");
        run_until_in_run(&mut robot, &mut host);
        robot.run_for(2_000_000);
        host.ask(&mut robot, &change(1, other)).expect("in a run");
        robot.run_for(after_us);
        host.ask(&mut robot, &ToModule::Stop).expect("always");
        let end = host.wait_for_end(&mut robot, 10_000_000).expect("ends");
        assert_eq!(end.reason, EndReason::Stopped);
        check_set_points(&robot);
    }
}
