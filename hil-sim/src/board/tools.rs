//! What a test or a command needs before it can run a board: QEMU, the image, the plugin.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

use thiserror::Error;

use super::runner::BoardConfig;

/// Oldest QEMU whose USARTs, plugin API and object layouts this was written for.
const QEMU_MAJOR: u32 = 10;

/// The chip's instruction set.
const TARGET: &str = "thumbv7em-none-eabihf";

/// Why a board cannot be run on this machine. The text says what to do.
#[derive(Debug, Error, PartialEq, Eq)]
pub enum Unavailable {
    /// No such program.
    #[error(
        "qemu-system-arm is not installed (Debian 12: package qemu-system-arm from bookworm-backports)"
    )]
    NoQemu,
    /// Too old, or newer than what was tried.
    #[error("qemu-system-arm is version {found}, version 10 is needed")]
    WrongQemu {
        /// What it says of itself.
        found: String,
    },
    /// The compiler has no library for the chip.
    #[error("the compiler cannot build for the chip: `rustup target add {TARGET}`")]
    NoTarget,
    /// A build failed; cargo's own message stands above.
    #[error("cannot build {what}; run `{command}` to see why")]
    Build {
        /// Which of the two.
        what: &'static str,
        /// The command that failed.
        command: String,
    },
}

/// Image and plugin, built.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Built {
    /// `qemu-system-arm`.
    pub qemu: PathBuf,
    /// The firmware image.
    pub elf: PathBuf,
    /// The plugin.
    pub plugin: PathBuf,
}

/// Finds a usable QEMU on the path.
///
/// # Errors
/// [`Unavailable::NoQemu`], [`Unavailable::WrongQemu`].
pub fn find_qemu() -> Result<PathBuf, Unavailable> {
    let program = PathBuf::from("qemu-system-arm");
    let output = Command::new(&program)
        .arg("--version")
        .output()
        .map_err(|_| Unavailable::NoQemu)?;
    let text = String::from_utf8_lossy(&output.stdout);
    let version = text.split_whitespace().nth(3).unwrap_or("unknown");
    match version
        .split('.')
        .next()
        .and_then(|major| major.parse::<u32>().ok())
    {
        Some(QEMU_MAJOR) => Ok(program),
        _ => Err(Unavailable::WrongQemu {
            found: version.to_owned(),
        }),
    }
}

fn find_target(root: &Path) -> Result<(), Unavailable> {
    let output = Command::new("rustc")
        .args(["--print", "target-libdir", "--target", TARGET])
        .current_dir(root)
        .output();
    let folder = output.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned());
    match folder {
        Ok(folder) if Path::new(&folder).is_dir() => Ok(()),
        _ => Err(Unavailable::NoTarget),
    }
}

fn cargo(root: &Path, what: &'static str, arguments: &[&str]) -> Result<(), Unavailable> {
    let program = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    // The alias and DEFMT_LOG stand in `.cargo/config.toml`, which cargo finds by working directory.
    let status = Command::new(program)
        .args(arguments)
        .current_dir(root)
        .env_remove("RUSTFLAGS")
        .env_remove("CARGO_ENCODED_RUSTFLAGS")
        .status();
    if status.is_ok_and(|s| s.success()) {
        return Ok(());
    }
    Err(Unavailable::Build {
        what,
        command: format!("cargo {}", arguments.join(" ")),
    })
}

/// Builds image and plugin into `target/board` of the workspace at `root`, apart from the build that may be running.
///
/// # Errors
/// All of [`Unavailable`].
pub fn build(root: &Path) -> Result<Built, Unavailable> {
    let qemu = find_qemu()?;
    find_target(root)?;
    let target = "target/board";
    cargo(
        root,
        "the firmware image",
        &["fw", "--quiet", "--target-dir", target],
    )?;
    cargo(
        root,
        "the QEMU plugin",
        &[
            "build",
            "--quiet",
            "--package",
            "qemu-shim",
            "--release",
            "--target-dir",
            target,
        ],
    )?;
    let target = root.join(target);
    Ok(Built {
        qemu,
        elf: target.join("thumbv7em-none-eabihf/firmware/firmware"),
        plugin: target.join("release/libqemu_shim.so"),
    })
}

/// For tests: image, plugin and QEMU, built once per process, or `None` after saying aloud that and why `test` is
/// skipped.
///
/// # Panics
/// When image or plugin do not build. With `CI=true` in the environment nothing may be skipped.
#[must_use]
pub fn built_or_skip(root: &Path, test: &str) -> Option<Built> {
    static BUILT: OnceLock<Result<Built, Unavailable>> = OnceLock::new();
    static SKIPPED: AtomicU32 = AtomicU32::new(0);
    match BUILT.get_or_init(|| build(root)) {
        Ok(built) => Some(built.clone()),
        Err(why @ Unavailable::Build { .. }) => panic!("{test}: {why}"),
        Err(why) => {
            let ci = std::env::var("CI").is_ok_and(|value| value == "true");
            assert!(!ci, "{test} cannot be skipped in CI: {why}");
            let count = SKIPPED.fetch_add(1, Ordering::Relaxed) + 1;
            eprintln!("SKIPPED {test}: {why} ({count} skipped so far)");
            None
        }
    }
}

impl Built {
    /// A configuration with these files, nothing counted, no log.
    #[must_use]
    pub fn config(&self) -> BoardConfig {
        BoardConfig {
            qemu: self.qemu.clone(),
            elf: self.elf.clone(),
            plugin: self.plugin.clone(),
            seed: 1,
            rng_fault: None,
            regions: Vec::new(),
            profile: Vec::new(),
            stack: None,
            log: None,
        }
    }
}
