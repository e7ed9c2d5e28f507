//! What is changed about a joint's answer when the search is over.

use super::answer::REMAINDER;
use super::clock::ONE_CLOCK;
use super::intervals::REPLAYED;
use super::joint_library::last_resort;
use super::joints::{Found, Tier};
use super::open::{self, Law};
use super::score::{Score, State};
use super::search::{Answer, Candidate, Coordinate, Fit, Search};
use super::servo::{J, JointRun};
use crate::vocabulary::{Effect, Stage};

/// The first effect whose interval holds the value at which it is none, or that is smaller than what is seen, by its place among those found, and the fit
/// without it. Where the joints are `mixed`, a friction of several numbers has the error of replayed loads in each.
pub(super) fn doubted(
    answer: &Answer,
    coordinates: &[Coordinate],
    mixed: bool,
) -> Option<(usize, Fit)> {
    let last = answer.last();
    let doubted = |m: &usize| {
        let own = &answer.candidates[*m];
        let loads = mixed && own.effect.stage() == Stage::Drivetrain && own.free.len() > 1;
        let error = if loads { REPLAYED } else { 0.0 };
        own.free.iter().all(|i| {
            let off = (last.theta[*i] - coordinates[*i].neutral).abs();
            let spread = libm::hypot(last.spread[*i], error);
            off <= (1.96 * spread).max(coordinates[*i].least)
        })
    };
    let at = last.members.iter().position(doubted)?;
    Some((at, answer.removed_alone[at].0.clone()))
}

/// Gain over its threshold below which a limit of speed beside one of torque is none. A motor at its torque's limit is slow as well, and
/// two laws of the one differ (2.4 on an emulated robot whose speed nothing limited).
const HURRIED: f64 = 3.0;

/// A weak limit of speed beside a limit of torque, by its place among the effects found, and the fit without it.
pub(super) fn unhurried(answer: &Answer) -> Option<(usize, Fit)> {
    let members = &answer.last().members;
    let effect = |m: &usize| answer.candidates[*m].effect;
    let limit = |m: &usize| matches!(effect(m), Effect::TorqueLimit | Effect::CurrentLimit);
    if !members.iter().any(limit) {
        return None;
    }
    let weak = |(at, m): (usize, &usize)| {
        effect(m) == Effect::VelocityLimit && answer.strengths[at] < HURRIED
    };
    let at = members.iter().enumerate().position(weak)?;
    Some((at, answer.removed_alone[at].0.clone()))
}

/// Gain over its threshold below which the gravity load of a joint is none where links play or twist. Replayed loads then stand a little
/// elsewhere (1.4 beside the play of another joint, 4.3 where one was planted beside a connector's; emulated robots).
const HEAVY: f64 = 2.5;

/// A weak gravity load of a joint of a robot whose links are `loose`, by its place among the effects found, and the fit without it.
pub(super) fn weightless(answer: &Answer, loose: bool) -> Option<(usize, Fit)> {
    let weak = |(at, m): (usize, &usize)| {
        answer.candidates[*m].effect == Effect::GravityLoad && answer.strengths[at] < HEAVY
    };
    let mut members = answer.last().members.iter().enumerate();
    let at = members.position(weak).filter(|_| loose)?;
    Some((at, answer.removed_alone[at].0.clone()))
}

/// The answer with a motor that weakens as it warms up, tried alone; `None` where it is not believed.
pub(super) fn weakened(search: &Search<'_, Tier>, base: Fit, nominal: Vec<f64>) -> Option<Answer> {
    let candidates = [last_resort(search.model.joint)];
    let alone = Search {
        candidates: &candidates,
        ..*search
    };
    let answer = alone.answer(base, nominal);
    (!answer.last().members.is_empty()).then_some(answer)
}

