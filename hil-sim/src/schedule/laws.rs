//! The laws, looked at from the motors' side of the wire: what the module sent, what the drivers do, what the
//! hosts were told.
//!
//! Nothing here asks the firmware. Positions, distances and the meaning of packets are computed again.

mod orders;
mod stops;
mod zeros;

use super::desk::{Note, Record};
use super::reading::{EDGE_M, end_cubes_apart_m, read_packet};
use super::wire::{Sent, Watched};
use crate::robot::ideal::IdealMotors;
use control::motion::MotionParams;
use control::precheck::{Margins, Verdict};
use orders::Grant;
use protocol::bus::{Instruction, Register};
use protocol::link::{Digest, RunEnd};
use std::fmt;
use stops::Stops;

/// Joints of the robot.
const JOINTS: usize = 6;
/// A cycle, us: 20 Hz (the paper).
const CYCLE_US: u64 = 50_000;
/// From a reason to let go, or a restart of a driver, to torque off on a clean bus, us: one cycle, and 3 ms for its packets.
pub(crate) const OFF_US: u64 = 53_000;
/// Ramp and hold of a run that is stopped, us. At a rate of 6 1/s 0.25 rad are below 1 mrad after 0.92 s; a second
/// of hold follows,
/// and another one when a fault strikes in it. All begin and end on the grid of cycles.
const REST_US: u64 = 3_250_000;
/// Set-points leave within this time after a reading was asked for, us: half a cycle.
const SAME_CYCLE_US: u64 = 25_000;
/// A driver that gave no new measurement for three cycles gets no set-point, us; the reading of the fourth is over
/// 25 ms later.
const STALE_US: u64 = 3 * CYCLE_US + SAME_CYCLE_US;
/// Rounding of set-points, f32 angles and wire counts, urad.
const ROUNDING_URAD: i64 = 30;

/// A law that did not hold.
#[derive(Debug, Clone, PartialEq)]
pub struct Violation {
    /// Which.
    pub law: Law,
    /// When, us of virtual time.
    pub at_us: u64,
    /// What was seen.
    pub what: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at_s = self.at_us as f64 * 1e-6;
        write!(f, "{:?} at {at_s:.4} s: {}", self.law, self.what)
    }
}

/// The laws.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Law {
    /// No set-point leads to an overlap, and every move was one that the pre-check certifies.
    Checked,
    /// No set-point is further from the one before than a joint turns in a cycle.
    Reachable,
    /// No set-point is older than its cycle, or built on readings of a silent driver.
    Fresh,
    /// Torque and set-points only by an order of this boot that no STOP has voided; one run for one order.
    Ordered,
    /// After a STOP that arrived whole no torque goes on, and nothing moves but the ramp.
    Stops,
    /// Torque only for a robot, and set-points only for a joint, whose zero was set since it was lost.
    Homed,
    /// Torque is off 53 ms after STOP, the end of the run, of the lease, of the hold, or a restart.
    LetGo,
    /// A driver with torque lets go by itself when the module is silent.
    Guarded,
    /// A slot holds the old gait or the new one.
    Stored,
    /// The record of a run is whole to its last sample.
    Recorded,
    /// The module restarts only when something made it.
    Alive,
    /// When the faults are gone, the robot runs again.
    ComesBack,
}

/// What a slot may hold.
#[derive(Debug, Clone, Default)]
struct Slot {
    certain: Option<Digest>,
    /// Uploads without an answer, by host.
    possible: Vec<(usize, Digest)>,
}

