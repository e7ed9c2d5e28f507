//! Gaits for the next experiment: what was played before, read off its set-points, and variations of a gait.

use control::gait::{Gait, Oscillator, RawGait};

use super::data::{JOINTS, Run};
use super::least::solve;

/// Rate of the amplitude filter, 1/s (paper, section III), and the time after which its start is over: e^-6.
const RATE_A_PER_S: f32 = 2.0;
const SETTLED_S: f64 = 3.0;
/// Set-points that a sine leaves by more than this, root mean square, are no gait, rad.
const SINE_RAD: f64 = 0.02;
/// Frequencies that are tried, Hz: those that a gait may have and a run of some seconds shows.
const FREQUENCIES_HZ: [f64; 2] = [0.05, 2.0];
/// A joint lifts what hangs on it by this, rad, this often, Hz.
const LIFT: (f32, f32) = (0.6, 0.1);

/// `raw` as a gait of `length_s`, named `base` and `change`.
fn finished(mut raw: RawGait, length_s: f64, base: &str, change: &str) -> Option<Gait> {
    raw.duration_s = length_s as f32;
    raw.name.clear();
    let room = control::gait::MAX_NAME - change.len();
    for c in base.chars().filter(|c| !c.is_control()) {
        if raw.name.len() + c.len_utf8() > room {
            break;
        }
        raw.name.push(c).ok()?;
    }
    raw.name.push_str(change).ok()?;
    Gait::try_from(raw).ok()
}

/// The gait itself, slower, faster and mirrored, for `length_s`; what the limits of a gait forbid is left out.
pub(super) fn variations(gait: &Gait, length_s: f64) -> Vec<Gait> {
    let mut mirrored = gait.raw();
    for o in &mut mirrored.oscillators {
        o.offset_rad = -o.offset_rad;
        o.initial_phase_rad = wrapped(o.initial_phase_rad + std::f32::consts::PI);
    }
    let all = [
        finished(gait.raw(), length_s, gait.name(), ""),
        timed(gait, length_s, 0.5, "_slower"),
        timed(gait, length_s, 1.5, "_faster"),
        finished(mirrored, length_s, gait.name(), "_mirrored"),
    ];
    all.into_iter().flatten().collect()
}

/// The gait at `factor` times its frequency.
fn timed(gait: &Gait, length_s: f64, factor: f32, change: &str) -> Option<Gait> {
    let mut raw = gait.raw();
    raw.frequency_hz *= factor;
    finished(raw, length_s, gait.name(), change)
}

/// As many periods of the gait at half its frequency.
pub(super) fn slower(gait: &Gait) -> Option<Gait> {
    timed(gait, 2.0 * f64::from(gait.duration_s()), 0.5, "_slower")
}

fn wrapped(x: f32) -> f32 {
    use std::f32::consts::{PI, TAU};
    let turns = ((x + PI) / TAU).floor();
    x - turns * TAU
}

/// One joint alone, the others at zero.
pub(super) fn lifts(length_s: f64) -> Vec<Gait> {
    let lift = |joint: usize| {
        let mut raw = RawGait {
            frequency_hz: LIFT.1,
            rate_a_per_s: RATE_A_PER_S,
            ..RawGait::default()
        };
        for k in 0..JOINTS {
            let one = Oscillator {
                amplitude_rad: if k == joint { LIFT.0 } else { 0.0 },
                offset_rad: 0.0,
                initial_phase_rad: 0.0,
            };
            raw.oscillators.push(one).ok()?;
        }
        finished(raw, length_s, &format!("lift_joint_{joint}"), "")
    };
    (0..JOINTS).filter_map(lift).collect()
}

/// Sines at one frequency through the set-points of a run: mean, sine and cosine part of every joint.
struct Sines {
    joints: [[f64; 3]; JOINTS],
    /// What they leave, squared and averaged.
    left: f64,
}

/// Times, s, and values of a joint's set-points once the start is over.
type Points<'a> = (&'a [f64], &'a [f64]);

fn sines(points: &[Points<'_>; JOINTS], frequency_hz: f64) -> Sines {
    let mut out = Sines {
        joints: [[0.0; 3]; JOINTS],
        left: 0.0,
    };
    for ((t_s, v), joint) in points.iter().zip(&mut out.joints) {
        let (mut a, mut b, mut square) = ([0.0; 9], [0.0; 3], 0.0);
        for (t, v) in t_s.iter().zip(*v) {
            let (sin, cos) = libm::sincos(std::f64::consts::TAU * frequency_hz * t);
            let row = [1.0, sin, cos];
            for i in 0..3 {
                b[i] += row[i] * v;
                for j in 0..3 {
                    a[3 * i + j] += row[i] * row[j];
                }
            }
            square += v * v;
        }
        // A little ridge: a joint at rest has no phase.
        for i in 0..3 {
            a[4 * i] += 1e-9;
        }
        let x = solve(&a, &b);
        let explained: f64 = x.iter().zip(&b).map(|(x, b)| x * b).sum();
        let count = (t_s.len() * JOINTS).max(1) as f64;
        out.left += (square - explained).max(0.0) / count;
        joint.copy_from_slice(&x);
    }
    out
}

/// The gait that a run was sent, read off its set-points; `None` where they are no sines of one frequency.
pub(super) fn played(run: &Run, name: &str) -> Option<Gait> {
    let mut points: [Points<'_>; JOINTS] = [(&[], &[]); JOINTS];
    for (slot, joint) in points.iter_mut().zip(&run.joints) {
        let track = joint.command.as_ref()?;
        let from = track.t_s.partition_point(|t| *t < SETTLED_S);
        *slot = (track.t_s.get(from..)?, track.v.get(from..)?);
    }
    let span_s = run.length_s - SETTLED_S;
    if span_s < 2.0 {
        return None;
    }
    // Fine enough that no sine slips through, then halved about the best.
    let mut step_hz = 0.2 / span_s;
    let count = ((FREQUENCIES_HZ[1] - FREQUENCIES_HZ[0]) / step_hz) as usize;
    let tried = (0..=count).map(|i| FREQUENCIES_HZ[0] + i as f64 * step_hz);
    let of = |f: f64| (f, sines(&points, f));
    let mut best = tried.map(of).min_by(|a, b| a.1.left.total_cmp(&b.1.left))?;
    for _ in 0..12 {
        step_hz *= 0.5;
        for f in [best.0 - step_hz, best.0 + step_hz] {
            let next = of(f);
            if next.1.left < best.1.left {
                best = next;
            }
        }
    }
    let (frequency_hz, sines) = best;
    if sines.left.sqrt() > SINE_RAD {
        return None;
    }
    let mut raw = RawGait {
        frequency_hz: frequency_hz as f32,
        rate_a_per_s: RATE_A_PER_S,
        ..RawGait::default()
    };
    for [mean, sin, cos] in sines.joints {
        let one = Oscillator {
            amplitude_rad: libm::hypot(sin, cos) as f32,
            offset_rad: mean as f32,
            initial_phase_rad: libm::atan2(cos, sin) as f32,
        };
        raw.oscillators.push(one).ok()?;
    }
    finished(raw, run.length_s, name, "")
}
