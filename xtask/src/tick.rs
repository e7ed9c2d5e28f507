//! `cargo xtask tick`: instructions of the 20 Hz law on an emulated Cortex-M4F, over shipped and random gaits.

use crate::{setup, sh};
use anyhow::{Context, Result, bail};

const MANIFEST: &str = "tests/tick-cost/Cargo.toml";
const TARGET: &str = "thumbv7em-none-eabihf";

/// Builds the counting program and runs it in QEMU, where one instruction is one nanosecond.
pub(crate) fn run() -> Result<()> {
    setup::rust_target()?;
    let folder = sh::target_dir().join("tick-cost");
    let program = folder.join(TARGET).join("release/tick-cost");
    let (folder, program) = (folder.to_string_lossy(), program.to_string_lossy());
    let build = ["build", "--release", "--quiet", "--manifest-path", MANIFEST];
    sh::run(
        "cargo",
        &[&build[..], &["--target", TARGET, "--target-dir", &folder]].concat(),
    )?;
    let machine = [
        "-M",
        "mps2-an386",
        "-nographic",
        "-monitor",
        "none",
        "-serial",
        "none",
    ];
    let counting = ["-icount", "shift=0,sleep=off"];
    let output = ["-semihosting-config", "enable=on,target=native"];
    let arguments = [&machine[..], &counting, &output, &["-kernel", &program]].concat();
    // The program's words come over semihosting, which QEMU writes to standard error.
    let done = sh::command("qemu-system-arm", &arguments)
        .output()
        .context("QEMU is installed by `cargo xtask setup`")?;
    let text = String::from_utf8_lossy(&done.stderr);
    print!("{text}");
    if !done.status.success() {
        bail!("the counting program failed: {}", done.status);
    }
    if !text.contains("bits: the same as on the host") {
        bail!("the law gives other bits on the emulated processor than on this computer");
    }
    if !text.contains("instructions, the same for every tag") {
        bail!("the time of a tag's check tells which byte is wrong");
    }
    Ok(())
}

/// As a check: without QEMU it is skipped aloud.
pub(crate) fn check() -> Result<()> {
    if sh::output("qemu-system-arm", &["--version"]).is_err() {
        eprintln!("SKIPPED  instructions of the law: needs QEMU (`cargo xtask setup`)");
        return Ok(());
    }
    run()
}
