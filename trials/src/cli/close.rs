//! `rb-trials close`: the loop from search to robot to diagnosis to search, and what the patch is worth.
//!
//! The paper's own measure: its fitted simulator promised 6.0 cm/s, the robot walked 5.8.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, anyhow, bail};
use camera::similarity;
use camera::{Silhouette, Solid, View};
use control::gait::Gait;
use control::kinematics;
use control::robot::JOINTS;
use files::model::{Key, Model};
use optimise::search::Search;
use optimise::select::select;
use optimise::settings::SearchSettings;
use optimise::simulated::{Simulated, base_pose};
use physics::{Drive, Options, Params, Pose, Start, Trial};

use super::{diagnose, host, make, write};
use crate::robot::{self, Plan, Ride, SeenBy};

/// Options of `gap close`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder for gaits, recordings, verdict and patch
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// What is wrong with the emulated robot: EFFECT[@JOINT][:VALUE,...] joined by +
    #[arg(long, value_name = "CAUSES", default_value = "ground_friction:0.45")]
    plant: String,
    /// Use this patched model instead of diagnosing
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Particles of each search
    #[arg(long, default_value_t = 48)]
    particles: usize,
    /// Iterations of each search
    #[arg(long, default_value_t = 30)]
    iterations: u32,
    /// Gaits taken from each search
    #[arg(long, default_value_t = 4)]
    gaits: usize,
    /// Length of a run, s
    #[arg(long, default_value_t = 20.0)]
    duration: f64,
    /// Seed of searches and robot
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The program that diagnoses; absent = rb-host beside this one
    #[arg(long, value_name = "FILE")]
    host: Option<PathBuf>,
}

/// Runs of each gait on the robot.
const REPEATS: u64 = 3;
/// Frames per second of the films that are compared.
const FILM_HZ: f64 = 5.0;

/// One motion: poses of body 3 and link angles, moved so that it begins at the origin and looks along its first
/// heading.
struct Motion {
    base: Vec<Pose>,
    link_rad: Vec<[f32; JOINTS]>,
}

impl Motion {
    fn new(base: &[Pose], link_rad: &[[f32; JOINTS]]) -> Self {
        let first = base.first().map_or([0.0; 3], |p| p.position_m);
        let turn = -base.first().map_or(0.0, heading);
        let (sin, cos) = ((turn as f32).sin(), (turn as f32).cos());
        let half = 0.5 * turn as f32;
        let (hs, hc) = (half.sin(), half.cos());
        let moved = |p: &Pose| {
            let (dx, dy) = (p.position_m[0] - first[0], p.position_m[1] - first[1]);
            let [w, x, y, z] = p.quaternion;
            Pose {
                position_m: [cos * dx - sin * dy, sin * dx + cos * dy, p.position_m[2]],
                // The turn about z in front of the pose's own rotation.
                quaternion: [
                    hc * w - hs * z,
                    hc * x - hs * y,
                    hc * y + hs * x,
                    hc * z + hs * w,
                ],
            }
        };
        Self {
            base: base.iter().map(moved).collect(),
            link_rad: link_rad.to_vec(),
        }
    }

    fn speed_m_s(&self, duration_s: f64) -> f64 {
        let end = self.base.last().map_or([0.0; 3], |p| p.position_m);
        f64::from(end[0].hypot(end[1])) / duration_s
    }
}

