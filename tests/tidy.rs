//! The workspace keeps the promises its documents make about it.

use serde_json::Value;
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::process::Command;
use tests::root;

/// All packages of the lock file. Those of other platforms are fetched where no build has needed them yet.
fn metadata() -> Value {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--locked"])
        .current_dir(root())
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Names of all crates `start` reaches by normal and build dependencies.
fn reaches(metadata: &Value, start: &str) -> BTreeSet<String> {
    let nodes = metadata["resolve"]["nodes"].as_array().unwrap();
    let name = |id: &Value| {
        let package = metadata["packages"]
            .as_array()
            .unwrap()
            .iter()
            .find(|p| p["id"] == *id);
        package.unwrap()["name"].as_str().unwrap().to_owned()
    };
    let start = nodes
        .iter()
        .find(|node| name(&node["id"]) == start)
        .unwrap();
    let (mut open, mut seen) = (vec![start["id"].clone()], BTreeSet::new());
    while let Some(id) = open.pop() {
        if !seen.insert(id.as_str().unwrap().to_owned()) {
            continue;
        }
        let node = nodes.iter().find(|node| node["id"] == id).unwrap();
        for dependency in node["deps"].as_array().unwrap() {
            let kinds = dependency["dep_kinds"].as_array().unwrap();
            if kinds.iter().any(|kind| kind["kind"] != "dev") {
                open.push(dependency["pkg"].clone());
            }
        }
    }
    seen.iter()
        .map(|id| name(&Value::from(id.as_str())))
        .collect()
}

fn members(metadata: &Value) -> Vec<(String, PathBuf)> {
    let ids = metadata["workspace_members"].as_array().unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    let of = |id: &Value| {
        packages
            .iter()
            .find(|package| package["id"] == *id)
            .unwrap()
    };
    ids.iter()
        .map(|id| {
            let manifest = PathBuf::from(of(id)["manifest_path"].as_str().unwrap());
            (
                of(id)["name"].as_str().unwrap().to_owned(),
                manifest.parent().unwrap().to_path_buf(),
            )
        })
        .collect()
}

/// Files git tracks, as (path from the root, text); binary files are left out.
fn tracked_texts() -> Vec<(String, String)> {
    let output = Command::new("git")
        .args(["ls-files", "-z"])
        .current_dir(root())
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "the tidy test needs a git checkout"
    );
    let names = String::from_utf8(output.stdout).unwrap();
    names
        .split_terminator('\0')
        .filter_map(|name| {
            Some((
                name.to_owned(),
                std::fs::read_to_string(root().join(name)).ok()?,
            ))
        })
        .collect()
}

#[test]
fn the_architecture_page_names_every_crate() {
    let text = std::fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    for (name, folder) in members(&metadata()) {
        let folder = folder.strip_prefix(root()).unwrap().display().to_string();
        assert!(
            text.contains(&format!("`{folder}/`")),
            "ARCHITECTURE.md does not name `{folder}/` ({name})"
        );
    }
}

#[test]
fn folders_the_architecture_page_names_exist() {
    let text = std::fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    for word in text
        .split('`')
        .skip(1)
        .step_by(2)
        .filter(|word| word.ends_with('/') && !word.contains(' '))
    {
        assert!(
            root().join(word).is_dir(),
            "ARCHITECTURE.md names `{word}`, which is no folder"
        );
    }
}

#[test]
fn what_the_page_for_contributors_names_exists() {
    let text = std::fs::read_to_string(root().join("CONTRIBUTING.md")).unwrap();
    let prose: String = text.split("```").step_by(2).collect();
    // What commands make below `target/` is not in a fresh clone.
    let made = |path: &&str| path.starts_with("target/");
    for path in named_paths(&prose).into_iter().filter(|path| !made(path)) {
        // A new file stands in a folder that is there.
        let known = path.split("NAME").next().unwrap();
        assert!(
            root().join(known).exists(),
            "CONTRIBUTING.md names `{path}`"
        );
    }
    let commands = std::fs::read_to_string(root().join("xtask/src/main.rs")).unwrap();
    for rest in text.split("cargo xtask ").skip(1) {
        let word: String = rest.chars().take_while(char::is_ascii_lowercase).collect();
        assert!(
            commands.contains(&format!("Some(\"{word}\")")),
            "CONTRIBUTING.md names `cargo xtask {word}`"
        );
    }
}

