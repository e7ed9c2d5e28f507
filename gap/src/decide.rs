//! Decisions: every threshold of the search of causes, read from robots without a cause.

mod tails;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::evidence::cause::Cause;
use crate::evidence::ensemble::Spreads;
use crate::vocabulary::{Effect, Stage};
pub use tails::Tail;
use tails::{BY, beyond_tails, left, lefts, most, remainders, tail, tails};

/// Family-wise share of robots without a cause that may be accused of one.
pub const LEVEL: f64 = 0.01;
/// Share of joints without a cause that leave as much, from which a remainder is ordinary: to be no outlier at [`LEVEL`]
/// does not show that all is explained. By hand: one in ten, as a test of equivalence rejects more.
pub const ORDINARY: f64 = 0.1;
/// Share of the squares beyond the noise that stays, above which what was named is not what is there: of joints and of robots.
pub const MOST: f64 = 0.5;
/// Standard deviations of its prior from which a size is not plausible: by hand; it decides what a report lists as unseen.
pub const PLAUSIBLE: f64 = 2.0;
/// Likelihood ratios within which two causes are one class: a factor of 20 (Kass and Raftery 1995: strong).
pub const CLASS: f64 = 3.0;

/// What a calibration tells apart: an effect, or a shape of none, and the kinds of blocks that show it.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Shown {
    effect: Option<Effect>,
    by: String,
}

impl Shown {
    /// `effect` in blocks of the kinds `by`.
    #[must_use]
    pub fn new(effect: Option<Effect>, by: &str) -> Self {
        Self {
            effect,
            by: by.into(),
        }
    }

    fn name(&self) -> &'static str {
        self.effect.map_or("open", Effect::name)
    }

    /// Name by which it stands in a calibration.
    fn key(&self) -> String {
        format!("{}{BY}{}", self.name(), self.by)
    }
}

impl std::fmt::Display for Shown {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.key())
    }
}

impl From<&Cause> for Shown {
    fn from(cause: &Cause) -> Self {
        Self::new(cause.effect, &cause.shown_by)
    }
}

/// What searches of robots without a cause found: the null distribution of the strongest evidence.
///
/// The evidence of each effect counts beyond the tail that such robots have of it. An effect that is hard to tell
/// from their differences asks more of itself, not of all others. The largest of standardised statistics has the level
/// that is stated (Westfall and Young 1993).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Always `rb.calibration/5`.
    pub schema: String,
    /// How the file was made.
    pub command: String,
    /// Where the robots come from.
    pub source: String,
    /// Largest evidence of each of them over all effects, beyond their tails, ascending.
    pub strongest: Vec<f64>,
    /// Tails by effect, and by what shows it where enough robots have that; without any the evidence counts as it is.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub tails: BTreeMap<String, Tail>,
    /// What the best set leaves of each of them, ascending; of robots, the largest over all blocks beyond `lefts`.
    /// Empty where nothing was measured of it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remainders: Vec<f64>,
    /// Tails of what is left, dB, by blocks that leave alike.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub lefts: BTreeMap<String, Tail>,
    /// What they differ by from the nominal model.
    #[serde(default)]
    pub spreads: Spreads,
    /// The same of joints by what their controllers put out, where enough of them put out that.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub drives: BTreeMap<String, Spreads>,
    /// How far the size of a cause is off because its law is not quite ours, one standard deviation as a share of the
    /// size, by stage: of robots whose causes are known.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub laws: BTreeMap<String, f64>,
}

/// Why a calibration cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationError {
    /// The text is no calibration.
    #[error("no calibration: {0}")]
    Text(#[from] serde_json::Error),
    /// Another schema.
    #[error("schema `{0}`, not `{SCHEMA}`; make the file again with `rb-host gap calibrate`")]
    Schema(String),
    /// Values that are no numbers, or too few of them.
    #[error("{0} finite values; at least {LEAST} robots without a cause are needed")]
    Few(usize),
}

const SCHEMA: &str = "rb.calibration/5";
/// Fewest robots whose strongest evidence says anything: with 19 a cause at least has p = 0.05.
pub(crate) const LEAST: usize = 19;

