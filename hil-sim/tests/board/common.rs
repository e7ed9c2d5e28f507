//! What the tests of the board share.

use std::path::Path;

use control::gait::Gait;
use hil_sim::board::host::BoardHost;
use hil_sim::board::peer::Motors;
use hil_sim::board::runner::{BoardConfig, BoardRunner};
use hil_sim::board::tools::{self, Built};
use hil_sim::board::wire::Port;
use hil_sim::robot::ideal::IdealMotors;

/// Guest seconds.
pub(crate) const SECOND_NS: u64 = 1_000_000_000;

/// Workspace root.
pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("a member lies in the workspace")
}

/// Image and plugin, or `None` if the test is skipped.
pub(crate) fn built(test: &str) -> Option<Built> {
    tools::built_or_skip(root(), test)
}

/// A shipped gait.
pub(crate) fn gait(name: &str) -> Gait {
    let file = root().join("gaits").join(format!("{name}.toml"));
    let text = std::fs::read_to_string(&file).expect("shipped gait");
    files::gait::parse(&file.to_string_lossy(), &text).expect("shipped gaits are valid")
}

/// A board with ideal motors and a host on its cable.
pub(crate) fn board(config: &BoardConfig) -> (BoardRunner<Motors<IdealMotors>>, BoardHost) {
    let board = BoardRunner::start(config, Motors::new(IdealMotors::new(false))).expect("starts");
    (board, BoardHost::new(Port::Wire))
}
