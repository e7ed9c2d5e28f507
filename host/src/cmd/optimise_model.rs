//! `rb-host optimise model`

use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args as ClapArgs;
use files::model::{Key, Model};
use optimise::meta::{
    FilmMaker, FilmedGait, Fit, Likeness, PAPER_ITERATIONS, PAPER_PARTICLES, TableIii, rows_of,
};
use optimise::simulated::SimulatedMotions;
use optimise::table2::ROWS;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::cli::parse_duration;
use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};
use crate::interrupt;
use crate::searching::folder::Folder;
use crate::searching::tables::{Compared, table_ii, table_iii};
use crate::searching::{curve, films};

#[derive(Debug, ClapArgs)]
pub(super) struct ModelArgs {
    /// Data set folder with films (`frames`) and `gaits/NAME.toml`
    data: PathBuf,
    /// Folder for checkpoint, curve, tables and the fitted model
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Model to start from; the shipped hand-tuned model when absent
    #[arg(short, long, value_name = "FILE", conflicts_with = "resume")]
    model: Option<PathBuf>,
    /// Gaits the fit may see; when absent those whose runs all have the role "fit"
    #[arg(
        long,
        value_name = "NAME,...",
        value_delimiter = ',',
        conflicts_with = "resume"
    )]
    training: Vec<String>,
    /// Rows of Table II to fit, such as 1-4,13,17
    #[arg(
        long,
        value_name = "ROWS",
        default_value = "1-22",
        conflicts_with = "resume"
    )]
    rows: String,
    /// Go on with the fit in the folder, with everything it was told when it began
    #[arg(long)]
    resume: bool,
    /// Particles
    #[arg(long, value_name = "N", default_value_t = PAPER_PARTICLES, conflicts_with = "resume")]
    particles: usize,
    /// Iterations in all [default: 100]; with --resume a fit can be made longer
    #[arg(long, value_name = "N")]
    iterations: Option<u32>,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "resume")]
    seed: u64,
    /// The search looks at every N-th frame; tables use all
    #[arg(long, value_name = "N", default_value_t = STRIDE, conflicts_with = "resume", value_parser = clap::value_parser!(u32).range(1..))]
    stride: u32,
    /// Threads; the result does not depend on it [default: all cores]
    #[arg(short = 'j', long, value_name = "N")]
    threads: Option<usize>,
    /// Stop after this time with a checkpoint
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    time_limit: Option<Duration>,
}

/// Three frames a second of a 30 Hz film: a gait of 0.2 Hz moves its joints by less than 70 degrees from one to the next.
const STRIDE: u32 = 10;

/// Name of the start model inside the folder.
const START: &str = "start.toml";

/// What the folder keeps from one call to the next.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Stored {
    fit: Fit,
    training: Vec<String>,
    stride: u32,
    /// Checksum of the films the fit has seen.
    films: u64,
    /// Iterations that were asked for.
    #[serde(default = "paper_iterations")]
    iterations: u32,
}

/// What a fit was asked for that does not say so.
fn paper_iterations() -> u32 {
    PAPER_ITERATIONS
}

/// Fits and prints Tables II and III.
pub(super) fn run(args: &ModelArgs, context: &Context) -> Outcome {
    if let Some(threads) = args.threads {
        // Fails only when a pool exists already, and then the fits still agree to the bit.
        let _ = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global();
    }
    let begun = Instant::now();
    let folder = Folder::open(&args.output, args.resume)?;
    let told = Told::gather(args, &folder)?;
    let (data, manifest) = films::read_manifest(&args.data)?;
    context.out.say("reading films");
    let height_m = told.model.value(Key::CameraHeight);
    let gaits = films::load(&data, &manifest, &told.training, height_m)?;
    let settings = films::settings_of(manifest.camera.as_ref(), told.stride as usize);
    let longest = gaits.iter().map(FilmedGait::frames).max().unwrap_or(0);
    // As far past the film as the longest time shift of Table II looks.
    let duration_s = longest as f64 / settings.rate_hz + Key::CameraTimeShift.info().search.1;
    let trials = SimulatedMotions::new(&told.model, context.robot_model(), duration_s);
    let maker = FilmMaker::new(settings, &context.robot_model());
    let likeness = Likeness::new(&gaits, maker).map_err(|error| {
        Failure::new(Exit::BadFile, error)
            .hint("name them with --training g01,g03,... or give their runs role = \"fit\"")
    })?;
    let mut stored = told.open(args, &folder, checksum(&gaits))?;
    stored.iterations = args.iterations.unwrap_or(stored.iterations);
    let read_s = begun.elapsed().as_secs_f64();
    let interrupted = iterate(args, &mut stored, &likeness, &trials, &folder, context)?;
    let report = Report {
        start: rows_of(&told.model),
        fit: &stored.fit,
        gaits: &gaits,
        likeness: &likeness,
        trials: &trials,
    };
    report.write(&folder, (begun, read_s), context)?;
    if interrupted {
        let message = format!(
            "stopped after iteration {}; the checkpoint is written",
            stored.fit.swarm().iteration()
        );
        return Err(Failure::say(Exit::Interrupted, message).hint("go on with --resume"));
    }
    Ok(())
}

/// What the fit is told, from the command line or, when resumed, from the folder.
struct Told {
    model: Model,
    training: Vec<String>,
    stride: u32,
    stored: Option<Stored>,
}

impl Told {
    fn gather(args: &ModelArgs, folder: &Folder) -> Outcome<Self> {
        if !args.resume {
            return Ok(Self {
                model: crate::model_file::load(args.model.as_deref())?,
                training: args.training.clone(),
                stride: args.stride,
                stored: None,
            });
        }
        let stored: Stored = folder.restore()?;
        Ok(Self {
            model: crate::model_file::load(Some(&folder.join(START)))?,
            training: stored.training.clone(),
            stride: stored.stride,
            stored: Some(stored),
        })
    }

