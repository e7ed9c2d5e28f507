//! Boot from flash, and the background work that writes it.

use super::core::{Core, Job, Settings, Stored};
use super::dry_run::Progress;
use super::session::{boot_event, wire_crash};
use crate::crash::{BLOCK_BYTES, CrashRecord};
use crate::entropy::EntropyError;
use crate::ports::{ResetCause, SlotStore};
use crate::slots::{CRASH_PAIR, GAIT_SLOTS, SETTINGS_PAIR, SlotError};
use control::gait::Gait;
use control::machine::{MAX_JOINTS, Machine};
use control::supervisor::{Event as SupervisorEvent, Fault};
use protocol::bus::Profile;
use protocol::link::gait::MAX_GAIT;
use protocol::link::{
    Completed, EventKind, KEY_LEN, Key, Reject, StorageFault, StoredGait, WireContact, WireGait,
    WireRobot,
};
use sha2::Digest as _;

/// Clearance that every move of an uploaded gait keeps.
const MARGIN_M: f32 = control::precheck::MARGIN_M;
/// Settings record: format, active slot + 1 or 0, key present, key, number of the drivers' profile, number of what of the robot may meet, its joints or
/// 0 where no host has told them, their no-load speeds.
const SETTINGS_BYTES: usize = SETTINGS_BYTES_2 + 2 + SPEEDS_BYTES;
const SETTINGS_FORMAT: u8 = 3;
const SPEEDS_BYTES: usize = 4 * MAX_JOINTS;
/// As written before there were robots of other than six joints: without what is said of the robot.
const SETTINGS_BYTES_2: usize = 4 + KEY_LEN;
const SETTINGS_FORMAT_2: u8 = 2;
/// As written before there were profiles: without the last byte, and every driver ours.
const SETTINGS_BYTES_1: usize = 3 + KEY_LEN;
const SETTINGS_FORMAT_1: u8 = 1;

/// What the board knows at boot.
#[derive(Debug, Clone)]
pub struct BootFacts {
    /// Why the processor started.
    pub cause: ResetCause,
    /// The chip's unique id.
    pub unique_id: [u8; 12],
    /// Name of the board.
    pub board: &'static str,
    /// Bytes that differ at every boot, or why there are none.
    pub entropy: Result<[u8; 16], EntropyError>,
    /// Whether a debug probe can read the flash.
    pub flash_readable: bool,
    /// Fault record that survived the reset.
    pub crash: Option<CrashRecord>,
    /// Time since boot, us.
    pub now_us: u64,
}

/// The answer of finished work and the link it goes to.
pub(crate) type Finished = (usize, Result<Completed, Reject>);

impl Core {
    pub(crate) fn boot<S: SlotStore>(&mut self, store: &mut S, facts: &BootFacts) {
        self.now_us = facts.now_us;
        self.cause = facts.cause;
        self.board = facts.board;
        let drawn = facts.entropy.ok();
        self.challenge_seed = drawn.map(|drawn| seed_of(&drawn, &facts.unique_id));
        self.flash_readable = facts.flash_readable;
        let hash = sha2::Sha256::new().chain_update(facts.unique_id).finalize();
        self.robot_id = hash.first().map_or(1, |byte| byte % 254 + 1);
        let hash = sha2::Sha256::new()
            .chain_update(b"rb boot")
            .chain_update(drawn.unwrap_or_default())
            .chain_update(facts.unique_id)
            .finalize();
        let boot_id = hash
            .first_chunk::<4>()
            .map_or(1, |bytes| u32::from_le_bytes(*bytes));
        self.boot_id = boot_id.max(1);

        let _ = self.slots.recover(store);
        self.settings = self.read_settings(store);
        self.be(self.settings.machine.unwrap_or(self.built_as));
        for slot in 0..GAIT_SLOTS {
            let stored = self.read_gait(store, slot);
            if let Some(place) = self.gaits.get_mut(slot) {
                *place = stored;
            }
        }
        self.keep_crash(store, facts.crash.as_ref());
        self.event(boot_event(self));
        self.warn_of_readable_key();
        // Never refused: nothing else has happened yet.
        let _ = self.supervise(SupervisorEvent::Booted);
        if self.challenge_seed.is_none() {
            // Shown as a latched fault; clearing it gives no challenge.
            let _ = self.supervise(SupervisorEvent::Fault(Fault::Internal));
        }
    }

