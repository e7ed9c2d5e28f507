//! Which instruction set runs a batch.
#![allow(unsafe_code)]

use crate::engine::{NoProbe, Probe, Stage};
use crate::robot::Robot;
use crate::rollout::run_group;
use crate::trial::{Options, Outcome, RunError, Trial};
use std::sync::Arc;

/// An instruction set and lane width. All but [`Level::Reference`] give the same bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Scalar double precision: the reference, one trial at a time.
    Reference,
    /// Scalar single precision.
    Scalar,
    /// 4 lanes, SSE2, what every x86-64 has.
    Sse2,
    /// 8 lanes.
    Avx2,
    /// 16 lanes.
    Avx512,
}

impl Level {
    /// The fastest level of this processor.
    #[must_use]
    pub fn detect() -> Level {
        #[cfg(target_arch = "x86_64")]
        {
            if std::arch::is_x86_feature_detected!("avx512f") {
                return Level::Avx512;
            }
            if std::arch::is_x86_feature_detected!("avx2") {
                return Level::Avx2;
            }
            return Level::Sse2;
        }
        #[allow(unreachable_code)]
        Level::Scalar
    }

    /// Whether this processor can run it.
    #[must_use]
    pub fn available(self) -> bool {
        match self {
            Level::Reference | Level::Scalar => true,
            #[cfg(target_arch = "x86_64")]
            Level::Sse2 => true,
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => std::arch::is_x86_feature_detected!("avx2"),
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => std::arch::is_x86_feature_detected!("avx512f"),
            #[cfg(not(target_arch = "x86_64"))]
            _ => false,
        }
    }

    /// Trials that run side by side; hand [`run`] a multiple of it.
    #[must_use]
    pub fn lanes(self) -> usize {
        match self {
            Level::Reference | Level::Scalar => 1,
            Level::Sse2 => 4,
            Level::Avx2 => 8,
            Level::Avx512 => 16,
        }
    }
}

/// Runs trials on this thread at the fastest level. Results do not depend on the level, on how trials are split into calls, or on which
/// trials run side by side; split by [`Level::lanes`] to spread them over threads.
///
/// # Errors
/// A setting out of range, or a trial whose drive does not fit its robot.
pub fn run(trials: &[Trial], options: &Options) -> Result<Vec<Outcome>, RunError> {
    run_at(Level::detect(), trials, options)
}

/// As [`run`], at a given level; one that this processor lacks falls back to [`Level::Scalar`], with the same bits.
///
/// # Errors
/// As [`run`].
pub fn run_at(level: Level, trials: &[Trial], options: &Options) -> Result<Vec<Outcome>, RunError> {
    run_with(level, trials, options, &mut NoProbe)
}

/// As [`run`], telling `probe` when each stage of each step ends.
///
/// # Errors
/// As [`run`].
pub fn run_probed(
    trials: &[Trial],
    options: &Options,
    probe: &mut dyn Probe,
) -> Result<Vec<Outcome>, RunError> {
    struct Told<'a>(&'a mut dyn Probe);
    impl Probe for Told<'_> {
        fn ended(&mut self, stage: Stage) {
            self.0.ended(stage);
        }
    }
    run_with(Level::detect(), trials, options, &mut Told(probe))
}

fn run_with<P: Probe>(
    level: Level,
    trials: &[Trial],
    options: &Options,
    probe: &mut P,
) -> Result<Vec<Outcome>, RunError> {
    options.check()?;
    for (k, trial) in trials.iter().enumerate() {
        trial.check(k)?;
    }
    let level = if level.available() {
        level
    } else {
        Level::Scalar
    };
    let mut outcomes: Vec<Option<Outcome>> = vec![None; trials.len()];
    let mut left: Vec<usize> = (0..trials.len()).collect();
    while let Some(first) = left.first() {
        let robot = Arc::clone(&trials[*first].params.robot);
        let same = |k: &usize| {
            Arc::ptr_eq(&trials[*k].params.robot, &robot) || *trials[*k].params.robot == *robot
        };
        let (group, rest): (Vec<usize>, Vec<usize>) = left.iter().copied().partition(same);
        left = rest;
        for chunk in group.chunks(level.lanes()) {
            let members: Vec<&Trial> = chunk.iter().map(|k| &trials[*k]).collect();
            let done = run_level(level, &robot, &members, options, probe);
            for (k, outcome) in chunk.iter().zip(done) {
                outcomes[*k] = Some(outcome);
            }
        }
    }
    Ok(outcomes.into_iter().flatten().collect())
}

fn run_level<P: Probe>(
    level: Level,
    robot: &Robot,
    trials: &[&Trial],
    options: &Options,
    probe: &mut P,
) -> Vec<Outcome> {
    match level {
        Level::Reference => run_group::<f64>(robot, trials, options, probe),
        #[cfg(target_arch = "x86_64")]
        Level::Sse2 => run_group::<crate::lane::F32x4>(robot, trials, options, probe),
        // SAFETY: `run_with` replaced levels that this processor lacks.
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => unsafe { run_avx2(robot, trials, options, probe) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 => unsafe { run_avx512(robot, trials, options, probe) },
        _ => run_group::<f32>(robot, trials, options, probe),
    }
}

/// # Safety
/// The processor must have AVX2.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn run_avx2<P: Probe>(
    robot: &Robot,
    trials: &[&Trial],
    options: &Options,
    probe: &mut P,
) -> Vec<Outcome> {
    run_group::<crate::lane::F32x8>(robot, trials, options, probe)
}

/// # Safety
/// The processor must have AVX-512F.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
unsafe fn run_avx512<P: Probe>(
    robot: &Robot,
    trials: &[&Trial],
    options: &Options,
    probe: &mut P,
) -> Vec<Outcome> {
    run_group::<crate::lane::F32x16>(robot, trials, options, probe)
}
