//! What the laws excuse ends where the module could know better.

use super::{CYCLE_US, JOINTS, Laws, STALE_US};
use crate::schedule::wire::Sent;

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
