//! The engine's clearance against that of the firmware's pre-check, which shares no code with it.
// Helpers outside `#[test]` functions may fail a test by panicking too.
#![allow(clippy::unwrap_used)]

use files::model::Model;
use physics::noise::philox;
use physics::{Drive, Level, Options, Params, Pose, Start, Trial, Twist, run_at};
use std::sync::Arc;

#[test]
fn two_geometries_agree_where_cubes_are_near() {
    let params = Arc::new(Params::try_from(&Model::hand_tuned()).unwrap());
    let h = 0.001;
    let options = Options {
        time_step_s: h,
        ..Options::default()
    };
    let unit = |k: u32, j: u32| f64::from(philox([k, j, 0, 0], [9, 9])[0]) / 4_294_967_296.0;
    let (mut near, mut hit, mut worst) = (0, 0, 0.0f64);
    for block in 0..300 {
        let poses: Vec<[f32; 6]> = (block * 16..block * 16 + 16)
            .map(|k| {
                // 3.6 % of all pairs of joints 2 and 3 bring cubes 1 and 4 within one edge (design, section 2.1).
                std::array::from_fn(|j| {
                    ((unit(k, j as u32) * 2.0 - 1.0) * std::f64::consts::PI) as f32
                })
            })
            .collect();
        let trials: Vec<Trial> = poses
            .iter()
            .map(|q| Trial {
                params: Arc::clone(&params),
                start: Start::State {
                    base: Pose {
                        position_m: [0.0, 0.0, 5.0],
                        quaternion: [1.0, 0.0, 0.0, 0.0],
                    },
                    twist: Twist::default(),
                    angles_rad: q.to_vec(),
                    speeds_rad_s: vec![0.0; 6],
                },
                drive: Drive::SetPoints {
                    period_s: 1.0,
                    values_rad: Arc::from(*q),
                },
                duration_s: h,
            })
            .collect();
        for (q, out) in poses
            .iter()
            .zip(run_at(Level::detect(), &trials, &options).unwrap())
        {
            let precheck = params.robot.precheck_clearance_m(q).unwrap();
            if out.clearance_m >= 1.0 {
                assert!(precheck > 0.003, "engine far, pre-check {precheck}: {q:?}");
                continue;
            }
            near += 1;
            hit += u32::from(precheck < 0.0);
            if precheck > 0.0 {
                worst = worst.max((out.clearance_m - precheck).abs());
            }
            // An overlap that one sees by more than the rounding of the other's bound, both see.
            assert!(
                precheck > -0.002 || out.clearance_m < 0.0,
                "{precheck} {q:?}"
            );
            assert!(
                out.clearance_m > -0.004 || precheck < 0.0,
                "{} {precheck} {q:?}",
                out.clearance_m
            );
        }
    }
    assert!(near > 100 && hit > 20, "too few near poses: {near}, {hit}");
    assert!(worst < 0.004, "{worst}");
}
