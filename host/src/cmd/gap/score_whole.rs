//! Scores of the whole-robot blind check: opened labels against verdicts, by effect and joint.

use gap::vocabulary::Effect;
use serde_json::Value;

use super::score::{Row, Table, median};

/// A cause is detectable when an oracle could gain more than this many floors by it.
const DETECTABLE: f64 = 2.0;
/// Largest class that counts as an answer.
const CLASS: usize = 3;

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
pub(super) fn stage(effect: &str) -> &'static str {
    match effect {
        "position_friction" | "hysteretic_spring" => "drivetrain",
        "zero_drift" => "conventions",
        "asymmetric_gain" => "electrical",
        "friction_drift" => "body",
        name => Effect::from_name(name).map_or("", |e| e.stage().name()),
    }
}

/// One opened case.
struct Opened {
    label: Value,
    verdict: Value,
    truth: Vec<Cause>,
    /// What was said: for each effect found, the members of its class.
    said: Vec<Vec<Cause>>,
}

impl Opened {
    fn new((label, verdict): &(Value, Value)) -> Self {
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
            label: label.clone(),
            verdict: verdict.clone(),
        }
    }

    fn kind(&self) -> &str {
        self.label["kind"].as_str().unwrap_or("")
    }

    fn word(&self) -> &str {
        self.verdict["verdict"].as_str().unwrap_or("")
    }

    fn floors(&self, key: &str) -> bool {
        let planted = list(&self.label["planted"]);
        let enough = |p: &Value| p[key].as_f64().unwrap_or(0.0) > DETECTABLE;
        !planted.is_empty() && planted.iter().all(enough)
    }

    fn top_right(&self) -> bool {
        let first = self.said.first();
        first.is_some_and(|c| c.len() <= CLASS && self.truth.iter().any(|t| c.contains(t)))
    }

    fn hits(&self) -> usize {
        let named = |t: &&Cause| self.said.iter().any(|c| c.len() <= CLASS && c.contains(t));
        self.truth.iter().filter(named).count()
    }

    fn exact(&self) -> bool {
        self.hits() == self.truth.len() && self.said.len() == self.truth.len()
    }

    /// The first effect said, or where there is none, the first place of the gap.
    fn place(&self) -> (&str, Option<u64>) {
        if let Some((effect, joint)) = self.said.first().and_then(|c| c.first()) {
            return (stage(effect), *joint);
        }
        let known = |w: &&Value| w["stage"] != "unexplained";
        let first = list(&self.verdict["where"]).iter().find(known);
        first.map_or(("", None), |w| {
            (w["stage"].as_str().unwrap_or(""), w["joint"].as_u64())
        })
    }

    fn stage_right(&self) -> bool {
        let (said, _) = self.place();
        self.truth.iter().any(|(t, _)| stage(t) == said)
    }

    fn joint_right(&self) -> bool {
        let (_, said) = self.place();
        self.truth.iter().any(|(_, joint)| *joint == said)
    }

    /// Whether the best that was found leaves more than two floors.
    fn far_off(&self) -> bool {
        let g = &self.verdict["gap"];
        let floor = g["floor"].as_f64().unwrap_or(f64::INFINITY);
        g["after"].as_f64().unwrap_or(0.0) > DETECTABLE * floor
    }

    /// Relative error of the first parameter of each rightly named effect.
    fn parameter_errors(&self) -> Vec<f64> {
        let error = |p: &Value| {
            let found = list(&self.verdict["effects"])
                .iter()
                .find(|e| cause(e) == cause(p))?;
            let key = *Effect::from_name(p["effect"].as_str()?)?
                .parameters()
                .first()?;
            let truth = p["parameters"][key].as_f64()?;
            let said = found["parameters"][key]["value"].as_f64()?;
            Some(((said - truth) / truth).abs())
        };
        list(&self.label["planted"])
            .iter()
            .filter_map(error)
            .collect()
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

    fn told(&self) -> String {
        let name = |c: &Cause| {
            let joint = c.1.map_or(String::new(), |j| format!("@{j}"));
            format!("{}{joint}", c.0)
        };
        let planted: Vec<String> = list(&self.label["planted"])
            .iter()
            .map(|p| {
                let f = |key: &str| p[key].as_f64().unwrap_or(0.0);
                let at = if p["readings_too"] == true {
                    ", readings too"
                } else {
                    ""
                };
                format!(
                    "{} {} ({:.1} floors, any channel {:.1}{at})",
                    name(&cause(p)),
                    p["parameters"],
                    f("floors"),
                    f("floors_any")
                )
            })
            .collect();
        let said: Vec<String> = self
            .said
            .iter()
            .map(|c| c.iter().map(name).collect::<Vec<_>>().join("|"))
            .collect();
        format!(
            "{} [{}]: planted {}; said {} [{}]",
            self.label["name"].as_str().unwrap_or(""),
            self.kind(),
            if planted.is_empty() {
                "nothing".to_owned()
            } else {
                planted.join(" + ")
            },
            self.word(),
            said.join(", ")
        )
    }
}

