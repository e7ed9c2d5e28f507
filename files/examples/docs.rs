//! Writes what is published of the readers' own tables: `docs/schema/*.json` and `docs/reference/effects.md`.

use files::schema::Format;
use std::path::Path;

fn main() -> std::io::Result<()> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    for format in Format::ALL {
        let path = docs.join(format!("schema/{}.json", format.name()));
        std::fs::write(path, format!("{:#}\n", format.schema()))?;
    }
    std::fs::write(docs.join("reference/effects.md"), files::effects::page())
}
