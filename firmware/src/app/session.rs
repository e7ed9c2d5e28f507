//! What a host may ask: the module side of every message, as the link server calls it.

use super::core::{BusJob, Core, Job, Session};
use super::dry_run::DryRun;
use super::run::Run;
use crate::crash;
use crate::slots::GAIT_SLOTS;
use control::gait::Gait;
use control::machine::Contact;
use control::motion::RetargetError;
use control::supervisor::{Event as SupervisorEvent, Order};
use heapless::Vec;
use protocol::bus::Profile;
use protocol::link::event::Event;
use protocol::link::message::MAX_EVENTS;
use protocol::link::status::MAX_FIRMWARE_ID;
use protocol::link::{
    BusAnswer, Counters, CrashRecord, Digest, Drivers, EventKind, GaitReject, Hello, Info, Key,
    MAX_SLOTS, ModuleHandler, ModuleState, Nonce, Outcome, Reject, ResetCause, SampleBlock,
    SlotInfo, StartOrder, StorageFault, StoredGait, TelemetryRate, VERSION, WireGait, WireRobot,
};

/// Longest time a raw bus packet listens, ms.
const MAX_LISTEN_MS: u16 = 1_000;
/// Time for the answer to leave before the reset, us.
const RESET_DELAY_US: u64 = 200_000;

/// The core as one link's server sees it.
pub(crate) struct Visitor<'a> {
    pub core: &'a mut Core,
    pub link: usize,
}

impl Visitor<'_> {
    fn session(&mut self) -> Option<&mut Session> {
        self.core.sessions.get_mut(self.link)
    }

    /// A refusal because something is under way says who holds the robot, if that is the host of another link.
    fn or_held(&self, reject: Reject) -> Reject {
        let other = self.core.holder().filter(|link| *link != self.link);
        match (reject, other) {
            // There are two links.
            (Reject::State { .. } | Reject::Busy, Some(link)) => Reject::Held { link: link as u8 },
            (reject, _) => reject,
        }
    }

    fn may_write(&self) -> Result<(), Reject> {
        self.core.may_write().map_err(|reject| self.or_held(reject))
    }

    fn slot(&self, slot: u8) -> Result<usize, Reject> {
        let index = usize::from(slot);
        if index < GAIT_SLOTS {
            Ok(index)
        } else {
            Err(Reject::NoSuchSlot {
                slots: GAIT_SLOTS as u8,
            })
        }
    }

    fn stored(&self, slot: u8) -> Result<&super::core::Stored, Reject> {
        let index = self.slot(slot)?;
        self.core
            .gaits
            .get(index)
            .and_then(Option::as_ref)
            .ok_or(Reject::SlotEmpty)
    }

    /// The gait of a slot, if it is the one the host means and the robot is one that it fits. Stored gaits were checked at upload; checked again,
    /// because flash is another source than the link, and the robot may be another since.
    fn gait(&self, slot: u8, digest: Digest) -> Result<Gait, Reject> {
        let stored = self.stored(slot)?;
        if stored.digest != digest {
            return Err(Reject::OtherGait {
                stored: stored.digest,
            });
        }
        let gait = Gait::try_from(&stored.gait).map_err(|_| Reject::Storage {
            fault: StorageFault::Damaged,
        })?;
        gait.check_speed(self.core.motion.machine().limits())
            .map_err(|error| Reject::Gait(GaitReject::from(error)))?;
        Ok(gait)
    }
}

