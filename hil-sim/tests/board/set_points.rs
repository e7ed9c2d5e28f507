//! Set-points: image in QEMU, native firmware and the law alone give the same bits.

use control::gait::Gait;
use hil_sim::board::wire::TimedByte;
use hil_sim::robot::host::SimHost;
use hil_sim::robot::ideal::IdealMotors;
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::crc::Crc32c;
use protocol::link::{EndReason, TelemetryRate};

use crate::common::{SECOND_NS, board, built, gait, law};

const GAITS: [&str; 5] = ["crawl", "inchworm", "paddle", "sidewind", "turn"];
const CYCLES: usize = 600;

/// Every set-point that every driver took, in order, urad.
fn taken(motors: &IdealMotors) -> Vec<Vec<i32>> {
    let of = |joint| motors.taken(joint).iter().map(|t| t.goal_urad).collect();
    (0..6).map(of).collect()
}

fn native(gait: &Gait) -> (u32, Vec<Vec<i32>>) {
    let mut robot = EmulatedRobot::with_motors(Setup::default(), IdealMotors::new(false));
    let mut host = SimHost::new(robot.link());
    host.home(&mut robot).expect("drivers answer");
    let digest = host.upload(&mut robot, 0, gait).expect("clear");
    host.start(&mut robot, 0, digest, 30_000, TelemetryRate::Cycle)
        .expect("ready");
    let end = host
        .wait_for_end(&mut robot, 60_000_000)
        .expect("the lease ends");
    let points = taken(&robot.motors().borrow());
    (end.setpoint_crc32c, points)
}

#[test]
fn five_gaits_of_thirty_seconds_are_the_same_bits_in_qemu_natively_and_in_the_law() {
    let Some(built) = built("set-points of five gaits in QEMU") else {
        return;
    };
    for name in GAITS {
        let gait = gait(name);
        let (mut board, mut host) = board(&built.config());
        host.home(&mut board).expect("drivers answer");
        let digest = host.upload(&mut board, 0, &gait).expect("clear");
        host.start(&mut board, 0, digest, 30_000).expect("ready");
        let end = host
            .wait_for_end(&mut board, 60 * SECOND_NS)
            .expect("runs")
            .expect("the lease ends");
        let in_qemu = taken(board.bus().motors());
        let figures = board.finish().expect("ends");
        println!("{name}: {end:?} {figures:?}");
        assert_eq!(
            (end.reason, end.cycles as usize, end.holds, end.dropped),
            (EndReason::Completed, CYCLES, 0, 0),
            "{name}"
        );

        let (law_crc, law_points) = law(&gait, CYCLES);
        let (native_crc, native_points) = native(&gait);
        assert_eq!(end.setpoint_crc32c, law_crc, "{name}: QEMU against the law");
        assert_eq!(native_crc, law_crc, "{name}: native against the law");
        assert!(
            in_qemu == native_points,
            "{name}: every set-point on the bus, approach and ramp included"
        );
        for (joint, expected) in law_points.iter().enumerate() {
            let found = in_qemu[joint]
                .windows(CYCLES)
                .any(|run| run == &expected[..]);
            assert!(found, "{name}: joint {joint} on the bus against the law");
        }
    }
}

/// All bytes on the motor bus with their times, as one number.
fn fingerprint(log: &[TimedByte]) -> u32 {
    let mut crc = Crc32c::new();
    for byte in log {
        crc.update(&[byte.byte]);
        crc.update(&byte.end_ns.to_le_bytes());
    }
    crc.value()
}

#[test]
fn a_run_repeats_to_the_instruction() {
    let Some(built) = built("repeatability in QEMU") else {
        return;
    };
    let run = || {
        let (mut board, mut host) = board(&built.config());
        host.home(&mut board).expect("drivers answer");
        let digest = host.upload(&mut board, 0, &gait("crawl")).expect("clear");
        host.start(&mut board, 0, digest, 3_000).expect("ready");
        board.run_until(5 * SECOND_NS).expect("runs");
        let log = board.take_bus_log();
        let figures = board.finish().expect("ends");
        (figures, log.len(), fingerprint(&log))
    };
    let first = run();
    assert!(first.1 > 5_000, "the bus was in use: {} bytes", first.1);
    assert_eq!(first.0.overruns, [0; 3]);
    assert_eq!(first, run());
}
