//! A data set folder that grows run by run: what `run --dataset`, `rec film` and the hybrid cycle write.
//!
//! ```text
//! dataset.toml    model.toml    gaits/NAME.toml
//! RUN.csv         RUN/index.csv, 00000.png, ..., sync.json      recordings/RUN.mcap
//! ```
//! A run is in the set when `dataset.toml` names it; everything else of it is written before that, so an interrupted
//! recording leaves nothing but files that the next try writes anew.

use std::path::{Path, PathBuf};

use control::gait::Gait;
use files::dataset::{Manifest, Role};
use optimise::meta::FilmSettings;

use super::beside::{Laid, LayError, Seen, alignment_json, lay};
use super::{csv, reader};
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::searching::films;

/// The folder.
#[derive(Debug, Clone)]
pub struct SetFolder {
    path: PathBuf,
}

/// Names that the folder itself uses.
const MANIFEST: &str = "dataset.toml";
/// See [`MANIFEST`].
const MODEL: &str = "model.toml";
/// See [`MANIFEST`].
const GAITS: &str = "gaits";
/// See [`MANIFEST`].
const RECORDINGS: &str = "recordings";

impl SetFolder {
    /// Opens the folder; a new one is begun with this name, model text and `[camera]` table (empty = none known).
    ///
    /// # Errors
    /// Exit code 2 when the folder holds something else, 1 when the disk refuses.
    pub fn open(path: &Path, name: &str, model: &str, camera: &str) -> Outcome<Self> {
        let set = Self {
            path: path.to_owned(),
        };
        if set.manifest_path().exists() {
            return Ok(set);
        }
        set.must_be_ours()?;
        disk::make_folder(&path.join(GAITS))?;
        disk::make_folder(&path.join(RECORDINGS))?;
        set.write(MODEL, model.as_bytes())?;
        let name = quoted(name);
        let manifest = format!(
            "format = 1\nrobot = \"metamodule\"\nname = {name}\n\n[metamodule]\nmodel = \"{MODEL}\"\n{camera}"
        );
        // Without a run it is no data set yet, so it is kept aside until the first one is added.
        set.write(&format!("{RECORDINGS}/{MANIFEST}"), manifest.as_bytes())?;
        Ok(set)
    }

    /// A folder that was begun here may hold whatever a first recording leaves that was cut off at any instant.
    fn must_be_ours(&self) -> Outcome {
        if self.path.join(RECORDINGS).join(MANIFEST).exists() {
            return Ok(());
        }
        let own = |name: &std::ffi::OsStr| {
            let name = name.to_string_lossy();
            let name = name.strip_suffix(".new").unwrap_or(&name);
            [MODEL, GAITS, RECORDINGS].contains(&name)
        };
        let mut entries = std::fs::read_dir(&self.path)
            .into_iter()
            .flatten()
            .flatten();
        let Some(foreign) = entries.find(|entry| !own(&entry.file_name())) else {
            return Ok(());
        };
        let (path, foreign) = (self.path.display(), foreign.file_name());
        let message = format!("{path} holds {} and no {MANIFEST}", foreign.display());
        Err(Failure::say(Exit::Usage, message)
            .hint("name a new folder, or one that holds a data set"))
    }

