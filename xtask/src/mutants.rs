//! `cargo xtask mutants`: a sample of the mutants of `cargo-mutants`, crate by crate, and how many the tests kill.
//!
//! The sample is systematic: of all mutants of a crate, in the order of the source, every N-th from the SHARD-th on. So it is the same everywhere, and N
//! shards are the whole.

use crate::{planted, sh};
use anyhow::{Context, Result, bail};
use std::path::Path;
use std::process::{Command, Stdio};

/// Mutants that the same tests judge.
struct Judged {
    /// Name of the row.
    name: &'static str,
    /// Crate.
    package: &'static str,
    /// Options of `cargo mutants` that choose files.
    files: &'static [&'static str],
    /// Arguments of `cargo test -p CRATE` that choose the tests.
    tests: &'static [&'static str],
}

const JUDGED: [Judged; 4] = [
    Judged {
        name: "control",
        package: "control",
        files: &[],
        tests: &["--lib", "--test", "control"],
    },
    Judged {
        name: "protocol",
        package: "protocol",
        files: &[],
        tests: &[],
    },
    // The firmware's behaviour is tested from the wires, in `hil-sim`.
    Judged {
        name: "firmware",
        package: "firmware",
        files: &["-e", "firmware/src/stm32/**", "-e", "firmware/src/board/**"],
        tests: &[
            "-p",
            "hil-sim",
            "--lib",
            "--test",
            "robot",
            "--test",
            "slots_power_cut",
        ],
    },
    // What only the chip runs: the tests build its image and start it in QEMU.
    Judged {
        name: "stm32",
        package: "firmware",
        files: &[
            "-f",
            "firmware/src/stm32/**",
            "-f",
            "firmware/src/board/l475.rs",
        ],
        tests: &["-p", "hil-sim", "--test", "board"],
    },
];
/// Shards that the mutants of a crate are dealt into when no other number is given.
const SHARDS: u32 = 100;
/// The page of what was found.
const PAGE: &str = "docs/validation/mutants.md";
/// Tests that take more than so many times what they take without a mutant hang; but not before a minute is over, s.
const PATIENCE: [&str; 2] = ["3", "60"];

/// What came of one row.
struct Outcome {
    name: &'static str,
    all: usize,
    killed: usize,
    unviable: usize,
    survived: Vec<String>,
}

/// `[--shard K/N] [ROW...]`: shard 0 of 100 of every row when nothing is given. The other rows of the page are kept.
pub(crate) fn run(arguments: &[String]) -> Result<()> {
    let (shard, names) = match arguments {
        [flag, shard, names @ ..] if flag == "--shard" => (shard.clone(), names),
        names => (format!("0/{SHARDS}"), names),
    };
    if sh::output("cargo", &["mutants", "--version"]).is_err() {
        bail!("needs `cargo install cargo-mutants`");
    }
    let known = |name: &String| JUDGED.iter().any(|judged| judged.name == name);
    if let Some(unknown) = names.iter().find(|name| !known(name)) {
        bail!("no mutants of `{unknown}`");
    }
    let copy = planted::copy()?;
    let wanted = |name: &str| names.is_empty() || names.iter().any(|n| n == name);
    let path = sh::root().join(PAGE);
    for judged in JUDGED.iter().filter(|judged| wanted(judged.name)) {
        let outcome = mutate(&copy, judged, &shard)?;
        let date = sh::output("date", &["-I"])?;
        let row = row(&outcome, &shard, date.trim());
        println!("{row}");
        let before = std::fs::read_to_string(&path).unwrap_or_default();
        std::fs::write(&path, page(&outcome, &row, &before))?;
    }
    Ok(())
}

fn mutate(copy: &Path, judged: &Judged, shard: &str) -> Result<Outcome> {
    let Judged {
        name,
        package,
        files,
        tests,
    } = *judged;
    let list = [&["mutants", "--list", "-p", package], files].concat();
    let all = sh::output("cargo", &list)?;
    let output = sh::target_dir().join("mutants").join(name);
    std::fs::create_dir_all(&output)?;
    let status = Command::new("cargo")
        .args(["mutants", "--in-place", "-p", package, "--shard", shard])
        .args(files)
        .args(["--sharding", "round-robin", "--no-shuffle"])
        .args(["--timeout-multiplier", PATIENCE[0]])
        .args(["--minimum-test-timeout", PATIENCE[1]])
        .arg("--output")
        .arg(&output)
        .arg("--")
        .args(tests)
        .current_dir(copy)
        .env("CARGO_TARGET_DIR", sh::target_dir().join("planted/build"))
        .env("RUST_BACKTRACE", "0")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .context("cannot start cargo mutants")?;
    // 2: some survived, 3: some hung (cargo-mutants' own list of exit codes).
    if !matches!(status.code(), Some(0 | 2 | 3)) {
        bail!("{name}: {status}; see {}", output.display());
    }
    let list = |file: &str| -> Result<Vec<String>> {
        let path = output.join("mutants.out").join(file);
        let text =
            std::fs::read_to_string(&path).with_context(|| format!("no {}", path.display()))?;
        Ok(text.lines().map(str::to_owned).collect())
    };
    // A mutant that hangs is found as well. One that builds for this machine, but not for the chip, fails in the tests that build the image.
    let chip = not_for_the_chip(&output.join("mutants.out/log"))?;
    Ok(Outcome {
        name,
        all: all.lines().count(),
        killed: list("caught.txt")?.len() + list("timeout.txt")?.len() - chip,
        unviable: list("unviable.txt")?.len() + chip,
        survived: list("missed.txt")?,
    })
}