impl ModuleHandler for Visitor<'_> {
    fn hello(&mut self) -> Hello {
        let next_event = self.core.events.next_seq();
        if let Some(session) = self.session() {
            *session = Session {
                open: true,
                next_event,
                ..*session
            };
        }
        let mut firmware = heapless::String::<MAX_FIRMWARE_ID>::new();
        // A longer word would be left out whole; the test of this module reads it back.
        for word in [crate::FIRMWARE_ID, " ", self.core.board] {
            let _ = firmware.push_str(word);
        }
        Hello {
            protocol: VERSION,
            robot_id: self.core.robot_id,
            boot_id: self.core.boot_id,
            firmware,
            model_digest: self.core.model_digest,
            keyed: self.core.settings.key.is_some(),
        }
    }

    fn info(&mut self) -> Info {
        let core = &*self.core;
        Info {
            state: core.state(),
            fault: core.fault,
            reset_cause: reset_cause(core),
            slots: GAIT_SLOTS as u8,
            active_slot: core.settings.active,
            battery_mv: core.inputs.battery_mv.unwrap_or(0),
            homed_mask: core.supervisor.homed_mask(),
            motor_mask: core.motors.mask(super::motors::Motor::present),
            uptime_us: core.now_us,
            cycles: core.counts.cycles,
            counters: Counters {
                bad_tags: core.counts.bad_tags,
                bus_timeouts: core.counts.bus_timeouts,
                bus_bad_crc: core.counts.bus_bad_crc,
                bus_stray: core.counts.bus_stray,
                overruns: core.timing.overruns(),
                holds: core.counts.holds,
                samples_dropped: core.counts.samples_dropped,
                events_dropped: core.events.dropped(),
                ..Counters::default()
            },
        }
    }

    fn fresh_nonce(&mut self) -> Result<Nonce, Reject> {
        self.core.fresh_nonce()
    }

    fn key(&self) -> Option<Key> {
        self.core.settings.key
    }

    fn bad_tag(&mut self, request: u8) {
        self.core.counts.bad_tags = self.core.counts.bad_tags.saturating_add(1);
        self.core.event(EventKind::BadTag { request });
    }

    fn stop(&mut self) {
        // Nothing that was signed before this STOP may move the robot after it, on whatever link it comes.
        self.core.void_challenges = true;
        self.core.event(EventKind::Stop { input: false });
        // Stop is never refused.
        let _ = self.core.supervise(SupervisorEvent::Order(Order::Stop));
    }

    fn put_gait(
        &mut self,
        slot: u8,
        activate: bool,
        gait: &WireGait,
    ) -> Result<Outcome<StoredGait>, Reject> {
        let slot = self.slot(slot)?;
        self.may_write()?;
        let checked =
            Gait::try_from(gait).map_err(|error| Reject::Gait(GaitReject::from(error)))?;
        checked
            .check_speed(self.core.motion.machine().limits())
            .map_err(|error| Reject::Gait(GaitReject::from(error)))?;
        // Stored as the checked gait writes itself, so the fingerprint is that of the host's own canonical form.
        let gait = WireGait::from(&checked);
        self.core.job = Some(Job::Put {
            link: self.link,
            slot,
            activate,
            gait,
            check: DryRun::new(checked),
        });
        Ok(Outcome::Pending)
    }

    fn get_gait(&mut self, slot: u8) -> Result<(Digest, WireGait), Reject> {
        let stored = self.stored(slot)?;
        Ok((stored.digest, stored.gait.clone()))
    }

    fn slots(&mut self) -> (Option<u8>, Vec<Option<SlotInfo>, MAX_SLOTS>) {
        let mut list = Vec::new();
        for stored in &self.core.gaits {
            let info = stored.as_ref().map(|stored| SlotInfo {
                name: stored.gait.name.clone(),
                digest: stored.digest,
                generation: stored.generation,
            });
            // As many as fit: GAIT_SLOTS <= MAX_SLOTS.
            let _ = list.push(info);
        }
        (self.core.settings.active, list)
    }

    fn activate_slot(&mut self, slot: u8) -> Result<Outcome, Reject> {
        self.may_write()?;
        self.stored(slot)?;
        self.core.job = Some(Job::Activate {
            link: self.link,
            slot: usize::from(slot),
        });
        Ok(Outcome::Pending)
    }

    fn erase_slot(&mut self, slot: u8) -> Result<Outcome, Reject> {
        self.may_write()?;
        self.stored(slot)?;
        if self.core.settings.active == Some(slot) {
            return Err(Reject::SlotActive);
        }
        self.core.job = Some(Job::Erase {
            link: self.link,
            slot: usize::from(slot),
        });
        Ok(Outcome::Pending)
    }

    fn start(&mut self, order: &StartOrder) -> Result<Outcome, Reject> {
        let gait = self.gait(order.slot, order.digest)?;
        if self.core.challenge_seed.is_none() {
            return Err(Reject::NoEntropy);
        }
        if *self.core.motion.machine().contact() == Contact::Unstated {
            return Err(Reject::ContactUnstated);
        }
        if self.core.job.is_some() || self.core.bus_job.is_some() {
            return Err(self.or_held(Reject::Busy));
        }
        if self.core.inputs.stop_pressed {
            return Err(Reject::StopInputActive);
        }
        self.core.battery_allows()?;
        if let Some(wrong) = self.core.motors.wrong().next() {
            return Err(Reject::WrongDriver(wrong));
        }
        let missing_mask = self.core.motion.machine().all_joints()
            & !self
                .core
                .motors
                .mask(|motor| motor.position_rad().is_some());
        if missing_mask != 0 && self.core.state() == ModuleState::Idle {
            return Err(Reject::MotorsMissing { missing_mask });
        }
        if self.core.run.is_some() {
            // Its hold may be over since the last cycle, but no cycle has let the drivers go and told its end.
            let state = self.core.state();
            return Err(self.or_held(Reject::State { state }));
        }
        self.core.supervise(SupervisorEvent::Order(Order::Start {
            duration_us: u64::from(order.duration_ms).saturating_mul(1_000),
            countdown_us: u64::from(order.countdown_ms).saturating_mul(1_000),
            lease_us: order.lease_ms.map(|ms| u64::from(ms).saturating_mul(1_000)),
        }))?;
        self.core.runs = self.core.runs.wrapping_add(1);
        // A host would take the end of the run before for that of this one, now or when it is back from silence.
        self.core.run_end = None;
        for session in &mut self.core.sessions {
            session.beats = 0;
            session.silent = false;
            session.end_due = false;
        }
        let joints = self.core.motors.joints();
        self.core.telemetry.begin(self.core.runs, joints);
        self.core.recording = order.rate != TelemetryRate::Off;
        self.core.run_link = self.link;
        self.core.run = Some(Run::new(self.core.runs, gait, order, self.link));
        Ok(Outcome::Done(()))
    }

    fn heartbeat(&mut self) -> Result<Outcome, Reject> {
        self.core
            .supervise(SupervisorEvent::Order(Order::Heartbeat))?;
        Ok(Outcome::Done(()))
    }

    fn change_gait(&mut self, slot: u8, digest: Digest) -> Result<Outcome, Reject> {
        let gait = self.gait(slot, digest)?;
        let core = &mut *self.core;
        let state = core.state();
        if state != ModuleState::Run {
            return Err(Reject::State { state });
        }
        let planner = core.run.as_mut().and_then(|run| run.planner.as_mut());
        let planner = planner.ok_or(Reject::State { state })?;
        planner
            .retarget(&core.motion, &gait)
            .map_err(|error| match error {
                RetargetError::Mismatch(mismatch) => Reject::Gait(GaitReject::from(mismatch)),
                RetargetError::ChangePending => Reject::Busy,
            })?;
        if let Some(run) = core.run.as_mut() {
            run.next_digest = Some(digest);
            run.slot = slot;
        }
        core.event(EventKind::GaitChanged { slot, digest });
        Ok(Outcome::Done(()))
    }

    fn clear_fault(&mut self) -> Result<Outcome, Reject> {
        self.core
            .supervise(SupervisorEvent::Order(Order::ClearFault))?;
        Ok(Outcome::Done(()))
    }

    fn zero(&mut self, joint_mask: u16) -> Result<Outcome, Reject> {
        if joint_mask == 0 || joint_mask & !self.core.motion.machine().all_joints() != 0 {
            return Err(Reject::JointMask);
        }
        let state = self.core.state();
        if !matches!(state, ModuleState::Unhomed | ModuleState::Idle) {
            return Err(self.or_held(Reject::State { state }));
        }
        let wrong = self
            .core
            .motors
            .wrong()
            .find(|wrong| joint_mask >> wrong.joint & 1 != 0);
        if let Some(wrong) = wrong {
            return Err(Reject::WrongDriver(wrong));
        }
        let now_us = self.core.now_us;
        let missing_mask = joint_mask & !self.core.motors.mask(|motor| motor.may_be_zeroed(now_us));
        if missing_mask != 0 {
            return Err(Reject::MotorsMissing { missing_mask });
        }
        for (joint, motor) in self.core.motors.iter_mut().enumerate() {
            if joint_mask >> joint & 1 != 0 {
                // A fresh reading is there: checked above.
                motor.set_zero();
            }
        }
        self.core
            .supervise(SupervisorEvent::Order(Order::Home { joint_mask }))?;
        self.core.event(EventKind::Homed { mask: joint_mask });
        Ok(Outcome::Done(()))
    }

    fn subscribe(&mut self, rate: TelemetryRate) -> Result<(), Reject> {
        // Of this link alone. What a run records is ordered with its start, with proof.
        if let Some(session) = self.session() {
            session.rate = rate;
        }
        Ok(())
    }

    fn events(&mut self, since: u32, into: &mut Vec<Event, MAX_EVENTS>) -> (u32, u32) {
        let mut next = self.core.events.next_seq();
        for event in self.core.events.since(since) {
            if into.push(*event).is_err() {
                next = event.seq;
                break;
            }
        }
        (next, self.core.events.lost_since(since))
    }

    fn drain(&mut self, from: u32) -> Result<SampleBlock, Reject> {
        let to_recorder = self.link == self.core.run_link;
        Ok(self.core.telemetry.drain(from, to_recorder))
    }

    fn bus_raw(&mut self, bytes: &[u8], listen_ms: u16) -> Result<Outcome<BusAnswer>, Reject> {
        self.may_write().or_else(|reject| match reject {
            // Reading a bus needs no battery.
            Reject::Battery { .. } => Ok(()),
            other => Err(other),
        })?;
        let packet = Vec::from_slice(bytes).map_err(|_| Reject::BusOrder)?;
        if packet.is_empty() || listen_ms > MAX_LISTEN_MS {
            return Err(Reject::BusOrder);
        }
        let link = self.link;
        self.core.bus_job = Some(BusJob {
            link,
            packet,
            listen_ms,
            heard: Vec::new(),
            overflow: false,
        });
        Ok(Outcome::Pending)
    }

    fn set_key(&mut self, key: &Key) -> Result<Outcome, Reject> {
        self.may_write()?;
        self.core.job = Some(Job::SetKey {
            link: self.link,
            key: *key,
        });
        Ok(Outcome::Pending)
    }

    fn reset(&mut self) -> Result<Outcome, Reject> {
        if self.core.in_motion() {
            let state = self.core.state();
            return Err(self.or_held(Reject::State { state }));
        }
        self.core.reboot_at_us = Some(self.core.now_us.saturating_add(RESET_DELAY_US));
        Ok(Outcome::Done(()))
    }

    fn crash(&mut self) -> Option<CrashRecord> {
        self.core.crash.clone()
    }

    fn set_drivers(&mut self, profile: Profile) -> Result<Outcome, Reject> {
        self.may_write()?;
        self.core.job = Some(Job::SetDrivers {
            link: self.link,
            profile,
        });
        Ok(Outcome::Pending)
    }

    fn set_robot(&mut self, robot: &WireRobot) -> Result<Outcome, Reject> {
        self.core.may_write()?;
        let machine = robot
            .machine(&self.core.meta_module())
            .map_err(|error| Reject::Robot(error.into()))?;
        self.core.job = Some(Job::SetRobot {
            link: self.link,
            machine,
        });
        Ok(Outcome::Pending)
    }

    fn robot(&mut self) -> Result<WireRobot, Reject> {
        let told = self.core.settings.machine;
        Ok(WireRobot::from(&told.unwrap_or(self.core.built_as)))
    }

    fn drivers(&mut self) -> Drivers {
        let motors = &self.core.motors;
        let profile = self.core.settings.drivers;
        // Until the next cycle goes over to a new profile, what is known is of the old one. At most one per joint.
        let known = motors.wrong().filter(|_| motors.info().profile == profile);
        (profile, known.collect())
    }
}

