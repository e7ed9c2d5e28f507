//! The hybrid cycle: search, record on the robot, match the model, simulate again, and so on with the matched model.
//!
//! ```text
//! hybrid.toml   model.toml   state.json   robot/          what it was told, where it stands, the emulated robot
//! cycle1/model.toml   search.toml   search/   set/   start.toml   match/   resimulate/
//! times.json   account.txt, .json, .svg   report.html     the only files with wall times
//! ```
//! A step is done when `state.json` names the next one; every step goes on from what it has written. So an interrupted
//! cycle ends with the same bytes as one that was left alone, but for the last line of files above.

pub mod account;
mod page;
mod record;
pub mod resimulate;
pub mod settings;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Parser;
use files::model::{Key, Model};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::cli::Cli;
use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::link::PortUri;
use crate::searching::folder::Folder;
use account::{Account, Times};
use settings::HybridSettings;

/// A step of a cycle.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
pub enum Step {
    /// Search gaits on the present model, select.
    Search,
    /// Run them on the robot.
    Record,
    /// Ask the diagnosis where the gap is and which effect causes it; only where the settings want it.
    Diagnose,
    /// Fit the model to the films.
    Match,
    /// Simulate the recorded gaits with the model before and after.
    Resimulate,
    /// All cycles are done.
    Done,
}

impl Step {
    fn name(self) -> &'static str {
        match self {
            Self::Search => "search",
            Self::Record => "record",
            Self::Diagnose => "diagnose",
            Self::Match => "match",
            Self::Resimulate => "resimulate",
            Self::Done => "done",
        }
    }
}

/// Where a hybrid optimisation stands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct State {
    format: u32,
    /// From 1.
    cycle: u32,
    /// Next step.
    step: Step,
    /// Port of the robot; empty = the one drawn in the folder.
    port: String,
    /// The `[camera]` table of a real camera.
    camera: String,
    /// Slot of a real robot whose gait may be replaced.
    slot: Option<u8>,
}

/// Names in the folder.
const STATE: &str = "state.json";
/// See [`STATE`].
const TIMES: &str = "times.json";
/// See [`STATE`].
const SETTINGS: &str = "hybrid.toml";
/// Patched model that the diagnosis of a cycle writes.
const DIAGNOSIS: &str = "diagnosis.toml";
/// See [`STATE`].
const MODEL: &str = "model.toml";

/// Folder of the drawn robot.
pub const ROBOT: &str = "robot";

/// How to begin.
#[derive(Debug, Clone)]
pub struct Beginning {
    /// How much of everything.
    pub settings: HybridSettings,
    /// The nominal model.
    pub model: Model,
    /// Where the robot is; empty = the one drawn in [`ROBOT`].
    pub port: String,
    /// The `[camera]` table of a real camera; empty = as the scenario says, or a Kinect.
    pub camera: String,
    /// Slot of a real robot whose gait may be replaced; an emulated one is new for every take.
    pub slot: Option<u8>,
}

/// A hybrid optimisation in its folder.
pub struct Hybrid<'a> {
    context: &'a Context,
    folder: Folder,
    path: PathBuf,
    settings: HybridSettings,
    state: State,
    times: Times,
    threads: Option<usize>,
}

impl<'a> Hybrid<'a> {
    /// Begins in a folder that is empty but for what the caller has put there (the emulated robot).
    ///
    /// # Errors
    /// Exit code 2 when one stands there already.
    pub fn begin(context: &'a Context, path: &Path, beginning: &Beginning) -> Outcome<Self> {
        if path.join(STATE).exists() {
            let message = format!("{} already holds a hybrid cycle", path.display());
            return Err(Failure::say(Exit::Usage, message)
                .hint("go on with --resume, or choose another folder"));
        }
        disk::make_folder(path)?;
        let folder = Folder::at(path);
        let settings = toml::to_string(&beginning.settings).map_err(anyhow::Error::from)?;
        folder.write(SETTINGS, settings.as_bytes())?;
        folder.write(MODEL, beginning.model.to_toml().as_bytes())?;
        let hybrid = Self {
            context,
            folder,
            path: path.to_owned(),
            settings: beginning.settings.clone(),
            state: State {
                format: 1,
                cycle: 1,
                step: Step::Search,
                port: beginning.port.clone(),
                camera: beginning.camera.clone(),
                slot: beginning.slot,
            },
            times: Times::default(),
            threads: None,
        };
        hybrid.store()?;
        Ok(hybrid)
    }

