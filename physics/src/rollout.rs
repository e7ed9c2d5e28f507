//! Many trials, lane by lane.

use crate::drive::LaneDrive;
use crate::engine::{self, Command, LaneParams, Probe, Stage, State, Tree, Work};
use crate::lane::Lane;
use crate::params::Params;
use crate::robot::Robot;
use crate::trial::{CONTROL_RATE_HZ, NotFinite, Options, Outcome, Pose, Start, Trial};

/// A sum of speeds and height above this is taken for divergence, as NaN is.
const ABSURD: f64 = 1e6;
/// Below this clearance of the engine the pre-check's is asked for, m: more than its margin and what both may differ by.
const PRECHECK_BELOW_M: f64 = 0.005;
/// Guards sample instants against rounding of step times.
const SAMPLE_GUARD_S: f64 = 1e-6;

/// What one lane has gathered.
struct Record {
    outcome: Outcome,
    start: [f64; 2],
    end_step: u64,
    next_sample: u64,
    squares: f64,
    count: u64,
    /// Smallest clearance by the firmware's pre-check so far, m.
    clearance_m: f64,
    done: bool,
}

/// Runs up to `L::N` trials on one structure side by side.
#[inline(always)]
pub(crate) fn run_group<L: Lane>(
    robot: &Robot,
    trials: &[&Trial],
    options: &Options,
    probe: &mut impl Probe,
) -> Vec<Outcome> {
    let tree = Tree::new(robot);
    let params: Vec<&Params> = trials.iter().map(|t| &*t.params).collect();
    let (p, switches) = LaneParams::<L>::new(robot, &params, options.time_step_s, options.sweeps);
    let mut state = initial_state::<L>(robot, &tree, trials);
    let mut work = Work::<L>::new();
    let mut command = Command::<L>::hold();
    let mut drives: Vec<LaneDrive<'_>> =
        trials.iter().map(|t| LaneDrive::new(t, options)).collect();
    let mut records: Vec<Record> = trials
        .iter()
        .zip(&drives)
        .map(|(t, d)| Record::new(t, d.lead_steps, options))
        .collect();
    let last = records.iter().map(|r| r.end_step).max().unwrap_or(0);
    for step in 0..=last {
        observe(
            robot,
            options,
            step,
            &mut drives,
            &mut records,
            &mut state,
            &mut command,
        );
        if records.iter().all(|r| r.done) {
            break;
        }
        probe.ended(Stage::Control);
        engine::step(&tree, &p, &switches, &command, &mut state, &mut work, probe);
        check_finite(step, options, &state, &drives, &mut records);
        probe.ended(Stage::Integration);
    }
    records.into_iter().map(|r| r.outcome).collect()
}

