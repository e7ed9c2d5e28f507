//! The gaits that robots are asked for.

use anyhow::{Context, Result, bail};
use control::gait::Gait;

macro_rules! searched {
    ($($name:literal),*) => {
        [$(($name, include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../gaits/searched/", $name, ".toml")))),*]
    };
}

/// Name and text of `gaits/searched`.
const SEARCHED: [(&str, &str); 17] = searched!(
    "g01", "g02", "g03", "g04", "g05", "g06", "g07", "g08", "g09", "g10", "g11", "g12", "g13",
    "g14", "g15", "g16", "g17"
);

/// `count` of the seventeen, spread over them so that both the fittest and the different ones are among them.
///
/// # Errors
/// A count of none or more than seventeen.
pub fn shipped(count: usize) -> Result<Vec<Gait>> {
    let all = SEARCHED.len();
    if count == 0 || count > all {
        bail!("{count} gaits asked for; there are 1 to {all}");
    }
    let chosen = (0..count).map(|k| SEARCHED[k * all / count]);
    chosen
        .map(|(name, text)| files::gait::parse(name, text).context("a shipped gait"))
        .collect()
}