    /// Goes on with the one in the folder.
    ///
    /// # Errors
    /// Exit code 2 when there is none, 3 when it is damaged.
    pub fn resume(context: &'a Context, path: &Path) -> Outcome<Self> {
        let folder = Folder::at(path);
        let read = |name: &str| {
            let path = folder.join(name);
            disk::read_text(&path, disk::MAX_TEXT).map_err(|e| {
                Failure::say(Exit::Usage, format!("{}: {e}", path.display()))
                    .hint("leave --resume away to begin a hybrid cycle there")
            })
        };
        let damaged = |name: &str, e: serde_json::Error| {
            Failure::say(
                Exit::BadFile,
                format!("{}: {e}", folder.join(name).display()),
            )
            .hint("the file is damaged or of another version; begin in a new folder")
        };
        let state = serde_json::from_str(&read(STATE)?).map_err(|e| damaged(STATE, e))?;
        let times = match read(TIMES) {
            Ok(text) => serde_json::from_str(&text).map_err(|e| damaged(TIMES, e))?,
            Err(_) => Times::default(),
        };
        let settings = HybridSettings::load(Some(&folder.join(SETTINGS)))?;
        Ok(Self {
            context,
            path: path.to_owned(),
            folder,
            settings,
            state,
            times,
            threads: None,
        })
    }

    /// Another port than the one it began with.
    pub fn set_port(&mut self, port: &str) {
        port.clone_into(&mut self.state.port);
    }

    /// Threads of search and match; the result does not depend on it.
    pub fn set_threads(&mut self, threads: Option<usize>) {
        self.threads = threads;
    }

    /// Does steps until `cycles` are done, or `until` of the present cycle is.
    ///
    /// # Errors
    /// Exit code 130 for Ctrl-C, 1 when films of a real robot are missing; those of the steps.
    pub fn run(&mut self, cycles: u32, until: Option<Step>) -> Outcome {
        if self.state.step == Step::Done && self.state.cycle < cycles {
            self.begin_cycle(self.state.cycle + 1)?;
        }
        while self.state.step != Step::Done {
            let step = self.state.step;
            let (cycle, name) = (self.state.cycle, step.name());
            self.context
                .out
                .say(format_args!("cycle {cycle} of {cycles}: {name}"));
            let begun = Instant::now();
            let done = self.step(step);
            // Robot time is counted as such; the wall time of an emulated robot is none.
            if step != Step::Record {
                let wall_s = begun.elapsed().as_secs_f64();
                let key = format!("cycle{cycle}/{name}");
                *self.times.wall_s.entry(key).or_insert(0.0) += wall_s;
            }
            self.store_times()?;
            done.map_err(|failure| self.told_how_to_go_on(failure))?;
            self.advance(step, cycles)?;
            if until == Some(step) {
                break;
            }
        }
        self.report()
    }

    fn told_how_to_go_on(&self, failure: Failure) -> Failure {
        match failure.exit() {
            Exit::Interrupted => {
                Failure::say(Exit::Interrupted, failure.to_string()).hint(format!(
                    "go on with `rb-host hybrid --resume -o {}`",
                    self.path.display()
                ))
            }
            _ => failure,
        }
    }

    fn step(&mut self, step: Step) -> Outcome {
        disk::make_folder(&self.cycle_path())?;
        match step {
            Step::Search => self.search(),
            Step::Record => self.record(),
            Step::Diagnose => self.diagnose(),
            Step::Match => self.fit(),
            Step::Resimulate => self.resimulate(),
            Step::Done => Ok(()),
        }
    }

