//! What the module knows of its drivers, and what it believes.
//!
//! A CRC-16 lets one wrong frame through every few hours on a noisy wire, so no reading is believed on its checksum
//! alone: each must fit the one before. What does not fit becomes a [`Finding`], never a command.

use super::setup::Setup;
use control::machine::{Angles, MAX_JOINTS};
use control::robot::JointLimits;
use protocol::bus::feedback::status;
use protocol::bus::{PackedFeedback, Profile, ProfileInfo};
use protocol::link::WrongDriver;
use protocol::units;

/// Cycles without an answer after which a driver counts as lost: its own bus watchdog trips at the same time.
pub const LOST_CYCLES: u8 = 3;
/// A joint may turn this much faster than its no-load speed before a reading counts as a jump: full battery (8.4 V
/// against 7.4 V nominal) and overshoot.
const SPEED_MARGIN: f32 = 1.5;
/// Added to the largest plausible step, rad: quantisation and the play of a worn gear.
const STEP_MARGIN_RAD: f32 = 0.03;
/// An applied set-point this close to one that was sent is the one that was sent, urad: drivers may quantise
/// (X-series: 1534 urad).
const ECHO_TOLERANCE_URAD: i32 = 3_200;
/// Set-points remembered per driver: a driver behind a slow transport may apply one that is 0.4 s old.
const SENT_KEPT: usize = 8;
/// Readings in a row with a foreign set-point that stop the robot.
const ECHO_CYCLES: u8 = 3;
/// Readings over which a joint is watched for a stall: 1 s at 20 Hz.
const STALL_READINGS: u8 = 20;
/// A set-point that travels this far within them, urad: the smallest travel beyond any backlash and deadband of a worn gear.
const STALL_TRAVEL_URAD: i32 = 150_000;
/// ... while the joint stays within this, urad: a tenth of what a joint with heavy stiction still makes of it.
const STALL_STAYS_URAD: i32 = 10_000;
/// Oldest reading that becomes a zero, us: one of the cycle before, while this one reads. Before an older one the task stood still, and the joint
/// may have been placed since.
const ZERO_AGE_US: u64 = 2 * control::CYCLE_US;

/// Something about a driver that the supervisor or the host must know.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finding {
    /// It answers (again).
    Found,
    /// It did not answer for [`LOST_CYCLES`] cycles.
    Lost,
    /// It restarted: zero and settings are gone.
    Reset,
    /// It reports a hardware error.
    HardwareError,
    /// The position moved further than the joint can turn.
    Jump,
    /// It applies a set-point that was not sent.
    WrongSetPoint {
        /// Last one sent, urad in the joint's frame.
        sent_urad: i32,
        /// What it applies, urad in the joint's frame.
        applied_urad: i32,
        /// Seen often enough to stop.
        certain: bool,
    },
    /// The set-point travels, the joint does not.
    Stall,
}

/// Findings of one reading: at most one of each kind.
pub type Findings = heapless::Vec<Finding, 7>;

/// Smallest and largest of a row of angles, urad.
#[derive(Debug, Clone, Copy)]
struct Extent {
    min: i32,
    max: i32,
}

impl Extent {
    const fn new() -> Self {
        Self {
            min: i32::MAX,
            max: i32::MIN,
        }
    }

    fn take(&mut self, angle_urad: i32) {
        self.min = self.min.min(angle_urad);
        self.max = self.max.max(angle_urad);
    }

    fn span(&self) -> u32 {
        self.max.abs_diff(self.min)
    }
}

/// Readings of the last second or less.
#[derive(Debug, Clone, Copy)]
struct Watch {
    readings: u8,
    applied: Extent,
    position: Extent,
}

impl Watch {
    const fn new() -> Self {
        Self {
            readings: 0,
            applied: Extent::new(),
            position: Extent::new(),
        }
    }
}

/// One driver.
#[derive(Debug, Clone)]
pub struct Motor {
    /// Last reading that was believed, driver's frame.
    last: Option<PackedFeedback>,
    last_us: u64,
    zero_urad: i32,
    /// Set-points in the driver's frame, newest last.
    sent: heapless::Deque<i32, SENT_KEPT>,
    misses: u8,
    lost: bool,
    hardware_error: bool,
    wrong_echoes: u8,
    watch: Watch,
    answered: bool,
    /// Watchdog and delays are to be written before the next torque.
    configure: bool,
    /// It restarted, and has not said since then that its torque is off.
    restarted: bool,
    setup: Setup,
    /// What was last said about it being wrong.
    noted: Option<(u16, u16)>,
}

