//! The commands that the pages show, run as they are shown, page by page, each page in a folder of its own.
//!
//! The word after `sh` says what a block needs. Blocks without a word run as they stand. Blocks that take long run in a short form. In a
//! `background` block, lines that end in `&` run beside the others. The options of the rest must exist. A `toml` block with a file name is written to the folder first.

use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

use crate::rig::{Done, Folder, command, rb};

/// A shown block: the words of its fence, and its lines.
struct Block {
    fence: Vec<String>,
    lines: Vec<String>,
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn blocks(page: &Path) -> Vec<Block> {
    let text = std::fs::read_to_string(page).unwrap();
    let mut found: Vec<Block> = Vec::new();
    let mut inside = false;
    for line in text.lines().map(str::trim) {
        if let Some(fence) = line.strip_prefix("```") {
            inside = !inside;
            if inside {
                let fence = fence.split_whitespace().map(str::to_owned).collect();
                found.push(Block {
                    fence,
                    lines: Vec::new(),
                });
            }
        } else if inside {
            found.last_mut().unwrap().lines.push(line.to_owned());
        }
    }
    found
}

/// Pages below a folder of `docs/`, in order.
fn pages(folder: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(root().join("docs").join(folder)).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    let mut pages: Vec<PathBuf> = paths
        .filter(|p| p.extension().is_some_and(|e| e == "md"))
        .collect();
    pages.sort();
    pages
}

fn copy(from: &Path, to: &Path, wanted: impl Fn(&str) -> bool) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_file() && wanted(&name) {
            std::fs::copy(&path, to.join(name)).unwrap();
        }
    }
}

/// What a reader in the folder of the repository has at hand, and small settings for the short forms.
fn workspace() -> Folder {
    let folder = Folder::new("docs");
    copy(&root().join("gaits"), &folder.path("gaits"), |_| true);
    let two = |name: &str| ["g01.toml", "g03.toml"].contains(&name);
    copy(
        &root().join("gaits/searched"),
        &folder.path("gaits/searched"),
        two,
    );
    copy(
        &root().join("examples/servo"),
        &folder.path("examples/servo"),
        |_| true,
    );
    std::fs::create_dir(folder.path("mine")).unwrap();
    for (take, name) in [
        ("motion1_take1", "slow_sine"),
        ("motion2_take1", "steps"),
        ("motion3_take1", "chirp"),
    ] {
        let from = root().join(format!("examples/servo/{take}.csv"));
        std::fs::copy(from, folder.path(&format!("mine/{name}.csv"))).unwrap();
    }
    folder.write("small-search.toml", SMALL_SEARCH);
    folder.write("small-hybrid.toml", SMALL_HYBRID);
    folder
}

const SMALL_SEARCH: &str = "\
format = 1
particles = 8
iterations = 2
[space]
duration_s = 2
[score]
repetitions = 2
[select]
count = 2
best = 1
training = 1
";
const SMALL_HYBRID: &str = "\
format = 1
repeats = 2
[search]
particles = 6
iterations = 2
[search.space]
duration_s = 2
[search.score]
repetitions = 2
[search.select]
count = 2
best = 1
training = 1
[match]
particles = 3
iterations = 1
rows = \"3\"
";
/// Short forms of commands that take long: what is replaced, and by what.
const SHORT: &[(&str, &str)] = &[
    (
        "optimise gait -o search",
        "optimise gait -o search --settings small-search.toml",
    ),
    (
        "search --settings small-search.toml --resume",
        "search --resume",
    ),
    ("emulate films", "emulate films --repeat 2 -d 2s"),
    (
        "--training g01,g03,g06,g09,g12,g15",
        "--training g01 --particles 3 --iterations 1 --rows 3",
    ),
    (
        "hybrid -o cycle",
        "hybrid -o cycle --settings small-hybrid.toml",
    ),
    (
        "cycle --settings small-hybrid.toml --resume",
        "cycle --resume",
    ),
    ("--cycles 3", "--cycles 2"),
    ("--at 12s", "--at 1s"),
];

/// The arguments of a shown `rb-host` line: quoted words are one, and `*.toml` is every such file.
fn arguments(folder: &Folder, line: &str) -> Vec<String> {
    let line = line
        .split("  #")
        .next()
        .unwrap()
        .trim()
        .trim_end_matches(" &");
    let mut found = Vec::new();
    for (index, part) in line.split('"').enumerate() {
        if index % 2 == 1 {
            found.push(part.to_owned());
            continue;
        }
        for word in part.split_whitespace() {
            let Some(parent) = word.strip_suffix("/*.toml") else {
                found.push(word.to_owned());
                continue;
            };
            let entries = std::fs::read_dir(folder.path(parent)).unwrap();
            let names = entries.map(|e| e.unwrap().file_name().to_string_lossy().into_owned());
            let mut files: Vec<String> = names
                .filter(|name| name.ends_with(".toml"))
                .map(|name| format!("{parent}/{name}"))
                .collect();
            files.sort();
            found.extend(files);
        }
    }
    found.split_off(1)
}

