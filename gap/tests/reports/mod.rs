//! Five verdicts of the kinds that people meet, built by hand: what a report must say of them is known.

use std::collections::BTreeMap;

use files::dataset::Manifest;
use gap::report::Subject;
use gap::verdict::*;
use gap::vocabulary::Effect;

/// A report to be read: a short name, the verdict, and what it is about.
pub(crate) struct Case {
    pub(crate) name: &'static str,
    pub(crate) verdict: Verdict,
    pub(crate) subject: Subject,
}

fn subject(text: &str, runs: usize) -> Subject {
    let runs: String = (0..runs)
        .map(|k| format!("[[run]]\nfile = \"run{k}.csv\"\n"))
        .collect();
    let (manifest, _) = Manifest::parse("dataset.toml", &format!("format = 1\n{text}\n{runs}"))
        .expect("valid manifest");
    Subject::new(&manifest, Some("2026-11-20".into()))
}

/// Metric, unit, before, calibrated, after, floor.
fn gap(metric: &str, unit: &str, [before, calibrated, after, floor]: [f64; 4]) -> Gap {
    Gap {
        metric: metric.into(),
        unit: unit.into(),
        before,
        after_calibration: calibrated,
        after,
        floor,
        floor_source: "repeats".into(),
        ci95_after: [0.9 * after, 1.1 * after],
        shrink: 1.0 - after / before,
        shrink_after_calibration: 1.0 - after / calibrated,
        shrink_of_achievable: Some((before - after) / (before - floor)),
        held_out_runs: vec!["run2.csv".into(), "run5.csv".into()],
    }
}

fn place(stage: &str, joint: Option<usize>, share: f64) -> Where {
    Where {
        stage: stage.into(),
        joint,
        regime: "reversal".into(),
        share,
        ci95: [0.8 * share, (1.2 * share).min(1.0)],
    }
}

/// An effect with one parameter, and whether each rival is distinguishable.
fn effect(
    effect: Effect,
    joint: Option<usize>,
    value: f64,
    confidence: f64,
    rivals: &[(Effect, bool)],
) -> EffectRow {
    let estimate = Estimate {
        value,
        ci95: [0.9 * value, 1.1 * value],
    };
    let key = effect.parameters()[0].key.to_owned();
    let rival = |(effect, distinguishable): &(Effect, bool)| Alternative {
        effect: *effect,
        distinguishable: *distinguishable,
        margin: if *distinguishable { 7.6 } else { 8.2 },
    };
    EffectRow {
        part_of: None,
        effect,
        stage: effect.stage().name().into(),
        joint,
        parameters: BTreeMap::from([(key, estimate)]),
        confidence,
        alternatives: rivals.iter().map(rival).collect(),
        gap_added_alone: 0.011,
        gap_removed_from_full: 0.017,
        kind: "structural".into(),
        plausible: true,
    }
}

fn class(effects: &[Effect], separate_by: &str) -> Ambiguous {
    let member = |e: &Effect| Member {
        effect: *e,
        stage: e.stage().name().into(),
        joint: Some(0),
        probability: 1.0 / effects.len() as f64,
    };
    Ambiguous {
        effects: effects.to_vec(),
        members: effects.iter().map(member).collect(),
        separate_by: separate_by.into(),
    }
}

/// A verdict with the sum of its confidences as it should be.
fn verdict(
    verdict: Word,
    gap: Gap,
    effects: Vec<EffectRow>,
    probabilities: Probabilities,
) -> Verdict {
    let three = [gap.before, gap.after_calibration, gap.after];
    let stair = |step: &str, gap| Stair {
        step: step.into(),
        gap,
    };
    Verdict {
        schema: "rb.gap/1".into(),
        verdict,
        sentence: String::new(),
        partial: false,
        metrics: BTreeMap::from([(gap.metric.clone(), three)]),
        // A step that the search tried and rejected must not be shown.
        staircase: vec![
            stair("nominal", gap.before),
            stair("calibrated", gap.after_calibration),
            stair("thermal_derating", 1.01 * gap.after),
        ],
        gap,
        place: Vec::new(),
        regimes: Vec::new(),
        effects,
        probabilities,
        unseen: vec![Unseen {
            effect: Effect::Jitter,
            why: "needs the applied set-point as the driver echoes it".into(),
        }],
        ambiguous: Vec::new(),
        next_experiment: None,
        pulled: BTreeMap::new(),
        displaced: Vec::new(),
        provenance: Provenance {
            tool: "gap".into(),
            commit: None,
            data_sha256: "0".into(),
            seed: 1,
            split: "every third gait held out".into(),
            wall_time_s: 12.0,
            warnings: Vec::new(),
        },
    }
}

const STATED: &str = "[bench]\ninertia_kg_m2 = 0.003\nsupply_v = 12.0\neffort_per_volt = 0.1\n\
                      [bench.controller]\nkind = \"p\"\noutput = \"voltage\"\nkp = 5.0";

fn none() -> Case {
    let gap = gap("position_rmse_rad", "rad", [0.0041, 0.0037, 0.0037, 0.0036]);
    let chance = Probabilities {
        none: 0.97,
        unknown: 0.02,
    };
    let mut v = verdict(Word::None, gap, Vec::new(), chance);
    v.place = vec![place("unexplained", Some(0), 1.0)];
    let text = format!("robot = \"bench\"\nname = \"Elbow on the stand\"\n{STATED}");
    Case {
        name: "none",
        verdict: v,
        subject: subject(&text, 6),
    }
}

