//! What the report shows of a whole robot: errors joint by joint, path and angles of a run, and the robot itself under a time slider.

use super::replay::Replay;
use super::score::JointRow;
use crate::report::{Evidence, number, page, table};
use crate::verdict::Verdict;

/// The page.
pub(super) fn html(v: &Verdict, joints: &[JointRow], replay: Option<&Replay>) -> String {
    let mut plots = String::new();
    let pair = |x: Option<[f64; 2]>| {
        let told = |[before, after]: [f64; 2]| format!("{} to {}", number(before), number(after));
        x.map_or_else(|| "not measured".into(), told)
    };
    let rows: Vec<Vec<String>> = joints
        .iter()
        .map(|r| vec![r.joint.to_string(), pair(r.angle_rad), pair(r.torque_nm)])
        .collect();
    let head = [
        "joint",
        "angle error [rad], before to after",
        "torque error [N m], before to after",
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
    page(
        v,
        &Evidence {
            title: "Diagnosis of a robot",
            plots,
            replay: film,
        },
    )
}