    /// The folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn manifest_path(&self) -> PathBuf {
        self.path.join(MANIFEST)
    }

    /// Text of `dataset.toml`, or of its beginning before the first run.
    fn manifest_text(&self) -> Outcome<String> {
        let path = self.manifest_path();
        let path = if path.exists() {
            path
        } else {
            self.path.join(RECORDINGS).join(MANIFEST)
        };
        disk::read_regular_text(&path, disk::MAX_TEXT)
            .map_err(|e| Failure::say(Exit::BadFile, format!("{}: {e}", path.display())))
    }

    /// Names of the runs in the set.
    ///
    /// # Errors
    /// Exit code 3 for a damaged `dataset.toml`.
    pub fn runs(&self) -> Outcome<Vec<String>> {
        if !self.manifest_path().exists() {
            return Ok(Vec::new());
        }
        let runs = self.manifest()?.runs;
        Ok(runs
            .into_iter()
            .map(|run| run.file.trim_end_matches(".csv").to_owned())
            .collect())
    }

    /// `dataset.toml`, parsed.
    ///
    /// # Errors
    /// Exit code 3 when it is missing or damaged.
    pub fn manifest(&self) -> Outcome<Manifest> {
        let shown = self.manifest_path().display().to_string();
        let (manifest, _) = Manifest::parse(&shown, &self.manifest_text()?)
            .map_err(|e| Failure::new(Exit::BadFile, e))?;
        Ok(manifest)
    }

    /// The camera of the set as far as it is known, else a Kinect over the origin.
    ///
    /// # Errors
    /// Exit code 3 for a damaged `dataset.toml`.
    pub fn camera(&self) -> Outcome<FilmSettings> {
        // Before its first run the manifest lacks one.
        let text = self.manifest_text()? + "\n[[run]]\nfile = \"-\"\n";
        let (manifest, _) =
            Manifest::parse(MANIFEST, &text).map_err(|e| Failure::new(Exit::BadFile, e))?;
        Ok(films::settings_of(manifest.camera.as_ref(), 1))
    }

    /// Where the recording of a run stands.
    #[must_use]
    pub fn recording_path(&self, run: &str) -> PathBuf {
        self.path.join(RECORDINGS).join(format!("{run}.mcap"))
    }

    /// Adds the run that [`Self::recording_path`] holds, with what was seen of it.
    ///
    /// # Errors
    /// Exit code 3 when what was seen does not fit the recording, 1 when the disk refuses.
    pub fn add(
        &self,
        run: &str,
        gait: &Gait,
        role: Option<Role>,
        seen: Option<Seen>,
    ) -> Outcome<Option<Laid>> {
        let laid = self.write_run(run, seen)?;
        let name = gait.name();
        self.write(
            &format!("{GAITS}/{name}.toml"),
            files::gait::to_toml(gait).as_bytes(),
        )?;
        let mut manifest = self.manifest_text()?;
        manifest.push_str(&format!(
            "\n[[run]]\nfile = \"{run}.csv\"\ngait = {}\n",
            quoted(name)
        ));
        match role {
            Some(Role::Fit) => manifest.push_str("role = \"fit\"\n"),
            Some(Role::Check) => manifest.push_str("role = \"check\"\n"),
            None => {}
        }
        if laid
            .as_ref()
            .is_some_and(|laid| !laid.film.frames.is_empty())
        {
            manifest.push_str(&format!("frames = \"{run}\"\n"));
        }
        self.write(MANIFEST, manifest.as_bytes())?;
        Ok(laid)
    }

    /// Adds what was seen to a run that is in the set already.
    ///
    /// # Errors
    /// Exit code 2 when the set has no such run, 3 when what was seen does not fit it.
    pub fn add_film(&self, run: &str, seen: Seen) -> Outcome<Laid> {
        if !self.runs()?.iter().any(|known| known == run) {
            let message = format!("{} has no run {run}", self.manifest_path().display());
            let known = self.runs()?.join(", ");
            return Err(Failure::say(Exit::Usage, message).hint(format!("its runs: {known}")));
        }
        let laid = self
            .write_run(run, Some(seen))?
            .ok_or_else(|| Failure::say(Exit::BadFile, "no film"))?;
        let entry = format!("file = \"{run}.csv\"\n");
        let frames = format!("frames = \"{run}\"\n");
        let text = self.manifest_text()?;
        if !text.contains(&frames) {
            let text = text.replacen(&entry, &format!("{entry}{frames}"), 1);
            self.write(MANIFEST, text.as_bytes())?;
        }
        Ok(laid)
    }

    /// Takes all runs of a gait out of the set; their recordings stay.
    ///
    /// # Errors
    /// Exit code 1 when the disk refuses.
    pub fn remove_gait(&self, gait: &str) -> Outcome {
        const RUN: &str = "\n[[run]]\n";
        if !self.manifest_path().exists() {
            return Ok(());
        }
        let text = self.manifest_text()?;
        let mut blocks = text.split(RUN);
        let mut kept = blocks.next().unwrap_or_default().to_owned();
        let line = format!("gait = {}", quoted(gait));
        let mut runs = 0;
        for block in blocks {
            if block.lines().any(|l| l == line) {
                continue;
            }
            runs += 1;
            kept.push_str(RUN);
            kept.push_str(block);
        }
        if runs == 0 {
            // Without a run it is no data set: back to its beginning.
            let path = self.manifest_path();
            return std::fs::remove_file(&path).map_err(|error| {
                let message = format!("cannot remove {}: {error}", path.display());
                Failure::say(Exit::Other, message)
            });
        }
        self.write(MANIFEST, kept.as_bytes())
    }

    /// CSV and film of a run from its recording and what was seen.
    fn write_run(&self, run: &str, seen: Option<Seen>) -> Outcome<Option<Laid>> {
        let path = self.recording_path(run);
        let recording = reader::read(&path).map_err(|e| Failure::new(Exit::BadFile, e))?;
        let data = recording
            .runs
            .iter()
            .find(|run| !run.samples.is_empty())
            .ok_or_else(|| {
                let message = format!("{} holds no samples", path.display());
                Failure::say(Exit::BadFile, message)
            })?;
        let laid = seen
            .map(|seen| lay(seen, data).map_err(|e| misfit(run, e)))
            .transpose()?;
        let (base, imu) = laid
            .as_ref()
            .map_or((&[][..], &[][..]), |laid| (&laid.base, &laid.imu));
        if let Some(laid) = laid.as_ref().filter(|laid| !laid.film.frames.is_empty()) {
            let folder = self.path.join(run);
            disk::remove_folder(&folder)?;
            laid.film.write(&folder)?;
            if let Some(alignment) = &laid.alignment {
                let text = format!("{:#}\n", alignment_json(alignment));
                disk::write(&folder.join("sync.json"), text.as_bytes())?;
            }
        }
        let text = csv::to_csv_beside(data, base, imu);
        self.write(&format!("{run}.csv"), text.as_bytes())?;
        Ok(laid)
    }

    /// Writes a file in one step.
    fn write(&self, name: &str, bytes: &[u8]) -> Outcome {
        disk::write(&self.path.join(name), bytes)
    }
}

fn misfit(run: &str, error: LayError) -> Failure {
    Failure::say(Exit::BadFile, format!("film of run {run}: {error}"))
}

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}
