//! Seeded schedules of faults over the whole chain: `cargo run --release -p hil-sim --example schedules -- 2000`.

use anyhow::{Context, Result, bail};
use hil_sim::schedule::{Cut, Kind, LOSSES, Law, Plan, Summary, many, play, shrink, table};
use std::time::{Duration, Instant};

const USAGE: &str = "\
schedules [N]                     play N schedules (2000) on all cores
  --first SEED                    from this seed on (0)
  --threads N                     on N threads
  --stop                          end at the first broken law
  --minutes M                     end after M minutes, whatever N is
  --faults NAME,NAME              draw these faults only
  --seed SEED                     play one schedule and print it; what fails is shrunk
    --keep N,N  --until SECONDS   of it these faults alone, and until then
  --table RUNS                    faults of the servo bus by the share of packets lost, RUNS each";

struct Options {
    count: u64,
    first: u64,
    threads: usize,
    minutes: Option<f64>,
    stop: bool,
    seed: Option<u64>,
    table: Option<u32>,
    cut: Cut,
}

/// Numbers of faults; none plays a schedule without faults.
fn list(text: &str) -> Result<Vec<usize>> {
    let words = text.split(',').filter(|word| !word.is_empty());
    words.map(|word| Ok(word.parse()?)).collect()
}

fn options() -> Result<Options> {
    let mut options = Options {
        count: 2_000,
        first: 0,
        threads: std::thread::available_parallelism().map_or(1, usize::from),
        minutes: None,
        stop: false,
        seed: None,
        table: None,
        cut: Cut::default(),
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || {
            words
                .next()
                .with_context(|| format!("{word} needs a value"))
        };
        match word.as_str() {
            "--first" => options.first = value()?.parse()?,
            "--threads" => options.threads = value()?.parse()?,
            "--stop" => options.stop = true,
            "--minutes" => options.minutes = Some(value()?.parse()?),
            "--faults" => options.cut.kinds = Some(Kind::list(&value()?)?),
            "--seed" => options.seed = Some(value()?.parse()?),
            "--table" => options.table = Some(value()?.parse()?),
            "--keep" => options.cut.keep = Some(list(&value()?)?),
            "--until" => {
                let until_s: f64 = value()?.parse()?;
                options.cut.active_us = Some((until_s * 1e6) as u64);
            }
            number => options.count = number.parse().context(USAGE)?,
        }
    }
    Ok(options)
}

/// Plays one schedule and says what it is; shrinks what fails.
fn one(seed: u64, cut: &Cut) -> Result<()> {
    let plan = Plan::with(seed, cut);
    print!("{plan}");
    let outcome = play(&plan);
    println!(
        "{:.3} s of virtual time, trace {:016x}, {:?}",
        outcome.virtual_us as f64 * 1e-6,
        outcome.trace,
        outcome.counts
    );
    let Some(broken) = outcome.broken else {
        return Ok(());
    };
    println!("broken: {broken}");
    let smaller = shrink(seed, cut, broken.law);
    let plan = Plan::with(seed, &smaller);
    println!("\nas small as it gets:\n{plan}");
    if let Some(broken) = play(&plan).broken {
        println!("broken: {broken}");
    }
    let keep: Vec<String> = plan.numbers.iter().map(ToString::to_string).collect();
    bail!(
        "again: schedules --seed {seed} --keep '{}' --until {:.6}",
        keep.join(","),
        plan.active_us as f64 * 1e-6
    )
}

fn report(summary: &Summary, took: Duration) {
    let (n, failed) = (summary.schedules, summary.failures.len());
    let virtual_s = summary.virtual_us as f64 * 1e-6;
    println!(
        "{n} schedules, {virtual_s:.0} s of virtual time, trace {:016x}",
        summary.trace
    );
    println!("{:?}", summary.counts);
    let struck = Kind::all().zip(summary.struck);
    let struck: Vec<String> = struck.map(|(k, n)| format!("{} {n}", k.name())).collect();
    println!("faults struck: {}", struck.join(", "));
    for failure in summary.failures.iter().take(20) {
        match &failure.broken {
            Some(broken) => println!("seed {}: {broken}", failure.seed),
            None => println!("seed {}: panic", failure.seed),
        }
    }
    if failed == 0 {
        println!("0 of {n}: rate < {:.1e} at 95 % (3/N)", 3.0 / n as f64);
    } else {
        println!("{failed} of {n} broke a law; play one alone with --seed");
    }
    let took_s = took.as_secs_f64();
    let rate = n as f64 / took_s;
    println!("{took_s:.1} s, {rate:.0} seeds a second");
}

/// Per fault one row: share noticed, median and longest time in ms, share recovered, at each loss.
fn print_table(runs: u32) {
    let losses: Vec<String> = LOSSES
        .iter()
        .map(|loss| format!("{:.0} % lost", loss * 100.0))
        .collect();
    println!(
        "{runs} runs a cell. In each: share told, of the runs still under way; median (longest) time to it, ms; share of all runs after which"
    );
    println!("the robot made a whole run again.\n");
    println!("| fault | {} |", losses.join(" | "));
    println!("|---{}|", "|---".repeat(losses.len()));
    let percent = |n: u32, of: u32| f64::from(n) / f64::from(of.max(1)) * 100.0;
    for rows in table(runs).chunks(LOSSES.len()) {
        let cells = rows.iter().map(|row| {
            format!(
                "{:.0} %; {:.0} ({:.0}); {:.0} %",
                percent(row.noticed, row.struck),
                row.median_ms,
                row.most_ms,
                percent(row.recovered, row.runs)
            )
        });
        let cells: Vec<String> = cells.collect();
        println!("| {} | {} |", rows[0].fault, cells.join(" | "));
    }
}

fn main() -> Result<()> {
    let options = options()?;
    if let Some(runs) = options.table {
        print_table(runs);
        return Ok(());
    }
    if let Some(seed) = options.seed {
        return one(seed, &options.cut);
    }
    let begun = Instant::now();
    let minutes = options.minutes.unwrap_or(f64::INFINITY);
    let go_on = || begun.elapsed().as_secs_f64() < minutes * 60.0;
    let summary = many(
        options.first,
        options.count,
        options.threads,
        &options.cut,
        options.stop,
        &go_on,
    );
    report(&summary, begun.elapsed());
    if !summary.failures.is_empty() {
        let worst = summary.of_law(Law::Checked);
        bail!("a law did not hold ({worst} times that set-points are checked)");
    }
    Ok(())
}