fn shared() -> Case {
    let gap = gap("position_rmse_rad", "rad", [0.0213, 0.0189, 0.0041, 0.0036]);
    let chance = Probabilities {
        none: 0.01,
        unknown: 0.03,
    };
    let sizes = [0.62, 0.71, 0.8, 0.66, 0.6, 0.75];
    let all = [
        (Effect::StribeckFriction, true),
        (Effect::ViscousFriction, true),
    ];
    let row = |(k, x): (usize, &f64)| effect(Effect::CoulombFriction, Some(k), *x, 0.16, &all);
    let rows = sizes.iter().enumerate().map(row).collect();
    let mut v = verdict(Word::Explained, gap, rows, chance);
    v.place = [0.12, 0.15, 0.2, 0.13, 0.11, 0.14]
        .into_iter()
        .enumerate()
        .map(|(k, x)| place("drivetrain", Some(k), x))
        .collect();
    v.place.push(place("driver", Some(2), 0.08));
    v.place.push(place("unexplained", None, 0.07));
    Case {
        name: "shared",
        verdict: v,
        subject: subject(
            "robot = \"metamodule\"\nname = \"Crawl on the lab floor\"",
            42,
        ),
    }
}

fn one_of_a_class() -> Case {
    let gap = gap("position_rmse_rad", "rad", [0.0189, 0.0151, 0.0072, 0.0052]);
    let chance = Probabilities {
        none: 0.01,
        unknown: 0.42,
    };
    let rivals = [
        (Effect::CoulombFriction, true),
        (Effect::Deadband, false),
        (Effect::Quantisation, true),
    ];
    let row = effect(Effect::Backlash, Some(0), 0.009, 0.57, &rivals);
    let mut v = verdict(Word::Explained, gap, vec![row], chance);
    v.place = vec![
        place("transmission", Some(0), 0.46),
        place("driver", Some(0), 0.38),
        place("unexplained", Some(0), 0.16),
    ];
    let members = [Effect::Backlash, Effect::Deadband, Effect::StribeckFriction];
    let advice = "record link_position behind the gear during slow reversals";
    v.ambiguous = vec![class(&members, advice)];
    v.next_experiment = Some(NextExperiment {
        text: "Bring the joint to 200 mrad and play the slow triangle of the motion file three times (24 s, within the angles and speeds of the recordings); record current_a and duty too.".into(),
        separates: members.to_vec(),
        gait: Some("report.next.csv".into()),
    });
    let text = format!("robot = \"bench\"\nname = \"SO-101, shoulder rotation\"\n{STATED}");
    Case {
        name: "class",
        verdict: v,
        subject: subject(&text, 9),
    }
}

fn unknown() -> Case {
    let gap = gap("pose_rmse_m", "m", [0.0312, 0.0295, 0.0291, 0.006]);
    let chance = Probabilities {
        none: 0.0,
        unknown: 0.93,
    };
    let row = effect(Effect::ViscousFriction, Some(4), 0.31, 0.07, &[]);
    let mut v = verdict(Word::Unknown, gap, vec![row], chance);
    v.place = vec![
        place("body", None, 0.71),
        place("unexplained", None, 0.2),
        place("drivetrain", Some(4), 0.06),
        place("driver", Some(1), 0.03),
    ];
    v.next_experiment = Some(NextExperiment {
        text: "Record each joint alone in the air (slow triangle, then chirp) with current and link angle, three repeats each: it shows whether the remainder lies before or behind the gear.".into(),
        separates: Vec::new(),
        gait: None,
    });
    Case {
        name: "unknown",
        verdict: v,
        subject: subject("robot = \"metamodule\"\nname = \"Roll on the carpet\"", 12),
    }
}

fn little_stated() -> Case {
    let gap = gap("position_rmse_rad", "rad", [0.0834, 0.0612, 0.0195, 0.0048]);
    let chance = Probabilities {
        none: 0.0,
        unknown: 0.02,
    };
    let mut gain = effect(
        Effect::LoopGain,
        Some(0),
        24.45,
        0.49,
        &[(Effect::DampingGain, true)],
    );
    gain.plausible = false;
    let late = effect(
        Effect::FeedbackDelay,
        Some(0),
        0.021,
        0.49,
        &[(Effect::MotorLag, false)],
    );
    let mut v = verdict(Word::PartlyExplained, gap, vec![gain, late], chance);
    v.staircase.push(Stair {
        step: "loop_gain".into(),
        gap: 0.031,
    });
    v.staircase.push(Stair {
        step: "feedback_delay".into(),
        gap: 0.0195,
    });
    v.place = vec![
        place("driver", Some(0), 0.71),
        place("unexplained", Some(0), 0.2),
        place("drivetrain", Some(0), 0.09),
    ];
    Case {
        name: "little-stated",
        verdict: v,
        subject: subject("robot = \"bench\"\nname = \"My servo\"", 5),
    }
}

/// The five.
pub(crate) fn cases() -> [Case; 5] {
    [
        none(),
        shared(),
        one_of_a_class(),
        unknown(),
        little_stated(),
    ]
}
