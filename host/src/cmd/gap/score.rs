//! Opened labels against verdicts: one case, groups of cases, and the table of figures that every check writes.

use gap::vocabulary::Effect;
use serde_json::{Value, json};

/// A cause is detectable when an oracle could gain more than this many floors by it.
const DETECTABLE: f64 = 2.0;
/// Largest class that counts as an answer.
const CLASS: usize = 3;

/// Score table.
pub(super) struct Table {
    rows: Vec<Row>,
    /// Cases that failed, in words.
    pub(super) failures: Vec<String>,
}

/// One figure of a table.
pub(super) struct Row {
    pub(super) name: &'static str,
    pub(super) value: Option<f64>,
    pub(super) of: usize,
    pub(super) target: &'static str,
}

impl Table {
    pub(super) fn new(rows: Vec<Row>, failures: Vec<String>) -> Self {
        Self { rows, failures }
    }

    pub(super) fn markdown(&self) -> String {
        let mut s = String::from("| figure | value | cases | target |\n|---|---|---|---|\n");
        for r in &self.rows {
            let value = r.value.map_or("-".into(), |v| format!("{v:.3}"));
            s.push_str(&format!(
                "| {} | {value} | {} | {} |\n",
                r.name, r.of, r.target
            ));
        }
        s.push_str("\nCases that failed:\n\n");
        for f in &self.failures {
            s.push_str(&format!("- {f}\n"));
        }
        s
    }

    pub(super) fn json(&self) -> Value {
        self.rows.iter().map(|r| json!({ "figure": r.name, "value": r.value, "cases": r.of, "target": r.target })).collect()
    }
}

/// A figure with its number of cases and what was aimed at.
pub(super) fn row(name: &'static str, value: Option<f64>, of: usize, target: &'static str) -> Row {
    Row {
        name,
        value,
        of,
        target,
    }
}

/// Effect and joint.
type Cause = (String, Option<u64>);

fn list(v: &Value) -> &[Value] {
    v.as_array().map(Vec::as_slice).unwrap_or_default()
}

fn cause(v: &Value) -> Cause {
    let name = v["effect"].as_str().unwrap_or("");
    (name.to_owned(), v["joint"].as_u64())
}

/// Stage of an effect; those that no vocabulary holds have one too.
fn stage(effect: &str) -> &'static str {
    match effect {
        "position_friction" | "hysteretic_spring" => "drivetrain",
        "zero_drift" => "conventions",
        "asymmetric_gain" => "electrical",
        "friction_drift" => "body",
        name => Effect::from_name(name).map_or("", |e| e.stage().name()),
    }
}

/// One opened case.
pub(super) struct Opened {
    pub(super) label: Value,
    pub(super) verdict: Value,
    pub(super) truth: Vec<Cause>,
    /// What was said: for each effect found, the members of its class.
    pub(super) said: Vec<Vec<Cause>>,
    /// Base effects whose nominal value had to be taken off by more than three tolerances, the farthest first; none of them is an
    /// effect that was said.
    displaced: Vec<Cause>,
}

impl Opened {
    /// A case of the whole robot.
    pub(super) fn new((label, verdict): &(Value, Value)) -> Self {
        let class = |e: &Value| {
            let own = cause(e);
            let members = |a: &Value| list(&a["members"]).iter().map(cause).collect::<Vec<_>>();
            list(&verdict["ambiguous"])
                .iter()
                .map(members)
                .find(|m| m.contains(&own))
                .unwrap_or_else(|| vec![own])
        };
        Self {
            truth: list(&label["planted"]).iter().map(cause).collect(),
            said: list(&verdict["effects"]).iter().map(class).collect(),
            displaced: list(&verdict["displaced"]).iter().map(cause).collect(),
            label: label.clone(),
            verdict: verdict.clone(),
        }
    }

