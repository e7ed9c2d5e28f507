//! What to play next on the robot where the body holds what is open: the gait in which the explanations left over predict what differs most.
//!
//! Every gait of a menu is played by every explanation, from home, several times with the model's numbers drawn from their tolerances. A
//! robot that rests on an edge falls to either side, and a gait that hangs on it promises nothing. What the explanations predict
//! differently, over what the draws scatter by, ranks the gaits. The gaits on record are played alike, to say what the new one adds.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;
use std::ops::Range;
use std::sync::Arc;

use control::gait::Gait;
use files::model::{Key, Model};
use physics::{Drive, Options, Outcome, Params, Start, Trial};

use super::data::{Data, JOINTS};
use super::{gaits, predict, windows};
use crate::math::{self, Rng};
use crate::verdict::Estimate;
use crate::vocabulary::Effect;

/// Between instants at which places are compared, s.
const INSTANT_S: f64 = 2.5;
/// Samples per second of a play.
const RATE_HZ: f64 = 20.0;
/// What repeats differ by: ground friction, relative, and every joint's home, rad. Chosen; robots of `trials` differ by as much.
const FRICTION_SPREAD: f64 = 0.02;
const HOME_RAD: f64 = 1e-3;
/// Least relative error of an effect of the body: they came out up to 15 % off on emulated robots, taken as two standard deviations.
const VALUE_SHARE: f64 = 0.07;
/// Error of a tracked place, m, and of any simulated one as a share of its way: what two honest engines differ by
/// (`docs/validation/README.md`).
const PLACE_M: f64 = 2e-3;
const WAY_SHARE: f64 = 0.03;
/// Relative error of a simulated torque: loads replayed for emulated robots without a cause are off by up to 15 %, taken as two
/// standard deviations.
const TORQUE_SHARE: f64 = 0.07;
/// Draws of the tolerances on the whole menu, of the gaits that come out best there, and fresh ones of the best: what is promised must not
/// come from the draws that it was chosen by.
const DRAWS: [Range<u64>; 3] = [0..4, 4..28, 28..60];
const SHORTLIST: usize = 8;
/// Standard deviations below which an experiment does not decide by itself.
const CLEAR: f64 = 2.0;
/// Headings that are tried where the ground has a direction: 0, 90 and 180 degrees.
const HEADINGS: usize = 3;
/// Length of a gait, s, where the runs on record are shorter or longer: three periods at 0.2 Hz need 15.
const LENGTH_S: [f64; 2] = [10.0, 30.0];

/// One of several explanations.
#[derive(Debug, Clone)]
pub(super) struct Explanation {
    pub(super) effect: Effect,
    pub(super) parameters: BTreeMap<String, Estimate>,
    pub(super) model: Model,
}

/// What is open.
#[derive(Debug, Clone)]
pub(super) enum Open {
    /// Explanations that the data cannot tell apart.
    Class(Vec<Explanation>),
    /// A remainder that nothing explains.
    Remainder {
        /// Gait whose windows leave most.
        gait: usize,
        /// What they leave, squared tolerances per sample.
        cost: f64,
    },
}

/// What is looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Quantity {
    /// How far the base has come, m along x and y of the robot as it lies at home, at this time.
    Place {
        /// Time from the start of the gait, s.
        at_s: f64,
    },
    /// Root mean square torque of a joint over the run, N m.
    Torque {
        /// The joint.
        joint: usize,
    },
}

/// What to look at, and what is expected there.
#[derive(Debug, Clone, PartialEq)]
pub struct Look {
    /// What is looked at.
    pub quantity: Quantity,
    /// What each explanation predicts; a torque has one number, a place two.
    pub predicted: Vec<(Effect, Vec<f64>)>,
    /// Difference of the closest pair of explanations, in the unit of the quantity.
    pub apart: f64,
    /// One standard deviation of that difference: the model's tolerances, the simulator's and the measurement's errors.
    pub scatter: f64,
    /// The same difference over its standard deviation in the best gait on record.
    pub recorded: f64,
}

impl Look {
    /// Standard deviations that the closest pair of explanations is apart.
    #[must_use]
    pub fn separation(&self) -> f64 {
        self.apart / self.scatter.max(1e-12)
    }
}

/// A gait to play next.
#[derive(Debug, Clone, PartialEq)]
pub struct Experiment {
    /// The gait.
    pub gait: Gait,
    /// Heading of the robot at the start, rad from the tracker's x axis; `None` where it does not matter.
    pub heading_rad: Option<f64>,
    /// What to look at; `None` where nothing is to be told apart.
    pub look: Option<Look>,
    /// What to do, in words.
    pub text: String,
}

