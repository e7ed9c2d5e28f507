//! rb-host: upload, run, record, search, match, diagnose.
fn main() {}
