//! rb-host: the tool a person talks to the robot with.
//!
//! [`run`] parses the command line, resolves the settings and calls one module of [`cmd`]. Below that:
//! [`link`] talks to a robot (serial, TCP, Bluetooth serial, or the emulated one in process), [`recording`] writes and
//! reads MCAP files, [`plot`] draws them. Data goes to standard output, everything said to a person to standard error.
#![forbid(unsafe_code)]

use std::ffi::OsString;
use std::process::ExitCode;

use clap::Parser;

pub mod bus_way;
pub mod cli;
pub mod cmd;
pub mod context;
pub mod failure;
pub mod faults;
pub mod gait_file;
pub mod hybrid;
pub mod interrupt;
pub mod link;
pub mod model_file;
pub mod output;
pub mod plot;
pub mod recording;
pub mod robot_file;
pub mod runner;
pub mod searching;
pub mod settings;
pub mod takes;
pub mod upload;

use cli::Cli;
use context::Context;
use failure::Exit;

/// Runs one command line and gives the process exit code.
pub fn run(args: impl IntoIterator<Item = OsString>) -> ExitCode {
    let cli = match Cli::try_parse_from(args) {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version are no failure; clap writes them to standard output itself.
            let code = if error.use_stderr() {
                Exit::Usage
            } else {
                Exit::Ok
            };
            let _ = error.print();
            return ExitCode::from(code.code());
        }
    };
    let json = cli.global.json;
    let result = Context::new(&cli.global).and_then(|context| cli.command.run(&context));
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            output::print_failure(&failure, json);
            ExitCode::from(failure.exit().code())
        }
    }
}
