//! `cargo xtask release`: what a user installs, in `target/dist/`.
//!
//! The archives hold no clock: files are dated by `SOURCE_DATE_EPOCH`, or by the last commit.

use crate::{elf, images, sbom, sh};
use anyhow::{Context, Result, ensure};
use std::path::{Path, PathBuf};

/// Completion scripts: the shell, and where its package keeps them.
const COMPLETIONS: &[(&str, &str)] = &[
    ("bash", "share/bash-completion/completions/rb-host"),
    ("zsh", "share/zsh/vendor-completions/_rb-host"),
    ("fish", "share/fish/vendor_completions.d/rb-host.fish"),
];
/// Files and folders that go into `share/doc/rb-host`.
const DOCUMENTS: &[&str] = &[
    "README.md",
    "CHANGELOG.md",
    "CITATION.cff",
    "LICENSE-APACHE",
    "LICENSE-MIT",
    "docs",
    "examples",
    "gaits",
    "robots",
];

/// Build everything, then the archives, the Debian package, the parts list and the checksums.
pub(crate) fn run() -> Result<()> {
    let version = env!("CARGO_PKG_VERSION");
    let dist = sh::target_dir().join("dist");
    if dist.exists() {
        std::fs::remove_dir_all(&dist)?;
    }
    std::fs::create_dir_all(&dist)?;
    sh::run(
        "cargo",
        &["build", "--release", "--locked", "--package", "host"],
    )?;
    images::default_image()?;

    let host = format!("rb-host-{version}-{}-linux", std::env::consts::ARCH);
    let tree = dist.join(&host);
    let date = source_date()?;
    host_tree(&tree)?;
    archive(&dist, &host, &date)?;
    let firmware = format!("rb-firmware-{version}-stm32l475vg");
    firmware_tree(&dist.join(&firmware))?;
    archive(&dist, &firmware, &date)?;
    debian(&dist, &tree, version, &date)?;
    for package in ["host", "firmware"] {
        let name = dist.join(format!("rb-{package}-{version}.cdx.json"));
        std::fs::write(name, sbom::write(package)?)?;
    }
    for folder in [host, firmware] {
        std::fs::remove_dir_all(dist.join(folder))?;
    }
    checksums(&dist)?;
    eprintln!("\nThe release is in {}", dist.display());
    Ok(())
}

/// Seconds since 1970 for every file: `SOURCE_DATE_EPOCH`, else the last commit's.
fn source_date() -> Result<String> {
    match std::env::var("SOURCE_DATE_EPOCH") {
        Ok(date) => Ok(date),
        Err(_) => Ok(sh::output("git", &["log", "-1", "--format=%ct"])?
            .trim()
            .to_owned()),
    }
}

/// Program, manual pages, completions, udev rule and documents, laid out as below `/usr`.
fn host_tree(tree: &Path) -> Result<()> {
    let built = sh::target_dir().join("release/rb-host");
    let program = put(tree, "bin/rb-host", &std::fs::read(built)?)?;
    let program_name = program.to_string_lossy().into_owned();
    make_executable(&program)?;
    let pages = tree.join("share/man/man1");
    sh::run(
        &program_name,
        &["-q", "man", "-o", &pages.to_string_lossy()],
    )?;
    for (shell, place) in COMPLETIONS {
        let script = sh::output(&program_name, &["completions", shell])?;
        put(tree, place, script.as_bytes())?;
    }
    let rule = std::fs::read(sh::root().join("packaging/60-rb.rules"))?;
    put(tree, "lib/udev/rules.d/60-rb.rules", &rule)?;
    for name in DOCUMENTS {
        let from = sh::root().join(name);
        copy(&from, &tree.join("share/doc/rb-host").join(name))?;
    }
    Ok(())
}

