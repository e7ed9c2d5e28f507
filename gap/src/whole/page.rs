//! What the report shows of a whole robot: errors joint by joint, path and angles of a run, and the robot itself under a time slider.

use super::causes::JointRow;
use super::replay::Replay;
use crate::report::{Evidence, Subject, number, page, table};
use crate::verdict::Verdict;

/// The page.
pub(super) fn html(
    v: &Verdict,
    subject: &Subject,
    joints: &[JointRow],
    replay: Option<&Replay>,
) -> String {
    let mut plots = String::new();
    let pair = |x: Option<[f64; 2]>, factor: f64| {
        let both = |e: [f64; 2]| e.map(|x| number(factor * x)).join(" → ");
        x.map_or_else(|| "not measured".into(), both)
    };
    let row = |r: &JointRow| {
        let joint = r.joint.to_string();
        vec![joint, pair(r.angle_rad, 1e3), pair(r.torque_nm, 1.0)]
    };
    let rows: Vec<Vec<String>> = joints.iter().map(row).collect();
    let head = [
        "joint",
        "angle error [mrad], before → after",
        "torque error [N m], before → after",
    ];
    table(&mut plots, &head, &rows);
    let mut film = String::new();
    if let Some(replay) = replay {
        let mut named: Vec<usize> = v.effects.iter().filter_map(|e| e.joint).collect();
        named.sort_unstable();
        named.dedup();
        plots.push_str(&replay.plots(&named));
        replay.html(&mut film);
    }
    let evidence = Evidence {
        plots,
        replay: film,
    };
    page(v, subject, &evidence)
}