/// Everything the laws remember.
#[derive(Debug)]
pub(crate) struct Laws {
    motion: MotionParams,
    keyed: bool,
    /// Where each encoder stands at the home pose, urad.
    pub(crate) home_urad: [i32; JOINTS],
    goals: [Option<i32>; JOINTS],
    /// What the module sent each driver, and when, us: for the record.
    sent_goals: Vec<(u64, usize, i32)>,
    read_us: u64,
    torque_asked: bool,
    runs: u64,
    orders: u64,
    grants: Vec<Grant>,
    /// Every STOP that went into the module since its last restart: number, time, us.
    stops_in: Vec<(u64, u64)>,
    stops: Stops,
    /// Every order to set zeros of this boot: joints, time, us.
    zeros: Vec<(u16, u64)>,
    /// When the last STOP that was acknowledged or is certain first went into the module, us: what was ordered before is void.
    stopped_us: u64,
    /// Since when nobody may have torque, unless an order says so, us.
    lapsed_us: u64,
    /// Until when bus, task or drivers were disturbed, us.
    disturbed_us: u64,
    slots: [Slot; 8],
    last_end: Option<(u32, RunEnd)>,
    /// When each driver restarted, us.
    lost_us: [Option<u64>; JOINTS],
    /// Until when each driver heard nothing, us.
    deaf_us: [u64; JOINTS],
    /// Whether encoders jumped: the set-points of the record are then in a frame that nobody but the module knows.
    pub(crate) jumped: bool,
    /// Whether packets on the bus overtake each other: the one that clears a watchdog may then come after the one
    /// that was read back.
    pub(crate) disordered: bool,
    /// Runs that came to their end, whole records, set-points looked at.
    pub(crate) counts: Counts,
    /// The first law that did not hold.
    pub(crate) broken: Option<Violation>,
}

/// How much was looked at.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Set-point packets.
    pub set_points: u64,
    /// Times torque was switched on for a run.
    pub runs: u64,
    /// Records that were compared whole.
    pub records: u64,
    /// Uploads that were acknowledged.
    pub uploads: u64,
    /// Times that torque had to be off.
    pub offs: u64,
    /// STOPs that had to take effect, whatever the answer.
    pub stops: u64,
    /// Runs to their end after the faults.
    pub completed: u64,
}

impl Counts {
    /// Adds those of another schedule.
    pub(crate) fn add(&mut self, other: &Self) {
        self.set_points += other.set_points;
        self.runs += other.runs;
        self.records += other.records;
        self.uploads += other.uploads;
        self.offs += other.offs;
        self.stops += other.stops;
        self.completed += other.completed;
    }
}

impl Laws {
    /// Nothing seen yet.
    #[must_use]
    pub(crate) fn new(keyed: bool, home_urad: [i32; JOINTS], held: &[(usize, Digest)]) -> Self {
        let mut slots: [Slot; 8] = Default::default();
        for (slot, digest) in held {
            slots[*slot].certain = Some(*digest);
        }
        Self {
            motion: MotionParams::default(),
            keyed,
            home_urad,
            goals: [None; JOINTS],
            sent_goals: Vec::new(),
            read_us: 0,
            torque_asked: false,
            runs: 0,
            orders: 0,
            grants: Vec::new(),
            stops_in: Vec::new(),
            stops: Stops::default(),
            zeros: Vec::new(),
            stopped_us: 0,
            lapsed_us: 0,
            disturbed_us: 0,
            slots,
            last_end: None,
            lost_us: [None; JOINTS],
            deaf_us: [0; JOINTS],
            jumped: false,
            disordered: false,
            counts: Counts::default(),
            broken: None,
        }
    }

    /// Notes a violation; the first one stays.
    pub(crate) fn break_law(&mut self, law: Law, at_us: u64, what: String) {
        self.broken.get_or_insert(Violation { law, at_us, what });
    }

    /// The module restarted.
    pub(crate) fn restarted(&mut self, at_us: u64) {
        self.grants.clear();
        self.stops_in.clear();
        self.zeros.clear();
        self.forget_stops();
        (self.runs, self.orders) = (0, 0);
        self.torque_asked = false;
        self.goals = [None; JOINTS];
        self.lapsed_us = at_us;
        self.disturb(at_us);
    }

    /// Bus, task or drivers are disturbed until then; no disturbance ends another.
    pub(crate) fn disturb(&mut self, until_us: u64) {
        self.disturbed_us = self.disturbed_us.max(until_us);
    }

    /// The STOP input is released. It was seen if it was down for a cycle: then no earlier order counts any more.
    pub(crate) fn stop_released(&mut self, pressed_us: u64, now_us: u64) {
        if now_us - pressed_us > OFF_US {
            self.grants.clear();
            self.lapsed_us = self.lapsed_us.max(pressed_us);
        }
    }

