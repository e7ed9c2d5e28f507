//! Where, from measured signals: each planted law is broken in its own stage, with nothing fitted and no library.

mod common;

use gap::interface::shares;
use gap::joint::{P, Params, Problem};
use gap::vocabulary::Stage;

#[test]
fn a_broken_law_shows_in_its_own_stage_inverse_crime() {
    let table = [
        (P::Coulomb, 0.6, Stage::Drivetrain),
        (P::Viscous, 0.5, Stage::Drivetrain),
        (P::Gravity, 1.4, Stage::Drivetrain),
        (P::Resistance, 1.5, Stage::Electrical),
        (P::CurrentLimit, 0.3, Stage::Electrical),
        (P::Deadband, 0.02, Stage::Driver),
        (P::LoopGain, 0.7, Stage::Driver),
        (P::Lag, 0.01, Stage::Driver),
        (P::FeedbackDelay, 0.005, Stage::Driver),
        // The loop swings by itself.
        (P::FeedbackDelay, 0.012, Stage::Driver),
    ];
    for (p, value, stage) in table {
        let planted = Params::default().with(p, value);
        let (manifest, recordings) = common::data(&planted, 11);
        let problem = Problem::new(&manifest, &recordings, 0).expect("position");
        let runs: Vec<usize> = (0..problem.runs.len()).collect();
        let told = shares(&problem, &runs, &Params::default(), 70.0, 1).expect("all signals");
        assert_eq!(told[0].stage, Some(stage), "{p:?}: {told:?}");
        assert!(told[0].share > 0.5, "{p:?}: {told:?}");
        let sum: f64 = told.iter().map(|s| s.share).sum();
        assert!((sum - 1.0).abs() < 1e-9, "{sum}");
        // With the law in the model nothing stands out.
        let left = shares(&problem, &runs, &planted, 70.0, 1);
        let strongest = left.map_or(0.0, |l| l[0].share);
        assert!(strongest < told[0].share, "{p:?}");
    }
}

#[test]
fn without_duty_and_current_nothing_is_claimed() {
    let (manifest, mut recordings) = common::data(&Params::default(), 1);
    for r in &mut recordings {
        r.joint_mut(0)
            .expect("one joint")
            .set(files::dataset::Signal::Current, None);
    }
    let problem = Problem::new(&manifest, &recordings, 0).expect("position");
    assert_eq!(shares(&problem, &[0, 1], &Params::default(), 70.0, 1), None);
}
