//! The clock of a film against the clock of the robot: the first motion is the mark.
//!
//! Robot and camera are switched on apart, and nothing but motion is seen by both. The robot rests, then moves; how much
//! the outline changes from frame to frame and how much the joints turn in the same time rise together. The edge of both
//! gives the shift to a few frames, the likeness of the two curves behind it to a fraction of one.

/// How far something has gone by some instants of its own clock: rising times, and travel that never falls.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Travel {
    points: Vec<(f64, f64)>,
}

impl Travel {
    /// Nothing yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// By `t_s` it has gone `further` than at the instant before. Instants that do not rise and amounts below zero or that
    /// are no number are left out.
    pub fn push(&mut self, t_s: f64, further: f64) {
        let (last_s, sum) = self
            .points
            .last()
            .copied()
            .unwrap_or((f64::NEG_INFINITY, 0.0));
        if t_s > last_s && further >= 0.0 && t_s.is_finite() && further.is_finite() {
            self.points.push((t_s, sum + further));
        }
    }

    /// Travel by `t_s`, linear between instants, constant outside.
    fn at(&self, t_s: f64) -> f64 {
        let after = self.points.partition_point(|point| point.0 <= t_s);
        match (
            after.checked_sub(1).map(|k| self.points[k]),
            self.points.get(after),
        ) {
            (Some((a_s, a)), Some(&(b_s, b))) => a + (t_s - a_s) / (b_s - a_s) * (b - a),
            (Some((_, a)), None) => a,
            (None, _) => 0.0,
        }
    }

    /// Begin and end of the time covered, s.
    fn span_s(&self) -> Option<(f64, f64)> {
        Some((self.points.first()?.0, self.points.last()?.0))
    }

    /// Way in each step of [`EDGE_STEP_S`], from the first instant on.
    fn steps(&self) -> Vec<f64> {
        let Some((from_s, to_s)) = self.span_s() else {
            return Vec::new();
        };
        let count = ((to_s - from_s) / EDGE_STEP_S) as usize;
        let step = |k: usize| {
            let t_s = from_s + k as f64 * EDGE_STEP_S;
            self.at(t_s + EDGE_STEP_S) - self.at(t_s)
        };
        (0..count).map(step).collect()
    }

    /// The pace of what moves: the median of the steps that are no rest, per second; `None` when nothing moves. A fall or a
    /// flicker does not change it.
    fn pace_per_s(&self) -> Option<f64> {
        let steps = self.steps();
        let most = steps.iter().copied().fold(0.0, f64::max);
        let mut moving: Vec<f64> = steps
            .into_iter()
            .filter(|step| *step > REST_SHARE * most)
            .collect();
        moving.sort_by(f64::total_cmp);
        let median = *moving.get(moving.len() / 2)?;
        (median > 0.0).then_some(median / EDGE_STEP_S)
    }

    /// The pace that tells motion from rest, per second: a small share of the usual one, and well above what flickers in the
    /// first [`REST_S`], which must be rest.
    fn knee_per_s(&self) -> Option<f64> {
        let flicker = self
            .steps()
            .into_iter()
            .take((REST_S / EDGE_STEP_S) as usize)
            .fold(0.0, f64::max);
        let knee = EDGE_SHARE * self.pace_per_s()?;
        Some(knee.max(FLICKER * flicker / EDGE_STEP_S))
    }

    /// When the first motion begins, s: the first step that is no rest.
    fn edge_s(&self, knee_per_s: f64) -> Option<f64> {
        let (from_s, _) = self.span_s()?;
        let least = knee_per_s * EDGE_STEP_S;
        let edge = self.steps().iter().position(|step| *step > least)?;
        Some(from_s + edge as f64 * EDGE_STEP_S)
    }
}

/// Steps in which the edge is looked for, s: the period of the robot's telemetry, longer than a frame.
const EDGE_STEP_S: f64 = 0.05;
/// Steps below this share of the largest one are rest.
const REST_SHARE: f64 = 0.01;
/// A step above this share of the pace is motion. Chosen: the outline of a slow first motion changes by less than a pixel.
const EDGE_SHARE: f64 = 0.05;
/// A step above this many times the largest one at rest is motion.
const FLICKER: f64 = 3.0;
/// The camera must have seen the robot rest this long before it moved, s.
pub const REST_S: f64 = 0.4;
/// Shifts are searched this far about the one the edges give, s.
const REACH_S: f64 = 1.0;
/// Grid of the search, s: an eighth of a frame at 30 Hz.
const GRID_S: f64 = 1.0 / 240.0;
/// Motion compared from before the edge to this long after it, s. Later the robot may fall over, which the film shows and the
/// joints do not.
const WINDOW_S: (f64, f64) = (1.5, 1.0);
/// Curves less alike than this are not of the same run.
pub const LEAST_CORRELATION: f64 = 0.8;

