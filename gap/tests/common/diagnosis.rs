//! The diagnosis of a joint by what ships.

use files::dataset::{Manifest, Recording};
use gap::bench::{Diagnosis, Settings, diagnose};
use gap::decide::Calibration;
use gap::watch::Watch;

/// The diagnosis of a joint by the shipped calibration.
pub(crate) fn diagnosed(manifest: &Manifest, recordings: &[Recording]) -> Diagnosis {
    let calibration = Calibration::shipped_joint();
    let settings = Settings::default();
    diagnose(manifest, recordings, &settings, &calibration, Watch::NOBODY).expect("positions")
}
