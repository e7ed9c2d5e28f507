//! Sets of causes by their evidence: all singles, all that may follow the best sets, exchanges, and what is left out.

use rayon::prelude::*;

use super::block::Block;
use super::cause::{Cause, Entries};
use super::linear::{cholesky, forward, inverse, log_determinant};
use crate::math::Rng;

/// Sets that are kept at every size.
const BEAM: usize = 6;
/// Rounds of exchanges after growth.
const EXCHANGES: usize = 3;

/// Blocks and the causes that may be in them.
#[derive(Debug, Clone, Copy)]
pub struct Problem<'a> {
    /// Blocks.
    pub blocks: &'a [Block],
    /// Causes.
    pub causes: &'a [Cause],
    /// What is always there: differences between simulators and parts that blocks share.
    pub always: &'a [Cause],
}

/// A set of causes.
#[derive(Debug, Clone, PartialEq)]
pub struct Set {
    /// Causes by number, ascending.
    pub members: Vec<usize>,
    /// Logarithm of the evidence over that of no cause, prior included.
    pub evidence: f64,
}

/// Posterior of a set's latent numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Posterior {
    /// First latent number of every member.
    pub first: Vec<usize>,
    /// Means.
    pub mean: Vec<f64>,
    /// Covariance, row-major.
    pub covariance: Vec<f64>,
}

impl Posterior {
    /// Latent numbers drawn from it.
    #[must_use]
    pub fn drawn(&self, rng: &mut Rng) -> Vec<f64> {
        let n = self.mean.len();
        let l = cholesky(&self.covariance, n);
        let z: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
        let row = |i: usize| (0..=i).map(|j| l[i * n + j] * z[j]).sum::<f64>();
        (0..n).map(|i| self.mean[i] + row(i)).collect()
    }
}

/// What else a member may be.
#[derive(Debug, Clone, PartialEq)]
pub struct Rival {
    /// Cause by number.
    pub cause: usize,
    /// Evidence of the set with the member less that with the rival in its place.
    pub margin: f64,
}

/// The outcome of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// The best set.
    pub best: Set,
    /// Evidence that each member adds to the others.
    pub gains: Vec<f64>,
    /// Rivals of each member, nearest first.
    pub rivals: Vec<Vec<Rival>>,
    /// The cause that was not taken and would add the largest share of what is asked of it, and what it would add.
    pub next: Option<(usize, f64)>,
}

/// Logarithm of twice the standard normal distribution function.
fn log_twice_normal(x: f64) -> f64 {
    let p = libm::erfc(-x / std::f64::consts::SQRT_2);
    if p > 1e-300 {
        libm::log(p)
    } else {
        // Mills ratio.
        -0.5 * x * x - libm::log(-x) - 0.5 * libm::log(0.5 * std::f64::consts::PI)
    }
}

