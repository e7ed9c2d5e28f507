//! What may be different about a servo and its set-points, as columns.

use super::Known;
use super::servo::Law;
use crate::evidence::block::Column;
use crate::vocabulary::Effect;

/// Delays that are played, s; a factor of 1.4 apart where delays of real buses lie.
const DELAYS_S: [f64; 10] = [
    0.006, 0.01, 0.015, 0.022, 0.032, 0.045, 0.065, 0.095, 0.14, 0.2,
];
/// What drivers of one bus take a set-point apart by, s: an exchange of six at 1 Mbaud and their loops of 1 ms.
const BUS_S: f64 = 0.0015;
/// Time constants that are played, s.
const LAGS_S: [f64; 8] = [0.008, 0.014, 0.024, 0.04, 0.065, 0.11, 0.18, 0.3];
/// Half widths of dead bands that are played, rad.
const BANDS_RAD: [f64; 9] = [0.002, 0.0035, 0.006, 0.01, 0.017, 0.03, 0.05, 0.08, 0.13];
/// Speed limits that are played, rad/s; a factor of 1.2 apart.
const SPEEDS_RAD_S: [f64; 21] = [
    0.06, 0.072, 0.086, 0.104, 0.124, 0.149, 0.179, 0.215, 0.258, 0.31, 0.37, 0.45, 0.53, 0.64,
    0.77, 0.92, 1.11, 1.33, 1.6, 1.92, 2.3,
];

/// Torque limits that are played, N m; a factor of 1.2 apart.
const TORQUES_NM: [f64; 23] = [
    0.08, 0.096, 0.115, 0.138, 0.166, 0.2, 0.24, 0.29, 0.34, 0.41, 0.5, 0.6, 0.71, 0.86, 1.03,
    1.23, 1.48, 1.78, 2.13, 2.56, 3.1, 3.7, 4.4,
];

/// Least share of the nominal gain, and of a limit of speed or torque, that is played. Numerics of a play, chosen by hand: a loop of
/// no gain and a motor of no torque answer nothing. They decide no name.
const LEAST_RATIO: f64 = 0.05;
const LEAST_SHARE: f64 = 0.01;
/// Least tolerance of a stated gain or speed limit, as a share: what rounding of a data sheet leaves.
pub(super) const LEAST_TOLERANCE: f64 = 0.01;
/// Numbers of the shapes that no effect has: of the servo's own, not of the drivetrain's.
const DRIFT: usize = 300;
const LOPSIDED: usize = 301;

/// What a column changes about the servo; the coefficient of a played shape is the share of its size.
#[derive(Debug, Clone, Copy)]
pub(super) enum Change {
    Offset,
    Scale,
    Gain(f64),
    Droop,
    Delay(f64),
    Clock,
    Step(f64),
    SoftBand(f64),
    HardBand(f64),
    FeedbackDelay(f64),
    Lag(f64),
    /// Speed limit, as a share of the nominal one that is lost.
    Limit(f64),
    /// Torque limit.
    Torque {
        nominal_nm: f64,
        lost_nm: f64,
    },
    Drift,
    Lopsided,
}

impl Change {
    /// Share of the speed limit that a unit of it takes off.
    pub(super) const fn limits(self) -> f64 {
        match self {
            Self::Limit(size) => size,
            _ => 0.0,
        }
    }

    /// Coefficients between which a law has its change: a limit is not negative, nor is a gain.
    pub(super) fn range(self) -> [f64; 2] {
        match self {
            Self::Gain(size) if size > 0.0 => [(LEAST_RATIO - 1.0) / size, f64::INFINITY],
            Self::Gain(size) => [f64::NEG_INFINITY, (LEAST_RATIO - 1.0) / size],
            Self::Limit(size) if size > 0.0 => [f64::NEG_INFINITY, (1.0 - LEAST_SHARE) / size],
            Self::Torque {
                nominal_nm,
                lost_nm,
            } => [
                f64::NEG_INFINITY,
                (1.0 - LEAST_SHARE) * nominal_nm / lost_nm,
            ],
            _ => [f64::NEG_INFINITY, f64::INFINITY],
        }
    }

    /// The law with `by` of the change.
    pub(super) fn on(self, mut law: Law, by: f64) -> Law {
        match self {
            Self::Offset => law.offset += by,
            Self::Scale => law.scale += by,
            Self::Gain(size) => law.ratio = (law.ratio + size * by).max(LEAST_RATIO),
            Self::Droop => law.droop += by,
            Self::Delay(size) => law.delay_s += size * by,
            Self::Clock => law.clock += by,
            Self::Step(size) => law.step = (law.step + size * by).max(0.0),
            Self::SoftBand(size) => law.soft_band = (law.soft_band + size * by).max(0.0),
            Self::HardBand(size) => law.hard_band = (law.hard_band + size * by).max(0.0),
            Self::FeedbackDelay(size) => {
                law.feedback_delay_s = (law.feedback_delay_s + size * by).max(0.0);
            }
            Self::Lag(size) => law.lag_s = (law.lag_s + size * by).max(0.0),
            Self::Drift => law.drift += by,
            Self::Lopsided => law.lopsided += by,
            Self::Limit(size) => law.share = (law.share - size * by).max(LEAST_SHARE),
            Self::Torque {
                nominal_nm,
                lost_nm,
            } => {
                let least = LEAST_SHARE * nominal_nm;
                law.torque_nm = (law.torque_nm.min(nominal_nm) - lost_nm * by).max(least);
            }
        }
        law
    }
}

/// A column and what it changes; `step` is the coefficient that is played where the column is not in the law yet.
pub(super) struct Shape {
    pub(super) column: Column,
    pub(super) change: Change,
    pub(super) step: f64,
}

