//! `cargo xtask figures`: every figure the documentation quotes, from one fresh run.

use crate::{sh, test};
use anyhow::Result;

/// Each table with the command that prints it.
const TABLES: &[(&str, &str)] = &[
    (
        "Pre-check against parry3d",
        "run --release -q -p control --example precheck_oracle -- 1000000 100000",
    ),
    (
        "Firmware image in QEMU: size, stack, instructions per tick",
        "run --release -q -p hil-sim --example board_table",
    ),
    (
        "Emulated robot: speed against real time, upload time on the link",
        "run --release -q -p hil-sim --example robot_speed",
    ),
    (
        "Motor bus: time of a cycle",
        "test --release -q -p hil-sim --test motors bus_time_of_a_cycle -- --nocapture",
    ),
    (
        "Telemetry: what the link carries and the memory holds",
        "test --release -q -p protocol --test telemetry -- --nocapture",
    ),
    (
        "Damaged uploads, missing motors, power cuts",
        "test --release -q -p hil-sim --test robot --test slots_power_cut -- --nocapture",
    ),
    (
        "Body simulator beside MuJoCo",
        "run --release -q -p host -- bench",
    ),
    (
        "Body simulator, MuJoCo, ODE and Rapier on the same gaits",
        "run --release -q -p peers --features rapier --example validate 50 coarse",
    ),
];

/// Print all tables; each command can also be run alone.
pub(crate) fn run() -> Result<()> {
    test::firmware_image()?;
    for (title, command) in TABLES {
        println!("\n## {title}\n\n    cargo {command}\n");
        let arguments: Vec<&str> = command.split(' ').collect();
        sh::run("cargo", &arguments)?;
    }
    Ok(())
}
