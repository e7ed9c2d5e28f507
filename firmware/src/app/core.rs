//! State of the application and the few functions every part of it uses.

use super::dry_run::DryRun;
use super::events::EventLog;
use super::motors::Motors;
use super::run::Run;
use super::timing::Timing;
use super::types::{BoardInputs, LINKS, Outgoing};
use crate::ports::ResetCause;
use crate::slots::{GAIT_SLOTS, Slots};
use control::machine::{Contact, Machine};
use control::motion::MotionParams;
use control::robot::RobotModel;
use control::supervisor::{
    Command, Event as SupervisorEvent, Supervisor, SupervisorParams, Transition,
};
use protocol::bus::Profile;
use protocol::link::message::MAX_BUS_BYTES;
use protocol::link::telemetry::SampleLog;
use protocol::link::{
    CrashRecord, Digest, EventKind, Fault, FaultInfo, Key, ModuleState, Nonce, Reject, RunEnd,
    Sample, TelemetryRate, WireContact, WireGait,
};
use sha2::Digest as _;

/// Battery below which no run starts and nothing is written to flash, mV: 2 cells at 3.3 V. The board measures one pack of 2 cells, however
/// the packs are wired; the supply of the motors is `supply.voltage_v` of the robot model, which may be that of two packs.
pub const ARM_MV: u16 = 6_600;
/// Battery below which a run stops, mV: 2 cells at 3.1 V under load; the drivers give up at 6.0 V.
pub const STOP_MV: u16 = 6_200;
/// Readings in a row below [`STOP_MV`] that stop a run: a single dip is a step of six motors at once.
pub const LOW_READINGS: u8 = 10;
/// Telemetry blocks kept: 72 x 496 bytes = 35 KiB of the 96 KiB of RAM.
pub const BLOCKS: usize = 72;
/// Frames of a host within a run that show that it keeps in touch.
pub const HEARTBEATS: u8 = 5;
/// Silence of the host in a run that is worth an event, us.
pub const LINK_SILENT_US: u64 = 2_000_000;

/// A stored gait, kept in RAM so that no order has to touch the flash while the robot moves.
#[derive(Debug, Clone)]
pub(crate) struct Stored {
    pub gait: WireGait,
    pub digest: Digest,
    pub generation: u32,
}

/// Background work that ends with an answer on `link`.
#[derive(Debug)]
#[allow(
    clippy::large_enum_variant,
    reason = "no heap to box into; one lives at a time"
)]
pub(crate) enum Job {
    Put {
        link: usize,
        slot: usize,
        activate: bool,
        gait: WireGait,
        check: DryRun,
    },
    Erase {
        link: usize,
        slot: usize,
    },
    Activate {
        link: usize,
        slot: usize,
    },
    SetKey {
        link: usize,
        key: Key,
    },
    SetDrivers {
        link: usize,
        profile: Profile,
    },
    SetRobot {
        link: usize,
        machine: Machine,
    },
}

impl Job {
    /// The link whose host ordered it.
    pub(crate) fn link(&self) -> usize {
        match self {
            Self::Put { link, .. }
            | Self::Erase { link, .. }
            | Self::Activate { link, .. }
            | Self::SetKey { link, .. }
            | Self::SetDrivers { link, .. }
            | Self::SetRobot { link, .. } => *link,
        }
    }
}

/// A raw packet of a host for the motor bus.
#[derive(Debug)]
pub(crate) struct BusJob {
    pub link: usize,
    pub packet: heapless::Vec<u8, MAX_BUS_BYTES>,
    pub listen_ms: u16,
    pub heard: heapless::Vec<u8, MAX_BUS_BYTES>,
    pub overflow: bool,
}

/// What survives a reset besides the gaits.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Settings {
    pub key: Option<Key>,
    pub active: Option<u8>,
    pub drivers: Profile,
    /// The robot that a host has told; without one it is the one the firmware was built for.
    pub machine: Option<Machine>,
}

/// Counts since boot that no other part keeps.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Counts {
    pub bad_tags: u32,
    pub bus_timeouts: u32,
    pub bus_bad_crc: u32,
    pub bus_stray: u32,
    pub holds: u32,
    pub cycles: u32,
    pub samples_dropped: u32,
}

impl Counts {
    const fn new() -> Self {
        Self {
            bad_tags: 0,
            bus_timeouts: 0,
            bus_bad_crc: 0,
            bus_stray: 0,
            holds: 0,
            cycles: 0,
            samples_dropped: 0,
        }
    }
}

/// One host link's session.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Session {
    /// A host has said HELLO.
    pub open: bool,
    /// Next event to send unasked.
    pub next_event: u32,
    /// Live samples outside of a run.
    pub rate: TelemetryRate,
    /// The newest live sample is not yet sent.
    pub live: bool,
    /// Time of the last frame, us since boot.
    pub heard_us: u64,
    /// Frames since the run began.
    pub beats: u8,
    /// It kept in touch and fell silent: blocks wait for it.
    pub silent: bool,
    /// The end of the last run is still to be told.
    pub end_due: bool,
}