impl Problem<'_> {
    fn product(&self, a: &Entries, b: &Entries) -> f64 {
        let mut sum = 0.0;
        for (block, column, w) in a {
            for (other, beside, v) in b {
                if block == other {
                    sum += w * v * self.blocks[*block].product(*column, *beside);
                }
            }
        }
        sum
    }

    fn moment(&self, a: &Entries) -> f64 {
        a.iter()
            .map(|(b, c, w)| w * self.blocks[*b].moment[*c])
            .sum()
    }

    /// `I + M` of the latent numbers, their moments, and the part of the evidence that prior means give.
    fn normal(&self, members: &[usize]) -> (Vec<f64>, Vec<f64>, f64) {
        let own = members.iter().flat_map(|m| &self.causes[*m].latents);
        let latents: Vec<&Entries> = own
            .chain(self.always.iter().flat_map(|c| &c.latents))
            .collect();
        let given = members.iter().map(|m| &self.causes[*m]);
        let mean: Entries = given
            .chain(self.always)
            .flat_map(|c| c.mean.clone())
            .filter(|e| e.2 != 0.0)
            .collect();
        let n = latents.len();
        let mut a = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                let x = self.product(latents[i], latents[j]);
                a[i * n + j] = x;
                a[j * n + i] = x;
            }
            a[i * n + i] += 1.0;
        }
        let z = latents
            .iter()
            .map(|l| self.moment(l) - self.product(l, &mean))
            .collect();
        let given = self.moment(&mean) - 0.5 * self.product(&mean, &mean);
        (a, z, given)
    }

    /// Logarithm of the evidence of a set over that of no cause, prior included.
    #[must_use]
    pub fn evidence(&self, members: &[usize]) -> f64 {
        let (a, mut z, given) = self.normal(members);
        let n = z.len();
        let l = cholesky(&a, n);
        let moments = z.clone();
        forward(&l, n, &mut z);
        let square: f64 = z.iter().map(|z| z * z).sum();
        let mut out = given + 0.5 * square - 0.5 * log_determinant(&l, n);
        let mut at = 0;
        for m in members {
            let cause = &self.causes[*m];
            out += cause.log_prior;
            if cause.positive {
                out += sign(&l, n, &moments, at, cause);
            }
            at += cause.latents.len();
        }
        out
    }

    /// Posterior of the latent numbers of a set.
    #[must_use]
    pub fn posterior(&self, members: &[usize]) -> Posterior {
        let (a, z, _) = self.normal(members);
        let n = z.len();
        let covariance = inverse(&cholesky(&a, n), n);
        let mean = (0..n)
            .map(|i| (0..n).map(|j| covariance[i * n + j] * z[j]).sum())
            .collect();
        let mut first = Vec::with_capacity(members.len());
        let mut at = 0;
        for m in members {
            first.push(at);
            at += self.causes[*m].latents.len();
        }
        Posterior {
            first,
            mean,
            covariance,
        }
    }

    /// Block, column and mean of every coefficient that each member of a set moves, and of those that are always there.
    #[must_use]
    pub fn by_member(&self, members: &[usize]) -> (Vec<Entries>, Entries) {
        self.with_latents(members, &self.posterior(members).mean)
    }

    /// The same where the latent numbers are these.
    #[must_use]
    pub fn with_latents(&self, members: &[usize], latents: &[f64]) -> (Vec<Entries>, Entries) {
        let mut latents = latents.iter();
        let mut of = |cause: &Cause| -> Entries {
            let mut out = cause.mean.clone();
            for (latent, by) in cause.latents.iter().zip(&mut latents) {
                out.extend(latent.iter().map(|(b, c, w)| (*b, *c, by * w)));
            }
            out
        };
        let named = members.iter().map(|m| of(&self.causes[*m])).collect();
        (named, self.always.iter().flat_map(of).collect())
    }

    /// Block, column and mean of every coefficient that a set moves.
    #[must_use]
    pub fn coefficients(&self, members: &[usize]) -> Entries {
        let mut out = Entries::new();
        for entry in self.by_member(members).0.into_iter().flatten() {
            match out.iter_mut().find(|o| (o.0, o.1) == (entry.0, entry.1)) {
                Some(own) => own.2 += entry.2,
                None => out.push(entry),
            }
        }
        out
    }

    /// Whether two causes may stand side by side: one effect has one cause at a joint.
    fn compatible(&self, a: usize, b: usize) -> bool {
        let (a, b) = (&self.causes[a], &self.causes[b]);
        if a.effect != b.effect {
            return true;
        }
        match a.effect {
            None => a.joints != b.joints || a.fixed != b.fixed,
            Some(_) => !a.joints.is_empty() && !a.joints.iter().any(|k| b.joints.contains(k)),
        }
    }

    fn with(&self, members: &[usize], cause: usize) -> Option<Set> {
        if !members.iter().all(|m| self.compatible(*m, cause)) {
            return None;
        }
        let mut members = members.to_vec();
        members.push(cause);
        members.sort_unstable();
        let evidence = self.evidence(&members);
        Some(Set { members, evidence })
    }

    /// Sets with one cause more, best first.
    fn grown(&self, sets: &[Set]) -> Vec<Set> {
        let mut out: Vec<Set> = sets
            .iter()
            .flat_map(|s| {
                (0..self.causes.len())
                    .into_par_iter()
                    .filter_map(|c| self.with(&s.members, c))
                    .collect::<Vec<_>>()
            })
            .collect();
        out.sort_by(|a, b| {
            let order = b.evidence.total_cmp(&a.evidence);
            order.then_with(|| a.members.cmp(&b.members))
        });
        out.dedup_by(|a, b| a.members == b.members);
        out
    }

    fn without(&self, set: &Set, at: usize) -> Set {
        let mut members = set.members.clone();
        members.remove(at);
        let evidence = self.evidence(&members);
        Set { members, evidence }
    }

    /// Evidence of a set less what is asked of its members, by cause.
    fn above(&self, set: &Set, asks: &[f64]) -> f64 {
        set.evidence - set.members.iter().map(|m| asks[*m]).sum::<f64>()
    }

    /// The best of the sets that differ from `set` by one member, left out or another one in its place.
    fn exchanged(&self, set: &Set, asks: &[f64]) -> Option<Set> {
        let mut best = set.clone();
        for at in 0..set.members.len() {
            let bare = self.without(set, at);
            let least = self.above(&bare, asks);
            if least > self.above(&best, asks) {
                best = bare.clone();
            }
            let others = self.grown(std::slice::from_ref(&bare));
            // A member must add what is asked of it; what it is, the evidence says.
            if let Some(other) = others.into_iter().find(|s| self.above(s, asks) > least)
                && (other.evidence > set.evidence + 1e-9 && other.evidence > best.evidence)
            {
                best = other;
            }
        }
        (best.members != set.members).then_some(best)
    }

    /// The set of causes of most evidence, each of which adds what is asked of it at least (`asks`, by cause).
    #[must_use]
    pub fn search(&self, asks: &[f64], most: usize) -> Found {
        let mut best = Set {
            members: Vec::new(),
            evidence: self.evidence(&[]),
        };
        let mut beam = vec![best.clone()];
        for _ in 0..most {
            let mut next = self.grown(&beam);
            let bar = self.above(&best, asks);
            let Some(first) = next.iter().find(|s| self.above(s, asks) > bar) else {
                break;
            };
            best = first.clone();
            next.truncate(BEAM);
            beam = next;
        }
        for _ in 0..EXCHANGES {
            let Some(other) = self.exchanged(&best, asks) else {
                break;
            };
            best = other;
            let bar = self.above(&best, asks);
            let more = self.grown(std::slice::from_ref(&best));
            if let Some(more) = more.into_iter().find(|s| self.above(s, asks) > bar)
                && more.members.len() <= most
            {
                best = more;
            }
        }
        self.weighed(best, asks)
    }

    /// A set with what each member adds, its rivals, and the best cause outside.
    fn weighed(&self, best: Set, asks: &[f64]) -> Found {
        let mut gains = Vec::new();
        let mut rivals = Vec::new();
        for at in 0..best.members.len() {
            let bare = self.without(&best, at);
            gains.push(best.evidence - bare.evidence);
            let own = best.members[at];
            let others = self.grown(&[bare]);
            rivals.push(
                others
                    .iter()
                    .filter_map(|s| {
                        let new = s.members.iter().find(|m| !best.members.contains(m))?;
                        (*new != own).then_some(Rival {
                            cause: *new,
                            margin: best.evidence - s.evidence,
                        })
                    })
                    .take(40)
                    .collect(),
            );
        }
        let more = self.grown(std::slice::from_ref(&best));
        let next = more
            .iter()
            .filter_map(|s| {
                let new = s.members.iter().find(|m| !best.members.contains(m))?;
                Some((*new, s.evidence - best.evidence))
            })
            .filter(|x| x.1 > 0.0)
            .max_by(|a, b| {
                let share = |x: &(usize, f64)| x.1 / asks[x.0];
                share(a).total_cmp(&share(b)).then_with(|| b.0.cmp(&a.0))
            });
        Found {
            best,
            gains,
            rivals,
            next,
        }
    }
}