/// The answer with a ripple that is a law in what effects leave of the torque and leaves none itself; `None` where there is none. `shown` is what other
/// evidence has shown.
///
/// Angles hardly show a ripple, and where currents are coarse the torque's share of the cost is small.
pub(super) fn rippled(
    search: &Search<'_, Tier>,
    answer: &Answer,
    nominal: &[f64],
    shown: &[usize],
) -> Option<Answer> {
    let of = |c: &Candidate| c.effect == Effect::TorqueRipple;
    let c = search.candidates.iter().position(of)?;
    let last = answer.last();
    if !search.model.torque || last.members.contains(&c) {
        return None;
    }
    let periods = open::periods(search.model, &last.theta)?;
    let from = |nm: f64| {
        let mut theta = last.theta.clone();
        theta[J::RippleSin as usize] = nm;
        theta[J::RipplePeriods as usize] = f64::from(periods);
        let members = [last.members.as_slice(), &[c]].concat();
        search.fit(&theta, &members, search.limits.iterations)
    };
    let fits = [open::LEAST_NM, -open::LEAST_NM].map(from);
    let fit = fits.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost))?;
    let remains = fit.cost > last.cost.min(REMAINDER);
    if remains || open::law(search.model, &fit.theta).share > RIPPLED {
        return None;
    }
    let steps = answer.steps.iter().cloned().chain([fit]).collect();
    let shown = [shown, &[c]].concat();
    Some(search.summed_up((steps, answer.nearest), nominal, &shown))
}

/// A torque limit that was found, as the measured torque itself shows it: what a joint does beyond its limit hangs on its surroundings, which
/// a joint by itself does not know.
pub(super) fn limited(mut answer: Answer, tier: &Tier) -> Answer {
    let free = J::MaxTorque as usize;
    let last = answer.last();
    let found = last
        .members
        .iter()
        .any(|m| answer.candidates[*m].free.contains(&free));
    let fitted = last.theta[free] * tier.nominal.max_torque_nm;
    let per_ampere = last.theta[J::PerAmpere as usize];
    let factor = if tier.ampere { per_ampere } else { 1.0 };
    let off = |nm: &f64| libm::log(nm / fitted).abs();
    let shown = JointRun::plateaus_nm(&tier.runs).into_iter().flatten();
    // Of the two that which is nearer to the fitted one: two limits that blows alone meet came out a fifth too low by the other.
    let shown = shown
        .map(|nm| nm * factor)
        .min_by(|a, b| off(a).total_cmp(&off(b)));
    // The fit knows the limit to a factor; another plateau is something else.
    if let Some(nm) = shown.filter(|nm| found && (0.5..2.0).contains(&(nm / fitted))) {
        let at = answer.steps.len() - 1;
        answer.steps[at].theta[free] = nm / tier.nominal.max_torque_nm;
    }
    answer
}

/// Angle error on the scored runs with an effect over that without it from which the effect is refuted, and the share of the torque's error that
/// it must take off to stand even so.
const REFUTED: f64 = 1.3;
const REPAID: f64 = 0.2;
/// Share of its error that angle or torque of the scored runs must lose with an effect. Planted ones take 3 % of one of them away at least.
/// A dead band that a torque limit's other law asked for made both 4 % worse (emulated robots).
const USEFUL: f64 = 0.01;

/// Whether a joint whose scored runs have these errors [without an effect, with it] is better off without it; where its `link` was measured, that may be
/// where the effect shows.
fn better_off(angle_rad: Option<[f64; 2]>, torque_nm: Option<[f64; 2]>, link: bool) -> bool {
    let to = |error: Option<[f64; 2]>, share: f64| error.is_some_and(|[a, b]| b < share * a);
    let worse = angle_rad.is_some_and(|[a, b]| b > REFUTED * a);
    let useful = link || to(angle_rad, 1.0 - USEFUL) || to(torque_nm, 1.0 - USEFUL);
    (worse && !to(torque_nm, 1.0 - REPAID)) || !useful
}

/// Whether an effect that the scored runs refute took so much away, from the cost `without` it to that `with` it, that something is there
/// which it bent to. A ripple took 5.2 of the 5.7 squared tolerances of a hysteretic spring (an emulated robot).
fn bends(with: f64, without: f64) -> bool {
    const PLAIN: f64 = 3.0;
    const MOST: f64 = 0.5;
    without > PLAIN && with < MOST * without
}

/// Takes the effects of joints away that the scored runs refute: their angles are foretold far worse with them and their torques hardly better, or neither of
/// them better. What is left is marked again where loads are `replayed` or not.
pub(super) fn refuted(score: &Score, joints: &mut [Found], replayed: bool) {
    for at in 0..joints.len() {
        let mut m = 0;
        let found = joints[at].answer.last().members.len();
        while m < joints[at].answer.last().members.len() {
            let state = |own: &Fit| State {
                joints: (joints.iter().enumerate())
                    .map(|(k, f)| if k == at { own } else { f.answer.last() })
                    .map(|fit| fit.theta.clone())
                    .collect(),
                body: Vec::new(),
                camera: Vec::new(),
                conventions: true,
                held: true,
            };
            let without = joints[at].answer.removed_alone[m].0.clone();
            let rows = score.by_joint(&state(&without), &state(joints[at].answer.last()));
            let row = &rows[at];
            if better_off(row.angle_rad, row.torque_nm, joints[at].tier.has_link()) {
                joints[at].refuted |= bends(joints[at].answer.last().cost, without.cost);
                joints[at].answer.drop_member(m, without);
            } else {
                m += 1;
            }
        }
        if m < found {
            joints[at].look();
        }
    }
    mark(joints, replayed);
}