    /// The fit at its start, stored with its model, or as the checkpoint has it.
    fn open(&self, args: &ModelArgs, folder: &Folder, films: u64) -> Outcome<Stored> {
        if let Some(stored) = &self.stored {
            if stored.films == films {
                return Ok(stored.clone());
            }
            return Err(
                Failure::say(Exit::BadFile, "the films are not those this fit began with")
                    .hint("give the data set it began with, or start a fit in a new folder"),
            );
        }
        let rows = parse_rows(&args.rows)?;
        let fit = Fit::start(&rows, &rows_of(&self.model), args.particles, args.seed)
            .map_err(|error| Failure::new(Exit::Usage, error))?;
        let stored = Stored {
            fit,
            training: self.training.clone(),
            stride: self.stride,
            films,
            iterations: args.iterations.unwrap_or(PAPER_ITERATIONS),
        };
        folder.write(START, self.model.to_toml().as_bytes())?;
        folder.store(&stored)?;
        Ok(stored)
    }
}

/// A number that changes when a film does (FNV-1a over the areas).
fn checksum(gaits: &[FilmedGait]) -> u64 {
    const BASIS: u64 = 0xcbf2_9ce4_8422_2325;
    const PRIME: u64 = 0x0100_0000_01b3;
    let frames = gaits.iter().flat_map(|gait| gait.films.iter().flatten());
    let areas = frames.map(|frame| u64::from(frame.area_px()));
    areas.fold(BASIS, |sum, area| (sum ^ area).wrapping_mul(PRIME))
}

/// Runs the remaining iterations; true when stopped early.
fn iterate(
    args: &ModelArgs,
    stored: &mut Stored,
    likeness: &Likeness<'_>,
    trials: &SimulatedMotions,
    folder: &Folder,
    context: &Context,
) -> Outcome<bool> {
    let _grace =
        interrupt::grace("stopping; the checkpoint of the last whole iteration is written");
    let begun = Instant::now();
    let bar = context
        .out
        .progress(u64::from(stored.iterations), "matching");
    while stored.fit.swarm().iteration() < stored.iterations {
        let late = args.time_limit.is_some_and(|t| begun.elapsed() >= t);
        if interrupt::pressed() || late {
            bar.finish_and_clear();
            return Ok(true);
        }
        let searching = trials.clone().until(interrupt::pressed);
        let whole = stored
            .fit
            .iterate(likeness, &searching)
            .map_err(|error| Failure::new(Exit::BadFile, error))?;
        if !whole {
            bar.finish_and_clear();
            return Ok(true);
        }
        folder.store(stored)?;
        bar.set_position(u64::from(stored.fit.swarm().iteration()));
        let best = stored.fit.swarm().best().map_or(0.0, |best| best.fitness);
        bar.set_message(format!("R {best:.3}"));
    }
    bar.finish_and_clear();
    Ok(false)
}

/// What is written and printed at the end.
struct Report<'a> {
    start: [f64; ROWS],
    fit: &'a Fit,
    gaits: &'a [FilmedGait],
    likeness: &'a Likeness<'a>,
    trials: &'a SimulatedMotions,
}

impl Report<'_> {
    fn write(
        &self,
        folder: &Folder,
        (begun, read_s): (Instant, f64),
        context: &Context,
    ) -> Outcome {
        let best = self.fit.best();
        let (before, after) = (self.compare(&self.start)?, self.compare(&best)?);
        let fitted = self
            .trials
            .model_with(&best)
            .map_err(|error| Failure::new(Exit::Other, error))?;
        folder.write("model.toml", fitted.to_toml().as_bytes())?;
        self.write_curve(folder)?;
        let (text_ii, value_ii) = table_ii(&self.start, &best);
        let (text_iii, value_iii) = table_iii(self.gaits, &before, &after);
        let text = format!("{text_ii}\n{text_iii}");
        folder.write("tables.txt", text.as_bytes())?;
        context.out.wrote(&folder.join("model.toml"));
        let (iterations, wall_s) = (self.fit.swarm().iteration(), begun.elapsed().as_secs_f64());
        let value = json!({
            "iterations": iterations, "wall_s": wall_s, "table_ii": value_ii, "table_iii": value_iii,
        });
        context.out.result("rb.optimise_model/1", value, || {
            format!(
                "{iterations} iterations; {wall_s:.1} s with all, {read_s:.1} s of it reading films\n\n{text}"
            )
        });
        Ok(())
    }

    fn compare(&self, rows: &[f64; ROWS]) -> Outcome<Compared> {
        let ratios = self
            .likeness
            .ratios(rows, self.trials)
            .map_err(|error| Failure::new(Exit::BadFile, error))?;
        let sets = TableIii::new(self.gaits, &ratios);
        Ok(Compared { sets, ratios })
    }

    /// The paper's figure 6, with the mean of the particles beside the best.
    fn write_curve(&self, folder: &Folder) -> Outcome {
        let history = self.fit.swarm().history();
        let best: Vec<f64> = history.iter().map(|best| best.fitness).collect();
        let means = self.fit.means();
        let mut csv = "iteration,best,mean\n".to_owned();
        for (k, (best, mean)) in best.iter().zip(means).enumerate() {
            csv.push_str(&format!("{k},{best},{mean}\n"));
        }
        folder.write("curve.csv", csv.as_bytes())?;
        let title = "Similarity of simulated and filmed gaits";
        let drawn = curve::svg_best_and_mean(title, "F_meta", &best, means);
        folder.write("curve.svg", drawn.as_bytes())
    }
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
