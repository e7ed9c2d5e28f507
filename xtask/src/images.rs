//! The image of every board, and what its panic messages may point to.

use crate::{elf, setup, sh};
use anyhow::{Context, Result, bail, ensure};
use std::path::PathBuf;

/// The board of the crate's default features: the one that is flashed and run in QEMU.
const DEFAULT: &str = "l475";

/// The target folder of image and plug-in is the one the QEMU tests build into, so they find both ready.
const THUMB: [&str; 6] = [
    "--target",
    "thumbv7em-none-eabihf",
    "--profile",
    "firmware",
    "--target-dir",
    "target/board",
];

/// Our files from which an image may panic: an async function polled after its end, a cell borrowed twice, a part missing at the start. The files of
/// a board, of the application and of the law are not among them.
const MAY_PANIC: [&str; 6] = [
    "firmware/src/shared.rs",
    "firmware/src/tasks.rs",
    "firmware/src/stm32/clock.rs",
    "firmware/src/stm32/log.rs",
    "firmware/src/stm32/start.rs",
    "firmware/src/stm32/uart.rs",
];
/// Where the paths of our files begin in a panic message.
const OURS: [&str; 3] = ["firmware/src/", "control/src/", "protocol/src/"];

/// Every board, the default one last: its image is what stays.
fn boards() -> Result<Vec<String>> {
    let entries = std::fs::read_dir(sh::root().join("firmware/src/board"))?;
    let files = entries
        .flatten()
        .map(|entry| PathBuf::from(entry.file_name()));
    let maps = files.filter(|file| file.extension().is_some_and(|ending| ending == "x"));
    let stems = maps.filter_map(|file| Some(file.file_stem()?.to_str()?.to_owned()));
    let mut boards: Vec<String> = stems.collect();
    boards.sort_by_key(|board| (board == DEFAULT, board.clone()));
    ensure!(
        boards.last().is_some_and(|board| board == DEFAULT),
        "firmware/src/board has no {DEFAULT}.x"
    );
    Ok(boards)
}

/// Cargo's words for the image of `board`.
fn words(command: &str, board: &str) -> Vec<String> {
    let mut words = vec![command.to_owned(), "-p".into(), "firmware".into()];
    words.extend(THUMB.map(str::to_owned));
    if board != DEFAULT {
        words.push("--no-default-features".into());
        words.extend(["--features".into(), format!("board-{board}")]);
    }
    words
}

fn cargo(words: &[String]) -> Result<()> {
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    sh::run("cargo", &words)
}

/// Lints of every board; an image without a board is refused with a reason.
pub(crate) fn lints() -> Result<()> {
    setup::rust_target()?;
    for board in boards()? {
        let mut words = words("clippy", &board);
        words.extend(["--", "-D", "warnings"].map(str::to_owned));
        cargo(&words)?;
    }
    let none = [
        &["check", "-p", "firmware", "--no-default-features"][..],
        &THUMB,
    ]
    .concat();
    let refused = sh::command("cargo", &none).output()?;
    let said = String::from_utf8_lossy(&refused.stderr);
    if refused.status.success() || !said.contains("no board is chosen") {
        bail!("an image without a board was not refused for that reason:\n{said}");
    }
    Ok(())
}

/// Builds the image that is flashed and run unchanged in QEMU.
pub(crate) fn default_image() -> Result<()> {
    setup::rust_target()?;
    cargo(&words("build", DEFAULT))
}

/// The image that was built last.
pub(crate) fn elf() -> PathBuf {
    sh::root().join("target/board/thumbv7em-none-eabihf/firmware/firmware")
}

/// Links the image of every board, and looks from where each may panic.
pub(crate) fn all() -> Result<()> {
    setup::rust_target()?;
    for board in boards()? {
        cargo(&words("build", &board))?;
        let bytes = std::fs::read(elf()).context("the image just built")?;
        let flat = elf::flatten(&bytes)?;
        let places = panic_places(&flat.bytes);
        // An image without any would mean that the paths look different now.
        ensure!(
            !places.is_empty(),
            "{board}: the image names no source file"
        );
        let new: Vec<&String> = places
            .iter()
            .filter(|place| !MAY_PANIC.contains(&place.as_str()))
            .collect();
        ensure!(new.is_empty(), "{board}: a panic is reachable in {new:?}");
        eprintln!("{board}: {} KiB of flash", flat.bytes.len().div_ceil(1024));
    }
    Ok(())
}

/// Our source files that the image names: only a panic message needs them.
fn panic_places(image: &[u8]) -> Vec<String> {
    let mut places = Vec::new();
    for start in OURS {
        let hits = image.windows(start.len()).enumerate();
        for (at, _) in hits.filter(|(_, window)| *window == start.as_bytes()) {
            let rest = image.get(at..).unwrap_or_default();
            let path = rest.iter().take_while(|byte| byte.is_ascii_graphic());
            let path: String = path.map(|byte| char::from(*byte)).collect();
            // The next string begins without a gap.
            let end = path.find(".rs").map_or(path.len(), |end| end + 3);
            places.push(path[..end].to_owned());
        }
    }
    places.sort();
    places.dedup();
    places
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_that_a_panic_names_are_found_in_the_bytes_of_an_image() {
        let image = b"\0\x01firmware/src/app/core.rsfirmware/src/tasks.rs\0core/src/x.rs\xffcontrol/src/cpg.rs";
        let places = panic_places(image);
        let wanted = [
            "control/src/cpg.rs",
            "firmware/src/app/core.rs",
            "firmware/src/tasks.rs",
        ];
        assert_eq!(places, wanted);
    }

    #[test]
    fn every_board_has_its_file_and_its_feature() {
        let root = sh::root();
        let features = std::fs::read_to_string(root.join("firmware/Cargo.toml")).unwrap();
        let boards = boards().unwrap();
        assert!(boards.len() >= 2, "{boards:?}");
        for board in boards {
            assert!(
                root.join(format!("firmware/src/board/{board}.rs"))
                    .is_file()
            );
            assert!(features.contains(&format!("\nboard-{board} = [\"dep:embassy-stm32\", ")));
        }
    }
}
