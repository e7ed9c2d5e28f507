//! The check of an uploaded gait before it is stored: the whole motion is simulated on the module, a few moves at a time.
//!
//! The gait starts from its own start pose and runs for [`DRY_RUN_S`] or its duration, whichever is shorter, at the
//! real cycle time, through the same swept pre-check that guards every move of a run. A longer run is guarded by the
//! pre-check of the run itself.

use control::cpg::{self, CpgState};
use control::gait::Gait;
use control::machine::{Angles, Machine};
use control::precheck::{Blocked, Verdict};

/// Longest stretch that is simulated, s: a trial of the paper.
pub const DRY_RUN_S: f32 = 30.0;
/// Moves per step of background work: bounds the time the thread is held (two moves of at most
/// `control::precheck::MAX_POSES_PER_MOVE` poses).
pub const MOVES_PER_STEP: usize = 2;

/// How far a check is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Progress {
    /// More to do.
    More,
    /// Every move keeps its distance.
    Clear,
    /// A move collides.
    Blocked(Blocked),
}

/// A check under way.
#[derive(Debug)]
pub struct DryRun {
    gait: Gait,
    state: CpgState,
    at: Option<Angles>,
    moves_left: u32,
}

impl DryRun {
    /// Begins the check of a gait with one oscillator per joint.
    #[must_use]
    pub fn new(gait: Gait) -> Self {
        let moves = gait.duration_s().min(DRY_RUN_S) / control::CYCLE_S;
        Self {
            state: cpg::start(&gait),
            at: None,
            moves_left: moves as u32 + 1,
            gait,
        }
    }

    /// Checks the next moves.
    pub fn advance(&mut self, machine: &Machine, margin_m: f32) -> Progress {
        for _ in 0..MOVES_PER_STEP {
            if self.moves_left == 0 {
                return Progress::Clear;
            }
            self.moves_left -= 1;
            let Some(next) = cpg::step(&self.gait, &mut self.state, control::CYCLE_S).angles()
            else {
                // A gait has at least one oscillator.
                return Progress::Clear;
            };
            if let Verdict::Blocked(blocked) =
                machine.swept(&self.at.unwrap_or(next), &next, margin_m)
            {
                return Progress::Blocked(blocked);
            }
            self.at = Some(next);
        }
        Progress::More
    }
}
