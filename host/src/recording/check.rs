//! Checks a recording: whole, complete, plausible, and with the set-points of its own gait.

use control::gait::Gait;

use super::reader::{Recording, RunData};
use super::rows::SampleRow;
use super::timing::is_first_of_cycle;

/// Set-points travel in whole microradians, so a right one is at most half of one away.
const SETPOINT_TOLERANCE_RAD: f64 = 0.6e-6;

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Severity {
    /// Worth knowing.
    Note,
    /// The recording must not be trusted there.
    Problem,
}

/// One finding.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// How bad.
    pub severity: Severity,
    /// Run, if it belongs to one.
    pub run: Option<u32>,
    /// What was found.
    pub kind: FindingKind,
}

/// What can be found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FindingKind {
    /// The file is damaged.
    #[error("offset {}: {}", .0.offset, .0.kind)]
    Damage(super::Damage),
    /// No samples at all.
    #[error("no samples")]
    Empty,
    /// Samples are missing.
    #[error("{missing} samples are missing{}", At(.first_s))]
    Gap {
        /// Missing samples.
        missing: u32,
        /// Time of the first gap after the first sample, s; `None` when it lies at an end.
        first_s: Option<f64>,
    },
    /// The run was not ended.
    #[error("the end of the run was not recorded")]
    NoEnd,
    /// The pre-check held the robot.
    #[error("the pre-check held the joints in {cycles} cycles")]
    Holds {
        /// Held cycles.
        cycles: u32,
    },
    /// A joint's driver did not answer at times.
    #[error("joint {joint} did not answer in {samples} samples")]
    NoAnswer {
        /// Joint index.
        joint: usize,
        /// Samples without answer.
        samples: usize,
    },
    /// The set-points are not those of the attached gait.
    #[error(
        "set-points differ from the attached gait: joint {joint}, cycle {cycle}, by {difference_rad:.6} rad"
    )]
    OtherSetpoints {
        /// Joint index.
        joint: usize,
        /// CPG cycle.
        cycle: u32,
        /// Difference, rad.
        difference_rad: f64,
    },
}

/// Checks everything. `gait` is the attached gait, if it was read.
#[must_use]
pub fn check(recording: &Recording, gait: Option<&Gait>) -> Vec<Finding> {
    let mut findings: Vec<Finding> = recording
        .damage
        .iter()
        .map(|d| Finding {
            severity: Severity::Problem,
            run: None,
            kind: FindingKind::Damage(d.clone()),
        })
        .collect();
    if recording.runs.iter().all(|r| r.samples.is_empty()) {
        findings.push(Finding {
            severity: Severity::Problem,
            run: None,
            kind: FindingKind::Empty,
        });
    }
    for run in recording.runs.iter().filter(|r| !r.samples.is_empty()) {
        check_run(run, gait, &mut findings);
    }
    findings
}

fn check_run(run: &RunData, gait: Option<&Gait>, findings: &mut Vec<Finding>) {
    let mut add = |severity, kind| {
        findings.push(Finding {
            severity,
            run: Some(run.run),
            kind,
        })
    };
    if let Some(gap) = gap(run) {
        add(Severity::Problem, gap);
    }
    match &run.end {
        None => add(Severity::Problem, FindingKind::NoEnd),
        Some(end) if end.holds > 0 => add(Severity::Note, FindingKind::Holds { cycles: end.holds }),
        Some(_) => {}
    }
    let joints = run.samples.first().map_or(0, |s| s.joints.len());
    for joint in 0..joints {
        let silent = |s: &&SampleRow| s.joints.get(joint).is_none_or(|j| j.feedback.is_none());
        let samples = run.samples.iter().filter(silent).count();
        if samples > 0 {
            add(Severity::Note, FindingKind::NoAnswer { joint, samples });
        }
    }
    if let Some(other) = gait.and_then(|g| other_setpoints(run, g)) {
        add(Severity::Problem, other);
    }
}

/// Missing samples: steps of the device clock of more than a period, and what the module counted beyond that.
fn gap(run: &RunData) -> Option<FindingKind> {
    let gaps = gaps(run);
    let between: u32 = gaps.iter().map(|g| g.missing).sum();
    let present = u32::try_from(run.samples.len()).unwrap_or(u32::MAX);
    let counted = run
        .end
        .as_ref()
        .map_or(0, |e| e.samples.saturating_sub(present));
    let missing = between.max(counted);
    let start = run.samples.first()?.t_us;
    let first_s = gaps
        .first()
        .map(|g| g.after_us.saturating_sub(start) as f64 / 1e6);
    (missing > 0).then_some(FindingKind::Gap { missing, first_s })
}

/// A step of the device clock over missing samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TimeGap {
    /// Device time of the last sample before.
    pub after_us: u64,
    /// Device time of the first sample behind.
    pub before_us: u64,
    /// Samples missing between them.
    pub missing: u32,
}

/// The gaps of a run, from the rate that was asked for.
#[must_use]
pub fn gaps(run: &RunData) -> Vec<TimeGap> {
    let rate_hz = run
        .start
        .as_ref()
        .map(|s| s.rate_hz)
        .filter(|r| *r > 0.0)
        .unwrap_or(20.0);
    let period_us = 1e6 / rate_hz;
    let steps = run.samples.windows(2).filter_map(|pair| {
        let (after_us, before_us) = (pair[0].t_us, pair[1].t_us);
        let periods = (before_us.saturating_sub(after_us) as f64 / period_us).round();
        let missing = (periods as u32).saturating_sub(1);
        (missing > 0).then_some(TimeGap {
            after_us,
            before_us,
            missing,
        })
    });
    steps.collect()
}

/// ` , first at …` or nothing.
struct At<'a>(&'a Option<f64>);

impl core::fmt::Display for At<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.0 {
            Some(s) => write!(f, ", the first after {s:.2} s"),
            None => Ok(()),
        }
    }
}

/// The first set-point that the gait does not give. Held cycles repeat the last safe pose; they end the comparison, and so does a change of gait.
fn other_setpoints(run: &RunData, gait: &Gait) -> Option<FindingKind> {
    if run.start.as_ref().is_none_or(|s| s.gait != gait.name()) {
        return None;
    }
    let duration_s = run.start.as_ref().map_or(0.0, |s| s.duration_s);
    let cycles = (duration_s / f64::from(control::CYCLE_S)).round() as u32;
    let changed = run.events.iter().filter(|e| e.kind == "gait_changed");
    let changed_us = changed.map(|e| e.t_us).min();
    let mut state = control::cpg::start(gait);
    let mut samples = run
        .samples
        .iter()
        .filter(|s| is_first_of_cycle(s))
        .peekable();
    for cycle in 0..cycles {
        let expected = control::cpg::step(gait, &mut state, control::CYCLE_S);
        let Some(sample) = samples.next_if(|s| s.cycle == cycle + 1) else {
            continue;
        };
        if sample.hold || changed_us.is_some_and(|us| sample.t_us > us) {
            return None;
        }
        for (joint, (row, want)) in sample.joints.iter().zip(expected.as_slice()).enumerate() {
            let difference_rad = (row.setpoint_rad - f64::from(*want)).abs();
            if difference_rad > SETPOINT_TOLERANCE_RAD {
                return Some(FindingKind::OtherSetpoints {
                    joint,
                    cycle,
                    difference_rad,
                });
            }
        }
    }
    None
}
