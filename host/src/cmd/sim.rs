//! `rb-host sim`

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use control::cpg;
use control::gait::Gait;
use files::model::{Key, Model};
use optimise::meta::{FilmMaker, Placement, rows_of};
use optimise::simulated::bodies;
use physics::{CONTROL_RATE_HZ, Drive, Options, Outcome, Params, Start, Trial};
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;

use crate::cli::parse_duration;
use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome as Done};
use crate::robot_file::RobotFile;
use crate::searching::films;
use crate::searching::frames::Frames;

/// Play gaits in the body simulator: distance, impact, collision; with -o a data set folder, with --camera its films
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Gait files
    #[arg(required = true, value_name = "GAIT.toml")]
    gaits: Vec<PathBuf>,
    /// Robot model and effects; the shipped hand-tuned model when absent
    #[arg(short, long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Another robot than the meta-module (robot.toml); gaits need as many oscillators as it has motors
    #[arg(long, value_name = "FILE", conflicts_with = "camera")]
    robot: Option<PathBuf>,
    /// Length of each run [default: as the gait says]
    #[arg(short, long, value_name = "TIME", value_parser = parse_duration)]
    duration: Option<Duration>,
    /// Runs per gait; with more than one each has its own noise on the CPG outputs
    #[arg(long, value_name = "N", default_value_t = 1)]
    repeat: u16,
    /// Seed of the noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Time step of the simulation, such as 2ms [default: 4ms]
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    step: Option<Duration>,
    /// Film from the model's overhead camera into the data set
    #[arg(long, requires = "output")]
    camera: bool,
    /// Data set folder to write
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
}

/// Samples per second of motions and films; the paper's camera.
const RATE_HZ: f64 = films::RATE_HZ;

/// Simulates.
///
/// # Errors
/// Exit code 3 for files, 1 when the disk refuses.
pub fn run(args: &Args, context: &Context) -> Done {
    let model = crate::model_file::load(args.model.as_deref())?;
    let robot = args.robot.as_deref();
    let robot = robot
        .map(|path| crate::robot_file::load(path, &model))
        .transpose()?;
    let params = match &robot {
        Some(file) => Params::new(&model, Arc::clone(&file.robot)),
        None => Params::try_from(&model),
    };
    let params = Arc::new(params.map_err(|error| Failure::new(Exit::BadFile, error))?);
    let gaits = args
        .gaits
        .iter()
        .map(|path| crate::gait_file::load(path))
        .collect::<Done<Vec<Gait>>>()?;
    if let Some(folder) = &args.output {
        disk::must_be_empty(folder)?;
    }
    let runs: Vec<(usize, u16)> = (0..gaits.len())
        .flat_map(|g| (0..args.repeat.max(1)).map(move |r| (g, r)))
        .collect();
    let options = Options {
        time_step_s: args
            .step
            .map_or(Options::default().time_step_s, |step| step.as_secs_f64()),
        sample_rate_hz: RATE_HZ,
        record_angles: true,
        ..Options::default()
    };
    let trials: Vec<Trial> = runs
        .iter()
        .map(|&run| trial(args, &gaits, &model, &params, run))
        .collect();
    let outcomes = simulated(&trials, &options, context)?;
    if let Some(folder) = &args.output {
        let folder = Writer::new(folder, args.camera, &model, robot.as_ref(), context)?;
        folder.write(&gaits, &runs, &trials, &outcomes)?;
        context.out.wrote(folder.folder);
    }
    report(&gaits, &runs, &outcomes, context);
    Ok(())
}

/// Runs the trials some at a time, so that a bar can say how far it is; results do not depend on how they are split.
fn simulated(trials: &[Trial], options: &Options, context: &Context) -> Done<Vec<Outcome>> {
    const AT_ONCE: usize = 64;
    let bar = context.out.progress(trials.len() as u64, "simulating");
    let mut outcomes = Vec::with_capacity(trials.len());
    for some in trials.chunks(AT_ONCE) {
        let run = physics::run(some, options);
        outcomes.extend(run.map_err(|error| Failure::new(Exit::Usage, error))?);
        bar.inc(some.len() as u64);
    }
    bar.finish_and_clear();
    Ok(outcomes)
}