impl Session {
    pub(crate) const fn new() -> Self {
        Self {
            open: false,
            next_event: 0,
            rate: TelemetryRate::Off,
            live: false,
            heard_us: 0,
            beats: 0,
            silent: false,
            end_due: false,
        }
    }
}

/// The application without its link servers.
pub struct Core {
    /// Of the robot that is driven.
    pub(crate) motion: MotionParams,
    /// The robot the firmware was built for.
    pub(crate) built_as: Machine,
    pub(crate) model_digest: Digest,
    pub(crate) params: SupervisorParams,
    pub(crate) supervisor: Supervisor,
    pub(crate) motors: Motors,
    pub(crate) events: EventLog,
    pub(crate) telemetry: SampleLog<BLOCKS>,
    /// Samples of this run are kept.
    pub(crate) recording: bool,
    /// A block of the record may go out before the next instant of the grid.
    pub(crate) block_due: bool,
    pub(crate) live: Sample,
    pub(crate) timing: Timing,
    pub(crate) out: Outgoing,
    pub(crate) run: Option<Run>,
    pub(crate) run_link: usize,
    pub(crate) run_end: Option<RunEnd>,
    pub(crate) runs: u16,
    pub(crate) sessions: [Session; LINKS],
    pub(crate) slots: Slots,
    pub(crate) gaits: [Option<Stored>; GAIT_SLOTS],
    pub(crate) settings: Settings,
    pub(crate) job: Option<Job>,
    pub(crate) bus_job: Option<BusJob>,
    pub(crate) crash: Option<CrashRecord>,
    pub(crate) fault: Option<FaultInfo>,
    pub(crate) inputs: BoardInputs,
    pub(crate) low_readings: u8,
    pub(crate) counts: Counts,
    pub(crate) cause: ResetCause,
    pub(crate) board: &'static str,
    pub(crate) robot_id: u8,
    pub(crate) boot_id: u32,
    /// Seed of the challenges, from the generator and the chip's id; without one no challenge is given and nothing is started.
    pub(crate) challenge_seed: Option<[u8; 16]>,
    /// A debug probe can read the flash.
    pub(crate) flash_readable: bool,
    /// Something happened that voids the open challenges of every link.
    pub(crate) void_challenges: bool,
    pub(crate) nonces: u32,
    pub(crate) reboot_at_us: Option<u64>,
    /// The instant on the grid that the cycle under way belongs to, us.
    pub(crate) cycle_us: u64,
    /// Time of what is handled now, us.
    pub(crate) now_us: u64,
}

impl Core {
    /// Constant, because it is too large for the stack: a board keeps it in a static. [`Core::fit`] sets the robot.
    pub(crate) const fn blank() -> Self {
        Self {
            model_digest: Digest([0; 8]),
            motion: MotionParams::STRAIGHT,
            built_as: Machine::meta_module(RobotModel::STRAIGHT),
            params: SupervisorParams::NOMINAL,
            supervisor: Supervisor::new(),
            motors: Motors::new(),
            events: EventLog::new(),
            telemetry: SampleLog::new(),
            recording: false,
            block_due: false,
            live: Sample::ZERO,
            timing: Timing::new(),
            out: Outgoing::new(),
            run: None,
            run_link: 0,
            run_end: None,
            runs: 0,
            sessions: [const { Session::new() }; LINKS],
            slots: Slots::new(),
            gaits: [const { None }; GAIT_SLOTS],
            settings: Settings {
                key: None,
                active: None,
                drivers: Profile::Packed,
                machine: None,
            },
            job: None,
            bus_job: None,
            crash: None,
            fault: None,
            inputs: BoardInputs {
                battery_mv: None,
                stop_pressed: false,
            },
            low_readings: 0,
            counts: Counts::new(),
            cause: ResetCause::PowerOn,
            board: "",
            robot_id: 1,
            boot_id: 1,
            challenge_seed: None,
            flash_readable: false,
            void_challenges: false,
            nonces: 0,
            reboot_at_us: None,
            cycle_us: 0,
            now_us: 0,
        }
    }

    /// Sets robot and motion settings; before the boot.
    pub(crate) fn fit(&mut self, motion: MotionParams) {
        self.motion = motion;
        self.built_as = *motion.machine();
        self.be(self.built_as);
    }

    /// The geometry of a meta-module that the firmware was built with.
    pub(crate) fn meta_module(&self) -> RobotModel {
        self.built_as.model().copied().unwrap_or_default()
    }

    /// Drives this robot from now on; nothing is known of its drivers.
    pub(crate) fn be(&mut self, machine: Machine) {
        self.model_digest = model_digest(&machine);
        self.motion = self.motion.with_machine(machine);
        self.params.joints = machine.joints();
        self.motors.equip(self.settings.drivers, machine.joints());
    }

    /// State as the link names it.
    pub(crate) fn state(&self) -> ModuleState {
        ModuleState::from(&self.supervisor.state())
    }

    pub(crate) fn command(&self) -> Command {
        self.supervisor.command()
    }