impl Found {
    /// Whether `effect` was found.
    fn names(&self, effect: Effect) -> bool {
        let named = |m: &usize| self.answer.candidates[*m].effect == effect;
        self.answer.last().members.iter().any(named)
    }

    /// Whether a limit of its torque was found.
    pub(super) fn limited(&self) -> bool {
        let limit = J::MaxTorque as usize;
        let own = |m: &usize| self.answer.candidates[*m].free.contains(&limit);
        self.answer.last().members.iter().any(own)
    }

    /// Whether an effect of the drivetrain was found: its law stands beside any other.
    fn drives(&self) -> bool {
        let own = |m: &usize| self.answer.candidates[*m].effect.stage() == Stage::Drivetrain;
        self.answer.last().members.iter().any(own)
    }

    /// Whether the effects found only bend to what the joint shows: a straight line mends a part of any gap, any law a part of one that is a straight line, and
    /// more than a fifth of it stays.
    fn bent(&self) -> bool {
        const STAYS: f64 = 0.2;
        let excess = |fit: &Fit| (fit.cost - 1.0).max(0.0);
        let (answer, last) = (&self.answer, self.answer.last());
        let straight = |m: &usize| answer.candidates[*m].effect.stage() == Stage::Conventions;
        let stays = excess(last) > STAYS * excess(&answer.steps[0]);
        let alike = last.members.iter().all(straight) || self.gap == Stage::Conventions;
        !last.members.is_empty() && alike && last.cost > REMAINDER && stays
    }
}

/// Takes the clock away from joints that alone say that it is skewed: all joints share it.
pub(super) fn drop_lone_clocks(joints: &mut [Found]) {
    let clock = |f: &Found| {
        let of = |m: &usize| f.answer.candidates[*m].effect == Effect::ClockSkew;
        f.answer.last().members.iter().position(of)
    };
    let said = joints.iter().filter(|f| clock(f).is_some()).count();
    if joints.len() < ONE_CLOCK || said >= ONE_CLOCK {
        return;
    }
    for f in joints {
        if let Some(m) = clock(f) {
            let without = f.answer.removed_alone[m].0.clone();
            f.answer.drop_member(m, without);
            f.look();
        }
    }
}

/// How many times as large as the next joint's law one must be: laws of one joint are six times those of the next (emulated robots), of a ground that was
/// taken for another 1.6 times.
const APART: f64 = 2.0;
/// A ripple that is one leaves 0.004 to 0.008 that a law predicts; one that imitates a hysteresis on the path of few gaits 0.07 to 0.16, one with a
/// wrong number of periods 0.17 (emulated robots).
const RIPPLED: f64 = 0.05;

/// Whether what a joint keeps follows a `law` that the library does not hold. This is so where that of the `next` joint predicts so much,
/// one below `least_nm` is the error of the loads, and the joint is said to have a `ripple`.
fn outside(law: &Law, next: f64, least_nm: f64, ripple: bool) -> bool {
    let apart = law.share > open::LAW && law.share > APART * next;
    (apart && law.size_nm > least_nm) || (ripple && law.share > RIPPLED)
}

/// What effects of the drivetrain may leave over what the best law leaves, and the size of a law from which it counts beside them, N m.
/// True ones leave 0.96 at most, and of it a law predicts no more than 0.09. A hysteresis and a gain by direction that frictions imitated
/// left 1.22 and 1.25. Two others left a law of 0.26 and 0.32, of 0.06 to 0.14 N m (58 joints of emulated robots).
const SETTLED: f64 = 1.15;
const STRAY_NM: f64 = 0.05;

/// What the effects of a joint may leave over what the best law leaves, and the size from which a law counts. It is for joints where laws
/// below `least_nm` are the error of the loads and the joint `drives` with an effect of its drivetrain or not.
fn bounds(drives: bool, least_nm: f64) -> [f64; 2] {
    if drives {
        [SETTLED, STRAY_NM.min(least_nm)]
    } else {
        [open::RIVAL, least_nm]
    }
}

