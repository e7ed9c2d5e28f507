//! `cargo xtask demo`: the main job on the embedded default, ending with a picture.

use crate::sh;
use anyhow::Result;

/// Upload a gait to the emulated robot, run it for 30 s, record, check and draw it.
pub(crate) fn run() -> Result<()> {
    let folder = sh::target_dir().join("demo");
    std::fs::create_dir_all(&folder)?;
    let path = |name: &str| folder.join(name).to_string_lossy().into_owned();
    let (recording, picture) = (path("crawl.mcap"), path("crawl.svg"));
    sh::run("cargo", &["build", "--release", "--package", "host"])?;
    let rb_host = sh::target_dir().join("release/rb-host");
    let rb_host = rb_host.to_string_lossy();
    let gait = "gaits/crawl.toml";
    sh::run(&rb_host, &["--port", "sim:", "upload", gait])?;
    sh::run(
        &rb_host,
        &[
            "--port",
            "sim:",
            "run",
            gait,
            "--duration",
            "30s",
            "--force",
            "--record",
            &recording,
        ],
    )?;
    sh::run(&rb_host, &["rec", "check", &recording])?;
    sh::run(
        &rb_host,
        &["rec", "plot", &recording, "--force", "--output", &picture],
    )?;
    eprintln!("\nThe recording opens in Foxglove, PlotJuggler or Rerun: {recording}");
    eprintln!("The picture opens in any browser:                     {picture}");
    Ok(())
}
