//! What leaves for the motors this cycle: approach, gait, hold and ramp, every move certified one look-ahead before it is made.
//!
//! The planner keeps a queue of future set-points. A second copy of the oscillators runs ahead and each cycle adds one set-point to the
//! end of the queue, after the move towards it has been checked; the first entry leaves for the motors. So at any time the
//! next [`MotionSettings::lookahead_cycles`] moves are certified, each was checked once, and the work per cycle is constant.
//!
//! ```text
//!            applied      queue: certified moves, 1 s                      tail
//!   ───●────────●──────○──────○──────○── … ──○──────○── check ──▶ ○ next set-point of the oscillators that run ahead
//!               │ now                                  │ blocked: every queued set-point becomes the applied one (hold at once);
//!                                                      ▼ the next move planned leaves the held pose when the blocked moment has passed
//! ```
//!
//! * **Hold.** A blocked move holds all joints together at the pose applied now. Oscillator time runs on. The move out of the hold
//!   goes towards the oscillators' set-point at no more than the joints' no-load speed and is checked like any other.
//! * **Measured pose.** When a fresh measurement is at hand, the move from it to the next set-point is checked too, so that a robot which
//!   lags or was pushed is not driven through itself.
//! * **Change of gait.** A new gait takes effect at the end of the queue, one look-ahead later; nothing is recomputed.
//! * **Stop.** Amplitudes go to zero from the present state; each move is checked before it is made, with as much look-ahead as time
//!   allows, and a blocked one ends the ramp where it is.
//! * **Fail closed.** A set-point that is not finite, out of range or too fast does not leave; the last one stays.

pub use crate::motion_types::{
    BadSetPoint, BeginError, CycleOutput, MAX_LOOKAHEAD, MotionParams, MotionSettings,
    RetargetError, SettingsError,
};

use crate::CYCLE_S;
use crate::cpg::{self, CpgState};
use crate::gait::Gait;
use crate::machine::Angles;
use crate::math;
use crate::precheck::{Blocked, Verdict};
use crate::supervisor::Motion;
use heapless::Deque;

/// Set-points stay within this angle of the home pose, rad: four turns, within the drivers' multi-turn range.
pub const POSITION_LIMIT_RAD: f32 = 25.2;
/// The ramp has ended when every amplitude is below this, rad (0.06 deg, below backlash).
pub const SETTLED_RAD: f32 = 1e-3;
/// Moves checked per cycle while the queue fills.
const CHECKS_PER_CYCLE: u8 = 2;

/// Where in the course of a run the planner is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Approach { blocked: bool },
    Run,
    Ramp { ended: bool },
}

/// A certified future set-point.
#[derive(Clone, Copy, Debug)]
struct Planned {
    q_rad: Angles,
    /// Part of the gait (of the approach otherwise).
    gait: bool,
    held: bool,
}

type Measured<'a> = Option<&'a Angles>;
type Found = Option<Blocked>;

/// State of a motion from the start order to rest. Parameters are a separate type, [`MotionParams`].
#[derive(Clone, Debug)]
pub struct Planner {
    phase: Phase,
    queue: Deque<Planned, MAX_LOOKAHEAD>,
    /// Oscillators at the instant of the next set-point, and the gait that governs them.
    now: CpgState,
    gait: Gait,
    /// Oscillators at the end of the queue, and the gait that governs those.
    ahead: CpgState,
    gait_ahead: Gait,
    /// Set-points until `gait_ahead` governs `now`; 0: it does.
    switch_in: u8,
    applied_rad: Angles,
    tail_rad: Angles,
    held: bool,
    held_cycles: u32,
    holds: u32,
}

impl Planner {
    /// Starts the approach from `pose_rad`: the measured pose when fresh, else the set-point applied last.
    ///
    /// # Errors
    /// [`BeginError`] when the gait does not fit the robot or the pose is out of range.
    pub fn begin(
        params: &MotionParams,
        gait: &Gait,
        pose_rad: &Angles,
    ) -> Result<Self, BeginError> {
        let machine = params.machine();
        gait.check_speed(machine.limits())
            .map_err(BeginError::Mismatch)?;
        if pose_rad.len() != machine.limits().len() {
            return Err(BeginError::PoseCount {
                angles: pose_rad.len() as u8,
                joints: machine.joints(),
            });
        }
        for (k, q) in pose_rad.iter().enumerate() {
            if !in_limits(*q) {
                return Err(BeginError::Pose {
                    joint: k as u8,
                    value_rad: *q,
                });
            }
        }
        let now = cpg::start(gait);
        Ok(Planner {
            phase: Phase::Approach { blocked: false },
            queue: Deque::new(),
            ahead: now.clone(),
            now,
            gait: gait.clone(),
            gait_ahead: gait.clone(),
            switch_in: 0,
            applied_rad: *pose_rad,
            tail_rad: *pose_rad,
            held: false,
            held_cycles: 0,
            holds: 0,
        })
    }

