//! Scores of a blind check: opened labels against verdicts.

use serde_json::{Value, json};

/// A cause is detectable when an oracle could gain more than this many floors by it.
const DETECTABLE: f64 = 2.0;

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

/// One opened case.
struct Opened<'a> {
    label: &'a Value,
    verdict: &'a Value,
    truth: Vec<&'a str>,
    classes: Vec<Vec<&'a str>>,
}

fn names(v: &Value, key: &str) -> Vec<String> {
    let list = v.as_array().map(Vec::as_slice).unwrap_or_default();
    list.iter()
        .filter_map(|x| x[key].as_str())
        .map(str::to_string)
        .collect()
}

impl<'a> Opened<'a> {
    fn new(pair: &'a (Value, Value)) -> Self {
        let (label, verdict) = pair;
        let array = |v: &'a Value| v.as_array().map(Vec::as_slice).unwrap_or_default();
        let truth = array(&label["planted"])
            .iter()
            .filter_map(|p| p["effect"].as_str())
            .collect();
        let class = |e: &'a Value| -> Vec<&'a str> {
            let own = e["effect"].as_str().unwrap_or("");
            let mine = array(&verdict["ambiguous"])
                .iter()
                .find(|a| array(&a["effects"]).iter().any(|x| x == own));
            mine.map_or(vec![own], |a| {
                array(&a["effects"])
                    .iter()
                    .filter_map(Value::as_str)
                    .collect()
            })
        };
        let classes = array(&verdict["effects"]).iter().map(class).collect();
        Self {
            label,
            verdict,
            truth,
            classes,
        }
    }

    fn kind(&self) -> &str {
        self.label["kind"].as_str().unwrap_or("")
    }

    fn word(&self) -> &str {
        self.verdict["verdict"].as_str().unwrap_or("")
    }

    fn detectable(&self) -> bool {
        let list = self.label["planted"]
            .as_array()
            .map(Vec::as_slice)
            .unwrap_or_default();
        !list.is_empty()
            && list
                .iter()
                .all(|p| p["floors"].as_f64().unwrap_or(0.0) > DETECTABLE)
    }

    fn top_right(&self) -> bool {
        self.classes
            .first()
            .is_some_and(|c| c.len() <= 3 && self.truth.iter().any(|t| c.contains(t)))
    }

    fn hits(&self) -> usize {
        self.truth
            .iter()
            .filter(|t| self.classes.iter().any(|c| c.contains(t)))
            .count()
    }

    fn exact(&self) -> bool {
        self.hits() == self.truth.len() && self.classes.len() == self.truth.len()
    }

    fn stage_right(&self) -> bool {
        let stage =
            |e: &str| gap::vocabulary::Effect::from_name(e).map(gap::vocabulary::Effect::stage);
        let top = self
            .classes
            .first()
            .and_then(|c| c.first())
            .and_then(|e| stage(e));
        self.truth
            .iter()
            .any(|t| stage(t).is_some() && stage(t) == top)
    }

    /// Relative errors of the parameters of rightly named effects.
    fn parameter_errors(&self) -> Vec<f64> {
        let mut out = Vec::new();
        let found = self.verdict["effects"]
            .as_array()
            .map(Vec::as_slice)
            .unwrap_or_default();
        for p in self.label["planted"]
            .as_array()
            .map(Vec::as_slice)
            .unwrap_or_default()
        {
            let Some(e) = found.iter().find(|e| e["effect"] == p["effect"]) else {
                continue;
            };
            // The first parameter is the size of the effect.
            let Some((key, truth)) = p["parameters"].as_object().and_then(|m| {
                let first = gap::vocabulary::Effect::from_name(p["effect"].as_str()?)?
                    .parameters()
                    .first()?;
                Some((*first, m.get(*first)?.as_f64()?))
            }) else {
                continue;
            };
            if let Some(v) = e["parameters"][key]["value"].as_f64() {
                out.push(((v - truth) / truth).abs());
            }
        }
        out
    }

    /// For every parameter of rightly named effects whether its 95 % interval holds the truth.
    fn covered(&self) -> Vec<bool> {
        let list = |v: &'a Value| v.as_array().map(Vec::as_slice).unwrap_or_default();
        let mut out = Vec::new();
        for p in list(&self.label["planted"]) {
            let Some(e) = list(&self.verdict["effects"])
                .iter()
                .find(|e| e["effect"] == p["effect"])
            else {
                continue;
            };
            for (key, truth) in p["parameters"].as_object().into_iter().flatten() {
                let ci = &e["parameters"][key.as_str()]["ci95"];
                if let (Some(t), Some(a), Some(b)) =
                    (truth.as_f64(), ci[0].as_f64(), ci[1].as_f64())
                {
                    out.push(a <= t && t <= b);
                }
            }
        }
        out
    }