    /// A case of one joint: its verdict has a joint's number, its label has none.
    pub(super) fn bench((label, verdict): &(Value, Value)) -> Self {
        let mut verdict = verdict.clone();
        let blank = |list: &mut Value| {
            for row in list.as_array_mut().into_iter().flatten() {
                row["joint"] = Value::Null;
            }
        };
        blank(&mut verdict["effects"]);
        blank(&mut verdict["displaced"]);
        for class in verdict["ambiguous"].as_array_mut().into_iter().flatten() {
            blank(&mut class["members"]);
        }
        Self::new(&(label.clone(), verdict))
    }

    pub(super) fn kind(&self) -> &str {
        self.label["kind"].as_str().unwrap_or("")
    }

    pub(super) fn word(&self) -> &str {
        self.verdict["verdict"].as_str().unwrap_or("")
    }

    pub(super) fn floors(&self, key: &str) -> bool {
        self.above(key, DETECTABLE)
    }

    fn above(&self, key: &str, least: f64) -> bool {
        let planted = list(&self.label["planted"]);
        let size = |p: &Value| p[key].as_f64().or_else(|| p["floors"].as_f64());
        let enough = |p: &Value| size(p).unwrap_or(0.0) > least;
        !planted.is_empty() && planted.iter().all(enough)
    }

    /// Whether every planted cause adds two floors to the error that a diagnosis without it is left with: what is left adds to the floor by squares.
    pub(super) fn adds(&self, key: &str) -> bool {
        let least = ((1.0 + DETECTABLE).powi(2) - 1.0).sqrt();
        self.above(key, least)
    }

    pub(super) fn top_right(&self) -> bool {
        let first = self.said.first();
        first.is_some_and(|c| c.len() <= CLASS && self.truth.iter().any(|t| c.contains(t)))
    }

    pub(super) fn hits(&self) -> usize {
        let named = |t: &&Cause| self.said.iter().any(|c| c.len() <= CLASS && c.contains(t));
        self.truth.iter().filter(named).count()
    }

    pub(super) fn exact(&self) -> bool {
        self.hits() == self.truth.len() && self.said.len() == self.truth.len()
    }

    /// Place of the first effect said.
    fn said_at(&self) -> Option<(&str, Option<u64>)> {
        let (effect, joint) = self.said.first().and_then(|c| c.first())?;
        Some((stage(effect), *joint))
    }

    /// The first place of the gap.
    fn seen_at(&self) -> Option<(&str, Option<u64>)> {
        let known = |w: &&Value| w["stage"] != "unexplained";
        let first = list(&self.verdict["where"]).iter().find(known)?;
        Some((first["stage"].as_str()?, first["joint"].as_u64()))
    }

    /// The first effect said, or where there is none or something unknown, the first place of the gap.
    fn place(&self) -> (&str, Option<u64>) {
        let place = if self.word() == "unknown" {
            self.seen_at()
        } else {
            self.said_at().or_else(|| self.seen_at())
        };
        place.unwrap_or(("", None))
    }

    fn true_stage(&self, place: Option<(&str, Option<u64>)>) -> bool {
        place.is_some_and(|(said, _)| self.truth.iter().any(|(t, _)| stage(t) == said))
    }

    /// Whether the first effect said acts in a stage of the truth.
    pub(super) fn stage_said(&self) -> bool {
        self.true_stage(self.said_at())
    }

    /// Whether nothing but a nominal value beyond three tolerances was declared to take the effect's place.
    pub(super) fn displaced_only(&self) -> bool {
        self.said.is_empty() && !self.displaced.is_empty()
    }

    /// Whether that value is the parameter of the planted effect itself.
    pub(super) fn displaced_itself(&self) -> bool {
        let first = self.displaced.first().filter(|_| self.said.is_empty());
        first.is_some_and(|c| self.truth.contains(c))
    }

