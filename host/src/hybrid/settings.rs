//! `hybrid.toml`: how much of everything; absent values are the paper's.

use std::path::Path;

use optimise::meta::{PAPER_ITERATIONS, PAPER_PARTICLES};
use optimise::settings::SearchSettings;
use serde::{Deserialize, Serialize};

use crate::disk;
use crate::failure::{Exit, Failure, Outcome};

/// Settings of a hybrid cycle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HybridSettings {
    /// File format, 1.
    pub format: u32,
    /// Runs of each gait on the robot; the paper's 3. At least 2, or repeatability has no meaning.
    pub repeats: u32,
    /// Whether the recorded data set is diagnosed too (`gap report`) before the match.
    pub diagnose: bool,
    /// The search for gaits, as in `optimise.toml`.
    pub search: SearchSettings,
    /// The match of the model.
    #[serde(rename = "match")]
    pub matching: MatchSettings,
}

/// Settings of the meta-optimisation.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MatchSettings {
    /// Particles; the paper's 100.
    pub particles: usize,
    /// Iterations; the paper's 100.
    pub iterations: u32,
    /// Rows of Table II that are fitted.
    pub rows: String,
    /// The search looks at every so many frames.
    pub stride: u32,
    /// Seed.
    pub seed: u64,
}

impl Default for MatchSettings {
    fn default() -> Self {
        Self {
            particles: PAPER_PARTICLES,
            iterations: PAPER_ITERATIONS,
            rows: "1-22".to_owned(),
            stride: 10,
            seed: 1,
        }
    }
}

impl Default for HybridSettings {
    fn default() -> Self {
        Self {
            format: 1,
            repeats: 3,
            diagnose: false,
            search: SearchSettings::default(),
            matching: MatchSettings::default(),
        }
    }
}

impl HybridSettings {
    /// Reads a file; `None` = the paper's.
    ///
    /// # Errors
    /// Exit code 3 with file, key and range.
    pub fn load(path: Option<&Path>) -> Outcome<Self> {
        let Some(path) = path else {
            return Ok(Self::default());
        };
        let shown = path.display();
        let bad = |why: String| Failure::say(Exit::BadFile, format!("{shown}: {why}"));
        let text = disk::read_text(path, disk::MAX_TEXT).map_err(|e| bad(e.to_string()))?;
        let settings: Self =
            toml::from_str(&text).map_err(|e| disk::toml_error(path, &text, &e))?;
        settings
            .search
            .check()
            .map_err(|e| bad(format!("search: {e}")))?;
        let matching = &settings.matching;
        for (key, value, min, max) in [
            ("format", u64::from(settings.format), 1, 1),
            ("repeats", u64::from(settings.repeats), 2, 100),
            ("match.particles", matching.particles as u64, 2, 100_000),
            ("match.iterations", matching.iterations.into(), 1, 100_000),
            ("match.stride", matching.stride.into(), 1, 10_000),
        ] {
            if !(min..=max).contains(&value) {
                return Err(bad(format!(
                    "{key} is {value}; it must lie in [{min}, {max}]"
                )));
            }
        }
        Ok(settings)
    }

    /// Runs on the robot in one cycle, if the search finds all the gaits it should.
    #[must_use]
    pub fn experiments(&self) -> u64 {
        self.search.select.count as u64 * u64::from(self.repeats)
    }
}
