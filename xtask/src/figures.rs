//! `cargo xtask figures`: every figure the documentation quotes, from one fresh run.
//!
//! What a command prints takes the place of the text between its marks in `docs/validation/README.md`.

use crate::{images, sh, summary};
use anyhow::Result;

/// The page of all figures.
const PAGE: &str = "docs/validation/README.md";

/// What a test runs in the place of a table's command.
enum Short {
    /// The command itself, as it is.
    Same,
    /// The command with these arguments.
    By(&'static str),
    /// Another command, which does the same for a moment.
    Instead(&'static str),
    /// The command with these arguments, where QEMU is there.
    InQemu(&'static str),
    /// Nothing here: why.
    Elsewhere(&'static str),
}

/// Each table with the command that prints it.
const TABLES: &[(&str, &str, Short)] = &[
    (
        "Pre-check against parry3d",
        "run --release -q -p control --example precheck_oracle -- 1000000 100000",
        Short::By("1000 500"),
    ),
    (
        "Firmware image in QEMU: size, stack, instructions per tick",
        "run --release -q -p hil-sim --example board_table",
        Short::InQemu("gaits/crawl.toml"),
    ),
    (
        "Firmware image in QEMU: most instructions per tick, shipped and random gaits",
        "run --release -q -p hil-sim --example board_worst",
        Short::InQemu("1"),
    ),
    (
        "Instructions of the law: shipped and random gaits",
        "xtask tick",
        Short::Elsewhere("a step of its own does"),
    ),
    (
        "Emulated robot: speed against real time, upload time on the link",
        "run --release -q -p hil-sim --example robot_speed",
        Short::Same,
    ),
    (
        "Motor bus: time of a cycle",
        "test --release -q -p hil-sim --test motors bus_time_of_a_cycle -- --nocapture",
        Short::Elsewhere("the test is among all tests"),
    ),
    (
        "Telemetry: what the link carries and the memory holds",
        "test --release -q -p protocol --test telemetry -- --nocapture",
        Short::Elsewhere("the tests are among all tests"),
    ),
    (
        "Damaged uploads, missing motors, power cuts",
        "test --release -q -p hil-sim --test robot --test slots_power_cut -- --nocapture",
        Short::Elsewhere("the tests are among all tests"),
    ),
    (
        "STOP: times to the answer, the ramp and the end",
        "run --release -q -p hil-sim --example stop_times -- 1000",
        Short::By("10"),
    ),
    (
        "Seeded schedules of faults over firmware, wires, flash and hosts",
        "run --release -q -p hil-sim --example schedules -- 2000",
        Short::By("10"),
    ),
    (
        "Faults of the servo bus: told, recovered, by packets lost",
        "run --release -q -p hil-sim --example schedules -- --table 20",
        Short::By("--table 1"),
    ),
    (
        "Fuzzing: executions and coverage",
        "xtask fuzz --seconds 60",
        Short::Instead("run -q -p fuzz -- gait 1"),
    ),
    (
        "Body simulator beside MuJoCo",
        "run --release -q -p host -- bench",
        Short::Elsewhere("a test of `rb-host bench` does"),
    ),
    (
        "Body simulator, MuJoCo, ODE and Rapier on the same gaits",
        "run --release -q -p peers --features rapier --example validate -- 50 coarse",
        Short::By("1 coarse"),
    ),
];

/// Print the tables whose titles hold `words`, all of them without a word, and write them into the page.
pub(crate) fn run(words: &str) -> Result<()> {
    let chosen = || TABLES.iter().filter(|(title, ..)| title.contains(words));
    anyhow::ensure!(
        chosen().next().is_some(),
        "no table's title holds `{words}`"
    );
    images::default_image()?;
    let path = sh::root().join(PAGE);
    let date = sh::output("date", &["-I"])?;
    for (title, command, _) in chosen() {
        println!("\n## {title}\n\n    cargo {command}\n");
        let arguments: Vec<&str> = command.split(' ').collect();
        let text = sh::tee("cargo", &arguments)?;
        let body = format!("Measured {}.\n\n```text\n{}\n```", date.trim(), text.trim());
        let page = std::fs::read_to_string(&path)?;
        std::fs::write(&path, with_figure(&page, title, command, &body))?;
    }
    summary()
}

/// Makes the table of the firmware and the wires from the sections as they are, prints it and writes it into the page.
pub(crate) fn summary() -> Result<()> {
    let path = sh::root().join(PAGE);
    let read = |name: &str| std::fs::read_to_string(path.with_file_name(name));
    let page = std::fs::read_to_string(&path)?;
    let table = summary::table(&page, &read("planted-faults.md")?, &read("mutants.md")?)?;
    println!("\n{table}");
    std::fs::write(&path, summary::put(&page, &table)?)?;
    Ok(())
}

/// Runs every table's command in its short form, built as the tests are. Nothing is written: the figures of a short form are
/// none.
pub(crate) fn short() -> Result<()> {
    let qemu = sh::output("qemu-system-arm", &["--version"]).is_ok();
    for (title, command, short) in TABLES {
        let shortened = match short {
            Short::Elsewhere(what) => {
                eprintln!("{title}: not run here, {what}");
                continue;
            }
            Short::Same => (*command).to_owned(),
            Short::Instead(other) => (*other).to_owned(),
            Short::InQemu(_) if !qemu => {
                eprintln!("SKIPPED {title}: no QEMU");
                continue;
            }
            Short::By(arguments) | Short::InQemu(arguments) => {
                let program = command.split(" -- ").next().unwrap_or(command);
                format!("{program} -- {arguments}")
            }
        };
        let shortened = shortened.replace(" --release", "");
        eprintln!("\n## {title}\n\n    cargo {shortened}\n");
        let arguments: Vec<&str> = shortened.split(' ').collect();
        let printed = sh::tee("cargo", &arguments)?;
        anyhow::ensure!(
            !printed.trim().is_empty(),
            "`cargo {shortened}` prints nothing"
        );
    }
    Ok(())
}

/// The page with `body` between the marks of `title`; a section that it lacks is added at its end.
fn with_figure(page: &str, title: &str, command: &str, body: &str) -> String {
    let (begin, end) = (format!("<!-- begin: {title} -->\n"), "<!-- end -->");
    let section = page.split_once(&begin);
    let parts = section.and_then(|(before, rest)| Some((before, rest.split_once(end)?.1)));
    let Some((before, after)) = parts else {
        return format!("{page}\n## {title}\n\n    cargo {command}\n\n{begin}{body}\n{end}\n");
    };
    format!("{before}{begin}{body}\n{end}{after}")
}

#[cfg(test)]
mod tests {
    use super::{PAGE, TABLES, with_figure};

    #[test]
    fn every_figure_of_the_page_has_its_command() {
        let page = std::fs::read_to_string(crate::sh::root().join(PAGE)).unwrap();
        for mark in page.split("<!-- begin: ").skip(1) {
            let title = mark.split(" -->").next().unwrap();
            if title == "summary" {
                continue;
            }
            let command = TABLES.iter().find(|(known, _, _)| *known == title);
            let command = command
                .unwrap_or_else(|| panic!("no command prints `{title}`"))
                .1;
            assert!(
                page.contains(&format!("## {title}\n\n    cargo {command}\n")),
                "{title}"
            );
        }
    }

    #[test]
    fn a_figure_takes_the_place_of_the_older_one() {
        let page = with_figure("# Page\n", "Speed", "bench", "1");
        assert!(
            page.contains(
                "## Speed\n\n    cargo bench\n\n<!-- begin: Speed -->\n1\n<!-- end -->\n"
            )
        );
        let page = with_figure(&page, "Size", "size", "2");
        let newer = with_figure(&page, "Speed", "bench", "3");
        assert_eq!(newer, page.replace("-->\n1\n", "-->\n3\n"));
    }
}

#[cfg(test)]
mod programs {
    use super::TABLES;
    use crate::sh;

    #[test]
    fn every_table_has_its_program() {
        for (title, command, _) in TABLES {
            let words: Vec<&str> = command.split(' ').collect();
            let after = |flag: &str| words.windows(2).find(|w| w[0] == flag).map(|w| w[1]);
            if let (Some(package), Some(name)) = (after("-p"), after("--example")) {
                let file = sh::root().join(format!("{package}/examples/{name}.rs"));
                assert!(file.is_file(), "{title}: no {}", file.display());
            }
        }
    }
}