/// How many of the logs say that a test could not build the image.
fn not_for_the_chip(logs: &Path) -> Result<usize> {
    let mut found = 0;
    for log in std::fs::read_dir(logs)? {
        let text = std::fs::read_to_string(log?.path())?;
        found += usize::from(text.contains("cannot build the firmware image"));
    }
    Ok(found)
}

/// Wilson's interval at 95 %.
fn wilson(hits: usize, of: usize) -> (f64, f64) {
    let (n, z) = (of as f64, 1.96_f64);
    if of == 0 {
        return (0.0, 1.0);
    }
    let p = hits as f64 / n;
    let centre = p + z * z / (2.0 * n);
    let half = z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    let scale = 1.0 + z * z / n;
    ((centre - half) / scale, (centre + half) / scale)
}

fn row(outcome: &Outcome, shard: &str, date: &str) -> String {
    let Outcome {
        name,
        all,
        killed,
        unviable,
        survived,
    } = outcome;
    let tried = killed + survived.len();
    let (low, high) = wilson(*killed, tried);
    let share = *killed as f64 / tried.max(1) as f64;
    format!(
        "| `{name}` | {shard} | {date} | {all} | {tried} | {killed} | {share:.3}; {low:.3} to {high:.3} | {unviable} |"
    )
}

/// The page with a new row and its survivors; all others are taken from the page `before`.
fn page(outcome: &Outcome, new_row: &str, before: &str) -> String {
    let (mut rows, mut survived) = (Vec::new(), Vec::new());
    for Judged { name, .. } in JUDGED {
        let (row, survivor) = (format!("| `{name}` |"), format!("- {name}: "));
        if name == outcome.name {
            rows.push(new_row.to_owned());
            let own = outcome.survived.iter();
            survived.extend(own.map(|mutant| format!("{survivor}`{mutant}`")));
        } else {
            let kept = |begin: String| {
                let lines = before.lines().filter(move |line| line.starts_with(&begin));
                lines.map(str::to_owned)
            };
            rows.extend(kept(row));
            survived.extend(kept(survivor));
        }
    }
    if survived.is_empty() {
        survived.push("None.".to_owned());
    }
    format!(
        "<!-- generated by `cargo xtask mutants` -->\n# Mutants\n\n    cargo xtask mutants --shard K/N ROW\n\n\
         `cargo-mutants` changes one place at a time; the tests must fail. Shard K/N holds every N-th mutant from the K-th on, in the order of the \
         source; `stm32` is what only the chip runs, judged in QEMU. Beside the share stands Wilson's interval at 95 %. Unviable ones do not build.\n\n\
         | row | shard | measured | mutants | tried | killed | share | unviable |\n|---|---|---|---|---|---|---|---|\n{}\n\n\
         ## Survivors\n\n{}\n",
        rows.join("\n"),
        survived.join("\n")
    )
}

#[cfg(test)]
mod tests {
    use super::{Outcome, page, row, wilson};

    /// Against the closed form of Wilson 1927, table of Newcombe 1998: 81 of 263 gives 0.2553 to 0.3662.
    #[test]
    fn the_interval_is_wilsons() {
        let (low, high) = wilson(81, 263);
        assert!((low - 0.2553).abs() < 1e-4 && (high - 0.3662).abs() < 1e-4);
        assert_eq!(wilson(0, 0), (0.0, 1.0));
    }

    fn outcome(name: &'static str, survivor: &str) -> Outcome {
        Outcome {
            name,
            all: 1000,
            killed: 9,
            unviable: 2,
            survived: vec![survivor.to_owned()],
        }
    }

    #[test]
    fn the_page_lists_shares_and_survivors_and_keeps_the_other_crates() {
        let control = outcome("control", "control/src/cpg.rs:1:1: replace + with -");
        let first = page(&control, &row(&control, "0/100", "2026-01-01"), "");
        let row_of_control =
            "| `control` | 0/100 | 2026-01-01 | 1000 | 10 | 9 | 0.900; 0.596 to 0.982 | 2 |";
        assert!(first.contains(row_of_control));
        assert!(first.contains("- control: `control/src/cpg.rs:1:1: replace + with -`"));

        let protocol = outcome("protocol", "protocol/src/lib.rs:1:1: replace f with ()");
        let second = page(&protocol, &row(&protocol, "1/50", "2026-01-02"), &first);
        assert!(second.contains(row_of_control));
        assert!(second.contains("- control: `control/src/cpg.rs:1:1: replace + with -`"));
        assert!(second.contains("| `protocol` | 1/50 | 2026-01-02 |"));
        assert!(second.contains("- protocol: `protocol/src/lib.rs:1:1: replace f with ()`"));

        let again = page(&control, &row(&control, "2/100", "2026-01-03"), &second);
        assert!(!again.contains(row_of_control) && again.contains("| 2/100 | 2026-01-03 |"));
    }
}
