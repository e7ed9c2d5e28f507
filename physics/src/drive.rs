//! What one lane's joints are asked to do, tick by tick.

use crate::engine::{Command, State};
use crate::lane::Lane;
use crate::noise::normal_pair;
use crate::robot::MAX_JOINTS;
use crate::trial::{CONTROL_RATE_HZ, Drive, Options, Start, Trial};
use control::cpg::{self, CpgState};

/// Guards `floor` of a time by its period against rounding.
const TICK_GUARD: f64 = 1e-6;
/// Ticks a set-point can be late by (5 s at 40 Hz, the largest `latency.delay_s` and `clock_skew.ratio`), and the present one.
const HISTORY: usize = 201;

/// State of one lane's drive.
pub(crate) struct LaneDrive<'a> {
    trial: &'a Trial,
    motors: usize,
    cpg: Option<CpgState>,
    /// Next control tick, counted from t = 0.
    tick: u32,
    /// Steps before t = 0.
    pub lead_steps: u64,
    /// Set-points as sent, rad.
    pub sent: [f32; MAX_JOINTS],
    /// Offsets that the lead-in moves to.
    first: [f32; MAX_JOINTS],
    /// Sent set-points by tick, newest at `tick % HISTORY`; only kept when some joint's set-points are late.
    history: Vec<[f32; MAX_JOINTS]>,
}

impl<'a> LaneDrive<'a> {
    pub(crate) fn new(trial: &'a Trial, options: &Options) -> Self {
        let mut first = [0.0; MAX_JOINTS];
        let motors = trial.params.robot.motors();
        let mut state = None;
        match &trial.drive {
            Drive::Gait { gait, .. } => {
                let started = cpg::start(gait);
                for (slot, o) in first.iter_mut().zip(gait.oscillators()) {
                    *slot = o.offset_rad;
                }
                state = Some(started);
            }
            Drive::SetPoints { values_rad, .. }
            | Drive::LinkAngles { values_rad, .. }
            | Drive::EncoderAngles { values_rad, .. } => {
                first[..motors].copy_from_slice(&values_rad[..motors]);
            }
        }
        let mut lead_steps = 0;
        if trial.start == Start::Home {
            let largest = first.iter().fold(0.0f32, |a, x| a.max(x.abs()));
            let ticks = (f64::from(largest) / options.approach_rad_s * CONTROL_RATE_HZ).ceil();
            let lead_s = ticks / CONTROL_RATE_HZ + options.settle_s;
            lead_steps = (lead_s / options.time_step_s).ceil() as u64;
        }
        let late = trial.params.joints.iter().any(|j| j.command_delay_s > 0.0);
        LaneDrive {
            trial,
            motors,
            cpg: state,
            tick: 0,
            lead_steps,
            sent: [0.0; MAX_JOINTS],
            first,
            history: if late {
                vec![first; HISTORY]
            } else {
                Vec::new()
            },
        }
    }

    /// Time from t = 0 at the start of a step.
    pub(crate) fn time_s(&self, step: u64, h: f64) -> f64 {
        (step as f64 - self.lead_steps as f64) * h
    }

    /// Updates this lane of the command for the step that begins now. Returns whether a control tick passed.
    pub(crate) fn update<L: Lane>(
        &mut self,
        step: u64,
        options: &Options,
        lane: usize,
        state: &State<L>,
        command: &mut Command<L>,
    ) -> bool {
        let h = options.time_step_s;
        let time_s = self.time_s(step, h);
        let motors = self.motors;
        if step < self.lead_steps {
            let lead_s = step as f64 * h;
            for joint in 0..motors {
                let x = f64::from(self.first[joint]);
                let reach = options.approach_rad_s * lead_s;
                self.sent[joint] = x.clamp(-reach, reach) as f32;
            }
            self.apply(time_s, lane, command);
            return false;
        }
        if let Drive::LinkAngles {
            period_s,
            values_rad,
        }
        | Drive::EncoderAngles {
            period_s,
            values_rad,
        } = &self.trial.drive
        {
            let robot = &self.trial.params.robot;
            let hangs = matches!(self.trial.drive, Drive::EncoderAngles { .. });
            if step == self.lead_steps {
                lead(robot, motors, hangs, lane, command);
            }
            let from = if hangs { &state.encoder } else { &state.angle };
            let wanted = at(motors, *period_s, values_rad, time_s + h);
            for (joint, wanted) in wanted.enumerate() {
                let body = robot.body_of_joint(joint);
                command.speed[body].set(lane, (wanted - from[body].get(lane)) / h);
            }
        }
        let tick_time_s = f64::from(self.tick) / self.tick_rate_hz();
        let ticked = time_s + TICK_GUARD >= tick_time_s;
        if ticked {
            self.next_tick(motors);
        }
        // Late set-points arrive between ticks too.
        if ticked || !self.history.is_empty() {
            self.apply(time_s, lane, command);
        }
        ticked
    }

