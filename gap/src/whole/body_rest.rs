//! What the body leaves when all that was found is in it: how much of it speaks, and where it arose.

use super::body::{FLEX, OFFSET, PLAY, RATIO, Tier, of_joint};
use super::body_answer::{Found, limits, steepness};
use super::body_library::coordinates;
use super::data::JOINTS;
use super::search::{Candidate, Coordinate, Evaluate, Fit, Limits, Search};
use crate::math;
use crate::verdict::Law;
use crate::vocabulary::{Effect, Stage};

/// What nothing that was found explains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rest {
    /// How far it stands above what emulated robots without a cause leave, in thresholds; 0 where it does not. Beside what was named that much says that it
    /// bent to something else.
    evidence: f64,
    /// The same above what contacts of other makes leave: where nothing was named, less is no remainder.
    alone: f64,
    /// Stage and joint in which it arose.
    pub(super) place: (Stage, Option<usize>),
}

impl Rest {
    /// Nothing of note.
    pub(super) const NONE: Self = Self {
        evidence: 0.0,
        alone: 0.0,
        place: (Stage::Body, None),
    };

    /// How far it stands above what is no remainder, in thresholds, where something was `named` or nothing.
    pub(super) fn evidence(&self, named: bool) -> f64 {
        if named { self.evidence } else { self.alone }
    }
}

