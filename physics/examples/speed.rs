//! Simulated seconds per second on one core, at every level this processor has.

#[path = "../tests/common/mod.rs"]
mod common;

use files::model::Model;
use physics::{Drive, Level, Options, Params, Start, Trial, run_at};
use std::sync::Arc;
use std::time::Instant;

fn main() {
    let params =
        Arc::new(Params::try_from(&Model::hand_tuned()).expect("the default model is valid"));
    let trials: Vec<Trial> = (0..64)
        .map(|k| Trial {
            params: Arc::clone(&params),
            start: Start::HomeAtOnce,
            drive: Drive::Gait {
                gait: Arc::new(common::random_gait(1, k, (0.5, 1.2))),
                noise_rad: 0.0,
                seed: 0,
            },
            duration_s: 30.0,
        })
        .collect();
    for level in [
        Level::Reference,
        Level::Scalar,
        Level::Sse2,
        Level::Avx2,
        Level::Avx512,
    ] {
        let count = if level.lanes() == 1 { 4 } else { 64 };
        let start = Instant::now();
        let out = run_at(level, &trials[..count], &Options::default()).expect("valid trials");
        let wall_s = start.elapsed().as_secs_f64();
        let mean: f64 = out.iter().map(|o| o.distance_m).sum::<f64>() / count as f64;
        let worst = out.iter().map(|o| o.penetration_m.1).fold(0.0, f64::max);
        let depth = out.iter().map(|o| o.penetration_m.0).sum::<f64>() / count as f64;
        let track = out.iter().map(|o| o.tracking_rms_rad).sum::<f64>() / count as f64;
        println!(
            "{level:?}: {:.0} x real time, mean distance {mean:.4} m, penetration mean {:.4} worst {:.3} mm, tracking {track:.4} rad, nan {}",
            30.0 * count as f64 / wall_s,
            depth * 1e3,
            worst * 1e3,
            out.iter().filter(|o| o.not_finite.is_some()).count(),
        );
    }
}
