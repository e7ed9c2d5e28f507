//! Verdicts against labels: what was said of a case, whether it is right, and the table of a suite.

mod laws;
mod read;
mod table;

use std::collections::BTreeSet;

use serde_json::Value;

use crate::label::{Cause, Label};

pub use laws::{Size, laws};
pub use read::Said;
pub use table::{Figure, failures, left_out, table};

/// Largest class that counts as an answer.
const CLASS: usize = 3;

/// One opened case.
#[derive(Clone, Debug)]
pub struct Case {
    /// What was planted.
    pub label: Label,
    /// What the diagnosis wrote.
    pub verdict: Value,
    /// Causes said, the first first.
    pub said: Vec<Said>,
}

/// Effects that are one by physics: a joint's damping and the gain that damps it.
fn same(effect: &str) -> &str {
    match effect {
        "damping_gain" => "viscous_friction",
        other => other,
    }
}

impl Case {
    /// A label and its verdict.
    #[must_use]
    pub fn new(label: Label, verdict: Value) -> Self {
        let said = read::said(&verdict);
        Self {
            label,
            verdict,
            said,
        }
    }

    /// The verdict's word.
    #[must_use]
    pub fn word(&self) -> &str {
        self.verdict["verdict"].as_str().unwrap_or("")
    }

    /// Kind of the label.
    #[must_use]
    pub fn kind(&self) -> &str {
        &self.label.kind
    }

    fn named(truth: &Cause, effect: &str) -> bool {
        let mut also = truth.also.iter();
        same(&truth.effect) == same(effect) || also.any(|a| a == effect)
    }

    /// Whether a place that was said is that of the cause. A weight has a body, not a joint; the scale of a column is
    /// said of the robot or of its joints.
    fn placed(truth: &Cause, joints: &BTreeSet<usize>) -> bool {
        let anywhere = ["column_scale", "body_mass", "payload"];
        anywhere.contains(&truth.effect.as_str()) || truth.joints == *joints
    }

    /// Whether something said is a cause: its name and, where it counts, its joints.
    #[must_use]
    pub fn matches(truth: &Cause, said: &Said, place: bool) -> bool {
        let right = |(effect, joints): &(String, BTreeSet<usize>)| {
            Self::named(truth, effect) && (!place || Self::placed(truth, joints))
        };
        said.options.len() <= CLASS && said.options.iter().any(right)
    }

    /// Whether the first cause said was planted.
    #[must_use]
    pub fn first(&self, place: bool) -> bool {
        let first = self.said.first();
        let planted = |s: &Said| self.label.causes.iter().any(|t| Self::matches(t, s, place));
        first.is_some_and(planted)
    }

    /// How many planted causes were said.
    #[must_use]
    pub fn hits(&self) -> usize {
        let said = |t: &&Cause| self.said.iter().any(|s| Self::matches(t, s, true));
        self.label.causes.iter().filter(said).count()
    }

    /// How many of the causes said were planted.
    #[must_use]
    pub fn right(&self) -> usize {
        let planted = |s: &&Said| self.label.causes.iter().any(|t| Self::matches(t, s, true));
        self.said.iter().filter(planted).count()
    }

    /// Whether all was said and nothing else.
    #[must_use]
    pub fn exact(&self) -> bool {
        self.hits() == self.label.causes.len() && self.right() == self.said.len()
    }

    /// The first place of the gap.
    fn seen_at(&self) -> Option<(String, BTreeSet<usize>)> {
        let rows = self.verdict["where"].as_array()?;
        let first = rows.iter().find(|w| w["stage"] != "unexplained")?;
        Some((first["stage"].as_str()?.to_owned(), read::joints(first)))
    }

    /// Whether stage and joints are right: of the first cause said, else of the first place of the gap, which may be
    /// one of the cause's joints.
    #[must_use]
    pub fn place(&self) -> bool {
        let said = self.said.first().filter(|_| self.word() != "unknown");
        let mut causes = self.label.causes.iter();
        match said {
            Some(s) => causes.any(|t| t.stage == s.stage && Self::placed(t, &s.options[0].1)),
            None => self.seen_at().is_some_and(|(stage, joints)| {
                let within = |t: &Cause| !joints.is_empty() && joints.is_subset(&t.joints);
                causes.any(|t| t.stage == stage && (within(t) || Self::placed(t, &joints)))
            }),
        }
    }

    /// Whether a cause outside the library was recognised as such, or named by its own name.
    #[must_use]
    pub fn unknown(&self) -> bool {
        self.word() == "unknown" || self.first(true)
    }

    /// Whether the word claims that all is explained.
    #[must_use]
    pub fn claims(&self) -> bool {
        ["explained", "parametric"].contains(&self.word())
    }

    /// Probability of each cause said, or of `none` on a robot without a cause, and whether that was right.
    #[must_use]
    pub fn stated(&self) -> Vec<(f64, bool)> {
        if self.kind() == "null" {
            let none = self.verdict["probabilities"]["none"].as_f64();
            return none.map(|p| (p, true)).into_iter().collect();
        }
        let one = |s: &Said| {
            let planted = |t: &Cause| Self::matches(t, s, true);
            Some((s.probability?, self.label.causes.iter().any(planted)))
        };
        self.said.iter().filter_map(one).collect()
    }

    /// Every number of a rightly named cause that has an interval.
    #[must_use]
    pub fn sized(&self) -> Vec<Size> {
        let mut out = Vec::new();
        for t in &self.label.causes {
            let own = |s: &&Said| {
                let (effect, joints) = &s.options[0];
                *effect == t.effect && *joints == t.joints
            };
            let Some(said) = self.said.iter().find(own) else {
                continue;
            };
            for (key, truth) in &t.values {
                let said = &said.values[key.as_str()];
                let one = |x: f64, said: &Value| Some(Size::new(t, key, x, read::interval(said)?));
                let of_joints = truth
                    .by_joint
                    .iter()
                    .filter_map(|(joint, x)| one(*x, &said["by_joint"][joint]));
                let before = out.len();
                out.extend(of_joints);
                // One number for all joints holds where they do not differ.
                if out.len() == before && t.spread == 0.0 {
                    out.extend(truth.value.as_f64().and_then(|x| one(x, said)));
                }
            }
        }
        out
    }

    /// The case in words.
    #[must_use]
    pub fn told(&self) -> String {
        let place = |joints: &BTreeSet<usize>| {
            let text: String = joints.iter().map(ToString::to_string).collect();
            if text.is_empty() {
                String::new()
            } else {
                format!("@{text}")
            }
        };
        let planted: Vec<String> = self
            .label
            .causes
            .iter()
            .map(|c| {
                let off = c
                    .sigmas
                    .map_or(String::new(), |s| format!(", {s:.1} tolerances"));
                let left = c.delta_chi2_refitted;
                format!("{}{} (chi2 {left:.0}{off})", c.effect, place(&c.joints))
            })
            .collect();
        let class = |s: &Said| {
            let names = s.options.iter().map(|(e, j)| format!("{e}{}", place(j)));
            names.collect::<Vec<_>>().join("|")
        };
        let said: Vec<String> = self.said.iter().map(class).collect();
        format!(
            "{} [{}]: planted {}; said {} [{}]",
            self.label.name,
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
