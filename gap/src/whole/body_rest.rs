//! What the body leaves when all that was found is in it: how much of it speaks, and where it arose.

use super::body::{FLEX, OFFSET, PLAY, RATIO, Tier, of_joint};
use super::body_answer::{Found, limits, steepness};
use super::body_library::coordinates;
use super::data::JOINTS;
use super::search::{Candidate, Coordinate, Evaluate, Fit, Limits, Search};
use crate::math;
use crate::vocabulary::{Effect, Stage};

/// What nothing that was found explains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rest {
    /// How far it stands above what robots without a cause leave, in thresholds; 0 where it does not.
    pub(super) evidence: f64,
    /// Stage and joint in which it arose.
    pub(super) place: (Stage, Option<usize>),
}

impl Rest {
    /// Nothing of note.
    pub(super) const NONE: Self = Self {
        evidence: 0.0,
        place: (Stage::Body, None),
    };
}

/// Tolerances by which half the windows end off at most on contacts that differ: 0.7 to 1.1 on robots without a cause that another engine
/// played, 0.3 to 0.6 on emulated ones; 1.5 beside a centre of mass that must not be named.
const OFF: f64 = 1.25;
/// Cost, at the tolerances of the inertial sensor and of contacts of any make, above which the simulator misses something of this body; and that of the
/// calmer half of the gaits, since gaits with many blows leave more whatever the body is. Robots without a cause of the body leave 0.8 to 1.4 and 0.5 to 0.9
/// where it is emulated with this project's equations (58), and where MuJoCo plays it 1.3 to 3.0 and 1.0 to 2.4 with a round cone of friction, soft contacts
/// among them (14). With a pyramid for a cone five of six leave 2.6 to 4.0 and 2.3 to 3.4: the friction is another one there.
const LEFT: f64 = 3.1;
const CALM: f64 = 2.5;
/// The same where a free connection of one joint takes most of it away: contacts of another make are in no joint.
const LEFT_BY_JOINT: f64 = 1.4;
const CALM_BY_JOINT: f64 = 1.1;
/// What robots without a cause leave, in the middle.
const USUAL: f64 = 1.0;
/// Share of what the nominal body leaves from which what was found takes away so much that the rest is how its law differs: of a connector's
/// play of 0.1 rad two honest simulators keep half, of a ground of half the friction as much.
const KNOWN: f64 = 1.0 / 3.0;
/// Share of what is left above that which a free connection between reading and link of one joint must take away to be where it arose.
const TAKEN: f64 = 0.5;
/// Offsets and ratios of a link from which a straight line is fitted.
const LINES: [[f64; 2]; 9] = [
    [0.0, 1.0],
    [0.04, 1.0],
    [-0.04, 1.0],
    [0.15, 1.0],
    [-0.15, 1.0],
    [0.4, 1.0],
    [-0.4, 1.0],
    [0.0, 0.93],
    [0.0, 1.07],
];
/// Half plays, rad, and twists per torque, rad/(N m), from which a gear's connection is fitted.
const GEARS: [[f64; 2]; 4] = [[0.02, 0.0], [0.06, 0.0], [0.0, 0.02], [0.0, 0.1]];

impl Found {
    /// Weighs what the body leaves. Starts that were read off a film are too rough to say so.
    pub(super) fn weigh_rest(&mut self, filmed: bool) {
        if filmed {
            return;
        }
        let last = self.answer.last().clone();
        // A friction that was found took part in the calibration too.
        let first = if last.members.is_empty() {
            &self.answer.steps[0].theta
        } else {
            &self.answer.nominal
        };
        let ends_m = math::median(&self.tier.ends_m(&last.theta));
        let ends = ends_m / self.tier.tolerance_m().max(1e-9) / OFF;
        let left = self.tier.sharp(&last.theta, |tier| {
            let residuals = tier.residuals(&last.theta);
            let cost = super::least::cost(&residuals);
            let before = tier.thinned(first, 1);
            if before - cost > KNOWN * (before - 1.0)
                || !speaks(&residuals, LEFT_BY_JOINT, CALM_BY_JOINT)
            {
                return (0.0, None);
            }
            let place = between(tier, &last, cost);
            match place {
                Some(_) => (cost / LEFT_BY_JOINT, place),
                None if speaks(&residuals, LEFT, CALM) => (cost / LEFT, None),
                None => (0.0, None),
            }
        });
        let (cost, place) = left.unwrap_or((0.0, None));
        let tilt = self.tilt();
        let evidence = ends.max(cost).max(tilt);
        let place = place
            .filter(|_| tilt <= 1.0)
            .or_else(|| self.beside())
            .unwrap_or(Rest::NONE.place);
        self.rest = Rest {
            evidence: if evidence > 1.0 { evidence } else { 0.0 },
            place,
        };
    }

    /// How far gravity is off the tracker's vertical on a ground that is said to be level, over what the sensor's own error makes of it.
    fn tilt(&self) -> f64 {
        let answer = &self.answer;
        let sloped = |m: &usize| answer.candidates[*m].effect == Effect::GroundSlope;
        let shown = self.tier.slope.unwrap_or([0.0; 2]);
        if answer.last().members.iter().any(sloped) {
            0.0
        } else {
            steepness(shown)
        }
    }

