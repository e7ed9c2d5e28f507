//! The searched gaits that the program carries.

use control::gait::Gait;

use crate::failure::{Exit, Failure, Outcome};

macro_rules! gaits {
    ($($name:literal),*) => {
        [$(($name, include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../gaits/searched/", $name, ".toml")))),*]
    };
}

/// Name and text of `gaits/searched`.
const SEARCHED: [(&str, &str); 17] = gaits!(
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
    (0..count)
        .map(|k| {
            let (name, text) = SEARCHED[k * all / count];
            files::gait::parse(name, text)
                .map_err(|e| Failure::new(Exit::Other, anyhow::Error::new(e)))
        })
        .collect()
}
