//! Seeded schedules of faults over the whole chain: no law breaks, a seed replays to the byte on any number of threads, an unknown fault is refused.

use hil_sim::schedule::{Cut, Kind, Plan, many, play};

/// Schedules that every run of the tests plays: about a minute of processor time.
const SCHEDULES: u64 = 2_000;

fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

#[test]
fn no_law_breaks_whatever_strikes() {
    let summary = many(0, SCHEDULES, threads(), &Cut::default(), false, &|| true);
    assert_eq!(summary.schedules, SCHEDULES);
    assert!(summary.failures.is_empty(), "{:#?}", summary.failures);
    for (kind, struck) in Kind::all().zip(summary.struck) {
        assert!(struck > 30, "{} struck {struck} times", kind.name());
    }
    let counts = summary.counts;
    println!("{SCHEDULES} schedules, {counts:?}");
    assert!(counts.runs > SCHEDULES && counts.records > SCHEDULES / 2);
    assert!(counts.completed > SCHEDULES / 5 && counts.uploads > SCHEDULES / 2);
}

/// Seeds of longer runs in which a law did not hold: of the firmware, or of the laws themselves.
const ONCE_BROKEN: [u64; 19] = [
    1_001_717, 1_005_104, 2_004_131, 2_005_759, 2_006_753, 2_009_766, 3_002_523, 3_002_905,
    3_005_344, 3_008_058, 3_008_423, 4_004_192, 4_019_414, 4_030_497, 5_015_005, 6_000_784,
    7_000_081, 7_001_565, 7_009_756,
];

#[test]
fn seeds_that_broke_a_law_once_hold_now() {
    for seed in ONCE_BROKEN {
        assert_eq!(play(&Plan::of(seed)).broken, None, "seed {seed}");
    }
}

#[test]
fn the_sum_does_not_depend_on_the_number_of_threads() {
    let of = |threads| many(5_000, 24, threads, &Cut::default(), false, &|| true);
    assert_eq!(of(1), of(3));
}

#[test]
fn a_seed_replays_to_the_byte_and_another_is_another() {
    let trace = |seed| play(&Plan::of(seed)).trace;
    assert_eq!(trace(11), trace(11));
    assert_ne!(trace(11), trace(12));
}

#[test]
fn a_schedule_without_some_of_its_faults_keeps_the_others() {
    let whole = Plan::of(0);
    assert!(whole.faults.len() > 2);
    let keep = vec![1];
    let cut = Cut {
        keep: Some(keep),
        ..Cut::default()
    };
    let less = Plan::with(0, &cut);
    assert_eq!(less.faults, [whole.faults[1]]);
    assert_eq!(less.home_urad, whole.home_urad);
}
