//! The figures of a suite, each with its count and interval.

use serde_json::Value;

use super::Case;

/// One line of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// What is counted.
    pub name: String,
    /// Right ones and all, where it is a share.
    pub count: Option<(usize, usize)>,
    /// The figure.
    pub value: f64,
    /// Wilson's 95 % interval, where it is a share.
    pub interval: Option<[f64; 2]>,
    /// What was aimed at.
    pub target: &'static str,
}

/// Wilson's interval of a share at 95 %.
pub(super) fn wilson(right: usize, all: usize) -> [f64; 2] {
    if all == 0 {
        return [0.0, 1.0];
    }
    let (n, z) = (all as f64, 1.959_964);
    let p = right as f64 / n;
    let centre = p + z * z / (2.0 * n);
    let half = z * libm::sqrt(p * (1.0 - p) / n + z * z / (4.0 * n * n));
    let scale = 1.0 + z * z / n;
    // Rounding alone takes an end beyond 0 or 1.
    [
        ((centre - half) / scale).max(0.0),
        ((centre + half) / scale).min(1.0),
    ]
}

impl Figure {
    /// Head of a table.
    pub const HEAD: &str = "| figure | value | count | 95 % | target |\n|---|---|---|---|---|\n";

    /// A share.
    #[must_use]
    pub fn share(name: &str, right: usize, all: usize, target: &'static str) -> Self {
        Self {
            name: name.to_owned(),
            count: Some((right, all)),
            value: right as f64 / all as f64,
            interval: Some(wilson(right, all)),
            target,
        }
    }

    fn number(name: &str, value: f64, target: &'static str) -> Self {
        Self {
            name: name.to_owned(),
            count: None,
            value,
            interval: None,
            target,
        }
    }

    /// The line of a table.
    #[must_use]
    pub fn line(&self) -> String {
        let or = |x: Option<String>| x.unwrap_or_default();
        format!(
            "| {} | {:.3} | {} | {} | {} |\n",
            self.name,
            self.value,
            or(self.count.map(|(k, n)| format!("{k} of {n}"))),
            or(self.interval.map(|[a, b]| format!("{a:.2} to {b:.2}"))),
            self.target
        )
    }
}

fn of<'a>(cases: &[&'a Case], test: impl Fn(&Case) -> bool) -> Vec<&'a Case> {
    cases.iter().copied().filter(|c| test(c)).collect()
}

fn share(
    name: &str,
    group: &[&Case],
    test: impl Fn(&Case) -> bool,
    target: &'static str,
) -> Figure {
    let right = group.iter().filter(|c| test(c)).count();
    Figure::share(name, right, group.len(), target)
}

/// Targets of a figure: own emulator, other engines.
fn target(own: bool, ours: &'static str, theirs: &'static str) -> &'static str {
    if own { ours } else { theirs }
}

/// The figures of cases of one side: `own` emulator or other engines. `least`: chi-square beyond nominal numbers of
/// what can be named.
#[must_use]
pub fn table(cases: &[&Case], own: bool, least: f64) -> Vec<Figure> {
    let clear = |c: &Case| c.label.identifiable(least);
    let kind = |kind: &'static str| of(cases, |c| c.kind() == kind);
    let singles = of(&kind("single"), clear);
    let several = of(&kind("several"), clear);
    let mut out = one_cause(&kind("single"), &singles, own);
    out.extend(more_causes(&several, own));
    out.extend(words(cases, own, clear));
    let probabilities: Vec<(f64, bool)> = cases
        .iter()
        .filter(|c| c.kind() != "outside")
        .flat_map(|c| c.stated())
        .collect();
    let error = calibration(&probabilities);
    out.push(Figure::number("calibration error", error, "<= 0.05"));
    let covered: Vec<bool> = cases
        .iter()
        .flat_map(|c| c.sized())
        .map(|s| s.holds())
        .collect();
    out.push(Figure::share(
        "truth inside the 95 % interval",
        covered.iter().filter(|c| **c).count(),
        covered.len(),
        target(own, "0.93 to 0.97", "0.90 to 0.98"),
    ));
    let right = of(&singles, |c| c.first(true));
    let shrink = right.iter().filter_map(|c| shrink(&c.verdict));
    out.push(Figure::number(
        "shrink of the gap, singles named first, median",
        median(shrink.collect()),
        "",
    ));
    let wall = cases.iter();
    let wall = wall.filter_map(|c| c.verdict["provenance"]["wall_time_s"].as_f64());
    let name = "wall time of a diagnosis, median, s";
    out.push(Figure::number(name, median(wall.collect()), ""));
    out
}

fn one_cause(all: &[&Case], singles: &[&Case], own: bool) -> Vec<Figure> {
    let joints = |c: &Case| c.label.causes.first().map_or(0, |t| t.joints.len());
    let part = |name: &str, test: &dyn Fn(usize) -> bool| {
        let group = of(singles, |c| test(joints(c)));
        share(name, &group, |c| c.first(true), "")
    };
    vec![
        share(
            "first cause right with scope, identifiable singles",
            singles,
            |c| c.first(true),
            target(own, ">= 0.97", ">= 0.92"),
        ),
        part("- of one joint", &|n| n == 1),
        part("- of several joints", &|n| n > 1),
        part("- of the robot", &|n| n == 0),
        share(
            "effect of the first cause right, any joints",
            singles,
            |c| c.first(false),
            "",
        ),
        share(
            "exact set, identifiable singles",
            singles,
            Case::exact,
            target(own, ">= 0.95", ">= 0.88"),
        ),
        share(
            "stage and joints right, identifiable singles",
            singles,
            Case::place,
            target(own, ">= 0.99", ">= 0.95"),
        ),
        share(
            "first cause right with scope, all singles",
            all,
            |c| c.first(true),
            "",
        ),
    ]
}

