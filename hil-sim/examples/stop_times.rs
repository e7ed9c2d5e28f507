//! How long a STOP takes: `cargo run --release -p hil-sim --example stop_times -- 1000`.
//!
//! Runs of one gait on ideal drivers, each stopped at another phase of the cycle and of the gait, over a link whose bytes
//! take no time and over 115200 baud with telemetry of every cycle.

use anyhow::{Context, Result, anyhow, ensure};
use control::gait::{Gait, Oscillator, RawGait, chain};
use hil_sim::robot::host::{AskError, SimHost};
use hil_sim::robot::{EmulatedRobot, Setup, link};
use protocol::link::{EndReason, TelemetryRate, ToModule};

/// From the first byte of the order, us.
struct Stopped {
    /// The answer is there; the host looks every 1 ms.
    answered_us: u64,
    /// First set-point after the answer: one of the ramp.
    ramp_us: u64,
    /// Last set-point; torque goes off after it.
    still_us: u64,
}

fn gait() -> Result<Gait> {
    let mut raw = RawGait {
        frequency_hz: 0.2,
        rate_a_per_s: 2.0,
        duration_s: 30.0,
        links: chain(0.5, &[1.5, -1.5, 3.1, 1.5, -1.5]),
        ..RawGait::default()
    };
    let _ = raw.name.push_str("stopped");
    for _ in 0..6 {
        let _ = raw.oscillators.push(Oscillator {
            amplitude_rad: 0.5,
            offset_rad: 0.0,
            initial_phase_rad: 0.0,
        });
    }
    Gait::try_from(raw).map_err(|error| anyhow!("{error:?}"))
}

fn stopped(setup: Setup, gait: &Gait, rate: TelemetryRate, after_us: u64) -> Result<Stopped> {
    let of = |error: AskError| anyhow!("{error:?}");
    let mut robot = EmulatedRobot::ideal(setup);
    let mut host = SimHost::new(robot.link());
    host.home(&mut robot).map_err(of)?;
    let digest = host.upload(&mut robot, 0, gait).map_err(of)?;
    host.start(&mut robot, 0, digest, 60_000, rate)
        .map_err(of)?;
    robot.run_for(after_us);
    let at_us = robot.now_us();
    host.ask(&mut robot, &ToModule::Stop).map_err(of)?;
    let answered_us = robot.now_us();
    let end = host.wait_for_end(&mut robot, 10_000_000);
    let end = end.context("the run does not end")?;
    ensure!(end.reason == EndReason::Stopped, "{end:?}");
    let motors = robot.motors();
    let motors = motors.borrow();
    ensure!((0..6).all(|joint| !motors.torque(joint)), "torque is on");
    let mut after = motors.taken(0);
    after.retain(|taken| taken.at_ns > answered_us * 1000);
    let first = after.first().context("no ramp")?;
    let last = after.last().context("no ramp")?;
    Ok(Stopped {
        answered_us: answered_us - at_us,
        ramp_us: first.at_ns / 1000 - at_us,
        still_us: last.at_ns / 1000 - at_us,
    })
}

fn row(name: &str, mut times_us: Vec<u64>) {
    times_us.sort_unstable();
    let at = |share: f64| {
        let place = (share * (times_us.len() - 1) as f64).round() as usize;
        times_us[place] as f64 * 1e-3
    };
    let cells = [0.0, 0.25, 0.5, 0.75, 0.95, 1.0].map(|share| format!("{:.1}", at(share)));
    println!("| {name} | {} |", cells.join(" | "));
}

fn main() -> Result<()> {
    let count = match std::env::args().nth(1) {
        Some(word) => word.parse().context("stop_times [N]")?,
        None => 1_000_u64,
    };
    ensure!(count > 0, "at least one run");
    let gait = gait()?;
    println!(
        "{count} runs a link; ms from the first byte of STOP. Torque goes off after the last set-point.\n"
    );
    println!("| link, until | least | 25 % | median | 75 % | 95 % | most |");
    println!("|---|---|---|---|---|---|---|");
    for (name, link_byte_ns, rate) in [
        ("no byte time", 0, TelemetryRate::Off),
        (
            "115200 baud, telemetry of every cycle",
            link::BYTE_NS_115200,
            TelemetryRate::Cycle,
        ),
    ] {
        let mut times = [const { Vec::new() }; 3];
        for n in 0..count {
            let setup = Setup {
                seed: n,
                link_byte_ns,
                ..Setup::default()
            };
            // Phases of the cycle in equal steps, and one of the first five seconds of the gait each.
            let after_us = 1_000_000 + (n * 7 % 100) * 50_000 + 50_000 * n / count;
            let one = stopped(setup, &gait, rate, after_us)?;
            let all = [one.answered_us, one.ramp_us, one.still_us];
            times.iter_mut().zip(all).for_each(|(to, us)| to.push(us));
        }
        let until = [
            "answer",
            "first set-point after the answer",
            "last set-point",
        ];
        for (until, times_us) in until.into_iter().zip(times) {
            row(&format!("{name}: {until}"), times_us);
        }
    }
    Ok(())
}
