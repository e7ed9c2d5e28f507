//! What the tests of the board share.

use std::path::Path;

use control::cpg;
use control::gait::Gait;
use hil_sim::board::host::BoardHost;
use hil_sim::board::peer::Motors;
use hil_sim::board::runner::{BoardConfig, BoardRunner};
use hil_sim::board::tools::{self, Built};
use hil_sim::board::wire::Port;
use hil_sim::robot::ideal::IdealMotors;
use protocol::crc::Crc32c;
use protocol::units;

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

/// CRC over the f32 of every set-point, and the set-points, urad: from `control` alone.
pub(crate) fn law(gait: &Gait, cycles: usize) -> (u32, Vec<Vec<i32>>) {
    let mut state = cpg::start(gait);
    let mut crc = Crc32c::new();
    let mut joints = vec![Vec::new(); 6];
    for _ in 0..cycles {
        let points = cpg::step(gait, &mut state, control::CYCLE_S);
        for (joint, &angle) in joints.iter_mut().zip(points.as_slice()) {
            crc.update(&angle.to_le_bytes());
            joint.push(units::urad_from_rad(angle).expect("finite"));
        }
    }
    (crc.value(), joints)
}
