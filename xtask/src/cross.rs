//! `cargo xtask cross`: the host tool for Windows and macOS, by lints without a warning. Nothing is linked, nothing is run.

use crate::sh;
use anyhow::Result;

/// One target of each system.
const TARGETS: [&str; 2] = ["x86_64-pc-windows-gnu", "aarch64-apple-darwin"];

/// Checks the host tool for every target that this machine has or can get; says loudly which it left out.
pub(crate) fn run() -> Result<()> {
    for target in TARGETS {
        if let Err(error) = sh::run("rustup", &["target", "add", target]) {
            eprintln!("SKIPPED  host tool for {target}: its standard library, {error:#}");
            continue;
        }
        check(target)?;
    }
    Ok(())
}

/// Dependencies in C are left out, so a machine needs no compiler and no headers of the other system.
fn check(target: &str) -> Result<()> {
    let words = ["clippy", "-q", "-p", "host", "--target", target];
    let mut command = sh::command("cargo", &[&words[..], &["--", "-D", "warnings"]].concat());
    let none = sh::root().join("xtask/src/no-cc.sh");
    let name = target.replace('-', "_");
    command.env(format!("CC_{name}"), &none);
    command.env(format!("AR_{name}"), &none);
    sh::run_command(command)?;
    eprintln!(
        "checked  host tool for {target}; its parts in C were not compiled, and nobody has run it"
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use crate::sh;

    #[test]
    fn a_file_stands_where_the_compiler_and_the_archiver_would_write() {
        let folder = std::env::temp_dir().join(format!("no-cc-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (object, archive) = (folder.join("one.o"), folder.join("all.a"));
        let (o, a) = (object.to_string_lossy(), archive.to_string_lossy());
        let none = sh::root().join("xtask/src/no-cc.sh");
        let none = none.to_string_lossy();
        sh::run(&none, &["-O2", "-c", "one.c", "-o", &o]).unwrap();
        sh::run(&none, &["cq", &a, &o]).unwrap();
        assert!(object.is_file() && archive.is_file());
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
