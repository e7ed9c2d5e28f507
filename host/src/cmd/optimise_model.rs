//! `rb-host optimise model`

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args as ClapArgs;
use files::dataset::Manifest;
use files::model::Key;
use optimise::meta::{
    FilmMaker, FilmedGait, Fit, Likeness, PAPER_ITERATIONS, PAPER_PARTICLES, TableIii, rows_of,
};
use optimise::simulated::SimulatedMotions;
use optimise::table2::{implausible_factor, plausible_high};
use serde_json::{Value, json};

use crate::cli::parse_duration;
use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};
use crate::interrupt;
use crate::searching::folder::Folder;
use crate::searching::{curve, films};

#[derive(Debug, ClapArgs)]
pub(super) struct ModelArgs {
    /// Data set folder with films (`frames`) and `gaits/NAME.toml`
    data: PathBuf,
    /// Folder for checkpoint, curve, tables and the fitted model
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Model to start from; the shipped hand-tuned model when absent
    #[arg(short, long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Gaits the fit may see; when absent those whose runs all have the role "fit"
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    training: Vec<String>,
    /// Rows of Table II to fit, such as 1-4,13,17 [default: 1-22]
    #[arg(long, value_name = "ROWS", default_value = "1-22")]
    rows: String,
    /// Go on with the fit in the folder
    #[arg(long)]
    resume: bool,
    /// Particles
    #[arg(long, value_name = "N", default_value_t = PAPER_PARTICLES)]
    particles: usize,
    /// Iterations
    #[arg(long, value_name = "N", default_value_t = PAPER_ITERATIONS)]
    iterations: u32,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// The search looks at every N-th frame; tables use all
    #[arg(long, value_name = "N", default_value_t = 10)]
    stride: usize,
    /// Threads; the result does not depend on it [default: all cores]
    #[arg(short = 'j', long, value_name = "N")]
    threads: Option<usize>,
    /// Stop after this time with a checkpoint
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    time_limit: Option<Duration>,
}

/// Fits and prints Tables II and III.
pub(super) fn run(args: &ModelArgs, context: &Context) -> Outcome {
    if let Some(threads) = args.threads {
        // Fails only when a pool exists already, and then the fits still agree to the bit.
        let _ = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global();
    }
    let model = crate::model_file::load(args.model.as_deref())?;
    let manifest = read_manifest(&args.data)?;
    let start = rows_of(&model);
    context.out.say("reading films");
    let gaits = films::load(
        &args.data,
        &manifest,
        &args.training,
        model.value(Key::CameraHeight),
    )?;
    let longest = gaits
        .iter()
        .flat_map(|g| &g.films)
        .map(Vec::len)
        .max()
        .unwrap_or(0);
    let settings = films::settings_of(manifest.camera.as_ref(), args.stride);
    // One second and a fifth past the film: the longest time shift of Table II.
    let duration_s = longest as f64 / settings.rate_hz + Key::CameraTimeShift.info().search.1;
    let trials = SimulatedMotions::new(&model, context.robot_model(), duration_s);
    let maker = FilmMaker::new(settings, &context.robot_model());
    let likeness = Likeness::new(&gaits, maker).map_err(|error| {
        Failure::new(Exit::BadFile, error)
            .hint("name them with --training g01,g03,... or give their runs role = \"fit\"")
    })?;
    let folder = Folder::open(&args.output, args.resume)?;
    let mut fit = if args.resume {
        folder.restore::<Fit>()?
    } else {
        let rows = parse_rows(&args.rows)?;
        Fit::start(&rows, &start, args.particles, args.seed)
            .map_err(|error| Failure::new(Exit::Usage, error))?
    };
    let begun = Instant::now();
    let interrupted = iterate(args, &mut fit, &likeness, &trials, &folder, context)?;
    let wall = begun.elapsed();
    let table = |rows: &[f64; optimise::table2::ROWS]| {
        let ratios = likeness
            .ratios(rows, &trials)
            .map_err(|error| Failure::new(Exit::BadFile, error))?;
        Ok::<_, Failure>((TableIii::new(&gaits, &ratios), ratios))
    };
    let (before, after) = (table(&start)?, table(&fit.best())?);
    let fitted = trials
        .model_with(&fit.best())
        .map_err(|error| Failure::new(Exit::Other, error))?;
    folder.write("model.toml", fitted.to_toml().as_bytes())?;
    let history: Vec<f64> = fit
        .swarm()
        .history()
        .iter()
        .map(|best| best.fitness)
        .collect();
    folder.write(
        "curve.svg",
        curve::svg("Similarity of the best particle", "F_meta", &history).as_bytes(),
    )?;
    report(
        &fit,
        &start,
        &gaits,
        (&before, &after),
        wall,
        &folder,
        context,
    )?;
    if interrupted {
        let message = format!(
            "stopped after iteration {}; the checkpoint is written",
            fit.swarm().iteration()
        );
        return Err(Failure::say(Exit::Interrupted, message).hint("go on with --resume"));
    }
    Ok(())
}

