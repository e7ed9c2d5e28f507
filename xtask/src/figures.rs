//! `cargo xtask figures`: every figure the documentation quotes, from one fresh run.
//!
//! What a command prints takes the place of the text between its marks in `docs/validation/README.md`.

use crate::{images, sh};
use anyhow::Result;

/// The page of all figures.
const PAGE: &str = "docs/validation/README.md";

/// Each table with the command that prints it.
const TABLES: &[(&str, &str)] = &[
    (
        "Pre-check against parry3d",
        "run --release -q -p control --example precheck_oracle -- 1000000 100000",
    ),
    (
        "Firmware image in QEMU: size, stack, instructions per tick",
        "run --release -q -p hil-sim --example board_table",
    ),
    (
        "Firmware image in QEMU: most instructions per tick, shipped and random gaits",
        "run --release -q -p hil-sim --example board_worst",
    ),
    (
        "Instructions of the law: shipped and random gaits",
        "xtask tick",
    ),
    (
        "Emulated robot: speed against real time, upload time on the link",
        "run --release -q -p hil-sim --example robot_speed",
    ),
    (
        "Motor bus: time of a cycle",
        "test --release -q -p hil-sim --test motors bus_time_of_a_cycle -- --nocapture",
    ),
    (
        "Telemetry: what the link carries and the memory holds",
        "test --release -q -p protocol --test telemetry -- --nocapture",
    ),
    (
        "Damaged uploads, missing motors, power cuts",
        "test --release -q -p hil-sim --test robot --test slots_power_cut -- --nocapture",
    ),
    (
        "STOP: times to the answer, the ramp and the end",
        "run --release -q -p hil-sim --example stop_times -- 1000",
    ),
    (
        "Seeded schedules of faults over firmware, wires, flash and hosts",
        "run --release -q -p hil-sim --example schedules -- 2000",
    ),
    (
        "Faults of the servo bus: told, recovered, by packets lost",
        "run --release -q -p hil-sim --example schedules -- --table 20",
    ),
    (
        "Fuzzing: executions and coverage",
        "xtask fuzz --seconds 60",
    ),
    (
        "Body simulator beside MuJoCo",
        "run --release -q -p host -- bench",
    ),
    (
        "Body simulator, MuJoCo, ODE and Rapier on the same gaits",
        "run --release -q -p peers --features rapier --example validate 50 coarse",
    ),
];

/// Print all tables and write them into the page; each command can also be run alone.
pub(crate) fn run() -> Result<()> {
    images::default_image()?;
    let path = sh::root().join(PAGE);
    let date = sh::output("date", &["-I"])?;
    for (title, command) in TABLES {
        println!("\n## {title}\n\n    cargo {command}\n");
        let arguments: Vec<&str> = command.split(' ').collect();
        let text = sh::tee("cargo", &arguments)?;
        let body = format!("Measured {}.\n\n```text\n{}\n```", date.trim(), text.trim());
        let page = std::fs::read_to_string(&path)?;
        std::fs::write(&path, with_figure(&page, title, command, &body))?;
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
            let command = TABLES.iter().find(|(known, _)| *known == title);
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
        for (title, command) in TABLES {
            let words: Vec<&str> = command.split(' ').collect();
            let after = |flag: &str| words.windows(2).find(|w| w[0] == flag).map(|w| w[1]);
            if let (Some(package), Some(name)) = (after("-p"), after("--example")) {
                let file = sh::root().join(format!("{package}/examples/{name}.rs"));
                assert!(file.is_file(), "{title}: no {}", file.display());
            }
        }
    }
}