    /// Looks again where the remainder arose, with half the thresholds: that something is there is known. What is found stays where it leaves no remainder.
    pub(super) fn look_again(&mut self) {
        let (stage, joint) = self.rest.place;
        let nothing = self.answer.last().members.is_empty() && self.changes.is_none();
        if self.rest.evidence == 0.0 || joint.is_none() || !nothing {
            return;
        }
        let mut candidates = self.answer.candidates.clone();
        for c in &mut candidates {
            if (c.effect.stage(), c.joint) == (stage, joint) {
                c.starts.extend(starts(c));
            } else {
                c.starts.clear();
            }
        }
        let told = limits(&self.tier);
        let search = Search {
            model: &self.tier,
            coordinates: &coordinates(&self.tier.model),
            candidates: &candidates,
            limits: Limits {
                share: 0.5 * told.share,
                least: 0.5 * told.least,
                relative: 0.5 * told.relative,
                ..told
            },
        };
        let answer = search.answer(self.answer.last().clone(), self.answer.nominal.clone());
        let theta = &answer.last().theta;
        let left = self.tier.sharp(theta, |tier| {
            speaks(&tier.residuals(theta), LEFT_BY_JOINT, CALM_BY_JOINT)
        });
        if !answer.last().members.is_empty() && left == Some(false) {
            self.answer = answer;
            self.rest = Rest::NONE;
        }
    }

    /// Stage and joint of what was found first: it mends a part of the gap, and the rest of it is there.
    fn beside(&self) -> Option<(Stage, Option<usize>)> {
        let found = &self.answer.candidates[*self.answer.last().members.first()?];
        Some((found.effect.stage(), found.joint))
    }
}

/// The values of a free connection that a candidate of a joint starts from besides its own.
fn starts(c: &Candidate) -> Vec<Vec<f64>> {
    let of = |all: &[[f64; 2]], which: usize| all.iter().map(|x| vec![x[which]]).collect();
    match c.effect {
        Effect::JointOffset => of(&LINES, 0),
        Effect::JointScale => of(&LINES, 1),
        Effect::Backlash => of(&GEARS, 0),
        Effect::Compliance => of(&GEARS, 1),
        _ => Vec::new(),
    }
}

/// Whether more than `left` stays in all, and more than `quiet` of the calmer gaits too.
fn speaks(residuals: &[Vec<f64>], left: f64, quiet: f64) -> bool {
    super::least::cost(residuals) > left && calm(super::least::group_costs(residuals)) > quiet
}

/// Mean of the smaller half of the costs of gaits.
fn calm(mut costs: Vec<f64>) -> f64 {
    costs.sort_by(f64::total_cmp);
    costs.truncate(costs.len().div_ceil(2));
    math::mean(&costs)
}

/// Stage and joint of the connection between reading and link that, once it is free, takes most of what `last` leaves away, which costs `left`: a straight
/// line is the conventions', play and twist under load are the transmission's.
fn between(tier: &Tier, last: &Fit, left: f64) -> Option<(Stage, Option<usize>)> {
    let coordinates: Vec<Coordinate> = coordinates(&tier.model);
    let free = |effect, k: usize, what: [usize; 2], starts: &[[f64; 2]]| Candidate {
        effect,
        joint: Some(k),
        free: what.map(|w| of_joint(k, w)).to_vec(),
        starts: starts.iter().map(|s| s.to_vec()).collect(),
    };
    let line = |k| free(Effect::JointOffset, k, [OFFSET, RATIO], &LINES);
    let gear = |k| free(Effect::Backlash, k, [PLAY, FLEX], &GEARS);
    let all: Vec<Candidate> = (0..JOINTS)
        .map(line)
        .chain((0..JOINTS).filter(|_| !tier.link_measured).map(gear))
        .collect();
    let search = Search {
        model: tier,
        coordinates: &coordinates,
        candidates: &all,
        limits: limits(tier),
    };
    let base = Fit {
        members: Vec::new(),
        ..last.clone()
    };
    let (screened, _) = search.screen(&base, &(0..all.len()).collect::<Vec<_>>());
    let lead = screened.first()?;
    let cost = search.fit(&lead.theta, &[lead.candidate], 3).cost;
    let found = &all[lead.candidate];
    (left - cost > TAKEN * (left - USUAL)).then_some((found.effect.stage(), found.joint))
}

#[cfg(test)]
mod tests {
    use super::{CALM, CALM_BY_JOINT, LEFT, LEFT_BY_JOINT, speaks};

    /// Two numbers that cost as much as each gait does.
    fn gaits(costs: &[f64]) -> Vec<Vec<f64>> {
        costs.iter().map(|c| vec![c.sqrt(); 2]).collect()
    }

    #[test]
    fn what_contacts_of_another_make_leave_is_no_remainder() {
        // In the middle of what emulated robots and robots that MuJoCo plays leave, and of what two causes leave that must not be named: whether that is a
        // remainder, and whether it is one where a joint takes it away.
        for (what, costs, alone, by_joint) in [
            ("emulated", [0.7, 0.8, 1.2, 1.3], false, false),
            (
                "emulated, gaits with blows",
                [0.8, 0.9, 2.4, 2.6],
                false,
                false,
            ),
            (
                "emulated, an offset in readings too",
                [1.1, 1.4, 1.8, 2.2],
                false,
                true,
            ),
            ("MuJoCo", [1.5, 1.6, 1.7, 1.9], false, true),
            ("MuJoCo, soft contacts", [2.3, 2.5, 3.0, 3.2], false, true),
            ("soft ground", [2.8, 3.0, 3.7, 3.9], true, true),
            ("centre of mass", [6.0, 7.1, 8.0, 8.6], true, true),
        ] {
            let costs = gaits(&costs);
            assert_eq!(speaks(&costs, LEFT, CALM), alone, "{what}");
            let joint = speaks(&costs, LEFT_BY_JOINT, CALM_BY_JOINT);
            assert_eq!(joint, by_joint, "{what}");
        }
    }
}
