//! Table profiles: what the module must know of a family of drivers, as data.
//!
//! A bus carries drivers of one profile. Which one stands in `robot.toml` and, once uploaded, in the module's settings.
//!
//! Sources, named beside each constant:
//! * **e-manual**: Robotis e-manual, pages XL330-M288, XC330-T181 and XM430-W350, and "Protocol 2.0".
//! * **Feetech SDK**: headers `SMS_STS.h` and `SCSCL.h` of FTServo_Linux, and the "Communication Protocol User Manual" of Feetech.
//! * **LeRobot**: `motors/feetech/tables.py` and `motors/dynamixel/tables.py`, for model numbers and sign bits.

use serde::{Deserialize, Serialize};

use super::feedback::{PACKED_LEN, PackedFeedback, status};
use super::field::{Field, Order, Sign};
use super::indirect::{Indirect, X330_INDIRECT, XM430_INDIRECT};
use super::table::{MODEL_NUMBER, PACKED_FEEDBACK, Register};
use crate::units::{self, MAX_ANGLE_URAD};

/// A family of drivers. Grows at the end only: the number is stored and sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Profile {
    /// Our drivers: the X-series table with a packed block.
    #[default]
    Packed = 0,
    /// Dynamixel XL330.
    Xl330 = 1,
    /// Dynamixel XC330.
    Xc330 = 2,
    /// Dynamixel XM430.
    Xm430 = 3,
    /// Feetech STS and SMS.
    Sts = 4,
    /// Feetech SCS.
    Scs = 5,
}

/// How packets are framed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Framing {
    /// Dynamixel Protocol 2.0: [`super::packet`].
    Dynamixel2,
    /// Feetech: `FF FF id length ...`.
    Feetech,
}

/// Bytes that a register must hold before a driver is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Setting {
    /// First address.
    pub address: u16,
    /// What it must hold.
    pub bytes: &'static [u8],
}

const fn set(address: u16, bytes: &'static [u8]) -> Setting {
    Setting { address, bytes }
}

/// Where a reading holds what, from the begin of the block; units in counts of the driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Layout {
    torque: Field,
    goal: Field,
    position: Field,
    velocity: Field,
    current: Field,
    duty: Field,
    voltage: Field,
    temperature: Field,
    hardware_error: Field,
    /// Milliseconds, 0..=32767.
    tick: Option<Field>,
    /// Zero in a driver that has restarted since its settings were written.
    marker: Option<Field>,
    /// All bits set: the bus watchdog has tripped.
    watchdog: Option<Field>,
}

/// What one count is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Units {
    /// Counts of position in `turn_urad`.
    pub counts: i32,
    /// Angle of [`Units::counts`], urad.
    pub turn_urad: i32,
    /// Speed of 1000 counts, in steps of 0.5 mrad/s.
    pub velocity_per_1000: i32,
    /// Current of 100 counts, mA.
    pub ma_per_100: i32,
    /// Counts of duty 1.
    pub duty_full: i32,
    /// Smallest position that may be sent, counts.
    pub min_counts: i32,
    /// Largest position that may be sent, counts.
    pub max_counts: i32,
}

/// What the module must know of a family of drivers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProfileInfo {
    /// Profile.
    pub profile: Profile,
    /// Name in `robot.toml` and on the command line.
    pub name: &'static str,
    /// For people.
    pub title: &'static str,
    /// Frames of its packets.
    pub framing: Framing,
    /// Model numbers of the family; that of the emulated driver first.
    pub models: &'static [u16],
    /// Model number.
    pub model: Field,
    /// Whether one request reads several drivers.
    pub sync_read: bool,
    /// First address of the cyclic read.
    pub feedback: u16,
    /// Bytes of the cyclic read.
    pub feedback_len: u16,
    /// Torque on or off.
    pub torque: Field,
    /// Set-point.
    pub goal: Field,
    /// Hardware error bits.
    pub hardware_error: Field,
    /// Bus watchdog, 20 ms per count; `None`: the driver has none and holds its last set-point when the module dies.
    pub watchdog: Option<Field>,
    /// Settings, in the order of writing; all are compared first and written only where they differ.
    pub settings: &'static [Setting],
    /// Units of the table.
    pub units: Units,
    layout: Option<Layout>,
}

