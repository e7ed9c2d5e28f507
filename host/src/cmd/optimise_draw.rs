//! `rb-host optimise draw`

use std::path::PathBuf;

use clap::Args as ClapArgs;
use files::model::{Key, Model};
use optimise::table2::draw;
use serde_json::json;

use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};

#[derive(Debug, ClapArgs)]
pub(super) struct DrawArgs {
    /// File to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Seed of the draw
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Overwrite an existing file
    #[arg(long)]
    force: bool,
}

/// Writes a model whose rows of Table II are drawn evenly from their ranges.
pub(super) fn run(args: &DrawArgs, context: &Context) -> Outcome {
    let mut model = Model::hand_tuned();
    for (key, value) in Key::TABLE_II.iter().zip(draw(args.seed)) {
        model
            .set(*key, value)
            .map_err(|error| Failure::new(Exit::Other, error))?;
    }
    crate::cmd::write_new(&args.output, model.to_toml().as_bytes(), args.force)?;
    let value = json!({ "file": args.output, "seed": args.seed });
    context.out.result("rb.optimise_draw/1", value, || {
        format!(
            "{}: the 22 parameters of Table II drawn with seed {}\n",
            args.output.display(),
            args.seed
        )
    });
    Ok(())
}
