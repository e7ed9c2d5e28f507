//! Keys, proofs and media: who may move the robot.

use std::collections::BTreeSet;

use crate::common::{gait, ready_with};
use firmware::crash::{BLOCK_BYTES, CrashKind, CrashRecord};
use firmware::ports::ResetCause;
use hil_sim::robot::host::{AskError, SimHost};
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::link::{
    EventKind, FromModule, KEY_LEN, Key, ModuleState, Reject, Tag, TelemetryRate, ToModule,
};

fn setup() -> Setup {
    Setup {
        link_byte_ns: 0,
        radio: true,
        ..Setup::default()
    }
}

#[test]
fn a_radio_host_may_stop_but_not_start_upload_or_set_a_key() {
    let (mut robot, mut cable, digest) = ready_with(setup(), 0);
    let mut radio = SimHost::new(robot.radio());
    radio.hello(&mut robot).expect("anybody may say hello");
    let key = Key([7; KEY_LEN]);
    assert_eq!(
        radio.ask(&mut robot, &ToModule::SetKey { key }),
        Err(AskError::Rejected(Reject::WirePortOnly))
    );
    let refused = radio.start(&mut robot, 0, digest, 5_000, TelemetryRate::Off);
    assert_eq!(
        refused,
        Err(AskError::Rejected(Reject::NoKey)),
        "without a key nobody starts over radio"
    );
    cable
        .ask(&mut robot, &ToModule::SetKey { key })
        .expect("over the cable");
    assert_eq!(
        radio.upload(&mut robot, 0, &gait(1)),
        Err(AskError::Rejected(Reject::NoChallenge))
    );
    radio.set_key(Some(Key([8; KEY_LEN])));
    let refused = radio.start(&mut robot, 0, digest, 5_000, TelemetryRate::Off);
    assert_eq!(refused, Err(AskError::Rejected(Reject::BadTag)));

    cable.set_key(Some(key));
    cable
        .start(&mut robot, 0, digest, 30_000, TelemetryRate::Off)
        .expect("signed");
    robot.run_for(4_000_000);
    radio.set_key(None);
    radio
        .ask(&mut robot, &ToModule::Stop)
        .expect("anybody may stop");
    let FromModule::Info(info) = radio.ask(&mut robot, &ToModule::GetInfo).expect("answers") else {
        panic!()
    };
    assert_eq!(
        (info.state, info.counters.bad_tags),
        (ModuleState::Stopping, 1)
    );
}

#[test]
fn a_key_outlives_resets_and_the_right_one_opens_the_radio() {
    let (mut robot, mut cable, digest) = ready_with(setup(), 0);
    let key = Key([9; KEY_LEN]);
    cable
        .ask(&mut robot, &ToModule::SetKey { key })
        .expect("over the cable");
    robot.reset(ResetCause::PowerOn);
    robot.run_for(200_000);
    let mut radio = SimHost::new(robot.radio());
    radio.set_key(Some(key));
    let FromModule::Hello(hello) = radio.hello(&mut robot).expect("answers") else {
        panic!()
    };
    assert!(hello.keyed);
    radio
        .ask(
            &mut robot,
            &ToModule::Zero {
                joint_mask: 63,
                tag: Tag::NONE,
            },
        )
        .expect("signed");
    radio
        .start(&mut robot, 0, digest, 1_000, TelemetryRate::Off)
        .expect("signed");
}

#[test]
fn an_order_that_was_recorded_is_not_carried_out_again() {
    let (mut robot, mut host, digest) = ready_with(setup(), 0);
    let start = ToModule::Start {
        slot: 0,
        digest,
        duration_ms: 500,
        rate: TelemetryRate::Off,
        countdown_ms: 0,
        tag: Tag::NONE,
    };
    let frame = host.frame(&start);
    for repetition in 0..3 {
        robot.link().write(&frame);
        robot.run_for(100_000);
        if repetition == 0 {
            robot.run_for(12_000_000);
        }
    }
    host.receive(None);
    assert_eq!(host.ends.len(), 1, "the same frame starts one run");
    // After a reset the old session's frames mean nothing.
    robot.reset(ResetCause::Pin);
    robot.run_for(300_000);
    let before = robot.motors().borrow().taken(0).len();
    robot.link().write(&frame);
    robot.run_for(3_000_000);
    assert_eq!(robot.motors().borrow().taken(0).len(), before);
}

