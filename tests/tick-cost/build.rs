//! Hands the linker script of the emulated board to the linker, and the shipped gaits to the program as numbers.

use control::gait::Gait;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Folders of shipped gaits, from this package.
const FOLDERS: [&str; 2] = ["../../gaits", "../../gaits/searched"];

fn main() {
    let here = std::env::var("CARGO_MANIFEST_DIR").expect("set by cargo");
    println!("cargo:rustc-link-arg-bins=-T{here}/mps2.x");
    println!("cargo:rerun-if-changed=mps2.x");
    let mut text = String::from("const SHIPPED: &[Shipped] = &[\n");
    for folder in FOLDERS {
        let folder = Path::new(&here).join(folder);
        println!("cargo:rerun-if-changed={}", folder.display());
        for path in gait_files(&folder) {
            let source = std::fs::read_to_string(&path).expect("a gait file");
            let name = path.display().to_string();
            literal(
                &files::gait::parse(&name, &source).expect("a shipped gait"),
                &mut text,
            );
        }
    }
    text.push_str("];\n");
    let out = std::env::var("OUT_DIR").expect("set by cargo");
    std::fs::write(Path::new(&out).join("shipped.rs"), text).expect("a writable folder");
}

fn gait_files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("a folder of gaits");
    let paths = entries.map(|entry| entry.expect("a file").path());
    let mut paths: Vec<PathBuf> = paths
        .filter(|path| path.extension().is_some_and(|e| e == "toml"))
        .collect();
    paths.sort();
    paths
}

/// One gait as an element of the array; numbers by their bits.
fn literal(gait: &Gait, text: &mut String) {
    let head = (gait.frequency_hz().to_bits(), gait.rate_a_per_s().to_bits());
    let _ = write!(
        text,
        "    Shipped {{ frequency_rate: {head:?}, oscillators: &["
    );
    for o in gait.oscillators() {
        let bits = [o.amplitude_rad, o.offset_rad, o.initial_phase_rad].map(f32::to_bits);
        let _ = write!(text, "{bits:?}, ");
    }
    text.push_str("], links: &[");
    for l in gait.links() {
        let link = (l.from, l.to, l.weight.to_bits(), l.phase_lag_rad.to_bits());
        let _ = write!(text, "{link:?}, ");
    }
    text.push_str("] },\n");
}
