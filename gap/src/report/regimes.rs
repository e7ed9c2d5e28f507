//! Errors by joint and regime of the motion, as a map: the darker, the more above the joint's mean.

use super::markdown::table as lines_of;
use super::page::table;
use super::words::capital;
use crate::regimes::{Aspect, REGIMES, RegimeRow};
use crate::verdict::Verdict;

/// A column of the map: of the body or a joint, one of its errors.
#[derive(Clone, Copy, PartialEq)]
enum Column {
    Angle(Option<usize>),
    Torque(Option<usize>),
    Pose,
}

impl Column {
    /// Its error in a row, in the unit of the head.
    fn of(self, row: &RegimeRow) -> Option<[f64; 2]> {
        let (joint, error) = match self {
            Self::Angle(k) => (k, row.position_rmse_rad.map(|e| e.map(|x| 1e3 * x))),
            Self::Torque(k) => (k, row.effort_rmse_nm),
            Self::Pose => (None, row.pose_rmse_m.map(|e| e.map(|x| 1e3 * x))),
        };
        error.filter(|_| row.joint == joint)
    }

    fn head(self) -> String {
        let joint = |k: Option<usize>| k.map_or_else(|| "joint".into(), |k| format!("joint {k}"));
        match self {
            Self::Angle(k) => format!("{} angle [mrad]", joint(k)),
            Self::Torque(k) => format!("{} torque [N m]", joint(k)),
            Self::Pose => "body, 1 s [mm]".into(),
        }
    }
}

/// What an aspect's regimes are called.
const fn aspect(aspect: Aspect) -> &'static str {
    match aspect {
        Aspect::Motion => "motion",
        Aspect::Direction => "direction",
        Aspect::Phase => "cycle",
        Aspect::Supply => "supply",
        Aspect::Contact => "ground",
    }
}

/// Columns that hold an error, angles first.
fn columns(rows: &[RegimeRow]) -> Vec<Column> {
    let mut joints: Vec<Option<usize>> = rows.iter().map(|r| r.joint).collect();
    joints.sort_unstable();
    joints.dedup();
    let angles = joints.iter().map(|k| Column::Angle(*k));
    let torques = joints.iter().map(|k| Column::Torque(*k));
    let held = |c: &Column| rows.iter().any(|r| c.of(r).is_some());
    let all = angles.chain(torques).chain([Column::Pose]);
    all.filter(held).collect()
}

/// Mean over all time of a column's error before.
fn usual(rows: &[RegimeRow], column: Column, of: Aspect) -> f64 {
    let own = rows.iter().filter(|r| r.aspect == of);
    let square = |r: &RegimeRow| {
        column
            .of(r)
            .map(|[before, _]| (r.time * before * before, r.time))
    };
    let (sum, time) = own
        .filter_map(square)
        .fold((0.0, 0.0), |a, x| (a.0 + x.0, a.1 + x.1));
    (sum / f64::max(time, 1e-12)).sqrt()
}

/// Aspects and regimes that occurred, in their order.
fn lines(rows: &[RegimeRow]) -> Vec<(Aspect, &'static str)> {
    let occurred = |x: &(Aspect, &str)| rows.iter().any(|r| (r.aspect, r.regime) == *x);
    REGIMES.into_iter().filter(occurred).collect()
}

/// Two digits are enough for a map.
fn short(x: f64) -> String {
    if x >= 100.0 {
        format!("{x:.0}")
    } else if x >= 10.0 {
        format!("{x:.1}")
    } else {
        format!("{x:.2}")
    }
}

/// One cell: error before and after, behind it a colour.
fn cell(rows: &[RegimeRow], column: Column, (of, regime): (Aspect, &str)) -> String {
    let mut own = rows.iter().filter(|r| (r.aspect, r.regime) == (of, regime));
    let Some(([before, after], time)) = own.find_map(|r| Some((column.of(r)?, r.time))) else {
        return "–".into();
    };
    let above = (before / usual(rows, column, of).max(1e-12) - 1.0).clamp(0.0, 1.0);
    format!(
        "<span class=\"heat\" style=\"--heat:{:.0}%\" title=\"{:.0} % of the time\">{} → {}</span>",
        60.0 * above,
        100.0 * time,
        short(before),
        short(after)
    )
}

/// The map: a table of angles and one of torques, with a colour behind each cell.
pub(super) fn html(s: &mut String, v: &Verdict) {
    let rows = &v.regimes[..];
    let (torques, angles): (Vec<Column>, Vec<Column>) = columns(rows)
        .into_iter()
        .partition(|c| matches!(c, Column::Torque(_)));
    if angles.is_empty() && torques.is_empty() {
        return;
    }
    s.push_str("<p>Error before → after, held-out runs. A cell is the darker, the more the error before exceeds the mean of its group. Quarters of a cycle: below or above the middle angle, rising or falling.</p>");
    for columns in [angles, torques].into_iter().filter(|c| !c.is_empty()) {
        let mut head = vec!["regime".to_owned()];
        head.extend(columns.iter().map(|c| c.head()));
        let held = |(_, regime): &(Aspect, &str)| {
            let here = |r: &&RegimeRow| r.regime == *regime;
            let mut own = rows.iter().filter(here);
            own.any(|r| columns.iter().any(|c| c.of(r).is_some()))
        };
        let line = |(of, regime): (Aspect, &'static str)| {
            let name = format!("<b>{}</b><br>{}", regime.replace('_', " "), aspect(of));
            let cells = columns.iter().map(|c| cell(rows, *c, (of, regime)));
            std::iter::once(name).chain(cells).collect()
        };
        let body: Vec<Vec<String>> = lines(rows).into_iter().filter(held).map(line).collect();
        let head: Vec<&str> = head.iter().map(String::as_str).collect();
        table(s, &head, &body);
    }
}

/// Of every column the regime with the largest error before, as a narrow table.
pub(super) fn markdown(s: &mut String, v: &Verdict) {
    let rows = &v.regimes[..];
    let line = |c: Column| {
        let held = |r: &RegimeRow| Some((c.of(r)?, r.regime));
        let all = rows.iter().filter_map(held);
        let ([before, after], regime) = all.max_by(|a, b| a.0[0].total_cmp(&b.0[0]))?;
        let (regime, error) = (regime.replace('_', " "), short(before));
        Some(vec![capital(&c.head()), regime, error, short(after)])
    };
    let head = ["error", "largest at", "before", "after"].map(str::to_owned);
    let mut table = vec![head.to_vec()];
    table.extend(columns(rows).into_iter().filter_map(line));
    if table.len() > 1 {
        lines_of(s, &table);
    }
}