/// Every boot begins its counter of challenges anew, so what keeps them apart is the entropy of the boot.
#[test]
fn no_challenge_and_no_boot_id_comes_twice_over_power_cycles() {
    const CYCLES: usize = 300;
    let (mut robot, mut host, digest) = ready_with(setup(), 0);
    let start = ToModule::Start {
        slot: 0,
        digest,
        duration_ms: 500,
        rate: TelemetryRate::Off,
        countdown_ms: 0,
        tag: Tag::NONE,
    };
    let old = host.frame(&start);
    let (mut nonces, mut boots) = (BTreeSet::new(), BTreeSet::new());
    for _ in 0..CYCLES {
        robot.reset(ResetCause::PowerOn);
        robot.run_for(50_000);
        for _ in 0..3 {
            // HELLO voids the open challenge.
            let mut host = SimHost::new(robot.link());
            let answer = host.hello(&mut robot).expect("powered");
            let FromModule::Hello(hello) = answer else {
                panic!("{answer:?}");
            };
            boots.insert(hello.boot_id);
            let answer = host.ask(&mut robot, &ToModule::GetChallenge);
            let Ok(FromModule::Challenge { nonce }) = answer else {
                panic!("{answer:?}");
            };
            assert!(nonces.insert(nonce.0), "a challenge came twice");
        }
    }
    assert_eq!((boots.len(), nonces.len()), (CYCLES, 3 * CYCLES));
    // An order of the first boot is of no use in any later one.
    robot.link().write(&old);
    robot.run_for(3_000_000);
    assert!((0..6).all(|joint| !robot.motors().borrow().is_driving(joint)));
    // A generator that gives the same at every boot gives no challenge at all.
    robot.board().break_rng(Some(0x5EED_5EED));
    for _ in 0..3 {
        robot.reset(ResetCause::PowerOn);
        robot.run_for(50_000);
        let mut host = SimHost::new(robot.link());
        host.hello(&mut robot).expect("powered");
        let answer = host.ask(&mut robot, &ToModule::GetChallenge);
        assert_eq!(answer, Err(AskError::Rejected(Reject::NoEntropy)));
    }
}

/// The challenges of some boots of a robot whose chip has this id. Every robot here draws the same random numbers.
fn challenges(unique_id: [u8; 12]) -> BTreeSet<[u8; 16]> {
    let mut robot = EmulatedRobot::ideal(setup());
    robot.board().set_unique_id(unique_id);
    let mut nonces = BTreeSet::new();
    for _ in 0..10 {
        robot.reset(ResetCause::PowerOn);
        robot.run_for(50_000);
        for _ in 0..3 {
            let mut host = SimHost::new(robot.link());
            host.hello(&mut robot).expect("powered");
            match host.ask(&mut robot, &ToModule::GetChallenge) {
                Ok(FromModule::Challenge { nonce }) => nonces.insert(nonce.0),
                other => panic!("{other:?}"),
            };
        }
    }
    nonces
}

/// An order signed for one robot is void at another of the same key, even if both draw the same random numbers: the chip's id is in every challenge.
#[test]
fn robots_that_draw_the_same_random_numbers_share_no_challenge() {
    let one = challenges(*b"chip 1 of 2\0");
    let same = challenges(*b"chip 1 of 2\0");
    let other = challenges(*b"chip 2 of 2\0");
    assert_eq!((one.len(), other.len()), (30, 30));
    assert_eq!(one, same, "numbers and counters are the same here");
    assert!(one.is_disjoint(&other));
}

#[test]
fn a_crash_is_told_and_outlives_the_battery() {
    let (mut robot, mut host, _) = ready_with(setup(), 0);
    let mut record = CrashRecord::new(CrashKind::Panic, 4, 12_345_678);
    record.detail = 77;
    record.set_text("firmware/src/app/cycle.rs");
    let mut block = [0; BLOCK_BYTES];
    record.encode(&mut block);
    robot.board().set_crash_block(block);
    for cause in [ResetCause::Software, ResetCause::PowerOn] {
        robot.reset(cause);
        robot.run_for(100_000);
        host.hello(&mut robot).expect("answers");
        let FromModule::Crash(Some(told)) =
            host.ask(&mut robot, &ToModule::GetCrash).expect("answers")
        else {
            panic!()
        };
        assert_eq!(
            (told.detail, told.uptime_us, told.place.as_str()),
            (77, 12_345_678, "firmware/src/app/cycle.rs")
        );
    }
}

#[test]
fn a_reset_order_is_answered_and_carried_out_at_rest_only() {
    let (mut robot, mut host, digest) = ready_with(setup(), 0);
    let reset = ToModule::Reset { tag: Tag::NONE };
    host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Off)
        .expect("ready");
    robot.run_for(1_000_000);
    assert!(matches!(
        host.ask(&mut robot, &reset),
        Err(AskError::Rejected(Reject::State { .. }))
    ));
    host.wait_for_end(&mut robot, 12_000_000)
        .expect("the lease ends");
    assert_eq!(
        host.ask(&mut robot, &reset),
        Ok(FromModule::Ack { request: 18 })
    );
    robot.run_for(500_000);
    assert_eq!(robot.resets(), 1);
}