type Group<'a> = &'a [&'a Opened];

fn share(group: Group<'_>, test: impl Fn(&Opened) -> bool) -> Option<f64> {
    let right = group.iter().filter(|o| test(o)).count();
    (!group.is_empty()).then(|| right as f64 / group.len() as f64)
}

/// Expected calibration error over ten bins of the stated probability.
fn calibration(all: Group<'_>) -> Option<f64> {
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

fn row(name: &'static str, value: Option<f64>, of: usize, target: &'static str) -> Row {
    Row {
        name,
        value,
        of,
        target,
    }
}

/// The figures of a suite.
pub(super) fn table(pairs: &[(Value, Value)]) -> Table {
    let all: Vec<Opened> = pairs.iter().map(Opened::new).collect();
    let pick =
        |f: &dyn Fn(&Opened) -> bool| -> Vec<&Opened> { all.iter().filter(|o| f(o)).collect() };
    let motion = |o: &Opened| o.floors("floors");
    let any = |o: &Opened| o.floors("floors_any");
    let one = pick(&|o| o.kind() == "single" && motion(o));
    let one_any = pick(&|o| o.kind() == "single" && any(o));
    let one_all = pick(&|o| o.kind() == "single");
    let more = pick(&|o| matches!(o.kind(), "pair" | "triple") && any(o));
    let mut rows = singles(&one, &one_any, &one_all);
    rows.extend(several(&more));
    rows.extend(words(&all));
    let known = pick(&|o| !matches!(o.kind(), "null" | "outside"));
    // Of what nobody can see, no probability is right.
    let clear = pick(&|o| o.kind() == "null" || any(o));
    let sizes: Vec<f64> = known
        .iter()
        .filter(|o| o.hits() > 0)
        .flat_map(|o| o.said.iter().map(|c| c.len() as f64))
        .collect();
    let mean = (!sizes.is_empty()).then(|| sizes.iter().sum::<f64>() / sizes.len() as f64);
    rows.push(row("mean class size", mean, sizes.len(), "<= 1.3"));
    let shrink: Vec<f64> = one_any
        .iter()
        .filter_map(|o| o.verdict["gap"]["shrink_of_achievable"].as_f64())
        .collect();
    let of = shrink.len();
    rows.push(row(
        "shrink of achievable, median",
        median(shrink),
        of,
        ">= 0.99",
    ));
    let errors: Vec<f64> = one_any.iter().flat_map(|o| o.parameter_errors()).collect();
    let of = errors.len();
    rows.push(row(
        "parameter error, median",
        median(errors),
        of,
        "<= 0.02",
    ));
    rows.push(row(
        "confidence calibration error, nulls and detectable",
        calibration(&clear),
        clear.len(),
        "<= 0.05",
    ));
    let times = all
        .iter()
        .filter_map(|o| o.verdict["provenance"]["wall_time_s"].as_f64())
        .collect();
    rows.push(row(
        "wall time of a diagnosis, median, s",
        median(times),
        all.len(),
        "<= 60",
    ));
    let wrong = |o: &&Opened| match o.kind() {
        "null" => o.word() != "none",
        "outside" => any(o) && o.word() != "unknown",
        _ => any(o) && !o.exact(),
    };
    Table::new(rows, all.iter().filter(wrong).map(Opened::told).collect())
}

/// The figures with the planted effect of every single withheld from the library.
pub(super) fn left_out(pairs: &[(Value, Value)]) -> Table {
    let all: Vec<Opened> = pairs.iter().map(Opened::new).collect();
    let clear: Vec<&Opened> = all.iter().filter(|o| o.floors("floors_any")).collect();
    let (far, near): (Vec<&Opened>, Vec<&Opened>) =
        clear.iter().copied().partition(|o| o.far_off());
    let unknown = |o: &Opened| o.word() == "unknown";
    let placed = |o: &Opened| o.stage_right() && o.joint_right();
    let right = |o: &Opened| unknown(o) && placed(o);
    let equivalent = |o: &Opened| !o.said.is_empty() && placed(o);
    let wrong = |o: &&&Opened| {
        if o.far_off() {
            !right(o)
        } else {
            !equivalent(o)
        }
    };
    Table::new(
        vec![
            row(
                "unknown, more than 2 floors left",
                share(&far, unknown),
                far.len(),
                "-",
            ),
            row(
                "unknown, right stage and joint, more than 2 floors left",
                share(&far, right),
                far.len(),
                ">= 0.85",
            ),
            row(
                "something said or unknown, more than 2 floors left",
                share(&far, |o| o.word() != "none"),
                far.len(),
                "-",
            ),
            row(
                "an equivalent with right stage and joint, otherwise",
                share(&near, equivalent),
                near.len(),
                ">= 0.85",
            ),
        ],
        clear.iter().filter(wrong).map(|o| o.told()).collect(),
    )
}

fn singles(one: Group<'_>, any: Group<'_>, all: Group<'_>) -> Vec<Row> {
    let (n, m) = (one.len(), any.len());
    vec![
        row(
            "top-1, singles detectable in motion",
            share(one, Opened::top_right),
            n,
            ">= 0.97",
        ),
        row(
            "top-1, singles detectable in any channel",
            share(any, Opened::top_right),
            m,
            "-",
        ),
        row(
            "top-1, all singles",
            share(all, Opened::top_right),
            all.len(),
            "-",
        ),
        row(
            "exact set, singles detectable in motion",
            share(one, Opened::exact),
            n,
            ">= 0.95",
        ),
        row(
            "exact set, singles detectable in any channel",
            share(any, Opened::exact),
            m,
            "-",
        ),
        row(
            "stage, singles detectable in any channel",
            share(any, Opened::stage_right),
            m,
            ">= 0.99",
        ),
        row(
            "joint, singles detectable in any channel",
            share(any, Opened::joint_right),
            m,
            ">= 0.99",
        ),
    ]
}

/// Two or three causes, each of them detectable in some channel.
fn several(group: Group<'_>) -> Vec<Row> {
    let count = |f: &dyn Fn(&Opened) -> usize| group.iter().map(|o| f(o)).sum::<usize>();
    let ratio = |a: usize, b: usize| (b > 0).then(|| a as f64 / b as f64);
    let hits = count(&Opened::hits);
    let n = group.len();
    let precision = ratio(hits, count(&|o| o.said.len()));
    let recall = ratio(hits, count(&|o| o.truth.len()));
    vec![
        row("precision, two or three causes", precision, n, ">= 0.97"),
        row("recall, two or three causes", recall, n, ">= 0.95"),
        row(
            "exact, two or three causes",
            share(group, Opened::exact),
            n,
            ">= 0.90",
        ),
    ]
}

/// None and unknown.
fn words(all: &[Opened]) -> Vec<Row> {
    let pick =
        |f: &dyn Fn(&Opened) -> bool| -> Vec<&Opened> { all.iter().filter(|o| f(o)).collect() };
    let nulls = pick(&|o| o.kind() == "null");
    let outside = pick(&|o| o.kind() == "outside" && o.floors("floors_any"));
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
