//! What the checks need beyond Rust and a C compiler: installed where this user may, otherwise named exactly.

use crate::sh;
use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};

/// The QEMU whose object layouts the plug-in knows; the `b-l475e-iot01a` machine itself works from 9.1 on.
const QEMU_OLDEST: (u32, u32) = (10, 0);

/// What the set-up found or installed, and what is missing with the reason.
#[derive(Default)]
pub(crate) struct Report {
    ready: Vec<String>,
    missing: Vec<(String, String)>,
}

impl Report {
    /// Tell the user; what is missing comes last, with what to do.
    pub(crate) fn print(&self) {
        for line in &self.ready {
            eprintln!("ready    {line}");
        }
        for (what, remedy) in &self.missing {
            eprintln!("MISSING  {what}: tests that need it are skipped. {remedy}");
        }
    }

    fn add(&mut self, what: &str, result: Result<String>) {
        match result {
            Ok(found) => self.ready.push(format!("{what}: {found}")),
            Err(error) => self.missing.push((what.into(), format!("{error:#}"))),
        }
    }
}

/// Set up everything; only a missing Rust target is an error, the rest is reported.
pub(crate) fn run() -> Result<Report> {
    rust_target()?;
    let mut report = Report::default();
    report.add("QEMU", qemu());
    report.add("Python clients", python_clients());
    report.add("Chromium", debian_tool("chromium", "chromium"));
    report.add("mdBook", crate::site::mdbook());
    Ok(report)
}

/// The Cortex-M4F target of the firmware.
pub(crate) fn rust_target() -> Result<()> {
    let installed = sh::output("rustup", &["target", "list", "--installed"])
        .context("rustup is needed (https://rustup.rs)")?;
    if installed
        .lines()
        .any(|line| line == "thumbv7em-none-eabihf")
    {
        return Ok(());
    }
    sh::run("rustup", &["target", "add", "thumbv7em-none-eabihf"])
}

fn qemu() -> Result<String> {
    if let Some(version) = qemu_version().filter(|&version| version >= QEMU_OLDEST) {
        return Ok(format!("{}.{}", version.0, version.1));
    }
    let release = debian_release()?;
    let package = "qemu-system-arm";
    if release == "bookworm" {
        let suite = format!("{release}-backports");
        require_root(&format!(
            "as root: add the suite {suite} of your Debian mirror to the apt sources, then \
             `apt-get update && apt-get install -t {suite} {package}`"
        ))?;
        add_backports(&release, &suite)?;
        sh::run("apt-get", &["update", "-q"])?;
        apt_install(&["-t", &suite, package])?;
    } else {
        require_root(&format!("as root: `apt-get install {package}`"))?;
        apt_install(&[package])?;
    }
    match qemu_version() {
        Some(version) if version >= QEMU_OLDEST => Ok(format!("{}.{}", version.0, version.1)),
        found => bail!("QEMU >= 10.0 is needed, this system's package manager gave {found:?}"),
    }
}

fn qemu_version() -> Option<(u32, u32)> {
    let text = sh::output("qemu-system-arm", &["--version"]).ok()?;
    let version = text.split("version ").nth(1)?;
    let mut numbers = version.split(|c: char| !c.is_ascii_digit());
    Some((numbers.next()?.parse().ok()?, numbers.next()?.parse().ok()?))
}

fn debian_release() -> Result<String> {
    let text = std::fs::read_to_string("/etc/os-release").unwrap_or_default();
    let value = |key: &str| {
        let line = text.lines().find_map(|line| line.strip_prefix(key));
        line.map(|value| value.trim_matches('"').to_owned())
    };
    match (value("ID="), value("VERSION_CODENAME=")) {
        (Some(id), Some(codename)) if id == "debian" || id == "ubuntu" => Ok(codename),
        _ => bail!("install QEMU 10 with the Arm system emulator and plug-in support yourself"),
    }
}

