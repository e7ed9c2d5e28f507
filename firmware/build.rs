//! Linker arguments and memory map of the image; nothing to do for the host library but to count the boards.

use std::path::PathBuf;

const FEATURE: &str = "CARGO_FEATURE_BOARD_";

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-check-cfg=cfg(boards, values(\"none\", \"one\", \"several\"))");
    let features =
        std::env::vars().filter_map(|(name, _)| Some(name.strip_prefix(FEATURE)?.to_lowercase()));
    let boards: Vec<String> = features.collect();
    let count = match boards.len() {
        0 => "none",
        1 => "one",
        _ => "several",
    };
    println!("cargo::rustc-cfg=boards=\"{count}\"");
    let ([board], Ok("none")) = (&boards[..], std::env::var("CARGO_CFG_TARGET_OS").as_deref())
    else {
        return;
    };
    let map = format!("src/board/{board}.x");
    println!("cargo::rerun-if-changed={map}");
    println!("cargo::rerun-if-changed=../memory.x");
    let folder = PathBuf::from(std::env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    if let Err(error) = std::fs::copy(&map, folder.join("board.x")) {
        println!("cargo::error=the memory map of board `{board}`, firmware/{map}: {error}");
    }
    println!("cargo::rustc-link-search={}", folder.display());
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
}