impl Motor {
    const fn new(setup: Setup) -> Self {
        Self {
            setup,
            noted: None,
            last: None,
            last_us: 0,
            zero_urad: 0,
            sent: heapless::Deque::new(),
            misses: 0,
            lost: false,
            hardware_error: false,
            wrong_echoes: 0,
            watch: Watch::new(),
            answered: false,
            configure: false,
            restarted: false,
        }
    }

    /// Takes a reading. `now_us` is the time it was complete.
    pub fn absorb(
        &mut self,
        limits: &JointLimits,
        feedback: PackedFeedback,
        now_us: u64,
    ) -> Findings {
        let mut findings = Findings::new();
        let mut find = |finding| {
            // Room for one of each kind.
            let _ = findings.push(finding);
        };
        if feedback.status & status::RESTARTED != 0 {
            // Its settings are gone, and what the block holds is no reading.
            if self.last.is_some() {
                find(Finding::Reset);
                self.restarted = true;
            }
            self.forget();
            self.setup = Setup::Model;
            return findings;
        }
        let reset = self.last.is_some_and(|last| last.boots != feedback.boots);
        if reset {
            find(Finding::Reset);
            self.restarted = true;
            self.forget();
        }
        self.restarted &= feedback.status & status::TORQUE != 0;
        if let Some(last) = self.last.filter(|_| now_us > self.last_us) {
            // The same measurement again: the driver's loop stands, for however long. It counts as no answer. The tick alone comes round every 262 ms.
            let soon = now_us - self.last_us < 200_000;
            if last.tick_4us == feedback.tick_4us && (soon || last == feedback) {
                return findings;
            }
            if self.jumped(limits, &last, &feedback, now_us) {
                find(Finding::Jump);
            }
        }
        if self.last.is_none() || self.lost {
            find(Finding::Found);
            self.configure = true;
        }
        let error = feedback.status & status::HARDWARE_ERROR != 0;
        if error && !self.hardware_error {
            find(Finding::HardwareError);
        }
        self.hardware_error = error;
        if let Some(finding) = self.check_echo(&feedback) {
            find(finding);
        }
        if self.stalls(&feedback) {
            find(Finding::Stall);
        }
        self.last = Some(feedback);
        self.last_us = now_us;
        self.answered = true;
        self.lost = false;
        self.misses = 0;
        findings
    }

    fn jumped(
        &self,
        limits: &JointLimits,
        last: &PackedFeedback,
        now: &PackedFeedback,
        now_us: u64,
    ) -> bool {
        let speed_rad_s = limits.no_load_speed_rad_s;
        // At most 32 bits, which the processor converts in hardware.
        let dt_s = (now_us - self.last_us).min(1_000_000) as u32 as f32 * 1e-6;
        let step_rad = units::rad_from_urad(now.position_urad.saturating_sub(last.position_urad));
        step_rad.abs() > speed_rad_s * SPEED_MARGIN * dt_s + STEP_MARGIN_RAD
    }

    fn check_echo(&mut self, feedback: &PackedFeedback) -> Option<Finding> {
        let torque = feedback.status & status::TORQUE != 0;
        let newest = *self.sent.back().filter(|_| torque)?;
        let applied = feedback.applied_urad;
        let known = self
            .sent
            .iter()
            .any(|sent| applied.abs_diff(*sent) <= ECHO_TOLERANCE_URAD.unsigned_abs());
        if known {
            self.wrong_echoes = 0;
            return None;
        }
        self.wrong_echoes = self.wrong_echoes.saturating_add(1);
        // Only the first of a row and the one that makes it certain are worth an event.
        let certain = self.wrong_echoes == ECHO_CYCLES;
        (certain || self.wrong_echoes == 1).then(|| Finding::WrongSetPoint {
            sent_urad: newest.saturating_sub(self.zero_urad),
            applied_urad: applied.saturating_sub(self.zero_urad),
            certain,
        })
    }

    /// Torque is on, the set-point travels, the joint does not.
    fn stalls(&mut self, feedback: &PackedFeedback) -> bool {
        if feedback.status & status::TORQUE == 0 {
            self.watch = Watch::new();
            return false;
        }
        self.watch.applied.take(feedback.applied_urad);
        self.watch.position.take(feedback.position_urad);
        self.watch.readings = self.watch.readings.saturating_add(1);
        if self.watch.readings < STALL_READINGS {
            return false;
        }
        let watch = core::mem::replace(&mut self.watch, Watch::new());
        watch.applied.span() >= STALL_TRAVEL_URAD.unsigned_abs()
            && watch.position.span() <= STALL_STAYS_URAD.unsigned_abs()
    }

    /// Ends a control cycle: a driver that did not answer is one miss further.
    pub fn end_cycle(&mut self) -> Option<Finding> {
        if self.answered || self.lost {
            return None;
        }
        self.misses = self.misses.saturating_add(1);
        if self.misses < LOST_CYCLES {
            return None;
        }
        // Never seen: absent, not lost.
        let known = self.last.is_some();
        self.lost = true;
        known.then_some(Finding::Lost)
    }

