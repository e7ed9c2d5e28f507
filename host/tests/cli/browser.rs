//! A page in a browser: no complaint, no network, by keyboard, on a phone, in print.

use std::path::Path;
use std::process::Command;

use crate::rig::skip;

/// Chromium as Debian, Ubuntu and others call it.
fn chromium() -> Option<&'static str> {
    ["chromium", "chromium-browser", "google-chrome"]
        .into_iter()
        .find(|name| {
            let asked = Command::new(name).arg("--version").output();
            asked.is_ok_and(|o| o.status.success())
        })
}

/// What a reader of `page` meets, as the script beside the foreign clients reports it.
fn read(chromium: &str, page: &Path) -> serde_json::Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap()
        .join("tests/foreign/read_report_in_chromium.py");
    let mut command = Command::new("python3");
    let said = command.arg(script).arg(chromium).arg(page);
    let said = said.output().unwrap();
    let text = String::from_utf8_lossy(&said.stdout).into_owned();
    assert!(
        said.status.success(),
        "{}",
        String::from_utf8_lossy(&said.stderr)
    );
    serde_json::from_str(&text).unwrap()
}

/// Whether a reader gets at everything on `page`; skipped, loudly, where there is no browser.
pub(crate) fn assert_readable(page: &Path) {
    if Command::new("python3").arg("--version").output().is_err() {
        return skip("a page in a browser", "no python3 (`cargo xtask setup`)");
    }
    let Some(chromium) = chromium() else {
        return skip("a page in a browser", "no Chromium (`cargo xtask setup`)");
    };
    let page = read(chromium, page);
    assert_eq!(page["complaints"], serde_json::json!([]), "{page}");
    assert_eq!(page["network"], serde_json::json!([]), "{page}");
    assert_eq!(page["reached_by_tab"], true, "{page}");
    // The slider starts at its beginning, and three steps lead on.
    assert_eq!(page["times"][0], page["times"][1], "{page}");
    assert_ne!(page["times"][1], page["times"][2], "{page}");
    assert_eq!(page["dark"], true, "{page}");
    assert!(page["phone_width_px"].as_u64().unwrap() <= 360, "{page}");
    assert_eq!(page["slider_in_print"], "none", "{page}");
    assert_eq!(page["prints"], true, "{page}");
}
