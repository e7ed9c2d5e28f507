//! Prints the most instructions that a 20 Hz tick of the firmware image takes over all shipped gaits and 200 random ones.
//!
//! ```text
//! cargo run -p hil-sim --release --example board_worst [gaits of each at most]
//! ```
//! Run it in the workspace root; it builds image and plugin. The random gaits are those of `tests/tick-cost`, half of them folded so that they meet
//! themselves. What the module refuses at the upload never runs.

#[cfg(unix)]
#[path = "../../tests/tick-cost/src/draw.rs"]
mod draw;

#[cfg(unix)]
fn main() -> anyhow::Result<()> {
    use hil_sim::board::{table, tools};
    let built = tools::build(&std::env::current_dir()?)?;
    let count: usize = std::env::args()
        .nth(1)
        .map_or(Ok(200), |text| text.parse())?;
    let mut shipped = gaits::shipped()?;
    shipped.truncate(count);
    let sets = [("shipped", shipped), ("random", gaits::random(count))];
    for (label, gaits) in sets {
        let (mut most, mut refused) = (0, 0);
        for gait in &gaits {
            match table::most(&built, gait)? {
                Some(instructions) => most = most.max(instructions),
                None => refused += 1,
            }
        }
        println!(
            "{} {label} gaits, {refused} of them refused: most {most} of {} instructions",
            gaits.len(),
            table::target_instructions()
        );
    }
    Ok(())
}

#[cfg(unix)]
mod gaits {
    use super::draw::{self, Rng};
    use control::gait::Gait;

    /// All of the folders `gaits` and `gaits/searched`, by name.
    pub(crate) fn shipped() -> anyhow::Result<Vec<Gait>> {
        let mut gaits = Vec::new();
        for folder in ["gaits", "gaits/searched"] {
            let mut paths: Vec<_> = std::fs::read_dir(folder)?
                .flatten()
                .map(|entry| entry.path())
                .filter(|path| path.extension().is_some_and(|ending| ending == "toml"))
                .collect();
            paths.sort();
            for path in paths {
                let text = std::fs::read_to_string(&path)?;
                gaits.push(files::gait::parse(&path.display().to_string(), &text)?);
            }
        }
        Ok(gaits)
    }

    /// As `tests/tick-cost` draws them.
    pub(crate) fn random(count: usize) -> Vec<Gait> {
        let mut rng = Rng(11);
        let drawn = (0..count).map(|k| draw::random(&mut rng, k % 2 == 0));
        drawn.collect()
    }
}

#[cfg(not(unix))]
fn main() {
    println!("QEMU runs the image on Unix only");
}
