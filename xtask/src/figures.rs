//! `cargo xtask figures`: every figure the documentation quotes, from one fresh run.

use crate::{sh, test};
use anyhow::Result;

/// Each table with the command that prints it.
const TABLES: &[(&str, &[&str])] = &[
    (
        "Pre-check against parry3d",
        &[
            "run",
            "--release",
            "-q",
            "-p",
            "control",
            "--example",
            "precheck_oracle",
        ],
    ),
    (
        "Firmware image in QEMU",
        &[
            "run",
            "--release",
            "-q",
            "-p",
            "hil-sim",
            "--example",
            "board_table",
        ],
    ),
    (
        "Emulated robot",
        &[
            "run",
            "--release",
            "-q",
            "-p",
            "hil-sim",
            "--example",
            "robot_speed",
        ],
    ),
    (
        "Body simulator beside MuJoCo",
        &[
            "run",
            "--release",
            "-q",
            "-p",
            "physics",
            "--example",
            "bench",
        ],
    ),
];

/// Print all tables; each command can also be run alone.
pub(crate) fn run() -> Result<()> {
    test::firmware_image()?;
    for (title, arguments) in TABLES {
        println!("\n## {title}\n");
        sh::run("cargo", arguments)?;
    }
    Ok(())
}