    /// A host was told something.
    pub(crate) fn noted(&mut self, host: usize, note: &Note, record: &Record, now_us: u64) {
        match note {
            Note::Stopped(number) => self.stopped(*number, now_us),
            Note::Ended(boot, end) => self.last_end = Some((*boot, *end)),
            Note::Uploading(slot, digest) => {
                self.slots[usize::from(*slot)]
                    .possible
                    .push((host, *digest));
            }
            Note::Stored(slot, digest) => {
                self.counts.uploads += 1;
                let slot = &mut self.slots[usize::from(*slot)];
                slot.certain = Some(*digest);
                // A host has one upload under way at a time.
                slot.possible.retain(|(by, _)| *by != host);
            }
            Note::Drained(boot, run) => self.whole(*boot, *run, record, now_us),
            Note::Completed(end, duration_ms) => {
                self.counts.completed += 1;
                let want = duration_ms / 50;
                if end.cycles != want {
                    let what = format!("{} cycles of {want}", end.cycles);
                    self.break_law(Law::ComesBack, now_us, what);
                }
            }
        }
    }

    /// The record of a run whose end was told.
    fn whole(&mut self, boot: u32, run: u16, record: &Record, now_us: u64) {
        let end = self
            .last_end
            .filter(|(of, end)| (*of, end.run) == (boot, run));
        let Some((_, end)) = end.filter(|_| (record.boot, record.run) == (boot, run)) else {
            return;
        };
        self.counts.records += 1;
        let wanted = u64::from(end.samples - end.dropped.min(end.samples));
        let got = record.samples.len() as u64;
        let mut fault = record.damaged.clone();
        if got != wanted {
            fault = Some(format!(
                "{got} of {wanted} samples, {} dropped",
                end.dropped
            ));
        }
        let times: Vec<u64> = record.samples.values().map(|sample| sample.0).collect();
        if !times.is_sorted_by(|a, b| a < b) {
            fault = Some("times that do not rise".to_owned());
        }
        if let Some(what) = self.differs(record).filter(|_| !self.jumped) {
            fault = Some(what);
        }
        if let Some(what) = fault {
            self.break_law(Law::Recorded, now_us, format!("run {run}: {what}"));
        }
    }

    /// Whether the record shows a set-point that was not the last one sent.
    fn differs(&self, record: &Record) -> Option<String> {
        use protocol::link::telemetry::flags;
        for (index, (t_us, goals, bits)) in &record.samples {
            if bits & flags::NEW_SETPOINT == 0 {
                continue;
            }
            for (joint, recorded) in goals.iter().enumerate() {
                let before = self.sent_goals.iter().rev();
                let mut before = before.filter(|(at, j, _)| *j == joint && *at <= *t_us);
                let sent = before.next().map(|(_, _, raw)| raw - self.home_urad[joint]);
                if sent.is_some_and(|sent| sent != *recorded) {
                    return Some(format!(
                        "sample {index}, joint {joint}: {recorded} urad recorded, {sent:?} sent"
                    ));
                }
            }
        }
        None
    }

    /// A driver restarted: its encoder begins to count at 0 where the joint stands.
    pub(crate) fn encoder_lost(&mut self, now_us: u64, joint: usize, stood_urad: i32) {
        self.lost_us[joint] = Some(now_us);
        self.home_urad[joint] = self.home_urad[joint].saturating_sub(stood_urad);
        self.goals[joint] = None;
        self.sent_goals.retain(|(_, j, _)| *j != joint);
    }

    /// The user has put a joint into the home pose.
    pub(crate) fn placed(&mut self, joint: usize, home_urad: i32) {
        self.home_urad[joint] = home_urad;
        self.goals[joint] = None;
    }

    /// What the module has sent since the last look.
    pub(crate) fn sent(&mut self, bus: &mut Watched, troubled: impl Fn(usize) -> bool) {
        for packet in std::mem::take(&mut bus.sent) {
            self.packet(&packet, &troubled);
        }
    }

    fn packet(&mut self, packet: &Sent, troubled: impl Fn(usize) -> bool) {
        let at_us = packet.at_us;
        self.obey_stops(at_us);
        let Some((instruction, address, values)) = read_packet(&packet.bytes) else {
            self.break_law(
                Law::Checked,
                at_us,
                format!("no packet: {:02x?}", packet.bytes),
            );
            return;
        };
        if instruction == Instruction::SyncRead as u8
            || instruction == Instruction::FastSyncRead as u8
        {
            self.read_us = at_us;
        }
        if instruction != Instruction::SyncWrite as u8 {
            return;
        }
        if address == Register::TorqueEnable.address() {
            self.torque(packet, &values);
        } else if address == Register::GoalAngle.address() {
            self.set_points(packet, &values, troubled);
        }
    }

