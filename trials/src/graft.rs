//! Exact faults of the measurement layer, put onto the recording of one joint.

use std::fmt::Write as _;

use files::dataset::{Motion, Recording, Signal, header_name};
use hil_sim::rng::Rng;

use crate::joint::log_uniform;

/// One graft. The robot did what it did; what is changed is what was written down, so that the recording is that of a
/// robot with the fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Graft {
    /// Nothing.
    None,
    /// Set-points were sent this much earlier than they were, s.
    Latency(f64),
    /// Each set-point was sent earlier by its own random time, 1 sigma in s.
    Jitter(f64),
    /// Set-points stand in a frame whose zero is off, rad.
    Offset(f64),
    /// Set-points stand in another unit.
    Scale(f64),
    /// Set-points have the other sign.
    Sign,
    /// The clock that listed the set-points runs at another rate than the robot's.
    Clock(f64),
    /// Readings carry time stamps that are this late, s: the same as set-points that come late.
    Stamp(f64),
    /// This share of the readings is missing: nothing to be named.
    Loss(f64),
}

/// Kinds of grafts, the two without effect among them.
pub const KINDS: usize = 8;

/// Draws the graft of case `case`: one in four without effect, the others in turn, sizes log-uniform.
pub fn draw(rng: &mut Rng, case: usize) -> Graft {
    let mut between = |low, high| log_uniform(rng, low, high);
    match case % KINDS {
        0 => Graft::Latency(between(0.015, 0.12)),
        1 => Graft::Offset(between(0.01, 0.2)),
        2 => Graft::Scale(1.0 + between(0.015, 0.2)),
        3 => Graft::None,
        4 => Graft::Clock(1.0 + between(0.002, 0.02)),
        5 => Graft::Stamp(between(0.015, 0.12)),
        6 if case % (2 * KINDS) == 6 => Graft::Sign,
        6 => Graft::Jitter(between(0.03, 0.1)),
        _ => Graft::Loss(between(0.1, 0.5)),
    }
}

impl Graft {
    /// The effect that the diagnosis should name.
    pub fn effect(self) -> Option<&'static str> {
        match self {
            Self::None | Self::Loss(_) => None,
            Self::Latency(_) | Self::Stamp(_) => Some("latency"),
            Self::Jitter(_) => Some("jitter"),
            Self::Offset(_) => Some("joint_offset"),
            Self::Scale(_) => Some("joint_scale"),
            Self::Sign => Some("joint_sign"),
            Self::Clock(_) => Some("clock_skew"),
        }
    }

    /// In words.
    pub fn told(self) -> String {
        match self {
            Self::None => "none".to_owned(),
            Self::Latency(s) => format!("latency {:.0} ms", 1e3 * s),
            Self::Jitter(s) => format!("jitter {:.0} ms", 1e3 * s),
            Self::Offset(x) => format!("offset {:.0} mrad", 1e3 * x),
            Self::Scale(x) => format!("scale {x:.3}"),
            Self::Sign => "sign".to_owned(),
            Self::Clock(x) => format!("clock {x:.4}"),
            Self::Stamp(s) => format!("time stamps {:.0} ms late", 1e3 * s),
            Self::Loss(p) => format!("{:.0} % of readings lost", 1e2 * p),
        }
    }

    /// The set-point as it is listed, of one that the robot applied.
    fn listed(self, applied: f64) -> f64 {
        match self {
            Self::Offset(x) => applied - x,
            Self::Scale(x) => applied / x,
            Self::Sign => -applied,
            _ => applied,
        }
    }

    /// When a set-point is listed that came into force at `t_s`.
    fn listed_at(self, t_s: f64, rng: &mut Rng) -> f64 {
        match self {
            Self::Latency(s) => t_s - s,
            Self::Jitter(s) => t_s - s * rng.normal().abs(),
            Self::Clock(x) => t_s * x,
            _ => t_s,
        }
    }
}

