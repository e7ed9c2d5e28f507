//! Counts the instructions of the 20 Hz law. See README.md for the commands.
#![no_std]
#![no_main]

mod board;
mod draw;

use board::{Console, INSTRUCTIONS_PER_TICK, cost};
use control::gait::{Gait, Link, Oscillator, RawGait};
use control::machine::Angles;
use control::motion::{MotionParams, Planner};
use control::precheck::{self, MARGIN_M, Margins};
use control::robot::{JOINTS, RobotModel};
use control::supervisor::Motion;
use control::{CYCLE_S, cpg};
use core::fmt::Write;
use draw::{Rng, gait, random};
use protocol::link::{KEY_LEN, Key, NONCE_LEN, Nonce, TAG_LEN};

/// Mean and maximum.
#[derive(Default)]
struct Tally {
    count: u64,
    sum: u64,
    max: u32,
}

impl Tally {
    fn add(&mut self, instructions: u32) {
        self.count += 1;
        self.sum += u64::from(instructions);
        self.max = self.max.max(instructions);
    }
}

fn print(label: &str, tally: &Tally) {
    let mean = tally.sum / tally.count.max(1);
    let _ = writeln!(
        Console,
        "{label:<44} mean {mean:>7}  max {:>7}  ({} times)",
        tally.max, tally.count
    );
}

/// A gait of the folder `gaits`, numbers by their bits.
struct Shipped {
    frequency_rate: (u32, u32),
    oscillators: &'static [[u32; 3]],
    links: &'static [(u8, u8, u32, u32)],
}

include!(concat!(env!("OUT_DIR"), "/shipped.rs"));

impl Shipped {
    fn gait(&self) -> Option<Gait> {
        let (frequency, rate) = self.frequency_rate;
        let mut raw = RawGait {
            frequency_hz: f32::from_bits(frequency),
            rate_a_per_s: f32::from_bits(rate),
            duration_s: 30.0,
            ..RawGait::default()
        };
        let _ = raw.name.push_str("shipped");
        for bits in self.oscillators {
            let [amplitude_rad, offset_rad, initial_phase_rad] = bits.map(f32::from_bits);
            let _ = raw.oscillators.push(Oscillator {
                amplitude_rad,
                offset_rad,
                initial_phase_rad,
            });
        }
        for &(from, to, weight, lag) in self.links {
            let _ = raw.links.push(Link {
                from,
                to,
                weight: f32::from_bits(weight),
                phase_lag_rad: f32::from_bits(lag),
            });
        }
        Gait::try_from(raw).ok()
    }
}

/// Cost of a cycle over many gaits, and how many of them were held by the pre-check.
#[derive(Default)]
struct Sweep {
    cycle: Tally,
    gaits: u32,
    held: u32,
}

impl Sweep {
    fn add(&mut self, gait: Option<Gait>, cycles: u32) {
        let Some(followed) = gait.and_then(|gait| follow(&gait, cycles)) else {
            let _ = writeln!(Console, "a gait was refused");
            return;
        };
        self.gaits += 1;
        self.held += u32::from(followed.held > 0);
        for tally in [followed.approach, followed.free] {
            self.cycle.count += tally.count;
            self.cycle.sum += tally.sum;
            self.cycle.max = self.cycle.max.max(tally.max);
        }
    }

    fn print(&self, label: &str) {
        let (gaits, held) = (self.gaits, self.held);
        let _ = writeln!(Console, "{gaits} {label}, {held} of them held");
        print("  cycle", &self.cycle);
    }
}

/// First golden of `control/tests/control/cpg.rs`.
const HOST_BITS: u64 = 0x4481_be5e_1eda_3824;

/// FNV-1a over the bits of 600 set-points.
fn bits(gait: &Gait) -> u64 {
    let mut state = cpg::start(gait);
    let mut hash = 0xcbf2_9ce4_8422_2325u64;
    for _ in 0..600 {
        for q in cpg::step(gait, &mut state, CYCLE_S).as_slice() {
            for byte in q.to_bits().to_le_bytes() {
                hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
            }
        }
    }
    hash
}

/// Checks of one tag that are counted together, so that the counter's step of 40 instructions is small against what a byte would cost.
const CHECKS: u32 = 200;

/// A check of a tag must not tell by its time which byte was wrong: one after the other is, and all, and none. The counter's own step is allowed.
fn every_wrong_tag_costs_the_same() {
    let (key, nonce, payload) = (Key([0x4B; KEY_LEN]), Nonce([0x11; NONCE_LEN]), [7; 26]);
    let right = key.sign(&nonce, 8, &payload);
    let mut all = [right; TAG_LEN + 2];
    for (byte, tag) in all.iter_mut().take(TAG_LEN).enumerate() {
        tag.0[byte] ^= 0x80;
    }
    all[TAG_LEN].0 = right.0.map(|byte| !byte);
    let mut least = u32::MAX;
    let mut most = 0;
    for tag in all {
        let (instructions, good) = cost(|| {
            let verify =
                |_| u32::from(key.verify(&nonce, 8, &payload, core::hint::black_box(&tag)));
            (0..CHECKS).map(verify).sum::<u32>()
        });
        let expected = if tag == right { CHECKS } else { 0 };
        if good != expected {
            let _ = writeln!(Console, "a tag was judged wrongly");
        }
        least = least.min(instructions);
        most = most.max(instructions);
    }
    let verdict = if most - least <= 2 * INSTRUCTIONS_PER_TICK {
        "the same for every tag"
    } else {
        "NOT the same for every tag"
    };
    let _ = writeln!(
        Console,
        "{CHECKS} checks of a tag: {least} to {most} instructions, {verdict}"
    );
}