    /// The set-points sent last, rad.
    #[must_use]
    pub const fn applied_rad(&self) -> &Angles {
        &self.applied_rad
    }

    /// The gait that governs the present set-points.
    #[must_use]
    pub const fn gait(&self) -> &Gait {
        &self.gait
    }

    /// Cycles in which the pre-check held the robot.
    #[must_use]
    pub const fn held_cycles(&self) -> u32 {
        self.held_cycles
    }

    /// Times the pre-check began to hold the robot.
    #[must_use]
    pub const fn holds(&self) -> u32 {
        self.holds
    }

    /// Lets another gait take over, one look-ahead from now. Amplitudes and offsets pass to its values at its rate `a`.
    ///
    /// # Errors
    /// [`RetargetError`]; the running gait goes on.
    pub fn retarget(&mut self, params: &MotionParams, gait: &Gait) -> Result<(), RetargetError> {
        gait.check_speed(params.machine().limits())
            .map_err(RetargetError::Mismatch)?;
        if self.switch_in != 0 {
            return Err(RetargetError::ChangePending);
        }
        self.gait_ahead = gait.clone();
        self.switch_in = self.queue.iter().filter(|p| p.gait).count() as u8;
        if self.switch_in == 0 {
            self.gait = gait.clone();
        }
        Ok(())
    }

    /// One control cycle under the supervisor's `motion`; `measured_rad` is the measured pose if it is fresh.
    ///
    /// With [`Motion::Hold`] and [`Motion::None`] the last set-point is repeated.
    ///
    /// # Errors
    /// [`BadSetPoint`] when the next set-point fails the last check. It is not sent; the last one stays in force.
    pub fn cycle(
        &mut self,
        params: &MotionParams,
        motion: Motion,
        measured_rad: Option<&Angles>,
    ) -> Result<CycleOutput, BadSetPoint> {
        let gait_rad = self.gait_rad();
        let mut blocked = None;
        match motion {
            Motion::Approach => self.cycle_approach(params, measured_rad, &mut blocked)?,
            Motion::Run => self.cycle_run(params, measured_rad, &mut blocked)?,
            Motion::Ramp => self.cycle_ramp(params, measured_rad, &mut blocked)?,
            Motion::Hold | Motion::None => {}
        }
        Ok(CycleOutput {
            gait_rad,
            ..self.output(params, blocked)
        })
    }

    fn cycle_approach(
        &mut self,
        params: &MotionParams,
        measured: Measured<'_>,
        out: &mut Found,
    ) -> Result<(), BadSetPoint> {
        self.fill(params, out);
        let on_the_way = self.queue.front().is_some_and(|p| !p.gait);
        if on_the_way && self.full(params) && self.phase == (Phase::Approach { blocked: false }) {
            self.send_next(params, measured, out)?;
        }
        Ok(())
    }

    fn cycle_run(
        &mut self,
        params: &MotionParams,
        measured: Measured<'_>,
        out: &mut Found,
    ) -> Result<(), BadSetPoint> {
        if matches!(self.phase, Phase::Approach { .. }) {
            if !self.in_position(params) {
                return self.cycle_approach(params, measured, out);
            }
            self.phase = Phase::Run;
        }
        self.fill(params, out);
        if self.phase == Phase::Run && self.full(params) {
            self.send_next(params, measured, out)?;
        }
        Ok(())
    }

    fn cycle_ramp(
        &mut self,
        params: &MotionParams,
        measured: Measured<'_>,
        out: &mut Found,
    ) -> Result<(), BadSetPoint> {
        if !matches!(self.phase, Phase::Ramp { .. }) {
            self.begin_ramp();
        }
        self.fill(params, out);
        if self.phase == (Phase::Ramp { ended: false }) {
            self.send_next(params, measured, out)?;
        }
        Ok(())
    }

