//! Prints the most instructions that a 20 Hz tick of the firmware image takes over all shipped gaits and 200 random ones.
//!
//! ```text
//! cargo run -p hil-sim --release --example board_worst [random gaits]
//! ```
//! Run it in the workspace root; it builds image and plugin. The random gaits are those of `tests/tick-cost`, half of them folded so that they meet
//! themselves. What the module refuses at the upload never runs.

#[cfg(unix)]
fn main() -> anyhow::Result<()> {
    use hil_sim::board::{table, tools};
    let built = tools::build(&std::env::current_dir()?)?;
    let count = std::env::args()
        .nth(1)
        .map_or(Ok(200), |text| text.parse())?;
    let sets = [
        ("shipped", gaits::shipped()?),
        ("random", gaits::random(count)),
    ];
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
    use control::gait::{Gait, Oscillator, RawGait, chain};
    use control::robot::RobotModel;

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

    /// Knuth's linear congruential generator (MMIX), the upper bits.
    struct Rng(u64);

    impl Rng {
        fn between(&mut self, low: f32, high: f32) -> f32 {
            self.0 = self
                .0
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            low + (high - low) * ((self.0 >> 40) as f32 / 16_777_216.0)
        }
    }

    /// As `tests/tick-cost` draws them.
    pub(crate) fn random(count: usize) -> Vec<Gait> {
        let mut rng = Rng(11);
        (0..count).map(|k| draw(&mut rng, k % 2 == 0)).collect()
    }

    fn draw(rng: &mut Rng, folded: bool) -> Gait {
        let model = RobotModel::default();
        loop {
            let amplitudes = [0.0; 6].map(|_: f32| rng.between(0.0, 120.0));
            let mut offsets = [0.0; 6].map(|_: f32| rng.between(-120.0, 120.0));
            if folded {
                offsets = [0.0, 0.0, -90.0, -90.0, 0.0, 0.0].map(|x| x + rng.between(-20.0, 20.0));
            }
            let lags = [0.0; 5].map(|_: f32| rng.between(-180.0, 180.0));
            if let Some(gait) = gait(amplitudes, offsets, lags)
                && gait.check_speed(model.joints()).is_ok()
            {
                return gait;
            }
        }
    }

    fn gait(amplitudes_deg: [f32; 6], offsets_deg: [f32; 6], lags_deg: [f32; 5]) -> Option<Gait> {
        let mut raw = RawGait {
            frequency_hz: 0.2,
            rate_a_per_s: 2.0,
            duration_s: 30.0,
            ..RawGait::default()
        };
        raw.name.push_str("cost").ok()?;
        for (amplitude_deg, offset_deg) in amplitudes_deg.into_iter().zip(offsets_deg) {
            raw.oscillators
                .push(Oscillator {
                    amplitude_rad: amplitude_deg.to_radians(),
                    offset_rad: offset_deg.to_radians(),
                    initial_phase_rad: 0.0,
                })
                .ok()?;
        }
        raw.links = chain(0.5, &lags_deg.map(f32::to_radians));
        raw.lock_phases();
        Gait::try_from(raw).ok()
    }
}

#[cfg(not(unix))]
fn main() {
    println!("QEMU runs the image on Unix only");
}
