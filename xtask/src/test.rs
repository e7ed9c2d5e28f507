//! `cargo xtask test`: every check, in the order in which a failure is cheapest to learn about.

use crate::{images, setup, sh};
use anyhow::{Result, bail};
use std::path::Path;
use std::time::Instant;

type Step = (&'static str, fn() -> Result<()>);

const STEPS: &[Step] = &[
    ("format", || sh::run("cargo", &["fmt", "--all", "--check"])),
    ("lints", lints),
    ("host tool for Windows and macOS", crate::cross::run),
    ("lints of the firmware images", images::lints),
    ("firmware images", images::all),
    ("panic-free gate", panic_free_gate),
    ("instructions of the law", crate::tick::check),
    (
        "licences and known faults of dependencies",
        crate::audit::run,
    ),
    ("web site of the pages", crate::site::run),
    ("QEMU plug-in", plugin),
    ("compilation of the tests", || tests(&["--no-run"])),
    ("tests", || tests(&["--no-fail-fast"])),
    (
        "commands of the figures, in short form",
        crate::figures::short,
    ),
];

/// What takes hours and writes pages: how much the tests find, and every figure, 60 s of each fuzz target among them.
const LONG: &[Step] = &[
    ("planted faults", || crate::planted::run(&[])),
    ("a sample of mutants", || crate::mutants::run(&[])),
    ("figures", || crate::figures::run("")),
];

/// Set up, then run all steps; every failure is collected before the exit, and how long each step took is said.
pub(crate) fn run(arguments: &[String]) -> Result<()> {
    let steps = match arguments {
        [] => STEPS.to_vec(),
        [long] if long == "--long" => [STEPS, LONG].concat(),
        other => bail!("no option `{}`; there is --long", other.join(" ")),
    };
    setup::run()?.print();
    let mut failed = Vec::new();
    let mut took = Vec::new();
    for (name, step) in &steps {
        eprintln!("\n== {name}");
        let start = Instant::now();
        if let Err(error) = step() {
            eprintln!("FAILED {name}: {error:#}");
            failed.push(*name);
        }
        took.push((*name, start.elapsed().as_secs()));
    }
    eprintln!("\nWall time:");
    for (name, seconds) in took {
        eprintln!("{:5} min {:02} s  {name}", seconds / 60, seconds % 60);
    }
    if !failed.is_empty() {
        bail!("failed: {}", failed.join(", "));
    }
    eprintln!("\nAll {} steps passed.", steps.len());
    Ok(())
}

fn lints() -> Result<()> {
    sh::run(
        "cargo",
        &[
            "clippy",
            "--workspace",
            "--all-targets",
            "--",
            "-D",
            "warnings",
        ],
    )
}

/// All tests; with the search over MPI processes where this machine can build and start them. One build serves both: with its own
/// features it would compile nearly every crate a second time.
fn tests(how: &[&str]) -> Result<()> {
    let answers = |program| sh::output(program, &["--version"]).is_ok();
    let mut words = vec!["test", "--workspace"];
    words.extend(how);
    if answers("mpirun") && answers("mpicc") && libclang() {
        words.extend(["--features", "host/mpi"]);
    } else {
        eprintln!(
            "SKIPPED  search over MPI processes: needs OpenMPI and libclang \
             (Debian: openmpi-bin libopenmpi-dev libclang-dev)"
        );
    }
    sh::run("cargo", &words)
}

/// Whether bindgen will find libclang: where its variable points, or in the library folders of Debian.
fn libclang() -> bool {
    let holds = |folder: &Path| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let mut names = entries.map(|e| e.file_name().to_string_lossy().into_owned());
        names.any(|name| name.starts_with("libclang") && name.contains(".so"))
    };
    let below = |folder: &str, sub: &str| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.map(|e| e.path().join(sub)).any(|path| holds(&path))
    };
    std::env::var_os("LIBCLANG_PATH").is_some() || below("/usr/lib", "lib") || below("/usr/lib", "")
}

fn plugin() -> Result<()> {
    let folder = ["--target-dir", "target/board"];
    sh::run(
        "cargo",
        &[&["build", "-p", "qemu-shim", "--release"][..], &folder].concat(),
    )
}

/// A reachable panic in `control` or `protocol` leaves an undefined symbol, so the link fails.
pub(crate) fn panic_free_gate() -> Result<()> {
    setup::rust_target()?;
    let target_dir = sh::target_dir().join("panic-free");
    let target_dir = target_dir.to_string_lossy();
    let build = [
        "build",
        "--release",
        "--manifest-path",
        "tests/panic-free/Cargo.toml",
        "--target",
        "thumbv7em-none-eabihf",
        "--target-dir",
        &target_dir,
    ];
    sh::run("cargo", &build)?;
    // The gate must bite: with one reachable panic added, the link has to fail on that symbol.
    let bite = [&build[..], &["--features", "bite"]].concat();
    let refused = sh::command("cargo", &bite).output()?;
    let said = String::from_utf8_lossy(&refused.stderr);
    if refused.status.success() || !said.contains("undefined symbol: a_panic_is_reachable") {
        bail!(
            "the panic-free gate accepted a reachable panic, or failed for another reason:\n{said}"
        );
    }
    Ok(())
}
