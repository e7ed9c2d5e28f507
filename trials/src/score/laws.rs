//! How far sizes are off where a law is not quite that of the diagnosis, as a share of the size.

use std::collections::BTreeMap;

use files::effects::Effect;

use crate::label::Cause;

/// Fewest numbers of a stage that say something.
const FEWEST: usize = 5;
/// Shares that are tried, and the largest.
const STEP: f64 = 0.005;
const MOST: f64 = 1.0;

/// A number of a rightly named cause, in the unit that its law is linear in.
#[derive(Clone, Debug, PartialEq)]
pub struct Size {
    /// Stage of the cause.
    pub stage: String,
    /// What was planted, less the value that means nothing.
    pub planted: f64,
    /// Ends of the 95 % interval of what was found, less the same.
    pub found: [f64; 2],
}

impl Size {
    pub(super) fn new(cause: &Cause, key: &str, planted: f64, [a, b]: [f64; 2]) -> Self {
        let effect = Effect::from_name(&cause.effect);
        let parameter = effect.and_then(|e| e.parameters().iter().find(|p| p.key == key));
        // What limits nothing is infinite: a limit is off by a share of itself.
        let neutral = parameter.map_or(0.0, |p| p.neutral);
        let neutral = if neutral.is_finite() { neutral } else { 0.0 };
        // Laws are linear in what gives, not in its stiffness.
        let stiff = key.starts_with("stiffness");
        let of = |x: f64| if stiff { 1.0 / x } else { x - neutral };
        let found = if stiff {
            [of(b), of(a)]
        } else {
            [of(a), of(b)]
        };
        Self {
            stage: cause.stage.clone(),
            planted: of(planted),
            found,
        }
    }

    /// Whether the interval holds what was planted.
    #[must_use]
    pub fn holds(&self) -> bool {
        (self.found[0]..=self.found[1]).contains(&self.planted)
    }

    /// Logarithm of the likelihood of a law that is off by the share `law`.
    fn likelihood(&self, law: f64) -> f64 {
        let [a, b] = self.found;
        let (size, sd) = (0.5 * (a + b), (b - a) / 3.92);
        let variance = (sd * sd + law * law * size * size).max(f64::MIN_POSITIVE);
        -0.5 * (libm::log(variance) + (self.planted - size).powi(2) / variance)
    }
}

/// The share of most likelihood, by stage; none of a stage with few numbers.
#[must_use]
pub fn laws(all: &[Size]) -> BTreeMap<String, f64> {
    let mut stages: BTreeMap<&str, Vec<&Size>> = BTreeMap::new();
    for s in all {
        stages.entry(&s.stage).or_default().push(s);
    }
    let tried = || (0..=(MOST / STEP) as usize).map(|i| i as f64 * STEP);
    let one = |own: &[&Size]| {
        let likelihood = |law: &f64| own.iter().map(|s| s.likelihood(*law)).sum::<f64>();
        tried().max_by(|a, b| likelihood(a).total_cmp(&likelihood(b)))
    };
    stages
        .into_iter()
        .filter(|(_, own)| own.len() >= FEWEST)
        .filter_map(|(stage, own)| Some((stage.to_owned(), one(&own)?)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_is_off_by_a_share_of_itself() {
        let text = r#"{"effect": "velocity_limit", "stage": "driver", "scope": "joint", "joints": [0], "values": {}}"#;
        let cause: Cause = serde_json::from_str(text).expect("a label");
        let size = Size::new(&cause, "limit_rad_s", 1.2, [0.9, 1.1]);
        assert_eq!((size.planted, size.found), (1.2, [0.9, 1.1]));
    }

    /// Sizes of 2 that are found with a share of 0.1 more or less, and known to 0.01.
    #[test]
    fn a_law_that_is_off_by_a_tenth_is_found() {
        let one = |off: f64| Size {
            stage: "body".into(),
            planted: 2.0,
            found: [2.0 + off - 0.0196, 2.0 + off + 0.0196],
        };
        let offs = [-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3];
        let all: Vec<Size> = offs.map(one).to_vec();
        assert!(!all[0].holds() && all[3].holds());
        let found = laws(&all)["body"];
        // The root of the mean square is 0.2.
        assert!((found - 0.1).abs() < 0.01, "{found}");
        assert!(laws(&all[..4]).is_empty());
    }
}
