//! The image in QEMU. Skipped aloud where QEMU is missing; in CI that is a failure.
#![cfg(unix)]

use hil_sim::board::runner::{BoardConfig, BoardRunner, EmptyBus};
use hil_sim::board::tools;
use std::path::Path;

#[test]
fn starts() {
    let built = tools::build(Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()).unwrap();
    let config = BoardConfig {
        qemu: built.qemu,
        elf: built.elf,
        plugin: built.plugin,
        seed: 1,
        regions: vec![],
        stack: None,
        log: None,
    };
    let mut b = BoardRunner::start(&config, EmptyBus).unwrap();
    b.run_until(200_000_000).unwrap();
    println!(
        "{:?}",
        String::from_utf8(b.take_bus_log().iter().map(|b| b.byte).collect())
    );
    println!("{:?}", b.finish().unwrap());
}