fn trial(
    args: &Args,
    gaits: &[Gait],
    model: &Model,
    params: &Arc<Params>,
    (g, repetition): (usize, u16),
) -> Trial {
    let gait = gaits[g].clone();
    let duration_s = args
        .duration
        .map_or(f64::from(gait.duration_s()), |d| d.as_secs_f64());
    // Films see the motion up to one time shift after its end.
    let tail_s = if args.camera {
        model.value(Key::CameraTimeShift).max(0.0)
    } else {
        0.0
    };
    let noisy = args.repeat > 1;
    Trial {
        params: Arc::clone(params),
        start: Start::Home,
        drive: Drive::Gait {
            gait: Arc::new(gait),
            noise_rad: if noisy {
                model.value(Key::CpgNoise)
            } else {
                0.0
            },
            seed: args
                .seed
                .wrapping_mul(1_000_003)
                .wrapping_add(u64::from(repetition))
                .wrapping_add((g as u64) << 20),
        },
        duration_s: duration_s + tail_s,
    }
}

fn report(gaits: &[Gait], runs: &[(usize, u16)], outcomes: &[Outcome], context: &Context) {
    let mut text = String::from(
        "gait              run  distance[m]  speed[cm/s]  impact[m/s]  clearance[mm]  remark\n",
    );
    let mut rows = Vec::new();
    for (&(g, repetition), outcome) in runs.iter().zip(outcomes) {
        let remark = match (&outcome.not_finite, outcome.collided_at_s) {
            (Some(lost), _) => format!("a number was lost at step {}", lost.step),
            (None, Some(t_s)) => format!("touched itself at {t_s:.2} s"),
            (None, None) => String::new(),
        };
        // The simulator measures up to 1 m; beyond, the cubes that may meet never came near.
        let clearance = match outcome.clearance_m {
            far if far >= 1.0 => "far".to_owned(),
            near => format!("{:.1}", near * 1000.0),
        };
        let _ = writeln!(
            text,
            "{:16} {:4} {:12.3} {:12.2} {:12.2} {:>14}  {remark}",
            gaits[g].name(),
            repetition + 1,
            outcome.distance_m,
            outcome.speed_m_s * 100.0,
            outcome.impact_m_s,
            clearance,
        );
        rows.push(json!({
            "gait": gaits[g].name(), "run": repetition + 1, "distance_m": outcome.distance_m, "speed_m_s": outcome.speed_m_s,
            "impact_m_s": outcome.impact_m_s, "clearance_m": outcome.clearance_m, "collided_at_s": outcome.collided_at_s,
            "not_finite_at_step": outcome.not_finite.map(|lost| lost.step),
        }));
    }
    context
        .out
        .result("rb.sim/1", json!({ "runs": Value::from(rows) }), || text);
}

/// Writes the runs as a data set folder.
struct Writer<'a> {
    folder: &'a Path,
    films: bool,
    model: &'a Model,
    robot: Option<&'a RobotFile>,
    context: &'a Context,
}

impl<'a> Writer<'a> {
    fn new(
        folder: &'a Path,
        films: bool,
        model: &'a Model,
        robot: Option<&'a RobotFile>,
        context: &'a Context,
    ) -> Done<Self> {
        disk::begin(folder)?;
        Ok(Self {
            folder,
            films,
            model,
            robot,
            context,
        })
    }

    fn write(
        &self,
        gaits: &[Gait],
        runs: &[(usize, u16)],
        trials: &[Trial],
        outcomes: &[Outcome],
    ) -> Done {
        let mut manifest = String::from(
            "format = 1\nrobot = \"metamodule\"\nname = \"body simulator\"\n\n[metamodule]\nmodel = \"model.toml\"\n",
        );
        if self.films {
            manifest.push_str(&films::camera_toml(&films::settings(1)));
        }
        disk::claim(self.folder, &names(gaits, runs))?;
        disk::make_folder(&self.folder.join("gaits"))?;
        for gait in gaits {
            let file = self
                .folder
                .join("gaits")
                .join(format!("{}.toml", gait.name()));
            disk::write(&file, files::gait::to_toml(gait).as_bytes())?;
        }
        let bar = self.context.out.progress(runs.len() as u64, "writing");
        let mut starts_m: Vec<Option<[f32; 2]>> = vec![None; gaits.len()];
        for ((&(g, repetition), trial), outcome) in runs.iter().zip(trials).zip(outcomes) {
            // The robot is put down so that its first run stays in the middle of the picture; repeats begin at the same place.
            let start_m = *starts_m[g].get_or_insert_with(|| centring_start_m(outcome));
            let name = run_name(gaits, (g, repetition));
            let _ = write!(
                manifest,
                "\n[[run]]\nfile = \"{name}.csv\"\ngait = \"{}\"\n",
                gaits[g].name()
            );
            let rows = csv(&gaits[g], outcome, start_m);
            disk::write(&self.folder.join(format!("{name}.csv")), rows.as_bytes())?;
            if self.films {
                let _ = writeln!(manifest, "frames = \"{name}\"");
                self.film(&name, trial, outcome, start_m)?;
            }
            bar.inc(1);
        }
        bar.finish_and_clear();
        // The truth stays out of what a blind reader gets: the model is the shipped one.
        let shipped = Model::hand_tuned().to_toml();
        disk::write(&self.folder.join("model.toml"), shipped.as_bytes())?;
        match self.robot {
            None => disk::write(&self.folder.join("dataset.toml"), manifest.as_bytes())?,
            // The data set format knows the meta-module and the bench, so another robot's runs have no manifest.
            Some(robot) => disk::write(&self.folder.join("robot.toml"), robot.text.as_bytes())?,
        }
        disk::finish(self.folder)
    }

