//! Data sets recorded from the emulation.

use files::dataset::{Manifest, Recording, Signal};
use hil_sim::effects;
use hil_sim::motor::JointKind;
use hil_sim::recorder::{Plan, Row, record, to_csv};
use hil_sim::world::{World, WorldParams};

fn bench() -> WorldParams {
    let mut params = WorldParams::bench(1, JointKind::Intra.neutral());
    params.joints[0].load.gravity_nm = 1.0;
    params
}

fn swing(t_s: f64) -> Vec<f64> {
    vec![0.6 * (std::f64::consts::TAU * 0.2 * t_s).sin()]
}

fn run(params: &WorldParams, plan: &Plan) -> Vec<Row> {
    let mut world = World::on_stand(params).expect("valid");
    record(&mut world, &[1], plan, &mut swing).expect("healthy driver")
}

#[test]
fn a_bench_record_is_a_valid_data_set() {
    let plan = Plan {
        duration_s: 5.0,
        link: true,
        ..Plan::default()
    };
    let rows = run(&bench(), &plan);
    let csv = to_csv(&rows, 1, true);
    let manifest = "format = 1\nrobot = \"bench\"\nname = \"emulated\"\n[bench]\n[[run]]\nfile = \"a.csv\"\ngait = \"g\"\n";
    let (manifest, _) = Manifest::parse("dataset.toml", manifest).expect("manifest");
    let (recording, warnings) =
        Recording::parse("a.csv", &csv, &manifest).expect("columns are the contract's");
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!(recording.len(), 5 * 20 + 5 * 100);
    let _ = Signal::LinkPosition;
    let readings = rows
        .iter()
        .filter(|row| matches!(row, Row::Reading { .. }))
        .count();
    assert_eq!(readings, 500);
    // The neutral joint follows a slow swing with the lag of a proportional loop: (1 + T/(w0 kv T)) / kp.
    let worst = rows.iter().fold(0.0_f64, |worst, row| match row {
        Row::Reading { t_s, joints } if *t_s > 1.0 => {
            let position = f64::from(joints[0].expect("one").feedback.position_urad) * 1e-6;
            worst.max((position - swing(*t_s)[0]).abs())
        }
        _ => worst,
    });
    let speed = 0.6 * std::f64::consts::TAU * 0.2;
    let lag_s = (1.0 + 1.0 / (0.8 * 2.786)) / 10.0;
    // Plus half a set-point period of holding and up to one reading of staleness.
    assert!(
        worst > 0.8 * speed * lag_s && worst < speed * (lag_s + 0.055) + 0.02,
        "{worst}"
    );
}

#[test]
fn repeats_differ_only_by_their_disturbance() {
    let plan = Plan {
        duration_s: 3.0,
        ..Plan::default()
    };
    let mut params = bench();
    let first = run(&params, &plan);
    params.seed = 2;
    assert_eq!(
        first,
        run(&params, &plan),
        "without noise the seed changes nothing"
    );
    params.joints[0].load.disturbance_nm = 0.06;
    let noisy = run(&params, &plan);
    params.seed = 3;
    assert_ne!(noisy, run(&params, &plan));
}

#[test]
fn a_skewed_driver_clock_shows_in_the_record() {
    let plan = Plan {
        duration_s: 10.0,
        ..Plan::default()
    };
    let mut params = bench();
    effects::set(&mut params, "clock_skew", Some(0), "ratio", 1.01).expect("known");
    let last = run(&params, &plan)
        .iter()
        .rev()
        .find_map(|row| match row {
            Row::Reading { t_s, .. } => Some(*t_s),
            Row::SetPoints { .. } => None,
        })
        .expect("readings");
    // Ten seconds of record after three of approach, one per cent fast.
    assert!((last - 9.99 - 0.13).abs() < 0.01, "{last}");
}