/// What is open and how it can be seen.
pub(super) struct Question {
    open: Open,
    data: Arc<Data>,
    meters: Meters,
}

/// A gait from a start heading.
#[derive(Debug, Clone)]
struct Item {
    gait: Gait,
    /// Heading, in quarters of a turn.
    quarter: usize,
}

/// What a play shows: places at the instants, m, and torques of the joints, N m, root mean square.
#[derive(Debug, Clone, Default)]
struct Played {
    place_m: Vec<[f64; 2]>,
    torque_nm: [f64; JOINTS],
    touched: bool,
}

/// What can be measured: error of a place, m, and of the torque of joints with effort or current, N m.
#[derive(Debug, Clone)]
struct Meters {
    place_m: Option<f64>,
    torque_nm: Vec<(usize, f64)>,
}

impl Meters {
    /// Of a data set where torques are known to `torque_nm`, joint by joint.
    fn new(data: &Data, torque_nm: Vec<(usize, f64)>) -> Self {
        let bases = data.runs.iter().filter_map(|r| r.base.as_ref());
        let error = |b: &super::data::BaseTrack| match b.filmed {
            Some([x, y, ..]) => libm::hypot(x, y),
            None => PLACE_M,
        };
        Self {
            place_m: bases.map(error).max_by(f64::total_cmp),
            torque_nm,
        }
    }
}

fn played(o: &Outcome) -> Played {
    let start = o.poses.first().map_or([0.0; 3], |p| p.position_m);
    let step = (INSTANT_S * RATE_HZ) as usize;
    let place = |p: &physics::Pose| [0, 1].map(|k| f64::from(p.position_m[k] - start[k]));
    let torque = |k: usize| {
        let own = o.torques_nm.iter().skip(k).step_by(JOINTS);
        math::rms(&own.map(|x| f64::from(*x)).collect::<Vec<_>>())
    };
    Played {
        place_m: o.poses.iter().step_by(step).skip(1).map(place).collect(),
        torque_nm: std::array::from_fn(torque),
        touched: o.collided_at_s.is_some() || o.not_finite.is_some(),
    }
}

/// `model` as it may be: every number of Table II off by its tolerance, what repeats differ by besides, and the ground turned for a robot
/// that starts at `heading_rad`. Draw `draw` is the same for all explanations: what is left between them is their own.
fn disturbed(model: &Model, draw: u64, heading_rad: f64) -> Option<Params> {
    let mut rng = Rng::new(draw);
    let mut model = model.clone();
    for key in Key::TABLE_II {
        let info = key.info();
        let value = model.value(key) + model.parameter(key).tolerance * rng.normal();
        model.set(key, value.clamp(info.min, info.max)).ok()?;
    }
    for mut entry in model.effects().to_vec() {
        let info = entry.effect.info();
        let body = info.stage == files::model::Stage::Body;
        for (p, range) in entry.parameters.iter_mut().zip(info.parameters) {
            let least = if body {
                VALUE_SHARE * p.value.abs()
            } else {
                0.0
            };
            let off = p.tolerance.max(least) * rng.normal();
            p.value = (p.value + off).clamp(range.min, range.max);
        }
        model.set_effect_entry(entry).ok()?;
    }
    let mut out = Params::try_from(&model).ok()?;
    out.friction *= 1.0 + FRICTION_SPREAD * rng.normal();
    for joint in &mut out.joints {
        joint.command_offset_rad += HOME_RAD * rng.normal();
    }
    let (sin, cos) = libm::sincos(heading_rad);
    let [x, y, z] = out.gravity_m_s2;
    out.gravity_m_s2 = [cos * x + sin * y, cos * y - sin * x, z];
    out.anisotropy_direction_rad -= heading_rad;
    Some(out)
}

/// What each explanation may be: by explanation, then by draw.
type Worlds = Vec<Vec<Arc<Params>>>;

fn worlds(among: &[Explanation], draws: &Range<u64>, heading_rad: f64) -> Option<Worlds> {
    let of = |e: &Explanation| {
        let one = |draw| disturbed(&e.model, draw, heading_rad).map(Arc::new);
        draws.clone().map(one).collect()
    };
    among.iter().map(of).collect()
}

/// Whether the ground has a direction.
fn directed(e: &Explanation) -> bool {
    let tilted = |g: [f64; 3]| g[0] != 0.0 || g[1] != 0.0;
    Params::try_from(&e.model).is_ok_and(|p| tilted(p.gravity_m_s2) || p.anisotropy_ratio != 1.0)
}

fn options() -> Options {
    Options {
        sample_rate_hz: RATE_HZ,
        record_motors: true,
        ..Options::default()
    }
}