/// What makes test data is a program of its own.
#[test]
fn the_host_tool_reaches_no_generator_of_test_data() {
    assert!(!reaches(&metadata(), "host").contains("trials"));
}

/// The diagnosis must not be able to see the truth, nor the code that generates it.
#[test]
fn the_diagnosis_reaches_no_crate_that_makes_test_data() {
    let reached = reaches(&metadata(), "gap");
    for forbidden in ["hil-sim", "trials", "firmware", "tests", "host"] {
        assert!(!reached.contains(forbidden), "gap depends on {forbidden}");
    }
}

#[test]
fn core_crates_reach_no_port_and_no_terminal() {
    let metadata = metadata();
    for core in [
        "control", "protocol", "files", "physics", "swarm", "camera", "optimise", "gap",
    ] {
        let reached = reaches(&metadata, core);
        for forbidden in [
            "serialport",
            "ctrlc",
            "clap",
            "indicatif",
            "firmware",
            "hil-sim",
        ] {
            assert!(
                !reached.contains(forbidden),
                "{core} depends on {forbidden}"
            );
        }
    }
}

/// Lines with their indices, without comments, of a file of a core crate; none of any other file.
fn core_lines<'a>(file: &str, text: &'a str) -> impl Iterator<Item = (usize, &'a str)> {
    const CORE: [&str; 8] = [
        "control/src",
        "protocol/src",
        "files/src",
        "physics/src",
        "swarm/src",
        "camera/src",
        "optimise/src",
        "gap/src",
    ];
    let core = file.ends_with(".rs") && CORE.iter().any(|folder| file.starts_with(folder));
    let lines = text.lines().enumerate().filter(move |_| core);
    lines.filter(|(_, line)| !line.trim_start().starts_with("//"))
}

/// Functions whose last bits hang on the platform: `libm` or our own stand in for them in core crates.
#[test]
fn core_crates_use_no_arithmetic_of_the_platform() {
    const FUNCTIONS: [&str; 25] = [
        "sin", "cos", "tan", "sin_cos", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh",
        "asinh", "acosh", "atanh", "exp", "exp2", "exp_m1", "ln", "ln_1p", "log", "log2", "log10",
        "powf", "cbrt", "hypot",
    ];
    // Scripts of the report's page, and the lanes' own sine.
    let other = |file: &str, line: &str, function: &str| {
        line.contains("Math.") || (function == "sin_cos" && file.starts_with("physics/src/engine/"))
    };
    let calls = |line: &str, function: &str| {
        let passed = |of: &str| {
            let name = format!("{of}{function}");
            let mut rest = line.split(&name).skip(1);
            rest.any(|rest| !rest.starts_with(|c: char| c.is_alphanumeric() || c == '_'))
        };
        line.contains(&format!(".{function}(")) || passed("f32::") || passed("f64::")
    };
    for (file, text) in tracked_texts() {
        for (number, line) in core_lines(&file, &text) {
            for function in FUNCTIONS {
                assert!(
                    !calls(line, function) || other(&file, line, function),
                    "{file}:{}: {function} of the platform; use libm::{function}",
                    number + 1
                );
            }
        }
    }
}

/// Words a core crate must not contain outside comments: clocks, files, environment.
#[test]
fn core_crates_read_no_clock_file_or_environment() {
    const FORBIDDEN: &[&str] = &[
        "std::time::",
        "Instant::now",
        "SystemTime",
        "std::fs",
        "std::env::",
        "std::net",
        "std::process",
        "thread_rng",
        "from_os_rng",
    ];
    for (file, text) in tracked_texts() {
        for (number, line) in core_lines(&file, &text) {
            let hit = FORBIDDEN.iter().find(|word| line.contains(**word));
            assert!(
                hit.is_none(),
                "{file}:{}: {} in a core crate",
                number + 1,
                hit.unwrap()
            );
        }
    }
}

#[test]
fn nothing_is_left_open_or_switched_off() {
    // Spelt in two halves so that this file does not find itself.
    let marks = [
        ["TO", "DO"],
        ["FIX", "ME"],
        ["#[ign", "ore"],
        ["unimple", "mented!("],
        ["to", "do!("],
    ]
    .map(|m| m.concat());
    for (file, text) in tracked_texts()
        .into_iter()
        .filter(|(file, _)| file.ends_with(".rs"))
    {
        for mark in &marks {
            assert!(!text.contains(mark.as_str()), "{file} contains {mark}");
        }
    }
}

