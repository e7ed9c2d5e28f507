//! Shared helpers of the system tests.

use std::path::{Path, PathBuf};

/// The workspace root.
#[must_use]
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap_or_else(|| Path::new("."))
        .to_path_buf()
}

/// Cargo's target folder: `CARGO_TARGET_DIR` where set, else `target` in the root.
#[must_use]
pub fn target_dir() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}

/// Say aloud that a test could not run; on a CI machine (`CI=true`) that is a failure.
///
/// # Panics
/// When `CI` is `true`.
pub fn skip(test: &str, reason: &str) {
    println!("SKIPPED {test}: {reason}");
    eprintln!("SKIPPED {test}: {reason}");
    assert!(
        std::env::var("CI").as_deref() != Ok("true"),
        "{test} may not be skipped in CI: {reason}"
    );
}

/// Python with the clients of `tests/foreign/requirements.txt`, set up under `target/venv` when it is not there yet.
///
/// # Errors
/// Why it cannot be had.
pub fn python_clients() -> Result<PathBuf, String> {
    let requirements = root().join("tests/foreign/requirements.txt");
    let wanted = std::fs::read_to_string(&requirements).map_err(|e| e.to_string())?;
    let venv = target_dir().join("venv");
    let (python, stamp) = (venv.join("bin/python"), venv.join("requirements.installed"));
    if std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == wanted) {
        return Ok(python);
    }
    let run = |program: &Path, arguments: &[&str]| {
        let output = std::process::Command::new(program).args(arguments).output();
        let output = output.map_err(|e| format!("{}: {e}", program.display()))?;
        let complaint = String::from_utf8_lossy(&output.stderr).into_owned();
        if output.status.success() {
            Ok(())
        } else {
            Err(complaint)
        }
    };
    let (venv_text, file) = (venv.to_string_lossy(), requirements.to_string_lossy());
    run(Path::new("python3"), &["-m", "venv", &venv_text])?;
    run(
        &python,
        &[
            "-m",
            "pip",
            "install",
            "-q",
            "--disable-pip-version-check",
            "-r",
            &file,
        ],
    )?;
    std::fs::write(&stamp, wanted).map_err(|e| e.to_string())?;
    Ok(python)
}