    fn authorised(&self, at_us: u64) -> bool {
        self.grants
            .iter()
            .any(|grant| at_us >= grant.at_us && at_us <= grant.until_us() + OFF_US)
    }

    fn torque(&mut self, packet: &Sent, values: &[(usize, i32)]) {
        let at_us = packet.at_us;
        let on = values.iter().any(|(_, value)| *value == 1);
        if on && !self.torque_asked {
            self.runs += 1;
            self.counts.runs += 1;
            self.goals = [None; JOINTS];
            let orders = self.orders;
            if self.runs > orders {
                let what = format!("{} runs after {orders} orders", self.runs);
                self.break_law(Law::Ordered, at_us, what);
            }
        }
        if on {
            if !self.authorised(at_us) {
                self.break_law(Law::Ordered, at_us, "torque on without an order".to_owned());
            }
            self.torque_after_stop(at_us);
            self.torque_without_zero(packet);
        }
        let off = values.iter().filter(|(_, value)| *value == 0);
        let off = off.filter_map(|(joint, _)| self.goals.get_mut(*joint).map(|goal| *goal = None));
        // One driver that is let go ends no run.
        let all_off = off.count() == JOINTS;
        self.torque_asked = on || self.torque_asked && !all_off;
    }

    fn set_points(
        &mut self,
        packet: &Sent,
        values: &[(usize, i32)],
        troubled: impl Fn(usize) -> bool,
    ) {
        let at_us = packet.at_us;
        self.counts.set_points += 1;
        if !self.authorised(at_us) {
            self.break_law(Law::Ordered, at_us, "set-point without an order".to_owned());
        }
        if at_us - self.read_us > SAME_CYCLE_US {
            let late_us = at_us - self.read_us;
            self.break_law(Law::Fresh, at_us, format!("{late_us} us after the reading"));
        }
        self.set_points_without_zero(packet, values);
        let other = |(joint, goal): &(usize, i32)| {
            let before = self.goals.get(*joint).copied().flatten();
            before.is_some_and(|before| before != *goal)
        };
        if values.iter().any(other) {
            self.move_after_stop(at_us);
        }
        let from = self.pose(&self.goals, packet);
        let (mut next, mut moving, mut blind) = (self.goals, false, false);
        for (joint, goal) in values {
            let (joint, goal) = (*joint, *goal);
            if joint >= JOINTS {
                continue;
            }
            let here = self.goals[joint].unwrap_or(packet.stood_urad[joint]);
            // Before torque each driver is sent where it stands, by a reading that may be of a moment ago.
            moving |= packet.torque[joint] || self.goals[joint].is_some();
            let heard = packet.heard_us[joint];
            let lost = self.unheard(joint, packet);
            blind |= lost;
            let step = (i64::from(goal) - i64::from(here)).abs();
            if step > most_urad(joint) && !self.jumped && !lost && !troubled(joint) {
                let what = format!("joint {joint}: {step} urad from the last one");
                self.break_law(Law::Reachable, at_us, what);
            }
            let clear = at_us > self.disturbed_us + STALE_US;
            if clear && heard.is_none_or(|heard| at_us - heard > STALE_US) {
                let what = format!("joint {joint} gave its last measurement at {heard:?} us");
                self.break_law(Law::Fresh, at_us, what);
            }
            // A set-point in the frame that its driver has just lost: it has no torque, and stands where it stood.
            next[joint] = (!lost).then_some(goal);
            if !lost {
                self.sent_goals.push((at_us, joint, goal));
            }
        }
        if moving && !blind {
            let to = self.pose(&next, packet);
            self.checked(at_us, &from, &to);
        }
        self.goals = next;
    }

    /// Whether a driver has restarted and the module cannot know it: no reading since then has reached it whole, and one that was under way then
    /// says nothing of it. Such a driver has no torque, so no set-point moves it. After three cycles without a reading it counts as lost.
    fn unheard(&self, joint: usize, packet: &Sent) -> bool {
        let limp = !packet.torque[joint] || self.disordered;
        let unknown = |lost_us: u64| {
            let age_us = packet.at_us - lost_us;
            let heard = packet.heard_us[joint].is_some_and(|heard| heard >= lost_us);
            age_us < CYCLE_US || !heard && age_us <= STALE_US
        };
        limp && self.lost_us[joint].is_some_and(unknown)
    }

