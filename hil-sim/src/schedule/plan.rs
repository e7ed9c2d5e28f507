//! A schedule as data: all of it follows from the seed, and parts of it can be taken away to shrink a failure.

use super::fault::{Fault, Kind};
use crate::rng::Rng;
use std::fmt;

/// Hosts and faults act until this time, us.
pub(crate) const ACTIVE_US: u64 = 6_000_000;
/// Before this time nothing strikes: the module boots and reads its drivers, us.
pub(crate) const FROM_US: u64 = 150_000;
/// Most faults of one schedule.
const MOST_FAULTS: u64 = 7;

/// Stream numbers.
const PURPOSE_PLAN: u64 = 0x5C;
const PURPOSE_FAULT: u64 = 0x5D;

/// What is left away from the schedule of a seed.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Cut {
    /// Only these kinds are drawn; `None` = all.
    pub kinds: Option<Vec<Kind>>,
    /// Only these faults of the list stay; `None` = all.
    pub keep: Option<Vec<usize>>,
    /// Hosts and faults act until this time at the latest, us.
    pub active_us: Option<u64>,
}

/// A schedule.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Everything follows from it.
    pub seed: u64,
    /// Whether the robot has a key. Without one there is a cable alone, which loses bytes but keeps their order.
    pub keyed: bool,
    /// Byte time of the host links, ns.
    pub byte_ns: u64,
    /// Hosts and faults act until then, us.
    pub active_us: u64,
    /// After the faults the robot has to make a whole run again.
    pub comes_back: bool,
    /// Where the encoders stand at the home pose, urad.
    pub home_urad: [i32; 6],
    /// What strikes, in the order of the draw.
    pub faults: Vec<Fault>,
    /// Numbers of the faults in the list of the seed.
    pub numbers: Vec<usize>,
}

impl Plan {
    /// The schedule of a seed, whole.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        Self::with(seed, &Cut::default())
    }

    /// The schedule of a seed without what `cut` takes away.
    #[must_use]
    pub fn with(seed: u64, cut: &Cut) -> Self {
        let mut rng = Rng::new(seed, PURPOSE_PLAN, 0);
        let keyed = rng.chance(0.7);
        let byte_ns = if rng.chance(0.5) { 0 } else { 86_806 };
        let comes_back = rng.chance(0.25);
        let home_urad = std::array::from_fn(|_| (rng.next_u64() % 600_000) as i32 - 300_000);
        let count = rng.next_u64() % (MOST_FAULTS + 1);
        let kinds: Vec<Kind> = cut.kinds.clone().unwrap_or_else(|| Kind::all().collect());
        let drawn = (0..count).filter_map(|n| draw(seed, n, keyed, &kinds));
        let kept = drawn.enumerate().filter(|(n, _)| {
            let keep = cut.keep.as_ref();
            keep.is_none_or(|keep| keep.contains(n))
        });
        let (numbers, mut faults): (Vec<usize>, Vec<Fault>) = kept.unzip();
        let active_us = cut.active_us.unwrap_or(ACTIVE_US).clamp(FROM_US, ACTIVE_US);
        for fault in &mut faults {
            fault.to_us = fault.to_us.min(active_us);
        }
        Self {
            seed,
            keyed,
            byte_ns,
            active_us,
            comes_back,
            home_urad,
            faults,
            numbers,
        }
    }
}

/// The fault of one number, from a stream of its own: others may be left away.
fn draw(seed: u64, number: u64, keyed: bool, kinds: &[Kind]) -> Option<Fault> {
    let mut rng = Rng::new(seed, PURPOSE_FAULT, number);
    let (pick, from, long) = (rng.next_u64() as usize, rng.uniform(), rng.uniform());
    let mut kind = *kinds.get(pick.checked_rem(kinds.len())?)?;
    let link = usize::from(keyed && rng.chance(0.5));
    // A cable keeps the order of what is on it, and nobody else is on it.
    let of_radio = matches!(
        kind,
        Kind::LinkDelay | Kind::LinkReorder | Kind::LinkDuplicate
    );
    if of_radio && !keyed {
        kind = Kind::LinkLoss;
    }
    let from_us = FROM_US + (from * (ACTIVE_US - FROM_US) as f64) as u64;
    // From 2 ms to 2 s, as many short as long ones.
    let length_us = (2_000.0 * libm::pow(1_000.0, long)) as u64;
    Some(Fault {
        kind,
        from_us,
        to_us: from_us + length_us,
        joint: (rng.next_u64() % 6) as usize,
        link,
        size: rng.uniform(),
        seed: rng.next_u64(),
    })
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "seed {}: {}, {} ns a byte, hosts and faults until {:.3} s{}",
            self.seed,
            if self.keyed { "key set" } else { "no key" },
            self.byte_ns,
            self.active_us as f64 * 1e-6,
            if self.comes_back { ", then a run" } else { "" },
        )?;
        for (number, fault) in self.numbers.iter().zip(&self.faults) {
            writeln!(f, "  {number}: {fault}")?;
        }
        Ok(())
    }
}
