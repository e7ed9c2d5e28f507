//! The commands shown in the documentation, run as shown. Pages that need a device are left to a person.

use std::path::Path;

use crate::rig::{Folder, rb};

/// Commands of the `sh` blocks of a page, without comments.
fn commands(page: &str) -> Vec<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../docs")
        .join(page);
    let text = std::fs::read_to_string(path).unwrap();
    let mut inside = false;
    let mut found = Vec::new();
    for line in text.lines() {
        if line.starts_with("```") {
            inside = line == "```sh";
        } else if inside && line.starts_with("rb-host ") {
            found.push(line.split("  #").next().unwrap_or(line).trim().to_owned());
        }
    }
    found
}

/// Needs a device, another program or a film of a robot.
fn needs_more(command: &str) -> bool {
    [" &", "tcp://", "./bus", "/dev/", "my-film"]
        .iter()
        .any(|word| command.contains(word))
}

#[test]
fn shown_commands_run() {
    for page in [
        "tutorial/first-gait.md",
        "how-to/record.md",
        "reference/command-line.md",
    ] {
        let folder = Folder::new("docs");
        std::fs::create_dir(folder.path("gaits")).unwrap();
        for entry in
            std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("../gaits")).unwrap()
        {
            let path = entry.unwrap().path();
            if path.is_dir() {
                continue;
            }
            std::fs::copy(&path, folder.path("gaits").join(path.file_name().unwrap())).unwrap();
        }
        folder.write("ground.toml", "format = 1\nbody = \"ground\"\n");
        let commands = commands(page);
        assert!(!commands.is_empty(), "{page}");
        for command in commands.iter().filter(|c| !needs_more(c)) {
            let args: Vec<&str> = command.split_whitespace().skip(1).collect();
            let done = rb(&folder, &args);
            assert_eq!(done.code, 0, "{page}: {command}: {}", done.err);
        }
    }
}
