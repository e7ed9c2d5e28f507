//! Joints without a zero.

use super::{START, goes_in, laws, sent};
use crate::schedule::channel::Order;
use crate::schedule::laws::{CYCLE_US, JOINTS, Law, Laws, STALE_US};
use crate::schedule::wire::Sent;
use protocol::bus::Profile;

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
