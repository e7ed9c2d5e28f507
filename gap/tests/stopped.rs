//! A search of a joint that is asked to stop ends within one simulation of a run, and keeps what it had found.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod common;

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use gap::bench::{Diagnosis, Settings, diagnose};
use gap::decide::Calibration;
use gap::joint::{P, Params};
use gap::watch::Watch;

/// What a watched diagnosis gave.
struct Watched {
    diagnosis: Diagnosis,
    /// How often it asked whether to stop before the first phase.
    before: usize,
    /// The same phase by phase.
    asked: Vec<(String, usize)>,
}

/// Diagnoses a joint with two causes; the answer to the question number `last` and to all after it is to stop.
fn watched(last: usize) -> Watched {
    let planted = Params::default().with(P::Coulomb, 0.4).with(P::Play, 0.02);
    let (manifest, recordings) = common::data(&planted, 3);
    let count = AtomicUsize::new(0);
    let phases = Mutex::new(Vec::new());
    let next = |text: &str| {
        let begun = count.load(Ordering::SeqCst);
        phases.lock().unwrap().push((text.to_owned(), begun));
    };
    let watch = Watch {
        next: &next,
        stop: &|| count.fetch_add(1, Ordering::SeqCst) + 1 >= last,
    };
    let settings = Settings::default();
    let calibration = Calibration::shipped_joint();
    let diagnosis = diagnose(&manifest, &recordings, &settings, &calibration, watch).unwrap();
    let phases = phases.into_inner().unwrap();
    let before = phases.first().map_or(0, |p: &(String, usize)| p.1);
    let mut ends: Vec<usize> = phases.iter().skip(1).map(|p| p.1).collect();
    ends.push(count.into_inner());
    let one = |((text, begun), end): ((String, usize), usize)| (text, end - begun);
    Watched {
        diagnosis,
        before,
        asked: phases.into_iter().zip(ends).map(one).collect(),
    }
}

#[test]
fn a_search_asks_at_every_simulation_whether_to_stop_and_keeps_what_it_has() {
    let whole = watched(usize::MAX);
    assert!(!whole.diagnosis.verdict.partial);
    let steps = |d: &Diagnosis| -> Vec<(String, f64)> {
        let all = d.verdict.staircase.iter();
        all.map(|s| (s.step.clone(), s.gap)).collect()
    };
    let all = steps(&whole.diagnosis);
    // As stated, calibrated, and two causes.
    assert!(all.len() >= 4, "{:?}", whole.asked);
    // A step of the search simulates every candidate on every motion, and so does every try of a rival.
    for (phase, asked) in whole
        .asked
        .iter()
        .filter(|p| p.0 != "choosing the next experiment")
    {
        assert!(*asked > 100, "{phase}: asked {asked} times");
    }
    // In the middle of the second effect, and of the rivals.
    let mut begun = whole.before;
    for (number, (phase, asked)) in whole.asked.iter().enumerate() {
        let middle = begun + asked / 2;
        begun += asked;
        if number != 1 && phase != "trying rivals" {
            continue;
        }
        let part = watched(middle);
        let d = &part.diagnosis;
        assert!(d.verdict.partial, "{phase}");
        assert_eq!(
            part.asked.len(),
            number + 1,
            "{phase}: nothing begins after it"
        );
        let found = steps(d);
        let names =
            |s: &[(String, f64)]| -> Vec<String> { s.iter().map(|s| s.0.clone()).collect() };
        assert_eq!(names(&found), names(&all[..found.len()]), "{phase}");
        if phase == "trying rivals" {
            // Both causes; a search over another horizon may add one.
            assert!(found.len() >= 4, "{found:?}");
        } else {
            assert_eq!(found.len(), number + 2);
        }
        let gap = &d.verdict.gap;
        assert!(
            gap.after > 0.0 && gap.after.is_finite(),
            "{phase}: {}",
            gap.after
        );
        assert!(gap.after < gap.before, "{phase}: {}", gap.after);
    }
}
