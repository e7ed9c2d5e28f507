//! STOPs that nobody acknowledged, and joints without a zero.

use super::{START, goes_in, laws, sent};
use crate::schedule::channel::Order;
use crate::schedule::gaits;
use crate::schedule::laws::stops::RAMP_MOVES;
use crate::schedule::laws::{CYCLE_US, JOINTS, Law, Laws, STALE_US};
use crate::schedule::wire::Sent;
use control::cpg;
use control::motion::SETTLED_RAD;
use protocol::bus::Profile;

#[test]
fn a_ramp_has_the_moves_that_the_oscillators_take() {
    let moves = (0..gaits::COUNT).map(|number| {
        let gait = gaits::gait(number);
        let mut state = cpg::start(gait);
        for _ in 0..200 {
            cpg::advance(gait, &mut state, control::CYCLE_S, 1.0);
        }
        let settled = |state: &cpg::CpgState| {
            let mut all = state.oscillators().iter();
            all.all(|o| o.amplitude_rad.abs() <= SETTLED_RAD)
        };
        let mut moves = 0;
        while !settled(&state) {
            cpg::advance(gait, &mut state, control::CYCLE_S, 0.0);
            moves += 1;
        }
        moves
    });
    assert_eq!(moves.max(), Some(RAMP_MOVES));
}

/// Joints at this set-point, in a packet of a cycle.
fn set_points(at_us: u64, goal_urad: i32) -> Sent {
    let info = Profile::Packed.info();
    let goals: Vec<(u8, i32)> = (1..=6).map(|id| (id, goal_urad)).collect();
    let packet = info.set_points(&goals).expect("six fit");
    packed(at_us, packet.bytes())
}

fn torque(at_us: u64, ids: &[u8], on: i32) -> Sent {
    let info = Profile::Packed.info();
    let values: Vec<(u8, i32)> = ids.iter().map(|id| (*id, on)).collect();
    let packet = info.sync_write(&info.torque, &values).expect("six fit");
    packed(at_us, packet.bytes())
}

fn packed(at_us: u64, bytes: &[u8]) -> Sent {
    Sent {
        bytes: bytes.to_vec(),
        ..sent(at_us, at_us, false)
    }
}

/// A robot with its zeros set at 0.1 s and a start at 1 s.
fn started() -> Laws {
    let mut laws = laws();
    goes_in(&mut laws, 1, Order::Zero { joint_mask: 63 }, 100_000);
    goes_in(&mut laws, 2, START, 1_000_000);
    laws.packet(&torque(1_010_000, &[1, 2, 3, 4, 5, 6], 1), |_| false);
    assert_eq!(laws.broken, None);
    laws
}

/// Set-points of `cycles` cycles from `from_us` on, each other than the one before. When the law breaks, in moves.
fn moves(laws: &mut Laws, from_us: u64, cycles: u64) -> Option<u64> {
    for cycle in 0..cycles {
        let at_us = from_us + cycle * CYCLE_US;
        laws.read_us = at_us;
        let goal_urad = (at_us / CYCLE_US) as i32 % 7;
        laws.packet(&set_points(at_us, goal_urad), |_| false);
        if let Some(broken) = &laws.broken {
            assert_eq!(broken.law, Law::Stops, "{broken}");
            return Some(cycle + 1);
        }
    }
    None
}

#[test]
fn a_gait_that_goes_on_after_a_stop_breaks_a_law_when_a_ramp_would_be_over() {
    let most = u64::from(RAMP_MOVES) + 1;
    let mut laws = started();
    assert_eq!(moves(&mut laws, 1_020_000, 40), None);
    goes_in(&mut laws, 3, Order::Stop, 3_030_000);
    assert_eq!(moves(&mut laws, 3_040_000, most), None);
    // What stands still is no move, for as long as the hold may be.
    let at_us = 3_040_000 + most * CYCLE_US;
    let last = laws.goals[0].expect("sent");
    laws.read_us = at_us;
    laws.packet(&set_points(at_us, last), |_| false);
    assert_eq!(laws.broken, None);
    // A second STOP gives no more time.
    goes_in(&mut laws, 4, Order::Stop, at_us + 1_000);
    assert_eq!(moves(&mut laws, at_us + 10_000, 3), Some(1));
}

