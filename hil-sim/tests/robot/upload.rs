//! Uploads over a bad line and through power cuts: the slot holds the old gait or the new one, never anything else.

use crate::common::{gait, ready, ready_with};
use firmware::ports::ResetCause;
use hil_sim::robot::flash::{Cut, TEARS};
use hil_sim::robot::host::{AskError, SimHost, put};
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::link::{Digest, FromModule, Reject, ToModule, WireGait};

/// Bits of 8N1 on the line, idle before and after.
fn to_line(bytes: &[u8]) -> Vec<bool> {
    let mut line = vec![true; 12];
    for byte in bytes {
        line.push(false);
        line.extend((0..8).map(|bit| byte >> bit & 1 != 0));
        line.push(true);
    }
    line.extend([true; 12]);
    line
}

/// What a UART reads off the line: a byte without its stop bit is dropped.
fn from_line(line: &[bool]) -> Vec<u8> {
    let (mut bytes, mut at) = (Vec::new(), 0);
    while at + 10 <= line.len() {
        if line[at] {
            at += 1;
            continue;
        }
        let byte = (0..8).fold(0, |byte, bit| byte | u8::from(line[at + 1 + bit]) << bit);
        if line[at + 9] {
            bytes.push(byte);
        }
        at += 10;
    }
    bytes
}

struct Bench {
    robot: EmulatedRobot,
    host: SimHost,
    old: Digest,
    new: Digest,
    committed: u32,
    slowest_us: u64,
}

impl Bench {
    fn new() -> Self {
        let (robot, host, old) = ready(0);
        let new = WireGait::from(&gait(1)).digest();
        Self {
            robot,
            host,
            old,
            new,
            committed: 0,
            slowest_us: 0,
        }
    }

    /// A fresh upload of the new gait, as bytes.
    fn frame(&mut self) -> Vec<u8> {
        self.host.frame(&put(0, &gait(1)))
    }

    fn stored(&mut self) -> Digest {
        let FromModule::Slots { slots, .. } = self
            .host
            .ask(&mut self.robot, &ToModule::ListSlots)
            .expect("link usable")
        else {
            panic!()
        };
        slots[0].as_ref().expect("never empty").digest
    }

    /// Sends damaged bytes, then checks the link and the slot, and puts the old gait back.
    fn damage(&mut self, bytes: &[u8], label: &str) {
        self.robot.link().write(bytes);
        self.robot.run_for(5_000);
        let asked_us = self.robot.now_us();
        let stored = self.stored();
        self.slowest_us = self.slowest_us.max(self.robot.now_us() - asked_us);
        assert!(
            stored == self.old || stored == self.new,
            "{label}: a wrong gait was committed"
        );
        if stored == self.new {
            self.committed += 1;
            let back = self
                .host
                .upload(&mut self.robot, 0, &gait(0))
                .expect("link usable");
            assert_eq!(back, self.old);
        }
    }
}

#[test]
fn every_cut_drop_duplicate_and_bit_flip_of_an_upload_commits_no_wrong_gait() {
    let mut bench = Bench::new();
    let len = bench.frame().len();
    for at in 0..len {
        let frame = bench.frame();
        bench.damage(&frame[..at], &format!("cut at byte {at}"));
        let mut frame = bench.frame();
        frame.remove(at);
        bench.damage(&frame, &format!("byte {at} dropped"));
        let mut frame = bench.frame();
        frame.insert(at, frame[at]);
        bench.damage(&frame, &format!("byte {at} twice"));
    }
    let only_ends = bench.committed;
    // Leading and trailing delimiters may double, and the leading one may be missing.
    assert!(
        only_ends <= 4,
        "{only_ends} damaged streams still held a whole frame"
    );
    let bits = to_line(&bench.frame()).len();
    for bit in 0..bits {
        let mut line = to_line(&bench.frame());
        line[bit] = !line[bit];
        bench.damage(&from_line(&line), &format!("wire bit {bit} flipped"));
    }
    println!(
        "{} damaged uploads of {len} bytes ({bits} wire bits): 0 wrong gaits, {} times the whole frame survived, \
         link answers within {} us",
        3 * len + bits,
        bench.committed,
        bench.slowest_us
    );
    assert!(bench.slowest_us <= 1_000_000);
}

#[test]
fn a_power_cut_at_every_flash_operation_of_an_upload_leaves_old_or_new() {
    let (old, new) = (
        WireGait::from(&gait(0)).digest(),
        WireGait::from(&gait(1)).digest(),
    );
    let (mut olds, mut news) = (0, 0);
    for after in 0.. {
        let mut operations = 0;
        for (seed, tear) in TEARS.into_iter().enumerate() {
            let (mut robot, mut host, _) = ready_with(
                Setup {
                    link_byte_ns: 0,
                    seed: seed as u64,
                    ..Setup::default()
                },
                0,
            );
            robot.flash().borrow_mut().plan_cut(Cut { after, tear });
            let stored = host.upload(&mut robot, 0, &gait(1));
            operations = robot.flash().borrow().operations();
            robot.flash().borrow_mut().power_on();
            robot.reset(ResetCause::BrownOut);
            robot.run_for(100_000);
            host.hello(&mut robot).expect("boots after the cut");
            let FromModule::Slots { slots, .. } =
                host.ask(&mut robot, &ToModule::ListSlots).expect("answers")
            else {
                panic!()
            };
            let digest = slots[0].as_ref().expect("never empty").digest;
            assert!(
                digest == old && stored.is_err() || digest == new,
                "cut {after} {tear:?}: {stored:?}"
            );
            if digest == old { olds += 1 } else { news += 1 }
        }
        if operations <= after {
            break;
        }
    }
    println!(
        "{} power cuts through the whole application: {olds} times the old gait, {news} times the new one",
        olds + news
    );
    assert!(olds > 100 && news > 6);
}