    /// Angles from the home pose, rad.
    fn pose(&self, goals: &[Option<i32>; JOINTS], packet: &Sent) -> [f64; JOINTS] {
        std::array::from_fn(|joint| {
            let raw = goals[joint].unwrap_or(packet.stood_urad[joint]);
            f64::from(raw.saturating_sub(self.home_urad[joint])) * 1e-6
        })
    }

    fn checked(&mut self, at_us: u64, from: &[f64; JOINTS], to: &[f64; JOINTS]) {
        if self.jumped {
            return;
        }
        let apart_m = end_cubes_apart_m(to[2], to[3]);
        if apart_m < EDGE_M {
            let what = format!("cubes 1 and 4 are {apart_m:.4} m apart");
            self.break_law(Law::Checked, at_us, what);
        }
        // Balls of the cubes' circumradius further apart than twice 62 mm and the margin: nothing can touch.
        if apart_m > 0.2 || from == to {
            return;
        }
        let [from, to] = [from, to].map(|pose| pose.map(|angle_rad| angle_rad as f32));
        // Half of the margins that the module keeps: wire counts round.
        let margins = self.motion.settings().planned;
        let margins = Margins {
            keep_m: margins.keep_m * 0.5,
            escape_m: margins.escape_m * 0.5,
        };
        let machine = self.motion.machine();
        if let Verdict::Blocked(blocked) = machine.check_move(&from.into(), &to.into(), margins) {
            let what = format!("a move that the pre-check blocks: {blocked:?}");
            self.break_law(Law::Checked, at_us, what);
        }
    }

    /// The drivers, at any time. `deaf`: drivers that hear nothing.
    pub(crate) fn look(
        &mut self,
        now_us: u64,
        motors: &IdealMotors,
        stop_us: Option<u64>,
        deaf: impl Fn(usize) -> bool,
    ) {
        self.obey_stops(now_us);
        let until = self.grants.iter().map(Grant::until_us).max();
        let mut off_us = self.lapsed_us.max(until.unwrap_or(0));
        if let Some(stop_us) = stop_us {
            off_us = off_us.min(stop_us.max(self.lapsed_us));
        }
        for joint in 0..JOINTS {
            if deaf(joint) {
                self.deaf_us[joint] = now_us;
            }
            // One that heard nothing is told in the cycle after it is back: until then nobody but its own watchdog can take its torque.
            let reached_us = self.disturbed_us.max(self.deaf_us[joint]);
            let due_us = off_us.max(reached_us) + OFF_US + 1_000;
            // A driver that restarts just before torque-on has forgotten its watchdog. When both readings after it are lost on the wire,
            // the one of the next cycle tells of it, and its packets let it go.
            let lost = self.lost_us[joint].is_some_and(|lost| now_us - lost < OFF_US);
            let bare = motors.torque(joint) && !motors.has_watchdog(joint);
            if bare && !lost && !self.disordered {
                let what = format!("driver {joint} has torque and no watchdog");
                self.break_law(Law::Guarded, now_us, what);
            }
            if now_us < due_us {
                continue;
            }
            self.counts.offs += 1;
            if motors.is_driving(joint) {
                let what = format!("driver {joint} still drives, due at {due_us} us");
                self.break_law(Law::LetGo, now_us, what);
            }
        }
    }

    /// What a slot holds after a restart.
    pub(crate) fn holds(&mut self, now_us: u64, slot: usize, digest: Option<Digest>) {
        let allowed = &self.slots[slot];
        let fits = digest == allowed.certain
            || allowed
                .possible
                .iter()
                .any(|(_, maybe)| Some(*maybe) == digest);
        if !fits {
            let what = format!("slot {slot} holds {digest:?}, allowed {allowed:?}");
            self.break_law(Law::Stored, now_us, what);
        }
    }
}

/// Largest step of a set-point, urad: no-load speed (26.6 and 19.4 rpm, the paper's Table I) for a cycle.
fn most_urad(joint: usize) -> i64 {
    let rpm = if joint % 3 == 1 { 19.4 } else { 26.6 };
    let rad_s = rpm / 60.0 * core::f64::consts::TAU;
    (rad_s * CYCLE_US as f64) as i64 + ROUNDING_URAD
}

#[cfg(test)]
mod tests;
