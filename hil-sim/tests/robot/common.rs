//! Gaits and set-ups that the tests share.

use control::gait::{Gait, Oscillator, RawGait, chain};
use hil_sim::robot::host::SimHost;
use hil_sim::robot::ideal::IdealMotors;
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::link::Digest;

/// A chain of six; amplitudes and offsets small enough to stay clear.
pub(crate) fn gait(number: u8) -> Gait {
    let mut raw = RawGait {
        frequency_hz: 0.2 + 0.02 * f32::from(number),
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
            initial_phase_rad: 0.3 * f32::from(joint) - f32::from(number),
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
    let mut robot = EmulatedRobot::with_motors(setup, IdealMotors::new(false));
    let mut host = SimHost::new(robot.link());
    host.home(&mut robot).expect("drivers answer");
    let digest = host
        .upload(&mut robot, 0, &gait(number))
        .expect("the gait is clear");
    (robot, host, digest)
}