/// Tolerances by which half the windows end off at most on contacts that differ. They are 0.7 to 1.1 on robots without a cause that
/// another engine played, 0.3 to 0.6 on emulated ones; 1.5 beside a centre of mass that must not be named.
const OFF: f64 = 1.25;
/// Cost at the tolerances of the inertial sensor above which the simulator misses something of this body: 1.3 to 1.8 on emulated robots without
/// a cause. Robots that another engine played leave 7: its contacts are not the simulator's.
const LEFT: f64 = 2.1;
/// Cost of the calmer half of the gaits above which the same holds: 1.0 to 1.6 on 130 emulated robots without a cause, 1.9 and more where an effect of the body must
/// not be named. Gaits with many blows leave more whatever the body is, and two robots 2.1 and 2.3 in all.
const CALM: f64 = 1.7;
/// Cost, at the tolerances of the inertial sensor and of contacts of any make, above which the simulator misses something of this body. The
/// second is that of the calmer half of the gaits, since gaits with many blows leave more whatever the body is. On contacts of the other
/// law MuJoCo's robots without a cause leave 2.9 and 3.0, and 2.5 and 2.6 (two, as MuJoCo comes), with one that was named 1.9 to 2.9 and
/// 1.4 to 2.3 (eight).
const FOREIGN: [f64; 2] = [3.1, 2.5];
/// The same where either law leaves as much and nothing was named. Robots whose body is emulated with this project's equations leave 0.7 to
/// 1.0 and 0.6 to 0.8 (six without a cause, 20 with one that was named). Without a cause 1.2 to 2.2 and 1.0 to 1.5 are left where MuJoCo
/// plays the body with a round cone of friction, soft contacts among them (seven). A ground of 8 kN/m that must not be named leaves 2.6 and
/// 2.2.
const UNCLEAR: [f64; 2] = [2.4, 2.0];
/// The same beside what was named: 1.2 to 1.5 and 0.9 to 1.2 on three robots that MuJoCo plays with a round cone and that were told their cause.
const BESIDE: [f64; 2] = [1.8, 1.5];
/// What emulated robots without a cause leave at the sensor's tolerances, in the middle.
const USUAL: f64 = 1.5;
/// Share of what the nominal body leaves from which what was found takes away so much that the rest is how its law differs. Of a
/// connector's play of 0.1 rad two honest simulators keep half, of a ground of half the friction as much.
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
        let left = self.tier.sharp(|tier| {
            let residuals = tier.residuals(&last.theta);
            let cost = super::least::cost(&residuals);
            let before = tier.thinned(first, 1);
            if before - cost > KNOWN * (before - 1.0) {
                return (0.0, None);
            }
            if !speaks(&residuals, LEFT, CALM) {
                return (0.0, None);
            }
            (cost / LEFT, between(tier, &last, cost))
        });
        let (cost, place) = left.unwrap_or((0.0, None));
        let tilt = self.tilt();
        // Contacts sit in no joint.
        let asked = self.contacts.law != Law::Nominal && cost > 0.0 && place.is_none();
        let among = asked.then(|| self.among_makes(&last.theta)).flatten();
        let beyond = |[left, quiet]: [f64; 2]| match &among {
            Some(residuals) if speaks(residuals, left, quiet) => {
                super::least::cost(residuals) / left
            }
            Some(_) => 0.0,
            None => cost,
        };
        // What was named beside contacts that are not the simulator's has bent to less.
        let [beside, alone] = match self.contacts.law {
            Law::Nominal => [cost; 2],
            Law::Unclear => [BESIDE, UNCLEAR].map(beyond),
            Law::Other => [beyond(FOREIGN); 2],
        };
        self.contacts.left_any_make = among.as_deref().map(super::least::cost);
        let over = |x: f64| if x > 1.0 { x } else { 0.0 };
        let place = place
            .filter(|_| tilt <= 1.0)
            .or_else(|| self.beside())
            .unwrap_or(Rest::NONE.place);
        self.rest = Rest {
            evidence: over(ends.max(beside).max(tilt)),
            alone: over(ends.max(alone).max(tilt)),
            place,
        };
    }

    /// What windows of the body `theta` leave where they may end off by what contacts of other makes do.
    fn among_makes(&mut self, theta: &[f64]) -> Option<Vec<Vec<f64>>> {
        self.tier.among_makes(theta, |tier| tier.residuals(theta))
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
        let left = self
            .tier
            .sharp(|tier| speaks(&tier.residuals(theta), LEFT, CALM));
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
    use super::{BESIDE, CALM, FOREIGN, UNCLEAR, calm, speaks};

    #[test]
    fn what_contacts_of_another_make_leave_is_no_remainder() {
        // In the middle of what robots that MuJoCo plays leave, and of what causes leave that must not be named; whether that is a remainder beside what was named,
        // on contacts that may be the simulator's, and on foreign ones.
        for (what, costs, remains) in [
            ("round cone, named", [0.9, 1.1, 1.3, 1.5], [false; 3]),
            ("round cone", [1.2, 1.5, 1.5, 1.7], [false; 3]),
            ("soft contacts", [1.4, 1.5, 2.7, 3.2], [false; 3]),
            ("blows alone", [1.2, 1.4, 5.0, 6.0], [false; 3]),
            (
                "ground of 8 kN/m",
                [2.0, 2.3, 2.8, 3.3],
                [true, true, false],
            ),
            ("as it comes", [2.4, 2.6, 3.2, 3.5], [true, true, false]),
            ("centre of mass", [6.0, 7.1, 8.0, 8.6], [true; 3]),
        ] {
            let gaits: Vec<Vec<f64>> = costs.iter().map(|c: &f64| vec![c.sqrt(); 2]).collect();
            let told = [BESIDE, UNCLEAR, FOREIGN].map(|[left, quiet]| speaks(&gaits, left, quiet));
            assert_eq!(told, remains, "{what}");
        }
    }

    #[test]
    fn what_gaits_with_many_blows_leave_alone_is_no_remainder() {
        // What gaits leave of emulated robots: without a cause of the body, the last beside a friction of a joint; with one that must not be named.
        for (costs, speaks) in [
            (&[0.98, 1.19, 1.63, 1.54][..], false),
            (&[1.32, 1.69, 2.96, 3.38], false),
            (&[1.1, 2.0, 3.1, 2.2], false),
            (&[1.75, 2.20, 3.28, 2.83], true),
            (&[1.80, 2.91, 2.92, 1.95], true),
            (&[2.2], true),
        ] {
            assert_eq!(calm(costs.to_vec()) > CALM, speaks, "{costs:?}");
        }
    }
}
