//! The table of the firmware and the wires: what the sections of the validation page, the planted faults and the mutants say, a line each.

use anyhow::{Context, Result};

/// Marks of the table in the page.
pub(crate) const MARKS: [&str; 2] = ["<!-- begin: summary -->\n", "<!-- end -->"];

/// What a section's command printed, and the command.
struct Section<'a> {
    text: &'a str,
    command: &'a str,
}

fn section<'a>(page: &'a str, title: &str) -> Result<Section<'a>> {
    let cut = || {
        let (_, of_title) = page.split_once(&format!("\n## {title}\n\n    "))?;
        let (command, _) = of_title.split_once('\n')?;
        let (_, rest) = page.split_once(&format!("<!-- begin: {title} -->\n"))?;
        let (text, _) = rest.split_once("<!-- end -->")?;
        Some(Section { text, command })
    };
    cut().with_context(|| format!("the page has no section `{title}`"))
}

impl<'a> Section<'a> {
    /// The first line in which `word` stands.
    fn line(&self, word: &str) -> Result<&'a str> {
        let found = self.text.lines().find(|line| line.contains(word));
        found.with_context(|| format!("`{}` printed no line with `{word}`", self.command))
    }
}

/// Cells of a table's line.
fn cells(line: &str) -> Vec<&str> {
    let bare = line.trim().trim_start_matches('|').trim_end_matches('|');
    bare.split('|').map(str::trim).collect()
}

/// Rows of the summary: figure, measured, asked, command.
type Row = [String; 4];

fn schedules(page: &str) -> Result<[Row; 2]> {
    let of = section(
        page,
        "Seeded schedules of faults over firmware, wires, flash and hosts",
    )?;
    let speed = of.line("seeds a second")?;
    let speed = speed.rsplit(',').next().unwrap_or(speed).trim();
    let command = of.command.to_owned();
    Ok([
        [
            "schedules that broke a law".into(),
            of.line(": rate <")?.into(),
            "0 of 10^7".into(),
            command.clone(),
        ],
        [
            "schedules a second".into(),
            speed.into(),
            String::new(),
            command,
        ],
    ])
}

fn planted(page: &str) -> Result<Row> {
    let (_, said) = page
        .split_once("Last run ")
        .context("no planted faults were looked for")?;
    let (_, said) = said
        .split_once(": ")
        .context("no count of planted faults")?;
    let (count, _) = said
        .split_once(" found")
        .context("no count of planted faults")?;
    Ok([
        "planted faults found".into(),
        count.into(),
        "all of 40".into(),
        "cargo xtask planted".into(),
    ])
}

fn mutants(page: &str) -> Result<Vec<Row>> {
    let rows = page.lines().filter(|line| line.starts_with("| `"));
    let rows: Vec<Row> = rows
        .map(|line| {
            let cell = cells(line);
            let [name, shard, _, _, tried, killed, share, ..] = cell.as_slice() else {
                anyhow::bail!("no row of mutants: {line}");
            };
            Ok([
                format!("mutants of {name} killed"),
                format!("{killed} of {tried} ({share})"),
                "0.9".into(),
                format!(
                    "cargo xtask mutants --shard {shard} {}",
                    name.trim_matches('`')
                ),
            ])
        })
        .collect::<Result<_>>()?;
    anyhow::ensure!(!rows.is_empty(), "no mutants were tried");
    Ok(rows)
}

fn fuzzing(page: &str) -> Result<Row> {
    let of = section(page, "Fuzzing: executions and coverage")?;
    let (mut targets, mut executions, mut edges) = (0, 0_u64, 0_u64);
    let lines = of.text.lines().skip_while(|l| !l.starts_with("target"));
    for line in lines.skip(1).take_while(|l| !l.starts_with("```")) {
        let number = |at: usize| -> Result<u64> {
            let word = line.split_whitespace().nth(at).unwrap_or("");
            word.parse()
                .with_context(|| format!("no figures of fuzzing: {line}"))
        };
        targets += 1;
        executions += number(1)?;
        edges += number(3)?;
    }
    anyhow::ensure!(targets > 0, "no target was fuzzed");
    Ok([
        "fuzz executions; edges reached".into(),
        format!("{executions}; {edges}, in {targets} targets"),
        "10^9".into(),
        of.command.into(),
    ])
}

fn board(page: &str) -> Result<Vec<Row>> {
    let ticks = section(
        page,
        "Firmware image in QEMU: most instructions per tick, shipped and random gaits",
    )?;
    let image = section(
        page,
        "Firmware image in QEMU: size, stack, instructions per tick",
    )?;
    let mut rows: Vec<Row> = Vec::new();
    let of_limit = |l: &&str| l.ends_with(" instructions") && l.contains(" of ");
    for line in ticks.text.lines().filter(of_limit) {
        let (what, most) = line
            .split_once(": most ")
            .with_context(|| format!("no most of a tick: {line}"))?;
        rows.push([
            format!("instructions of a tick, most: {what}"),
            most.trim_end_matches(" instructions").into(),
            "120000 (6 % of 50 ms)".into(),
            ticks.command.into(),
        ]);
    }
    anyhow::ensure!(!rows.is_empty(), "no ticks were counted");
    let speed = image.line("s of guest time in")?;
    let speed = speed.split(" (").next().unwrap_or(speed);
    rows.push([
        "firmware image in QEMU".into(),
        speed.into(),
        "30 s of guest in 4 s".into(),
        image.command.into(),
    ]);
    Ok(rows)
}