    fn advance(&mut self, done: Step, cycles: u32) -> Outcome {
        self.state.step = match done {
            Step::Search => Step::Record,
            Step::Record if self.settings.diagnose => Step::Diagnose,
            Step::Record | Step::Diagnose => Step::Match,
            Step::Match => Step::Resimulate,
            Step::Resimulate | Step::Done => Step::Done,
        };
        if self.state.step == Step::Done && self.state.cycle < cycles {
            return self.begin_cycle(self.state.cycle + 1);
        }
        self.store()
    }

    fn begin_cycle(&mut self, cycle: u32) -> Outcome {
        self.state.cycle = cycle;
        self.state.step = Step::Search;
        self.store()
    }

    fn cycle_path(&self) -> PathBuf {
        self.path.join(format!("cycle{}", self.state.cycle))
    }

    /// The model that this cycle searches on: the nominal one, or what the cycle before has matched.
    fn model(&self) -> Outcome<Model> {
        let path = match self.state.cycle {
            0 | 1 => self.path.join(MODEL),
            n => self
                .path
                .join(format!("cycle{}", n - 1))
                .join("match")
                .join(MODEL),
        };
        crate::model_file::load(Some(&path))
    }

    fn search(&self) -> Outcome {
        let path = self.cycle_path();
        let folder = Folder::at(&path);
        folder.write(MODEL, self.model()?.to_toml().as_bytes())?;
        let mut settings = self.settings.search.clone();
        settings.seed = settings.seed.wrapping_add(u64::from(self.state.cycle - 1));
        let text = toml::to_string(&settings).map_err(anyhow::Error::from)?;
        folder.write("search.toml", text.as_bytes())?;
        if !path.join("search/checkpoint.json").exists() {
            disk::remove_folder(&path.join("search"))?;
        }
        // What an interrupted search selected is not what the whole one does.
        let gaits = path.join("search/gaits");
        disk::remove_folder(&gaits)?;
        let mut words = self.words(&["optimise", "gait"], "search");
        if !path.join("search/checkpoint.json").exists() {
            words.extend(["-s".into(), path.join("search.toml").into()]);
            words.extend(["-m".into(), path.join(MODEL).into()]);
        }
        self.command(words)
    }

    fn diagnose(&self) -> Outcome {
        let path = self.cycle_path();
        let mut words: Vec<OsString> = ["rb-host", "gap", "report", "--force"]
            .map(Into::into)
            .into();
        words.push(path.join("set").into());
        for (flag, file) in [
            ("-o", "diagnosis.html"),
            ("--json-file", "diagnosis.json"),
            ("--patch", DIAGNOSIS),
        ] {
            words.extend([flag.into(), path.join(file).into()]);
        }
        self.command(words)
    }

    fn fit(&self) -> Outcome {
        let path = self.cycle_path();
        let folder = Folder::at(&path);
        let start = self.filmed(self.model()?)?;
        folder.write("start.toml", start.to_toml().as_bytes())?;
        let mut from = "start.toml";
        if self.settings.diagnose {
            // What the diagnosis has found stays in the model; the match fits its rows around it.
            from = "patched.toml";
            let found = crate::model_file::load(Some(&path.join(DIAGNOSIS)))?;
            folder.write(from, self.filmed(found)?.to_toml().as_bytes())?;
        }
        if !path.join("match/checkpoint.json").exists() {
            disk::remove_folder(&path.join("match"))?;
        }
        let mut words = self.words(&["optimise", "model"], "match");
        words.insert(3, path.join("set").into());
        let told = &self.settings.matching;
        words.extend(["--iterations".into(), told.iterations.to_string().into()]);
        if !path.join("match/checkpoint.json").exists() {
            words.extend(["-m".into(), path.join(from).into()]);
            for (flag, value) in [
                ("--particles", told.particles.to_string()),
                ("--rows", told.rows.clone()),
                ("--stride", told.stride.to_string()),
                ("--seed", told.seed.to_string()),
            ] {
                words.extend([flag.into(), value.into()]);
            }
        }
        self.command(words)
    }

