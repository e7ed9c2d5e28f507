//! Prints the most instructions that a 20 Hz tick of the firmware image takes over all shipped gaits and 200 random ones.
//!
//! Then in runs in which one shipped gait takes over from another, ordered by a host that keeps in touch. Then the same by a host that falls silent: it
//! comes back to a record that waits for it. Of every set it prints too how many instructions of a tick the answers of the motor bus take.
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
    use hil_sim::board::table::{self, Contact};
    use hil_sim::board::tools;
    let built = tools::build(&std::env::current_dir()?)?;
    let count: usize = std::env::args()
        .nth(1)
        .map_or(Ok(200), |text| text.parse())?;
    let shipped = gaits::shipped()?;
    let few = &shipped[..count.min(shipped.len())];
    let random = gaits::random(count);
    let one = |gait| table::most(&built, gait);
    let pairs = || few.iter().zip(shipped.iter().cycle().skip(1));
    let changes = |contact| {
        Row::of(
            pairs().map(|(first, second)| table::most_of_change(&built, first, second, contact)),
        )
    };
    let rows = [
        ("shipped gaits", Row::of(few.iter().map(one))?),
        ("random gaits", Row::of(random.iter().map(one))?),
        (
            "changes from a shipped gait to the next and back",
            changes(Contact::Kept)?,
        ),
        (
            "such changes by a host that was silent for some seconds",
            changes(Contact::Lost)?,
        ),
    ];
    for (label, row) in &rows {
        println!(
            "{} {label}, {} of them refused: most {} of {} instructions",
            row.runs,
            row.refused,
            row.most.tick,
            table::target_instructions()
        );
    }
    for (label, row) in &rows {
        println!(
            "answers of the motor bus, {} {label}: most {} instructions of a tick",
            row.runs, row.most.bus
        );
    }
    Ok(())
}

/// A set of runs.
#[cfg(unix)]
#[derive(Default)]
struct Row {
    runs: usize,
    refused: usize,
    most: hil_sim::board::table::Most,
}

#[cfg(unix)]
impl Row {
    fn of<E>(
        runs: impl Iterator<Item = Result<Option<hil_sim::board::table::Most>, E>>,
    ) -> Result<Self, E> {
        let mut row = Self::default();
        for run in runs {
            row.runs += 1;
            match run? {
                Some(most) => row.most = row.most.max(most),
                None => row.refused += 1,
            }
        }
        Ok(row)
    }
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
