//! What an oracle could gain by each cause: windows of one second from the recorded state, noise-free, with and without it.

use control::gait::Gait;

use super::machine::{Machine, Sample, Snapshot};
use super::reality::{CameraTruth, Reality};
use super::{JOINTS, Plan, SAMPLE_TICKS, Signal, write};

/// Samples of a window.
const WINDOW: usize = 1000 / SAMPLE_TICKS as usize;
/// Of the gaits, one in three is looked at.
const EVERY: usize = 3;
/// Noise of a silhouette's centre, pixels: a third of an edge pixel's width over some hundred edge pixels, and the cut.
const CENTRE_PX: f64 = 0.5;

/// Channels: six each of encoder, current, duty and applied set-point, then bus, rates, base position, base attitude.
const CHANNELS: usize = 4 * JOINTS + 1 + 3 + 3 + 1;
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

/// What a channel belongs to; angles and base pose are always recorded.
fn signal(channel: usize) -> Option<Signal> {
    match channel {
        c if c < JOINTS => None,
        c if c < 2 * JOINTS => Some(Signal::Current),
        c if c < 3 * JOINTS => Some(Signal::Duty),
        c if c < 4 * JOINTS => Some(Signal::Echo),
        c if c == 4 * JOINTS => Some(Signal::Bus),
        c if c < BASE => Some(Signal::Inertial),
        _ => None,
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
    for k in 0..3 {
        out[4 * JOINTS + 1 + k] = a.gyro_rad_s[k] - b.gyro_rad_s[k];
        out[BASE + k] = f64::from(a.base.position_m[k] - b.base.position_m[k]);
    }
    let dot: f64 = a
        .base
        .quaternion
        .iter()
        .zip(b.base.quaternion)
        .map(|(x, y)| f64::from(x * y))
        .sum();
    out[BASE + 3] = 2.0 * libm::acos(dot.abs().min(1.0));
    out
}

#[derive(Default)]
struct Squares {
    sum: Vec<f64>,
    count: f64,
}

impl Squares {
    fn add(&mut self, a: &[Sample], b: &[Sample]) {
        self.sum.resize(CHANNELS, 0.0);
        for (x, y) in a.iter().zip(b) {
            self.count += 1.0;
            for (s, d) in self.sum.iter_mut().zip(difference(x, y)) {
                *s += d * d;
            }
        }
    }

    fn rms(&self, channel: usize) -> f64 {
        let sum = self.sum.get(channel).copied().unwrap_or(0.0);
        (sum / self.count.max(1.0)).sqrt()
    }
}

/// Per cause: floors on encoder or base, and on any channel.
pub(super) fn floors(plan: &Plan, gaits: &[Gait], truth: &Reality) -> Option<Vec<(f64, f64)>> {
    if plan.planted.is_empty() {
        return Some(Vec::new());
    }
    let others: Vec<Reality> = (0..plan.planted.len())
        .map(|k| {
            let mut rest = plan.planted.clone();
            rest.remove(k);
            Reality::new(plan.seed, &rest)
        })
        .collect::<Option<_>>()?;
    let mut spread = Squares::default();
    let mut without: Vec<Squares> = others.iter().map(|_| Squares::default()).collect();
    let mut film: Vec<f64> = vec![0.0; others.len()];
    let windows = plan.duration_s as u64;
    for (g, gait) in gaits.iter().enumerate().step_by(EVERY) {
        let mut clean = Machine::new(truth, gait, None)?;
        for w in 0..windows {
            let from = clean.snapshot();
            let with = clean.record(WINDOW);
            let run = (plan.seed, g as u64 * windows + w);
            let from = (&from, truth);
            spread.add(&with, &again(truth, gait, from, Some(run))?);
            for ((other, squares), film) in others.iter().zip(&mut without).zip(&mut film) {
                let other_window = again(other, gait, from, None)?;
                squares.add(&with, &other_window);
                *film = film.max(filmed(&truth.camera, &other.camera, &with));
            }
        }
    }
    let pose = BASE..CHANNELS;
    let size = |s: &Squares, c: usize| {
        let floor = libm::sqrt(noise(c) * noise(c) + spread.rms(c) * spread.rms(c));
        s.rms(c) / floor
    };
    let sizes = without.iter().zip(film).map(|(s, film)| {
        let of =
            |range: &mut dyn Iterator<Item = usize>| range.map(|c| size(s, c)).fold(0.0, f64::max);
        let film = if plan.seen_by.camera() { film } else { 0.0 };
        let main = of(&mut (0..JOINTS)).max(of(&mut pose.clone())).max(film);
        let recorded = |c: &usize| signal(*c).is_none_or(|x| !plan.without.contains(&x));
        (main, of(&mut (0..CHANNELS).filter(recorded)).max(film))
    });
    Some(sizes.collect())
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
