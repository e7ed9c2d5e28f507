//! Set-up, tests, firmware builds, tables.
fn main() {}