/// What a gait cost.
struct Followed {
    approach: Tally,
    free: Tally,
    held: u32,
}

/// A robot that lags and jitters follows the planner.
fn follow(gait: &Gait, cycles: u32) -> Option<Followed> {
    let params = MotionParams::default();
    let mut planner = Planner::begin(&params, gait, &[0.0; JOINTS].into()).ok()?;
    let mut rng = Rng(7);
    let mut measured = Angles::from([0.0; JOINTS]);
    let mut motion = Motion::Approach;
    let [mut approach, mut free] = [Tally::default(), Tally::default()];
    for _ in 0..cycles {
        let (instructions, out) = cost(|| planner.cycle(&params, motion, Some(&measured)));
        let out = out.ok()?;
        if motion == Motion::Run {
            &mut free
        } else {
            &mut approach
        }
        .add(instructions);
        if out.in_position {
            motion = Motion::Run;
        }
        for (m, q) in measured.iter_mut().zip(out.set_point_rad.iter()) {
            *m += 0.3 * (q - *m) + rng.between(-0.01, 0.01);
        }
    }
    let held = planner.held_cycles();
    Some(Followed {
        approach,
        free,
        held,
    })
}

/// One gait for 75 s, its start apart.
fn run(label: &str, gait: Option<Gait>) -> Option<()> {
    let followed = follow(&gait?, 1500)?;
    let _ = writeln!(Console, "{label}: held in {} cycles", followed.held);
    print("  cycle, approach", &followed.approach);
    print("  cycle, run", &followed.free);
    Some(())
}

/// Moves of one cycle that start 10 mm inside to 20 mm outside contact.
fn moves() {
    let model = RobotModel::default();
    let mut rng = Rng(3);
    let [mut pose, mut sweep, mut check] = [Tally::default(), Tally::default(), Tally::default()];
    while pose.count < 3000 {
        let from =
            [0.0f32; JOINTS].map(|_| rng.between(-core::f32::consts::PI, core::f32::consts::PI));
        let (instructions, found) = cost(|| precheck::clearance(&model, &from));
        if !(-0.01..0.02).contains(&found.clearance_m) {
            continue;
        }
        pose.add(instructions);
        let mut to = from;
        for (q, joint) in to.iter_mut().zip(model.joints()) {
            *q += rng.between(-1.0, 1.0) * joint.no_load_speed_rad_s * CYCLE_S;
        }
        sweep.add(cost(|| precheck::swept(&model, &from, &to, MARGIN_M)).0);
        let margins = Margins {
            keep_m: MARGIN_M,
            escape_m: 1e-3,
        };
        check.add(cost(|| precheck::check_move(&model, &from, &to, margins)).0);
    }
    print("near poses: clearance", &pose);
    print("near poses: swept move", &sweep);
    print("near poses: move with leave to escape", &check);
}

/// All measurements.
pub(crate) fn main() {
    // The loop is four to six instructions: shows that a tick is 40 of them.
    let (loops, _) = cost(|| (0..100_000u32).fold(0, |x, i| core::hint::black_box(x ^ i)));
    let _ = writeln!(
        Console,
        "100000 turns of an empty loop: {loops} instructions"
    );
    every_wrong_tag_costs_the_same();
    if let Some(gait) = gait([40.0; 6], [0.0; 6], [90.0, -90.0, 180.0, 90.0, -90.0]) {
        let mut state = cpg::start(&gait);
        let mut step = Tally::default();
        for _ in 0..600 {
            step.add(cost(|| cpg::step(&gait, &mut state, CYCLE_S)).0);
        }
        print("CPG step", &step);
        let same = if bits(&gait) == HOST_BITS {
            "the same as on the host"
        } else {
            "NOT those of the host"
        };
        let _ = writeln!(Console, "600 set-points of crawl, bits: {same}");
        let _ = run("crawl, free of itself", Some(gait));
    }
    let fold = [0.0, 0.0, -90.0, -90.0, 0.0, 0.0];
    let _ = run(
        "clash, meets itself",
        gait([0.0, 0.0, 60.0, 60.0, 0.0, 0.0], fold, [0.0; 5]),
    );
    let _ = run(
        "wild, meets itself",
        gait(
            [80.0, 80.0, 100.0, 100.0, 80.0, 80.0],
            fold,
            [30.0, 60.0, 10.0, 50.0, 20.0],
        ),
    );
    let mut shipped = Sweep::default();
    SHIPPED.iter().for_each(|one| shipped.add(one.gait(), 900));
    shipped.print("shipped gaits");
    let (mut drawn, mut rng) = (Sweep::default(), Rng(11));
    (0..200).for_each(|k| drawn.add(Some(random(&mut rng, k % 2 == 0)), 300));
    drawn.print("random gaits");
    moves();
}
