//! What the laws excuse ends where the module could know better.

mod halts;

use super::{CYCLE_US, JOINTS, Law, Laws, OFF_US, REST_US, STALE_US};
use crate::robot::ideal::IdealMotors;
use crate::robot::wire::MotorBus;
use crate::schedule::channel::{Delivered, Frame, Order};
use crate::schedule::wire::Sent;
use protocol::bus::Profile;

fn laws() -> Laws {
    Laws::new(false, [0; JOINTS], &[])
}

/// A packet that left at `at_us`, when the last reading of joint 0 had come at `heard_us`.
fn sent(at_us: u64, heard_us: u64, torque: bool) -> Sent {
    Sent {
        at_us,
        bytes: Vec::new(),
        heard_us: [Some(heard_us); JOINTS],
        stood_urad: [0; JOINTS],
        torque: [torque; JOINTS],
    }
}

#[test]
fn a_restart_is_unheard_until_a_reading_or_for_three_cycles() {
    let mut laws = laws();
    let lost_us = 1_000_000;
    laws.encoder_lost(lost_us, 0, 100_000);
    let unheard = |after_us, heard_us| laws.unheard(0, &sent(lost_us + after_us, heard_us, false));
    assert!(unheard(CYCLE_US - 1, lost_us + 1), "a reading under way");
    assert!(!unheard(CYCLE_US, lost_us + 1), "a reading since then");
    assert!(unheard(STALE_US, lost_us - 1), "no reading since then");
    assert!(!unheard(STALE_US + 1, lost_us - 1), "it counts as lost");
    assert!(!laws.unheard(1, &sent(lost_us + 1, 0, false)), "another");
}

#[test]
fn a_set_point_that_moves_a_driver_is_excused_by_no_restart() {
    let mut laws = laws();
    laws.encoder_lost(1_000_000, 0, 100_000);
    assert!(!laws.unheard(0, &sent(1_000_001, 0, true)));
}

/// Ideal drivers; the first has torque and no watchdog of its own.
fn driving() -> IdealMotors {
    let mut motors = IdealMotors::new(false);
    let info = Profile::Packed.info();
    let packet = info.sync_write(&info.torque, &[(1, 1)]).expect("short");
    motors.put(0, packet.bytes());
    motors.advance(2_000_000);
    assert!(motors.is_driving(0));
    motors
}

/// When the first law breaks for a driver that is never let go after a restart of the module at 1 s, and hears nothing until `deaf_until_us`.
fn breaks_us(deaf_until_us: u64) -> u64 {
    let (motors, mut laws) = (driving(), laws());
    // Its watchdog is not asked for.
    laws.disordered = true;
    laws.restarted(1_000_000);
    for now_us in (1_000_000..2_000_000).step_by(1_000) {
        let deaf = |joint| joint == 0 && now_us <= deaf_until_us;
        laws.look(now_us, &motors, None, deaf);
        if let Some(broken) = laws.broken {
            assert_eq!(broken.law, Law::LetGo);
            return broken.at_us;
        }
    }
    u64::MAX
}

#[test]
fn a_driver_that_heard_nothing_is_let_go_a_cycle_after_it_is_back() {
    assert_eq!(breaks_us(0), 1_000_000 + OFF_US + 1_000);
    assert_eq!(breaks_us(1_200_000), 1_200_000 + OFF_US + 1_000);
}

#[test]
fn no_disturbance_ends_another() {
    let (motors, mut laws) = (driving(), laws());
    // Its watchdog is not asked for.
    laws.disordered = true;
    laws.disturb(1_200_000);
    laws.disturb(1_100_000);
    for (now_us, kept) in [
        (1_200_000 + OFF_US, true),
        (1_200_000 + OFF_US + 1_000, false),
    ] {
        laws.look(now_us, &motors, None, |_| false);
        let broken = laws.broken.iter().any(|broken| broken.law == Law::LetGo);
        assert_eq!(broken, !kept, "at {now_us} us");
    }
}

#[test]
fn a_driver_that_restarted_may_lack_its_watchdog_for_a_cycle_and_its_packets() {
    for (after_us, broken) in [(OFF_US - 1, None), (OFF_US, Some(Law::Guarded))] {
        let (motors, mut laws) = (driving(), laws());
        laws.encoder_lost(1_000_000, 0, 0);
        laws.restarted(1_000_000);
        laws.look(1_000_000 + after_us, &motors, None, |_| false);
        assert_eq!(laws.broken.map(|broken| broken.law), broken);
    }
}

/// An order goes in at `at_us`, made a moment before.
fn goes_in(laws: &mut Laws, number: u64, order: Order, at_us: u64) {
    let frame = Frame {
        bytes: Vec::new(),
        order: Some((number, order)),
        made_us: at_us - 1_000,
        epoch: 0,
    };
    let sure = order == Order::Stop;
    laws.delivered(0, &Delivered { frame, at_us, sure }, 0);
}

const START: Order = Order::Start {
    runs_us: 30_000_000,
    lease_us: None,
};

/// When torque has to be off after a start at 1 s, or its copy at `copy_us`, and a STOP that went in at `stops_us` and was acknowledged at 2 s.
fn rests_us(keyed: bool, copy_us: Option<u64>, stops_us: &[u64]) -> u64 {
    let mut laws = Laws::new(keyed, [0; JOINTS], &[]);
    goes_in(&mut laws, 1, START, 1_000_000);
    if let Some(at_us) = copy_us {
        goes_in(&mut laws, 1, START, at_us);
    }
    for at_us in stops_us {
        goes_in(&mut laws, 2, Order::Stop, *at_us);
    }
    laws.stopped(2, 2_000_000);
    laws.grants[0].until_us() - REST_US
}

#[test]
fn a_stop_ends_what_was_ordered_before_it_went_in() {
    let whole_us = 31_000_000;
    for keyed in [false, true] {
        assert_eq!(rests_us(keyed, None, &[1_100_000]), 1_100_000);
        // Two copies: the first may have been lost in the receiver.
        assert_eq!(rests_us(keyed, None, &[1_100_000, 1_350_000]), 1_350_000);
        assert_eq!(rests_us(keyed, None, &[900_000]), whole_us, "before");
        assert_eq!(rests_us(keyed, None, &[2_100_000]), whole_us, "not yet");
    }
    // The first copy of the order may have been lost, and the second one came after the STOP. A key voids it.
    let copy_us = Some(1_250_000);
    assert_eq!(rests_us(false, copy_us, &[1_100_000]), whole_us);
    assert_eq!(rests_us(true, copy_us, &[1_100_000]), 1_100_000);
}

#[test]
fn an_order_between_a_stop_and_its_acknowledgement_counts() {
    let mut laws = Laws::new(true, [0; JOINTS], &[]);
    goes_in(&mut laws, 1, Order::Stop, 1_000_000);
    goes_in(&mut laws, 2, START, 1_002_000);
    laws.stopped(1, 1_500_000);
    assert!(laws.authorised(9_000_000));
    // What was made before it and comes late does not.
    let mut laws = Laws::new(true, [0; JOINTS], &[]);
    goes_in(&mut laws, 1, Order::Stop, 1_000_000);
    laws.stopped(1, 1_500_000);
    goes_in(&mut laws, 2, START, 1_000_500);
    assert!(!laws.authorised(1_600_000));
}
