//! Prints the figures of the firmware image: flash, RAM, stack, instructions per tick, speed in QEMU.
//!
//! ```text
//! cargo run -p hil-sim --release --example board_table [gaits/crawl.toml]
//! ```
//! Run it in the workspace root; it builds image and plugin.

#[cfg(unix)]
fn main() -> anyhow::Result<()> {
    use anyhow::Context;
    use hil_sim::board::{table, tools};
    let file = std::env::args()
        .nth(1)
        .unwrap_or_else(|| "gaits/crawl.toml".to_owned());
    let text = std::fs::read_to_string(&file).with_context(|| format!("cannot read {file}"))?;
    let gait = files::gait::parse(&file, &text)?;
    let built = tools::build(&std::env::current_dir()?)?;
    println!("{}", table::measure(&built, &gait)?);
    Ok(())
}

#[cfg(not(unix))]
fn main() {
    println!("QEMU runs the image on Unix only");
}