/// Plays of one gait: by explanation, then by repeat.
type Plays = Vec<Vec<Played>>;

/// Cuts what `trials` show into plays: `explanations` times `repeats` trials each.
fn run(trials: &[Trial], explanations: usize, repeats: usize) -> Vec<Plays> {
    let outcomes = windows::run(trials, &options());
    let shown: Vec<Played> = outcomes.iter().map(played).collect();
    let each = |gait: &[Played]| gait.chunks(repeats).map(<[Played]>::to_vec).collect();
    shown.chunks(explanations * repeats).map(each).collect()
}

fn plays(items: &[Item], among: &[Explanation], draws: &Range<u64>) -> Option<Vec<Plays>> {
    let turned: Vec<Worlds> = (0..HEADINGS)
        .map(|h| worlds(among, draws, h as f64 * FRAC_PI_2))
        .collect::<Option<_>>()?;
    let mut trials = Vec::new();
    for item in items {
        let gait = Arc::new(item.gait.clone());
        for worlds in &turned[item.quarter] {
            trials.extend(
                worlds
                    .iter()
                    .zip(draws.clone())
                    .map(|(params, seed)| Trial {
                        params: Arc::clone(params),
                        start: Start::Home,
                        drive: Drive::Gait {
                            gait: Arc::clone(&gait),
                            noise_rad: HOME_RAD,
                            seed,
                        },
                        duration_s: f64::from(item.gait.duration_s()),
                    }),
            );
        }
    }
    Some(run(&trials, among.len(), draws.clone().count()))
}

/// The gaits on record, one run of each.
fn recorded(data: &Data, among: &[Explanation], draws: &Range<u64>) -> Option<Vec<Plays>> {
    let worlds = worlds(among, draws, 0.0)?;
    let mut seen = Vec::new();
    let mut trials = Vec::new();
    for run in &data.runs {
        if seen.contains(&run.gait) {
            continue;
        }
        seen.push(run.gait);
        let own = worlds.iter().flatten().map(|p| predict::trial(run, p));
        if let Some(own) = own.collect::<Option<Vec<Trial>>>() {
            trials.extend(own);
        }
    }
    Some(run(&trials, among.len(), draws.clone().count()))
}

/// Mean over repeats, and variance of one repeat, of the numbers that `of` picks.
fn moments(plays: &[Played], of: &dyn Fn(&Played) -> Vec<f64>) -> (Vec<f64>, f64) {
    let all: Vec<Vec<f64>> = plays.iter().map(of).collect();
    let n = all.len().max(1) as f64;
    let width = all.iter().map(Vec::len).min().unwrap_or(0);
    let mean: Vec<f64> = (0..width)
        .map(|k| all.iter().map(|v| v[k]).sum::<f64>() / n)
        .collect();
    let off = |v: &Vec<f64>| {
        v.iter()
            .zip(&mean)
            .map(|(x, m)| (x - m).powi(2))
            .sum::<f64>()
    };
    let variance = all.iter().map(off).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, variance)
}

/// Distance and its standard deviation in one quantity between the plays `a` and `b`.
fn apart(quantity: Quantity, meters: &Meters, a: &[Played], b: &[Played]) -> [f64; 2] {
    let of = |p: &Played| numbers(quantity, p);
    let ((a, va), (b, vb)) = (moments(a, &of), moments(b, &of));
    let length = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let difference: Vec<f64> = a.iter().zip(&b).map(|(a, b)| a - b).collect();
    let size = length(&a).max(length(&b));
    let error = match quantity {
        Quantity::Place { .. } => libm::hypot(meters.place_m.unwrap_or(PLACE_M), WAY_SHARE * size),
        Quantity::Torque { joint } => {
            let of = meters.torque_nm.iter().find(|x| x.0 == joint);
            libm::hypot(of.map_or(0.0, |x| x.1), TORQUE_SHARE * size)
        }
    };
    [length(&difference), (va + vb + error * error).sqrt()]
}

fn numbers(quantity: Quantity, p: &Played) -> Vec<f64> {
    match quantity {
        Quantity::Place { at_s } => {
            let at = (at_s / INSTANT_S).round() as usize;
            p.place_m.get(at - 1).map_or(Vec::new(), |p| p.to_vec())
        }
        Quantity::Torque { joint } => vec![p.torque_nm[joint]],
    }
}

