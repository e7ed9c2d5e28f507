//! How much each cause shows: windows of one second from the recorded state, noise-free, with and without it.

use control::gait::Gait;

use super::machine::{Machine, Sample, Snapshot};
use super::reality::{CameraTruth, NUDGES, Reality};
use super::{JOINTS, Plan, REPEATS, SAMPLE_TICKS, Signal, write};
use crate::evidence;

/// Samples of a window.
const WINDOW: usize = 1000 / SAMPLE_TICKS as usize;
/// So many gaits are looked at; what they show is taken for all.
const LOOKED: usize = 2;
/// Noise of a silhouette's centre, pixels: a third of an edge pixel's width over some hundred edge pixels, and the cut.
const CENTRE_PX: f64 = 0.5;

/// Channels: six each of encoder, current or effort, duty and applied set-point, then bus, rates, base position, base
/// attitude.
const CHANNELS: usize = 4 * JOINTS + 1 + 3 + 3 + 3;
const BASE: usize = 4 * JOINTS + 4;

fn noise(channel: usize) -> f64 {
    match channel {
        c if c < JOINTS => write::POSITION_RAD,
        c if c < 2 * JOINTS => write::CURRENT_A,
        c if c < 3 * JOINTS => write::DUTY,
        // The echo is a number, printed to 10 urad.
        c if c < 4 * JOINTS => 1e-5,
        c if c == 4 * JOINTS => write::BUS_V,
        c if c < BASE => write::GYRO_RAD_S,
        c if c < BASE + 3 => write::BASE_M,
        _ => write::TURN_RAD,
    }
}

/// How long what repeats differ by lasts, s: the random torques' time, a step of the robot, a blow.
fn lasts_s(channel: usize) -> f64 {
    match channel {
        c if c <= 4 * JOINTS => 0.2,
        c if c < BASE => 0.1,
        _ => 0.5,
    }
}

/// Whether a channel was recorded.
fn recorded(plan: &Plan, channel: usize) -> bool {
    let has = |s: Signal| !plan.without.contains(&s);
    match channel {
        c if c < JOINTS => true,
        c if c < 2 * JOINTS => has(Signal::Current) || has(Signal::Effort),
        c if c < 3 * JOINTS => has(Signal::Duty),
        c if c < 4 * JOINTS => has(Signal::Echo),
        c if c == 4 * JOINTS => has(Signal::Bus),
        c if c < BASE => has(Signal::Inertial) && plan.seen_by.tracker(),
        _ => has(Signal::Pose) && plan.seen_by.tracker(),
    }
}

/// Differences of two samples, channel by channel.
fn difference(a: &Sample, b: &Sample) -> [f64; CHANNELS] {
    let mut out = [0.0; CHANNELS];
    for k in 0..JOINTS {
        out[k] = a.encoder_rad[k] - b.encoder_rad[k];
        out[JOINTS + k] = a.current_a[k] - b.current_a[k];
        out[2 * JOINTS + k] = a.duty[k] - b.duty[k];
        out[3 * JOINTS + k] = a.applied_rad[k] - b.applied_rad[k];
    }
    out[4 * JOINTS] = a.bus_v - b.bus_v;
    let turn = turn_rad(a.base.quaternion, b.base.quaternion);
    for k in 0..3 {
        out[4 * JOINTS + 1 + k] = a.gyro_rad_s[k] - b.gyro_rad_s[k];
        out[BASE + k] = f64::from(a.base.position_m[k] - b.base.position_m[k]);
        out[BASE + 3 + k] = turn[k];
    }
    out
}

/// Rotation from `b` to `a` as a vector, rad; small ones are meant.
fn turn_rad(a: [f32; 4], b: [f32; 4]) -> [f64; 3] {
    let [w, x, y, z] = a.map(f64::from);
    let [e, f, g, h] = b.map(f64::from);
    let real = w * e + x * f + y * g + z * h;
    let sign = if real < 0.0 { -2.0 } else { 2.0 };
    [
        x * e - w * f + z * g - y * h,
        y * e - w * g + x * h - z * f,
        z * e - w * h + y * f - x * g,
    ]
    .map(|v| sign * v)
}

/// Differences of windows, row by row.
type Rows = Vec<[f64; CHANNELS]>;

/// What windows of the looked-at gaits show of one robot against another.
struct Windows {
    /// Of the robot itself once more, with the disturbances of a run.
    spread: Rows,
    /// Without each cause, then with each nominal number off.
    others: Vec<Rows>,
    /// Chi-square of pictures without each cause.
    film: Vec<f64>,
}

/// Realities without each cause.
fn less(plan: &Plan) -> Option<Vec<Reality>> {
    let without = |k: usize| {
        let rest: Vec<_> = plan.planted.iter().filter(|p| p.cause != k).collect();
        Reality::new(plan.seed, &rest.into_iter().cloned().collect::<Vec<_>>())
    };
    (0..plan.causes()).map(without).collect()
}

