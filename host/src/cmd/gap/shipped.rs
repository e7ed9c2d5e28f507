//! The gaits that the program carries.

use control::gait::Gait;

use crate::failure::{Exit, Failure, Outcome};

macro_rules! gaits {
    ($folder:literal: $($name:literal),*) => {
        [$(($name, include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../gaits/", $folder, $name, ".toml")))),*]
    };
}

/// Name and text of the gaits written by hand.
const WRITTEN: [(&str, &str); 6] =
    gaits!("": "crawl", "inchworm", "paddle", "roll", "sidewind", "turn");

/// Name and text of `gaits/searched`.
const SEARCHED: [(&str, &str); 17] = gaits!(
    "searched/":
    "g01", "g02", "g03", "g04", "g05", "g06", "g07", "g08", "g09", "g10", "g11", "g12", "g13",
    "g14", "g15", "g16", "g17"
);

/// `count` of the seventeen, spread over them so that both the fittest and the different ones are among them.
///
/// # Errors
/// A count of none or more than seventeen.
pub(super) fn gaits(count: usize) -> Outcome<Vec<Gait>> {
    let all = SEARCHED.len();
    if count == 0 || count > all {
        return Err(Failure::say(
            Exit::Usage,
            format!("{count} gaits asked for; there are 1 to {all}"),
        ));
    }
    let chosen = (0..count).map(|k| SEARCHED[k * all / count]);
    chosen.map(parse).collect()
}

/// Everything that an experiment may be chosen from.
///
/// # Errors
/// None of the gaits as shipped.
pub(super) fn menu() -> Outcome<Vec<Gait>> {
    SEARCHED.into_iter().chain(WRITTEN).map(parse).collect()
}

fn parse((name, text): (&str, &str)) -> Outcome<Gait> {
    files::gait::parse(name, text).map_err(|e| Failure::new(Exit::Other, anyhow::Error::new(e)))
}
