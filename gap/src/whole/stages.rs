//! The tiers of a robot, one after the other: what signals and body show, the loads that follow, the joints under them, what is scored.

use std::sync::Arc;

use files::dataset::{Manifest, Recording};
use files::model::Model;
use physics::Params;
use rayon::prelude::*;

use super::camera::Film;
use super::conventions::{self, Conventions};
use super::data::{Data, JOINTS};
use super::joints::{self, Around, Found, Tier};
use super::loads::{self, Replay};
use super::score::Score;
use super::search::Candidate;
use super::servo::Load;
use super::windows::{self, LinkMap, Window};
use super::{
    Settings, Split, WholeError, body, bounce, camera, direct, film, friction, last_word, split,
};
use crate::vocabulary::{Effect, Stage};

/// Share of a mass's effect on the loads that must stay on the friction that fits best. It is 0.3 for a mass of 1.4 whose friction nothing
/// tells, less where a friction was there that is too near to the nominal one to be named.
const STAYS: f64 = 0.25;
/// Effects of the body that a replay takes over well. A mass beside them then shows in the torques: as 0.838 beside a shifted centre
/// of mass where 0.832 is true, 1.02 on soft ground (emulated robots); a slope only turns gravity.
const REPLAYED: [Effect; 3] = [
    Effect::GroundSlope,
    Effect::ComOffset,
    Effect::GroundCompliance,
];

/// What is asked.
pub(super) struct Task<'a> {
    pub(super) manifest: &'a Manifest,
    pub(super) films: &'a [Film],
    pub(super) model: &'a Model,
    pub(super) settings: &'a Settings,
    /// The nominal model, ready to simulate.
    pub(super) params: Arc<Params>,
}

/// What signals and body show.
pub(super) struct Seen {
    pub(super) data: Arc<Data>,
    pub(super) split: Split,
    pub(super) conventions: Conventions,
    pub(super) direct: Vec<direct::Reading>,
    pub(super) body: Option<body::Found>,
    /// Readings stood in another order and have been put in order.
    moved: bool,
}

/// Loads of all joints by run, and the windows that they were replayed in.
pub(super) struct Loads {
    windows: Vec<Window>,
    /// The friction that motion and torques agree on, over the nominal one.
    agreed: Option<f64>,
    by_run: Vec<[Load; JOINTS]>,
}

impl Seen {
    /// Whether `effect` was read off.
    fn reads(&self, effect: Effect) -> bool {
        self.direct.iter().any(|r| r.effect == effect)
    }

    /// Whether joints stood in another order.
    fn mixed(&self) -> bool {
        self.moved || self.conventions.mixed()
    }

    /// Whether the body holds an effect that `is` so.
    fn holds(&self, is: impl Fn(&Candidate) -> bool) -> bool {
        self.body.as_ref().is_some_and(|b| {
            let members = &b.answer.last().members;
            members.iter().any(|c| is(&b.answer.candidates[*c]))
        })
    }
}