/// Marks the joints whose remainder follows a law: one that several joints show comes from the loads, which the body shares; and so does a small
/// one where the loads are `replayed`.
pub(super) fn mark(found: &mut [Found], replayed: bool) {
    let least_nm = if replayed { open::LEAST_NM } else { 0.0 };
    let laws: Vec<f64> = found.iter().map(|f| f.law.share).collect();
    for (k, f) in found.iter_mut().enumerate() {
        let [rival, least_nm] = bounds(f.drives(), least_nm);
        let others = laws.iter().enumerate().filter(|l| l.0 != k);
        let next = others.map(|l| *l.1).fold(0.0, f64::max);
        f.odd = outside(&f.law, next, least_nm, f.names(Effect::TorqueRipple));
        if f.odd && f.rest != Stage::Transmission {
            // Laws are those of torques.
            f.rest = Stage::Drivetrain;
        }
        f.odd |= f.refuted;
        if f.bent() {
            (f.astray, f.rest) = (true, f.gap);
        }
        if f.late {
            (f.odd, f.astray, f.rest) = (true, true, Stage::Transport);
        }
        if f.rival > rival && f.law.size_nm > least_nm {
            // The gap is where it was without them.
            (f.odd, f.astray, f.rest) = (true, true, f.gap);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::search::Candidate;
    use super::super::terms::samples::{fit, found};
    use super::{
        Answer, Coordinate, Effect, Law, bends, better_off, bounds, doubted, outside, unhurried,
        weightless,
    };

    /// An answer with these effects: number of their coordinates, what each is, and the gain over its threshold.
    fn answer(effects: &[(Effect, &[f64], f64)]) -> (Answer, Vec<Coordinate>) {
        let mut candidates = Vec::new();
        let mut theta = Vec::new();
        for (effect, values, _) in effects {
            candidates.push(Candidate {
                effect: *effect,
                joint: Some(0),
                free: (theta.len()..theta.len() + values.len()).collect(),
                starts: Vec::new(),
            });
            theta.extend(*values);
        }
        let coordinates = vec![
            Coordinate {
                neutral: 0.0,
                sigma: 0.0,
                step: 0.01,
                least: 0.01,
                range: [-10.0, 10.0],
            };
            theta.len()
        ];
        let mut last = fit(&[]);
        last.members = (0..effects.len()).collect();
        last.spread = vec![0.05; theta.len()];
        last.theta = theta;
        let strengths = effects.iter().map(|e| e.2).collect();
        (found(candidates, last, strengths), coordinates)
    }

    #[test]
    fn an_effect_whose_interval_holds_none_is_doubted() {
        const DRY: Effect = Effect::CoulombFriction;
        const SLANT: Effect = Effect::AsymmetricFriction;
        for (what, values, mixed, is) in [
            ("far from none", &[0.3][..], false, None),
            ("within its error", &[0.09], false, Some(0)),
            ("two numbers, one far from none", &[0.2, 0.0], false, None),
            (
                "the same where joints are mixed",
                &[0.2, 0.0],
                true,
                Some(0),
            ),
            ("large where joints are mixed", &[0.3, 0.0], true, None),
            ("one number where joints are mixed", &[0.2], true, None),
        ] {
            let effect = if values.len() > 1 { SLANT } else { DRY };
            let (answer, coordinates) = answer(&[(effect, values, 1.0)]);
            let at = doubted(&answer, &coordinates, mixed).map(|d| d.0);
            assert_eq!(at, is, "{what}");
        }
    }

    #[test]
    fn a_weak_limit_of_speed_beside_one_of_torque_is_none() {
        const SPEED: Effect = Effect::VelocityLimit;
        const TORQUE: Effect = Effect::TorqueLimit;
        for (what, effects, is) in [
            (
                "weak, beside",
                &[(TORQUE, &[1.0][..], 9.0), (SPEED, &[1.0], 2.4)][..],
                Some(1),
            ),
            (
                "strong, beside",
                &[(TORQUE, &[1.0], 9.0), (SPEED, &[1.0], 4.0)],
                None,
            ),
            (
                "a weak dead band, beside",
                &[(TORQUE, &[1.0], 9.0), (Effect::Deadband, &[1.0], 2.4)],
                None,
            ),
            ("weak, alone", &[(SPEED, &[1.0], 1.2)], None),
            (
                "a current's",
                &[(SPEED, &[1.0], 1.2), (Effect::CurrentLimit, &[1.0], 1.0)],
                Some(0),
            ),
        ] {
            assert_eq!(unhurried(&answer(effects).0).map(|u| u.0), is, "{what}");
        }
    }

    #[test]
    fn an_effect_stays_where_the_scored_runs_are_foretold_better_with_it() {
        const BOTH: [bool; 2] = [true, true];
        const NEITHER: [bool; 2] = [false, false];
        // Errors [without, with]; whether the effect goes where the link was not measured, and where it was.
        for (what, angle_rad, torque_nm, goes) in [
            ("angles better", [1.0, 0.9], Some([1.0, 1.0]), NEITHER),
            ("torques better", [1.0, 1.0], Some([1.0, 0.9]), NEITHER),
            (
                "torques a little better, angles far worse",
                [1.0, 1.4],
                Some([1.0, 0.9]),
                BOTH,
            ),
            (
                "torques far better, angles far worse",
                [1.0, 1.4],
                Some([1.0, 0.7]),
                NEITHER,
            ),
            (
                "both a little worse",
                [1.0, 1.05],
                Some([1.0, 1.04]),
                [true, false],
            ),
            (
                "neither changes",
                [1.0, 0.995],
                Some([1.0, 1.0]),
                [true, false],
            ),
            ("angles alone, better", [1.0, 0.9], None, NEITHER),
            ("angles alone, the same", [1.0, 1.0], None, [true, false]),
            (
                "angles that are no number",
                [1.0, f64::NAN],
                None,
                [true, false],
            ),
        ] {
            let said = [false, true].map(|link| better_off(Some(angle_rad), torque_nm, link));
            assert_eq!(said, goes, "{what}");
        }
        assert!(bends(0.5, 5.7) && !bends(0.5, 1.6) && !bends(4.0, 5.7));
    }

    #[test]
    fn a_weak_gravity_load_of_a_loose_robot_is_none() {
        const LOAD: Effect = Effect::GravityLoad;
        for (what, strength, loose, is) in [
            ("weak, loose", 1.4, true, Some(0)),
            ("strong, loose", 4.3, true, None),
            ("weak, tight", 1.4, false, None),
        ] {
            let (answer, _) = answer(&[(LOAD, &[0.5], strength)]);
            assert_eq!(weightless(&answer, loose).map(|w| w.0), is, "{what}");
        }
    }

    #[test]
    fn a_law_outside_the_library_is_one_joints_and_larger_than_the_error_of_the_loads() {
        for (what, [share, size_nm, next], ripple, is) in [
            ("a hysteresis", [0.4, 0.3, 0.05], false, true),
            (
                "too little of what is left",
                [0.19, 0.3, 0.05],
                false,
                false,
            ),
            ("soft ground: small", [0.4, 0.09, 0.05], false, false),
            (
                "loads that all joints share",
                [0.4, 0.3, 0.25],
                false,
                false,
            ),
            ("a ripple", [0.006, 0.02, 0.0], true, false),
            ("a ripple of a wrong period", [0.17, 0.1, 0.0], true, true),
        ] {
            let law = Law { share, size_nm };
            assert_eq!(outside(&law, next, 0.12, ripple), is, "{what}");
        }
    }

    #[test]
    fn a_friction_beside_which_a_law_stays_is_astray() {
        for (what, drives, [rival, share, size_nm, next], [astray, odd]) in [
            (
                "a friction that is one",
                true,
                [0.96, 0.05, 0.05, 0.02],
                [false, false],
            ),
            (
                "a hysteresis told as one",
                true,
                [1.25, 0.107, 0.14, 0.017],
                [true, false],
            ),
            (
                "one that leaves a small law",
                true,
                [0.93, 0.32, 0.104, 0.079],
                [false, true],
            ),
            (
                "a dead band beside a friction that hides",
                false,
                [1.25, 0.228, 0.075, 0.113],
                [false, false],
            ),
        ] {
            let [most, least_nm] = bounds(drives, 0.12);
            let law = Law { share, size_nm };
            assert_eq!(rival > most && size_nm > least_nm, astray, "{what}");
            assert_eq!(outside(&law, next, least_nm, false), odd, "{what}");
        }
        // Loads that were measured have no error.
        assert_eq!(bounds(true, 0.0)[1], 0.0);
    }
}