/// Files and folders that `text` names between backticks.
fn named_paths(text: &str) -> Vec<&str> {
    let quoted = text.split('`').skip(1).step_by(2);
    quoted
        .filter(|t| t.contains('/') && !t.contains([' ', '<', '*']))
        .collect()
}

/// Text of a file, or of every Rust file below a folder.
fn source(path: &std::path::Path) -> String {
    if path.is_file() {
        return std::fs::read_to_string(path).unwrap();
    }
    let mut entries: Vec<PathBuf> = std::fs::read_dir(path)
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    entries.sort();
    let rust = |p: &PathBuf| p.is_dir() || p.extension().is_some_and(|x| x == "rs");
    entries
        .iter()
        .filter(|p| rust(p))
        .map(|p| source(p))
        .collect()
}

#[test]
fn the_page_on_effects_names_the_places_where_they_are() {
    use files::effects::{Effect, Stage};
    let page = std::fs::read_to_string(root().join("docs/how-to/add-an-effect.md")).unwrap();
    for path in named_paths(&page) {
        assert!(root().join(path).exists(), "{path} does not exist");
    }
    let of = |place: &str| -> String {
        let row = page
            .lines()
            .find(|l| l.starts_with(&format!("| {place} |")));
        let row = row.unwrap_or_else(|| panic!("no place `{place}`"));
        named_paths(row)
            .iter()
            .map(|p| source(&root().join(p)))
            .collect()
    };
    let [registry, simulator, diagnosis, generator] =
        ["registry", "simulator", "diagnosis", "generator"].map(of);
    for effect in Effect::ALL {
        let variant = format!("Effect::{effect:?}");
        let whole = |text: &str| {
            let mut ends = text
                .match_indices(&variant)
                .map(|(at, v)| &text[at + v.len()..]);
            ends.any(|rest| !rest.starts_with(|c: char| c.is_alphanumeric()))
        };
        assert!(whole(&registry), "{variant} has no row");
        let forces = [Stage::Drivetrain, Stage::Transmission, Stage::Body];
        let simulated = !forces.contains(&effect.stage()) || whole(&simulator);
        assert!(simulated, "the simulator lacks {variant}");
        assert!(whole(&diagnosis), "the diagnosis lacks {variant}");
        let name = format!("\"{}\"", effect.name());
        assert!(generator.contains(&name), "no generator plays {name}");
    }
}

/// Every promise of the threat model names its test.
#[test]
fn tests_that_the_threat_model_names_exist() {
    let texts = tracked_texts();
    let page = &texts
        .iter()
        .find(|(name, _)| name == "docs/explanation/threat-model.md")
        .unwrap()
        .1;
    let rows = page.lines().filter(|line| line.starts_with("| "));
    let names: Vec<&str> = rows
        .filter_map(|row| row.trim_end_matches(" |").rsplit(" | ").next())
        .filter_map(|cell| cell.strip_prefix('`')?.strip_suffix('`'))
        .collect();
    assert!(names.len() >= 14, "{names:?}");
    for name in names {
        let wanted = format!("fn {name}(");
        let is_there =
            |(file, text): &(String, String)| file.ends_with(".rs") && text.contains(&wanted);
        assert!(texts.iter().any(is_there), "{name}");
    }
}

#[test]
fn links_between_the_documents_lead_somewhere() {
    for (file, text) in tracked_texts()
        .into_iter()
        .filter(|(file, _)| file.ends_with(".md"))
    {
        let folder = root().join(&file).parent().unwrap().to_path_buf();
        for target in text
            .split("](")
            .skip(1)
            .filter_map(|rest| rest.split(')').next())
        {
            let target = target.split('#').next().unwrap();
            if target.is_empty() || target.contains("://") || target.contains(' ') {
                continue;
            }
            assert!(
                folder.join(target).exists(),
                "{file} links to {target}, which does not exist"
            );
        }
    }
}

#[test]
fn pages_that_sources_name_exist() {
    let sources = |(file, _): &(String, String)| file.ends_with(".rs") || file.ends_with(".py");
    for (file, text) in tracked_texts().into_iter().filter(sources) {
        let words = text.split(|c: char| !(c.is_ascii_alphanumeric() || "/._-".contains(c)));
        let pages = words.filter(|w| w.starts_with("docs/") && w.ends_with(".md"));
        for page in pages {
            assert!(
                root().join(page).exists(),
                "{file} names {page}, which does not exist"
            );
        }
    }
}