fn look(
    plan: &Plan,
    gaits: &[Gait],
    truth: &Reality,
    others: &[Reality],
    causes: usize,
) -> Option<Windows> {
    let mut out = Windows {
        spread: Rows::new(),
        others: vec![Rows::new(); others.len()],
        film: vec![0.0; causes],
    };
    let windows = plan.duration_s as u64;
    let every = (gaits.len() / LOOKED).max(1);
    for (g, gait) in gaits.iter().enumerate().step_by(every).take(LOOKED) {
        let mut clean = Machine::new(truth, gait, None)?;
        for w in 0..windows {
            let from = clean.snapshot();
            let with = clean.record(WINDOW);
            // One window in two.
            if w % 2 == 1 {
                continue;
            }
            let run = (plan.seed, g as u64 * windows + w);
            let from = (&from, truth);
            let rows = |again: Vec<Sample>| -> Rows {
                with.iter()
                    .zip(&again)
                    .map(|(a, b)| difference(a, b))
                    .collect()
            };
            out.spread
                .extend(rows(again(truth, gait, from, Some(run))?));
            for (other, kept) in others.iter().zip(&mut out.others) {
                kept.extend(rows(again(other, gait, from, None)?));
            }
            for (other, film) in others.iter().zip(&mut out.film) {
                let moved = filmed(&truth.camera, &other.camera, &with);
                *film += moved * moved * write::FRAME_HZ;
            }
        }
    }
    Some(out)
}

/// Per cause: what it adds to chi-square, and what stays of that once the nominal numbers were fitted.
pub(super) fn evidence(plan: &Plan, gaits: &[Gait], truth: &Reality) -> Option<Vec<(f64, f64)>> {
    let mut others = less(plan)?;
    let causes = others.len();
    if causes == 0 {
        return Some(Vec::new());
    }
    for number in 0..NUDGES {
        others.push(Reality::nudged(plan.seed, &plan.planted, Some(number))?);
    }
    let seen = look(plan, gaits, truth, &others, causes)?;
    let rate_hz = 1000.0 / SAMPLE_TICKS as f64;
    let count = seen.spread.len().max(1) as f64;
    let weights: Vec<f64> = (0..CHANNELS)
        .map(|c| {
            if !recorded(plan, c) {
                return 0.0;
            }
            let spread = seen.spread.iter().map(|r| r[c] * r[c]).sum::<f64>() / count;
            1.0 / libm::sqrt(noise(c) * noise(c) + spread * (lasts_s(c) * rate_hz).max(1.0))
        })
        .collect();
    let weighted = |rows: &Rows| -> Vec<f64> {
        let row = |r: &[f64; CHANNELS]| r.iter().zip(&weights).map(|(x, w)| x * w).collect();
        rows.iter().flat_map(|r| -> Vec<f64> { row(r) }).collect()
    };
    let (gone, off) = seen.others.split_at(causes.min(seen.others.len()));
    let [gone, off] = [gone, off].map(|rows| rows.iter().map(weighted).collect::<Vec<_>>());
    // From the windows that were looked at to all runs.
    let looked = seen.spread.len() as f64 / WINDOW as f64;
    let all = (gaits.len() * REPEATS) as f64 * plan.duration_s / looked.max(1.0);
    let shown = evidence::remaining(&gone, &off).into_iter().zip(seen.film);
    let with_film = |((full, left), film): ((f64, f64), f64)| {
        let film = if plan.seen_by.camera() { film } else { 0.0 };
        (all * (full + film), all * (left + film))
    };
    Some(shown.map(with_film).collect())
}

fn again(
    reality: &Reality,
    gait: &Gait,
    from: (&Snapshot, &Reality),
    run: Option<(u64, u64)>,
) -> Option<Vec<Sample>> {
    Some(Machine::resume(reality, gait, from, run)?.record(WINDOW))
}

/// How far the robot's picture moves between two cameras, root mean square in floors.
fn filmed(a: &CameraTruth, b: &CameraTruth, track: &[Sample]) -> f64 {
    if a == b {
        return 0.0;
    }
    let place = |c: &CameraTruth, s: &Sample| {
        let [x, y, z] = s.base.position_m.map(f64::from);
        let scale = write::FOCAL_PX / (c.height_m - z);
        let (sin, cos) = libm::sincos(c.yaw_rad);
        let (dx, dy) = (x - c.x_m, y - c.y_m);
        [
            scale * (cos * dx + sin * dy),
            scale * (cos * dy - sin * dx),
            scale,
        ]
    };
    let late = |c: &CameraTruth, k: usize| {
        let shift = libm::round(c.shift_s * 1000.0 / SAMPLE_TICKS as f64) as i64;
        let at = (k as i64 + shift).clamp(0, track.len() as i64 - 1);
        &track[at as usize]
    };
    // Size of the robot's picture counts with half its length, 0.22 m.
    let squares: f64 = (0..track.len())
        .map(|k| {
            let (p, q) = (place(a, late(a, k)), place(b, late(b, k)));
            let (dx, dy, ds) = (p[0] - q[0], p[1] - q[1], 0.22 * (p[2] - q[2]));
            dx * dx + dy * dy + ds * ds
        })
        .sum();
    let moved = libm::sqrt(squares / track.len().max(1) as f64) / CENTRE_PX;
    // Lost frames are counted: their number over its own spread in a film of 60 frames.
    let lost = (a.drop - b.drop).abs() * libm::sqrt(60.0);
    moved.max(lost)
}