/// How a film lies in time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// Add to the film's clock to get the robot's, s.
    pub offset_s: f64,
    /// The same from the two edges alone, s: a check, good to a few frames.
    pub edge_offset_s: f64,
    /// Likeness of the two curves, up to 1.
    pub correlation: f64,
    /// How long the film shows rest before the first motion, s.
    pub rest_s: f64,
}

/// Why a film could not be laid in time.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SyncError {
    /// Nothing moves in the film.
    #[error("nothing moves in the film: is it the film of this run?")]
    FilmAtRest,
    /// Nothing moves in the recording.
    #[error("no joint moves in the recording")]
    RobotAtRest,
    /// The film begins too late.
    #[error(
        "the film shows {rest_s:.2} s of rest before the first motion, the mark needs {REST_S} s: start the camera first, or give the robot a longer countdown"
    )]
    NoRest {
        /// Rest seen, s.
        rest_s: f64,
    },
    /// The motions differ.
    #[error(
        "the motion in the film is not that of the run (correlation {correlation:.2}, needed {LEAST_CORRELATION}): is it the film of another run?"
    )]
    Unlike {
        /// Best correlation found.
        correlation: f64,
    },
}

/// Lays the film's clock on the robot's. `film` has one entry per frame: the change of the outline since the frame before;
/// `robot` one per sample: the way of the joints since the sample before, from before the first motion on.
///
/// # Errors
/// [`SyncError`]
pub fn align(film: &Travel, robot: &Travel) -> Result<Alignment, SyncError> {
    let pace = film.pace_per_s().ok_or(SyncError::FilmAtRest)?;
    let film_knee = film.knee_per_s().ok_or(SyncError::FilmAtRest)?;
    let robot_knee = robot.knee_per_s().ok_or(SyncError::RobotAtRest)?;
    // A film that begins in motion has no rest to tell motion from.
    let edge_knee = if film_knee < pace {
        film_knee
    } else {
        EDGE_SHARE * pace
    };
    let edge_s = film.edge_s(edge_knee).ok_or(SyncError::FilmAtRest)?;
    let robot_edge_s = robot.edge_s(robot_knee).ok_or(SyncError::RobotAtRest)?;
    let (from_s, _) = film.span_s().ok_or(SyncError::FilmAtRest)?;
    let rest_s = edge_s - from_s;
    if rest_s < REST_S {
        return Err(SyncError::NoRest { rest_s });
    }
    let edge_offset_s = robot_edge_s - edge_s;
    let (before_s, after_s) = WINDOW_S;
    let intervals: Vec<(f64, f64, f64)> = film
        .points
        .windows(2)
        .map(|pair| (pair[0].0, pair[1].0, pair[1].1 - pair[0].1))
        .filter(|(a_s, b_s, _)| *a_s >= edge_s - before_s && *b_s <= edge_s + after_s)
        .collect();
    let likeness = |offset_s: f64| {
        let pairs = intervals.iter().map(|(a_s, b_s, seen)| {
            let went = robot.at(b_s + offset_s) - robot.at(a_s + offset_s);
            let length_s = b_s - a_s;
            (
                share(*seen, film_knee * length_s),
                share(went, robot_knee * length_s),
            )
        });
        correlation(pairs)
    };
    let count = (REACH_S / GRID_S) as i32;
    let at = |k: i32| edge_offset_s + f64::from(k) * GRID_S;
    let best = (-count..=count).map(|k| (k, likeness(at(k)))).fold(
        (0, f64::NEG_INFINITY),
        |best, next| {
            if next.1 > best.1 { next } else { best }
        },
    );
    if best.1.is_nan() || best.1 < LEAST_CORRELATION {
        return Err(SyncError::Unlike {
            correlation: best.1,
        });
    }
    let (left, right) = (likeness(at(best.0 - 1)), likeness(at(best.0 + 1)));
    let bend = left - 2.0 * best.1 + right;
    let fine = if bend < 0.0 {
        (0.5 * (left - right) / bend).clamp(-0.5, 0.5)
    } else {
        0.0
    };
    Ok(Alignment {
        offset_s: at(best.0) + fine * GRID_S,
        edge_offset_s,
        correlation: best.1,
        rest_s,
    })
}

