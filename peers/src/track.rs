//! What an engine did with the trials, in one form for all engines.

use physics::{Drive, Level, Options, Outcome, Pose, Trial, run_at};

/// Ticks of a 30 s trial at 20 Hz.
pub const TICKS: usize = 600;
/// Joints of the meta-module.
pub const JOINTS: usize = 6;

/// Base position (m), quaternion (w first) and joint angles (rad) at 20 Hz, t = 0 and the end included.
pub type Track = Vec<[f64; 7 + JOINTS]>;

/// What an engine did with all trials.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// One per trial.
    pub tracks: Vec<Track>,
    /// Name and value of what the engine measured of itself.
    pub figures: Vec<(String, f64)>,
}

impl Report {
    /// One figure; NaN when the engine gave none of that name.
    #[must_use]
    pub fn figure(&self, name: &str) -> f64 {
        self.figures
            .iter()
            .find(|(n, _)| n == name)
            .map_or(f64::NAN, |(_, v)| *v)
    }
}

/// Our own engine.
///
/// # Panics
/// When a trial does not fit its robot or diverged: such a run is no reference.
#[must_use]
pub fn ours(level: Level, trials: &[Trial], time_step_s: f64, sweeps: u32) -> Report {
    let options = Options {
        time_step_s,
        sweeps,
        record_angles: true,
        ..Options::default()
    };
    let outcomes = run_at(level, trials, &options).expect("valid trials");
    Report {
        tracks: outcomes.iter().map(track).collect(),
        figures: Vec::new(),
    }
}

fn track(outcome: &Outcome) -> Track {
    assert!(outcome.not_finite.is_none(), "a trial diverged");
    let row = |(pose, angles): (&Pose, &[f32])| {
        let mut row = [0.0; 7 + JOINTS];
        let values = pose.position_m.iter().chain(&pose.quaternion).chain(angles);
        for (slot, x) in row.iter_mut().zip(values) {
            *slot = f64::from(*x);
        }
        row
    };
    let angles = outcome.angles_rad.chunks(JOINTS);
    outcome.poses.iter().zip(angles).map(row).collect()
}

/// The set-points of a trial at 20 Hz, joint by joint within a tick, rad; from the control crate, as the robot would get them.
#[must_use]
pub fn set_points(trial: &Trial) -> Vec<f64> {
    let Drive::Gait { gait, .. } = &trial.drive else {
        return Vec::new();
    };
    let mut state = control::cpg::start(gait);
    (0..TICKS)
        .flat_map(|_| {
            let out = control::cpg::step(gait, &mut state, 0.05);
            out.as_slice()
                .iter()
                .map(|x| f64::from(*x))
                .collect::<Vec<f64>>()
        })
        .collect()
}