/// Heading of body 3's x axis.
fn heading(p: &Pose) -> f64 {
    let [w, x, y, z] = p.quaternion.map(f64::from);
    (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
}

/// Root mean square distance of two paths, m.
fn apart_m(a: &Motion, b: &Motion) -> f64 {
    let squares: f64 = a
        .base
        .iter()
        .zip(&b.base)
        .map(|(p, q)| {
            let d = |k: usize| f64::from(p.position_m[k] - q.position_m[k]);
            d(0) * d(0) + d(1) * d(1)
        })
        .sum();
    (squares / a.base.len().min(b.base.len()).max(1) as f64).sqrt()
}

/// The overhead camera of both.
struct Films {
    view: View,
    solids: Vec<Solid>,
    robot: control::robot::RobotModel,
}

impl Films {
    fn new() -> Result<Self> {
        let robot = control::robot::RobotModel::default();
        let height_m = Key::CameraHeight.info().hand as f32;
        let view = View::new(height_m, (0.0, 0.0), 0.0, (320, 240), 290.0)?;
        Ok(Self {
            view,
            solids: Solid::meta_module(&robot),
            robot,
        })
    }

    fn film(&self, motion: &Motion) -> Vec<Silhouette> {
        let every = (1.0 / (FILM_HZ * Ride::PERIOD_S)).round() as usize;
        motion
            .base
            .iter()
            .zip(&motion.link_rad)
            .step_by(every)
            .map(|(base, angles)| {
                let poses = kinematics::forward(&self.robot, angles).rebased(3, &base_pose(base));
                self.view.render(&self.solids, poses.bodies())
            })
            .collect()
    }

    /// Similarity R of the predicted with the achieved motion.
    fn similarity(&self, robot: &Motion, predicted: &Motion) -> f64 {
        similarity::mean_ratio(&self.film(robot), &self.film(predicted), 0).unwrap_or(0.0)
    }
}

/// Gaits of a small search in a simulator.
fn search(args: &Args, model: &Model, what: &str) -> Result<Vec<Gait>> {
    let settings = SearchSettings::default();
    let trials = Simulated::new(model, settings.space.duration_s, args.seed)?;
    let mut search = Search::start(
        settings.space.clone(),
        settings.score,
        model.value(Key::ImpactLimit) as f32,
        args.particles,
        args.seed,
    )?;
    for _ in 0..args.iterations {
        search.iterate(&trials);
    }
    let chosen = select(search.space(), search.archive(), &settings.select);
    let named = chosen.iter().take(args.gaits.max(1)).enumerate();
    named
        .map(|(k, c)| {
            let name = format!("{what}{:02}", k + 1);
            let gait = search.space().gait(&c.found.position, &name);
            gait.map_err(|e| anyhow!("gait {name}: {e}"))
        })
        .collect()
}

/// What the simulator promises for a gait: runs with the noise of the search.
fn predicted(args: &Args, model: &Model, gait: &Gait) -> Result<Vec<Motion>> {
    let params = Params::try_from(model).context(
        "the patch holds an effect that acts outside the body simulator; search with what is left of it",
    )?;
    let params = Arc::new(params);
    let trials: Vec<Trial> = (0..REPEATS)
        .map(|run| Trial {
            params: Arc::clone(&params),
            start: Start::Home,
            drive: Drive::Gait {
                gait: Arc::new(gait.clone()),
                noise_rad: model.value(Key::CpgNoise),
                seed: args.seed ^ (run << 32),
            },
            duration_s: args.duration,
        })
        .collect();
    let options = Options {
        sample_rate_hz: 1.0 / Ride::PERIOD_S,
        record_angles: true,
        ..Options::default()
    };
    let outcomes = physics::run(&trials, &options)?;
    Ok(outcomes
        .iter()
        .map(|o| Motion::new(&o.poses, o.angles_rad.as_chunks::<JOINTS>().0))
        .collect())
}

fn ridden(plan: &Plan, gait: &Gait) -> Result<Vec<Motion>> {
    (0..REPEATS)
        .map(|run| {
            let ride = robot::play(plan, gait, run)?;
            Ok(Motion::new(&ride.base, &ride.link_rad))
        })
        .collect()
}

/// One line of the table: means over gaits and runs.
struct Line {
    gaits: &'static str,
    model: &'static str,
    predicted_m_s: f64,
    achieved_m_s: f64,
    path_error_m: f64,
    similarity: f64,
}

fn compare(
    args: &Args,
    (gaits_name, gaits): (&'static str, &[Gait]),
    (model_name, model): (&'static str, &Model),
    plan: &Plan,
    films: &Films,
) -> Result<Line> {
    let mut sums = [0.0; 4];
    let mut count = 0.0;
    for gait in gaits {
        let (promised, robot) = (predicted(args, model, gait)?, ridden(plan, gait)?);
        for (p, r) in promised.iter().zip(&robot) {
            let row = [
                p.speed_m_s(args.duration),
                r.speed_m_s(args.duration),
                apart_m(p, r),
                films.similarity(r, p),
            ];
            sums.iter_mut().zip(row).for_each(|(s, x)| *s += x);
            count += 1.0;
        }
    }
    let [predicted_m_s, achieved_m_s, path_error_m, similarity] =
        sums.map(|s| s / f64::max(count, 1.0));
    Ok(Line {
        gaits: gaits_name,
        model: model_name,
        predicted_m_s,
        achieved_m_s,
        path_error_m,
        similarity,
    })
}

/// A model file.
fn load(path: &Path) -> Result<Model> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(Model::parse(&path.display().to_string(), &text)?)
}

/// The patched model: given, or what `gap report` makes of recordings of the gaits, in a process of its own.
fn patched(args: &Args, plan: &Plan, gaits: &[Gait]) -> Result<Model> {
    if let Some(path) = &args.model {
        return load(path);
    }
    let data = args.output.join("data");
    make::write_files(&robot::case(plan, gaits)?.files, &data)?;
    let patch = args.output.join("patched.toml");
    let verdict = args.output.join("verdict.json");
    let file = patch.to_string_lossy();
    if !diagnose(
        &host(args.host.as_ref())?,
        &data,
        &verdict,
        &["--patch", &file],
    )? {
        bail!(
            "the diagnosis failed; run `rb-host gap report {}`",
            data.display()
        );
    }
    load(&patch)
}

fn store(folder: &Path, gaits: &[Gait]) -> Result<()> {
    for gait in gaits {
        let file = folder.join(format!("{}.toml", gait.name()));
        write(&file, files::gait::to_toml(gait))?;
    }
    Ok(())
}

pub(super) fn run(args: &Args) -> Result<()> {
    let plan = Plan {
        name: args.plant.clone(),
        kind: "by name",
        planted: make::parse(&args.plant, args.seed)?,
        duration_s: args.duration,
        seen_by: SeenBy::Tracker,
        without: Vec::new(),
        ..robot::plan(args.seed, 1000)
    };
    let films = Films::new()?;
    let nominal = Model::hand_tuned();
    let old = search(args, &nominal, "old")?;
    store(&args.output.join("gaits"), &old)?;
    let before = compare(args, ("old", &old), ("nominal", &nominal), &plan, &films)?;
    println!(
        "searched in the nominal simulator: {:.1} cm/s promised, {:.1} cm/s achieved",
        100.0 * before.predicted_m_s,
        100.0 * before.achieved_m_s
    );
    let model = patched(args, &plan, &old)?;
    let after = compare(args, ("old", &old), ("patched", &model), &plan, &films)?;
    let new = search(args, &model, "new")?;
    store(&args.output.join("gaits"), &new)?;
    let last = compare(args, ("new", &new), ("patched", &model), &plan, &films)?;
    publish(args, &[before, after, last], &model)
}

fn publish(args: &Args, lines: &[Line], model: &Model) -> Result<()> {
    let mut text = format!(
        "planted: {}\npatched model: {} effects\n\n| gaits searched in | model | predicted, cm/s | achieved, cm/s | off by | path error, cm | R |\n|---|---|---|---|---|---|---|\n",
        args.plant,
        model.effects().len()
    );
    for l in lines {
        let off = 100.0 * (l.predicted_m_s / l.achieved_m_s.max(1e-6) - 1.0);
        let _ = writeln!(
            text,
            "| {} simulator | {} | {:.2} | {:.2} | {off:+.0} % | {:.1} | {:.3} |",
            if l.gaits == "old" {
                "the nominal"
            } else {
                "the patched"
            },
            l.model,
            100.0 * l.predicted_m_s,
            100.0 * l.achieved_m_s,
            100.0 * l.path_error_m,
            l.similarity
        );
    }
    text.push_str("| paper, fitted simulator | | 6.0 | 5.8 | +3 % | | |\n");
    write(&args.output.join("close.md"), &text)?;
    println!("{text}");
    Ok(())
}