#[test]
fn a_flood_at_line_rate_delays_neither_the_cycle_nor_stop() {
    let (mut robot, mut host, digest) = ready_with(
        Setup {
            radio: true,
            ..Setup::default()
        },
        0,
    );
    host.start(&mut robot, 0, digest, 60_000, TelemetryRate::Cycle)
        .expect("ready");
    robot.run_for(3_000_000);
    let mut noise = 1_u32;
    for _ in 0..300 {
        // 20 ms of line time at 115200 baud: random bytes, zeros, an endless frame.
        let bytes: Vec<u8> = (0..230)
            .map(|k| {
                noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                if noise >> 30 == 0 {
                    (noise >> 16) as u8
                } else {
                    u8::from(k % 7 != 0)
                }
            })
            .collect();
        robot.radio().write(&bytes);
        robot.run_for(20_000);
    }
    let FromModule::Info(info) = host.ask(&mut robot, &ToModule::GetInfo).expect("answers") else {
        panic!()
    };
    assert_eq!((info.state, info.counters.overruns), (ModuleState::Run, 0));
    let mut radio = SimHost::new(robot.radio());
    radio
        .ask(&mut robot, &ToModule::Stop)
        .expect("the first whole frame after the flood is understood");
    let end = host
        .wait_for_end(&mut robot, 12_000_000)
        .expect("the ramp ends");
    assert_eq!(end.reason, protocol::link::EndReason::Stopped);
}

/// A second client learns who holds the robot, and what he may still do.
#[test]
fn a_second_host_is_told_who_holds_the_robot() {
    let (mut robot, mut cable, digest) = ready_with(setup(), 0);
    let key = Key([5; KEY_LEN]);
    cable
        .ask(&mut robot, &ToModule::SetKey { key })
        .expect("over the cable");
    let mut radio = SimHost::new(robot.radio());
    for host in [&mut cable, &mut radio] {
        host.set_key(Some(key));
        host.hello(&mut robot).expect("answers");
    }
    radio
        .start(&mut robot, 0, digest, 2_000, TelemetryRate::Off)
        .expect("free");
    robot.run_for(2_000_000);
    let held = Err(AskError::Rejected(Reject::Held { link: 1 }));
    let tag = Tag::NONE;
    assert_eq!(
        cable.start(&mut robot, 0, digest, 500, TelemetryRate::Off),
        held
    );
    for order in [
        ToModule::EraseSlot { slot: 1, tag },
        ToModule::Zero {
            joint_mask: 63,
            tag,
        },
        ToModule::Reset { tag },
        ToModule::SetKey { key },
    ] {
        assert_eq!(cable.ask(&mut robot, &order), held, "{order:?}");
    }
    // To the holder himself it is a state, not somebody else.
    let own = radio.start(&mut robot, 0, digest, 500, TelemetryRate::Off);
    let state = ModuleState::Run;
    assert_eq!(own, Err(AskError::Rejected(Reject::State { state })));

    cable.ask(&mut robot, &ToModule::Stop).expect("anybody");
    radio.wait_for_end(&mut robot, 12_000_000).expect("stops");
    cable
        .start(&mut robot, 0, digest, 500, TelemetryRate::Off)
        .expect("free again");
}

#[test]
fn a_key_that_a_probe_can_read_is_told_at_every_boot_and_when_it_is_set() {
    let key = Key([5; KEY_LEN]);
    let told = |host: &SimHost| {
        let events = host.events.iter();
        events
            .filter(|event| event.kind == EventKind::KeyReadable)
            .count()
    };
    for readable in [false, true] {
        let (mut robot, mut host, _) = ready_with(setup(), 0);
        robot.board().set_flash_readable(readable);
        robot.reset(ResetCause::PowerOn);
        robot.run_for(300_000);
        host.hello(&mut robot).expect("answers");
        robot.run_for(300_000);
        host.receive(None);
        assert_eq!(told(&host), 0, "without a key there is nothing to read");
        host.ask(&mut robot, &ToModule::SetKey { key })
            .expect("over the cable");
        robot.run_for(300_000);
        host.receive(None);
        assert_eq!(told(&host), usize::from(readable));
        robot.reset(ResetCause::PowerOn);
        robot.run_for(300_000);
        host.hello(&mut robot).expect("answers");
        let answer = host.ask(&mut robot, &ToModule::GetEvents { since: 0 });
        let Ok(FromModule::Events { events, .. }) = answer else {
            panic!("{answer:?}")
        };
        let kinds: Vec<EventKind> = events.iter().map(|event| event.kind).collect();
        assert_eq!(
            kinds.contains(&EventKind::KeyReadable),
            readable,
            "{kinds:?}"
        );
    }
}