    /// Whether anything moves or may move: no flash, no raw bus traffic.
    pub(crate) fn in_motion(&self) -> bool {
        self.command().torque
    }

    pub(crate) fn event(&mut self, kind: EventKind) {
        self.events.push(self.now_us, kind);
    }

    /// A key that anybody with a probe can read is worth a word: at boot, and when it is set.
    pub(crate) fn warn_of_readable_key(&mut self) {
        if self.flash_readable && self.settings.key.is_some() {
            self.event(EventKind::KeyReadable);
        }
    }

    /// Takes one event to the supervisor and notes what came of it.
    pub(crate) fn supervise(&mut self, event: SupervisorEvent) -> Result<(), Reject> {
        if let SupervisorEvent::Fault(fault) = event {
            self.note_fault(fault.into());
        }
        let homed = self.supervisor.homed_mask();
        let step = self.supervisor.step(&self.params, self.now_us, event);
        let lost = homed & !self.supervisor.homed_mask();
        if lost != 0 {
            self.event(EventKind::Unhomed { mask: lost });
        }
        self.note_transition(&step);
        match step.refusal {
            Some(refusal) => Err(Reject::from_refusal(refusal, self.state())),
            None => Ok(()),
        }
    }

    fn note_transition(&mut self, step: &Transition) {
        let (from, to) = (ModuleState::from(&step.from), ModuleState::from(&step.to));
        if from == to {
            return;
        }
        self.event(EventKind::State { from, to });
        if let control::supervisor::State::Fault { fault, .. } = step.to {
            // A driver reset in motion becomes a fault inside the supervisor.
            self.note_fault(fault.into());
        }
        if from == ModuleState::Fault && !matches!(to, ModuleState::EStop) {
            self.fault = None;
            self.event(EventKind::FaultCleared);
        }
    }

    fn note_fault(&mut self, fault: Fault) {
        match &mut self.fault {
            Some(info) if info.fault == fault => info.count = info.count.saturating_add(1),
            // The first one stays what `Info` shows, until it is cleared.
            Some(_) => {}
            None => {
                let info = FaultInfo {
                    fault,
                    first_us: self.now_us,
                    count: 1,
                };
                self.fault = Some(info);
                self.event(EventKind::Fault(info));
            }
        }
    }

    /// A fault that only counts while something moves.
    pub(crate) fn fault_in_motion(&mut self, fault: control::supervisor::Fault) {
        if self.in_motion() {
            // Fault events are never refused.
            let _ = self.supervise(SupervisorEvent::Fault(fault));
        }
    }

    /// Sixteen bytes from the boot's seed and a counter: different every time, not to be foreseen without the seed.
    pub(crate) fn fresh_nonce(&mut self) -> Result<Nonce, Reject> {
        let seed = self.challenge_seed.ok_or(Reject::NoEntropy)?;
        self.nonces = self.nonces.wrapping_add(1);
        let hash = sha2::Sha256::new()
            .chain_update(b"rb nonce")
            .chain_update(seed)
            .chain_update(self.nonces.to_le_bytes())
            .finalize();
        let mut nonce = [0; 16];
        for (place, byte) in nonce.iter_mut().zip(hash) {
            *place = byte;
        }
        Ok(Nonce(nonce))
    }

    /// The link whose host has something under way: a run, a flash job, a packet on the bus.
    pub(crate) fn holder(&self) -> Option<usize> {
        let run = self.run.as_ref().map(|run| run.link);
        let job = self.job.as_ref().map(Job::link);
        run.or(job).or(self.bus_job.as_ref().map(|job| job.link))
    }

    /// Refuses what would write flash: while something moves, while other work is under way, on a low battery.
    pub(crate) fn may_write(&self) -> Result<(), Reject> {
        if self.in_motion() {
            return Err(Reject::State {
                state: self.state(),
            });
        }
        if self.job.is_some() || self.bus_job.is_some() {
            return Err(Reject::Busy);
        }
        self.battery_allows()
    }

    pub(crate) fn battery_allows(&self) -> Result<(), Reject> {
        match self.inputs.battery_mv {
            Some(battery_mv) if battery_mv < ARM_MV => Err(Reject::Battery {
                battery_mv,
                needed_mv: ARM_MV,
            }),
            _ => Ok(()),
        }
    }
}

/// First 8 bytes of SHA-256 over the model's numbers, little endian, in the order of the struct. A robot without a model has the number of what
/// may meet in the model's place.
fn model_digest(machine: &Machine) -> Digest {
    let mut hash = sha2::Sha256::new();
    match machine.contact() {
        Contact::MetaModule(model) => {
            let params = model.params();
            for value in [params.twist_rad, params.cube_m, params.ball_radius_m] {
                hash.update(value.to_le_bytes());
            }
        }
        other => hash.update([WireContact::from(other).number()]),
    }
    for joint in machine.limits() {
        hash.update(joint.no_load_speed_rad_s.to_le_bytes());
    }
    let mut digest = [0; 8];
    for (place, byte) in digest.iter_mut().zip(hash.finalize()) {
        *place = byte;
    }
    Digest(digest)
}