impl Calibration {
    /// How far a size of an effect of `stage` is off because of its law, as a share of the size.
    #[must_use]
    pub fn law(&self, stage: Stage) -> f64 {
        self.laws.get(stage.name()).copied().unwrap_or(0.0)
    }

    /// From the strongest evidence of robots without a cause.
    ///
    /// # Errors
    /// Too few finite values.
    pub fn new(
        mut strongest: Vec<f64>,
        command: &str,
        source: &str,
    ) -> Result<Self, CalibrationError> {
        strongest.retain(|x| x.is_finite());
        if strongest.len() < LEAST {
            return Err(CalibrationError::Few(strongest.len()));
        }
        strongest.sort_by(f64::total_cmp);
        Ok(Self {
            schema: SCHEMA.into(),
            command: command.into(),
            source: source.into(),
            strongest,
            tails: BTreeMap::new(),
            remainders: Vec::new(),
            lefts: BTreeMap::new(),
            spreads: Spreads::default(),
            drives: BTreeMap::new(),
            laws: BTreeMap::new(),
        })
    }

    /// From the largest evidence of every effect of robots without a cause. Each is taken beyond the tails of the
    /// others, as that of a robot to come will be: in its own tail no value stands out.
    ///
    /// # Errors
    /// Too few robots.
    pub fn by_effect(
        robots: &[BTreeMap<Shown, f64>],
        command: &str,
        source: &str,
    ) -> Result<Self, CalibrationError> {
        let own = Self::new(beyond_tails(robots), command, source)?;
        let tails = tails(&robots.iter().collect::<Vec<_>>());
        Ok(Self { tails, ..own })
    }

    /// What joints differ by whose controllers put out the same.
    #[must_use]
    pub fn spreads_of(&self, drive: &str) -> &Spreads {
        self.drives.get(drive).unwrap_or(&self.spreads)
    }

    /// The same with what the best sets leave.
    #[must_use]
    pub fn with_remainders(mut self, mut remainders: Vec<f64>) -> Self {
        remainders.retain(|x| x.is_finite());
        remainders.sort_by(f64::total_cmp);
        self.remainders = remainders;
        self
    }

    /// The same with what no column explains in the blocks of robots: kind of the block and dB.
    #[must_use]
    pub fn with_lefts(self, robots: &[Vec<(String, f64)>]) -> Self {
        let remainders = remainders(robots);
        let lefts = lefts(&robots.iter().collect::<Vec<_>>());
        let own = Self { lefts, ..self };
        own.with_remainders(remainders)
    }

    /// What is left in a block, dB, beyond the tail of its kind, which says what puts it out after "by" if that matters;
    /// `None` for a kind that too few robots of the calibration had.
    #[must_use]
    pub fn standard_left(&self, kind: &str, left_db: f64) -> Option<f64> {
        Some(left(&self.lefts, kind)?.standard(left_db))
    }

    /// The most that is left of anything, beyond the tail of its kind; 0 where nothing reaches a tail.
    #[must_use]
    pub fn most_left(&self, left_db: &[(String, f64)]) -> f64 {
        most(&self.lefts, left_db)
    }

    /// Reads a file that [`Calibration::to_json`] wrote.
    ///
    /// # Errors
    /// Text of another kind.
    pub fn parse(text: &str) -> Result<Self, CalibrationError> {
        let read: Self = serde_json::from_str(text)?;
        if read.schema != SCHEMA {
            return Err(CalibrationError::Schema(read.schema));
        }
        let own = Self::new(read.strongest, &read.command, &read.source)?;
        let own = Self {
            spreads: read.spreads,
            drives: read.drives,
            tails: read.tails,
            lefts: read.lefts,
            laws: read.laws,
            ..own
        };
        Ok(own.with_remainders(read.remainders))
    }

    /// The file's text.
    ///
    /// # Errors
    /// None that this type can have.
    pub fn to_json(&self) -> Result<String, CalibrationError> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// That of emulated robots and of robots played in MuJoCo and ODE.
    #[must_use]
    pub fn shipped() -> Self {
        Self::of(include_str!("../calibration/robot.json"))
    }