/// Everything that happens between two steps: samples, statistics, the next command.
#[inline(never)]
fn observe<L: Lane>(
    robot: &Robot,
    options: &Options,
    step: u64,
    drives: &mut [LaneDrive<'_>],
    records: &mut [Record],
    state: &mut State<L>,
    command: &mut Command<L>,
) {
    for (lane, (drive, record)) in drives.iter_mut().zip(records).enumerate() {
        if record.done {
            continue;
        }
        if step == drive.lead_steps {
            record.start = [state.position.x.get(lane), state.position.y.get(lane)];
            // The move to the first pose counts for collisions, not for impacts and penetration.
            let clearance = state.clearance.get(lane);
            state.reset_statistics(lane);
            state.clearance.set(lane, clearance);
        }
        record.sample(robot, options, step, drive, lane, state);
        if drive.update(step, options, lane, state, command) {
            record.tick(robot, options, step, drive, lane, state);
        }
    }
}

impl Record {
    fn new(trial: &Trial, lead_steps: u64, options: &Options) -> Record {
        let steps = (trial.duration_s / options.time_step_s - SAMPLE_GUARD_S).ceil() as u64;
        let expected = (trial.duration_s * options.sample_rate_hz) as usize + 2;
        Record {
            outcome: Outcome {
                poses: Vec::with_capacity(expected),
                angles_rad: Vec::new(),
                encoders_rad: Vec::new(),
                torques_nm: Vec::new(),
                end_angles_rad: Vec::new(),
                end_speeds_rad_s: Vec::new(),
                distance_m: 0.0,
                speed_m_s: 0.0,
                collided_at_s: None,
                clearance_m: 1.0,
                impact_m_s: 0.0,
                peak_force_n: 0.0,
                penetration_m: (0.0, 0.0),
                tracking_rms_rad: 0.0,
                not_finite: None,
            },
            start: [0.0; 2],
            end_step: lead_steps + steps,
            next_sample: 0,
            squares: 0.0,
            count: 0,
            clearance_m: 1.0,
            done: false,
        }
    }

    fn sample<L: Lane>(
        &mut self,
        robot: &Robot,
        options: &Options,
        step: u64,
        drive: &LaneDrive<'_>,
        lane: usize,
        state: &State<L>,
    ) {
        if step < drive.lead_steps {
            return;
        }
        let time_s = drive.time_s(step, options.time_step_s);
        let end = step == self.end_step;
        let due = options.sample_rate_hz > 0.0
            && time_s + SAMPLE_GUARD_S >= self.next_sample as f64 / options.sample_rate_hz;
        let ends_only = options.sample_rate_hz <= 0.0 && (end || step == drive.lead_steps);
        if due || ends_only {
            self.next_sample += 1;
            self.outcome.poses.push(pose(state, lane));
            for joint in 0..robot.motors() {
                let body = robot.body_of_joint(joint);
                if options.record_angles {
                    self.outcome
                        .angles_rad
                        .push(state.angle[body].get(lane) as f32);
                }
                if options.record_motors {
                    self.outcome
                        .encoders_rad
                        .push(state.encoder[body].get(lane) as f32);
                    self.outcome
                        .torques_nm
                        .push(state.torque[body].get(lane) as f32);
                }
            }
        }
        if end {
            self.finish(robot, time_s, lane, state);
        }
    }

    /// Once per control tick: tracking error and collisions.
    fn tick<L: Lane>(
        &mut self,
        robot: &Robot,
        options: &Options,
        step: u64,
        drive: &LaneDrive<'_>,
        lane: usize,
        state: &State<L>,
    ) {
        for joint in 0..robot.motors() {
            let error =
                f64::from(drive.sent[joint]) - state.encoder[robot.body_of_joint(joint)].get(lane);
            self.squares += error * error;
            self.count += 1;
        }
        self.check_clearance(robot, lane, state);
        let clearance = self.clearance_m.min(state.clearance.get(lane));
        if self.outcome.collided_at_s.is_none() && clearance < 0.0 {
            let time_s = drive.time_s(step, options.time_step_s);
            self.outcome.collided_at_s = Some(time_s);
            if options.stop_on_collision {
                self.finish(robot, time_s.max(1.0 / CONTROL_RATE_HZ), lane, state);
            }
        }
    }

    /// Near cubes are looked at with the geometry of the firmware's pre-check, which is what a robot would stop by.
    fn check_clearance<L: Lane>(&mut self, robot: &Robot, lane: usize, state: &State<L>) {
        if state.gap.get(lane) > PRECHECK_BELOW_M || robot.motors() != 6 {
            return;
        }
        let angles = std::array::from_fn(|j| state.angle[robot.body_of_joint(j)].get(lane) as f32);
        if let Some(clearance) = robot.precheck_clearance_m(&angles) {
            self.clearance_m = self.clearance_m.min(clearance);
        }
    }

    fn finish<L: Lane>(&mut self, robot: &Robot, time_s: f64, lane: usize, state: &State<L>) {
        let dx = state.position.x.get(lane) - self.start[0];
        let dy = state.position.y.get(lane) - self.start[1];
        let out = &mut self.outcome;
        out.end_angles_rad = (0..robot.joints())
            .map(|joint| state.angle[robot.body_of_joint(joint)].get(lane) as f32)
            .collect();
        out.end_speeds_rad_s = (0..robot.joints())
            .map(|joint| state.speed[robot.body_of_joint(joint)].get(lane) as f32)
            .collect();
        out.distance_m = (dx * dx + dy * dy).sqrt();
        out.speed_m_s = out.distance_m / time_s;
        out.clearance_m = self.clearance_m.min(state.clearance.get(lane));
        if out.collided_at_s.is_none() && out.clearance_m < 0.0 {
            out.collided_at_s = Some(time_s);
        }
        out.impact_m_s = state.impact.get(lane);
        out.peak_force_n = state.peak_force.get(lane);
        let count = state.depth_count.get(lane).max(1.0);
        out.penetration_m = (state.depth_sum.get(lane) / count, state.depth_max.get(lane));
        out.tracking_rms_rad = (self.squares / (self.count.max(1) as f64)).sqrt();
        self.done = true;
    }
}

fn pose<L: Lane>(state: &State<L>, lane: usize) -> Pose {
    let at = |x: L| x.get(lane) as f32;
    Pose {
        position_m: [
            at(state.position.x),
            at(state.position.y),
            at(state.position.z),
        ],
        quaternion: state.quaternion.map(at),
    }
}

/// Marks lanes whose numbers stopped being numbers.
#[inline(always)]
fn check_finite<L: Lane>(
    step: u64,
    options: &Options,
    state: &State<L>,
    drives: &[LaneDrive<'_>],
    records: &mut [Record],
) {
    use crate::lane::Mask;
    let mut sum = state.position.z + state.linear.x + state.linear.y + state.linear.z;
    sum += state.angular.x + state.angular.y + state.angular.z;
    for speed in &state.speed {
        sum += *speed;
    }
    let bad = sum.abs().lt(L::splat(ABSURD)).not();
    if bad.any() {
        mark_bad(step, options, L::one().only(bad), drives, records);
    }
}

#[inline(never)]
fn mark_bad<L: Lane>(
    step: u64,
    options: &Options,
    bad: L,
    drives: &[LaneDrive<'_>],
    records: &mut [Record],
) {
    for (lane, (drive, record)) in drives.iter().zip(records).enumerate() {
        if bad.get(lane) > 0.0 && record.outcome.not_finite.is_none() {
            let time_s = drive.time_s(step, options.time_step_s);
            record.outcome.not_finite = Some(NotFinite { step, time_s });
        }
    }
}

/// The state at the beginning of every lane; unused lanes repeat the last trial.
fn initial_state<L: Lane>(robot: &Robot, tree: &Tree, trials: &[&Trial]) -> State<L> {
    let mut state: State<L> = State::at_rest();
    for lane in 0..L::N {
        let trial = trials[lane.min(trials.len() - 1)];
        match &trial.start {
            Start::Home | Start::HomeAtOnce => state.position.z.set(lane, tree.home_height_m),
            Start::State {
                base,
                twist,
                angles_rad,
                speeds_rad_s,
            } => {
                let set = |v: &mut crate::linear::V3<L>, x: [f32; 3]| {
                    v.x.set(lane, f64::from(x[0]));
                    v.y.set(lane, f64::from(x[1]));
                    v.z.set(lane, f64::from(x[2]));
                };
                set(&mut state.position, base.position_m);
                set(&mut state.linear, twist.linear_m_s);
                set(&mut state.angular, twist.angular_rad_s);
                for (slot, q) in state.quaternion.iter_mut().zip(base.quaternion) {
                    slot.set(lane, f64::from(q));
                }
                for (joint, (angle, speed)) in angles_rad.iter().zip(speeds_rad_s).enumerate() {
                    let body = robot.body_of_joint(joint);
                    state.angle[body].set(lane, f64::from(*angle));
                    state.speed[body].set(lane, f64::from(*speed));
                    // A connector has no motor that turned: its spring rests at zero.
                    if joint < robot.motors() {
                        state.encoder[body].set(lane, f64::from(*angle));
                    }
                }
            }
        }
    }
    state
}