/// X-series current of XM430, mA per 100 counts (e-manual, Present Current: 2.69 mA).
const XM430_MA_PER_100: i32 = units::X_MA_PER_100_CURRENT_COUNTS;
/// Current of XL330 and XC330, mA per 100 counts (e-manual, Present Current: about 1 mA).
const X330_MA_PER_100: i32 = 100;
/// 0.229 rpm = 23.9808 mrad/s per count (e-manual, Present Velocity), in steps of 0.5 mrad/s.
const X_VELOCITY_PER_1000: i32 = 47_962;
/// Furthest Goal Position of the extended position mode, counts: 256 turns (e-manual, Goal Position).
const X_MAX_COUNTS: i32 = 1_048_575;

const X_INDIRECT_START: u16 = 168;

/// Where each byte of the cyclic read comes from, 20 bytes: as many as an XL330 can map.
///
/// Torque (64), hardware error (70), watchdog (98), goal position (116, three bytes: 256 turns are 21 bits), realtime tick (120), PWM (124),
/// current (126), velocity (128, two bytes), position (132, three bytes), voltage (144), temperature (146). Addresses: e-manual.
const X_MAP: [u8; 40] = map([
    64, 70, 98, 116, 117, 118, 120, 121, 124, 125, 126, 127, 128, 129, 132, 133, 134, 144, 145, 146,
]);

#[rustfmt::skip]
/// Indirect addresses below 256, as they stand in the table: low byte, then 0.
const fn map(addresses: [u8; 20]) -> [u8; 40] {
    let [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r, s, t] = addresses;
    [
        a, 0, b, 0, c, 0, d, 0, e, 0, f, 0, g, 0, h, 0, i, 0, j, 0, k, 0, l, 0, m, 0, n, 0, o, 0,
        p, 0, q, 0, r, 0, s, 0, t, 0,
    ]
}

const fn x(address: u16, len: u8, sign: Sign) -> Field {
    Field::new(address, len, Order::Little, sign)
}

/// Places in the block of [`X_MAP`].
const X_LAYOUT: Layout = Layout {
    torque: x(0, 1, Sign::None),
    hardware_error: x(1, 1, Sign::None),
    marker: Some(x(2, 1, Sign::None)),
    watchdog: Some(x(2, 1, Sign::None)),
    goal: x(3, 3, Sign::Twos),
    tick: Some(x(6, 2, Sign::None)),
    duty: x(8, 2, Sign::Twos),
    current: x(10, 2, Sign::Twos),
    velocity: x(12, 2, Sign::Twos),
    position: x(14, 3, Sign::Twos),
    voltage: x(17, 2, Sign::None),
    temperature: x(19, 1, Sign::None),
};

/// Settings of an X servo (e-manual, addresses in order). Torque off; velocity-based profile and normal direction (Drive Mode 0).
/// Extended position (Operating Mode 4); no return delay; Profile Acceleration and Velocity 0, which is none. The map of the cyclic read.
/// Bus watchdog cleared, then 160 ms: after a restart it reads 0 again.
const X_SETTINGS: &[Setting] = &[
    set(64, &[0]),
    set(10, &[0]),
    set(11, &[4]),
    set(9, &[0]),
    set(108, &[0, 0, 0, 0, 0, 0, 0, 0]),
    set(X_INDIRECT_START, &X_MAP),
    set(98, &[0]),
    set(98, &[WATCHDOG_COUNTS]),
];

/// Bus watchdog of the drivers, 20 ms per count: 160 ms, three missed cycles.
pub const WATCHDOG_COUNTS: u8 = 8;

const fn dynamixel(
    profile: Profile,
    name: &'static str,
    title: &'static str,
    models: &'static [u16],
    indirect: Indirect,
    ma_per_100: i32,
) -> ProfileInfo {
    ProfileInfo {
        profile,
        name,
        title,
        framing: Framing::Dynamixel2,
        models,
        model: x(0, 2, Sign::None),
        sync_read: true,
        feedback: indirect.data(),
        feedback_len: 20,
        torque: x(64, 1, Sign::None),
        goal: x(116, 4, Sign::Twos),
        hardware_error: x(70, 1, Sign::None),
        watchdog: Some(x(98, 1, Sign::Twos)),
        settings: X_SETTINGS,
        units: Units {
            counts: units::X_COUNTS_PER_TURN,
            turn_urad: 6_283_185,
            velocity_per_1000: X_VELOCITY_PER_1000,
            ma_per_100,
            duty_full: units::X_PWM_FULL,
            min_counts: -X_MAX_COUNTS,
            max_counts: X_MAX_COUNTS,
        },
        layout: Some(X_LAYOUT),
    }
}

