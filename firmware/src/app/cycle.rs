//! The decision of a cycle: what the readings mean, what the supervisor says, what may leave for the motors.

use super::core::{Core, HEARTBEATS, LINK_SILENT_US, LOW_READINGS, STOP_MV};
use super::motors::{Finding, Motor};
use super::packets::{FIRST_ID, collect};
use super::run::Run;
use super::timing::{STOP_AFTER, Slot};
use super::types::{BoardInputs, Values};
use control::motion::{CycleOutput, Planner};
use control::supervisor::{Event as SupervisorEvent, Fault, Motion, State};
use protocol::bus::PackedFeedback;
use protocol::link::telemetry::flags;
use protocol::link::{EventKind, MotorSample, RunEnd, Sample, TelemetryRate};

impl Core {
    /// Takes what the board reads. `due_us` is the instant on the grid: times of runs count on it.
    pub(crate) fn begin_cycle(&mut self, due_us: u64, inputs: BoardInputs) -> Slot {
        (self.now_us, self.cycle_us) = (due_us, due_us);
        self.inputs = inputs;
        let slot = self.timing.begin(due_us);
        self.change_robot();
        for motor in self.motors.iter_mut() {
            motor.begin_slot();
        }
        if inputs.stop_pressed != self.out.stop_input {
            self.out.stop_input = inputs.stop_pressed;
            if inputs.stop_pressed {
                self.event(EventKind::Stop { input: true });
            }
            // The STOP input is never refused.
            let _ = self.supervise(SupervisorEvent::StopInput {
                pressed: inputs.stop_pressed,
            });
        }
        if slot == Slot::Control {
            self.counts.cycles = self.counts.cycles.saturating_add(1);
            self.block_due = false;
            self.events.tick(due_us);
            self.watch_battery();
            self.watch_link();
        }
        slot
    }

    /// Goes over to the robot and the profile of the settings, between two exchanges. Its drivers have no zero yet.
    fn change_robot(&mut self) {
        let profile = self.settings.drivers;
        let machine = self.settings.machine.unwrap_or(self.built_as);
        let other_drivers = self.motors.info().profile != profile;
        let other_robot = *self.motion.machine() != machine;
        if !other_drivers && !other_robot {
            return;
        }
        let homed = self.supervisor.homed_mask();
        for joint in (0..self.motors.joints()).filter(|joint| homed >> joint & 1 != 0) {
            // A driver reset is never refused.
            let _ = self.supervise(SupervisorEvent::DriverReset { joint });
        }
        self.be(machine);
        if other_drivers {
            self.event(EventKind::DriversChanged { profile });
        }
        if other_robot {
            let (joints, contact) = (machine.joints(), machine.contact().into());
            self.event(EventKind::RobotChanged { joints, contact });
        }
    }

    fn watch_battery(&mut self) {
        let low = self
            .inputs
            .battery_mv
            .filter(|battery_mv| *battery_mv < STOP_MV);
        self.low_readings = low.map_or(0, |_| self.low_readings.saturating_add(1));
        if let Some(battery_mv) = low
            && self.low_readings == LOW_READINGS
        {
            self.event(EventKind::BatteryLow { battery_mv });
            self.fault_in_motion(Fault::LowBattery);
        }
    }

    fn watch_link(&mut self) {
        let Some(run) = self.run.as_ref() else { return };
        let Some(session) = self.sessions.get_mut(run.link) else {
            return;
        };
        // Only a host that keeps in touch can fall silent: many start a run and just listen.
        let quiet_us = self.now_us.saturating_sub(session.heard_us);
        if session.beats >= HEARTBEATS && !session.silent && quiet_us > LINK_SILENT_US {
            session.silent = true;
            self.void_challenges = true;
            self.event(EventKind::LinkSilent);
        }
    }

