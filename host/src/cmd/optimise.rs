//! `rb-host optimise`

#[path = "optimise_model.rs"]
mod meta;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::{Args as ClapArgs, Subcommand, ValueEnum};
use control::robot::JOINTS;
use files::model::{Key, Model};
use optimise::search::{GaitTrials, Search};
use optimise::select::{Chosen, select};
use optimise::settings::SearchSettings;
use optimise::shard::{Alone, Exchange, Sharded};
use optimise::simulated::Simulated;
use optimise::space::joint_speeds_rad_s;
use serde_json::json;

use crate::cli::parse_duration;
use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::interrupt;
use crate::robot_file::RobotFile;
use crate::searching::curve;
use crate::searching::folder::Folder;

/// Search gaits, or match the simulator to the robot, by particle swarm
#[derive(Debug, ClapArgs)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Find gaits: a swarm over amplitudes, offsets and phase lags; ends with a varied selection as gait files
    Gait(GaitArgs),
    /// Match the simulator to films of the robot: the 22 parameters of the paper's Table II, or any subset
    Model(meta::ModelArgs),
}

#[derive(Debug, ClapArgs)]
struct GaitArgs {
    /// Search settings (optimise.toml); absent values are the paper's
    #[arg(
        long,
        short_alias = 's',
        value_name = "FILE",
        conflicts_with = "resume"
    )]
    settings: Option<PathBuf>,
    /// Robot model and effects; the shipped hand-tuned model when absent
    #[arg(short, long, value_name = "FILE", conflicts_with = "resume")]
    model: Option<PathBuf>,
    /// Another robot than the meta-module (robot.toml); gaits get as many oscillators as it has motors
    #[arg(long, value_name = "FILE", conflicts_with = "resume")]
    robot: Option<PathBuf>,
    /// Folder for settings, model, checkpoint, curve and found gaits
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Go on with the search in the folder, with the settings and the model it was started with
    #[arg(long)]
    resume: bool,
    /// Particles [default: 300]
    #[arg(long, value_name = "N", conflicts_with = "resume")]
    particles: Option<usize>,
    /// Iterations in all; with --resume a search can be made longer [default: 200]
    #[arg(long, value_name = "N")]
    iterations: Option<u32>,
    /// Seed of everything random [default: 1]
    #[arg(long, value_name = "N", conflicts_with = "resume")]
    seed: Option<u64>,
    /// Threads; the result does not depend on it [default: all cores]
    #[arg(short = 'j', long, value_name = "N")]
    threads: Option<usize>,
    /// Where trials run
    #[arg(long, value_enum, default_value_t = Engine::Local)]
    engine: Engine,
    /// Stop after this time with a checkpoint
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    time_limit: Option<Duration>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Engine {
    /// Threads of this process
    Local,
    /// Processes started by mpirun or srun (needs a build with the feature `mpi`)
    Mpi,
}

/// Runs the search.
///
/// # Errors
/// Exit codes 2 and 3 for arguments and files, 130 when interrupted (the checkpoint is written).
pub fn run(args: &Args, context: &Context) -> Outcome {
    match &args.what {
        What::Gait(args) => search_gaits(args, context),
        What::Model(args) => meta::run(args, context),
    }
}

fn search_gaits(args: &GaitArgs, context: &Context) -> Outcome {
    if let Some(threads) = args.threads {
        // Fails only when a pool exists already, and then the searches still agree to the bit.
        let _ = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global();
    }
    let task = Task::gather(args)?;
    match args.engine {
        Engine::Local => drive(args, &task, &Sharded::new(task.trials()?, Alone), context),
        Engine::Mpi => search_over_processes(args, &task, context),
    }
}

#[cfg(feature = "mpi")]
fn search_over_processes(args: &GaitArgs, task: &Task, context: &Context) -> Outcome {
    let world = crate::searching::mpi_engine::World::join()
        .ok_or_else(|| Failure::say(Exit::Other, "MPI was already joined in this process"))?;
    drive(args, task, &Sharded::new(task.trials()?, world), context)
}

#[cfg(not(feature = "mpi"))]
fn search_over_processes(_: &GaitArgs, _: &Task, _: &Context) -> Outcome {
    Err(Failure::say(Exit::Usage, "this rb-host was built without MPI")
        .hint("build it with `cargo build --release -p host --features mpi` (needs OpenMPI and libclang)"))
}

/// What a search is told, read before anything starts. It stands in the folder too, so that a resumed search is the same search.
struct Task {
    settings: SearchSettings,
    model: Model,
    robot: Option<RobotFile>,
}

/// Names of the settings, the model and the structure inside the folder.
const SETTINGS: &str = "optimise.toml";
/// See [`SETTINGS`].
const MODEL: &str = "model.toml";
/// See [`SETTINGS`].
const ROBOT: &str = "robot.toml";