/// Runs the remaining iterations; true when stopped early.
fn iterate(
    args: &ModelArgs,
    fit: &mut Fit,
    likeness: &Likeness<'_>,
    trials: &SimulatedMotions,
    folder: &Folder,
    context: &Context,
) -> Outcome<bool> {
    let begun = Instant::now();
    let bar = context.out.progress(u64::from(args.iterations), "matching");
    while fit.swarm().iteration() < args.iterations {
        if interrupt::pressed()
            || args
                .time_limit
                .is_some_and(|limit| begun.elapsed() >= limit)
        {
            bar.finish_and_clear();
            return Ok(true);
        }
        fit.iterate(likeness, trials)
            .map_err(|error| Failure::new(Exit::BadFile, error))?;
        folder.store(fit)?;
        bar.set_position(u64::from(fit.swarm().iteration()));
        let best = fit.swarm().best().map_or(0.0, |best| best.fitness);
        bar.set_message(format!("R {best:.3}"));
    }
    bar.finish_and_clear();
    Ok(false)
}

type Compared = (TableIii, Vec<f64>);

fn report(
    fit: &Fit,
    start: &[f64; optimise::table2::ROWS],
    gaits: &[FilmedGait],
    (before, after): (&Compared, &Compared),
    wall: Duration,
    folder: &Folder,
    context: &Context,
) -> Outcome {
    let best = fit.best();
    let mut text = format!(
        "{} iterations in {:.1} s\n\nTable II\n",
        fit.swarm().iteration(),
        wall.as_secs_f64()
    );
    let _ = writeln!(
        text,
        " # {:28} {:>18} {:>10} {:>10} {:>10}",
        "parameter", "range", "start", "fitted", "paper"
    );
    let mut rows = Vec::new();
    for (k, key) in Key::TABLE_II.iter().enumerate() {
        let info = key.info();
        let range = format!("[{}, {}]", info.search.0, info.search.1);
        let flag = implausible_factor(*key, best[k]);
        let remark = match (flag, plausible_high(*key)) {
            (Some(factor), Some((_, why))) => format!("  IMPLAUSIBLE: {factor:.1} x {why}"),
            _ => String::new(),
        };
        let _ = writeln!(
            text,
            "{:2} {:28} {range:>18} {:10.5} {:10.5} {:10.5}{remark}",
            k + 1,
            info.path(),
            start[k],
            best[k],
            info.meta_optimised
        );
        rows.push(json!({ "row": k + 1, "name": info.path(), "start": start[k], "fitted": best[k], "paper": info.meta_optimised, "implausible_factor": flag }));
    }
    let _ = writeln!(
        text,
        "\nTable III            before    after   change   (paper: before    after)"
    );
    let paper = [
        ("training set", 0.250_317, 0.414_293),
        ("test set", 0.325_153, 0.402_104),
        ("all gaits", 0.281_152, 0.409_271),
    ];
    let of = |t: &TableIii| [Some(t.training), t.test, Some(t.all)];
    for ((name, paper_before, paper_after), (b, a)) in paper
        .iter()
        .zip(of(&before.0).into_iter().zip(of(&after.0)))
    {
        if let (Some(b), Some(a)) = (b, a) {
            let change = (a / b - 1.0) * 100.0;
            let _ = writeln!(
                text,
                "{name:16} {b:10.3} {a:8.3} {change:7.1} %   {paper_before:14.3} {paper_after:8.3}"
            );
        }
    }
    for ((filmed, b), a) in gaits.iter().zip(&before.1).zip(&after.1) {
        let set = if filmed.training { "training" } else { "test" };
        let _ = writeln!(
            text,
            "  {:14} {b:10.3} {a:8.3}   {set}, weight {:.4}",
            filmed.gait.name(),
            filmed.weight
        );
    }
    folder.write("tables.txt", text.as_bytes())?;
    let tables = json!({ "before": before.0, "after": after.0 });
    let value = json!({
        "iterations": fit.swarm().iteration(), "wall_s": wall.as_secs_f64(), "table_ii": Value::from(rows), "table_iii": tables,
    });
    context.out.result("rb.optimise_model/1", value, || text);
    Ok(())
}

/// `1-4,13` as row numbers.
fn parse_rows(text: &str) -> Outcome<Vec<u8>> {
    let bad = || {
        Failure::say(
            Exit::Usage,
            format!("--rows {text}: write numbers and ranges from 1 to 22, such as 1-4,13,17"),
        )
    };
    let mut rows = Vec::new();
    for part in text.split(',') {
        let (low, high) = part.split_once('-').unwrap_or((part, part));
        let (low, high): (u8, u8) = (
            low.trim().parse().map_err(|_| bad())?,
            high.trim().parse().map_err(|_| bad())?,
        );
        rows.extend(low..=high);
    }
    Ok(rows)
}

fn read_manifest(folder: &Path) -> Outcome<Manifest> {
    let path = folder.join("dataset.toml");
    let shown = path.display().to_string();
    let text = std::fs::read_to_string(&path)
        .map_err(|e| Failure::say(Exit::BadFile, format!("{shown}: {e}")))?;
    let (manifest, _) =
        Manifest::parse(&shown, &text).map_err(|error| Failure::new(Exit::BadFile, error))?;
    Ok(manifest)
}