#[test]
fn gaits_that_are_wrong_collide_or_are_too_fast_are_refused_by_name() {
    let (mut robot, mut host, old) = ready(0);
    let mut wire = WireGait::from(&gait(1));
    wire.oscillators[2].offset_rad = f32::NAN;
    let put = |gait: &WireGait| ToModule::PutGait {
        slot: 0,
        activate: false,
        gait: gait.clone(),
        tag: protocol::link::Tag::NONE,
    };
    let refused = host.ask(&mut robot, &put(&wire));
    assert!(
        matches!(refused, Err(AskError::Rejected(Reject::Gait(_)))),
        "{refused:?}"
    );
    let mut wire = WireGait::from(&gait(1));
    wire.oscillators[2].amplitude_rad = 3.1;
    let refused = host.ask(&mut robot, &put(&wire));
    assert!(
        matches!(refused, Err(AskError::Rejected(Reject::Gait(_)))),
        "{refused:?}"
    );
    // Cubes 1 and 4 meet on 3.6 % of the torus of A.M2 and B.M0 (design page); one such fold as the centre of a gait.
    let model = control::robot::RobotModel::default();
    let degrees = || {
        (-180..180_i16)
            .step_by(10)
            .map(|degrees| f32::from(degrees).to_radians())
    };
    let (m2, m3) = degrees()
        .flat_map(|m2| degrees().map(move |m3| (m2, m3)))
        .find(|(m2, m3)| {
            control::precheck::clearance(&model, &[0.0, 0.0, *m2, *m3, 0.0, 0.0]).clearance_m
                < -0.01
        })
        .expect("some fold collides");
    let mut wire = WireGait::from(&gait(1));
    for oscillator in &mut wire.oscillators {
        oscillator.offset_rad = 0.0;
    }
    (
        wire.oscillators[2].offset_rad,
        wire.oscillators[3].offset_rad,
    ) = (m2, m3);
    let refused = host.ask(&mut robot, &put(&wire));
    let Err(AskError::Rejected(Reject::Collision {
        body_a,
        body_b,
        clearance_um,
    })) = refused
    else {
        panic!("{refused:?}")
    };
    assert!(body_a <= 1 && (5..=6).contains(&body_b) && clearance_um < 3_000);
    let FromModule::GaitData {
        digest, gait: kept, ..
    } = host
        .ask(&mut robot, &ToModule::GetGait { slot: 0 })
        .expect("answers")
    else {
        panic!()
    };
    assert_eq!((kept.digest(), digest), (old, old), "the old gait is kept");
}

#[test]
fn slots_are_listed_activated_read_back_and_erased() {
    let (mut robot, mut host, digest) = ready(0);
    let tag = protocol::link::Tag::NONE;
    for slot in 1..8 {
        host.upload(&mut robot, slot, &gait(slot)).expect("clear");
    }
    assert_eq!(
        host.upload(&mut robot, 8, &gait(1)),
        Err(AskError::Rejected(Reject::NoSuchSlot { slots: 8 }))
    );
    host.ask(&mut robot, &ToModule::ActivateSlot { slot: 0, tag })
        .expect("used slot");
    let refused = host.ask(&mut robot, &ToModule::EraseSlot { slot: 0, tag });
    assert_eq!(refused, Err(AskError::Rejected(Reject::SlotActive)));
    host.ask(&mut robot, &ToModule::EraseSlot { slot: 5, tag })
        .expect("not the active one");
    robot.reset(ResetCause::PowerOn);
    robot.run_for(100_000);
    host.hello(&mut robot).expect("answers");
    let FromModule::Slots { active, slots } =
        host.ask(&mut robot, &ToModule::ListSlots).expect("answers")
    else {
        panic!()
    };
    let names: Vec<_> = slots
        .iter()
        .map(|slot| slot.as_ref().map(|info| info.name.to_string()))
        .collect();
    let expected: Vec<_> = (0..8)
        .map(|slot| (slot != 5).then(|| format!("test {slot}")))
        .collect();
    assert_eq!((active, names), (Some(0), expected));
    let FromModule::GaitData { gait: stored, .. } = host
        .ask(&mut robot, &ToModule::GetGait { slot: 0 })
        .expect("answers")
    else {
        panic!()
    };
    assert_eq!(
        (stored.digest(), stored),
        (digest, WireGait::from(&gait(0)))
    );
}

#[test]
fn nothing_is_written_while_the_robot_runs() {
    let (mut robot, mut host, digest) = ready(0);
    host.start(
        &mut robot,
        0,
        digest,
        20_000,
        protocol::link::TelemetryRate::Off,
    )
    .expect("ready");
    robot.run_for(3_000_000);
    let erases = robot.flash().borrow().erases();
    let refused = host.upload(&mut robot, 1, &gait(1));
    assert!(
        matches!(refused, Err(AskError::Rejected(Reject::State { .. }))),
        "{refused:?}"
    );
    robot.run_for(1_000_000);
    assert_eq!(robot.flash().borrow().erases(), erases);
}
