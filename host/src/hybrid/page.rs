//! The report as one self-contained page.

use std::fmt::Write as _;
use std::path::Path;

use super::account::Account;
use crate::disk;
use crate::failure::Outcome;

/// Style of the page.
const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:980px;margin:2em auto;padding:0 1em}pre{background:#f6f6f3;padding:1em;overflow-x:auto;font-size:13px}img,svg{max-width:100%}h2{margin-top:2em}";

/// The page of the cycles up to `cycle`: tables, pictures and the time account, with everything inside.
///
/// # Errors
/// Exit code 1 when a file cannot be read.
pub(super) fn html(path: &Path, cycle: u32, account: &Account) -> Outcome<String> {
    let mut out = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\"><title>Hybrid optimisation</title><style>{STYLE}</style><h1>Hybrid optimisation</h1>"
    );
    for k in 1..=cycle {
        let folder = path.join(format!("cycle{k}"));
        let _ = write!(out, "<h2>Cycle {k}</h2>");
        svg(&mut out, "Search", &folder.join("search/curve.svg"))?;
        text(
            &mut out,
            "Predicted and achieved",
            &folder.join("resimulate/result.txt"),
        )?;
        png(
            &mut out,
            "Robot above, matched simulation below",
            &folder.join("resimulate/strip.png"),
        )?;
        png(
            &mut out,
            "Robot red, simulation blue, both green",
            &folder.join("resimulate/overlay.png"),
        )?;
        text(
            &mut out,
            "Tables II and III",
            &folder.join("match/tables.txt"),
        )?;
        svg(&mut out, "Match", &folder.join("match/curve.svg"))?;
    }
    let _ = writeln!(
        out,
        "<h2>Time account</h2>{}<pre>{}</pre></html>",
        account.svg(),
        escaped(&account.text())
    );
    Ok(out)
}

fn text(out: &mut String, title: &str, path: &Path) -> Outcome {
    if path.exists() {
        let text = disk::text(path)?;
        let _ = write!(out, "<h3>{title}</h3><pre>{}</pre>", escaped(&text));
    }
    Ok(())
}

fn svg(out: &mut String, title: &str, path: &Path) -> Outcome {
    if path.exists() {
        let _ = write!(out, "<h3>{title}</h3>{}", disk::text(path)?);
    }
    Ok(())
}

fn png(out: &mut String, title: &str, path: &Path) -> Outcome {
    if path.exists() {
        let data = base64(&std::fs::read(path).map_err(|e| disk::bad_file(path, &e))?);
        let _ = write!(
            out,
            "<h3>{title}</h3><img alt=\"{title}\" src=\"data:image/png;base64,{data}\">"
        );
    }
    Ok(())
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

/// RFC 4648, section 4.
fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let mut word = [0; 3];
        word[..chunk.len()].copy_from_slice(chunk);
        let bits = u32::from_be_bytes([0, word[0], word[1], word[2]]);
        for k in 0..4 {
            let index = (bits >> (18 - 6 * k)) & 63;
            let pad = k > chunk.len();
            out.push(if pad {
                '='
            } else {
                char::from(ALPHABET[index as usize])
            });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::base64;

    /// The test vectors of RFC 4648, section 10.
    #[test]
    fn base64_vectors() {
        for (bytes, text) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
    }
}