impl Task {
    /// From the folder when resumed, else from files and flags.
    fn gather(args: &GaitArgs) -> Outcome<Self> {
        let (settings, model, robot) = if args.resume {
            let folder = Folder::open(&args.output, true)?;
            let robot = folder.join(ROBOT);
            let [settings, model] = [SETTINGS, MODEL].map(|name| Some(folder.join(name)));
            (settings, model, robot.exists().then_some(robot))
        } else {
            let GaitArgs {
                settings,
                model,
                robot,
                ..
            } = args;
            (settings.clone(), model.clone(), robot.clone())
        };
        let model = crate::model_file::load(model.as_deref())?;
        let robot = robot
            .map(|path| crate::robot_file::load(&path, &model))
            .transpose()?;
        let settings = gather_settings(args, settings.as_deref(), robot.as_ref())?;
        Ok(Self {
            settings,
            model,
            robot,
        })
    }

    fn trials(&self) -> Outcome<Simulated> {
        let (duration_s, seed) = (self.settings.space.duration_s, self.settings.seed);
        let trials = match &self.robot {
            Some(file) => Simulated::on(Arc::clone(&file.robot), &self.model, duration_s, seed),
            None => Simulated::new(&self.model, duration_s, seed),
        };
        let trials = trials.map_err(|error| Failure::new(Exit::BadFile, error))?;
        Ok(trials.until(interrupt::pressed))
    }

    /// The search at its start, or as the checkpoint has it. The process that writes gets the folder with it.
    fn open(&self, args: &GaitArgs, first: bool) -> Outcome<(Search, Option<Folder>)> {
        let folder = if first {
            let folder = Folder::open(&args.output, args.resume)?;
            Some(folder)
        } else {
            None
        };
        let search = if args.resume {
            Folder::open(&args.output, true)?.restore::<Search>()?
        } else {
            Search::start(
                self.settings.space.clone(),
                self.settings.score,
                self.model.value(Key::ImpactLimit) as f32,
                self.settings.particles,
                self.settings.seed,
            )
            .map_err(|error| Failure::new(Exit::Usage, error))?
        };
        if let Some(folder) = &folder {
            let settings = toml::to_string(&self.settings).map_err(anyhow::Error::from)?;
            folder.write(SETTINGS, settings.as_bytes())?;
            folder.write(MODEL, self.model.to_toml().as_bytes())?;
            if let Some(robot) = &self.robot {
                folder.write(ROBOT, robot.text.as_bytes())?;
            }
            folder.store(&search)?;
        }
        Ok((search, folder))
    }
}

/// Iterates, stores and reports. Only the first of several processes writes and speaks; what ends one of them ends all.
fn drive<T: GaitTrials, E: Exchange>(
    args: &GaitArgs,
    task: &Task,
    trials: &Sharded<T, E>,
    context: &Context,
) -> Outcome {
    let opened = task.open(args, trials.is_first());
    let failed = trials.any(opened.is_err());
    let (mut search, folder) = opened?;
    if failed {
        return Err(Failure::say(
            Exit::Other,
            "another process of the job failed",
        ));
    }
    let settings = &task.settings;
    // Choosing takes most of a second of the processor, longer on a busy machine.
    let _grace = interrupt::grace("stopping: choosing from what was found so far");
    let begun = Instant::now();
    let bar = folder.is_some().then(|| {
        context
            .out
            .progress(u64::from(settings.iterations), "searching")
    });
    let late = || args.time_limit.is_some_and(|t| begun.elapsed() >= t);
    let mut stored = Ok(());
    let mut interrupted = false;
    while search.swarm().iteration() < settings.iterations {
        interrupted = trials.any(stored.is_err() || interrupt::pressed() || late());
        if interrupted {
            break;
        }
        if !search.iterate(trials) {
            interrupted = true;
            break;
        }
        stored = folder
            .as_ref()
            .map_or(Ok(()), |folder| folder.store(&search));
        if let Some(bar) = &bar {
            bar.set_position(u64::from(search.swarm().iteration()));
            let best = search.swarm().best().map_or(0.0, |best| best.fitness);
            bar.set_message(format!("best {:.2} cm/s", best * 100.0));
        }
    }
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
    stored?;
    let Some(folder) = folder else { return Ok(()) };
    report(&search, settings, &folder, begun.elapsed(), context)?;
    if interrupted {
        let message = format!(
            "stopped after iteration {}; the checkpoint is written",
            search.swarm().iteration()
        );
        let hint = format!(
            "go on with `rb-host optimise gait --resume -o {}`",
            args.output.display()
        );
        return Err(Failure::say(Exit::Interrupted, message).hint(hint));
    }
    Ok(())
}

