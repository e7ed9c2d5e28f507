//! The tables of instructions per tick, in short: one gait instead of all.

use hil_sim::board::table::{self, Contact};

use crate::common::{built, gait};

#[test]
fn a_tick_of_the_image_stays_within_its_share_of_the_period() {
    let Some(built) = built("ticks") else { return };
    let crawl = gait("crawl");
    let whole = table::measure(&built, &crawl).expect("measured");
    let total = whole.rows.first().expect("a row of all");
    let most = table::most(&built, &crawl)
        .expect("measured")
        .expect("taken");
    assert!(most.tick <= table::target_instructions(), "{most:?}");
    assert!((1..most.tick).contains(&most.bus), "{most:?}");
    assert!(total.max.is_some_and(|m| m <= table::target_instructions()));
    assert!(total.mean < most.tick as f64 && whole.ticks > 600);
    assert!(
        whole
            .stack_bound
            .is_some_and(|b| b.total_bytes() >= whole.stack_used)
    );
}

#[test]
fn a_change_of_gait_in_mid_run_stays_within_the_share_too() {
    let Some(built) = built("ticks of a change") else {
        return;
    };
    let most = table::most_of_change(&built, &gait("crawl"), &gait("sidewind"), Contact::Kept)
        .expect("measured")
        .expect("taken");
    assert!(most.tick <= table::target_instructions(), "{most:?}");
}
