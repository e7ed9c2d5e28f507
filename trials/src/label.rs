//! What was planted: one format for the generators here and in `trials/foreign`.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};

/// Where a cause sits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scope {
    /// All joints.
    All,
    /// The joints of one kind of motor.
    Kind,
    /// The joints of one module.
    Module,
    /// One joint.
    Joint,
    /// The robot, once.
    Robot,
}

/// A number of a cause: one for all its joints, and each joint's own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// The number drawn, or a list, or a name.
    pub value: Value,
    /// Number by joint, where the cause has joints.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub by_joint: BTreeMap<String, f64>,
}

/// One planted cause.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cause {
    /// Name of the vocabulary, or one that no vocabulary holds.
    pub effect: String,
    /// Its stage.
    pub stage: String,
    /// Where it sits.
    pub scope: Scope,
    /// Its joints; none for a cause of the robot.
    pub joints: BTreeSet<usize>,
    /// Numbers by their keys.
    pub values: BTreeMap<String, Truth>,
    /// Names that are right too.
    #[serde(default)]
    pub also: Vec<String>,
    /// The word people have for it and its companion, as `worn_gear`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compound: Option<String>,
    /// Relative spread between its joints.
    #[serde(default)]
    pub spread: f64,
    /// Whether a convention holds for readings too.
    #[serde(default)]
    pub readings_too: bool,
    /// By how many tolerances a nominal number is off.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigmas: Option<f64>,
    /// What it adds to chi-square in the recorded columns.
    #[serde(default)]
    pub delta_chi2: f64,
    /// What stays of that once the nominal numbers are fitted within their tolerances.
    #[serde(default)]
    pub delta_chi2_refitted: f64,
    /// What stays beside the best of its rivals too, of any size; `None` where no rival was tried.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delta_chi2_rival: Option<f64>,
}

/// A nominal number within so many tolerances is no cause.
const NOMINAL_SIGMAS: f64 = 3.0;
/// Three standard deviations tell a cause from its nearest rival.
const RIVAL_CHI2: f64 = 9.0;

impl Cause {
    /// Whether a diagnosis could name it: enough chi-square beyond nominal numbers, no nominal number within its
    /// tolerances, and no rival that does as well.
    #[must_use]
    pub fn identifiable(&self, least: f64) -> bool {
        self.delta_chi2_refitted >= least
            && self.sigmas.is_none_or(|s| s >= NOMINAL_SIGMAS)
            && self.delta_chi2_rival.is_none_or(|x| x >= RIVAL_CHI2)
    }
}

/// Label of one data set folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Label {
    /// Name of the folder.
    pub name: String,
    /// What played reality: `emulator`, `mujoco`, `ode`, `rapier`.
    pub engine: String,
    /// `null`, `single`, `several`, `outside`.
    pub kind: String,
    /// What was planted.
    pub causes: Vec<Cause>,
    /// What else a generator says of the case.
    #[serde(flatten)]
    pub more: BTreeMap<String, Value>,
}

impl Label {
    /// Whether every cause is.
    #[must_use]
    pub fn identifiable(&self, least: f64) -> bool {
        !self.causes.is_empty() && self.causes.iter().all(|c| c.identifiable(least))
    }
}

/// The labels of a suite.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Labels {
    /// Format of the file.
    pub format: u32,
    /// One a case.
    pub cases: Vec<Label>,
}

/// Hexadecimal SHA-256.
#[must_use]
pub fn sha256(bytes: &[u8]) -> String {
    let digest = Sha256::digest(bytes);
    digest.iter().map(|b| format!("{b:02x}")).collect()
}

/// Where the hash of a label file stands.
fn seal_of(path: &Path) -> std::path::PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".sha256");
    name.into()
}

/// Writes labels and their hash.
///
/// # Errors
/// Files that cannot be written; other labels that were sealed there before.
pub fn seal(path: &Path, labels: &Labels) -> Result<String> {
    let text = serde_json::to_string_pretty(labels)? + "\n";
    let hash = sha256(text.as_bytes());
    let sealed = seal_of(path);
    if let Ok(before) = fs::read_to_string(&sealed)
        && before.trim() != hash
    {
        bail!(
            "{} holds the hash of other labels; begin again in a new folder",
            sealed.display()
        );
    }
    fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?;
    fs::write(&sealed, format!("{hash}\n"))
        .with_context(|| format!("cannot write {}", sealed.display()))?;
    Ok(hash)
}

/// Reads sealed labels: their hash is that of the file beside them.
///
/// # Errors
/// Files that cannot be read; labels that changed after they were sealed.
pub fn open(path: &Path) -> Result<(Labels, String)> {
    let read = |p: &Path| fs::read(p).with_context(|| format!("cannot read {}", p.display()));
    let bytes = read(path)?;
    let hash = sha256(&bytes);
    let sealed = seal_of(path);
    if String::from_utf8_lossy(&read(&sealed)?).trim() != hash {
        bail!(
            "{} is not what {} sealed; make the suite again",
            path.display(),
            sealed.display()
        );
    }
    let labels = serde_json::from_slice(&bytes)
        .with_context(|| format!("{} holds no labels", path.display()))?;
    Ok((labels, hash))
}
