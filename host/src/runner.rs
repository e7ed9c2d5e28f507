//! One run on a robot: start, collect telemetry through drop-outs, drain what is missing, record.

use std::collections::BTreeSet;
use std::time::Duration;

use control::gait::Gait;
use indicatif::ProgressBar;
use protocol::link::{
    Digest, EndReason, EventKind, FromModule, ModuleState, Reject, RunEnd, Sample, SampleBlock,
    Tag, TelemetryRate, ToModule,
};

use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};
use crate::interrupt;
use crate::link::{LinkError, PortUri, Robot, Stopped, telemetry, text};
use crate::recording::timing::{is_first_of_cycle, start_us};
use crate::recording::{EventRow, Recorder, RunEndRow, RunStart};

/// A robot that says nothing for this long in a run is asked whether it is still there.
const SILENCE: Duration = Duration::from_millis(1500);
/// After the end of the run a lost link is looked for this long before the run is given up.
const PATIENCE_AFTER_RUN: Duration = Duration::from_secs(20);
/// The way to the start pose: half a turn at the slowest joint's limited speed, with room.
const APPROACH: Duration = Duration::from_secs(20);
/// Longest wait for the end of a run after STOP: amplitudes run down within it.
const STOPPING: Duration = Duration::from_secs(6);

/// A gait that takes over in mid-run.
#[derive(Debug, Clone, Copy)]
pub struct Change {
    /// Slot.
    pub slot: u8,
    /// Digest of the gait in it.
    pub digest: Digest,
    /// Time from the first step of the gait.
    pub after: Duration,
}

/// What to run.
#[derive(Debug, Clone)]
pub struct Order {
    /// Slot.
    pub slot: u8,
    /// Digest of the gait in it.
    pub digest: Digest,
    /// The gait, for the host's own set-points in the recording.
    pub gait: Gait,
    /// Length of the run.
    pub duration: Duration,
    /// Tethered: the robot stops this long after the last heartbeat. `None`: it runs to its end without this host.
    pub lease: Option<Duration>,
    /// Samples per second.
    pub rate_hz: u32,
    /// Wait before the first movement.
    pub countdown: Duration,
    /// What takes over in mid-run.
    pub then: Option<Change>,
}

/// Lease of a tethered run: of four heartbeats three may be lost.
const LEASE: Duration = Duration::from_secs(1);

/// The tether of a run over this link: every real robot has one unless it is to be autonomous. The emulated robot in this process ends with it.
#[must_use]
pub fn lease(uri: &PortUri, autonomous: bool) -> Option<Duration> {
    (!autonomous && !uri.is_sim()).then_some(LEASE)
}

/// How a run went.
#[derive(Debug, Clone, PartialEq)]
pub struct RunReport {
    /// Counts and reason.
    pub end: RunEndRow,
    /// The reason as the module told it.
    pub reason: Option<EndReason>,
    /// RMS of set-point minus position over all joints, rad; 0 without samples.
    pub tracking_rms_rad: f64,
    /// Ctrl-C was pressed and the robot stopped.
    pub interrupted: bool,
}

/// A run under way.
struct Run<'a> {
    context: &'a Context,
    robot: &'a mut Robot,
    recorder: Option<&'a mut Recorder>,
    run: u32,
    order: &'a Order,
    seen_us: BTreeSet<u64>,
    have: BTreeSet<u32>,
    module_run: Option<u16>,
    first_tick_us: Option<u64>,
    last_us: u64,
    square_sum: f64,
    square_count: u64,
    reconnects: u32,
    dropped: u32,
    next_beat: Duration,
    /// When the change of gait is to be ordered, link time.
    change_at: Option<Duration>,
    /// Somebody changed the gait in this run: its set-points are not those of the order's gait.
    changed: bool,
    bar: ProgressBar,
}