fn stop(page: &str) -> Result<Row> {
    let of = section(page, "STOP: times to the answer, the ramp and the end")?;
    let line = of
        .text
        .lines()
        .find(|l| l.contains("115200 baud") && l.contains("first set-point"))
        .context("no times of STOP")?;
    let cell = cells(line);
    let [_, _, _, median, _, high, most] = cell.as_slice() else {
        anyhow::bail!("no times of STOP: {line}");
    };
    Ok([
        "STOP at 115200 baud to the first set-point of the ramp".into(),
        format!("median {median} ms, 95 % {high} ms, most {most} ms"),
        "53 ms".into(),
        of.command.into(),
    ])
}

/// Of every loss, the least share of runs after which the robot made a whole run again, over all faults.
fn recovered(page: &str) -> Result<Row> {
    let of = section(
        page,
        "Faults of the servo bus: told, recovered, by packets lost",
    )?;
    let mut lines = of.text.lines().filter(|l| l.starts_with('|'));
    let head = cells(lines.next().context("no faults of the bus")?);
    let mut least = vec![100_u32; head.len()];
    let mut faults = 0;
    for line in lines.skip(1) {
        faults += 1;
        for (slot, cell) in least.iter_mut().zip(cells(line)).skip(1) {
            let share = cell.rsplit(';').next().unwrap_or("").trim();
            let share = share.trim_end_matches(" %").parse();
            *slot = share
                .map(|s: u32| s.min(*slot))
                .with_context(|| format!("no share: {cell}"))?;
        }
    }
    let pairs = head.iter().zip(&least).skip(1);
    let pairs: Vec<String> = pairs.map(|(loss, s)| format!("{loss}: {s} %")).collect();
    Ok([
        format!("whole run again after each of {faults} bus faults, least share"),
        pairs.join(", "),
        String::new(),
        of.command.into(),
    ])
}

/// The table, from the pages as they are.
///
/// # Errors
/// A figure is missing.
pub(crate) fn table(page: &str, planted_page: &str, mutants_page: &str) -> Result<String> {
    let mut rows: Vec<Row> = schedules(page)?.into();
    rows.push(planted(planted_page)?);
    rows.extend(mutants(mutants_page)?);
    rows.push(fuzzing(page)?);
    rows.extend(board(page)?);
    rows.push(stop(page)?);
    rows.push(recovered(page)?);
    let lines: Vec<String> = rows
        .iter()
        .map(|[figure, measured, asked, command]| {
            format!("| {figure} | {measured} | {asked} | `{command}` |\n")
        })
        .collect();
    Ok(format!(
        "| figure | measured | asked | command |\n|---|---|---|---|\n{}",
        lines.concat()
    ))
}

/// The page with `table` between its marks.
///
/// # Errors
/// The page has no marks.
pub(crate) fn put(page: &str, table: &str) -> Result<String> {
    let [begin, end] = MARKS;
    let parts = page.split_once(begin);
    let parts = parts.and_then(|(before, rest)| Some((before, rest.split_once(end)?.1)));
    let (before, after) = parts.context("the page has no place for the summary")?;
    Ok(format!("{before}{begin}{table}{end}{after}"))
}

#[cfg(test)]
mod tests {
    use super::{put, table};

    fn pages() -> [String; 3] {
        ["README.md", "planted-faults.md", "mutants.md"].map(|name| {
            let path = crate::sh::root().join("docs/validation").join(name);
            std::fs::read_to_string(path).unwrap()
        })
    }

    #[test]
    fn the_summary_is_that_of_the_sections() {
        let [page, planted, mutants] = pages();
        let table = table(&page, &planted, &mutants).unwrap();
        assert_eq!(
            put(&page, &table).unwrap(),
            page,
            "run `cargo xtask figures --summary`"
        );
    }

    #[test]
    fn a_figure_that_is_missing_is_an_error() {
        let [page, planted, mutants] = pages();
        for (cut, instead) in [
            (": rate <", ""),
            ("seeds a second", ""),
            ("s of guest time in", ""),
            (": most ", ""),
            ("first set-point after", ""),
            ("<!-- begin: Fuzzing: executions and coverage -->", ""),
            ("<!-- begin: Faults of the servo bus", ""),
        ] {
            let broken = page.replace(cut, instead);
            assert!(table(&broken, &planted, &mutants).is_err(), "{cut}");
        }
        assert!(table(&page, "", &mutants).is_err());
        assert!(table(&page, &planted, "").is_err());
    }
}