impl Task<'_> {
    /// Signals and body.
    pub(super) fn see(&self, recordings: &[Recording]) -> Result<Seen, WholeError> {
        let mut data = Data::new(self.manifest, recordings, self.model);
        film::track(
            &mut data,
            self.films,
            self.manifest,
            self.model,
            &self.params,
        );
        let data = Arc::new(data);
        let split = split(&data);
        if split.fit.is_empty() {
            return Err(WholeError::Nothing);
        }
        let withhold = &self.settings.withhold;
        let mut conventions = conventions::find(&data);
        let mut direct = direct::read(&data, &mut conventions, withhold);
        let body = body::Tier::new(&data, self.model, &self.params, &split.fit)
            .map(|tier| body::diagnose(&data, tier, withhold));
        // Where readings stand in another order too, all that follows looks at each joint's own.
        let order = body.as_ref().map(|b| b.tier.order);
        let moved = order.filter(|o| o.iter().enumerate().any(|(k, from)| k != *from));
        let data = match moved {
            Some(order) => Arc::new(data.reordered(&order)),
            None => data,
        };
        if moved.is_some() {
            conventions = conventions::find(&data);
            direct = direct::read(&data, &mut conventions, withhold);
        }
        Ok(Seen {
            data,
            split,
            conventions,
            direct,
            body,
            moved: moved.is_some(),
        })
    }

    /// Joint `k` under these loads.
    fn tier(&self, seen: &Seen, k: usize, loads: &[[Load; JOINTS]]) -> Option<Tier> {
        let fit = &seen.split.fit;
        Tier::new(&seen.data, self.model, k, fit, &seen.conventions, loads)
    }

    /// Loads on the joints, from the body as it was found to be; the friction of its ground as motion and torques together have it.
    pub(super) fn loads(&self, seen: &mut Seen) -> Loads {
        let windows = windows::cut(&seen.data, 1.0, 0.9);
        let mut agreed = None;
        if let Some(mut body) = seen.body.take() {
            if body.changes.is_none() {
                let coarse = [seen.data.filmed(), seen.conventions.skewed()];
                let (ratio, read) = friction::settle(&mut body, self.model, coarse, |with| {
                    let loads = loads::replay(&seen.data, &windows, with);
                    (0..JOINTS)
                        .filter_map(|k| self.tier(seen, k, &loads))
                        .filter_map(|tier| joints::moments(&tier, self.model, &seen.conventions))
                        .collect()
                });
                agreed = ratio;
                let alone = read.is_none() && coarse == [false; 2];
                let bounce = alone.then(|| bounce::settle(&mut body, &seen.data));
                seen.direct.extend(read.into_iter().chain(bounce.flatten()));
            }
            seen.body = Some(body);
        }
        let (params, links) = match &seen.body {
            Some(b) => {
                let theta = &b.answer.last().theta;
                (Arc::new(b.tier.params(theta)), b.tier.links(theta))
            }
            None => (Arc::clone(&self.params), Default::default()),
        };
        let by_run = loads::weighed(&seen.data, &windows, (&params, &links));
        Loads {
            windows,
            agreed,
            by_run,
        }
    }

    /// Every joint alone.
    pub(super) fn joints(&self, seen: &Seen, loads: &Loads) -> Vec<Found> {
        let mut tiers: Vec<Tier> = (0..JOINTS)
            .filter_map(|k| self.tier(seen, k, &loads.by_run))
            .collect();
        joints::calibrate(&mut tiers, self.model, &seen.conventions);
        let withhold = &self.settings.withhold;
        let around = Around {
            mixed: seen.mixed(),
            loose: seen.holds(|c| c.effect.stage() == Stage::Transmission),
        };
        let mut found: Vec<Found> = tiers
            .into_par_iter()
            .map(|tier| joints::diagnose(tier, self.model, &seen.conventions, withhold, around))
            .collect();
        last_word::drop_lone_clocks(&mut found);
        last_word::mark(&mut found, seen.body.is_some());
        found
    }

    /// What the loads of all joints say together joins what was read off; returned is what would explain them as well.
    pub(super) fn together(
        &self,
        seen: &mut Seen,
        joints: &[Found],
        loads: &mut Loads,
    ) -> Option<direct::Reading> {
        let replay = Replay {
            data: &seen.data,
            model: self.model,
            fit_runs: &seen.split.fit,
            conventions: &seen.conventions,
            joints,
            mixed: seen.mixed(),
        };
        // A replay with a friction that was found is too rough for torques to show a mass besides.
        let spoils = |c: &Candidate| match c.effect {
            // Two robots with a soft connector alone showed masses of 1.13 and 1.37.
            Effect::ConnectorCompliance | Effect::ConnectorPlay => true,
            effect => effect.stage() == Stage::Body && !REPLAYED.contains(&effect),
        };
        // So is one with a ground or a zero that changes along the runs: two such robots showed masses of 0.82 and 0.85.
        let changes = seen.body.as_ref().is_some_and(|b| b.changes.is_some());
        let other = seen.holds(spoils) || seen.reads(Effect::GroundFriction) || changes;
        let mass = replay.mass().filter(|_| !other);
        // On the friction that fits best, named or not, too.
        let mass = mass.filter(|m| {
            let (Some(b), Some(friction)) = (&seen.body, loads.agreed) else {
                return true;
            };
            let there = replay.ratio(b, &mut loads.windows.clone(), friction);
            (there - 1.0) / (m.estimate.value - 1.0) > STAYS
        });
        let rough = seen.data.filmed();
        let slips = seen.reads(Effect::GroundFriction)
            || seen.holds(|c| c.effect == Effect::GroundFriction);
        let mut body = seen.body.take();
        let mut slips = slips;
        if let Some(b) = body.as_mut().filter(|_| slips && !rough) {
            let again = friction::again(b, self.model, seen.conventions.skewed(), |with| {
                replay.moments(&mut loads.windows.clone(), with)
            });
            let own = |r: &direct::Reading| r.effect == Effect::GroundFriction;
            let read = seen.direct.iter().position(own);
            match (read, again) {
                (Some(at), Some(value)) => seen.direct[at].estimate = value,
                // It was the joints' own friction.
                (Some(at), None) => {
                    seen.direct.remove(at);
                    b.take_back(body::B::Friction);
                    slips = false;
                }
                (None, _) => {}
            }
        }
        if let Some(b) = &mut body {
            let blunted = |r: &direct::Reading| bounce::blunted(b, r, joints);
            if let Some(at) = seen.direct.iter().position(blunted) {
                seen.direct.remove(at);
                b.take_back(body::B::Bounce);
            }
            b.weigh_rest(rough);
            if !slips && mass.is_none() {
                b.look_again();
            }
        }
        seen.body = body;
        let found = seen.body.as_ref();
        let named = match &mass {
            Some(_) => Some(Effect::Mass),
            None => slips.then_some(Effect::GroundFriction),
        };
        let instead = named
            .zip(found)
            .filter(|_| rough)
            .and_then(|(effect, body)| replay.instead(effect, body, &mut loads.windows));
        seen.direct.extend(mass);
        instead
    }

    /// The runs that are scored, as they were found to be.
    pub(super) fn score(
        &self,
        seen: &Seen,
        joints: &[Found],
        loads: &Loads,
        filmed: bool,
    ) -> Score {
        let runs = &seen.split.score;
        let mut scored = body::Tier::new(&seen.data, self.model, &self.params, runs);
        if let (Some(s), Some(b)) = (&mut scored, &seen.body) {
            s.adopt(&b.tier);
            if seen.moved {
                s.order = std::array::from_fn(|k| k);
            }
            s.measure(&seen.data, &b.answer.last().theta);
        }
        let scored = scored.filter(|_| seen.body.is_some());
        let mut score = Score::new(
            &seen.data,
            joints,
            scored,
            runs,
            &seen.conventions,
            &loads.by_run,
        );
        let found = seen.body.as_ref().map(|b| (b.tier.maps, b.tier.order));
        score.recorded = score.body.clone().zip(found).and_then(as_recorded);
        score.camera = camera::Tier::new(&seen.data, self.manifest, self.model, self.films, runs)
            .filter(|_| filmed);
        score
    }
}

/// The scored runs of a body whose joints were `found` to read in another order or sense, as they were recorded; `None` where they read as they should.
fn as_recorded(
    (mut scored, (maps, order)): (body::Tier, ([LinkMap; JOINTS], [usize; JOINTS])),
) -> Option<body::Tier> {
    let right = std::array::from_fn(|k| k);
    // The scored data stand in the order found.
    order
        .iter()
        .enumerate()
        .for_each(|(k, from)| scored.order[*from] = k);
    scored.maps = [LinkMap::default(); JOINTS];
    (order != right || maps != scored.maps).then_some(scored)
}
