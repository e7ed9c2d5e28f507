//! Hands the linker script of the emulated board to the linker.

fn main() {
    let here = std::env::var("CARGO_MANIFEST_DIR").expect("set by cargo");
    println!("cargo:rustc-link-arg-bins=-T{here}/mps2.x");
    println!("cargo:rerun-if-changed=mps2.x");
}
