//! Positions that were measured correct the simulation, so that rows are predicted over a short horizon.
//!
//! A critically damped tracking filter (alpha-beta; Brookner 1998, "Tracking and Kalman Filtering Made Easy", 1.2):
//! with `r = exp(-interval / horizon)` the angle takes `1 - r^2` of the error of a row, the speed `(1 - r)^2` over the
//! interval. The inner loop of a velocity servo holds the speed within less: the angle takes `1 - r`, the speed nothing.

use files::dataset::Output;

use crate::joint::data::{RunData, Sample};

/// When the simulation was corrected last.
pub(super) struct Observer {
    horizon_s: f64,
    /// A loop of the servo's own holds the speed.
    speed_held: bool,
    dt_s: f64,
    last_s: f64,
}

/// What of a row's error is taken.
pub(super) struct Gains {
    /// By the angle.
    pub(super) position: f64,
    /// By the speed, 1/s.
    pub(super) speed_hz: f64,
    /// Steps since the row before.
    pub(super) steps: f64,
}

impl Observer {
    pub(super) fn new(run: &RunData, dt_s: f64) -> Self {
        Self {
            horizon_s: run.horizon_s,
            speed_held: run.nominal.output == Output::Velocity,
            dt_s,
            last_s: 0.0,
        }
    }

    /// The command was switched, and the simulation starts from what was measured at `step`.
    pub(super) fn restart(&mut self, step: usize) {
        self.last_s = step as f64 * self.dt_s;
    }

    /// How a row corrects; `None` where nothing is to be corrected.
    pub(super) fn gains(&mut self, row: &Sample) -> Option<Gains> {
        if !self.horizon_s.is_finite() || !row.enabled || !row.measured[0].is_finite() {
            return None;
        }
        let now_s = (row.step as f64 + row.part) * self.dt_s;
        let interval_s = now_s - self.last_s;
        if interval_s <= 0.0 {
            return None;
        }
        self.last_s = now_s;
        let r = libm::exp(-interval_s / self.horizon_s);
        let [position, speed_hz] = if self.speed_held {
            [1.0 - r, 0.0]
        } else {
            [1.0 - r * r, (1.0 - r) * (1.0 - r) / interval_s]
        };
        Some(Gains {
            position,
            speed_hz,
            steps: interval_s / self.dt_s,
        })
    }
}