    fn read_settings<S: SlotStore>(&self, store: &mut S) -> Settings {
        let mut bytes = [0; SETTINGS_BYTES];
        let read = self.slots.read(store, SETTINGS_PAIR, &mut bytes);
        let (head, told) = bytes.split_at(SETTINGS_BYTES_2);
        let Ok([format, active, keyed, key @ .., drivers]) =
            <[u8; SETTINGS_BYTES_2]>::try_from(head)
        else {
            return Settings::default();
        };
        let drivers = match (read, format) {
            (Ok(SETTINGS_BYTES), SETTINGS_FORMAT) | (Ok(SETTINGS_BYTES_2), SETTINGS_FORMAT_2) => {
                Profile::from_number(drivers)
            }
            (Ok(SETTINGS_BYTES_1), SETTINGS_FORMAT_1) => Some(Profile::Packed),
            _ => return Settings::default(),
        };
        Settings {
            key: (keyed == 1).then_some(Key(key)),
            // One of a later firmware: ours answer to nothing there, and nothing moves.
            drivers: drivers.unwrap_or_default(),
            machine: self.read_robot(told),
            active: active
                .checked_sub(1)
                .filter(|slot| usize::from(*slot) < GAIT_SLOTS),
        }
    }

    /// The robot of the settings. What cannot be is taken as never told.
    fn read_robot(&self, told: &[u8]) -> Option<Machine> {
        let ([contact, joints], speeds) = told.split_first_chunk::<2>()?;
        let mut robot = WireRobot {
            contact: WireContact::from_number(*contact)?,
            speeds_rad_s: heapless::Vec::new(),
        };
        for speed in speeds.chunks_exact(4).take(usize::from(*joints)) {
            let bytes = speed.first_chunk::<4>()?;
            // At most MAX_JOINTS: the record holds no more.
            let _ = robot.speeds_rad_s.push(f32::from_le_bytes(*bytes));
        }
        robot.machine(&self.meta_module()).ok()
    }

    /// A record counts as a gait only when it passes the same checks as an upload, but for those that need the robot: those come at its start.
    fn read_gait<S: SlotStore>(&self, store: &mut S, slot: usize) -> Option<Stored> {
        let mut bytes = [0; MAX_GAIT];
        let len = self.slots.read(store, slot, &mut bytes).ok()?;
        let gait = WireGait::from_bytes(bytes.get(..len)?)?;
        Gait::try_from(&gait).ok()?;
        Some(Stored {
            digest: gait.digest(),
            generation: self.slots.sequence(slot)?,
            gait,
        })
    }

    /// A new record goes to flash, where it outlives the battery; without one the last from flash is shown.
    fn keep_crash<S: SlotStore>(&mut self, store: &mut S, crash: Option<&CrashRecord>) {
        let mut block = [0; BLOCK_BYTES];
        if let Some(record) = crash {
            record.encode(&mut block);
            // A failed write leaves the record in RAM for this life.
            let _ = self.slots.write(store, CRASH_PAIR, &block);
            self.crash = Some(wire_crash(record));
        } else if self.slots.read(store, CRASH_PAIR, &mut block) == Ok(BLOCK_BYTES) {
            self.crash = CrashRecord::decode(&block).as_ref().map(wire_crash);
        }
    }

    /// One step of background work. `None` = nothing to do; `Some(None)` = more to come.
    pub(crate) fn work<S: SlotStore>(&mut self, store: &mut S) -> Option<Option<Finished>> {
        if let Job::Put { link, check, .. } = self.job.as_mut()? {
            let link = *link;
            match check.advance(self.motion.machine(), MARGIN_M) {
                Progress::More => return Some(None),
                Progress::Clear => {}
                Progress::Blocked(blocked) => {
                    self.job = None;
                    let reject = Reject::Collision {
                        body_a: blocked.pair.first,
                        body_b: blocked.pair.last,
                        clearance_um: (blocked.clearance_m * 1e6) as i32,
                    };
                    return Some(Some((link, Err(reject))));
                }
            }
        }
        let job = self.job.take()?;
        Some(Some(self.write_flash(store, job)))
    }

    fn write_flash<S: SlotStore>(&mut self, store: &mut S, job: Job) -> Finished {
        match job {
            Job::Put {
                link,
                slot,
                activate,
                gait,
                ..
            } => (link, self.put(store, slot, activate, gait)),
            Job::Erase { link, slot } => (link, self.erase(store, slot)),
            Job::Activate { link, slot } => {
                (link, self.activate(store, slot).map(|()| Completed::Ack))
            }
            Job::SetKey { link, key } => (link, self.store_key(store, key)),
            Job::SetDrivers { link, profile } => (link, self.store_drivers(store, profile)),
            Job::SetRobot { link, machine } => (link, self.store_robot(store, machine)),
        }
    }

