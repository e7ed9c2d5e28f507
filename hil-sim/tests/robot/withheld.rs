//! Frames that an attacker holds back, forges or repeats on the owner's link: what they may not do.

use crate::common::{gait, ready_with};
use hil_sim::robot::host::{AskError, SimHost};
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::link::{
    Digest, EndReason, EventKind, FromModule, KEY_LEN, Key, ModuleState, Reject, SampleBlock, Tag,
    TelemetryRate, ToModule,
};

const KEY: Key = Key([7; KEY_LEN]);

fn start(digest: Digest) -> ToModule {
    ToModule::Start {
        slot: 0,
        digest,
        duration_ms: 4_000,
        rate: TelemetryRate::Cycle,
        countdown_ms: 0,
        tag: Tag::NONE,
    }
}

/// A keyed robot at rest, its owner on the radio, and somebody on the cable.
fn keyed() -> (EmulatedRobot, SimHost, SimHost, Digest) {
    let setup = Setup {
        link_byte_ns: 0,
        radio: true,
        ..Setup::default()
    };
    let (mut robot, mut cable, digest) = ready_with(setup, 0);
    cable
        .ask(&mut robot, &ToModule::SetKey { key: KEY })
        .expect("over the cable");
    let mut owner = SimHost::new(robot.radio());
    owner.set_key(Some(KEY));
    owner.hello(&mut robot).expect("answers");
    (robot, owner, cable, digest)
}

fn state(robot: &mut EmulatedRobot, host: &mut SimHost) -> ModuleState {
    match host.ask(robot, &ToModule::GetInfo) {
        Ok(FromModule::Info(info)) => info.state,
        other => panic!("{other:?}"),
    }
}

type Meanwhile = fn(&mut EmulatedRobot, &mut SimHost, &mut SimHost);

#[test]
fn a_start_that_was_held_back_does_not_run_the_robot() {
    let cases: [(&str, Meanwhile); 5] = [
        ("the owner stops", |robot, owner, _| {
            owner.ask(robot, &ToModule::Stop).expect("acknowledged");
        }),
        ("somebody on the cable stops", |robot, _, cable| {
            cable.ask(robot, &ToModule::Stop).expect("acknowledged");
        }),
        ("a host says hello on the radio", |robot, _, _| {
            SimHost::new(robot.radio()).hello(robot).expect("answers");
        }),
        ("five seconds pass", |robot, _, _| robot.run_for(5_000_000)),
        ("the radio is lost and comes back", |robot, _, _| {
            robot.radio().cut();
            robot.run_for(100_000);
            robot.radio().reconnect();
        }),
    ];
    for (what, meanwhile) in cases {
        let (mut robot, mut owner, mut cable, digest) = keyed();
        let held_back = owner
            .signed_frame(&mut robot, &start(digest))
            .expect("a challenge");
        meanwhile(&mut robot, &mut owner, &mut cable);
        let before = robot.motors().borrow().taken(0).len();
        for _ in 0..3 {
            robot.radio().write(&held_back);
            robot.run_for(1_000_000);
        }
        assert_eq!(state(&mut robot, &mut owner), ModuleState::Idle, "{what}");
        assert_eq!(robot.motors().borrow().taken(0).len(), before, "{what}");
        owner
            .ask(&mut robot, &start(digest))
            .expect("a new order of the owner starts it");
    }
}

#[test]
fn a_start_that_was_signed_in_a_run_is_void_after_it() {
    let (mut robot, mut owner, mut cable, digest) = keyed();
    owner.ask(&mut robot, &start(digest)).expect("ready");
    while state(&mut robot, &mut cable) != ModuleState::Run {
        robot.run_for(100_000);
    }
    // Ramp and hold take longer than a challenge lives: so ask as late as possible.
    while state(&mut robot, &mut cable) != ModuleState::Stopping {
        robot.run_for(100_000);
    }
    let mut held_back = Vec::new();
    while state(&mut robot, &mut cable) == ModuleState::Stopping {
        held_back = owner
            .signed_frame(&mut robot, &start(digest))
            .expect("a challenge");
        robot.run_for(100_000);
    }
    let before = robot.motors().borrow().taken(0).len();
    robot.radio().write(&held_back);
    robot.run_for(2_000_000);
    assert_eq!(state(&mut robot, &mut cable), ModuleState::Idle);
    assert_eq!(robot.motors().borrow().taken(0).len(), before);
}

#[test]
fn an_order_that_is_late_within_the_life_of_its_challenge_is_obeyed() {
    let (mut robot, mut owner, _, digest) = keyed();
    let late = owner
        .signed_frame(&mut robot, &start(digest))
        .expect("a challenge");
    robot.run_for(4_000_000);
    robot.radio().write(&late);
    robot.run_for(1_000_000);
    assert_ne!(state(&mut robot, &mut owner), ModuleState::Idle);
}

