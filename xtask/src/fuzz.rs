//! `cargo xtask fuzz`: every fuzz target for some seconds, and a table of what that was.

use crate::sh;
use anyhow::{Context, Result, bail};
use std::path::Path;
use std::process::Stdio;

/// Targets with the longest input, as `fuzz::TARGETS` has them; a test of `fuzz` holds the list.
const TARGETS: &[(&str, usize)] = &[
    ("bus", 512),
    ("servos", 512),
    ("link", 1024),
    ("robot", 1024),
    ("flash", 512),
    ("gait", 4096),
    ("model", 8192),
    ("structure", 8192),
    ("scenario", 4096),
    ("dataset", 4096),
    ("csv", 4096),
    ("index", 1024),
    ("picture", 2048),
    ("mcap", 4096),
];
const LIBFUZZER: &str = "fuzz/libfuzzer";
/// Memory of a run, MiB, and the longest time of one input, s: a busy machine may stop for long.
const LIMITS: [&str; 2] = ["-rss_limit_mb=512", "-timeout=60"];

/// `--seconds N` for each target (60 when not given), then names of targets (all when none is given).
pub(crate) fn run(arguments: &[String]) -> Result<()> {
    let (seconds, names) = match arguments {
        [flag, seconds, names @ ..] if flag == "--seconds" => (seconds.parse::<u64>()?, names),
        names => (60, names),
    };
    if let Some(unknown) = names
        .iter()
        .find(|name| TARGETS.iter().all(|(known, _)| known != name))
    {
        bail!("no target `{unknown}`");
    }
    let wanted = |name: &str| names.is_empty() || names.iter().any(|n| n == name);
    let chosen = TARGETS.iter().filter(|(name, _)| wanted(name));
    if sh::output("cargo", &["+nightly", "fuzz", "--version"]).is_err() {
        eprintln!(
            "SKIPPED  coverage: needs `rustup toolchain install nightly` and `cargo install cargo-fuzz`; mutating without it"
        );
        return chosen
            .into_iter()
            .try_for_each(|(name, _)| without_coverage(name, seconds));
    }
    let corpus = sh::target_dir().join("fuzz");
    let corpus_word = corpus.to_string_lossy().into_owned();
    sh::run(
        "cargo",
        &[
            "run",
            "--release",
            "-q",
            "-p",
            "fuzz",
            "--",
            "--unpack",
            &corpus_word,
        ],
    )?;
    println!(
        "{:<10} {:>14} {:>10} {:>9} {:>8}",
        "target", "executions", "a second", "edges", "corpus"
    );
    for (name, longest) in chosen {
        println!("{}", with_coverage(name, *longest, seconds, &corpus)?);
    }
    Ok(())
}

fn without_coverage(name: &str, seconds: u64) -> Result<()> {
    let seconds = seconds.to_string();
    sh::run(
        "cargo",
        &["run", "--release", "-q", "-p", "fuzz", "--", name, &seconds],
    )
}

/// One target by libFuzzer; its row of the table.
fn with_coverage(name: &str, longest: usize, seconds: u64, corpus: &Path) -> Result<String> {
    let folder = corpus.join(name).to_string_lossy().into_owned();
    let (time, length) = (
        format!("-max_total_time={seconds}"),
        format!("-max_len={longest}"),
    );
    let found = corpus.join("found").join(name);
    std::fs::create_dir_all(&found)?;
    let artifacts = format!("-artifact_prefix={}/", found.display());
    let words = [
        "+nightly",
        "fuzz",
        "run",
        "--fuzz-dir",
        LIBFUZZER,
        "--sanitizer",
        "none",
        "any",
        &folder,
        "--",
        &time,
        &length,
        "-print_final_stats=1",
        &artifacts,
        LIMITS[0],
        LIMITS[1],
    ];
    let output = sh::command("cargo", &words)
        .env("FUZZ_TARGET", name)
        .stdout(Stdio::null())
        .output()
        .context("cannot start cargo fuzz")?;
    let said = String::from_utf8_lossy(&output.stderr);
    if !output.status.success() {
        let tail: Vec<&str> = said.lines().rev().take(30).collect();
        let tail: Vec<&str> = tail.into_iter().rev().collect();
        bail!(
            "{name} failed; the input is in {}\n{}",
            found.display(),
            tail.join("\n")
        );
    }
    Ok(row(name, &said))
}

/// The row of a target from what libFuzzer says.
fn row(name: &str, said: &str) -> String {
    let stat = |key: &str| {
        let line = said.lines().find_map(|line| line.strip_prefix(key));
        line.map_or("?", str::trim)
    };
    let last = said
        .lines()
        .rev()
        .find(|line| line.contains(" cov: "))
        .unwrap_or("");
    let after = |key: &str| {
        let mut words = last.split_whitespace().skip_while(|word| *word != key);
        words.nth(1).unwrap_or("?")
    };
    let inputs = after("corp:").split('/').next().unwrap_or("?");
    let (executions, rate) = (
        stat("stat::number_of_executed_units:"),
        stat("stat::average_exec_per_sec:"),
    );
    format!(
        "{name:<10} {executions:>14} {rate:>10} {:>9} {inputs:>8}",
        after("cov:")
    )
}

#[cfg(test)]
mod tests {
    use super::{TARGETS, row};

    #[test]
    fn a_row_holds_what_libfuzzer_says() {
        let said = "#2 INITED cov: 1 ft: 1 corp: 1/1b\n#9\tDONE   cov: 1234 ft: 5 corp: 77/12Kb lim: 9 exec/s: 3\n\
                    stat::number_of_executed_units: 987\nstat::average_exec_per_sec:     65\n";
        let row = row("gait", said);
        let words: Vec<&str> = row.split_whitespace().collect();
        assert_eq!(words, ["gait", "987", "65", "1234", "77"]);
    }

    #[test]
    fn the_targets_are_those_of_the_fuzz_crate() {
        let text =
            std::fs::read_to_string(crate::sh::root().join("fuzz/src/lib.rs")).expect("the crate");
        for (name, longest) in TARGETS {
            assert!(
                text.contains(&format!("(\"{name}\", {longest}, ")),
                "{name}"
            );
        }
        let targets = text.matches("    binary(\"").count() + text.matches("    text(\"").count();
        assert_eq!(targets, TARGETS.len());
    }
}