    fn put<S: SlotStore>(
        &mut self,
        store: &mut S,
        slot: usize,
        activate: bool,
        gait: WireGait,
    ) -> Result<Completed, Reject> {
        self.battery_allows()?;
        let digest = gait.digest();
        let mut bytes = [0; MAX_GAIT];
        self.slots
            .write(store, slot, gait.to_bytes(&mut bytes))
            .map_err(storage)?;
        let stored = self
            .read_gait(store, slot)
            .filter(|stored| stored.digest == digest);
        let stored = stored.ok_or(Reject::Storage {
            fault: StorageFault::ReadBack,
        })?;
        if let Some(place) = self.gaits.get_mut(slot) {
            *place = Some(stored);
        }
        // Fits: slot < GAIT_SLOTS.
        let number = slot as u8;
        self.event(EventKind::GaitStored {
            slot: number,
            digest,
        });
        if activate && self.settings.active != Some(number) {
            self.activate(store, slot)?;
        }
        let active = self.settings.active == Some(number);
        Ok(Completed::GaitStored(StoredGait {
            slot: number,
            digest,
            active,
        }))
    }

    fn erase<S: SlotStore>(&mut self, store: &mut S, slot: usize) -> Result<Completed, Reject> {
        self.slots.erase(store, slot).map_err(storage)?;
        if let Some(place) = self.gaits.get_mut(slot) {
            *place = None;
        }
        self.event(EventKind::SlotErased { slot: slot as u8 });
        Ok(Completed::Ack)
    }

    fn activate<S: SlotStore>(&mut self, store: &mut S, slot: usize) -> Result<(), Reject> {
        self.store_settings(
            store,
            Settings {
                active: Some(slot as u8),
                ..self.settings
            },
        )?;
        self.event(EventKind::SlotActivated { slot: slot as u8 });
        Ok(())
    }

    fn store_key<S: SlotStore>(&mut self, store: &mut S, key: Key) -> Result<Completed, Reject> {
        self.store_settings(
            store,
            Settings {
                key: Some(key),
                ..self.settings
            },
        )?;
        self.event(EventKind::KeySet);
        self.warn_of_readable_key();
        Ok(Completed::Ack)
    }

    /// Stores a profile; the next cycle goes over to it.
    fn store_drivers<S: SlotStore>(
        &mut self,
        store: &mut S,
        profile: Profile,
    ) -> Result<Completed, Reject> {
        self.store_settings(
            store,
            Settings {
                drivers: profile,
                ..self.settings
            },
        )?;
        Ok(Completed::Ack)
    }

    /// Stores a robot; the next cycle goes over to it.
    fn store_robot<S: SlotStore>(
        &mut self,
        store: &mut S,
        machine: Machine,
    ) -> Result<Completed, Reject> {
        self.store_settings(
            store,
            Settings {
                machine: Some(machine),
                ..self.settings
            },
        )?;
        Ok(Completed::Ack)
    }

    fn store_settings<S: SlotStore>(
        &mut self,
        store: &mut S,
        settings: Settings,
    ) -> Result<(), Reject> {
        let mut bytes = [0; SETTINGS_BYTES];
        let head = [
            SETTINGS_FORMAT,
            settings.active.map_or(0, |slot| slot.saturating_add(1)),
            u8::from(settings.key.is_some()),
        ];
        let key = settings.key.map_or([0; KEY_LEN], |key| key.0);
        let told = settings.machine.as_ref();
        let robot = [
            settings.drivers as u8,
            told.map_or(0, |machine| WireContact::from(machine.contact()).number()),
            told.map_or(0, Machine::joints),
        ];
        let limits = told.map_or(&[][..], Machine::limits);
        let speeds = limits
            .iter()
            .flat_map(|joint| joint.no_load_speed_rad_s.to_le_bytes());
        let all = head.into_iter().chain(key).chain(robot).chain(speeds);
        for (place, byte) in bytes.iter_mut().zip(all) {
            *place = byte;
        }
        self.slots
            .write(store, SETTINGS_PAIR, &bytes)
            .map_err(storage)?;
        self.settings = settings;
        Ok(())
    }
}

/// Seed of a boot's challenges: what the generator gave, and which chip this is. Two robots share no challenge, even if their generators agree.
fn seed_of(drawn: &[u8; 16], unique_id: &[u8; 12]) -> [u8; 16] {
    let hash = sha2::Sha256::new()
        .chain_update(b"rb seed")
        .chain_update(drawn)
        .chain_update(unique_id)
        .finalize();
    let mut seed = [0; 16];
    for (place, byte) in seed.iter_mut().zip(hash) {
        *place = byte;
    }
    seed
}

fn storage(error: SlotError) -> Reject {
    let fault = match error {
        SlotError::Flash => StorageFault::Write,
        SlotError::NoSuchSlot | SlotError::TooLong | SlotError::Empty => StorageFault::Damaged,
    };
    Reject::Storage { fault }
}
