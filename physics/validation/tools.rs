//! What the validation and the benchmark share: gaits, files for the other engines, building and running them.
// Each of the two programs leaves some of it unused.
#![allow(dead_code)]

use files::model::{Key, Model};
use physics::mjcf::{self, Servo};
use physics::{Drive, Level, Options, Outcome, Params, Start, Trial, run_at};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

/// Ticks of a 30 s trial at 20 Hz.
pub(crate) const TICKS: usize = 600;
/// Joints of the meta-module.
pub(crate) const JOINTS: usize = 6;
/// Points on a great circle of the exported hulls: 5 degrees, 0.06 mm off the ball.
const PER_TURN: usize = 72;

/// Base position, quaternion and joint angles at 20 Hz, t = 0 and the end included.
pub(crate) type Track = Vec<[f64; 7 + JOINTS]>;

/// What an engine did with all trials.
pub(crate) struct Report {
    pub(crate) tracks: Vec<Track>,
    /// "name value" lines of a foreign engine.
    pub(crate) figures: Vec<(String, f64)>,
}

impl Report {
    pub(crate) fn figure(&self, name: &str) -> f64 {
        self.figures
            .iter()
            .find(|(n, _)| n == name)
            .map_or(f64::NAN, |(_, v)| *v)
    }
}

/// The hand-tuned model without bounce, which MuJoCo cannot express.
pub(crate) fn params() -> Arc<Params> {
    let mut model = Model::hand_tuned();
    model.set(Key::Bounce, 0.0).expect("zero is in range");
    Arc::new(Params::try_from(&model).expect("the hand-tuned model is valid"))
}

/// Random gaits that do not touch themselves, as trials from home at once, without noise.
pub(crate) fn trials(params: &Arc<Params>, count: usize) -> Vec<Trial> {
    let mut out = Vec::new();
    let mut k = 0;
    while out.len() < count {
        let batch: Vec<Trial> = (k..k + 16)
            .map(|k| Trial {
                params: Arc::clone(params),
                start: Start::HomeAtOnce,
                drive: Drive::Gait {
                    gait: Arc::new(crate::common::random_gait(1, k, (0.5, 1.2))),
                    noise_rad: 0.0,
                    seed: 0,
                },
                duration_s: TICKS as f64 / 20.0,
            })
            .collect();
        k += 16;
        let done = run_at(Level::detect(), &batch, &Options::default()).expect("valid trials");
        let clear = batch
            .into_iter()
            .zip(done)
            .filter(|(_, o)| o.clearance_m > 0.005);
        out.extend(clear.map(|(t, _)| t));
    }
    out.truncate(count);
    out
}

/// Our own engine.
pub(crate) fn ours(level: Level, trials: &[Trial], h: f64, sweeps: u32) -> (Report, Vec<Outcome>) {
    let options = Options {
        time_step_s: h,
        sweeps,
        record_angles: true,
        ..Options::default()
    };
    let outcomes = run_at(level, trials, &options).expect("valid trials");
    let tracks = outcomes
        .iter()
        .map(|o| {
            assert!(o.not_finite.is_none(), "a trial diverged");
            let angles = o.angles_rad.chunks(JOINTS);
            let row = |(p, a): (&physics::Pose, &[f32])| {
                let mut row = [0.0; 7 + JOINTS];
                let values = p.position_m.iter().chain(&p.quaternion).chain(a);
                for (slot, x) in row.iter_mut().zip(values) {
                    *slot = f64::from(*x);
                }
                row
            };
            o.poses.iter().zip(angles).map(row).collect()
        })
        .collect();
    (
        Report {
            tracks,
            figures: Vec::new(),
        },
        outcomes,
    )
}

/// The set-points of every trial, from the control crate.
fn set_points(trial: &Trial) -> Vec<f64> {
    let Drive::Gait { gait, .. } = &trial.drive else {
        return Vec::new();
    };
    let mut state = control::cpg::start(gait);
    (0..TICKS)
        .flat_map(|_| {
            let out = control::cpg::step(gait, &mut state, 0.05);
            out.as_slice()
                .iter()
                .map(|x| f64::from(*x))
                .collect::<Vec<f64>>()
        })
        .collect()
}