    /// A model with what is known of the camera: its height from the data set, and no time shift, for the films are laid in time.
    fn filmed(&self, mut model: Model) -> Outcome<Model> {
        let manifest = self.set()?.manifest()?;
        let known = |key: &str| {
            let camera = manifest.camera.as_ref()?;
            camera.quantities.get(key).map(|quantity| quantity.value)
        };
        let bad = |e| Failure::new(Exit::BadFile, anyhow::Error::new(e));
        if let Some(height_m) = known("height_m") {
            model.set(Key::CameraHeight, height_m).map_err(bad)?;
        }
        model.set(Key::CameraTimeShift, 0.0).map_err(bad)?;
        Ok(model)
    }

    fn resimulate(&self) -> Outcome {
        let path = self.cycle_path();
        let before = crate::model_file::load(Some(&path.join("start.toml")))?;
        let after = crate::model_file::load(Some(&path.join("match").join(MODEL)))?;
        let folder = resimulate::folder(&path.join("resimulate"))?;
        let rows = resimulate::run(self.context, &self.set()?, (&before, &after), &folder)?;
        let value = json!({ "cycle": self.state.cycle, "gaits": rows });
        self.context
            .out
            .result("rb.hybrid_cycle/1", value, || resimulate::text(&rows));
        Ok(())
    }

    /// Command, output folder, and what all of them take.
    fn words(&self, command: &[&str], output: &str) -> Vec<OsString> {
        let folder = self.cycle_path().join(output);
        let mut words: Vec<OsString> = vec!["rb-host".into()];
        words.extend(command.iter().map(OsString::from));
        words.extend(["-o".into(), folder.clone().into()]);
        if folder.join("checkpoint.json").exists() {
            words.push("--resume".into());
        }
        if let Some(threads) = self.threads {
            words.extend(["-j".into(), threads.to_string().into()]);
        }
        words
    }

    /// A step that is a command of its own: shown, so that a user can repeat it, and run in this process.
    fn command(&self, words: Vec<OsString>) -> Outcome {
        let shown: Vec<String> = words
            .iter()
            .map(|word| word.to_string_lossy().into_owned())
            .collect();
        self.context.out.detail(shown.join(" "));
        let cli =
            Cli::try_parse_from(words).map_err(|e| Failure::say(Exit::Usage, e.to_string()))?;
        cli.command.run(self.context)
    }

    fn port(&self) -> Outcome<PortUri> {
        let port = &self.state.port;
        if port.is_empty() {
            let scenario = self.path.join(ROBOT).join("scenario.toml");
            return Ok(PortUri::Sim(Some(scenario)));
        }
        port.parse()
            .map_err(|e| Failure::new(Exit::Usage, anyhow::Error::new(e)))
    }

    fn store(&self) -> Outcome {
        let text = serde_json::to_string_pretty(&self.state).map_err(anyhow::Error::from)?;
        self.folder.write(STATE, (text + "\n").as_bytes())
    }

    fn store_times(&self) -> Outcome {
        let text = serde_json::to_string_pretty(&self.times).map_err(anyhow::Error::from)?;
        self.folder.write(TIMES, (text + "\n").as_bytes())
    }

    /// The time account of what is done, and the page.
    fn report(&self) -> Outcome {
        let account = Account::new(&self.times, &self.settings);
        let text = account.text();
        self.folder.write("account.txt", text.as_bytes())?;
        let value = json!({
            "folder": self.path, "cycle": self.state.cycle, "step": self.state.step, "times": self.times,
            "account": account.json(),
        });
        self.folder
            .write("account.json", format!("{:#}\n", account.json()).as_bytes())?;
        self.folder.write("account.svg", account.svg().as_bytes())?;
        let page = page::html(&self.path, self.state.cycle, &account)?;
        self.folder.write("report.html", page.as_bytes())?;
        let next = match self.state.step {
            Step::Done => String::new(),
            step => format!("next: {}, with --resume\n", step.name()),
        };
        self.context.out.result("rb.hybrid/1", value, || {
            format!("{text}{next}{}", self.folder.join("report.html").display())
        });
        Ok(())
    }
}
