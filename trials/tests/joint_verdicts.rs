//! A few fixed cases of the blind check of one joint: emulated motor, driver and bench on one side, diagnosis on the other.
//! The full suite is `rb-trials joints`; this one keeps what it found from being lost. Seed and numbers are those of
//! development, so this is no blind result.

use files::dataset::{Manifest, Recording};
use gap::bench::{Settings, diagnose};
use gap::decide::Calibration;
use gap::verdict::{Verdict, Word};
use gap::watch::Watch;
use trials::joint;

const SEED: u64 = 100;

fn verdict_on(case: &joint::Case) -> Verdict {
    let text = |name: &str| {
        let file = case.files.iter().find(|f| f.0 == name);
        file.expect("the case has the file").1.as_str()
    };
    let (manifest, _) = Manifest::parse("dataset.toml", text("dataset.toml")).expect("valid");
    let recordings: Vec<Recording> = manifest
        .runs
        .iter()
        .map(|r| {
            Recording::parse(&r.file, text(&r.file), &manifest)
                .expect("valid")
                .0
        })
        .collect();
    let (settings, calibration) = (Settings::default(), Calibration::shipped_joint());
    diagnose(
        &manifest,
        &recordings,
        &settings,
        &calibration,
        Watch::NOBODY,
    )
    .expect("positions")
    .verdict
}

fn of_kind(kind: &str) -> impl Iterator<Item = usize> {
    let kind = kind.to_string();
    (0..200).filter(move |i| joint::plan(SEED, *i).kind == kind)
}

#[test]
fn cases_without_an_effect_raise_no_alarm() {
    for index in of_kind("null").take(4) {
        let case = joint::case(SEED, index);
        let verdict = verdict_on(&case);
        assert_eq!(
            verdict.verdict,
            Word::None,
            "{}: {}",
            case.label.name,
            verdict.sentence
        );
        assert!(verdict.effects.is_empty());
    }
}

#[test]
fn visible_single_effects_are_named_first() {
    let mut tried = 0;
    for index in of_kind("single") {
        let case = joint::case(SEED, index);
        let label = &case.label;
        // Smaller ones may hide.
        if label.causes[0].delta_chi2_refitted < 2500.0 {
            continue;
        }
        let verdict = verdict_on(&case);
        let planted = label.causes[0].effect.as_str();
        let named = verdict.effects.first().map(|e| e.effect.name());
        let class = |a: &gap::verdict::Ambiguous| a.effects.iter().any(|e| e.name() == planted);
        assert!(
            named == Some(planted) || verdict.ambiguous.iter().any(class),
            "{}: planted {planted}, named {named:?}",
            label.name
        );
        let total: f64 = verdict.effects.iter().map(|e| e.confidence).sum::<f64>()
            + verdict.probabilities.none
            + verdict.probabilities.unknown;
        assert!((total - 1.0).abs() < 1e-9);
        tried += 1;
        if tried == 4 {
            break;
        }
    }
    assert_eq!(tried, 4);
}