    /// Takes one reading. True when the driver's error register is to be read.
    pub(crate) fn absorb(
        &mut self,
        joint: usize,
        feedback: PackedFeedback,
        latched_us: u64,
    ) -> bool {
        let limits = self.motion.machine().limits().get(joint);
        let (Some(motor), Some(limits)) = (self.motors.get_mut(joint), limits) else {
            return false;
        };
        let findings = motor.absorb(limits, feedback, latched_us);
        let tripped = motor.watchdog_tripped();
        // Joints are 0..12.
        let joint = joint as u8;
        let mut ask = false;
        for finding in findings {
            match finding {
                Finding::Found => self.event(EventKind::MotorFound { joint }),
                Finding::Lost => {}
                Finding::Reset => {
                    self.event(EventKind::MotorReset { joint });
                    // A driver reset is never refused.
                    let _ = self.supervise(SupervisorEvent::DriverReset { joint });
                }
                Finding::HardwareError => ask = true,
                Finding::Jump => self.distrust(joint, Fault::EncoderJump { joint }),
                Finding::WrongSetPoint {
                    sent_urad,
                    applied_urad,
                    certain,
                } => {
                    self.event(EventKind::SetpointMismatch {
                        joint,
                        sent_urad,
                        applied_urad,
                    });
                    if certain {
                        self.fault_in_motion(Fault::EchoMismatch { joint });
                    }
                }
                Finding::Stall => self.fault_in_motion(Fault::Stall { joint }),
            }
        }
        if tripped
            && matches!(
                self.supervisor.state(),
                State::Run { .. } | State::Stopping { .. }
            )
        {
            self.fault_in_motion(Fault::DriverLost { joint });
        }
        ask
    }

    /// An encoder that jumped has lost its zero, moving or not.
    fn distrust(&mut self, joint: u8, fault: Fault) {
        self.fault_in_motion(fault);
        let homed = self.supervisor.homed_mask() >> joint & 1 != 0;
        if homed {
            let _ = self.supervise(SupervisorEvent::DriverReset { joint });
        }
    }

    /// A driver's error register was read (0: it did not say).
    pub(crate) fn hardware_error(&mut self, joint: usize, bits: u8) {
        let joint = joint as u8;
        self.event(EventKind::MotorError { joint, bits });
        self.fault_in_motion(Fault::DriverError { joint, bits });
    }

    /// Ends the readings of a control cycle and decides what leaves.
    ///
    /// All of it happens at the instant on the grid: bytes of a host that came while the drivers were read move neither the end of a run nor the time of a
    /// sample.
    ///
    /// `fresh`: a set-point that leaves now rests on readings of this cycle. Between here and the set-points no packet leaves in a cycle that has any.
    pub(crate) fn decide(&mut self, fresh: bool) {
        let handled_us = core::mem::replace(&mut self.now_us, self.cycle_us);
        self.decide_now(fresh);
        self.now_us = handled_us.max(self.now_us);
    }

    fn decide_now(&mut self, fresh: bool) {
        self.count_missing();
        self.take_sample(Slot::Control);
        self.check_torque();
        let in_position = self
            .run
            .as_mut()
            .is_some_and(|run| core::mem::take(&mut run.in_position));
        // Events of the cycle itself are never refused.
        let _ = self.supervise(SupervisorEvent::Tick);
        if in_position {
            let before = self.state();
            let _ = self.supervise(SupervisorEvent::InPosition);
            if self.state() != before
                && let Some(run) = self.run.as_ref()
            {
                let (slot, digest) = (run.slot, run.digest);
                self.event(EventKind::RunStarted { slot, digest });
            }
        }
        self.out.goals.clear();
        self.plan(fresh);
        self.pace_record();
        self.note_end();
    }

    fn count_missing(&mut self) {
        for joint in 0..self.motors.joints() {
            let motor = self.motors.get_mut(usize::from(joint));
            if motor.and_then(Motor::end_cycle) == Some(Finding::Lost) {
                self.event(EventKind::MotorLost { joint });
                self.fault_in_motion(Fault::DriverLost { joint });
            }
        }
    }

    /// A driver that lets go by itself while the robot moves is a fault; one that does so while arming is switched on again.
    fn check_torque(&mut self) {
        let moving = self.run.as_ref().is_some_and(|run| run.planner.is_some());
        if !moving || !self.in_motion() {
            return;
        }
        let off = self.motors.mask(|motor| motor.torque() == Some(false));
        if let Some(joint) = (0..self.motors.joints()).find(|joint| off >> joint & 1 != 0) {
            self.fault_in_motion(Fault::DriverError { joint, bits: 0 });
        }
    }

    /// Whether drivers are to be switched on now: armed, and the planner has not begun.
    pub(crate) fn wants_torque_on(&self) -> bool {
        self.command().motion == Motion::Approach
            && self.run.as_ref().is_some_and(|run| run.planner.is_none())
    }

    /// Drivers that get torque now, once the run asks for it: they answered in this cycle, lack it, and their watchdog is certain.
    pub(crate) fn to_switch_on(&self) -> u16 {
        if !self.wants_torque_on() {
            return 0;
        }
        let off = |motor: &Motor| motor.answered() && motor.torque() == Some(false);
        self.motors
            .mask(|motor| off(motor) && !motor.needs_settings())
    }