/// The first `longest_s` of a recording with a graft, as CSV. A set-point that is listed between two readings gets a
/// row of its own.
pub fn csv(
    recording: &Recording,
    motion: Motion,
    graft: Graft,
    longest_s: f64,
    seed: u64,
) -> String {
    let columns = columns(recording, motion);
    let mut out = String::from("t_s");
    for (name, _) in &columns {
        let _ = write!(out, ",{name}");
    }
    out.push('\n');
    let mut rng = Rng::new(seed, 0x6C, 0);
    let stamps = recording.t_s();
    let begin = stamps.first().copied().unwrap_or(0.0);
    let sent = events(recording, graft, &mut rng);
    let late = if let Graft::Stamp(s) = graft { s } else { 0.0 };
    let mut next = 0;
    let mut set_point = sent.first().map_or(f64::NAN, |e| e.1);
    for (row, t) in stamps.iter().enumerate() {
        if t - begin > longest_s {
            break;
        }
        let t = t + late;
        while let Some((at, value)) = sent.get(next).filter(|e| e.0 <= t) {
            set_point = *value;
            next += 1;
            if *at > begin + late && *at < t {
                line(&mut out, *at, &columns, |name, column| match name {
                    Kind::SetPoint => set_point,
                    Kind::Enable => column[row.saturating_sub(1)],
                    Kind::Reading => f64::NAN,
                });
            }
        }
        let lost = matches!(graft, Graft::Loss(p) if rng.chance(p));
        line(&mut out, t, &columns, |name, column| match name {
            Kind::SetPoint => set_point,
            Kind::Reading if lost => f64::NAN,
            _ => column[row],
        });
    }
    out
}

/// Step at which applied and listed set-points are compared, s: finer than any row and any graft.
const COMPARED_S: f64 = 2.0e-3;

/// Sum of squares and count of the difference between applied and listed set-points over a recording.
pub fn change(recording: &Recording, graft: Graft, longest_s: f64) -> (f64, f64) {
    let applied = events(recording, Graft::None, &mut Rng::new(0, 0, 0));
    let listed = events(recording, graft, &mut Rng::new(0, 0, 0));
    let late = if let Graft::Stamp(s) = graft { s } else { 0.0 };
    let held = |of: &[(f64, f64)], t: f64| {
        let next = of.partition_point(|e| e.0 <= t);
        of.get(next.saturating_sub(1)).map_or(0.0, |e| e.1)
    };
    let begin = recording.t_s().first().copied().unwrap_or(0.0);
    let end = recording
        .t_s()
        .last()
        .map_or(begin, |t| t.min(begin + longest_s));
    let steps = ((end - begin) / COMPARED_S) as usize;
    let mut squares = 0.0;
    for k in 0..steps {
        let t = begin + k as f64 * COMPARED_S;
        let d = held(&applied, t) - held(&listed, t + late);
        squares += d * d;
    }
    (squares, steps as f64)
}

/// What a column is to a graft.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    SetPoint,
    Enable,
    Reading,
}

type Column<'a> = (String, (Kind, &'a [f64]));

fn columns(recording: &Recording, motion: Motion) -> Vec<Column<'_>> {
    let mut out = Vec::new();
    let joint = recording.joint(0);
    for signal in Signal::ALL {
        // An echo of the set-point would betray every fault of the way to the drive.
        if signal == Signal::AppliedSetpoint {
            continue;
        }
        if let Some(column) = joint.and_then(|j| j.get(signal)) {
            let kind = match signal {
                Signal::Setpoint => Kind::SetPoint,
                Signal::Enable => Kind::Enable,
                _ => Kind::Reading,
            };
            out.push((header_name(signal, motion).to_owned(), (kind, column)));
        }
    }
    if let Some(column) = &recording.body().bus_v {
        out.push(("bus_v".to_owned(), (Kind::Reading, column)));
    }
    out
}

/// Set-points as listed: time and value, in order.
fn events(recording: &Recording, graft: Graft, rng: &mut Rng) -> Vec<(f64, f64)> {
    let Some(column) = recording.joint(0).and_then(|j| j.get(Signal::Setpoint)) else {
        return Vec::new();
    };
    let mut out: Vec<(f64, f64)> = Vec::new();
    let mut last = f64::NAN;
    for (t, value) in recording.t_s().iter().zip(column) {
        if value.is_nan() || *value == last {
            continue;
        }
        last = *value;
        let at = graft.listed_at(*t, rng);
        // Set-points keep their order.
        let at = out.last().map_or(at, |e| at.max(e.0));
        out.push((at, graft.listed(*value)));
    }
    out
}