    /// That of emulated joints and of joints played in MuJoCo.
    #[must_use]
    pub fn shipped_joint() -> Self {
        Self::of(include_str!("../calibration/joint.json"))
    }

    fn of(text: &str) -> Self {
        // A test reads both.
        Self::parse(text).unwrap_or_else(|_| Self {
            schema: SCHEMA.into(),
            command: String::new(),
            source: String::new(),
            strongest: vec![f64::MAX; LEAST],
            tails: BTreeMap::new(),
            remainders: Vec::new(),
            lefts: BTreeMap::new(),
            spreads: Spreads::default(),
            drives: BTreeMap::new(),
            laws: BTreeMap::new(),
        })
    }

    /// Conformal p-value of what a set leaves: the chance that one without a cause leaves as much; 1 where nothing
    /// was measured of that.
    #[must_use]
    pub fn remainder_p(&self, remainder: f64) -> f64 {
        let below = self.remainders.partition_point(|x| *x < remainder);
        let n = self.remainders.len();
        (n - below + 1) as f64 / (n + 1) as f64
    }

    /// Conformal p-value of an effect's evidence: the chance that a robot without a cause shows as much of any effect.
    #[must_use]
    pub fn p_value(&self, shown: &Shown, evidence: f64) -> f64 {
        let standard = tail(&self.tails, shown).standard(evidence);
        let below = self.strongest.partition_point(|x| *x < standard);
        let n = self.strongest.len();
        (n - below + 1) as f64 / (n + 1) as f64
    }

    /// Evidence that a cause of an effect must add: what robots without a cause do not show, and what makes it likelier
    /// than its absence by one over [`LEVEL`].
    #[must_use]
    pub fn ask(&self, shown: &Shown) -> f64 {
        let evidence = tail(&self.tails, shown).evidence(self.least());
        evidence.max(-libm::log(LEVEL))
    }

    /// Evidence that a cause must add, beyond its tail: the least one whose p-value is at most [`LEVEL`]; beyond all robots without
    /// a cause where these are too few to tell.
    #[must_use]
    pub fn least(&self) -> f64 {
        let n = self.strongest.len();
        let may = (LEVEL * (n + 1) as f64).floor() as usize;
        let at = n.saturating_sub(may.max(1));
        // As many as may be counted, less one, lie above it.
        self.strongest[at] + STEP
    }
}

/// What counts as more evidence.
const STEP: f64 = 1e-6;

#[cfg(test)]
mod tests {
    use super::*;

    fn of(n: usize) -> Calibration {
        let strongest = (0..n).map(|i| i as f64).collect();
        Calibration::new(strongest, "test", "numbers").expect("enough")
    }

    #[test]
    fn few_robots_ask_for_more_evidence_than_any_of_them() {
        let c = of(49);
        assert!(c.least() > 48.0);
        assert!((c.p_value(&Shown::default(), c.least()) - 0.02).abs() < 1e-12);
    }

    #[test]
    fn many_robots_allow_the_share_that_the_level_says() {
        let c = of(999);
        assert!(c.p_value(&Shown::default(), c.least()) <= LEVEL);
        assert!(c.p_value(&Shown::default(), c.least() - 1.0) > LEVEL);
    }