    /// The set-point is the start pose and the first look-ahead of the run is certified.
    fn in_position(&self, params: &MotionParams) -> bool {
        let at_start = self.queue.front().is_some_and(|p| p.gait);
        self.phase == (Phase::Approach { blocked: false }) && at_start && self.full(params)
    }

    fn output(&self, params: &MotionParams, blocked: Option<Blocked>) -> CycleOutput {
        CycleOutput {
            set_point_rad: self.applied_rad,
            gait_rad: self.gait_rad(),
            held: self.held,
            blocked,
            in_position: self.in_position(params),
            approach_blocked: self.phase == Phase::Approach { blocked: true },
            settled: match self.phase {
                Phase::Ramp { ended } => ended || self.at_rest(),
                _ => false,
            },
        }
    }

    fn gait_rad(&self) -> Angles {
        self.now.set_points().angles().unwrap_or(self.applied_rad)
    }

    fn at_rest(&self) -> bool {
        self.now
            .oscillators()
            .iter()
            .all(|o| o.amplitude_rad.abs() <= SETTLED_RAD)
    }

    fn full(&self, params: &MotionParams) -> bool {
        self.queue.len() >= usize::from(params.settings().lookahead_cycles)
    }

    fn begin_ramp(&mut self) {
        self.queue.clear();
        self.ahead = self.now.clone();
        self.gait_ahead = self.gait.clone();
        self.switch_in = 0;
        self.tail_rad = self.applied_rad;
        // Out of a hold, or before t = 0, there is no motion to bring to rest.
        let moving = self.phase == Phase::Run && !self.held;
        self.phase = Phase::Ramp { ended: !moving };
    }

    /// Extends the queue by checked moves: at most two per cycle, one when it is full but for the entry that leaves.
    fn fill(&mut self, params: &MotionParams, blocked: &mut Found) {
        for _ in 0..CHECKS_PER_CYCLE {
            let ended = matches!(
                self.phase,
                Phase::Approach { blocked: true } | Phase::Ramp { ended: true }
            );
            if ended || self.full(params) {
                return;
            }
            self.extend(params, blocked);
        }
    }

    fn extend(&mut self, params: &MotionParams, blocked: &mut Found) {
        let (next, gait) = self.next_rad(params);
        let verdict = if next == self.tail_rad {
            Verdict::Clear { clearance_m: 0.0 }
        } else {
            let margins = params.settings().planned;
            params.machine().check_move(&self.tail_rad, &next, margins)
        };
        match verdict {
            Verdict::Clear { .. } => {
                let held =
                    gait && next == self.tail_rad && self.queue.back().is_some_and(|p| p.held);
                self.push(Planned {
                    q_rad: next,
                    gait,
                    held,
                });
            }
            Verdict::Blocked(b) => {
                let ahead_s = self.queue.len() as f32 * CYCLE_S;
                *blocked = Some(Blocked {
                    at_s: b.at_s + ahead_s,
                    ..b
                });
                self.hold(gait);
            }
        }
    }

    /// The set-point one cycle behind the end of the queue, rate-limited, and whether it belongs to the gait.
    fn next_rad(&mut self, params: &MotionParams) -> (Angles, bool) {
        let target = self.ahead.set_points().angles().unwrap_or(self.tail_rad);
        let approaching = matches!(self.phase, Phase::Approach { .. })
            && !self.queue.back().is_some_and(|p| p.gait);
        if approaching && self.tail_rad != target {
            return (
                limited(
                    &self.tail_rad,
                    &target,
                    &params.steps_rad(params.settings().approach_ratio),
                ),
                false,
            );
        }
        let scale = if matches!(self.phase, Phase::Ramp { .. }) {
            0.0
        } else {
            1.0
        };
        cpg::advance(&self.gait_ahead, &mut self.ahead, CYCLE_S, scale);
        (
            limited(&self.tail_rad, &target, &params.steps_rad(1.0)),
            true,
        )
    }

    fn push(&mut self, planned: Planned) {
        self.tail_rad = planned.q_rad;
        let _ = self.queue.push_back(planned);
    }

