//! `fuzz TARGET SECONDS [SEED]`: mutations of the corpus without coverage, for machines without libFuzzer. Prints executions.
//! `fuzz --unpack FOLDER` writes corpus, regressions and seeds as libFuzzer reads them, `fuzz --pack FOLDER` takes a corpus into the tree.

use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use fuzz::{Mutator, TARGETS, Target, corpus, seeds, target};

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let done = match *words.as_slice() {
        ["--unpack", folder] => TARGETS
            .iter()
            .try_for_each(|target| unpack(target, Path::new(folder))),
        ["--pack", folder] => TARGETS
            .iter()
            .try_for_each(|target| pack(target, Path::new(folder))),
        [name, seconds] => drive(name, seconds, "1"),
        [name, seconds, seed] => drive(name, seconds, seed),
        _ => Err(std::io::Error::other(
            "see the first lines of fuzz/src/main.rs",
        )),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("fuzz: {error}");
            ExitCode::FAILURE
        }
    }
}

fn inputs(target: &Target) -> Vec<Vec<u8>> {
    let mut inputs = seeds::of(target.name);
    inputs.extend(corpus::read(target.name));
    inputs.extend(corpus::folder(&corpus::regressions(target.name)));
    inputs
}

fn drive(name: &str, seconds: &str, seed: &str) -> std::io::Result<()> {
    let names: Vec<&str> = TARGETS.iter().map(|target| target.name).collect();
    let bad = |what: &str| std::io::Error::other(format!("{what}; targets: {}", names.join(" ")));
    let target = target(name).ok_or_else(|| bad("no such target"))?;
    let seconds = seconds.parse().map_err(|_| bad("SECONDS is no number"))?;
    let seed = seed.parse().map_err(|_| bad("SEED is no number"))?;
    let corpus = inputs(target);
    let mut mutator = Mutator::new(seed, target.longest, target.text);
    let (begun, mut executions) = (Instant::now(), 0_u64);
    let failed = std::env::temp_dir().join(format!("fuzz-{name}-{}", std::process::id()));
    while begun.elapsed() < Duration::from_secs(seconds) {
        for _ in 0..64 {
            let data = mutator.next(&corpus);
            if std::panic::catch_unwind(|| (target.run)(&data)).is_err() {
                std::fs::write(&failed, &data)?;
                let message = format!(
                    "{name} failed after {executions} executions; the input is {}",
                    failed.display()
                );
                return Err(std::io::Error::other(message));
            }
            executions += 1;
        }
    }
    let rate = executions as f64 / begun.elapsed().as_secs_f64();
    println!("{name}: {executions} executions, {rate:.0} a second");
    Ok(())
}

fn unpack(target: &Target, folder: &Path) -> std::io::Result<()> {
    let folder = folder.join(target.name);
    std::fs::create_dir_all(&folder)?;
    for (k, input) in inputs(target).into_iter().enumerate() {
        std::fs::write(folder.join(format!("tree-{k:05}")), input)?;
    }
    Ok(())
}

fn pack(target: &Target, folder: &Path) -> std::io::Result<()> {
    let inputs = corpus::folder(&folder.join(target.name));
    if inputs.is_empty() {
        return Ok(());
    }
    std::fs::write(corpus::file(target.name), corpus::pack(inputs))
}