fn report(
    search: &Search,
    settings: &SearchSettings,
    folder: &Folder,
    wall: Duration,
    context: &Context,
) -> Outcome {
    let history: Vec<f64> = search
        .swarm()
        .history()
        .iter()
        .map(|best| best.fitness)
        .collect();
    let curve: String = history
        .iter()
        .enumerate()
        .map(|(i, f)| format!("{i},{f}\n"))
        .collect();
    folder.write(
        "curve.csv",
        format!("iteration,best_fitness_m_s\n{curve}").as_bytes(),
    )?;
    let drawn = curve::svg("Best fitness of the swarm", "fitness [m/s]", &history);
    folder.write("curve.svg", drawn.as_bytes())?;
    let chosen = select(search.space(), search.archive(), &settings.select);
    let mut table = String::new();
    for (k, gait) in chosen.iter().enumerate() {
        let name = format!("g{:02}", k + 1);
        let file = search
            .space()
            .gait(&gait.found.position, &name)
            .map_err(|error| Failure::say(Exit::Other, format!("gait {name}: {error}")))?;
        folder.write(
            &format!("gaits/{name}.toml"),
            files::gait::to_toml(&file).as_bytes(),
        )?;
        table.push_str(&row(&name, gait));
    }
    let selection = serde_json::to_vec_pretty(&chosen).map_err(anyhow::Error::from)?;
    folder.write("selection.json", &selection)?;
    context.out.wrote(&folder.join("selection.json"));
    let counts = search.counts();
    let best = search.swarm().best().map_or(0.0, |best| best.fitness);
    let value = json!({
        "iterations": search.swarm().iteration(), "best_fitness_m_s": best, "gaits": chosen, "wall_s": wall.as_secs_f64(),
        "trials": counts.trials, "collided": counts.collisions, "too_hard": counts.impacts, "failed": counts.failures,
    });
    context.out.result("rb.optimise_gait/1", value, || {
        format!(
            "{} iterations, {} trials in {:.1} s; refused: {} for collision, {} for impact, {} for a lost number\n\
             gait  fitness  speed   deviation  impact  difference  chosen as\n\
                    [cm/s]  [cm/s]       [cm]   [m/s]\n{table}",
            search.swarm().iteration(),
            counts.trials,
            wall.as_secs_f64(),
            counts.collisions,
            counts.impacts,
            counts.failures,
        )
    });
    Ok(())
}

fn row(name: &str, gait: &Chosen) -> String {
    let score = &gait.found.score;
    let difference = gait
        .difference
        .map_or_else(|| "-".to_owned(), |d| format!("{d:.3}"));
    let set = if gait.training { "training" } else { "test" };
    format!(
        "{name}   {:7.2} {:7.2} {:10.2} {:7.2} {difference:>11}  {:?}, {set}\n",
        score.fitness * 100.0,
        score.speed_m_s * 100.0,
        score.deviation_m * 100.0,
        score.impact_m_s,
        gait.why,
    )
}

/// File, then flags. Speeds of the joints that the file does not give are those of the robot's motors.
fn gather_settings(
    args: &GaitArgs,
    file: Option<&Path>,
    robot: Option<&RobotFile>,
) -> Outcome<SearchSettings> {
    let (mut settings, speeds_given) = match file {
        Some(path) => read_settings(path)?,
        None => (SearchSettings::default(), false),
    };
    if let Some(file) = robot.filter(|_| !speeds_given) {
        settings.space.joint_speed_rad_s = joint_speeds_rad_s(&file.robot);
    }
    let motors = robot.map_or(JOINTS, |file| file.robot.motors());
    if settings.space.joints() != motors {
        let found = settings.space.joints();
        let message = format!(
            "space.joint_speed_rad_s has {found} entries, the robot has {motors} joints with motors"
        );
        return Err(Failure::say(Exit::BadFile, message).hint("give one speed per joint, or none"));
    }
    if let Some(particles) = args.particles {
        settings.particles = particles;
    }
    if let Some(iterations) = args.iterations {
        settings.iterations = iterations;
    }
    if let Some(seed) = args.seed {
        settings.seed = seed;
    }
    settings
        .check()
        .map_err(|error| Failure::new(Exit::Usage, error))?;
    Ok(settings)
}

/// Settings, and whether they name the speeds of the joints.
fn read_settings(path: &Path) -> Outcome<(SearchSettings, bool)> {
    let shown = path.display();
    let text = disk::read_text(path, disk::MAX_TEXT)
        .map_err(|e| Failure::say(Exit::BadFile, format!("{shown}: {e}")))?;
    let settings: SearchSettings =
        toml::from_str(&text).map_err(|error| disk::toml_error(path, &text, &error))?;
    settings
        .check()
        .map_err(|error| Failure::say(Exit::BadFile, format!("{shown}: {error}")))?;
    let table: toml::Table =
        toml::from_str(&text).map_err(|error| disk::toml_error(path, &text, &error))?;
    let space = table.get("space").and_then(toml::Value::as_table);
    let speeds_given = space.is_some_and(|space| space.contains_key("joint_speed_rad_s"));
    Ok((settings, speeds_given))
}