/// A way as a share of itself and the knee: whether it moves counts more than how fast.
fn share(way: f64, knee: f64) -> f64 {
    way / (way + knee)
}

/// Pearson's correlation; 0 when either side does not vary.
fn correlation(pairs: impl Iterator<Item = (f64, f64)> + Clone) -> f64 {
    let (mut n, mut sum_a, mut sum_b) = (0.0, 0.0, 0.0);
    for (a, b) in pairs.clone() {
        n += 1.0;
        sum_a += a;
        sum_b += b;
    }
    let (mean_a, mean_b) = (sum_a / n, sum_b / n);
    let (mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0);
    for (a, b) in pairs {
        aa += (a - mean_a) * (a - mean_a);
        bb += (b - mean_b) * (b - mean_b);
        ab += (a - mean_a) * (b - mean_b);
    }
    if aa > 0.0 && bb > 0.0 {
        ab / (aa * bb).sqrt()
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rest, a ramp, a short stop, then swings: as a robot goes to its start pose and begins.
    fn speed(t_s: f64) -> f64 {
        match t_s {
            t if t < 2.0 => 0.0,
            t if t < 3.3 => 1.0,
            t if t < 3.8 => 0.0,
            t => 0.8 * libm::fabs(libm::sin(1.3 * (t - 3.8))),
        }
    }

    fn travel(
        rate_hz: f64,
        from_s: f64,
        to_s: f64,
        clock: impl Fn(f64) -> f64,
        gain: f64,
    ) -> Travel {
        let mut travel = Travel::new();
        let count = ((to_s - from_s) * rate_hz) as usize;
        for k in 0..count {
            let t_s = from_s + k as f64 / rate_hz;
            // Midpoint rule in ten parts.
            let part_s = 0.1 / rate_hz;
            let way: f64 = (0..10)
                .map(|i| speed(t_s - (f64::from(i) + 0.5) * part_s) * part_s)
                .sum();
            travel.push(clock(t_s), gain * way);
        }
        travel
    }

    #[test]
    fn the_shift_of_the_clocks_is_found_to_a_fifth_of_a_frame() {
        for shift_s in [-40.0, -0.017, 0.0, 0.4, 1234.5] {
            let robot = travel(20.0, 0.5, 12.0, |t| t, 1.0);
            let film = travel(30.0, 0.7, 11.0, |t| t - shift_s, 5000.0);
            let found = align(&film, &robot).unwrap();
            assert!(
                (found.offset_s - shift_s).abs() < 0.2 / 30.0,
                "{shift_s}: {found:?}"
            );
            assert!((found.edge_offset_s - shift_s).abs() < 0.1, "{found:?}");
            assert!(
                found.correlation > 0.95 && (found.rest_s - 1.3).abs() < 0.1,
                "{found:?}"
            );
        }
    }

    #[test]
    fn a_film_that_cannot_be_laid_in_time_says_why() {
        let robot = travel(20.0, 0.5, 12.0, |t| t, 1.0);
        let late = travel(30.0, 1.9, 11.0, |t| t, 1.0);
        assert!(matches!(
            align(&late, &robot),
            Err(SyncError::NoRest { .. })
        ));
        let still = travel(30.0, 0.0, 1.9, |t| t, 1.0);
        assert_eq!(align(&still, &robot), Err(SyncError::FilmAtRest));
        assert_eq!(align(&robot, &still), Err(SyncError::RobotAtRest));
        let mut other = Travel::new();
        for k in 0..200 {
            // Rest, then a motion that comes and goes against all the robot does.
            let t_s = f64::from(k) * 0.04;
            let goes = t_s > 1.0 && (k / 6) % 2 == 0;
            other.push(t_s, if goes { 1.0 } else { 0.0 });
        }
        assert!(matches!(
            align(&other, &robot),
            Err(SyncError::Unlike { .. })
        ));
    }
}