/// Feetech: first address of the cyclic read, Torque Enable (Feetech SDK, `SMS_STS_TORQUE_ENABLE`, `SCSCL_TORQUE_ENABLE`).
const FEETECH_FEEDBACK: u16 = 40;

/// Places in the block 40..=70 (Feetech SDK, "SRAM"; status 65: LeRobot). Load has its sign in bit 10, the others of STS in bit 15 (Feetech SDK,
/// `ReadLoad`, `ReadPos`, `ReadSpeed`).
const fn feetech_layout(order: Order, sign: Sign, marker: Option<Field>) -> Layout {
    const fn at(address: u16, len: u8, order: Order, sign: Sign) -> Field {
        Field::new(address - FEETECH_FEEDBACK, len, order, sign)
    }
    Layout {
        torque: at(40, 1, order, Sign::None),
        goal: at(42, 2, order, sign),
        position: at(56, 2, order, sign),
        velocity: at(58, 2, order, Sign::Magnitude(15)),
        duty: at(60, 2, order, Sign::Magnitude(10)),
        voltage: at(62, 1, order, Sign::None),
        temperature: at(63, 1, order, Sign::None),
        hardware_error: at(65, 1, order, Sign::None),
        current: at(69, 2, order, Sign::Magnitude(15)),
        tick: None,
        marker,
        watchdog: None,
    }
}

/// Goal Speed that limits nothing, steps/s: twice what an STS3215 turns unloaded (52 rpm = 3550 steps/s), low byte first. A restart clears it.
const STS_FREE_SPEED: [u8; 2] = 7_000_u16.to_le_bytes();

/// Settings of STS (Feetech SDK and protocol manual). Torque off; EEPROM unlocked (55); no return delay (7). Angle limits 0, which means
/// several turns (9..=12); position mode (33); EEPROM locked. No acceleration limit (41); Goal Time 0, Goal Speed free (44..=47).
const STS_SETTINGS: &[Setting] = &[
    set(40, &[0]),
    set(55, &[0]),
    set(7, &[0]),
    set(9, &[0, 0, 0, 0]),
    set(33, &[0]),
    set(55, &[1]),
    set(41, &[0]),
    set(44, &[0, 0, STS_FREE_SPEED[0], STS_FREE_SPEED[1]]),
];

/// Settings of SCS: torque off, Goal Time and Goal Speed 0, which is as fast as it can (Feetech SDK, `SCSCL.h`).
const SCS_SETTINGS: &[Setting] = &[set(40, &[0]), set(44, &[0, 0, 0, 0])];

const PACKED: ProfileInfo = ProfileInfo {
    profile: Profile::Packed,
    name: "packed",
    title: "our driver with the packed block",
    framing: Framing::Dynamixel2,
    models: &[MODEL_NUMBER as u16],
    model: x(0, 2, Sign::None),
    sync_read: true,
    feedback: PACKED_FEEDBACK,
    feedback_len: PACKED_LEN as u16,
    torque: x(Register::TorqueEnable.address(), 1, Sign::None),
    goal: x(Register::GoalAngle.address(), 4, Sign::Twos),
    hardware_error: x(Register::HardwareError.address(), 1, Sign::None),
    watchdog: Some(x(Register::BusWatchdog.address(), 1, Sign::Twos)),
    settings: &[],
    // One count is 1 urad.
    units: Units {
        counts: 1_000_000,
        turn_urad: 1_000_000,
        velocity_per_1000: 1_000,
        ma_per_100: 100,
        duty_full: 2_000,
        min_counts: -MAX_ANGLE_URAD,
        max_counts: MAX_ANGLE_URAD,
    },
    layout: None,
};

