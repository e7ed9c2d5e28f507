//! Examples at the end of every `--help`. A test parses each of them.

/// Words of a command and its examples, each a command line after `rb-host`.
type Examples = (&'static str, &'static [&'static str]);

/// One row for every command that does something.
pub const EXAMPLES: &[Examples] = &[
    ("list", &["list", "list --all --no-probe"]),
    ("info", &["info", "-p /dev/ttyACM0 info --json"]),
    ("doctor", &["doctor", "-p tcp://127.0.0.1:7000 doctor"]),
    (
        "upload",
        &[
            "upload gaits/crawl.toml",
            "upload gaits/turn.toml -s 3 --activate",
        ],
    ),
    ("download", &["download -o active.toml", "download -s 3"]),
    ("slots list", &["slots list"]),
    ("slots activate", &["slots activate 3"]),
    ("slots erase", &["slots erase 5 --yes"]),
    (
        "run",
        &[
            "-p sim: run gaits/crawl.toml -d 5s -r crawl.mcap",
            "run -s 3 -d 30s",
            "run gaits/crawl.toml --dataset set --repeat 3 --role fit",
        ],
    ),
    ("stop", &["stop"]),
    ("monitor", &["monitor", "monitor --plain --rate 100 -d 10s"]),
    ("log", &["log"]),
    ("zero", &["zero", "zero --joint A.M2"]),
    ("reset", &["reset", "reset --fault"]),
    ("bus scan", &["bus scan", "bus --direct /dev/ttyUSB0 scan"]),
    ("bus ping", &["bus ping 2"]),
    (
        "bus read",
        &["bus read 2 present-position", "bus read 2 all"],
    ),
    ("bus write", &["bus write 2 led 1"]),
    ("bus table", &["bus table"]),
    ("bus use", &["bus use xm430", "bus use robot.toml"]),
    ("bus bench", &["bus bench -d 10s --id 1 --id 2"]),
    ("gait new", &["gait new my.toml"]),
    (
        "gait check",
        &[
            "gait check gaits/crawl.toml gaits/turn.toml",
            "gait check -",
        ],
    ),
    ("gait show", &["gait show my.toml --plot my.svg"]),
    (
        "gait convert",
        &[
            "gait convert my.toml --to json -o my.json",
            "gait convert my.json --to toml",
        ],
    ),
    ("gait diff", &["gait diff a.toml b.toml"]),
    (
        "emulate",
        &[
            "emulate robot --tcp 127.0.0.1:7000",
            "emulate motors --pty /tmp/bus --inject drop=0.01",
        ],
    ),
    (
        "emulate films",
        &["emulate films gaits/crawl.toml gaits/turn.toml -o set --seed 7"],
    ),
    ("rec info", &["rec info crawl.mcap"]),
    ("rec check", &["rec check crawl.mcap", "rec check set"]),
    (
        "rec cat",
        &[
            "rec cat crawl.mcap --events",
            "rec cat crawl.mcap --run 1 --json",
        ],
    ),
    (
        "rec convert",
        &[
            "rec convert crawl.mcap --to csv -o crawl.csv",
            "rec convert crawl.mcap --to dataset -o set",
        ],
    ),
    (
        "rec film",
        &["rec film set crawl_1 films/crawl_1 --track track.csv"],
    ),
    (
        "rec plot",
        &[
            "rec plot crawl.mcap",
            "rec plot crawl.mcap --run 2 -o two.svg --force",
        ],
    ),
    (
        "sim",
        &[
            "sim gaits/crawl.toml",
            "sim gaits/crawl.toml -o set --camera --repeat 3",
        ],
    ),
    ("camera import", &["camera import dump -o depth"]),
    (
        "camera background",
        &["camera background depth -o empty.pgm"],
    ),
    (
        "camera silhouette",
        &["camera silhouette depth -o film --background empty.pgm"],
    ),
    (
        "camera simulate",
        &["camera simulate set --run g01_1 -m fit/model.toml -o simulated"],
    ),
    (
        "camera compare",
        &[
            "camera compare set -m fit/model.toml",
            "camera compare set/g01_1 simulated -o r.csv",
        ],
    ),
    (
        "camera overlay",
        &["camera overlay set/g01_1 simulated --at 2s -o overlay.png"],
    ),
    (
        "camera strip",
        &["camera strip set/g01_1 simulated -o strip.png"],
    ),
    (
        "camera animate",
        &["camera animate set/g01_1 simulated -o overlay.html"],
    ),
    (
        "optimise gait",
        &[
            "optimise gait -o search --particles 50 --iterations 20",
            "optimise gait -o search --resume --iterations 40",
        ],
    ),
    (
        "optimise model",
        &[
            "optimise model set -o fit --rows 1-4,13",
            "optimise model set -o fit --resume",
        ],
    ),
    ("model schema", &["model schema dataset"]),
    ("model check", &["model check model.toml"]),
    (
        "model show",
        &["model show", "model show fit/model.toml --json"],
    ),
    (
        "hybrid",
        &[
            "-p sim: hybrid -o h",
            "hybrid -o h --resume --cycles 2",
            "-p /dev/ttyACM0 hybrid -o h --slot 3",
        ],
    ),
    (
        "gap report",
        &[
            "gap report set -o report.html",
            "gap report set --json-file verdict.json --patch patch.toml --time-limit 2min",
        ],
    ),
    (
        "gap causes",
        &[
            "gap causes set --patch patch.toml",
            "gap causes set --calibration own.json --json",
        ],
    ),
    (
        "gap calibrate",
        &["gap calibrate --nulls nulls -o own.json"],
    ),
    (
        "gap predict",
        &["gap predict set --patch patch.toml -o predicted"],
    ),
    (
        "gap collect",
        &[
            "gap collect -o set --dry-run",
            "-p sim: gap collect -o set --repeat 2 --warm 0s",
        ],
    ),
    ("bench", &["bench --trials 16 --alone"]),
    ("completions", &["completions bash", "completions zsh"]),
    ("man", &["man -o man"]),
    ("config show", &["config show"]),
    ("config path", &["config path"]),
    ("config init", &["config init"]),
    ("config key set", &["-p /dev/ttyACM0 config key set"]),
    ("config key path", &["config key path"]),
    ("version", &["version", "version --json"]),
];

/// Adds the examples to a command and everything below it.
#[must_use]
pub fn add(command: clap::Command) -> clap::Command {
    below(command, "")
}

fn below(command: clap::Command, path: &str) -> clap::Command {
    let join = |name: &str| format!("{path} {name}").trim_start().to_owned();
    let command = match EXAMPLES.iter().find(|row| row.0 == path) {
        Some((_, lines)) => {
            let lines: Vec<String> = lines.iter().map(|l| format!("  rb-host {l}")).collect();
            command.after_help(format!("Examples:\n{}", lines.join("\n")))
        }
        None => command,
    };
    command.mut_subcommands(|sub| {
        let path = join(sub.get_name());
        below(sub, &path)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    /// Every command without commands of its own, and those that also do something themselves.
    fn leaves(command: &clap::Command, path: &str, out: &mut Vec<String>) {
        for sub in command.get_subcommands() {
            let path = format!("{path} {}", sub.get_name()).trim_start().to_owned();
            if !sub.has_subcommands() || sub.get_positionals().next().is_some() {
                out.push(path.clone());
            }
            leaves(sub, &path, out);
        }
    }

    #[test]
    fn every_command_has_examples_and_every_example_is_a_command_line() {
        let mut found = Vec::new();
        leaves(&crate::cli::Cli::command(), "", &mut found);
        let mut told: Vec<String> = EXAMPLES.iter().map(|row| row.0.to_owned()).collect();
        found.sort();
        told.sort();
        assert_eq!(found, told);
        for (path, lines) in EXAMPLES {
            for line in *lines {
                let words = ["rb-host"].into_iter().chain(line.split(' '));
                let parsed = crate::cli::command().try_get_matches_from(words);
                assert!(parsed.is_ok(), "{line}: {}", parsed.unwrap_err());
                assert!(
                    line.contains(path.split(' ').next().unwrap()),
                    "{path}: {line}"
                );
            }
        }
    }

    /// How an option is written: its short form, and the name of its value.
    type Form = (Option<char>, Option<String>);

    fn options(command: &clap::Command, path: &str, out: &mut Vec<(String, String, Form)>) {
        for option in command.get_opts().filter(|o| !o.is_hide_set()) {
            let Some(long) = option.get_long() else {
                continue;
            };
            let values = option.get_value_names().unwrap_or_default();
            let takes = option.get_action().takes_values();
            let value = takes.then(|| values.first().map_or("", |v| v.as_str()).to_owned());
            out.push((
                long.to_owned(),
                path.to_owned(),
                (option.get_short(), value),
            ));
        }
        for sub in command.get_subcommands() {
            options(sub, &format!("{path} {}", sub.get_name()), out);
        }
    }

    #[test]
    fn an_option_means_one_thing_everywhere() {
        let mut found = Vec::new();
        options(&crate::cli::command(), "", &mut found);
        let kind = |long: &str, value: &Option<String>| match value.as_deref() {
            // What a command writes is a file or a folder.
            Some("FILE" | "DIR" | "PATH") if long == "output" => Some("PATH".to_owned()),
            // Runs of a recording have numbers, those of a data set have names.
            Some("NAME") if long == "run" => Some("N".to_owned()),
            _ => value.clone(),
        };
        let mut differ = Vec::new();
        for (long, path, (short, value)) in &found {
            let first = found.iter().find(|row| row.0 == *long).unwrap();
            let short_differs = short.is_some() && first.2.0.is_some() && *short != first.2.0;
            if short_differs || kind(long, value) != kind(long, &first.2.1) {
                differ.push(format!("--{long} of `{path}` and of `{}`", first.1));
            }
        }
        let letters = |letter| {
            let longs = found.iter().filter(|row| row.2.0 == Some(letter));
            longs
                .map(|row| row.0.clone())
                .collect::<std::collections::BTreeSet<_>>()
        };
        for letter in 'a'..='z' {
            let longs = letters(letter);
            if longs.len() > 1 {
                differ.push(format!("-{letter} is {longs:?}"));
            }
        }
        assert!(differ.is_empty(), "{differ:#?}");
    }
}