pub(super) fn shape(column: Column, change: Change, step: f64) -> Shape {
    Shape {
        column,
        change,
        step,
    }
}

/// What may be different, where loads of at most `load_nm` are known.
pub(super) fn shapes(known: &Known, load_nm: f64) -> Vec<Shape> {
    let mut out = conventions(known);
    transport(known, &mut out);
    driver(known, &mut out);
    torque(known, load_nm, &mut out);
    out
}

fn conventions(known: &Known) -> Vec<Shape> {
    let tolerance = known.nominal.gain_tolerance.max(LEAST_TOLERANCE);
    let speed = known.speed_tolerance.max(LEAST_TOLERANCE);
    let mut out = vec![
        shape(
            Column::linear(Effect::JointOffset, "offset_rad", 0.0, 0.1),
            Change::Offset,
            0.01,
        ),
        shape(
            Column::linear(Effect::JointScale, "ratio", 1.0, 0.15),
            Change::Scale,
            0.01,
        ),
        shape(
            Column::linear(Effect::LoopGain, "ratio", 1.0, 0.5).with_slack(tolerance),
            Change::Gain(1.0),
            0.05,
        ),
        // Which of its own ticks a driver answers in, and when a row is taken.
        shape(
            Column::nuisance(BUS_S).with_shared_slack("ticks", 0.5 * known.row_s.max(0.004)),
            Change::FeedbackDelay(1.0),
            0.01,
        ),
        // Speed lost per torque: a servo of another engine is not infinitely stiff.
        shape(Column::nuisance(0.03), Change::Droop, 0.01),
    ];
    for (i, size) in [-0.6, -0.4, -0.2, 0.3, 0.7, 1.5].into_iter().enumerate() {
        let ratio = Column::played(Effect::LoopGain, "ratio", 1.0, 1.0 + size, 1 + i);
        out.push(shape(ratio, Change::Gain(size), 1.0));
    }
    // Within its tolerances a speed limit is no effect.
    for tolerances in [-1.0, 1.0, 2.0] {
        let size = tolerances * speed;
        out.push(shape(Column::nuisance(1.0), Change::Limit(size), 1.0));
    }
    out
}

fn transport(known: &Known, out: &mut Vec<Shape>) {
    // A set-point acts at some time between two rows: of all joints about the same, a bus later in each.
    let slack = 0.6 * known.row_s.max(0.002);
    let column = Column::nuisance(BUS_S).with_shared_slack("rows", slack);
    out.push(shape(column, Change::Delay(1.0), 0.004));
    if known.applied {
        return;
    }
    let delays: Vec<f64> = match known.late_s {
        None => DELAYS_S.to_vec(),
        Some([low, high]) if high > 0.0 => vec![0.5 * (low + high)],
        Some(_) => Vec::new(),
    };
    for (i, d) in delays.into_iter().enumerate() {
        let column = Column::played(Effect::Latency, "delay_s", 0.0, d, i);
        out.push(shape(column, Change::Delay(d), 1.0));
    }
    // Rows show a drift by one row at least, the motion a smaller one too.
    if !known.clocked {
        let column = Column::linear(Effect::ClockSkew, "ratio", 1.0, 0.005);
        let column = column.of_robot();
        out.push(shape(column, Change::Clock, 0.002));
    }
}

fn driver(known: &Known, out: &mut Vec<Shape>) {
    for (i, w) in BANDS_RAD.into_iter().enumerate() {
        let column = |s| Column::played(Effect::Deadband, "half_width_rad", 0.0, w, s);
        out.push(shape(column(2 * i), Change::SoftBand(w), 1.0));
        out.push(shape(column(2 * i + 1), Change::HardBand(w), 1.0));
    }
    for (i, d) in DELAYS_S.into_iter().enumerate().take(8) {
        let column = Column::played(Effect::FeedbackDelay, "delay_s", 0.0, d, i);
        out.push(shape(column, Change::FeedbackDelay(d), 1.0));
    }
    for (i, lag) in LAGS_S.into_iter().enumerate() {
        let column = Column::played(Effect::MotorLag, "time_constant_s", 0.0, lag, i);
        out.push(shape(column, Change::Lag(lag), 1.0));
    }
    out.push(shape(Column::open(DRIFT, 0.005), Change::Drift, 0.001));
    out.push(shape(Column::open(LOPSIDED, 0.3), Change::Lopsided, 0.1));
    let most = known.nominal.max_speed_rad_s;
    let within = 1.0 - 3.0 * known.speed_tolerance;
    let limits = SPEEDS_RAD_S.into_iter().enumerate();
    for (i, limit) in limits.filter(|s| s.1 < within * most) {
        let column = Column {
            prior: [1.0, 0.1],
            ..Column::played(Effect::VelocityLimit, "limit_rad_s", most, limit, i)
        };
        out.push(shape(column, Change::Limit(1.0 - limit / most), 1.0));
    }
}

/// A motor that gives less than the loads ask for. Within its tolerances a limit is no effect.
fn torque(known: &Known, load_nm: f64, out: &mut Vec<Shape>) {
    let [least, _] = known.nominal.at_limit_nm();
    let from = known.nominal.max_torque_nm;
    let limits = TORQUES_NM.into_iter().enumerate();
    for (i, nm) in limits.filter(|s| s.1 < least.min(load_nm)) {
        let column = Column {
            prior: [1.0, 0.1],
            ..Column::played(Effect::TorqueLimit, "limit_nm", from, nm, i)
        };
        let change = Change::Torque {
            nominal_nm: from,
            lost_nm: from - nm,
        };
        out.push(shape(column, change, 1.0));
    }
}