    /// Drivers that may have torque and should not, while the others keep theirs: one that restarted after its last reading got torque without a
    /// watchdog, and in another frame.
    pub(crate) fn to_let_go(&self) -> u16 {
        if self.command().torque {
            self.motors.mask(Motor::has_restarted)
        } else {
            0
        }
    }

    /// Set-points that ask for no motion: where each joint stands, for drivers that said in this cycle that their torque is off. One that
    /// restarted as torque went on and is silent since has torque in another frame.
    pub(crate) fn goals_here(&self) -> Values {
        let standing = self
            .motors
            .iter()
            .zip(FIRST_ID..)
            .filter(|(motor, _)| motor.answered() && motor.torque() == Some(false));
        collect(standing.filter_map(|(motor, id)| Some((id, motor.raw_position_urad()?))))
    }

    /// The set-points of this cycle.
    pub(crate) fn goals(&self) -> Values {
        self.out.goals.clone()
    }

    fn plan(&mut self, fresh: bool) {
        let command = self.command();
        self.out.flags = if command.torque { flags::TORQUE } else { 0 };
        if !command.torque {
            return;
        }
        let measured = self.motors.positions_rad();
        let now_us = self.now_us;
        let state = self.supervisor.state();
        let on = self.motors.mask(|motor| motor.torque() == Some(true));
        let ready = on == self.motion.machine().all_joints();
        let Some(run) = self.run.as_mut() else { return };
        run.age_cycles = run.age_cycles.saturating_add(1);
        if run.is_to_check() && !run.is_intact() {
            self.fault_in_motion(Fault::GaitCorrupt);
            return;
        }
        // The drivers hold the last set-point, as they do when a packet is lost.
        if !fresh {
            return;
        }
        if run.planner.is_none() {
            let waits = matches!(state, State::Armed { run_at_us, .. } if now_us < run_at_us);
            let Some(pose) =
                measured.filter(|_| ready && !waits && command.motion == Motion::Approach)
            else {
                return;
            };
            match Planner::begin(&self.motion, run.gait(), &pose) {
                Ok(planner) => run.planner = Some(planner),
                Err(_) => {
                    self.fault_in_motion(Fault::BadSetPoint);
                    return;
                }
            }
        }
        let motion = if core::mem::take(&mut run.hold_next) {
            Motion::Hold
        } else {
            command.motion
        };
        let Some(planner) = run.planner.as_mut() else {
            return;
        };
        match planner.cycle(&self.motion, motion, measured.as_ref()) {
            Ok(output) => self.follow(motion, &output),
            Err(_) => self.fault_in_motion(Fault::BadSetPoint),
        }
    }

    /// Turns the planner's output into set-points, events and counts.
    fn follow(&mut self, motion: Motion, output: &CycleOutput) {
        let values = output.set_point_rad;
        let mut goals = Values::new();
        let info = self.motors.info();
        let mut out_of_range = false;
        for (index, ((motor, id), angle_rad)) in self
            .motors
            .iter_mut()
            .zip(FIRST_ID..)
            .zip(values.iter())
            .enumerate()
        {
            // Not to a driver that lost its zero, its torque or its voice.
            let homed = self.supervisor.homed_mask() >> index & 1 != 0;
            let fit = motor.present() && motor.torque() == Some(true) && homed;
            let raw = motor.to_wire(info, *angle_rad);
            out_of_range |= fit && raw.is_none();
            if let Some(raw) = raw.filter(|_| fit) {
                motor.note_sent(raw);
                let _ = goals.push((id, raw));
            }
        }
        self.out.goals = goals;
        if out_of_range {
            // A servo of one turn cannot follow where this gait goes.
            self.fault_in_motion(Fault::BadSetPoint);
        }
        if let Some(blocked) = output.blocked {
            self.event(EventKind::Hold {
                body_a: blocked.pair.first,
                body_b: blocked.pair.last,
                clearance_um: (blocked.clearance_m * 1e6) as i32,
                ahead_ms: (blocked.at_s * 1e3) as u16,
            });
        }
        self.count_output(motion, output);
        if output.approach_blocked {
            let _ = self.supervise(SupervisorEvent::ApproachBlocked);
        }
        if output.settled {
            let _ = self.supervise(SupervisorEvent::Settled);
        }
    }