/// Model numbers: e-manual, "Model Number" of each page.
const XL330: ProfileInfo = dynamixel(
    Profile::Xl330,
    "xl330",
    "Dynamixel XL330",
    &[1200, 1190],
    X330_INDIRECT,
    X330_MA_PER_100,
);
const XC330: ProfileInfo = dynamixel(
    Profile::Xc330,
    "xc330",
    "Dynamixel XC330",
    &[1220, 1210, 1230, 1240],
    X330_INDIRECT,
    X330_MA_PER_100,
);
const XM430: ProfileInfo = dynamixel(
    Profile::Xm430,
    "xm430",
    "Dynamixel XM430",
    &[1020, 1030],
    XM430_INDIRECT,
    XM430_MA_PER_100,
);

/// Fields that both Feetech tables have at the same address.
const fn feetech(
    profile: Profile,
    name: &'static str,
    title: &'static str,
    models: &'static [u16],
    order: Order,
) -> ProfileInfo {
    let scs = matches!(order, Order::Big);
    // SCS positions are never negative; STS ones have their sign in bit 15 (Feetech SDK, `ReadPos`).
    let sign = if scs { Sign::None } else { Sign::Magnitude(15) };
    let marker = Field::new(46 - FEETECH_FEEDBACK, 2, order, Sign::None);
    ProfileInfo {
        profile,
        name,
        title,
        framing: Framing::Feetech,
        models,
        model: Field::new(3, 2, order, Sign::None),
        // Sync Read: protocol manual, 1.3.7; SCS does not have it.
        sync_read: !scs,
        feedback: FEETECH_FEEDBACK,
        feedback_len: 31,
        torque: Field::new(40, 1, order, Sign::None),
        goal: Field::new(42, 2, order, sign),
        hardware_error: Field::new(65, 1, order, Sign::None),
        watchdog: None,
        settings: if scs { SCS_SETTINGS } else { STS_SETTINGS },
        units: if scs { SCS_UNITS } else { STS_UNITS },
        // An SCS has one turn and knows it after a restart.
        layout: Some(feetech_layout(
            order,
            sign,
            if scs { None } else { Some(marker) },
        )),
    }
}

/// STS: 4096 counts a turn (LeRobot), goals of 7.5 turns (-30719..=30719, not verified); 1 step/s = 1.534 mrad/s, as it is with bit 2 of Phase
/// (18) set; 6.5 mA (not verified); load 0.1 %.
const STS_UNITS: Units = Units {
    counts: 4096,
    turn_urad: 6_283_185,
    velocity_per_1000: 3_068,
    ma_per_100: 650,
    duty_full: 1_000,
    min_counts: -30_719,
    max_counts: 30_719,
};

/// SCS: 1024 counts in 300 deg (Feetech SCS15 and SCS0009 data sheets); 1 step/s = 5.113 mrad/s; load 0.1 %. Current as STS.
const SCS_UNITS: Units = Units {
    counts: 1024,
    turn_urad: 5_235_988,
    velocity_per_1000: 10_227,
    ma_per_100: 650,
    duty_full: 1_000,
    min_counts: 0,
    max_counts: 1_023,
};

/// Model numbers: LeRobot, `MODEL_NUMBER_TABLE` (STS3215, STS3250, SM8512BL; SCS0009). Low byte at address 3, high byte at 4, in both series.
const STS: ProfileInfo = feetech(
    Profile::Sts,
    "sts",
    "Feetech STS or SMS",
    &[777, 2825, 11_272],
    Order::Little,
);
const SCS: ProfileInfo = feetech(Profile::Scs, "scs", "Feetech SCS", &[1284], Order::Big);

impl Profile {
    /// Every profile.
    pub const ALL: [Self; 6] = [
        Self::Packed,
        Self::Xl330,
        Self::Xc330,
        Self::Xm430,
        Self::Sts,
        Self::Scs,
    ];

    /// What there is to know of it.
    #[must_use]
    pub const fn info(self) -> &'static ProfileInfo {
        match self {
            Self::Packed => &PACKED,
            Self::Xl330 => &XL330,
            Self::Xc330 => &XC330,
            Self::Xm430 => &XM430,
            Self::Sts => &STS,
            Self::Scs => &SCS,
        }
    }

    /// Profile with this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|profile| profile.info().name == name)
    }

    /// Profile with this number, as stored.
    #[must_use]
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|profile| *profile as u8 == number)
    }

    /// Profile of a driver that answers in this framing with this model number.
    #[must_use]
    pub fn of_model(framing: Framing, model: u16) -> Option<Self> {
        Self::ALL.into_iter().find(|profile| {
            let info = profile.info();
            info.framing == framing && info.models.contains(&model)
        })
    }
}

