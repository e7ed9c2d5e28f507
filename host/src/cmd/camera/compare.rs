//! `rb-host camera compare`

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Duration;

use camera::similarity::{meta_fitness, ratio};
use files::model::Key;
use optimise::meta::{FilmMaker, FilmedGait, Likeness, rows_of};
use optimise::simulated::SimulatedMotions;
use serde_json::{Value, json};

use super::pair::Films;
use crate::cli::parse_duration;
use crate::context::Context;
use crate::disk::write_new;
use crate::failure::{Exit, Failure, Outcome};
use crate::searching::films;

#[derive(Debug, clap::Args)]
pub(super) struct CompareArgs {
    /// Film folder of the robot; or, without SIMULATED, a data set folder with films
    robot: PathBuf,
    /// Film folder of the simulation
    simulated: Option<PathBuf>,
    /// Of a data set: robot model and effects to simulate; the shipped hand-tuned model when absent
    #[arg(short, long, value_name = "FILE", conflicts_with = "simulated")]
    model: Option<PathBuf>,
    /// Of two films: compare the robot at t with the simulation at t plus this time, such as 400ms
    #[arg(long, value_name = "TIME", value_parser = parse_duration, default_value = "0", requires = "simulated")]
    shift: Duration,
    /// Of two films: frames per second at which both are looked at
    #[arg(long, value_name = "HZ", default_value_t = films::RATE_HZ, requires = "simulated")]
    rate: f64,
    /// Of two films: CSV with R of every frame
    #[arg(short, long, value_name = "FILE", requires = "simulated")]
    output: Option<PathBuf>,
    /// Overwrite an existing file
    #[arg(long)]
    force: bool,
}

/// Compares.
pub(super) fn run(args: &CompareArgs, context: &Context) -> Outcome {
    match &args.simulated {
        Some(simulated) => {
            let films = Films {
                robot: args.robot.clone(),
                simulated: simulated.clone(),
                shift: args.shift,
                rate: args.rate,
            };
            two_films(args, &films, context)
        }
        None => data_set(args, context),
    }
}

fn two_films(args: &CompareArgs, films: &Films, context: &Context) -> Outcome {
    let pair = films.read()?;
    let mut csv = "t_s,r,overlap_px,union_px\n".to_owned();
    let mut ratios = Vec::new();
    for (t_s, (robot, simulated)) in pair.t_s.iter().zip(&pair.frames) {
        // The sizes were compared when the films were read.
        let r = ratio(robot, simulated).ok().flatten();
        let (overlap, union) = robot.overlap_and_union_px(simulated).unwrap_or((0, 0));
        let shown = r.map_or_else(String::new, |r| format!("{r:.6}"));
        let _ = writeln!(csv, "{t_s:.6},{shown},{overlap},{union}");
        ratios.push(r);
    }
    if let Some(path) = &args.output {
        write_new(path, csv.as_bytes(), args.force)?;
    }
    let seen: Vec<f64> = ratios.iter().copied().flatten().collect();
    if seen.is_empty() {
        return Err(
            Failure::say(Exit::BadFile, "no frame of either film shows a robot")
                .hint("look at the frames; `rb-host camera silhouette` may need another --closer"),
        );
    }
    let mean = seen.iter().sum::<f64>() / seen.len() as f64;
    let value =
        json!({ "r": mean, "frames": ratios.len(), "compared": seen.len(), "r_per_frame": ratios });
    context.out.result("rb.camera_compare/1", value, || {
        format!(
            "R {mean:.4}, mean of {} frames; {} frames without a robot in either film left out",
            seen.len(),
            ratios.len() - seen.len()
        )
    });
    Ok(())
}

/// Share of the work that is usually done when the films were read, as measured on data sets of two gaits and of six.
const READ: f64 = 0.8;

fn data_set(args: &CompareArgs, context: &Context) -> Outcome {
    let phases = context.out.phases("reading the films");
    let model = crate::model_file::load(args.model.as_deref())?;
    let (data, manifest) = films::read_manifest(&args.robot)?;
    // R of all gaits is wanted, whatever a fit may see.
    let mut gaits = films::load(&data, &manifest, &[], model.value(Key::CameraHeight))?;
    if gaits.is_empty() {
        let message = format!("{}: no run has a film", args.robot.display());
        return Err(Failure::say(Exit::BadFile, message)
            .hint("name the folder of a run's frames by `frames = \"folder\"` in dataset.toml"));
    }
    gaits.iter_mut().for_each(|gait| gait.training = true);
    let settings = films::settings_of(manifest.camera.as_ref(), 1);
    let longest = gaits.iter().map(FilmedGait::frames).max().unwrap_or(0);
    let shift_s = model.value(Key::CameraTimeShift).max(0.0);
    let duration_s = (longest + 1) as f64 / settings.rate_hz + shift_s;
    phases.begin("simulating and comparing", READ);
    let trials = SimulatedMotions::new(&model, context.robot_model(), duration_s);
    let maker = FilmMaker::new(settings, &context.robot_model());
    let ratios = Likeness::new(&gaits, maker)
        .and_then(|likeness| likeness.ratios(&rows_of(&model), &trials))
        .map_err(|error| Failure::new(Exit::BadFile, error))?;
    drop(phases);
    let weighted: Vec<(f64, f64)> = gaits
        .iter()
        .map(|gait| gait.weight)
        .zip(ratios.iter().copied())
        .collect();
    let f_meta = meta_fitness(&weighted).map_err(|error| Failure::new(Exit::BadFile, error))?;
    let value = json!({ "f_meta": f_meta, "gaits": rows(&gaits, &ratios) });
    context.out.result("rb.camera_compare/1", value, || {
        table(&gaits, &ratios, f_meta)
    });
    Ok(())
}

fn rows(gaits: &[FilmedGait], ratios: &[f64]) -> Vec<Value> {
    let row = |(gait, r): (&FilmedGait, &f64)| {
        json!({
            "gait": gait.gait.name(), "r": r, "r_h": gait.repeatability, "mean_speed_m_s": gait.mean_speed_m_s,
            "w_gait": gait.weight, "share_seen": gait.share_seen(), "trials": gait.films.len(),
        })
    };
    gaits.iter().zip(ratios).map(row).collect()
}

fn table(gaits: &[FilmedGait], ratios: &[f64], f_meta: f64) -> String {
    let mut text =
        "gait             trials        R      R_H  speed[cm/s]   W_gait  in picture\n".to_owned();
    for (gait, r) in gaits.iter().zip(ratios) {
        let _ = writeln!(
            text,
            "{:16} {:6} {r:8.4} {:8.4} {:12.2} {:8.5} {:9.0} %",
            gait.gait.name(),
            gait.films.len(),
            gait.repeatability,
            gait.mean_speed_m_s * 100.0,
            gait.weight,
            gait.share_seen() * 100.0,
        );
    }
    let _ = writeln!(text, "F_meta {f_meta:.4}");
    text
}
