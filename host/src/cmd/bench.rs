//! `rb-host bench`

use std::fmt::Write as _;
use std::path::PathBuf;

use peers::{MUJOCO_TRIALS, Mujoco, PeerError, Share, SpeedRow, SpeedTable, Workplace};
use serde_json::{Value, json};

use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};

/// Speed of the body simulator on one core, beside MuJoCo on the same robot and gaits where it is installed
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Random gaits of 30 s that this simulator plays; MuJoCo and scalar code play the first 16
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u16).range(1..=10_000))]
    trials: u16,
    /// Python environment with the package mujoco; else the one of `python3`
    #[arg(long, value_name = "DIR", default_value = "target/venv")]
    venv: PathBuf,
    /// Folder for the exported model and MuJoCo's program [default: a folder for temporary files]
    #[arg(long, value_name = "DIR")]
    work: Option<PathBuf>,
    /// This simulator alone
    #[arg(long)]
    alone: bool,
}

/// The time steps that are compared, s.
const STEPS_S: [f64; 2] = [0.002, 0.004];

/// Measures and prints.
///
/// # Errors
/// Exit code 1 when MuJoCo is there but fails.
pub fn run(args: &Args, context: &Context) -> Outcome {
    let params = peers::bounceless();
    let trials = peers::clear_trials(&params, usize::from(args.trials));
    let folder = args.work.clone().unwrap_or_else(|| {
        std::env::temp_dir().join(format!("rb-host-bench-{}", std::process::id()))
    });
    let few = trials.get(..MUJOCO_TRIALS).unwrap_or(&trials);
    let place = Workplace::new(folder.clone(), &params, few).map_err(failed)?;
    let mujoco = mujoco(args, &place, context)?;
    let bar = context.out.progress(STEPS_S.len() as u64, "measuring");
    let tables = STEPS_S
        .iter()
        .map(|&step_s| {
            peers::speed_table(&params, &trials, step_s, mujoco.as_ref()).inspect(|_| bar.inc(1))
        })
        .collect::<Result<Vec<SpeedTable>, PeerError>>()
        .map_err(failed)?;
    bar.finish_and_clear();
    let shares = peers::profile(&trials, STEPS_S[1]);
    if args.work.is_none() {
        // Our own folder of a moment ago; what stays behind harms nobody.
        let _ = std::fs::remove_dir_all(folder);
    }
    let value = json!({
        "trials": args.trials, "mujoco": mujoco.is_some(),
        "tables": tables.iter().map(table_json).collect::<Vec<Value>>(),
        "profile": shares.iter().map(share_json).collect::<Vec<Value>>(),
    });
    context
        .out
        .result("rb.bench/1", value, || text(args, &tables, &shares));
    Ok(())
}

fn failed(error: PeerError) -> Failure {
    Failure::new(Exit::Other, error)
}

/// MuJoCo where it is installed; what keeps it out is said aloud, because half of the table is missing then.
fn mujoco<'a>(args: &Args, place: &'a Workplace, context: &Context) -> Outcome<Option<Mujoco<'a>>> {
    if args.alone {
        return Ok(None);
    }
    let Some(package) = peers::mujoco_package(&args.venv) else {
        context.out.warn(format_args!(
            "MuJoCo LEFT OUT: neither {} nor python3 has the package; `pip install mujoco`, or name an environment with --venv",
            args.venv.display()
        ));
        return Ok(None);
    };
    match Mujoco::build(place, &package) {
        Ok(mujoco) => Ok(Some(mujoco)),
        Err(error @ (PeerError::NoLibrary { .. } | PeerError::NoCompiler(_))) => {
            context.out.warn(format_args!("MuJoCo LEFT OUT: {error}"));
            Ok(None)
        }
        Err(error) => Err(failed(error)),
    }
}

fn text(args: &Args, tables: &[SpeedTable], shares: &[Share]) -> String {
    let mut out = format!(
        "One core, processor time. {} random gaits of 30 s, the first {MUJOCO_TRIALS} for MuJoCo and scalar code; from home, friction 1, no \
         bounce, CPG included.\nEnergy drift: a limp robot in the air, largest deviation in 10 s; ours in f64.\n",
        args.trials
    );
    for table in tables {
        let _ = writeln!(
            out,
            "\nTime step {} ms\n\n| engine | simulated s per s | x MuJoCo | mean penetration [mm] | worst [mm] | tracking RMS [rad] | energy drift |\n|---|---|---|---|---|---|---|",
            table.time_step_s * 1e3
        );
        for row in &table.rows {
            let quality = &row.quality;
            let ratio = row.ratio.map_or_else(String::new, |r| format!("{r:.1}"));
            let drift = quality
                .energy_drift
                .map_or_else(String::new, |d| format!("{:.2} %", 100.0 * d));
            let _ = writeln!(
                out,
                "| {} | {:.0} | {ratio} | {:.3} | {:.2} | {:.4} | {drift} |",
                row.name,
                row.speed,
                quality.depth_mean_mm,
                quality.depth_worst_mm,
                quality.tracking_rms_rad,
            );
        }
        for level in &table.missing {
            let _ = writeln!(out, "| {level:?}: not on this processor | | | | | | |");
        }
    }
    let _ = writeln!(
        out,
        "\nWhere a step of {} ms goes, {:?}, effects off, the clock's own time included\n\n| stage | share | ns per trial and step |\n|---|---|---|",
        STEPS_S[1] * 1e3,
        physics::Level::detect(),
    );
    for share in shares {
        let _ = writeln!(
            out,
            "| {} | {:.1} % | {:.1} |",
            stage_words(share.stage),
            100.0 * share.share,
            share.ns_per_step
        );
    }
    out
}

fn stage_words(stage: physics::Stage) -> &'static str {
    match stage {
        physics::Stage::Control => "control: CPG, set-points, pre-check, samples",
        physics::Stage::Kinematics => "dynamics: positions",
        physics::Stage::MassMatrix => "dynamics: mass matrix",
        physics::Stage::Bias => "dynamics: bias forces, servo",
        physics::Stage::Contacts => "contact detection",
        physics::Stage::SelfContact => "self-contact",
        physics::Stage::Solver => "contact and motor solver",
        physics::Stage::Integration => "integration",
    }
}

fn table_json(table: &SpeedTable) -> Value {
    let row = |row: &SpeedRow| {
        json!({
            "engine": row.name, "simulated_s_per_s": row.speed, "ratio_to_mujoco": row.ratio,
            "penetration_mean_mm": row.quality.depth_mean_mm, "penetration_worst_mm": row.quality.depth_worst_mm,
            "tracking_rms_rad": row.quality.tracking_rms_rad, "energy_drift": row.quality.energy_drift,
        })
    };
    let missing: Vec<String> = table.missing.iter().map(|l| format!("{l:?}")).collect();
    json!({
        "time_step_s": table.time_step_s, "missing_levels": missing,
        "rows": table.rows.iter().map(row).collect::<Vec<Value>>(),
    })
}

fn share_json(share: &Share) -> Value {
    json!({ "stage": format!("{:?}", share.stage), "share": share.share, "ns_per_trial_step": share.ns_per_step })
}