/// The closest pair of explanations in the quantity that shows it best; `None` where a robot touches itself.
fn look(
    among: &[Explanation],
    meters: &Meters,
    plays: &Plays,
    only: Option<&[Quantity]>,
) -> Option<Look> {
    if plays.iter().flatten().any(|p| p.touched) {
        return None;
    }
    let instants = plays.iter().flatten().map(|p| p.place_m.len()).min()?;
    let place = |i: usize| Quantity::Place {
        at_s: i as f64 * INSTANT_S,
    };
    let places = (1..=instants).filter(|_| meters.place_m.is_some());
    let torque = |x: &(usize, f64)| Quantity::Torque { joint: x.0 };
    let torques = meters.torque_nm.iter().map(torque);
    let all: Vec<Quantity> = places.map(place).chain(torques).collect();
    let quantities = only.unwrap_or(&all);
    let mut closest: Option<Look> = None;
    for (i, a) in plays.iter().enumerate() {
        for b in &plays[i + 1..] {
            let one = |q: &Quantity| {
                let [apart, scatter] = apart(*q, meters, a, b);
                (*q, apart, scatter)
            };
            let shown = quantities.iter().map(one);
            let clear = |x: &(Quantity, f64, f64)| x.1 / x.2.max(1e-12);
            let best = shown.max_by(|x, y| clear(x).total_cmp(&clear(y)))?;
            if closest
                .as_ref()
                .is_some_and(|c| c.separation() <= clear(&best))
            {
                continue;
            }
            let (quantity, apart, scatter) = best;
            let mean = |p: &[Played]| moments(p, &|p| numbers(quantity, p)).0;
            closest = Some(Look {
                quantity,
                predicted: among
                    .iter()
                    .zip(plays)
                    .map(|(e, p)| (e.effect, mean(p)))
                    .collect(),
                apart,
                scatter,
                recorded: 0.0,
            });
        }
    }
    closest
}

/// Everything that may be played: the gaits on record, the menu, their variations, and every joint alone.
fn items(data: &Data, menu: &[Gait], length_s: f64, directed: bool) -> Vec<Item> {
    let own = (0..data.gaits.len()).filter_map(|g| sent(data, g));
    let own: Vec<Gait> = own.collect();
    let known = |g: &&Gait| own.iter().all(|o| o.name() != g.name());
    let base: Vec<Gait> = own
        .iter()
        .chain(menu.iter().filter(known))
        .cloned()
        .collect();
    let mut out: Vec<Gait> = base
        .iter()
        .flat_map(|g| gaits::variations(g, length_s))
        .collect();
    out.extend(gaits::lifts(length_s));
    // A ground with a direction wants the robot turned instead of the gait varied.
    let headings = if directed { HEADINGS } else { 1 };
    let mut all = Vec::new();
    for gait in out {
        if directed && base.iter().all(|b| b.name() != gait.name()) {
            continue;
        }
        all.extend((0..headings).map(|quarter| Item {
            gait: gait.clone(),
            quarter,
        }));
    }
    all
}

/// The gait `gait` of the data set, read off its set-points.
fn sent(data: &Data, gait: usize) -> Option<Gait> {
    let mut runs = data.runs.iter().filter(|r| r.gait == gait);
    runs.find_map(|r| gaits::played(r, &data.gaits[gait]))
}

impl Question {
    /// What `open` leaves to be decided, of joints whose torques are known to `torque_nm`.
    pub(super) fn new(open: Open, data: &Arc<Data>, torque_nm: Vec<(usize, f64)>) -> Self {
        Self {
            open,
            data: Arc::clone(data),
            meters: Meters::new(data, torque_nm),
        }
    }

    /// Length of a gait, s: that of the runs on record.
    fn length_s(&self) -> f64 {
        let all: Vec<f64> = self.data.runs.iter().map(|r| r.length_s).collect();
        math::median(&all).round().clamp(LENGTH_S[0], LENGTH_S[1])
    }

    /// The answer: the best gait of `menu`, of those on record and of their variations that `accepts` lets pass.
    pub(super) fn experiment(
        &self,
        menu: &[Gait],
        accepts: &dyn Fn(&Gait) -> bool,
    ) -> Option<Experiment> {
        match &self.open {
            Open::Class(among) => self.separating(among, menu, accepts),
            Open::Remainder { gait, cost } => self.again(*gait, *cost, accepts),
        }
    }