/// Messages without a tag that a stranger puts on the owner's own line, and on the other one.
#[test]
fn nobody_without_the_key_can_shorten_the_record_of_a_run() {
    for on_the_cable in [false, true] {
        let (mut robot, mut owner, mut stranger, digest) = keyed();
        owner.ask(&mut robot, &start(digest)).expect("ready");
        let line = if on_the_cable {
            robot.link()
        } else {
            robot.radio()
        };
        for step in 0..80_u32 {
            robot.run_for(100_000);
            owner.receive(None);
            let rate = TelemetryRate::Off;
            line.write(&stranger.frame(&ToModule::Subscribe { rate }));
            for from_sample in [0, step, u32::MAX] {
                line.write(&stranger.frame(&ToModule::Drain { from_sample }));
            }
        }
        let end = owner
            .wait_for_end(&mut robot, 12_000_000)
            .or_else(|| owner.ends.last().copied())
            .expect("the run ends");
        assert_eq!((end.reason, end.dropped), (EndReason::Completed, 0));
        let mut have: Vec<u32> = owner
            .blocks
            .iter()
            .flat_map(|block: &SampleBlock| (block.first..).take(block.samples().count()))
            .collect();
        have.sort_unstable();
        have.dedup();
        assert_eq!(
            have.len() as u32,
            end.samples,
            "on the cable: {on_the_cable}"
        );
        assert!(end.samples >= end.cycles);
    }
}

#[test]
fn wrong_tags_and_stop_frames_push_no_fault_out_of_the_log() {
    let (mut robot, mut owner, mut cable, digest) = keyed();
    owner.ask(&mut robot, &start(digest)).expect("ready");
    robot.run_for(2_000_000);
    robot
        .motors()
        .borrow_mut()
        .trouble(2, hil_sim::robot::ideal::Trouble::Missing);
    robot.run_for(3_000_000);
    let mut forger = SimHost::new(robot.radio());
    forger.hello(&mut robot).expect("answers");
    forger.set_key(Some(Key([8; KEY_LEN])));
    for number in 0..200_u16 {
        let joint_mask = number % 60 + 1;
        let tag = Tag::NONE;
        let refused = forger.ask(&mut robot, &ToModule::Zero { joint_mask, tag });
        assert_eq!(refused, Err(AskError::Rejected(Reject::BadTag)));
        forger.ask(&mut robot, &ToModule::Stop).expect("always");
        // Slowly enough for every one to be looked at.
        robot.run_for(protocol::link::server::TAG_TRY_US);
    }
    robot.run_for(1_100_000);
    let mut events = Vec::new();
    let mut since = 0;
    loop {
        let answer = cable.ask(&mut robot, &ToModule::GetEvents { since });
        let Ok(FromModule::Events {
            next, events: part, ..
        }) = answer
        else {
            panic!("{answer:?}")
        };
        if part.is_empty() {
            break;
        }
        events.extend(part);
        since = next;
    }
    let has = |test: fn(&EventKind) -> bool| events.iter().any(|event| test(&event.kind));
    assert!(has(|kind| matches!(
        kind,
        EventKind::MotorLost { joint: 2 }
    )));
    assert!(has(|kind| matches!(kind, EventKind::Fault(_))));
    assert!(
        has(|kind| matches!(kind, EventKind::Boot { .. })),
        "the first event of all"
    );
    assert!(has(|kind| matches!(kind, EventKind::Repeated { .. })));
    let FromModule::Info(info) = cable.ask(&mut robot, &ToModule::GetInfo).expect("answers") else {
        panic!()
    };
    assert_eq!(info.counters.bad_tags, 200, "every one is counted");
}

#[test]
fn a_robot_whose_random_numbers_fail_gives_no_challenge_and_starts_nothing() {
    let (mut robot, mut owner, mut cable, digest) = keyed();
    robot.board().break_rng(Some(0xDEAD_BEEF));
    robot.reset(firmware::ports::ResetCause::PowerOn);
    robot.run_for(300_000);
    for host in [&mut owner, &mut cable] {
        host.hello(&mut robot).expect("answers");
        assert_eq!(
            host.ask(&mut robot, &ToModule::GetChallenge),
            Err(AskError::Rejected(Reject::NoEntropy))
        );
        assert_eq!(state(&mut robot, host), ModuleState::Fault);
    }
    // Not even a robot without a key, where orders need no challenge.
    let (mut robot, mut cable, _) = ready_with(Setup::default(), 0);
    robot.board().break_rng(Some(0));
    robot.reset(firmware::ports::ResetCause::PowerOn);
    robot.run_for(300_000);
    cable.hello(&mut robot).expect("answers");
    let clear = ToModule::ClearFault { tag: Tag::NONE };
    cable.ask(&mut robot, &clear).expect("the cable, no key");
    cable.home(&mut robot).expect("drivers answer");
    cable.upload(&mut robot, 0, &gait(0)).expect("clear");
    assert_eq!(
        cable.ask(&mut robot, &start(digest)),
        Err(AskError::Rejected(Reject::NoEntropy))
    );
    robot.board().break_rng(None);
    robot.reset(firmware::ports::ResetCause::PowerOn);
    robot.run_for(300_000);
    cable.home(&mut robot).expect("drivers answer");
    cable.ask(&mut robot, &start(digest)).expect("works again");
}