impl ProfileInfo {
    /// Counts of a set-point, urad in the driver's frame. `None` beyond what the driver takes.
    #[must_use]
    pub fn goal_counts(&self, angle_urad: i32) -> Option<i32> {
        let Units {
            counts,
            turn_urad,
            min_counts,
            max_counts,
            ..
        } = self.units;
        let scaled = i64::from(angle_urad) * i64::from(counts);
        let turn = i64::from(turn_urad.max(1));
        let half = if scaled < 0 { -(turn / 2) } else { turn / 2 };
        // Our own drivers count in urad. A Cortex-M4 divides 64 bits in software.
        let rounded = if counts == turn_urad && counts > 0 {
            angle_urad
        } else {
            i32::try_from(scaled.saturating_add(half).checked_div(turn)?).ok()?
        };
        (min_counts..=max_counts)
            .contains(&rounded)
            .then_some(rounded)
    }

    /// Angle of a position in counts, urad; saturates at what the block carries.
    #[must_use]
    pub fn angle_urad(&self, counts: i32) -> i32 {
        let scaled = i64::from(counts).saturating_mul(i64::from(self.units.turn_urad));
        let per = i64::from(self.units.counts.max(1));
        let half = if scaled < 0 { -(per / 2) } else { per / 2 };
        let angle = scaled.saturating_add(half).checked_div(per).unwrap_or(0);
        let limit = i64::from(MAX_ANGLE_URAD);
        angle.clamp(-limit, limit) as i32
    }

    /// A reading in our units. `None` when the bytes are no block of this profile. `now_us`, the time of the request, stands in for the tick of a
    /// driver without one.
    #[must_use]
    pub fn decode(&self, bytes: &[u8], now_us: u64) -> Option<PackedFeedback> {
        if bytes.len() != usize::from(self.feedback_len) {
            return None;
        }
        let Some(layout) = &self.layout else {
            return PackedFeedback::from_bytes(bytes.first_chunk::<PACKED_LEN>()?);
        };
        let value = |field: &Field| {
            let from = usize::from(field.address);
            bytes.get(from..).map_or(0, |bytes| field.value_of(bytes))
        };
        let scaled = |counts: i32, times: i32, per: i32| {
            let wide = i64::from(counts) * i64::from(times);
            let value = wide.checked_div(i64::from(per)).unwrap_or(0);
            value.clamp(i64::from(i16::MIN), i64::from(i16::MAX)) as i16
        };
        let velocity = scaled(value(&layout.velocity), self.units.velocity_per_1000, 1000);
        let tick_us = layout.tick.as_ref().map_or(now_us, |tick| {
            u64::from(value(tick).unsigned_abs()).saturating_mul(1000)
        });
        Some(PackedFeedback {
            tick_4us: (tick_us / u64::from(units::US_PER_TICK)) as u16,
            applied_urad: self.angle_urad(value(&layout.goal)),
            position_urad: self.angle_urad(value(&layout.position)),
            velocity,
            current_ma: scaled(value(&layout.current), self.units.ma_per_100, 100),
            duty: scaled(value(&layout.duty), 2_000, self.units.duty_full),
            // 0.1 V in every table here.
            voltage_5mv: value(&layout.voltage).saturating_mul(20).clamp(0, 0xFFF) as u16,
            temperature_c: value(&layout.temperature) as i16,
            status: layout.status(&value, velocity),
            boots: 0,
        })
    }
}

impl Layout {
    fn status(&self, value: &impl Fn(&Field) -> i32, velocity: i16) -> u8 {
        let tripped = self.watchdog.is_some_and(|field| value(&field) == 0xFF);
        let restarted = self.marker.is_some_and(|field| value(&field) == 0);
        let mut bits = 0;
        for (bit, set) in [
            (status::TORQUE, value(&self.torque) == 1),
            (status::HARDWARE_ERROR, value(&self.hardware_error) != 0),
            (status::WATCHDOG, tripped),
            (status::MOVING, velocity != 0),
            (status::RESTARTED, restarted),
        ] {
            bits |= if set { bit } else { 0 };
        }
        bits
    }
}