    fn count_output(&mut self, motion: Motion, output: &CycleOutput) {
        let Some(run) = self.run.as_mut() else { return };
        run.in_position = output.in_position;
        run.new_setpoint = true;
        if motion == Motion::Run {
            run.count(&output.set_point_rad);
        }
        if motion == Motion::Approach {
            self.out.flags |= flags::APPROACH;
        }
        let ended = run.hold_cycles;
        run.hold_cycles = if output.held {
            ended.saturating_add(1)
        } else {
            0
        };
        if output.held {
            self.out.flags |= flags::HOLD;
            self.counts.holds = self.counts.holds.saturating_add(1);
        } else if ended > 0 {
            self.event(EventKind::HoldEnded { cycles: ended });
        }
    }

    /// Ends the run once nothing moves any more.
    fn note_end(&mut self) {
        let state = self.supervisor.state();
        let over = !self.in_motion();
        let Some(run) = self.run.as_mut() else { return };
        run.note_end(&state);
        if !over {
            return;
        }
        self.telemetry.flush();
        self.recording = false;
        let (samples, dropped) = (self.telemetry.taken(), self.telemetry.dropped());
        self.counts.samples_dropped = self.counts.samples_dropped.saturating_add(dropped);
        let end: RunEnd = run.end(samples, dropped);
        self.run_link = run.link;
        self.run = None;
        // What was signed for this run is not for the time after it.
        self.void_challenges = true;
        self.run_end = Some(end);
        for motor in self.motors.iter_mut() {
            motor.forget_sent();
        }
        for session in &mut self.sessions {
            session.end_due = session.open;
        }
        self.event(EventKind::RunEnded { reason: end.reason });
    }

    /// In a run the record goes out at its own pace, not at the rate of the line: with a sample a cycle one block every second cycle, and none in a cycle
    /// that checks the gait.
    pub(crate) fn pace_record(&mut self) {
        self.block_due = self.run.as_ref().is_none_or(Run::may_send_block);
    }

    /// Takes a sample of what was read in this slot, for the run's record and for live viewers.
    pub(crate) fn take_sample(&mut self, slot: Slot) {
        let run_rate = self.run.as_ref().map_or(TelemetryRate::Off, |run| run.rate);
        let wanted = |rate| match rate {
            TelemetryRate::Off => false,
            TelemetryRate::Cycle => slot == Slot::Control,
            TelemetryRate::Fast => true,
        };
        let live = self
            .sessions
            .iter()
            .any(|session| session.open && wanted(session.rate));
        if !wanted(run_rate) && !live {
            return;
        }
        let run = self.run.as_mut();
        let (cycle, new_setpoint) = run.map_or((0, false), |run| {
            (run.cycles, core::mem::take(&mut run.new_setpoint))
        });
        // Written where it stays: it is half a kilobyte.
        let sample = &mut self.live;
        if sample.motors.len() != usize::from(self.motors.joints()) {
            *sample = Sample::of(self.motors.joints());
        }
        sample.cycle = cycle;
        sample.t_us = self.cycle_us;
        sample.flags = self.out.flags;
        if new_setpoint {
            sample.flags |= flags::NEW_SETPOINT;
        }
        sample.valid_mask = self.motors.mask(Motor::answered);
        for (place, motor) in sample.motors.iter_mut().zip(self.motors.iter()) {
            let reading = motor.reading();
            *place = reading.map_or(MotorSample::ZERO, |(feedback, at_us)| MotorSample {
                dt_us: u32::try_from(at_us.saturating_sub(self.cycle_us)).unwrap_or(0),
                setpoint_urad: motor.setpoint_urad().unwrap_or(0),
                feedback,
            });
        }
        if wanted(run_rate) && self.recording {
            self.telemetry.push(&self.live);
        }
        for session in &mut self.sessions {
            session.live = session.open && wanted(session.rate);
        }
    }

    /// Leaves the cycle at `now_us`; gives the next instant of the grid.
    pub(crate) fn end_cycle(&mut self, now_us: u64) -> u64 {
        let rates = self
            .sessions
            .iter()
            .filter(|session| session.open)
            .map(|session| session.rate);
        let run = self.run.as_ref().map(|run| run.rate);
        let fast = rates.chain(run).any(|rate| rate == TelemetryRate::Fast);
        let next = self.timing.end(now_us, fast);
        if next.skipped > 0 {
            let cycle_us = u32::try_from(next.took_us).unwrap_or(u32::MAX);
            self.event(EventKind::Overrun { cycle_us });
            if let Some(run) = self.run.as_mut() {
                run.hold_next = true;
            }
            if self.timing.in_row() >= STOP_AFTER {
                self.fault_in_motion(Fault::Overrun);
            }
        }
        self.now_us = now_us.max(self.now_us);
        next.due_us
    }
}
