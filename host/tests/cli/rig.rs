//! Runs rb-host in a folder of its own with a clean environment.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};

/// A folder that is removed at the end.
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new(name: &str) -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let base = Path::new(env!("CARGO_TARGET_TMPDIR"));
        let path = base.join(format!("{name}-{}-{number}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    pub(crate) fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// What a command line did.
#[derive(Debug)]
pub(crate) struct Done {
    pub(crate) code: i32,
    pub(crate) out: String,
    pub(crate) err: String,
}

/// The published schema of what calls itself `name`.
fn published(name: &str) -> Option<serde_json::Value> {
    let file = match name {
        "rb.gap/1" => "gap-1.json",
        "rb.gap/2" => "gap-2.json",
        _ => return None,
    };
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/schema");
    let text = std::fs::read_to_string(path.join(file)).unwrap();
    Some(serde_json::from_str(&text).unwrap())
}

impl Done {
    /// What was printed; a verdict is held to its published schema.
    #[track_caller]
    pub(crate) fn json(&self) -> serde_json::Value {
        let last = self.out.lines().last().unwrap_or_default();
        let value: serde_json::Value =
            serde_json::from_str(last).unwrap_or_else(|e| panic!("{e}: {self:?}"));
        if let Some(schema) = value["schema"].as_str().and_then(published) {
            let valid = jsonschema::validate(&schema, &value);
            assert!(valid.is_ok(), "{valid:?}\n{value}");
        }
        value
    }

    #[track_caller]
    pub(crate) fn expect(self, code: i32) -> Self {
        assert_eq!(self.code, code, "{}\n{}", self.out, self.err);
        self
    }
}

pub(crate) fn command(folder: &Folder, args: &[&str]) -> Command {
    // `INSTALLED_RB_HOST=/path/rb-host` runs these tests with an installed program.
    let installed = std::env::var_os("INSTALLED_RB_HOST");
    let mut command = Command::new(installed.unwrap_or(env!("CARGO_BIN_EXE_rb-host").into()));
    for (name, _) in std::env::vars() {
        if name.starts_with("RB_") {
            command.env_remove(name);
        }
    }
    command
        .env("HOME", &folder.0)
        .env("XDG_CONFIG_HOME", &folder.0)
        .env("NO_COLOR", "1");
    command
        .current_dir(&folder.0)
        .args(args)
        .stdin(Stdio::null());
    command
}

pub(crate) fn rb(folder: &Folder, args: &[&str]) -> Done {
    finish(command(folder, args).output().unwrap())
}

pub(crate) fn finish(output: std::process::Output) -> Done {
    Done {
        code: output.status.code().unwrap_or(-1),
        out: String::from_utf8_lossy(&output.stdout).into_owned(),
        err: String::from_utf8_lossy(&output.stderr).into_owned(),
    }
}

/// Says aloud that a test could not run; on a CI machine (`CI=true`) that is a failure.
pub(crate) fn skip(test: &str, reason: &str) {
    println!("SKIPPED {test}: {reason}");
    eprintln!("SKIPPED {test}: {reason}");
    assert_ne!(
        std::env::var("CI").as_deref(),
        Ok("true"),
        "{test}: {reason}"
    );
}

/// A shipped gait file.
pub(crate) fn gait(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../gaits")
        .join(name);
    path.display().to_string()
}

/// The emulated robot in a process of its own, on a TCP port of its own.
pub(crate) struct Emulator {
    child: Child,
    pub(crate) address: String,
}

impl Emulator {
    pub(crate) fn start(folder: &Folder) -> Self {
        Self::start_with(folder, &[])
    }

    /// With more arguments.
    pub(crate) fn start_with(folder: &Folder, extra: &[&str]) -> Self {
        let args = [
            "emulate",
            "robot",
            "--tcp",
            "127.0.0.1:0",
            "--json",
            "--quiet",
        ];
        let mut child = command(folder, &[&args, extra].concat())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap())
            .read_line(&mut line)
            .unwrap();
        let ready: serde_json::Value = serde_json::from_str(&line).unwrap();
        let uri = ready["address"].as_str().unwrap();
        Self {
            child,
            address: uri.trim_start_matches("tcp://").to_owned(),
        }
    }

    /// Ctrl-C, and wait until it has ended.
    pub(crate) fn interrupt(mut self) {
        let id = self.child.id().to_string();
        let sent = Command::new("kill").args(["-INT", &id]).status().unwrap();
        assert!(sent.success() && self.child.wait().unwrap().success());
    }

    pub(crate) fn uri(&self) -> String {
        format!("tcp://{}", self.address)
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Runs `rb-trials` with these arguments in this process; those that begin with `./` are files of the folder.
pub(crate) fn trials(folder: &Folder, args: &[&str]) -> Result<(), String> {
    let own = |a: &&str| match a.strip_prefix("./") {
        Some(name) => folder.path(name).to_string_lossy().into_owned(),
        None => (*a).to_owned(),
    };
    let line = std::iter::once("rb-trials".to_owned()).chain(args.iter().map(own));
    let cli = <trials::cli::Cli as clap::Parser>::try_parse_from(line);
    let cli = cli.map_err(|e| e.to_string())?;
    trials::cli::run(&cli).map_err(|e| format!("{e:#}"))
}