    #[test]
    fn an_effect_that_healthy_robots_imitate_asks_more_of_itself_alone() {
        let mut rng = crate::math::Rng::new(2);
        let late = Shown::new(Some(Effect::Latency), "driver");
        let [heavy, guessed] =
            ["drivetrain", "blind_drivetrain"].map(|by| Shown::new(Some(Effect::Mass), by));
        let mut robot = |i: usize| {
            let slow = 9.0 * rng.normal().abs() - 3.0;
            let weight = rng.normal() - 3.0;
            // Every other robot has no pose of its base, and imitates a weight.
            let own = match i % 2 {
                0 => (heavy.clone(), weight),
                _ => (guessed.clone(), 5.0 * weight.abs()),
            };
            BTreeMap::from([(late.clone(), slow), own])
        };
        let healthy: Vec<_> = (0..800).map(&mut robot).collect();
        let c = Calibration::by_effect(&healthy[..400], "test", "numbers").expect("enough");
        assert!(c.ask(&late) > 15.0 && c.ask(&guessed) > 15.0, "{c:?}");
        assert!(c.ask(&heavy) < 5.0, "{c:?}");
        // What no robot had to show it asks what the hardest one does.
        assert!(c.ask(&Shown::default()) >= c.ask(&late));
        for shown in [&late, &heavy, &guessed] {
            assert!(c.p_value(shown, c.ask(shown)) <= LEVEL);
        }
        let accused = healthy[400..]
            .iter()
            .filter(|r| r.iter().any(|(s, x)| *x > c.ask(s)))
            .count();
        assert!(accused <= 16, "{accused} of 400 others");
    }

    /// Of twenty effects any may show much, each once in five hundred robots: of a hundred robots most effects show it in
    /// none. Beyond tails that a robot is itself in, none would stand out as far as one to come does.
    #[test]
    fn rare_evidence_of_many_effects_accuses_as_few_as_the_level_says() {
        let mut rng = crate::math::Rng::new(3);
        let mut robot = |_: usize| -> BTreeMap<Shown, f64> {
            let effects = Effect::ALL.iter().take(20);
            effects
                .map(|e| {
                    let rare = rng.uniform() < 1.0 / 500.0;
                    let evidence = rng.normal() + if rare { 50.0 } else { 0.0 };
                    (Shown::new(Some(*e), "joint"), evidence)
                })
                .collect()
        };
        let healthy: Vec<_> = (0..500).map(&mut robot).collect();
        let c = Calibration::by_effect(&healthy[..100], "test", "numbers").expect("enough");
        let accused = healthy[100..]
            .iter()
            .filter(|r| r.iter().any(|(s, x)| *x > c.ask(s)))
            .count();
        assert!(accused <= 10, "{accused} of 400 others");
    }

    #[test]
    fn the_shipped_files_are_calibrations() {
        for shipped in [Calibration::shipped(), Calibration::shipped_joint()] {
            assert!(shipped.strongest.len() >= LEAST, "{shipped:?}");
            assert!(shipped.least() < 1e3);
            let again = Calibration::parse(&shipped.to_json().expect("text")).expect("read");
            assert_eq!(again, shipped);
        }
    }

    #[test]
    fn a_file_holds_all_that_was_calibrated() {
        let mut whole = of(49);
        let one = BTreeMap::from([(Shown::new(Some(Effect::Mass), "body"), 1.0)]);
        whole = Calibration {
            tails: Calibration::by_effect(&vec![one; 49], "test", "numbers")
                .expect("enough")
                .tails,
            ..whole
        };
        let left = vec![("body".to_owned(), 1.0)];
        whole = whole.with_lefts(&vec![left; 49]);
        whole
            .spreads
            .columns
            .insert("driver.latency..0".into(), 0.5);
        whole.laws.insert("driver".into(), 0.1);
        let again = Calibration::parse(&whole.to_json().expect("text")).expect("read");
        assert_eq!(again, whole);
        assert!((again.law(Stage::Driver) - 0.1).abs() < f64::EPSILON);
    }

    #[test]
    fn other_texts_are_refused() {
        assert!(matches!(
            Calibration::parse("[]"),
            Err(CalibrationError::Text(_))
        ));
        let other = r#"{"schema":"x","command":"","source":"","strongest":[]}"#;
        assert!(matches!(
            Calibration::parse(other),
            Err(CalibrationError::Schema(_))
        ));
        // Evidence of that version was computed under other model errors.
        let old = r#"{"schema":"rb.calibration/1","command":"","source":"","strongest":[1.0]}"#;
        assert!(matches!(
            Calibration::parse(old),
            Err(CalibrationError::Schema(_))
        ));
        let few = r#"{"schema":"rb.calibration/5","command":"","source":"","strongest":[1.0]}"#;
        assert!(matches!(
            Calibration::parse(few),
            Err(CalibrationError::Few(1))
        ));
    }
}