/// The image as ELF for a debugger and as bytes for a flash tool.
fn firmware_tree(tree: &Path) -> Result<()> {
    let image = std::fs::read(images::elf())?;
    let flat = elf::flatten(&image).context("the firmware image")?;
    put(tree, "rb-firmware.elf", &image)?;
    put(tree, "rb-firmware.bin", &flat.bytes)?;
    let text = format!(
        "Flash rb-firmware.bin at {:#010x}, or rb-firmware.elf with probe-rs:\n\n    \
         probe-rs download --chip STM32L475VGTx rb-firmware.elf\n\n\
         The log needs the ELF file of the very image that runs.\n",
        flat.address
    );
    put(tree, "README.txt", text.as_bytes())?;
    Ok(())
}

fn put(tree: &Path, name: &str, bytes: &[u8]) -> Result<PathBuf> {
    let path = tree.join(name);
    let folder = path.parent().context("a file in a folder")?;
    std::fs::create_dir_all(folder)?;
    std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(path)
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    if from.is_dir() {
        std::fs::create_dir_all(to)?;
        for entry in std::fs::read_dir(from)? {
            let entry = entry?;
            copy(&entry.path(), &to.join(entry.file_name()))?;
        }
    } else {
        let folder = to.parent().context("a file in a folder")?;
        std::fs::create_dir_all(folder)?;
        std::fs::copy(from, to).with_context(|| format!("cannot copy {}", from.display()))?;
    }
    Ok(())
}

#[cfg(unix)]
fn make_executable(path: &Path) -> Result<()> {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755))?;
    Ok(())
}

#[cfg(not(unix))]
fn make_executable(_: &Path) -> Result<()> {
    Ok(())
}

/// `NAME.tar.gz` of a folder; the same files give the same bytes.
fn archive(dist: &Path, name: &str, date: &str) -> Result<()> {
    let (folder, file) = (dist.to_string_lossy(), dist.join(format!("{name}.tar")));
    let (file, date) = (file.to_string_lossy(), format!("--mtime=@{date}"));
    let fixed = [
        "--sort=name",
        "--owner=0",
        "--group=0",
        "--numeric-owner",
        &date,
    ];
    let places = ["-C", &folder, "-cf", &file, name];
    sh::run("tar", &[&fixed[..], &places].concat())?;
    sh::run("gzip", &["-n", "-9", "-f", &file])
}

/// A Debian package of the same tree, where `dpkg-deb` is installed.
fn debian(dist: &Path, tree: &Path, version: &str, date: &str) -> Result<()> {
    let Ok(machine) = sh::output("dpkg", &["--print-architecture"]) else {
        eprintln!("SKIPPED  Debian package: needs dpkg-deb");
        return Ok(());
    };
    let machine = machine.trim();
    let root = dist.join("deb");
    copy(tree, &root.join("usr"))?;
    make_executable(&root.join("usr/bin/rb-host"))?;
    std::fs::rename(root.join("usr/lib"), root.join("lib"))?;
    let control = std::fs::read_to_string(sh::root().join("packaging/control"))?;
    let control = control
        .replace("@VERSION@", version)
        .replace("@ARCHITECTURE@", machine);
    put(&root, "DEBIAN/control", control.as_bytes())?;
    let package = dist.join(format!("rb-host_{version}_{machine}.deb"));
    let (from, to) = (root.to_string_lossy(), package.to_string_lossy());
    let mut command = sh::command("dpkg-deb", &["--root-owner-group", "--build", &from, &to]);
    command.env("SOURCE_DATE_EPOCH", date);
    sh::run_command(command)?;
    std::fs::remove_dir_all(&root)?;
    Ok(())
}

/// `SHA256SUMS` over every file of the release.
fn checksums(dist: &Path) -> Result<()> {
    let entries = std::fs::read_dir(dist)?;
    let names: std::io::Result<Vec<String>> = entries
        .map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()))
        .collect();
    let mut names = names?;
    names.sort();
    let mut command = sh::command("sha256sum", &[]);
    let output = command.args(&names).current_dir(dist).output()?;
    ensure!(
        output.status.success(),
        "sha256sum failed: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    std::fs::write(dist.join("SHA256SUMS"), output.stdout)?;
    Ok(())
}
