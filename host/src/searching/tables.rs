//! The paper's Tables II and III for the user's films.

use std::fmt::Write as _;

use files::model::Key;
use optimise::meta::{FilmedGait, TableIii};
use optimise::table2::{ROWS, implausible_factor, plausible_high};
use serde_json::{Value, json};

/// Table III of the paper: set, R before, R after.
const PAPER: [(&str, f64, f64); 3] = [
    ("training set", 0.250_317, 0.414_293),
    ("test set", 0.325_153, 0.402_104),
    ("all gaits", 0.281_152, 0.409_271),
];

/// R of every gait and of the sets, with one set of parameters.
#[derive(Debug, Clone)]
pub struct Compared {
    /// Means of the sets.
    pub sets: TableIii,
    /// R per gait.
    pub ratios: Vec<f64>,
}

/// Table II: start, fitted and the paper's values, and what no hardware could have.
#[must_use]
pub fn table_ii(start: &[f64; ROWS], fitted: &[f64; ROWS]) -> (String, Value) {
    let mut text = format!(
        "Table II\n # {:28} {:>18} {:>10} {:>10} {:>10}\n",
        "parameter", "range", "start", "fitted", "paper"
    );
    let mut rows = Vec::new();
    for (k, key) in Key::TABLE_II.iter().enumerate() {
        let info = key.info();
        let range = format!("[{}, {}]", info.search.0, info.search.1);
        let factor = implausible_factor(*key, fitted[k]);
        let remark = match (factor, plausible_high(*key)) {
            (Some(factor), Some((_, why))) => format!("  IMPLAUSIBLE: {factor:.1} x {why}"),
            _ => String::new(),
        };
        let _ = writeln!(
            text,
            "{:2} {:28} {range:>18} {:10.5} {:10.5} {:10.5}{remark}",
            k + 1,
            info.path(),
            start[k],
            fitted[k],
            info.meta_optimised
        );
        rows.push(json!({
            "row": k + 1, "name": info.path(), "start": start[k], "fitted": fitted[k], "paper": info.meta_optimised,
            "implausible_factor": factor,
        }));
    }
    (text, Value::from(rows))
}

/// Table III: R before and after, the sets first, then every gait.
#[must_use]
pub fn table_iii(gaits: &[FilmedGait], before: &Compared, after: &Compared) -> (String, Value) {
    let mut text =
        "Table III            before    after   change   (paper: before    after)\n".to_owned();
    let of = |t: &TableIii| [Some(t.training), t.test, Some(t.all)];
    let sets = of(&before.sets).into_iter().zip(of(&after.sets));
    for ((name, paper_before, paper_after), pair) in PAPER.iter().zip(sets) {
        let (Some(b), Some(a)) = pair else { continue };
        let change = if b > 0.0 {
            format!("{:7.1} %", (a / b - 1.0) * 100.0)
        } else {
            format!("{:>9}", "-")
        };
        let _ = writeln!(
            text,
            "{name:16} {b:10.3} {a:8.3} {change}   {paper_before:14.3} {paper_after:8.3}"
        );
    }
    let mut rows = Vec::new();
    for ((filmed, b), a) in gaits.iter().zip(&before.ratios).zip(&after.ratios) {
        let set = if filmed.training { "training" } else { "test" };
        let (name, seen) = (filmed.gait.name(), filmed.share_seen());
        let _ = write!(
            text,
            "  {name:14} {b:10.3} {a:8.3}   {set}, weight {:.4}",
            filmed.weight
        );
        text.push_str(&remark(filmed, seen));
        rows.push(json!({
            "gait": name, "set": set, "before": b, "after": a, "weight": filmed.weight, "share_seen": seen,
        }));
    }
    let value = json!({ "before": before.sets, "after": after.sets, "gaits": rows });
    (text, value)
}

fn remark(filmed: &FilmedGait, seen: f64) -> String {
    let mut text = String::new();
    if seen < 1.0 {
        let _ = write!(text, ", in the picture for {:.0} %", seen * 100.0);
    }
    if filmed.training && filmed.weight <= 0.0 {
        text.push_str(", COUNTS FOR NOTHING in the fit: speed or repeatability is 0");
    }
    text.push('\n');
    text
}
