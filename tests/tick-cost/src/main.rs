//! Counts the instructions of the 20 Hz law. See README.md for the commands.
#![no_std]
#![no_main]

mod board;

use board::{Console, cost};
use control::gait::{Gait, Oscillator, RawGait, chain};
use control::motion::{MotionParams, Planner};
use control::precheck::{self, MARGIN_M, Margins};
use control::robot::{JOINTS, RobotModel};
use control::supervisor::Motion;
use control::{CYCLE_S, cpg};
use core::fmt::Write;

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

fn gait(amplitudes_deg: [f32; 6], offsets_deg: [f32; 6], lags_deg: [f32; 5]) -> Option<Gait> {
    let mut raw = RawGait {
        frequency_hz: 0.2,
        rate_a_per_s: 2.0,
        duration_s: 30.0,
        ..RawGait::default()
    };
    let _ = raw.name.push_str("cost");
    for (r, x) in amplitudes_deg.into_iter().zip(offsets_deg) {
        let [amplitude_rad, offset_rad] = [r, x].map(f32::to_radians);
        let _ = raw.oscillators.push(Oscillator {
            amplitude_rad,
            offset_rad,
            initial_phase_rad: 0.0,
        });
    }
    raw.links = chain(0.5, &lags_deg.map(f32::to_radians));
    raw.lock_phases();
    Gait::try_from(raw).ok()
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

/// A robot that lags and jitters follows the planner for 60 s.
fn run(label: &str, gait: Option<Gait>) -> Option<()> {
    let gait = gait?;
    let params = MotionParams::default();
    let mut planner = Planner::begin(&params, &gait, &[0.0; JOINTS]).ok()?;
    let mut rng = Rng(7);
    let mut measured = [0.0f32; JOINTS];
    let mut motion = Motion::Approach;
    let [mut approach, mut free] = [Tally::default(), Tally::default()];
    for _ in 0..1500 {
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
        for (m, q) in measured.iter_mut().zip(out.set_point_rad) {
            *m += 0.3 * (q - *m) + rng.between(-0.01, 0.01);
        }
    }
    let _ = writeln!(Console, "{label}: held in {} cycles", planner.held_cycles());
    print("  cycle, approach", &approach);
    print("  cycle, run", &free);
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
    moves();
}