fn run(folder: &Folder, line: &str) -> Done {
    let arguments = arguments(folder, line);
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    rb(folder, &words)
}

/// Whether every option of the line exists: help is printed in place of the work.
fn parses(folder: &Folder, line: &str) {
    let done = run(
        folder,
        &format!(
            "{} --help",
            line.split("  #")
                .next()
                .unwrap()
                .trim_end_matches(" &")
                .replace("*.toml", "a.toml")
        ),
    );
    assert_eq!(done.code, 0, "{line}: {}", done.err);
}

/// Processes that end with the test.
struct Running(Vec<Child>);

impl Drop for Running {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Lines that end in `&` run beside the others, on a port that is free.
fn together<'a>(folder: &Folder, lines: impl Iterator<Item = &'a String>) {
    const SHOWN: &str = "127.0.0.1:5000";
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr();
    let address = free.unwrap().to_string();
    let mut beside = Running(Vec::new());
    for line in lines {
        let line = line.replace(SHOWN, &address);
        if !line.ends_with(" &") {
            let done = run(folder, &line);
            assert_eq!(done.code, 0, "{line}: {}", done.err);
            continue;
        }
        let arguments = arguments(folder, &line);
        let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let mut child = command(folder, &words)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        // Its first line says that it is ready.
        let mut said = String::new();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        out.read_line(&mut said).unwrap();
        beside.0.push(child);
        assert!(!said.is_empty(), "{line} said nothing");
    }
}

fn follow(page: &Path) -> Folder {
    let folder = workspace();
    let name = page.display();
    for block in blocks(page) {
        let fence: Vec<&str> = block.fence.iter().map(String::as_str).collect();
        let shown = block
            .lines
            .iter()
            .filter(|line| line.starts_with("rb-host "));
        match fence.as_slice() {
            ["toml", file] => drop(folder.write(file, block.lines.join("\n"))),
            ["sh"] => {
                for line in block.lines.iter().filter(|line| !line.is_empty()) {
                    assert!(
                        line.starts_with("rb-host "),
                        "{name}: a reader cannot run `{line}` here"
                    );
                    let done = run(&folder, line);
                    assert_eq!(done.code, 0, "{name}: {line}: {}", done.err);
                }
            }
            ["sh", "long"] => {
                for line in shown {
                    let short = SHORT
                        .iter()
                        .fold(line.clone(), |text, (from, to)| text.replace(from, to));
                    let done = run(&folder, &short);
                    assert_eq!(done.code, 0, "{name}: {short}: {}", done.err);
                }
            }
            ["sh", "background"] if cfg!(unix) => together(&folder, shown),
            ["sh", "hardware" | "install" | "developer" | "background"] => {
                shown.for_each(|line| parses(&folder, line))
            }
            ["sh", ..] => panic!("{name}: unknown fence {fence:?}"),
            _ => {}
        }
    }
    folder
}

#[test]
fn the_tutorials_can_be_followed_word_by_word() {
    let pages = pages("tutorial");
    let folders: Vec<Folder> = pages.iter().map(|page| follow(page)).collect();
    // What the second tutorial says of its example.
    let named = folders
        .iter()
        .find_map(|folder| std::fs::read_to_string(folder.path("servo.toml")).ok());
    assert!(named.unwrap().contains("coulomb_friction"));
}

#[test]
fn commands_of_the_how_to_pages_run() {
    pages("how-to").iter().for_each(|page| drop(follow(page)));
}

#[test]
fn commands_of_the_other_pages_run() {
    let others = ["reference", "explanation"]
        .iter()
        .flat_map(|folder| pages(folder));
    others.for_each(|page| drop(follow(&page)));
    follow(&root().join("README.md"));
}

#[test]
fn the_reference_of_commands_is_the_command_line() {
    let written = rb(&Folder::new("docs-commands"), &["man", "--markdown"])
        .expect(0)
        .out;
    let page = std::fs::read_to_string(root().join("docs/reference/commands.md")).unwrap();
    let differs = written
        .lines()
        .zip(page.lines())
        .find(|(new, old)| new != old);
    assert!(
        written == page,
        "run `rb-host man --markdown > docs/reference/commands.md`; first difference: {differs:?}"
    );
}