#[test]
fn a_start_after_a_stop_moves_and_one_before_does_not() {
    let mut laws = started();
    goes_in(&mut laws, 3, Order::Stop, 2_000_000);
    laws.obey_stops(2_000_000);
    goes_in(&mut laws, 4, START, 2_000_500);
    laws.packet(&torque(2_010_000, &[1], 1), |_| false);
    assert_eq!(moves(&mut laws, 2_020_000, 60), None);
    // Both are on the line, and the order reaches the module first.
    let mut laws = started();
    goes_in(&mut laws, 3, Order::Stop, 2_004_000);
    goes_in(&mut laws, 4, START, 2_001_000);
    laws.packet(&torque(2_002_000, &[1], 1), |_| false);
    assert_eq!(laws.broken, None);
    let most = u64::from(RAMP_MOVES) + 1;
    // The first set-point after torque-on tells no move.
    assert_eq!(moves(&mut laws, 2_020_000, 60), Some(most + 2));
}

#[test]
fn no_torque_goes_on_after_a_stop() {
    for (at_us, broken) in [(2_000_000, None), (2_000_001, Some(Law::Stops))] {
        let mut laws = started();
        goes_in(&mut laws, 3, Order::Stop, 2_000_000);
        laws.packet(&torque(at_us, &[1], 1), |_| false);
        assert_eq!(laws.broken.map(|broken| broken.law), broken);
    }
}

#[test]
fn a_stop_that_may_be_lost_on_its_way_need_not_be_obeyed() {
    // The link, when something strikes it, and whether the STOP that arrives at 2 s stays certain.
    for (link, struck_us, certain) in [
        (0, 1_999_999, false),
        (0, 2_000_000, true),
        (1, 1_999_999, true),
    ] {
        let mut laws = started();
        goes_in(&mut laws, 3, Order::Stop, 2_000_000);
        laws.link_struck(link, struck_us);
        let broken = moves(&mut laws, 2_010_000, 60).is_some();
        assert_eq!(broken, certain, "link {link} struck at {struck_us} us");
        assert_eq!(laws.counts.stops, u64::from(certain));
    }
    let mut laws = started();
    goes_in(&mut laws, 3, Order::Stop, 2_000_000);
    laws.restarted(1_999_999);
    laws.obey_stops(2_100_000);
    assert_eq!(laws.counts.stops, 0);
}

#[test]
fn a_stop_that_nobody_acknowledged_ends_the_leave_to_have_torque() {
    let mut laws = started();
    assert!(laws.authorised(9_000_000));
    goes_in(&mut laws, 3, Order::Stop, 2_000_000);
    assert!(laws.authorised(9_000_000), "not yet");
    laws.obey_stops(2_000_000);
    assert!(!laws.authorised(9_000_000));
}

/// What breaks when joints are zeroed by `mask` at 0.1 s, joint 2 restarts at `lost_us`, and torque goes on after a start at 1 s.
fn without_zero(mask: u16, lost_us: Option<u64>) -> Option<Law> {
    let mut laws = laws();
    goes_in(&mut laws, 1, Order::Zero { joint_mask: mask }, 100_000);
    if let Some(lost_us) = lost_us {
        laws.encoder_lost(lost_us, 2, 0);
    }
    goes_in(&mut laws, 2, START, 1_000_000);
    laws.packet(&torque(1_010_000, &[1, 2], 1), |_| false);
    laws.broken.map(|broken| broken.law)
}

#[test]
fn torque_takes_the_zero_of_every_joint() {
    assert_eq!(without_zero(63, None), None);
    for joint in 0..JOINTS {
        assert_eq!(without_zero(63 & !(1 << joint), None), Some(Law::Homed));
    }
    assert_eq!(without_zero(63, Some(99_999)), None);
    assert_eq!(without_zero(63, Some(100_001)), Some(Law::Homed));
    // The reading that tells of the restart is a cycle away.
    assert_eq!(without_zero(63, Some(1_009_000)), None);
}

#[test]
fn no_zero_outlives_a_restart_of_the_module() {
    let mut laws = started();
    laws.restarted(2_000_000);
    goes_in(&mut laws, 3, START, 2_100_000);
    laws.packet(&torque(2_110_000, &[1], 1), |_| false);
    assert_eq!(laws.broken.map(|broken| broken.law), Some(Law::Homed));
}

#[test]
fn no_set_point_goes_to_a_joint_that_has_lost_its_zero() {
    for (after_us, broken) in [(CYCLE_US - 1, None), (STALE_US + 1, Some(Law::Homed))] {
        let mut laws = started();
        laws.encoder_lost(2_000_000, 3, 0);
        laws.read_us = 2_000_000 + after_us;
        laws.packet(&set_points(2_000_000 + after_us, 0), |_| false);
        assert_eq!(laws.broken.map(|broken| broken.law), broken);
    }
}