    fn film(&self, name: &str, trial: &Trial, outcome: &Outcome, start_m: [f32; 2]) -> Done {
        let rows = rows_of(self.model);
        let maker = FilmMaker::new(films::settings(1), &self.context.robot_model());
        let [x_m, y_m] = start_m;
        let placement = Placement {
            yaw_rad: 0.0,
            x_m,
            y_m,
        };
        let motion = bodies(&self.context.robot_model(), outcome);
        let tail_s = self.model.value(Key::CameraTimeShift).max(0.0);
        let frames = ((trial.duration_s - tail_s) * RATE_HZ) as usize;
        let film = maker
            .film(&motion, RATE_HZ, &rows, frames, 1, placement)
            .map_err(|e| Failure::new(Exit::BadFile, e))?;
        let t_s = (0..film.len()).map(|k| k as f64 / RATE_HZ).collect();
        let film = Frames { t_s, frames: film };
        disk::claim(self.folder, &film.names(name))?;
        film.write_into(&self.folder.join(name))
    }
}

/// Name of a run in a data set.
fn run_name(gaits: &[Gait], (g, repetition): (usize, u16)) -> String {
    format!("{}_{}", gaits[g].name(), repetition + 1)
}

/// Names of the files of a data set, films apart.
fn names(gaits: &[Gait], runs: &[(usize, u16)]) -> Vec<String> {
    let gait = |gait: &Gait| format!("gaits/{}.toml", gait.name());
    let run = |run: &(usize, u16)| format!("{}.csv", run_name(gaits, *run));
    let shared = ["model.toml", "dataset.toml", "robot.toml"].map(str::to_owned);
    let all = gaits.iter().map(gait).chain(runs.iter().map(run));
    all.chain(shared).collect()
}

/// The start that puts the middle of a run's extent under the camera, m.
pub(crate) fn centring_start_m(outcome: &Outcome) -> [f32; 2] {
    core::array::from_fn(|axis| {
        let along = outcome.poses.iter().map(|pose| pose.position_m[axis]);
        let (low, high) = along.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), v| {
            (low.min(v), high.max(v))
        });
        if low <= high {
            -0.5 * (low + high)
        } else {
            0.0
        }
    })
}

/// Set-points at 20 Hz and link angles with the base pose at the film's rate, each in rows of their own time.
fn csv(gait: &Gait, outcome: &Outcome, start_m: [f32; 2]) -> String {
    let joints = gait.oscillators().len();
    let mut text = String::from("t_s");
    for signal in ["setpoint_rad", "link_position_rad"] {
        for k in 0..joints {
            let _ = write!(text, ",{signal}_{k}");
        }
    }
    text.push_str(",base_x_m,base_y_m,base_z_m,base_qw,base_qx,base_qy,base_qz\n");
    let mut state = cpg::start(gait);
    let mut tick = 0u32;
    let samples = outcome
        .poses
        .iter()
        .zip(outcome.angles_rad.chunks_exact(joints));
    for (k, (pose, angles)) in samples.enumerate() {
        let t_s = k as f64 / RATE_HZ;
        while f64::from(tick) / CONTROL_RATE_HZ <= t_s + 1e-9 {
            let _ = write!(text, "{:.6}", f64::from(tick) / CONTROL_RATE_HZ);
            let set_points = cpg::step(gait, &mut state, (1.0 / CONTROL_RATE_HZ) as f32);
            for q in set_points.as_slice() {
                let _ = write!(text, ",{q}");
            }
            text.push_str(&",".repeat(joints + 7));
            text.push('\n');
            tick += 1;
        }
        // A hundred nanoseconds later where both fall together: times of a file must rise.
        let _ = write!(text, "{:.7}{}", t_s + 1e-7, ",".repeat(joints));
        let [x, y, z] = pose.position_m;
        let position_m = [x + start_m[0], y + start_m[1], z];
        let pose = position_m.iter().chain(&pose.quaternion);
        for v in angles.iter().chain(pose) {
            let _ = write!(text, ",{v}");
        }
        text.push('\n');
    }
    text
}
