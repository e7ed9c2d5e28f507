//! rb-host: the tool a person talks to the robot with.
//!
//! [`run`] parses the command line, resolves the settings and calls one module of [`cmd`]. Below that:
//! [`link`] talks to a robot (serial, TCP, Bluetooth serial, or the emulated one in process), [`recording`] writes and
//! reads MCAP files, [`plot`] draws them. Data goes to standard output, everything said to a person to standard error.
#![forbid(unsafe_code)]

use std::ffi::OsString;
use std::io::{ErrorKind, Write};
use std::process::ExitCode;

use clap::{ColorChoice, FromArgMatches};

pub mod bus_way;
pub mod cli;
pub mod cmd;
pub mod context;
pub mod data_folder;
pub mod disk;
pub mod examples;
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
pub mod terminal;
pub mod upload;

use cli::Cli;
use context::Context;
use failure::Exit;
use output::{Level, Output};

/// Runs one command line and gives the process exit code.
pub fn run(args: impl IntoIterator<Item = OsString>) -> ExitCode {
    let parsed = cli::command()
        .try_get_matches_from(args)
        .and_then(|matches| Cli::from_arg_matches(&matches));
    let cli = match parsed {
        Ok(cli) => cli,
        Err(error) => return parse_failed(&error),
    };
    let out = cli.global.output();
    let result = Context::new(&cli.global, out.clone())
        .and_then(|context| out.settle(cli.command.run(&context)));
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            out.failure(&failure);
            ExitCode::from(failure.exit().code())
        }
    }
}

/// Help and version are no failure; clap writes them to standard output itself.
fn parse_failed(error: &clap::Error) -> ExitCode {
    let code = if error.use_stderr() {
        Exit::Usage
    } else {
        Exit::Ok
    };
    match error.print().and_then(|()| std::io::stdout().flush()) {
        Err(lost) if code == Exit::Ok && lost.kind() != ErrorKind::BrokenPipe => {
            Output::new(Level::Normal, false, ColorChoice::Auto)
                .failure(&output::cannot_print(&lost));
            ExitCode::from(Exit::Other.code())
        }
        _ => ExitCode::from(code.code()),
    }
}