/// Change of the evidence where the coefficients of a cause cannot be negative, each by itself.
fn sign(l: &[f64], n: usize, moments: &[f64], at: usize, cause: &Cause) -> f64 {
    let mut z = moments.to_vec();
    forward(l, n, &mut z);
    let mut out = 0.0;
    for number in &cause.numbers {
        let mut unit = vec![0.0; n];
        let mut prior = 0.0;
        for (latent, w) in &number.of_latents {
            unit[at + latent] = *w;
            prior += w * w;
        }
        forward(l, n, &mut unit);
        let variance: f64 = unit.iter().map(|x| x * x).sum();
        let mean: f64 = unit.iter().zip(&z).map(|(a, b)| a * b).sum();
        out += log_twice_normal((number.mean + mean) / variance.sqrt().max(1e-12))
            - log_twice_normal(number.mean / prior.sqrt().max(1e-12));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::block::{Column, Segment, Site, White};
    use crate::evidence::cause::{Group, Scope, causes};
    use crate::vocabulary::{Effect, Stage};

    /// A joint's block of white errors: `size` of dry friction and none of another effect.
    fn joint(k: usize, size: f64, rng: &mut Rng) -> Block {
        let n = 200;
        let side: Vec<f64> = (0..n)
            .map(|i| if i % 40 < 20 { 1.0 } else { -1.0 })
            .collect();
        let speed: Vec<f64> = (0..n)
            .map(|i| crate::math::sin(0.157 * f64::from(i)))
            .collect();
        let segment = Segment {
            y: side.iter().map(|s| size * s + rng.normal()).collect(),
            x: vec![side, speed],
            weight: vec![1.0; n as usize],
        };
        let site = Site {
            stage: Stage::Drivetrain,
            joint: Some(k),
            blind: false,
            coarse: false,
        };
        let columns = vec![
            Column::linear(Effect::CoulombFriction, "torque_nm", 0.0, 1.0).at_least_neutral(),
            Column::linear(Effect::ViscousFriction, "nm_s_rad", 0.0, 1.0).at_least_neutral(),
        ];
        White::whitened(site, columns, &[segment], [1.0, 1.0]).plain()
    }

    fn groups() -> Vec<Group> {
        vec![Group {
            scope: Scope::All,
            joints: (0..6).collect(),
        }]
    }

    fn found(sizes: [f64; 6]) -> Vec<(Option<Effect>, Scope, Vec<usize>)> {
        let mut rng = Rng::new(11);
        let blocks: Vec<Block> = (0..6).map(|k| joint(k, sizes[k], &mut rng)).collect();
        let causes = causes(&blocks, &groups(), &[]);
        let problem = Problem {
            blocks: &blocks,
            causes: &causes,
            always: &[],
        };
        let found = problem.search(&vec![6.0; causes.len()], 6);
        let one = |m: &usize| {
            let c = &causes[*m];
            (c.effect, c.scope, c.joints.clone())
        };
        found.best.members.iter().map(one).collect()
    }

    #[test]
    fn what_all_joints_have_is_one_cause_and_what_one_has_is_its_own() {
        let dry = Some(Effect::CoulombFriction);
        let all = (dry, Scope::All, vec![0, 1, 2, 3, 4, 5]);
        let third = (dry, Scope::Joint, vec![2]);
        let cases = [
            ("no joint", [0.0; 6], vec![]),
            ("every joint alike", [0.6; 6], vec![all.clone()]),
            (
                "every joint, worn apart",
                [0.8, 0.4, 0.6, 0.9, 0.5, 0.7],
                vec![all],
            ),
            ("one joint", [0.0, 0.0, 0.8, 0.0, 0.0, 0.0], vec![third]),
        ];
        for (what, sizes, expected) in cases {
            assert_eq!(found(sizes), expected, "{what}");
        }
    }

    #[test]
    fn what_comes_nearest_has_most_of_what_is_asked_of_it_and_some_at_least() {
        for (size, expected) in [(0.8, Some(Effect::CoulombFriction)), (0.0, None)] {
            let mut rng = Rng::new(11);
            let sizes = [0.0, 0.0, size, 0.0, 0.0, 0.0];
            let blocks: Vec<Block> = (0..6).map(|k| joint(k, sizes[k], &mut rng)).collect();
            let causes = causes(&blocks, &groups(), &[]);
            let problem = Problem {
                blocks: &blocks,
                causes: &causes,
                always: &[],
            };
            let found = problem.search(&vec![500.0; causes.len()], 6);
            assert_eq!(found.best.members, [0; 0]);
            let next = found.next.and_then(|(c, _)| causes[c].effect);
            assert_eq!(next, expected, "{size}");
        }
    }

    #[test]
    fn the_evidence_of_one_column_is_that_of_the_closed_form() {
        let mut rng = Rng::new(5);
        let block = joint(0, 0.5, &mut rng);
        let (square, moment) = (block.product(0, 0), block.moment[0]);
        let blocks = [block];
        let mut all = causes(&blocks, &[], &[]);
        all[0].positive = false;
        let problem = Problem {
            blocks: &blocks,
            causes: &all,
            always: &[],
        };
        // y ~ N(0, I + x x'): Sherman and Morrison, and the determinant lemma.
        let closed = 0.5 * moment * moment / (1.0 + square) - 0.5 * libm::log(1.0 + square);
        let own = problem.evidence(&[0]) - all[0].log_prior;
        assert!((own - closed).abs() < 1e-9, "{own} for {closed}");
        let posterior = problem.posterior(&[0]);
        assert!((posterior.mean[0] - moment / (1.0 + square)).abs() < 1e-9);
    }
}