fn reset_cause(core: &Core) -> ResetCause {
    use crate::ports::ResetCause as Cause;
    match core.cause {
        Cause::PowerOn => ResetCause::PowerOn,
        Cause::BrownOut => ResetCause::BrownOut,
        Cause::Pin => ResetCause::Pin,
        Cause::Watchdog => ResetCause::Watchdog,
        Cause::Software if core.crash.is_some() => ResetCause::Crash,
        Cause::Software => ResetCause::Software,
        Cause::Other => ResetCause::Unknown,
    }
}

/// The fault record as the link carries it.
pub(crate) fn wire_crash(record: &crash::CrashRecord) -> CrashRecord {
    use protocol::link::CrashKind;
    let mut place = heapless::String::new();
    let skip = record.text.len().saturating_sub(place.capacity());
    // A cut inside a character leaves the text out; paths are ASCII.
    let _ = place.push_str(record.text.get(skip..).unwrap_or(""));
    CrashRecord {
        kind: match record.kind {
            crash::CrashKind::Panic => CrashKind::Panic,
            crash::CrashKind::HardFault => CrashKind::HardFault,
            crash::CrashKind::StackOverflow => CrashKind::StackOverflow,
            crash::CrashKind::Nmi => CrashKind::Nmi,
        },
        uptime_us: record.t_us,
        pc: record.pc,
        lr: record.lr,
        detail: record.detail,
        place,
    }
}

/// The boot event.
pub(crate) fn boot_event(core: &Core) -> EventKind {
    EventKind::Boot {
        cause: reset_cause(core),
    }
}
