//! Gaits and set-ups that the tests share.

use control::gait::{Gait, Oscillator, RawGait, chain};
use hil_sim::robot::host::SimHost;
use hil_sim::robot::ideal::IdealMotors;
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::link::Digest;

/// A chain of six; amplitudes and offsets small enough to stay clear.
pub(crate) fn gait(number: u8) -> Gait {
    let mut raw = RawGait {
        frequency_hz: 0.2 + 0.01 * f32::from(number),
        rate_a_per_s: 2.0,
        duration_s: 30.0,
        links: chain(0.5, &[0.4 * f32::from(number) - 1.0, -1.5, 3.1, 1.5, -1.5]),
        ..RawGait::default()
    };
    raw.name.push_str(&format!("test {number}")).expect("short");
    for joint in 0..6_u8 {
        let oscillator = Oscillator {
            amplitude_rad: 0.2 + 0.05 * f32::from(joint),
            offset_rad: 0.02 * f32::from(number) - 0.05,
            initial_phase_rad: 0.3 * f32::from(joint) - 0.7 * f32::from(number),
        };
        raw.oscillators.push(oscillator).expect("six fit");
    }
    Gait::try_from(raw).expect("within the ranges")
}

/// A robot with ideal drivers and a link without byte times, homed, the gait in slot 0.
pub(crate) fn ready(number: u8) -> (EmulatedRobot, SimHost, Digest) {
    ready_with(
        Setup {
            link_byte_ns: 0,
            ..Setup::default()
        },
        number,
    )
}

/// As [`ready`] with another set-up.
pub(crate) fn ready_with(setup: Setup, number: u8) -> (EmulatedRobot, SimHost, Digest) {
    ready_on(setup, &gait(number))
}

/// As [`ready_with`] with any gait.
pub(crate) fn ready_on(setup: Setup, gait: &Gait) -> (EmulatedRobot, SimHost, Digest) {
    let mut robot = EmulatedRobot::with_motors(setup, IdealMotors::new(false));
    let mut host = SimHost::new(robot.link());
    host.home(&mut robot).expect("drivers answer");
    let digest = host.upload(&mut robot, 0, gait).expect("the gait is clear");
    (robot, host, digest)
}

/// The gaits that come with the project, by file name.
pub(crate) fn shipped() -> Vec<(String, Gait)> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../gaits");
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .expect("the gaits folder")
        .map(|entry| entry.expect("readable").path())
        .filter(|path| {
            path.extension()
                .is_some_and(|extension| extension == "toml")
        })
        .collect();
    files.sort();
    let parse = |path: std::path::PathBuf| {
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let text = std::fs::read_to_string(&path).expect("readable");
        let gait = files::gait::parse(&name, &text).expect("a gait of ours");
        (name, gait)
    };
    files.into_iter().map(parse).collect()
}

/// INV1, INV2 and INV4 on the drivers' side: every set-point taken is within the limits. It is no further from where the joint stands than it
/// turns in a cycle (26.6 and 19.4 rpm no-load, the paper's Table I, plus the rounding of wire counts).
pub(crate) fn check_set_points(robot: &EmulatedRobot) {
    for joint in 0..6 {
        let rpm = if joint % 3 == 1 { 19.4 } else { 26.6 };
        let step_urad = (rpm / 60.0 * core::f64::consts::TAU * 0.05 * 1e6_f64) as i32 + 12;
        for taken in robot.motors().borrow().taken(joint) {
            let step = (taken.goal_urad - taken.from_urad).abs();
            assert!(
                step <= step_urad,
                "joint {joint}: step of {step} urad at {} us",
                taken.at_ns / 1000
            );
            assert!(taken.goal_urad.abs() <= 25_200_000);
        }
    }
}
