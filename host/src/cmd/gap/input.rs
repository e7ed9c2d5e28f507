//! Reads a data set folder.

use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use files::dataset::{Manifest, Recording};
use gap::report::Subject;
use sha2::{Digest, Sha256};

use crate::context::Context;
use crate::data_folder::DataFolder;
use crate::failure::{Exit, Failure, Outcome};
use crate::recording;

/// A data set in memory.
pub(super) struct Input {
    pub(super) manifest: Manifest,
    pub(super) recordings: Vec<Recording>,
    pub(super) sha256: String,
    /// What the reader left out or assumed.
    pub(super) warnings: Vec<String>,
    /// What a report says of the data set on top.
    pub(super) subject: Subject,
}

/// The day of `time` in UTC, as `2026-11-25`.
fn day(time: SystemTime) -> Option<String> {
    let since = time.duration_since(UNIX_EPOCH).ok()?;
    // Days since 0000-03-01: years then end with February, and eras of 400 years have 146 097 days.
    let days = since.as_secs() / 86_400 + 719_468;
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year = (of_era - of_era / 1_460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let march = (5 * of_year + 2) / 153;
    let day = of_year - (153 * march + 2) / 5 + 1;
    let month = if march < 10 { march + 3 } else { march - 9 };
    let year = 400 * era + year + u64::from(month <= 2);
    Some(format!("{year:04}-{month:02}-{day:02}"))
}

/// The data set at `path` for the head of a report. A set without a name of its own has that of its folder; the day is
/// that of the newest file of a run.
fn subject(path: &Path, manifest: &Manifest) -> Subject {
    let folder = DataFolder::of(path).ok();
    let written = |file: &str| {
        let name = file.split('#').next().unwrap_or(file);
        folder.as_ref()?.modified(name)
    };
    let newest = manifest.runs.iter().filter_map(|r| written(&r.file)).max();
    let mut subject = Subject::new(manifest, newest.and_then(day));
    let nameless = ["unnamed", "recordings"].contains(&subject.name.as_str());
    let own = path.canonicalize().ok();
    if let Some(name) = own
        .as_deref()
        .and_then(Path::file_name)
        .filter(|_| nameless)
    {
        subject.name = name.to_string_lossy().into_owned();
    }
    subject
}

/// Hexadecimal SHA-256.
pub(super) fn hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes)
        .iter()
        .map(|b| format!("{b:02x}"))
        .collect()
}

/// Reads manifest and runs, CSV or MCAP; warnings go to the user, each once.
pub(super) fn read(path: &Path, context: &Context) -> Outcome<Input> {
    let loaded =
        recording::load(path).map_err(|e| Failure::new(Exit::BadFile, anyhow::Error::new(e)))?;
    let mut warnings: Vec<String> = Vec::new();
    for warning in loaded.warnings.iter().map(ToString::to_string) {
        if !warnings.contains(&warning) {
            context.out.warn(&warning);
            warnings.push(warning);
        }
    }
    Ok(Input {
        subject: subject(path, &loaded.manifest),
        manifest: loaded.manifest,
        recordings: loaded.recordings,
        sha256: hex(&loaded.bytes),
        warnings,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn days_follow_the_calendar() {
        for (seconds, text) in [
            (0, "1970-01-01"),
            (951_782_400, "2000-02-29"),
            (951_868_800, "2000-03-01"),
            (1_798_761_599, "2026-12-31"),
            (4_107_542_400, "2100-03-01"),
        ] {
            let time = UNIX_EPOCH + Duration::from_secs(seconds);
            assert_eq!(day(time).as_deref(), Some(text));
        }
    }
}