    fn separating(
        &self,
        among: &[Explanation],
        menu: &[Gait],
        accepts: &dyn Fn(&Gait) -> bool,
    ) -> Option<Experiment> {
        let meters = &self.meters;
        let directed = among.iter().any(directed);
        let items = items(&self.data, menu, self.length_s(), directed);
        let [rough, fine, fresh] = &DRAWS;
        let ranked = |items: &[Item], draws: &Range<u64>| {
            let looks = plays(items, among, draws)?;
            let seen = looks.iter().map(|p| look(among, meters, p, None));
            let mut out: Vec<(Item, Look)> = items
                .iter()
                .zip(seen)
                .filter_map(|(i, l)| Some((i.clone(), l?)))
                .collect();
            out.sort_by(|a, b| b.1.separation().total_cmp(&a.1.separation()));
            Some(out)
        };
        let passed = ranked(&items, rough)?.into_iter();
        let short: Vec<Item> = passed
            .map(|x| x.0)
            .filter(|i| accepts(&i.gait))
            .take(SHORTLIST)
            .collect();
        let promised = |(item, chosen): (Item, Look)| {
            let again = plays(std::slice::from_ref(&item), among, fresh)?;
            let only = [chosen.quantity];
            Some((item, look(among, meters, &again[0], Some(&only))?))
        };
        let (item, mut look) = ranked(&short, fine)?.into_iter().find_map(promised)?;
        let before = recorded(&self.data, among, fine)?;
        let before = before
            .iter()
            .filter_map(|p| self::look(among, meters, p, None));
        look.recorded = before.map(|l| l.separation()).fold(0.0, f64::max);
        let heading_rad = directed.then_some(item.quarter as f64 * FRAC_PI_2);
        Some(Experiment {
            text: self.words(&item.gait, heading_rad, among, &look),
            gait: item.gait,
            heading_rad,
            look: Some(look),
        })
    }

    /// The gait that left most, in a way that shows what its remainder hangs on.
    fn again(&self, gait: usize, cost: f64, accepts: &dyn Fn(&Gait) -> bool) -> Option<Experiment> {
        let sent = sent(&self.data, gait)?;
        let name = &self.data.gaits[gait];
        let next = gaits::slower(&sent)?;
        accepts(&next).then(|| Experiment {
            text: format!(
                "The windows of gait {name} leave most ({cost:.0} squared tolerances per sample). Put the robot on the same ground and play the gait file three times, the same at half its frequency: what is gone then was inertia, blows or bounce, which fall with the square of the speed; what stays is how the ground holds or gives, or how the weight lies."
            ),
            gait: next,
            heading_rad: None,
            look: None,
        })
    }

    /// One paragraph on what to do and what to look at.
    fn words(
        &self,
        gait: &Gait,
        heading_rad: Option<f64>,
        among: &[Explanation],
        look: &Look,
    ) -> String {
        let turned = heading_rad.map_or_else(String::new, |h| {
            format!(
                ", the robot started at a heading of {:.0} degrees in the frame of the recordings",
                h.to_degrees()
            )
        });
        let (what, unit, scale) = self.unit(look.quantity);
        let value = |v: &Vec<f64>| {
            let v: Vec<String> = v.iter().map(|x| format!("{:.3}", x * scale)).collect();
            v.join(", ")
        };
        let one = |(e, (_, v)): (&Explanation, &(Effect, Vec<f64>))| {
            let own = e.parameters.iter();
            let own: Vec<String> = own.map(|(k, p)| format!("{k} {:.3}", p.value)).collect();
            let (name, own) = (e.effect.name(), own.join(", "));
            format!("{} {unit} if it is {name} ({own})", value(v))
        };
        let predicted: Vec<String> = among.iter().zip(&look.predicted).map(one).collect();
        let doubt = if look.separation() < CLEAR {
            " No gait of the menu decides it by itself."
        } else {
            ""
        };
        format!(
            "Put the robot on the same ground and play the gait file ({}, {:.0} s) three times{turned}. Look at {what}: {}. \
             The closest two are {:.3} {unit} apart, robots within the tolerances scatter by {:.3} {unit} ({:.1} standard deviations; {:.1} in the best gait on record).{doubt}",
            gait.name(),
            gait.duration_s(),
            predicted.join("; "),
            look.apart * scale,
            look.scatter * scale,
            look.separation(),
            look.recorded,
        )
    }

    /// Name of a quantity as it is recorded, its unit, and the factor to it.
    fn unit(&self, quantity: Quantity) -> (String, &'static str, f64) {
        match quantity {
            Quantity::Place { at_s } => (
                format!(
                    "how far the base has come {at_s} s after the start, along x and y of the robot as it lies at home"
                ),
                "m",
                1.0,
            ),
            Quantity::Torque { joint } if self.data.has(joint, |j| j.effort.is_some()) => (
                format!("the root mean square effort of joint {joint}"),
                "N m",
                1.0,
            ),
            Quantity::Torque { joint } => (
                format!("the root mean square current of joint {joint}"),
                "A",
                1.0 / self.data.motors.nm_per_a[joint][0],
            ),
        }
    }
}

#[cfg(test)]
mod tests;