    /// The move behind the queue is blocked: hold from the present pose (from the start pose before t = 0).
    fn hold(&mut self, gait: bool) {
        match self.phase {
            Phase::Approach { .. } if !gait => self.phase = Phase::Approach { blocked: true },
            Phase::Ramp { .. } => self.phase = Phase::Ramp { ended: true },
            Phase::Approach { .. } | Phase::Run => {
                let before_start = self.queue.iter().rev().find(|p| !p.gait).map(|p| p.q_rad);
                let held_rad = before_start.unwrap_or(self.applied_rad);
                for p in self.queue.iter_mut().filter(|p| p.gait) {
                    *p = Planned {
                        q_rad: held_rad,
                        gait: true,
                        held: true,
                    };
                }
                self.push(Planned {
                    q_rad: held_rad,
                    gait: true,
                    held: true,
                });
            }
        }
    }

    /// Sends the first set-point of the queue, unless the way to it from the measured pose is blocked.
    fn send_next(
        &mut self,
        params: &MotionParams,
        measured_rad: Measured<'_>,
        blocked: &mut Found,
    ) -> Result<(), BadSetPoint> {
        let Some(next) = self.queue.front().map(|p| p.q_rad) else {
            return Ok(());
        };
        if let Some(measured) = measured_rad
            && next != self.applied_rad
            && let Verdict::Blocked(b) =
                params
                    .machine()
                    .check_move(measured, &next, params.settings().measured)
        {
            *blocked = Some(b);
            self.hold_here();
            if self.phase != Phase::Run {
                return Ok(());
            }
        }
        let Some(first) = self.queue.pop_front() else {
            return Ok(());
        };
        self.note_hold(first.held);
        if first.gait {
            self.advance_now();
        }
        check_set_point(&self.applied_rad, &first.q_rad, &params.steps_rad(1.0))?;
        self.applied_rad = first.q_rad;
        Ok(())
    }

    /// Freezes the whole queue at the present pose.
    fn hold_here(&mut self) {
        match self.phase {
            Phase::Approach { .. } => self.phase = Phase::Approach { blocked: true },
            Phase::Ramp { .. } => self.phase = Phase::Ramp { ended: true },
            Phase::Run => {
                for p in self.queue.iter_mut() {
                    *p = Planned {
                        q_rad: self.applied_rad,
                        gait: true,
                        held: true,
                    };
                }
                self.tail_rad = self.applied_rad;
            }
        }
    }

    fn advance_now(&mut self) {
        let scale = if matches!(self.phase, Phase::Ramp { .. }) {
            0.0
        } else {
            1.0
        };
        cpg::advance(&self.gait, &mut self.now, CYCLE_S, scale);
        if self.switch_in > 0 {
            self.switch_in -= 1;
            if self.switch_in == 0 {
                self.gait = self.gait_ahead.clone();
            }
        }
    }

    fn note_hold(&mut self, held: bool) {
        if held {
            self.held_cycles = self.held_cycles.saturating_add(1);
            if !self.held {
                self.holds = self.holds.saturating_add(1);
            }
        }
        self.held = held;
    }
}

fn in_limits(q_rad: f32) -> bool {
    q_rad.abs() <= POSITION_LIMIT_RAD
}

/// The target itself where it is within reach, else one step towards it.
fn limited(from: &Angles, target: &Angles, steps: &Angles) -> Angles {
    let mut next = *target;
    for ((n, f), step) in next.iter_mut().zip(from.iter()).zip(steps.iter()) {
        let change = *n - *f;
        if change > *step {
            *n = *f + *step;
        } else if change < -*step {
            *n = *f - *step;
        }
    }
    next
}

/// The last check: finite, in range, no faster than the joint turns (but for rounding).
fn check_set_point(from: &Angles, to: &Angles, steps: &Angles) -> Result<(), BadSetPoint> {
    for (k, ((f, t), step)) in from.iter().zip(to.iter()).zip(steps.iter()).enumerate() {
        let slow = (*t - *f).abs() <= *step + 1e-5;
        if !(slow && in_limits(*t)) {
            return Err(BadSetPoint {
                joint: k as u8,
                value_rad: *t,
                previous_rad: *f,
            });
        }
    }
    Ok(())
}

// The planner holds two copies of the oscillators and of the gait; both are bounded.
const _: () = assert!(core::mem::size_of::<Planner>() < 4096);
// A step per cycle below half a turn keeps "the straight move" unambiguous.
const _: () = assert!(crate::robot::INTRA_NO_LOAD_RAD_S * CYCLE_S < math::PI);
