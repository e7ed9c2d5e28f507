//! rb-host: upload, run, record, search, match, diagnose.

use std::process::ExitCode;

fn main() -> ExitCode {
    host::run(std::env::args_os())
}
