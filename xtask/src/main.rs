//! Set-up, the two commands of the README, the firmware build, and the tables of the documentation.

mod audit;
mod cross;
mod demo;
mod elf;
mod figures;
mod fuzz;
mod images;
mod mutants;
mod planted;
mod release;
mod sbom;
mod setup;
mod sh;
mod site;
mod summary;
mod test;
mod tick;

use std::process::ExitCode;

const USAGE: &str = "\
cargo xtask <command>

  demo      upload, run and record a gait on the emulated robot, and draw it (needs Rust only)
  test      set up this machine, then run every check: format, lints, all tests, firmware, QEMU, foreign clients;
            --long: also planted faults, mutants and all figures (hours; writes docs/validation)
  setup     only the set-up that `test` does: Rust target, QEMU, Python clients, browser, mdBook
  fw        build the firmware image for the STM32L475VG and print its size
  gate      link `control` and `protocol` into a thumb image in which a reachable panic is a link error,
            link the image of every board and look from where it may panic
  cross     check the host tool for Windows and macOS; parts in C are left out, nothing is linked or run
  audit     licences, sources and known faults of dependencies, by cargo-deny and cargo-audit where they are installed
  fuzz      [--seconds N] [TARGET...]: every fuzz target, 60 s each when not given (coverage needs nightly and cargo-fuzz)
  release   archives, Debian package, checksums and parts list of this version, in target/dist
  site      the pages as a web site, in target/site with mdBook, links followed
  tick      count the instructions of the 20 Hz law, over all shipped and 200 random gaits, in QEMU
  planted   plant faults one at a time in a copy and print what finds them; [NUMBERS] (half an hour)
  mutants   [--shard K/N] [ROW...]: a sample of the mutants of control, protocol, firmware and stm32, and what the tests kill
  figures   [WORDS]: print every table that the documentation quotes, from a fresh run (an hour), or those whose titles
            hold these words;
            --short: run each command briefly, as `test` does, and write nothing;
            --summary: only the table of the firmware and the wires, from the sections as they are
";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let result = match arguments.first().map(String::as_str) {
        Some("demo") => demo::run(),
        Some("test") => test::run(&arguments[1..]),
        Some("setup") => setup::run().map(|report| report.print()),
        Some("fw") => images::default_image(),
        Some("gate") => test::panic_free_gate().and_then(|()| images::all()),
        Some("cross") => cross::run(),
        Some("audit") => audit::run(),
        Some("fuzz") => fuzz::run(&arguments[1..]),
        Some("release") => release::run(),
        Some("site") => site::run(),
        Some("tick") => tick::run(),
        Some("figures") if arguments.get(1).is_some_and(|word| word == "--short") => {
            figures::short()
        }
        Some("figures") if arguments.get(1).is_some_and(|word| word == "--summary") => {
            figures::summary()
        }
        Some("figures") => figures::run(&arguments[1..].join(" ")),
        Some("mutants") => mutants::run(&arguments[1..]),
        Some("planted") => planted::run(arguments.get(1..).unwrap_or_default()),
        _ => {
            eprint!("{USAGE}");
            return ExitCode::from(2);
        }
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("xtask: {error:#}");
            ExitCode::FAILURE
        }
    }
}