/// The other engines' programs and files in one folder.
pub(crate) struct Bench {
    folder: PathBuf,
    pub(crate) mujoco: Option<PathBuf>,
    pub(crate) ode: Option<PathBuf>,
}

impl Bench {
    /// Writes the model and the trials into a folder of that name, builds what can be built, and says what cannot.
    pub(crate) fn new(name: &str, params: &Params, trials: &[Trial]) -> Bench {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let target = root.parent().unwrap_or(root).join("target");
        let folder = target.join("validation").join(name);
        std::fs::create_dir_all(&folder).expect("the target folder can be written");
        let write = |name: &str, data: &[u8]| {
            std::fs::write(folder.join(name), data).expect("the target folder can be written");
        };
        for (name, servo) in [
            ("model.xml", Servo::Constraint),
            ("actuator.xml", Servo::Actuator),
        ] {
            write(
                name,
                mjcf::to_mjcf(params, 0.004, PER_TURN, servo).as_bytes(),
            );
        }
        write("robot.txt", robot_text(params).as_bytes());
        write("trials.bin", &trial_bytes(params, trials));
        let source = root.join("validation");
        let mujoco = mujoco_folder(&target).and_then(|lib| {
            let so = std::fs::read_dir(&lib)
                .ok()?
                .flatten()
                .map(|e| e.path())
                .find(|p| {
                    p.file_name()
                        .is_some_and(|n| n.to_string_lossy().starts_with("libmujoco.so"))
                })?;
            let program = folder.join("mujoco_run");
            let built = Command::new("cc")
                .arg("-O2")
                .arg(format!("-I{}", lib.join("include").display()))
                .args([source.join("mujoco_run.c").as_os_str(), so.as_os_str()])
                .arg(format!("-Wl,-rpath,{}", lib.display()))
                .args(["-lm", "-o"])
                .arg(&program)
                .status();
            built.ok().filter(|s| s.success()).map(|_| program)
        });
        if mujoco.is_none() {
            eprintln!("MuJoCo left out: needs cc and target/venv with `pip install mujoco`");
        }
        let program = folder.join("ode_run");
        let built = Command::new("cc")
            .args(["-O2", "-o"])
            .arg(&program)
            .arg(source.join("ode_run.c"))
            .args(["-lode", "-lm"])
            .status();
        let ode = built.ok().filter(|s| s.success()).map(|_| program);
        if ode.is_none() {
            eprintln!("ODE left out: needs cc and libode-dev");
        }
        Bench {
            folder,
            mujoco,
            ode,
        }
    }

    /// Every trial in MuJoCo, with either form of the servo.
    pub(crate) fn run_mujoco(&self, h: f64, servo: Servo) -> Option<Report> {
        let program = self.mujoco.as_ref()?;
        let model = match servo {
            Servo::Constraint => "model.xml",
            Servo::Actuator => "actuator.xml",
        };
        self.report(
            program,
            &[model, &h.to_string(), "trials.bin", "mujoco.bin"],
        )
    }

    /// Largest relative energy drift of MuJoCo over 10 s.
    pub(crate) fn mujoco_energy(&self, h: f64) -> Option<f64> {
        let program = self.mujoco.as_ref()?;
        let text = self.text(program, &["model.xml", &h.to_string(), "energy"])?;
        figures(&text).first().map(|(_, v)| *v)
    }

    /// Every trial in ODE; `stepper` is `step` or `quick`.
    pub(crate) fn run_ode(&self, h: f64, stepper: &str) -> Option<Report> {
        let program = self.ode.as_ref()?;
        self.report(
            program,
            &[
                "robot.txt",
                &h.to_string(),
                stepper,
                "trials.bin",
                "ode.bin",
            ],
        )
    }

