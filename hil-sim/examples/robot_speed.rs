//! How fast the emulated robot runs against real time: `cargo run --release -p hil-sim --example robot_speed`.
//!
//! A 30 s run with 20 Hz telemetry over a 115200 baud link, on ideal drivers and on motors with physics.

use control::gait::{Gait, Oscillator, RawGait, chain};
use hil_sim::motor::JointKind;
use hil_sim::robot::host::{AskError, SimHost};
use hil_sim::robot::ideal::IdealMotors;
use hil_sim::robot::wire::MotorBus;
use hil_sim::robot::{EmulatedRobot, Setup};
use hil_sim::world::{World, WorldParams};
use protocol::link::TelemetryRate;
use std::time::Instant;

fn gait() -> Result<Gait, control::gait::GaitError> {
    let mut raw = RawGait {
        frequency_hz: 0.2,
        rate_a_per_s: 2.0,
        duration_s: 30.0,
        ..RawGait::default()
    };
    let _ = raw.name.push_str("speed");
    raw.links = chain(0.5, &[1.5, -1.5, 3.1, 1.5, -1.5]);
    for _ in 0..6 {
        let _ = raw.oscillators.push(Oscillator {
            amplitude_rad: 0.5,
            offset_rad: 0.0,
            initial_phase_rad: 0.0,
        });
    }
    Gait::try_from(raw)
}

fn measure<M: MotorBus + 'static>(name: &str, motors: M, gait: &Gait) -> Result<(), AskError> {
    let begun = Instant::now();
    let mut robot = EmulatedRobot::with_motors(Setup::default(), motors);
    let mut host = SimHost::new(robot.link());
    host.home(&mut robot)?;
    let before_us = robot.now_us();
    let digest = host.upload(&mut robot, 0, gait)?;
    let upload_ms = (robot.now_us() - before_us) / 1000;
    host.start(&mut robot, 0, digest, 30_000, TelemetryRate::Cycle)?;
    let end = host.wait_for_end(&mut robot, 60_000_000);
    let (virtual_s, real_s) = (robot.now_us() as f64 * 1e-6, begun.elapsed().as_secs_f64());
    let ratio = virtual_s / real_s;
    println!(
        "{name}: {virtual_s:.1} s in {real_s:.3} s = {ratio:.0} x real time, {} polls",
        robot.polls()
    );
    println!("  upload and verify {upload_ms} ms of link time at 115200 baud; {end:?}");
    let bytes: usize = host.blocks.iter().map(|block| block.data.len()).sum();
    println!(
        "  record {} blocks, {bytes} bytes of delta code",
        host.blocks.len()
    );
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let gait = gait()?;
    let world = World::on_stand(&WorldParams::metamodule(1, JointKind::catalogue_joint))?;
    for failed in [
        measure("ideal drivers", IdealMotors::new(false), &gait),
        measure("motors", world, &gait),
    ] {
        failed.map_err(|error| format!("{error:?}"))?;
    }
    Ok(())
}