    /// Control ticks in a true second: the robot counts them by its own clock.
    fn tick_rate_hz(&self) -> f64 {
        CONTROL_RATE_HZ * self.trial.params.clock_ratio
    }

    fn next_tick(&mut self, motors: usize) {
        // By the robot's clock.
        let time_s = f64::from(self.tick) / CONTROL_RATE_HZ;
        match &self.trial.drive {
            Drive::Gait {
                gait,
                noise_rad,
                seed,
            } => {
                if let Some(state) = &mut self.cpg {
                    let out = cpg::step(gait, state, (1.0 / CONTROL_RATE_HZ) as f32);
                    for (slot, x) in self.sent.iter_mut().zip(out.as_slice()) {
                        *slot = *x;
                    }
                }
                if *noise_rad > 0.0 {
                    for pair in 0..motors.div_ceil(2) {
                        let noise = normal_pair(*seed, self.tick, pair as u32);
                        for (slot, x) in self.sent[2 * pair..motors.min(2 * pair + 2)]
                            .iter_mut()
                            .zip(noise)
                        {
                            *slot += (*noise_rad as f32) * x;
                        }
                    }
                }
            }
            Drive::SetPoints {
                period_s,
                values_rad,
            }
            | Drive::LinkAngles {
                period_s,
                values_rad,
            }
            | Drive::EncoderAngles {
                period_s,
                values_rad,
            } => {
                let last = values_rad.len() / motors - 1;
                let at = ((time_s / period_s + TICK_GUARD) as usize).min(last);
                self.sent[..motors].copy_from_slice(&values_rad[at * motors..(at + 1) * motors]);
            }
        }
        if !self.history.is_empty() {
            self.history[self.tick as usize % HISTORY] = self.sent;
        }
        self.tick += 1;
    }

    /// Passes the sent set-points through latency, conventions and quantisation into the command.
    fn apply<L: Lane>(&self, time_s: f64, lane: usize, command: &mut Command<L>) {
        let robot = &self.trial.params.robot;
        for joint in 0..robot.motors() {
            let j = &self.trial.params.joints[joint];
            let mut x = f64::from(self.sent[joint]);
            if j.command_delay_s > 0.0 && !self.history.is_empty() && self.tick > 0 {
                x = self.arrived(joint, time_s - j.command_delay_s);
            }
            if j.command_ratio != 1.0 || j.command_offset_rad != 0.0 {
                x = x * j.command_ratio + j.command_offset_rad;
            }
            if j.command_step_rad > 0.0 {
                x = (x / j.command_step_rad).round() * j.command_step_rad;
            }
            command.set_point[robot.body_of_joint(joint)].set(lane, x);
        }
    }

    /// The newest set-point that was sent at `time_s` or before.
    fn arrived(&self, joint: usize, time_s: f64) -> f64 {
        let ticks = (time_s + TICK_GUARD) * self.tick_rate_hz();
        if ticks < 0.0 {
            return f64::from(self.first[joint]);
        }
        f64::from(self.history[ticks as usize % HISTORY][joint])
    }
}

/// The joints follow speeds, the links' or, where links `hang` on their motors, the encoders'.
fn lead<L: Lane>(
    robot: &crate::robot::Robot,
    motors: usize,
    hangs: bool,
    lane: usize,
    command: &mut Command<L>,
) {
    for body in (0..motors).map(|joint| robot.body_of_joint(joint)) {
        command.speed_given[body].set(lane, 1.0);
        command.hangs[body].set(lane, f64::from(u8::from(hangs)));
        // Whatever it takes: a million times the motor's torque.
        command.limit_factor[body].set(lane, 1e6);
    }
}

/// Recorded angles at `time_s` by joint.
fn at(
    motors: usize,
    period_s: f64,
    values_rad: &[f32],
    time_s: f64,
) -> impl Iterator<Item = f64> + '_ {
    let last = values_rad.len() / motors - 1;
    let place = (time_s / period_s).clamp(0.0, last as f64);
    let at = (place as usize).min(last.saturating_sub(1));
    let share = place - at as f64;
    let row = |i: usize| &values_rad[i * motors..(i + 1) * motors];
    let pairs = row(at).iter().zip(row((at + 1).min(last)));
    pairs.map(move |(x0, x1)| {
        let [x0, x1] = [x0, x1].map(|x| f64::from(*x));
        x0 + (x1 - x0) * share
    })
}