    fn text(&self, program: &Path, args: &[&str]) -> Option<String> {
        let out = Command::new(program)
            .args(args)
            .current_dir(&self.folder)
            .output()
            .ok()?;
        if !out.status.success() {
            eprintln!(
                "{}: {}",
                program.display(),
                String::from_utf8_lossy(&out.stderr)
            );
            return None;
        }
        Some(String::from_utf8_lossy(&out.stdout).into_owned())
    }

    fn report(&self, program: &Path, args: &[&str]) -> Option<Report> {
        let text = self.text(program, args)?;
        let bytes = std::fs::read(self.folder.join(args[args.len() - 1])).ok()?;
        let numbers: Vec<f64> = bytes
            .chunks_exact(8)
            .map(|b| f64::from_le_bytes(b.try_into().expect("eight bytes")))
            .collect();
        let rows: Track = numbers
            .chunks_exact(7 + JOINTS)
            .map(|r| r.try_into().expect("a row"))
            .collect();
        Some(Report {
            tracks: rows.chunks(TICKS + 1).map(<[_]>::to_vec).collect(),
            figures: figures(&text),
        })
    }
}

fn figures(text: &str) -> Vec<(String, f64)> {
    text.lines()
        .filter_map(|l| l.split_once(' '))
        .filter_map(|(n, v)| Some((n.to_owned(), v.trim().parse().ok()?)))
        .collect()
}

/// The mujoco package of target/venv.
fn mujoco_folder(target: &Path) -> Option<PathBuf> {
    let lib = target.join("venv").join("lib");
    let python = std::fs::read_dir(lib).ok()?.flatten().next()?.path();
    Some(python.join("site-packages").join("mujoco")).filter(|p| p.is_dir())
}

fn trial_bytes(params: &Params, trials: &[Trial]) -> Vec<u8> {
    let mut out = Vec::new();
    for n in [trials.len(), TICKS, JOINTS] {
        out.extend(i32::try_from(n).expect("a small number").to_le_bytes());
    }
    for j in params.joints.iter().take(JOINTS) {
        for x in [j.gain_per_s, j.max_speed_rad_s, j.max_torque_nm] {
            out.extend(x.to_le_bytes());
        }
    }
    for trial in trials {
        for x in set_points(trial) {
            out.extend(x.to_le_bytes());
        }
    }
    out
}

fn robot_text(params: &Params) -> String {
    let raw = params.robot.raw();
    let rigid = mjcf::rigid_bodies(params);
    let mut out = String::new();
    let _ = writeln!(
        out,
        "{} {} {} {}",
        params.cfm,
        params.erp,
        params.friction,
        raw.bodies.len()
    );
    let mut list = |values: &[f64]| {
        for v in values {
            let _ = write!(out, "{v} ");
        }
        out.push('\n');
    };
    for (b, r) in raw.bodies.iter().zip(&rigid) {
        list(&[b.parent.map_or(-1.0, |p| p as f64)]);
        list(&b.offset_m);
        list(&b.axis);
        list(&[b.joint.map_or(-1.0, |j| j as f64), r.mass_kg]);
        list(&r.com_m);
        list(&r.inertia_kg_m2);
    }
    list(&[raw.halves.len() as f64]);
    for (h, half) in raw.halves.iter().enumerate() {
        let points = mjcf::surface(&params.robot, h, PER_TURN);
        list(&[half.body as f64]);
        list(&half.centre_m);
        list(&[points.len() as f64]);
        list(&points.into_iter().flatten().collect::<Vec<f64>>());
    }
    out
}

/// Middle value.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    if values.is_empty() {
        f64::NAN
    } else {
        values[values.len() / 2]
    }
}

/// Processor time of this process, s: the machine may be busy with other work. Linux keeps it in nanoseconds; elsewhere the wall clock.
pub(crate) fn cpu_s() -> f64 {
    let spent = std::fs::read_to_string("/proc/self/schedstat")
        .ok()
        .and_then(|t| t.split(' ').next().and_then(|n| n.parse::<f64>().ok()));
    let wall = || {
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        now.map_or(0.0, |d| d.as_secs_f64())
    };
    spent.map_or_else(wall, |ns| ns * 1e-9)
}