/// Write an apt source for `suite` at the mirror that already serves `release`.
fn add_backports(release: &str, suite: &str) -> Result<()> {
    let folder = Path::new("/etc/apt/sources.list.d");
    let mut files: Vec<PathBuf> = vec!["/etc/apt/sources.list".into()];
    if let Ok(entries) = std::fs::read_dir(folder) {
        files.extend(entries.flatten().map(|entry| entry.path()));
    }
    let texts: Vec<String> = files
        .iter()
        .filter_map(|file| std::fs::read_to_string(file).ok())
        .collect();
    if texts.iter().any(|text| text.contains(suite)) {
        return Ok(());
    }
    let mirror = texts
        .iter()
        .find_map(|text| mirror_of(text, release))
        .with_context(|| format!("no apt source serves {release}; add {suite} by hand"))?;
    let file = folder.join(format!("{suite}.list"));
    std::fs::write(&file, format!("deb {mirror} {suite} main\n"))
        .with_context(|| format!("cannot write {}", file.display()))
}

/// The mirror address of `release` in an apt source file of either format.
fn mirror_of(text: &str, release: &str) -> Option<String> {
    let one_line = text.lines().find_map(|line| {
        let words: Vec<&str> = line
            .split_whitespace()
            .filter(|w| !w.starts_with('['))
            .collect();
        match words.as_slice() {
            ["deb", uri, suite, ..] if *suite == release => Some((*uri).to_owned()),
            _ => None,
        }
    });
    one_line.or_else(|| {
        text.split("\n\n").find_map(|stanza| {
            let field = |key: &str| stanza.lines().find_map(|line| line.strip_prefix(key));
            let serves = field("Suites:")?
                .split_whitespace()
                .any(|suite| suite == release);
            serves.then(|| field("URIs:").map(|uri| uri.trim().to_owned()))?
        })
    })
}

fn debian_tool(program: &str, package: &str) -> Result<String> {
    let found = || sh::output(program, &["--version"]).ok();
    if let Some(version) = found() {
        return Ok(version.trim().to_owned());
    }
    require_root(&format!("as root: `apt-get install {package}`"))?;
    apt_install(&[package])?;
    found()
        .map(|version| version.trim().to_owned())
        .context("installed, but it does not start")
}

fn apt_install(arguments: &[&str]) -> Result<()> {
    let mut command = sh::command(
        "apt-get",
        &["install", "-y", "-q", "--no-install-recommends"],
    );
    command
        .args(arguments)
        .env("DEBIAN_FRONTEND", "noninteractive");
    sh::run_command(command)
}

fn require_root(remedy: &str) -> Result<()> {
    let user = sh::output("id", &["-u"]).unwrap_or_default();
    let has_apt = sh::output("apt-get", &["--version"]).is_ok();
    if user.trim() == "0" && has_apt {
        Ok(())
    } else {
        bail!("{remedy}")
    }
}

/// Other physics engines for the benchmark and for joints that another engine plays. A machine without them skips both.
fn engines(python: &str) {
    let here = std::process::Command::new(python)
        .args(["-c", "import mujoco, numpy"])
        .output();
    if here.is_ok_and(|o| o.status.success()) {
        return;
    }
    let file = sh::root().join("tests/foreign/engines.txt");
    let file = file.to_string_lossy();
    let quiet = ["-m", "pip", "install", "-q", "--disable-pip-version-check"];
    if sh::run(python, &[&quiet[..], &["-r", &file]].concat()).is_err() {
        eprintln!("LEFT OUT: {file} could not be installed; what needs MuJoCo is skipped");
    }
}

/// A virtual environment with the foreign clients the conformance tests drive.
fn python_clients() -> Result<String> {
    let venv = sh::target_dir().join("venv");
    let python = venv.join("bin/python");
    let requirements = sh::root().join("tests/foreign/requirements.txt");
    let wanted =
        std::fs::read_to_string(&requirements).context("tests/foreign/requirements.txt")?;
    let stamp = venv.join("requirements.installed");
    if std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == wanted) {
        engines(&python.to_string_lossy());
        return Ok(venv.display().to_string());
    }
    let venv_text = venv.to_string_lossy().into_owned();
    if sh::run("python3", &["-m", "venv", &venv_text]).is_err() {
        require_root("install python3 with its venv module (Debian: python3-venv)")?;
        apt_install(&["python3-venv"])?;
        sh::run("python3", &["-m", "venv", &venv_text])?;
    }
    let (python, file) = (python.to_string_lossy(), requirements.to_string_lossy());
    sh::run(
        &python,
        &[
            "-m",
            "pip",
            "install",
            "-q",
            "--disable-pip-version-check",
            "-r",
            &file,
        ],
    )?;
    engines(&python);
    std::fs::write(&stamp, wanted)?;
    Ok(venv_text)
}