/// Starts a run and follows it to its end.
///
/// # Errors
/// Exit codes 1 (recording), 5, 7.
pub fn run(
    context: &Context,
    robot: &mut Robot,
    recorder: Option<&mut Recorder>,
    number: u32,
    order: &Order,
) -> Outcome<RunReport> {
    let _grace = interrupt::grace("stopping the robot");
    let bar = context
        .out
        .progress(order.duration.as_secs(), &format!("run {}", number + 1));
    let mut run = Run {
        context,
        robot,
        recorder,
        run: number,
        order,
        seen_us: BTreeSet::new(),
        have: BTreeSet::new(),
        module_run: None,
        first_tick_us: None,
        last_us: 0,
        square_sum: 0.0,
        square_count: 0,
        reconnects: 0,
        dropped: 0,
        next_beat: Duration::ZERO,
        change_at: None,
        changed: false,
        bar,
    };
    let result = run.go();
    run.bar.finish_and_clear();
    result
}

impl Run<'_> {
    fn go(&mut self) -> Outcome<RunReport> {
        self.start()?;
        let mut interrupted = false;
        let followed = self.note_start().map_err(Stop::from);
        let end = match followed.and_then(|()| self.follow()) {
            Ok(end) => end,
            Err(Stop::Interrupted) => {
                interrupted = true;
                self.stop_robot()?
            }
            Err(Stop::Failed(failure)) => {
                // Whatever failed here, the robot must not run on unwatched.
                let _ = self.stop_robot();
                return Err(failure);
            }
        };
        self.drain()?;
        self.finish(end, interrupted)
    }

    fn start(&mut self) -> Outcome {
        let order = self.order;
        let rate = if order.rate_hz > 20 {
            TelemetryRate::Fast
        } else {
            TelemetryRate::Cycle
        };
        let (slot, digest, tag) = (order.slot, order.digest, Tag::NONE);
        let duration_ms = u32::try_from(order.duration.as_millis()).unwrap_or(u32::MAX);
        let countdown_ms = short_ms(order.countdown);
        self.robot.order(&match order.lease {
            None => ToModule::Start {
                slot,
                digest,
                duration_ms,
                rate,
                countdown_ms,
                tag,
            },
            Some(lease) => ToModule::StartTethered {
                slot,
                digest,
                duration_ms,
                rate,
                countdown_ms,
                lease_ms: short_ms(lease),
                tag,
            },
        })?;
        self.robot.forget_runs();
        Ok(())
    }

    /// The robot has accepted the run: the recording begins.
    fn note_start(&mut self) -> Outcome {
        let order = self.order;
        let start = RunStart {
            run: self.run,
            gait: order.gait.name().to_owned(),
            digest: text::hex(&order.digest.0),
            duration_s: order.duration.as_secs_f64(),
            rate_hz: f64::from(order.rate_hz),
        };
        self.record(|r| r.start_run(&start))
    }

    /// Collects until the run has ended.
    fn follow(&mut self) -> Result<Option<RunEnd>, Stop> {
        let length = self.order.duration + self.order.countdown + APPROACH;
        let until = self.robot.link().now() + length;
        let mut heard = self.robot.link().now();
        loop {
            self.beat(until)?;
            self.change(until)?;
            match self.robot.next(Duration::from_millis(100)) {
                Ok(Some(message)) => {
                    heard = self.robot.link().now();
                    if let Some(end) = self.take(message)? {
                        return Ok(Some(end));
                    }
                }
                Ok(None) => {
                    let now = self.robot.link().now();
                    if now.saturating_sub(heard) > SILENCE {
                        if self.has_ended(until)? {
                            return Ok(None);
                        }
                        heard = self.robot.link().now();
                    }
                }
                Err(error) if error.is_lost_link() => {
                    self.find_again(&error, until)?;
                    heard = self.robot.link().now();
                }
                Err(error) => return Err(error.into()),
            }
            if self.robot.link().now() > until + PATIENCE_AFTER_RUN {
                return Ok(None);
            }
        }
    }

    /// Four heartbeats within a lease. One that is lost is sent again; when none arrives the robot stops by itself.
    fn beat(&mut self, until: Duration) -> Result<(), Stop> {
        let Some(lease) = self.order.lease else {
            return Ok(());
        };
        let now = self.robot.link().now();
        if now < self.next_beat {
            return Ok(());
        }
        self.next_beat = now + lease / 4;
        match self.robot.heartbeat(lease / 2) {
            Ok(()) => Ok(()),
            // A run that is over takes none; its end is told.
            Err(LinkError::Refused { .. }) => Ok(()),
            Err(LinkError::Timeout { .. }) => {
                self.next_beat = now;
                Ok(())
            }
            Err(error) if error.is_lost_link() => self.find_again(&error, until),
            Err(error) => Err(error.into()),
        }
    }

    /// Orders the change of gait when its time has come.
    fn change(&mut self, until: Duration) -> Result<(), Stop> {
        let (Some(then), Some(at)) = (self.order.then, self.change_at) else {
            return Ok(());
        };
        if self.robot.link().now() < at {
            return Ok(());
        }
        let (slot, digest, tag) = (then.slot, then.digest, Tag::NONE);
        match self
            .robot
            .order(&ToModule::ChangeGait { slot, digest, tag })
        {
            Err(error) if error.is_lost_link() => return self.find_again(&error, until),
            Err(LinkError::Refused {
                reason: Reject::State { .. },
                ..
            }) => self
                .context
                .out
                .warn("the run was over before the gait could be changed"),
            other => other?,
        }
        self.change_at = None;
        Ok(())
    }

    /// Asks a silent robot for its state.
    fn has_ended(&mut self, until: Duration) -> Result<bool, Stop> {
        match self.robot.info() {
            Ok(info) => Ok(!matches!(
                info.state,
                ModuleState::Armed | ModuleState::Run | ModuleState::Stopping
            )),
            Err(error) if error.is_lost_link() => {
                self.find_again(&error, until)?;
                Ok(false)
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Reconnects, and notes how long the link was away.
    fn find_again(&mut self, error: &LinkError, until: Duration) -> Result<(), Stop> {
        let lost_at = self.robot.link().now();
        let meanwhile = match self.order.lease {
            None => "the robot goes on by itself".to_owned(),
            Some(lease) => format!("the robot stops within {} s", lease.as_secs_f64()),
        };
        self.context
            .out
            .warn(format_args!("{error}; {meanwhile}, connecting again"));
        self.host_event("link_lost", error.to_string())?;
        let patience = until.saturating_sub(lost_at) + PATIENCE_AFTER_RUN;
        self.robot.reconnect(patience)?;
        self.reconnects += 1;
        let away = self.robot.link().now().saturating_sub(lost_at);
        self.context.out.say(format_args!(
            "connected again after {:.1} s",
            away.as_secs_f64()
        ));
        self.host_event("link_back", format!("after {:.3} s", away.as_secs_f64()))?;
        Ok(())
    }

    /// Takes one unasked message; the end of this run ends the collection.
    fn take(&mut self, message: FromModule) -> Result<Option<RunEnd>, Stop> {
        match message {
            FromModule::Sample(sample) | FromModule::SampleOf(sample) => self.sample(&sample)?,
            FromModule::SampleBlock(block) | FromModule::SampleBlockOf(block) => {
                self.block(&block)?;
            }
            FromModule::Event(event) => {
                self.changed |= matches!(event.kind, EventKind::GaitChanged { .. });
                if matches!(event.kind, EventKind::RunStarted { .. }) {
                    let now = self.robot.link().now();
                    self.change_at = self.order.then.map(|then| now + then.after);
                }
                let row = telemetry::event_row(self.run, &event);
                self.context.out.detail(format_args!(
                    "{:>10.3} s  {:12} {}",
                    event.t_us as f64 / 1e6,
                    row.kind,
                    row.text
                ));
                self.record(|r| r.event(&row))?;
            }
            FromModule::RunEnd(end) => return Ok(Some(end)),
            _ => {}
        }
        Ok(None)
    }

    fn block(&mut self, block: &SampleBlock) -> Outcome {
        self.module_run.get_or_insert(block.run);
        if self.module_run != Some(block.run) {
            return Ok(());
        }
        self.dropped = self.dropped.max(block.dropped);
        for (index, sample) in (block.first..).zip(block.samples()) {
            // A damaged block passed its checksum, so both ends disagree about the code: nothing of it is used.
            let Ok(sample) = sample else {
                return Err(Failure::say(
                    Exit::Link,
                    "a telemetry block cannot be read; are both ends the same version?",
                ));
            };
            self.have.insert(index);
            self.sample(&sample)?;
        }
        Ok(())
    }

    fn sample(&mut self, sample: &Sample) -> Outcome {
        if !self.seen_us.insert(sample.t_us) {
            return Ok(());
        }
        let row = telemetry::row(self.run, sample);
        if is_first_of_cycle(&row) {
            let period_us = 1_000_000 / u64::from(self.order.rate_hz.max(1));
            let first = *self
                .first_tick_us
                .get_or_insert_with(|| start_us(&row, period_us));
            self.bar
                .set_position(row.t_us.saturating_sub(first) / 1_000_000);
        }
        if self.first_tick_us.is_some() {
            for joint in &row.joints {
                if let Some(feedback) = joint.feedback {
                    self.square_sum += (joint.setpoint_rad - feedback.position_rad).powi(2);
                    self.square_count += 1;
                }
            }
        }
        self.last_us = self.last_us.max(row.t_us);
        self.record(|r| r.sample(&row))
    }

    /// STOP, then wait for the end of the run. Loud when the robot does not acknowledge.
    fn stop_robot(&mut self) -> Outcome<Option<RunEnd>> {
        self.robot.finish_in_peace();
        let stopped = self.robot.stop().or_else(|error| {
            if !error.is_lost_link() {
                return Err(error);
            }
            self.robot.reconnect(Duration::from_secs(5))?;
            self.robot.stop()
        });
        match stopped {
            Ok(stopped) => self.context.out.say(match stopped {
                Stopped::Proved => "robot stopped (STOP acknowledged, proved with its key)",
                Stopped::Acknowledged => "robot stopped (STOP acknowledged)",
            }),
            Err(error @ (LinkError::Unproved | LinkError::StillMoving)) => {
                self.context.out.warn(format_args!(
                    "STOP IS NOT CERTAIN ({error}). Look at the robot and use its STOP button."
                ));
                return Ok(None);
            }
            Err(error) => {
                let left = self.order.lease.unwrap_or(self.order.duration).as_secs();
                self.context.out.warn(format_args!(
                    "STOP WAS NOT ACKNOWLEDGED ({error}). The robot runs on for at most {left} s. Use its STOP button."
                ));
                return Ok(None);
            }
        }
        self.context.out.say(format_args!(
            "its joints run down to rest; waiting at most {} s for that and for the last samples",
            STOPPING.as_secs()
        ));
        let until = self.robot.link().now() + STOPPING;
        while self.robot.link().now() < until {
            match self.robot.next(Duration::from_millis(200)) {
                Ok(Some(message)) => match self.take(message) {
                    Ok(Some(end)) => return Ok(Some(end)),
                    Ok(None) => {}
                    Err(_) => return Ok(None),
                },
                Ok(None) => {}
                Err(_) => return Ok(None),
            }
        }
        Ok(None)
    }

    /// Asks for every block that is missing, until the module has no more.
    fn drain(&mut self) -> Outcome {
        let mut from = 0;
        loop {
            while self.have.contains(&from) {
                from += 1;
            }
            let block = match self.robot.ask(&ToModule::Drain { from_sample: from }) {
                Ok(FromModule::SampleBlock(block) | FromModule::SampleBlockOf(block)) => block,
                Ok(_) => return Err(LinkError::WrongAnswer { request: "drain" }.into()),
                // Nothing kept: what is missing is counted.
                Err(LinkError::Refused { .. }) => return Ok(()),
                Err(error) if error.is_lost_link() => {
                    self.robot.reconnect(PATIENCE_AFTER_RUN)?;
                    continue;
                }
                Err(error) => return Err(error.into()),
            };
            if block.count == 0 || self.module_run.is_some_and(|run| run != block.run) {
                return Ok(());
            }
            self.block(&block)?;
            from = from.max(block.first.saturating_add(u32::from(block.count)));
        }
    }

    fn finish(&mut self, end: Option<RunEnd>, interrupted: bool) -> Outcome<RunReport> {
        let recorded = u32::try_from(self.seen_us.len()).unwrap_or(u32::MAX);
        let dropped = end.map_or(self.dropped, |e| e.dropped.max(self.dropped));
        let samples = end.map_or(recorded + dropped, |e| e.samples);
        let row = RunEndRow {
            run: self.run,
            reason: end.map_or_else(|| "unknown".to_owned(), |e| text::end_reason(&e.reason)),
            cycles: end.map_or(0, |e| e.cycles),
            holds: end.map_or(0, |e| e.holds),
            samples,
            dropped_by_module: dropped,
            recorded,
            lost_on_link: samples.saturating_sub(dropped).saturating_sub(recorded),
            reconnects: self.reconnects,
            setpoint_crc32c: end.map_or(0, |e| e.setpoint_crc32c),
        };
        if self.changed {
            self.context.out.warn(format_args!(
                "the gait was changed in mid-run: the recording has no set-points of this computer's law"
            ));
        }
        if let Some(start_us) = self.first_tick_us.filter(|_| !self.changed) {
            let (run, gait) = (self.run, &self.order.gait);
            if let Some(recorder) = self.recorder.as_deref_mut() {
                recorder
                    .host_cpg(run, gait, row.cycles, start_us)
                    .map_err(recording_failed)?;
            }
        }
        self.record(|r| r.end_run(&row))?;
        let tracking_rms_rad = (self.square_sum / self.square_count.max(1) as f64).sqrt();
        Ok(RunReport {
            end: row,
            reason: end.map(|e| e.reason),
            tracking_rms_rad,
            interrupted,
        })
    }

    fn host_event(&mut self, kind: &str, words: String) -> Outcome {
        let row = EventRow {
            run: self.run,
            seq: 0,
            t_us: self.last_us,
            source: "host".to_owned(),
            kind: kind.to_owned(),
            text: words,
        };
        self.record(|r| r.event(&row))
    }

    fn record(
        &mut self,
        write: impl FnOnce(&mut Recorder) -> Result<(), crate::recording::RecorderError>,
    ) -> Outcome {
        match self.recorder.as_deref_mut() {
            Some(recorder) => write(recorder).map_err(recording_failed),
            None => Ok(()),
        }
    }
}

fn short_ms(time: Duration) -> u16 {
    u16::try_from(time.as_millis()).unwrap_or(u16::MAX)
}

fn recording_failed(error: crate::recording::RecorderError) -> Failure {
    Failure::new(Exit::Other, error).hint("the robot was stopped; free some space and run again")
}

/// Why following a run ended early.
enum Stop {
    Interrupted,
    Failed(Failure),
}

impl From<LinkError> for Stop {
    fn from(error: LinkError) -> Self {
        match error {
            LinkError::Interrupted => Self::Interrupted,
            other => Self::Failed(other.into()),
        }
    }
}

impl From<Failure> for Stop {
    fn from(failure: Failure) -> Self {
        Self::Failed(failure)
    }
}