    /// Everything that a restart of the driver makes untrue.
    fn forget(&mut self) {
        self.zero_urad = 0;
        self.last = None;
        self.sent.clear();
        self.wrong_echoes = 0;
        self.watch = Watch::new();
        self.hardware_error = false;
    }

    /// Whether the driver answered in this cycle.
    #[must_use]
    pub fn answered(&self) -> bool {
        self.answered
    }

    /// Whether the driver answers at all.
    #[must_use]
    pub fn present(&self) -> bool {
        self.last.is_some() && !self.lost
    }

    /// Position in the joint's frame, rad; `None` without a fresh reading.
    #[must_use]
    pub fn position_rad(&self) -> Option<f32> {
        let last = self.last.filter(|_| self.present() && self.misses == 0)?;
        Some(units::rad_from_urad(
            last.position_urad.saturating_sub(self.zero_urad),
        ))
    }

    /// Last reading in the joint's frame and when it was complete, us since boot.
    #[must_use]
    pub fn reading(&self) -> Option<(PackedFeedback, u64)> {
        let last = self.last?;
        let feedback = PackedFeedback {
            position_urad: last.position_urad.saturating_sub(self.zero_urad),
            applied_urad: last.applied_urad.saturating_sub(self.zero_urad),
            ..last
        };
        Some((feedback, self.last_us))
    }

    /// Whether it is known where the joint stands now.
    #[must_use]
    pub fn may_be_zeroed(&self, now_us: u64) -> bool {
        let age_us = now_us.saturating_sub(self.last_us);
        self.position_rad().is_some() && age_us <= ZERO_AGE_US
    }

    /// The position read last becomes zero.
    pub fn set_zero(&mut self) {
        self.zero_urad = self.last.map_or(0, |last| last.position_urad);
    }

    /// What to send for an angle in the joint's frame; `None` when it is not finite or beyond what a driver of this profile takes.
    #[must_use]
    pub fn to_wire(&self, info: &ProfileInfo, angle_rad: f32) -> Option<i32> {
        let raw = units::urad_from_rad(angle_rad)?.checked_add(self.zero_urad)?;
        info.goal_counts(raw).map(|_| raw)
    }

    /// Whether it is of the profile and has its settings.
    #[must_use]
    pub fn ready(&self) -> bool {
        self.setup == Setup::Ready
    }

    /// How far it is in coming into use.
    #[must_use]
    pub fn setup(&self) -> Setup {
        self.setup
    }

    /// A step of coming into use. A driver found wrong comes back once for each way to be wrong.
    pub fn set_setup(&mut self, joint: u8, setup: Setup) -> Option<WrongDriver> {
        self.setup = setup;
        let wrong = self.wrong(joint)?;
        let noted = Some((wrong.model, wrong.address));
        let new = self.noted != noted;
        self.noted = noted;
        new.then_some(wrong)
    }

    /// A driver of ours would have answered the cyclic read: this one did with an error. Its model is to be read.
    pub fn suspect(&mut self) {
        if self.setup == Setup::Ready && !self.present() {
            self.setup = Setup::Model;
        }
    }

    /// In what it is wrong, if it is.
    #[must_use]
    pub fn wrong(&self, joint: u8) -> Option<WrongDriver> {
        match self.setup {
            Setup::WrongModel { model } => Some(WrongDriver {
                joint,
                model,
                address: 0,
            }),
            Setup::WrongSetting { address } => Some(WrongDriver {
                joint,
                model: 0,
                address,
            }),
            _ => None,
        }
    }

    /// Notes that a set-point went out, driver's frame.
    pub fn note_sent(&mut self, raw_urad: i32) {
        if self.sent.back() == Some(&raw_urad) {
            return;
        }
        if self.sent.is_full() {
            let _ = self.sent.pop_front();
        }
        // There is room: the oldest was taken out if it was full.
        let _ = self.sent.push_back(raw_urad);
    }

    /// Forgets set-points: torque goes off, none of them is in force.
    pub fn forget_sent(&mut self) {
        self.sent.clear();
        self.wrong_echoes = 0;
    }

    /// Last set-point sent, joint's frame, urad.
    #[must_use]
    pub fn setpoint_urad(&self) -> Option<i32> {
        self.sent
            .back()
            .map(|raw| raw.saturating_sub(self.zero_urad))
    }

    /// Measured position in the driver's frame, for the set-point that goes out before torque.
    #[must_use]
    pub fn raw_position_urad(&self) -> Option<i32> {
        self.last.map(|last| last.position_urad)
    }