    /// Whether what was declared to take the effect's place acts in a stage of the truth: the first effect said, or where none
    /// was said, the nominal value that was taken off farthest, by more than three tolerances.
    pub(super) fn equivalent_stage(&self) -> bool {
        if !self.displaced_only() {
            return self.stage_said();
        }
        let first = self.displaced.first();
        self.true_stage(first.map(|(effect, joint)| (stage(effect), *joint)))
    }

    /// Whether the first place of the gap is a stage of the truth, whatever effects were said.
    pub(super) fn stage_seen(&self) -> bool {
        self.true_stage(self.seen_at())
    }

    pub(super) fn stage_right(&self) -> bool {
        self.true_stage(Some(self.place()))
    }

    pub(super) fn joint_right(&self) -> bool {
        let (_, said) = self.place();
        self.truth.iter().any(|(_, joint)| *joint == said)
    }

    /// Whether the best that was found leaves more than two floors. Where neither an effect nor a nominal value beyond its
    /// tolerances was declared, all of a detectable effect is left.
    pub(super) fn far_off(&self) -> bool {
        let floor = self.verdict["gap"]["floor"].as_f64();
        self.silent_or(|after| after > DETECTABLE * floor.unwrap_or(f64::INFINITY))
    }

    /// The same in floors of the method: what the verdict `whole` of the same case, which had all of the library, leaves where it is right, if that is more
    /// than repeats differ by.
    pub(super) fn far_from(&self, whole: Option<&Value>) -> bool {
        let right = |w: &&Value| Self::new(&(self.label.clone(), (*w).clone())).hits() > 0;
        let metric = self.verdict["gap"]["metric"].as_str().unwrap_or("");
        let left = whole.filter(right).map(|w| &w["metrics"][metric][2]);
        let left = left.and_then(Value::as_f64).unwrap_or(0.0);
        self.far_off() && self.silent_or(|after| after > DETECTABLE * left)
    }

    /// Whether nothing was declared, or else what is left `is` so.
    fn silent_or(&self, is: impl Fn(f64) -> bool) -> bool {
        let silent = self.said.is_empty() && self.displaced.is_empty();
        silent || is(self.verdict["gap"]["after"].as_f64().unwrap_or(0.0))
    }

    /// Relative error of the first parameter of each rightly named effect.
    pub(super) fn parameter_errors(&self) -> Vec<f64> {
        let error = |p: &Value| {
            let found = list(&self.verdict["effects"])
                .iter()
                .find(|e| cause(e) == cause(p))?;
            let effect = Effect::from_name(p["effect"].as_str()?)?;
            let key = effect.parameters().first()?.key;
            let truth = p["parameters"][key].as_f64()?;
            let said = found["parameters"][key]["value"].as_f64()?;
            Some(((said - truth) / truth).abs())
        };
        list(&self.label["planted"])
            .iter()
            .filter_map(error)
            .collect()
    }

    /// For every parameter of rightly named effects whether its 95 % interval holds the truth.
    pub(super) fn covered(&self) -> Vec<bool> {
        let mut out = Vec::new();
        for p in list(&self.label["planted"]) {
            let mut found = list(&self.verdict["effects"]).iter();
            let Some(e) = found.find(|e| cause(e) == cause(p)) else {
                continue;
            };
            for (key, truth) in p["parameters"].as_object().into_iter().flatten() {
                let ci = &e["parameters"][key.as_str()]["ci95"];
                let ends = (truth.as_f64(), ci[0].as_f64(), ci[1].as_f64());
                if let (Some(t), Some(a), Some(b)) = ends {
                    out.push(a <= t && t <= b);
                }
            }
        }
        out
    }

    /// Stated probability of what was said, and whether it was right.
    fn stated(&self) -> (f64, bool) {
        let p = |key: &str| self.verdict["probabilities"][key].as_f64().unwrap_or(0.0);
        let right = match self.kind() {
            "null" => self.word() == "none",
            "outside" => self.word() == "unknown",
            _ => self.hits() > 0,
        };
        let stated = match self.word() {
            "none" => p("none"),
            "unknown" => p("unknown"),
            _ => 1.0 - p("none") - p("unknown"),
        };
        (stated, right)
    }