    fn told(&self) -> String {
        let planted: Vec<String> = self.label["planted"].as_array().map_or(vec![], |l| {
            l.iter()
                .map(|p| {
                    format!(
                        "{} {} ({:.1} floors)",
                        p["effect"].as_str().unwrap_or(""),
                        p["parameters"],
                        p["floors"].as_f64().unwrap_or(0.0)
                    )
                })
                .collect()
        });
        let said = names(&self.verdict["effects"], "effect").join(", ");
        let name = self.label["name"].as_str().unwrap_or("");
        format!(
            "{name} [{}]: planted {}; said {} [{said}]",
            self.kind(),
            planted.join(" + "),
            self.word()
        )
    }
}

fn share(list: &[&Opened<'_>], test: impl Fn(&Opened<'_>) -> bool) -> Option<f64> {
    (!list.is_empty()).then(|| list.iter().filter(|o| test(o)).count() as f64 / list.len() as f64)
}

pub(super) fn median(mut v: Vec<f64>) -> Option<f64> {
    v.sort_by(f64::total_cmp);
    v.get(v.len() / 2).copied()
}

/// Expected calibration error over ten bins of the top answer's probability.
fn calibration(list: &[&Opened<'_>]) -> Option<f64> {
    let mut bins = [(0.0, 0.0, 0.0); 10];
    for o in list {
        let p = &o.verdict["probabilities"];
        let (none, unknown) = (
            p["none"].as_f64().unwrap_or(0.0),
            p["unknown"].as_f64().unwrap_or(0.0),
        );
        let some = 1.0 - none - unknown;
        let right = match o.kind() {
            "null" => o.word() == "none",
            "outside" => o.word() == "unknown",
            _ => o.hits() > 0,
        };
        let stated = if o.word() == "none" {
            none
        } else if o.word() == "unknown" {
            unknown
        } else {
            some
        };
        let k = ((stated * 10.0) as usize).min(9);
        bins[k].0 += 1.0;
        bins[k].1 += stated;
        bins[k].2 += f64::from(u8::from(right));
    }
    let n = list.len() as f64;
    (n > 0.0).then(|| {
        bins.iter()
            .filter(|b| b.0 > 0.0)
            .map(|b| (b.1 - b.2).abs() / n)
            .sum()
    })
}

/// The figures of the mixed suite.
pub(super) fn table(pairs: &[(Value, Value)]) -> Table {
    let all: Vec<Opened<'_>> = pairs.iter().map(Opened::new).collect();
    let pick = |f: &dyn Fn(&Opened<'_>) -> bool| -> Vec<&Opened<'_>> {
        all.iter().filter(|o| f(o)).collect()
    };
    let nulls = pick(&|o| o.kind() == "null");
    let singles = pick(&|o| o.kind() == "single" && o.detectable());
    let every_single = pick(&|o| o.kind() == "single");
    let pairs = pick(&|o| o.kind() == "pair" && o.detectable());
    let outside = pick(&|o| o.kind() == "outside" && o.detectable());
    let inside = pick(&|o| o.kind() != "outside");
    let known = pick(&|o| matches!(o.kind(), "single" | "pair" | "triple") && o.hits() > 0);
    let hits: usize = pairs.iter().map(|o| o.hits()).sum();
    let said: usize = pairs.iter().map(|o| o.classes.len()).sum();
    let truth: usize = pairs.iter().map(|o| o.truth.len()).sum();
    let ratio = |a: usize, b: usize| (b > 0).then(|| a as f64 / b as f64);
    let sizes: Vec<f64> = known
        .iter()
        .flat_map(|o| o.classes.iter().map(|c| c.len() as f64))
        .collect();
    let shrink: Vec<f64> = singles
        .iter()
        .filter_map(|o| o.verdict["gap"]["shrink_of_achievable"].as_f64())
        .collect();
    let errors: Vec<f64> = singles.iter().flat_map(|o| o.parameter_errors()).collect();
    let covered: Vec<bool> = singles.iter().flat_map(|o| o.covered()).collect();
    let row = |name, value, of, target| Row {
        name,
        value,
        of,
        target,
    };
    let rows = vec![
        row(
            "top-1, detectable singles",
            share(&singles, |o| o.top_right()),
            singles.len(),
            ">= 0.97",
        ),
        row(
            "top-1, all singles",
            share(&every_single, |o| o.top_right()),
            every_single.len(),
            "-",
        ),
        row(
            "exact set, detectable singles",
            share(&singles, |o| o.exact()),
            singles.len(),
            ">= 0.95",
        ),
        row(
            "stage, detectable singles",
            share(&singles, |o| o.stage_right()),
            singles.len(),
            ">= 0.99",
        ),
        row(
            "precision, detectable pairs",
            ratio(hits, said),
            pairs.len(),
            ">= 0.97",
        ),
        row(
            "recall, detectable pairs",
            ratio(hits, truth),
            pairs.len(),
            ">= 0.95",
        ),
        row(
            "exact, detectable pairs",
            share(&pairs, |o| o.exact()),
            pairs.len(),
            ">= 0.90",
        ),
        row(
            "false alarms on nulls (an effect named)",
            share(&nulls, |o| !o.classes.is_empty()),
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
            "unknown found, detectable outside",
            share(&outside, |o| o.word() == "unknown"),
            outside.len(),
            ">= 0.90",
        ),
        row(
            "false unknown",
            share(&inside, |o| o.word() == "unknown"),
            inside.len(),
            "<= 0.05",
        ),
        row(
            "mean class size",
            (!sizes.is_empty()).then(|| sizes.iter().sum::<f64>() / sizes.len() as f64),
            known.len(),
            "<= 1.3",
        ),
        row(
            "shrink of achievable, median",
            median(shrink),
            singles.len(),
            ">= 0.99",
        ),
        row(
            "parameter error, median",
            median(errors.clone()),
            errors.len(),
            "<= 0.02",
        ),
        row(
            "truth inside the 95 % interval",
            ratio(covered.iter().filter(|c| **c).count(), covered.len()),
            covered.len(),
            "0.93 to 0.97",
        ),
        row(
            "confidence calibration error",
            calibration(&all.iter().collect::<Vec<_>>()),
            all.len(),
            "<= 0.05",
        ),
    ];
    let wrong = |o: &&Opened<'_>| match o.kind() {
        "null" => o.word() != "none",
        "outside" => o.detectable() && o.word() != "unknown",
        _ => o.detectable() && !o.exact(),
    };
    Table {
        rows,
        failures: all.iter().filter(wrong).map(Opened::told).collect(),
    }
}

/// The figures with the planted effect withheld from the library.
pub(super) fn left_out(pairs: &[(Value, Value)]) -> Table {
    let all: Vec<Opened<'_>> = pairs.iter().map(Opened::new).collect();
    let detectable: Vec<&Opened<'_>> = all.iter().filter(|o| o.detectable()).collect();
    let far = |o: &&&Opened<'_>| {
        let g = &o.verdict["gap"];
        g["after"].as_f64().unwrap_or(0.0)
            > DETECTABLE * g["floor"].as_f64().unwrap_or(f64::INFINITY)
    };
    let left: Vec<&Opened<'_>> = detectable.iter().filter(far).copied().collect();
    let rest: Vec<&Opened<'_>> = detectable.iter().filter(|o| !far(o)).copied().collect();
    let place = |o: &Opened<'_>| {
        let stage = o
            .truth
            .first()
            .and_then(|t| gap::vocabulary::Effect::from_name(t))
            .map(|e| e.stage().name());
        let said = o.verdict["where"]
            .as_array()
            .map(Vec::as_slice)
            .unwrap_or_default();
        said.iter()
            .find(|w| w["stage"] != "unexplained")
            .and_then(|w| w["stage"].as_str())
            == stage
    };
    let rows = vec![
        Row {
            name: "unknown, more than 2 floors left",
            value: share(&left, |o| o.word() == "unknown"),
            of: left.len(),
            target: "-",
        },
        Row {
            name: "unknown and right stage",
            value: share(&left, |o| o.word() == "unknown" && place(o)),
            of: left.len(),
            target: ">= 0.85",
        },
        Row {
            name: "equivalent with right stage, otherwise",
            value: share(&rest, |o| o.stage_right()),
            of: rest.len(),
            target: "-",
        },
    ];
    let failures = left
        .iter()
        .filter(|o| o.word() != "unknown")
        .map(|o| o.told())
        .collect();
    Table { rows, failures }
}