fn line(out: &mut String, t_s: f64, columns: &[Column<'_>], value: impl Fn(Kind, &[f64]) -> f64) {
    let _ = write!(out, "{t_s:.6}");
    for (_, (kind, column)) in columns {
        let v = value(*kind, column);
        if v.is_nan() {
            out.push(',');
        } else {
            let _ = write!(out, ",{v}");
        }
    }
    out.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;
    use files::dataset::Manifest;

    /// Ten rows at 10 ms; the set-point steps by 0.1 rad every 30 ms, the position is a ramp.
    fn recording() -> (Manifest, Recording) {
        let text = "format = 1\nrobot = \"bench\"\n[[run]]\nfile = \"a.csv\"\n";
        let (manifest, _) = Manifest::parse("dataset.toml", text).expect("valid");
        let mut csv = String::from("t_s,setpoint_rad,position_rad\n");
        for k in 0..10 {
            csv.push_str(&format!(
                "{:.2},{:.1},{:.3}\n",
                f64::from(k) * 0.01,
                0.1 * f64::from(k / 3),
                0.005 * f64::from(k)
            ));
        }
        let (recording, _) = Recording::parse("a.csv", &csv, &manifest).expect("valid");
        (manifest, recording)
    }

    fn grafted(graft: Graft) -> Recording {
        let (manifest, recording) = recording();
        let text = csv(&recording, Motion::Rotary, graft, 10.0, 1);
        Recording::parse("a.csv", &text, &manifest)
            .expect("a recording still")
            .0
    }

    fn column(r: &Recording, signal: Signal) -> &[f64] {
        r.joint(0).and_then(|j| j.get(signal)).expect("there")
    }

    /// Set-point in force at `t_s`.
    fn held(r: &Recording, t_s: f64) -> f64 {
        let at = r
            .t_s()
            .iter()
            .rposition(|t| *t <= t_s + 1e-9)
            .expect("later than the start");
        column(r, Signal::Setpoint)[at]
    }

    #[test]
    fn no_graft_changes_nothing() {
        let (_, plain) = recording();
        let same = grafted(Graft::None);
        assert_eq!(same.t_s(), plain.t_s());
        assert_eq!(
            column(&same, Signal::Setpoint),
            column(&plain, Signal::Setpoint)
        );
        assert_eq!(
            column(&same, Signal::Position),
            column(&plain, Signal::Position)
        );
        assert_eq!(change(&plain, Graft::None, 10.0).0, 0.0);
    }

    #[test]
    fn each_graft_is_the_fault_it_says() {
        // Applied at 30 ms, listed 4 ms before: a robot that takes 4 ms.
        let late = grafted(Graft::Latency(0.004));
        assert!(held(&late, 0.0255) < 0.05 && (held(&late, 0.0265) - 0.1).abs() < 1e-9);
        assert_eq!(
            column(&late, Signal::Position)
                .iter()
                .filter(|x| !x.is_nan())
                .count(),
            10
        );
        // Readings 4 ms late: the same in another clock.
        let stamp = grafted(Graft::Stamp(0.004));
        let row = stamp
            .t_s()
            .iter()
            .position(|t| (*t - 0.034).abs() < 1e-9)
            .expect("shifted");
        assert!((column(&stamp, Signal::Position)[row] - 0.015).abs() < 1e-9);
        assert!((held(&stamp, 0.0305) - 0.1).abs() < 1e-9);
        // The drive adds 0.2 to what is listed, doubles it, mirrors it.
        assert!((held(&grafted(Graft::Offset(0.2)), 0.03) + 0.1).abs() < 1e-9);
        assert!((held(&grafted(Graft::Scale(2.0)), 0.03) - 0.05).abs() < 1e-9);
        assert!((held(&grafted(Graft::Sign), 0.03) + 0.1).abs() < 1e-9);
        // A robot whose clock runs at 1.1 reaches the set-point of 33 ms at 30 ms.
        let clock = grafted(Graft::Clock(1.1));
        assert!(held(&clock, 0.032) < 0.05 && (held(&clock, 0.0335) - 0.1).abs() < 1e-9);
        let lost = grafted(Graft::Loss(0.5));
        let missing = column(&lost, Signal::Position)
            .iter()
            .filter(|x| x.is_nan())
            .count();
        assert!((2..9).contains(&missing), "{missing}");
    }
}