    /// The first place of an unknown gap and the nominal values off, where there are such.
    fn place_told(&self) -> String {
        let place = self.seen_at().filter(|_| self.word() == "unknown");
        let place = place.map_or(String::new(), |(stage, _)| format!(" in {stage}"));
        let names: Vec<&str> = self.displaced.iter().map(|c| c.0.as_str()).collect();
        match names.as_slice() {
            [] => place,
            some => format!("{place}, off: {}", some.join(", ")),
        }
    }

    pub(super) fn told(&self) -> String {
        let name = |c: &Cause| {
            let joint = c.1.map_or(String::new(), |j| format!("@{j}"));
            format!("{}{joint}", c.0)
        };
        let planted: Vec<String> = list(&self.label["planted"])
            .iter()
            .map(|p| {
                let f = |key: &str| p[key].as_f64().unwrap_or(0.0);
                let mut size = format!("{:.1} floors", f("floors"));
                if p["floors_any"] != p["floors"] {
                    size.push_str(&format!(", any channel {:.1}", f("floors_any")));
                }
                if p["readings_too"] == true {
                    size.push_str(", readings too");
                }
                format!("{} {} ({size})", name(&cause(p)), p["parameters"])
            })
            .collect();
        let said: Vec<String> = self
            .said
            .iter()
            .map(|c| c.iter().map(name).collect::<Vec<_>>().join("|"))
            .collect();
        format!(
            "{} [{}]: planted {}; said {} [{}]{}",
            self.label["name"].as_str().unwrap_or(""),
            self.kind(),
            if planted.is_empty() {
                "nothing".to_owned()
            } else {
                planted.join(" + ")
            },
            self.word(),
            said.join(", "),
            self.place_told()
        )
    }
}

pub(super) type Group<'a> = &'a [&'a Opened];

pub(super) fn share(group: Group<'_>, test: impl Fn(&Opened) -> bool) -> Option<f64> {
    let right = group.iter().filter(|o| test(o)).count();
    (!group.is_empty()).then(|| right as f64 / group.len() as f64)
}

/// All over some, where there are some.
pub(super) fn ratio(some: usize, all: usize) -> Option<f64> {
    (all > 0).then(|| some as f64 / all as f64)
}

pub(super) fn median(mut v: Vec<f64>) -> Option<f64> {
    v.sort_by(f64::total_cmp);
    v.get(v.len() / 2).copied()
}

/// The figures that every suite ends with: size of classes, shrink, parameters, intervals.
pub(super) fn sizes(known: Group<'_>, singles: Group<'_>) -> Vec<Row> {
    let right = || known.iter().filter(|o| o.hits() > 0);
    let classes = || right().flat_map(|o| &o.said);
    let members: usize = classes().map(Vec::len).sum();
    let shrink: Vec<f64> = singles
        .iter()
        .filter_map(|o| o.verdict["gap"]["shrink_of_achievable"].as_f64())
        .collect();
    let errors: Vec<f64> = singles.iter().flat_map(|o| o.parameter_errors()).collect();
    let covered: Vec<bool> = singles.iter().flat_map(|o| o.covered()).collect();
    let inside = covered.iter().filter(|c| **c).count();
    let (shrinks, sizes) = (shrink.len(), errors.len());
    vec![
        row(
            "mean class size",
            ratio(members, classes().count()),
            right().count(),
            "<= 1.3",
        ),
        row(
            "shrink of achievable, median",
            median(shrink),
            shrinks,
            ">= 0.99",
        ),
        row("parameter error, median", median(errors), sizes, "<= 0.02"),
        row(
            "truth inside the 95 % interval",
            ratio(inside, covered.len()),
            covered.len(),
            "0.93 to 0.97",
        ),
    ]
}

/// Precision, recall and exactness of cases with several causes.
pub(super) fn several(group: Group<'_>, names: [&'static str; 3]) -> Vec<Row> {
    let count = |f: &dyn Fn(&Opened) -> usize| group.iter().map(|o| f(o)).sum::<usize>();
    let (hits, n) = (count(&Opened::hits), group.len());
    let precision = ratio(hits, count(&|o| o.said.len()));
    let recall = ratio(hits, count(&|o| o.truth.len()));
    let exact = share(group, Opened::exact);
    vec![
        row(names[0], precision, n, ">= 0.97"),
        row(names[1], recall, n, ">= 0.95"),
        row(names[2], exact, n, ">= 0.90"),
    ]
}