    /// Whether the driver says that its torque is on; `None` when it is not known.
    #[must_use]
    pub fn torque(&self) -> Option<bool> {
        self.last
            .filter(|_| self.present())
            .map(|last| last.status & status::TORQUE != 0)
    }

    /// Whether it restarted and may have torque: without a watchdog, and in another frame.
    #[must_use]
    pub fn has_restarted(&self) -> bool {
        self.restarted
    }

    /// Whether its bus watchdog has tripped.
    #[must_use]
    pub fn watchdog_tripped(&self) -> bool {
        self.last
            .is_some_and(|last| last.status & status::WATCHDOG != 0)
    }

    /// Whether its watchdog is to be set: it is new, or the watchdog has tripped.
    #[must_use]
    pub fn needs_settings(&self) -> bool {
        self.present() && (self.configure || self.watchdog_tripped())
    }

    /// The watchdog is cleared; that it is set again is not certain before the driver says so.
    pub fn note_unguarded(&mut self) {
        self.configure = true;
    }

    /// The driver says that its watchdog is set.
    pub fn note_guarded(&mut self) {
        self.configure = false;
    }

    /// A new instant of the grid: nothing was read in it yet.
    pub fn begin_slot(&mut self) {
        self.answered = false;
    }
}

/// The drivers, by joint.
#[derive(Debug)]
pub struct Motors {
    info: &'static ProfileInfo,
    /// Those beyond `joints` are never used.
    motors: [Motor; MAX_JOINTS],
    joints: u8,
}

impl Default for Motors {
    fn default() -> Self {
        Self::new()
    }
}

impl Motors {
    /// None seen; those of a meta-module, of our own profile.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            info: Profile::Packed.info(),
            motors: [const { Motor::new(Setup::Ready) }; MAX_JOINTS],
            joints: control::robot::JOINTS as u8,
        }
    }

    /// Goes over to another profile or number of joints: none seen.
    pub fn equip(&mut self, profile: Profile, joints: u8) {
        self.info = profile.info();
        self.joints = joints;
        for motor in &mut self.motors {
            *motor = Motor::new(Setup::begin(self.info));
        }
    }

    /// What is driven.
    #[must_use]
    pub fn info(&self) -> &'static ProfileInfo {
        self.info
    }

    /// Drivers of another profile, and those that do not take their settings.
    pub fn wrong(&self) -> impl Iterator<Item = WrongDriver> {
        self.iter()
            .zip(0..)
            .filter_map(|(motor, joint)| motor.wrong(joint))
    }

    /// The driver of a joint.
    #[must_use]
    pub fn get(&self, joint: usize) -> Option<&Motor> {
        self.in_use().get(joint)
    }

    /// The driver of a joint, to change.
    pub fn get_mut(&mut self, joint: usize) -> Option<&mut Motor> {
        self.in_use_mut().get_mut(joint)
    }

    /// In joint order.
    pub fn iter(&self) -> impl Iterator<Item = &Motor> {
        self.in_use().iter()
    }

    /// In joint order, to change.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut Motor> {
        self.in_use_mut().iter_mut()
    }

    /// Bit k: `test` holds for driver k.
    pub fn mask(&self, test: impl Fn(&Motor) -> bool) -> u16 {
        self.iter()
            .zip(0..)
            .fold(0, |mask, (motor, bit)| mask | u16::from(test(motor)) << bit)
    }

    /// Joints that have not answered in this cycle: present ones first, because a silent driver delays those behind it; absent ones in
    /// the `first` try alone.
    #[must_use]
    pub fn unread(&self, first: bool) -> heapless::Vec<usize, MAX_JOINTS> {
        let mut joints = heapless::Vec::new();
        for present in [true, false] {
            let wanted = self.iter().enumerate().filter(|(_, motor)| {
                let turn = motor.present() == present && (present || first);
                turn && motor.ready() && !motor.answered()
            });
            for (joint, _) in wanted {
                // At most one per joint.
                let _ = joints.push(joint);
            }
        }
        joints
    }

    /// Measured angles, rad, when all are fresh.
    #[must_use]
    pub fn positions_rad(&self) -> Option<Angles> {
        let mut angles = [0.0; MAX_JOINTS];
        for (angle, motor) in angles.iter_mut().zip(self.iter()) {
            *angle = motor.position_rad()?;
        }
        Angles::new(angles.get(..usize::from(self.joints))?)
    }

    /// Number of joints.
    #[must_use]
    pub fn joints(&self) -> u8 {
        self.joints
    }

    fn in_use(&self) -> &[Motor] {
        self.motors.get(..usize::from(self.joints)).unwrap_or(&[])
    }

    fn in_use_mut(&mut self) -> &mut [Motor] {
        self.motors
            .get_mut(..usize::from(self.joints))
            .unwrap_or(&mut [])
    }
}