fn more_causes(several: &[&Case], own: bool) -> Vec<Figure> {
    let sum = |f: &dyn Fn(&Case) -> usize| several.iter().map(|c| f(c)).sum::<usize>();
    let pairs = of(several, |c| c.label.causes.len() == 2);
    let triples = of(several, |c| c.label.causes.len() > 2);
    let planted = sum(&|c| c.label.causes.len());
    vec![
        share(
            "exact set, identifiable pairs and triples",
            several,
            Case::exact,
            target(own, ">= 0.90", ">= 0.80"),
        ),
        share("- pairs", &pairs, Case::exact, ""),
        share("- triples", &triples, Case::exact, ""),
        Figure::share(
            "causes of these that were said",
            sum(&Case::hits),
            planted,
            "",
        ),
        Figure::share(
            "causes said of these that were planted",
            sum(&Case::right),
            sum(&|c| c.said.len()),
            "",
        ),
    ]
}

fn words(cases: &[&Case], own: bool, clear: impl Fn(&Case) -> bool) -> Vec<Figure> {
    let nulls = of(cases, |c| c.kind() == "null");
    let caused = of(cases, |c| c.kind() == "single" || c.kind() == "several");
    let outside = of(cases, |c| c.kind() == "outside" && clear(c));
    let visible = of(&caused, &clear);
    let not_null = of(cases, |c| c.kind() != "null");
    vec![
        share(
            "nulls accused (a cause said)",
            &nulls,
            |c| !c.said.is_empty(),
            "<= 0.01",
        ),
        share("nulls not `none`", &nulls, |c| c.word() != "none", ""),
        share(
            "`unknown` found, identifiable causes outside the library",
            &outside,
            Case::unknown,
            target(own, ">= 0.90", ">= 0.85"),
        ),
        share(
            "false `unknown` among those with a cause",
            &caused,
            |c| c.word() == "unknown",
            "<= 0.05",
        ),
        share(
            "`none` of identifiable causes",
            &visible,
            |c| c.word() == "none",
            "",
        ),
        share(
            "`explained` or `parametric` of a wrong set",
            &not_null,
            |c| c.claims() && !c.exact() && (clear(c) || c.right() < c.said.len()),
            "0",
        ),
    ]
}

/// The figures of singles whose planted effect was withheld.
#[must_use]
pub fn left_out(cases: &[&Case], own: bool, least: f64) -> Vec<Figure> {
    let singles = of(cases, |c| {
        c.kind() == "single" && c.label.identifiable(least)
    });
    let right = |c: &Case| c.word() == "unknown" && c.place();
    // A true equivalent: another effect of the same stage and joints that leaves nothing.
    let equivalent = |c: &Case| !c.said.is_empty() && c.place() && c.claims();
    vec![
        share(
            "`unknown` in the right place, or an equivalent there",
            &singles,
            |c| right(c) || equivalent(c),
            target(own, ">= 0.85", ">= 0.80"),
        ),
        share("- `unknown` in the right place", &singles, right, ""),
        share("- `unknown`", &singles, |c| c.word() == "unknown", ""),
        share("- `none`", &singles, |c| c.word() == "none", ""),
    ]
}

/// Cases that failed, in words.
#[must_use]
pub fn failures(cases: &[&Case], least: f64) -> Vec<String> {
    let wrong = |c: &Case| match c.kind() {
        "null" => c.word() != "none" || !c.said.is_empty(),
        "outside" => c.label.identifiable(least) && !c.unknown(),
        _ => c.label.identifiable(least) && !c.exact(),
    };
    of(cases, wrong).iter().map(|c| c.told()).collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Expected calibration error over ten bins of the stated probability.
fn calibration(stated: &[(f64, bool)]) -> f64 {
    let mut bins = [0.0; 10];
    for (p, right) in stated {
        bins[((p * 10.0) as usize).min(9)] += p - f64::from(u8::from(*right));
    }
    bins.iter().map(|b: &f64| b.abs()).sum::<f64>() / stated.len() as f64
}

/// Share of the gap that falls on runs held out: of the metric of `rb.gap/1`, of the signal that falls most of `rb.gap/2`.
fn shrink(verdict: &Value) -> Option<f64> {
    let signals = verdict["held_out"]["errors"].as_object();
    let fall = |e: &Value| Some(1.0 - e["after"].as_f64()? / e["before"].as_f64()?);
    match signals {
        Some(signals) => signals.values().filter_map(fall).max_by(f64::total_cmp),
        None => verdict["gap"]["shrink"].as_f64(),
    }
}

#[cfg(test)]
mod tests {
    use super::wilson;

    #[test]
    fn wilson_is_that_of_the_books() {
        // Newcombe 1998, method 3: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
        for (k, n, low, high) in [
            (81, 263, 0.2553, 0.3662),
            (15, 148, 0.0624, 0.1605),
            (0, 20, 0.0, 0.1611),
            (1, 29, 0.0061, 0.1718),
        ] {
            let [a, b] = wilson(k, n);
            assert!((a - low).abs() < 1e-4 && (b - high).abs() < 1e-4, "{a} {b}");
        }
    }
}