/// None and unknown; `clear` are the cases that can be seen.
pub(super) fn words(all: &[Opened], clear: &dyn Fn(&Opened) -> bool) -> Vec<Row> {
    let pick =
        |f: &dyn Fn(&Opened) -> bool| -> Vec<&Opened> { all.iter().filter(|o| f(o)).collect() };
    let nulls = pick(&|o| o.kind() == "null");
    let outside = pick(&|o| o.kind() == "outside" && clear(o));
    let inside = pick(&|o| o.kind() != "outside");
    let unknown = |o: &Opened| o.word() == "unknown";
    vec![
        row(
            "false alarms on nulls (an effect named)",
            share(&nulls, |o| !o.said.is_empty()),
            nulls.len(),
            "<= 0.01",
        ),
        row(
            "nulls called none",
            share(&nulls, |o| o.word() == "none"),
            nulls.len(),
            "-",
        ),
        row(
            "nulls with a nominal value > 3 tolerances off",
            share(&nulls, |o| !o.displaced.is_empty()),
            nulls.len(),
            "-",
        ),
        row(
            "unknown found, detectable outside",
            share(&outside, unknown),
            outside.len(),
            ">= 0.90",
        ),
        row(
            "unknown found and right stage",
            share(&outside, |o| unknown(o) && o.stage_right()),
            outside.len(),
            "-",
        ),
        row(
            "false unknown",
            share(&inside, unknown),
            inside.len(),
            "<= 0.05",
        ),
    ]
}

/// Cases that failed, in words; `clear` are those that can be seen.
pub(super) fn failures(all: &[Opened], clear: &dyn Fn(&Opened) -> bool) -> Vec<String> {
    let wrong = |o: &&Opened| match o.kind() {
        "null" => o.word() != "none",
        "outside" => clear(o) && o.word() != "unknown",
        _ => clear(o) && !o.exact(),
    };
    all.iter().filter(wrong).map(Opened::told).collect()
}

/// Expected calibration error over ten bins of the stated probability.
pub(super) fn calibration(all: Group<'_>) -> Option<f64> {
    let mut bins = [(0.0, 0.0); 10];
    for o in all {
        let (stated, right) = o.stated();
        let bin = &mut bins[((stated * 10.0) as usize).min(9)];
        bin.0 += stated;
        bin.1 += f64::from(u8::from(right));
    }
    let off: f64 = bins
        .iter()
        .map(|(stated, right)| (stated - right).abs())
        .sum();
    (!all.is_empty()).then(|| off / all.len() as f64)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::Opened;

    #[test]
    fn a_cause_adds_two_floors_from_root_eight_floors_on() {
        for (floors, detectable, adds) in [
            (&[1.9][..], false, false),
            (&[2.1], true, false),
            (&[2.82], true, false),
            (&[2.83], true, true),
            (&[9.0, 2.5], true, false),
            (&[9.0, 3.0], true, true),
            (&[], false, false),
        ] {
            let planted: Vec<_> = (floors.iter())
                .map(|f| json!({ "effect": "mass", "floors": f }))
                .collect();
            let case = Opened::new(&(json!({ "planted": planted }), json!({})));
            assert_eq!(case.floors("floors"), detectable, "{floors:?}");
            assert_eq!(case.adds("floors"), adds, "{floors:?}");
        }
    }
}
