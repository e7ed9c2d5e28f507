//! Fitness of a gait from its repetitions (paper, section V).

use serde::{Deserialize, Serialize};

/// What one simulated trial came to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrialOutcome {
    /// Horizontal path of body 3 at a constant rate from the start of the gait, m.
    pub path_m: Vec<[f32; 2]>,
    /// Time between points of the path, s.
    pub period_s: f32,
    /// Whether half-spheres of the robot met.
    pub collided: bool,
    /// Fastest approach of a ground contact, m/s.
    pub impact_m_s: f32,
    /// Simulation step at which a number was lost; the trial counts as failed.
    pub failed_at_step: Option<u64>,
}

impl TrialOutcome {
    /// Distance between first and last point over the time between them, m/s.
    #[must_use]
    pub fn speed_m_s(&self) -> f64 {
        match (self.path_m.first(), self.path_m.last()) {
            (Some(a), Some(b)) if self.path_m.len() > 1 => {
                distance_m(*a, *b) / (f64::from(self.period_s) * (self.path_m.len() - 1) as f64)
            }
            _ => 0.0,
        }
    }
}

/// What the paper leaves unsaid about the fitness, with our choices.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScoreSettings {
    /// Repetitions per gait; the paper's 3.
    pub repetitions: u16,
    /// Mean distance between repetitions at which the fitness is halved, m: one cube.
    pub deviation_half_m: f64,
}

impl Default for ScoreSettings {
    fn default() -> Self {
        Self {
            repetitions: 3,
            deviation_half_m: 0.110,
        }
    }
}

/// The verdict on one gait.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// What the swarm maximises, m/s.
    pub fitness: f64,
    /// Mean speed over the repetitions, m/s.
    pub speed_m_s: f64,
    /// Mean distance between pairs of repetitions at equal times, m.
    pub deviation_m: f64,
    /// Hardest ground contact of all repetitions, m/s.
    pub impact_m_s: f32,
    /// Whether any repetition collided with itself.
    pub collided: bool,
    /// Whether any repetition lost a number.
    pub failed: bool,
}

impl ScoreSettings {
    /// Score the repetitions of one gait; a ground contact faster than `impact_limit_m_s` refuses it.
    #[must_use]
    pub fn score(&self, trials: &[TrialOutcome], impact_limit_m_s: f32) -> Score {
        let n = trials.len().max(1) as f64;
        let speed_m_s = trials.iter().map(TrialOutcome::speed_m_s).sum::<f64>() / n;
        let deviation_m = mean_deviation_m(trials);
        let impact_m_s = trials
            .iter()
            .fold(0.0f32, |m, trial| m.max(trial.impact_m_s));
        let collided = trials.iter().any(|trial| trial.collided);
        let failed = trials.is_empty() || trials.iter().any(|trial| trial.failed_at_step.is_some());
        let refused = collided || failed || impact_m_s > impact_limit_m_s;
        let fitness = if refused {
            0.0
        } else {
            speed_m_s / (1.0 + deviation_m / self.deviation_half_m)
        };
        Score {
            fitness,
            speed_m_s,
            deviation_m,
            impact_m_s,
            collided,
            failed,
        }
    }
}

/// Mean over all pairs of repetitions and all common times of the distance between their paths.
fn mean_deviation_m(trials: &[TrialOutcome]) -> f64 {
    let (mut sum, mut points) = (0.0, 0u32);
    for (k, a) in trials.iter().enumerate() {
        for b in &trials[k + 1..] {
            for (p, q) in a.path_m.iter().zip(&b.path_m) {
                sum += distance_m(*p, *q);
                points += 1;
            }
        }
    }
    if points == 0 {
        0.0
    } else {
        sum / f64::from(points)
    }
}

fn distance_m(a: [f32; 2], b: [f32; 2]) -> f64 {
    let (dx, dy) = (f64::from(a[0] - b[0]), f64::from(a[1] - b[1]));
    (dx * dx + dy * dy).sqrt()
}
