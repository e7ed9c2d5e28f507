//! What was found, under the shared names: effects with joints, parameters and rivals.

use std::collections::BTreeMap;

use super::Parts;
use super::answer::permutation;
use super::body::{self, B};
use super::body_library;
use super::camera::C;
use super::clock::ONE_CLOCK;
use super::intervals::{REPLAYED, estimates, held_otherwise, played, sensed};
use super::nominal::Nominal;
use super::search::Answer;
use super::servo::J;
use super::steady::Change;
use crate::math;
use crate::verdict::{Estimate, Law};
use crate::vocabulary::{Effect, Stage};

/// Where an item lives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Place {
    /// Joint (by position in the list of joints found) and member of its last step.
    Joint(usize, usize),
    /// Member of the body's last step.
    Body(usize),
    /// Member of the camera's last step.
    Camera(usize),
    /// Order or sign, found before the fits.
    Convention,
    /// Read off the signals without a simulation.
    Direct,
    /// A number of the body, told beside its search.
    Told(B),
}

/// A rival.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rival {
    pub(super) effect: Effect,
    pub(super) joint: Option<usize>,
    /// Standard deviations by which it explains less.
    pub(super) margin: f64,
}

/// Distance of a ratio from minus one up to which it is that: a scale is known to half a per cent.
const MIRRORED: f64 = 0.01;

/// An effect found.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Item {
    pub(super) effect: Effect,
    pub(super) joint: Option<usize>,
    pub(super) parameters: BTreeMap<String, Estimate>,
    /// Cost that the model loses without it, squared tolerances per sample.
    pub(super) gain: f64,
    /// Its evidence over the threshold that it had to pass.
    pub(super) strength: f64,
    pub(super) rivals: Vec<Rival>,
    pub(super) place: Place,
    pub(super) plausible: bool,
}

impl Item {
    /// Weight against its rivals.
    pub(super) fn certainty(&self) -> f64 {
        let rest: f64 = self
            .rivals
            .iter()
            .map(|r| libm::exp(-0.5 * r.margin * r.margin))
            .sum();
        1.0 / (1.0 + rest)
    }

    /// Whether it acts outside the models that are fitted.
    pub(super) const fn outside(&self) -> bool {
        matches!(self.place, Place::Convention | Place::Direct)
    }
}

/// Takes what was found before the fits, and stands in the `nominal` coordinates, out of `theta`.
pub(super) fn unsigned(theta: &mut [f64], nominal: &[f64]) {
    for i in [J::Scale as usize, J::PerAmpere as usize] {
        theta[i] /= nominal[i];
    }
}

/// A number of an effect from coordinates.
pub(super) type Convert<'a> = Box<dyn Fn(&[f64]) -> f64 + 'a>;

fn joint_parameters<'a>(
    effect: Effect,
    free: &[usize],
    n: &'a Nominal,
) -> Vec<(&'static str, Convert<'a>)> {
    let get = |j: J| -> Convert<'a> { Box::new(move |t: &[f64]| t[j as usize]) };
    let slew = free.contains(&(J::Slew as usize));
    let hard = free.contains(&(J::DeadHard as usize));
    match effect {
        Effect::JointScale => vec![("ratio", get(J::Scale))],
        Effect::JointOffset => vec![("offset_rad", get(J::Offset))],
        Effect::Latency => vec![("delay_s", get(J::Delay))],
        Effect::ClockSkew => vec![("ratio", get(J::Skew))],
        Effect::Quantisation => vec![("step_rad", get(J::Quantum))],
        Effect::LoopGain => vec![("ratio", get(J::Gain))],
        Effect::Deadband => vec![(
            "half_width_rad",
            get(if hard { J::DeadHard } else { J::DeadSoft }),
        )],
        Effect::VelocityLimit if slew => vec![("limit_rad_s", get(J::Slew))],
        Effect::VelocityLimit => {
            vec![(
                "limit_rad_s",
                Box::new(|t: &[f64]| t[J::MaxSpeed as usize] * n.max_speed_rad_s),
            )]
        }
        Effect::FeedbackDelay => vec![("delay_s", get(J::FeedbackDelay))],
        Effect::MotorLag => vec![("time_constant_s", get(J::Lag))],
        Effect::TorqueLimit => {
            vec![(
                "limit_nm",
                Box::new(|t: &[f64]| t[J::MaxTorque as usize] * n.max_torque_nm),
            )]
        }
        Effect::CurrentLimit => vec![(
            "limit_a",
            Box::new(|t: &[f64]| {
                t[J::MaxTorque as usize] * n.max_torque_nm / (n.nm_per_a * t[J::PerAmpere as usize])
            }),
        )],
        Effect::ThermalDerating => vec![
            ("time_constant_s", get(J::DerateTime)),
            ("fraction", get(J::DerateShare)),
        ],
        Effect::Backlash => vec![("half_width_rad", get(J::Play))],
        Effect::Compliance => vec![(
            "stiffness_nm_rad",
            Box::new(|t: &[f64]| 1.0 / t[J::Flex as usize].max(1e-9)),
        )],
        _ => friction_parameters(effect, n),
    }
}

/// What torque along the motion takes.
fn friction_parameters<'a>(effect: Effect, n: &'a Nominal) -> Vec<(&'static str, Convert<'a>)> {
    let get = |j: J| -> Convert<'a> { Box::new(move |t: &[f64]| t[j as usize]) };
    match effect {
        Effect::CoulombFriction => vec![("torque_nm", get(J::Coulomb))],
        Effect::ViscousFriction => vec![("nm_s_rad", get(J::Viscous))],
        Effect::StribeckFriction => vec![
            ("static_nm", get(J::Static)),
            ("velocity_rad_s", get(J::StribeckSpeed)),
        ],
        Effect::DampingGain => vec![(
            "ratio",
            Box::new(|t: &[f64]| t[J::Viscous as usize] / n.damping_nm_s_rad.max(1e-6)),
        )],
        Effect::GravityLoad => vec![("ratio", Box::new(|t: &[f64]| 1.0 + t[J::Gravity as usize]))],
        Effect::LoadDependentFriction => vec![("fraction", get(J::LoadShare))],
        Effect::AsymmetricFriction => {
            vec![
                ("difference_nm", get(J::Asymmetry)),
                ("difference_nm_s_rad", get(J::AsymmetryViscous)),
            ]
        }
        Effect::QuadraticFriction => vec![("nm_s2_rad2", get(J::Quadratic))],
        Effect::TorqueRipple => vec![
            (
                "amplitude_nm",
                Box::new(|t: &[f64]| {
                    libm::hypot(t[J::RippleSin as usize], t[J::RippleCos as usize])
                }),
            ),
            (
                "periods",
                Box::new(|t: &[f64]| t[J::RipplePeriods as usize].round()),
            ),
            (
                "phase_rad",
                Box::new(|t: &[f64]| {
                    libm::atan2(t[J::RippleCos as usize], t[J::RippleSin as usize])
                }),
            ),
        ],
        _ => Vec::new(),
    }
}

pub(super) fn body_parameters(
    effect: Effect,
    joint: Option<usize>,
    mu: f64,
) -> Vec<(&'static str, Convert<'static>)> {
    let get = |b: B| -> Convert<'static> { Box::new(move |t: &[f64]| t[b as usize]) };
    let inverse =
        |i: usize| -> Convert<'static> { Box::new(move |t: &[f64]| 1.0 / t[i].max(1e-9)) };
    let k = joint.unwrap_or(0);
    let plain =
        |what: usize| -> Convert<'static> { Box::new(move |t: &[f64]| t[body::of_joint(k, what)]) };
    // The body shows how a reading hangs on the link; told is how the link hangs on reading and set-point, as everywhere.
    let opposite = |what: usize| -> Convert<'static> {
        Box::new(move |t: &[f64]| -t[body::of_joint(k, what)])
    };
    match effect {
        Effect::GroundFriction => vec![(
            "coefficient",
            Box::new(move |t: &[f64]| mu * t[B::Friction as usize]),
        )],
        Effect::Restitution => vec![("coefficient", get(B::Bounce))],
        Effect::FrictionAnisotropy => vec![
            (
                "ratio",
                Box::new(|t: &[f64]| body::anisotropy(t).map_or(1.0, |a| a.0)),
            ),
            (
                "direction_rad",
                Box::new(|t: &[f64]| body::anisotropy(t).map_or(0.0, |a| a.1)),
            ),
        ],
        Effect::TorsionalFriction => vec![("coefficient_m", get(B::Torsion))],
        Effect::GroundSlope => vec![("roll_rad", get(B::Roll)), ("pitch_rad", get(B::Pitch))],
        Effect::GroundCompliance => {
            vec![
                ("stiffness_n_m", inverse(B::GroundGive as usize)),
                ("damping_n_s_m", get(B::GroundDamping)),
            ]
        }
        Effect::ComOffset => vec![
            ("x_m", get(B::ComX)),
            ("y_m", get(B::ComY)),
            ("z_m", get(B::ComZ)),
        ],
        Effect::ConnectorCompliance => {
            vec![("stiffness_nm_rad", inverse(B::ConnectorGive as usize))]
        }
        Effect::ConnectorPlay => vec![("half_width_rad", get(B::ConnectorPlay))],
        Effect::JointOffset => vec![("offset_rad", opposite(body::OFFSET))],
        Effect::JointScale => vec![("ratio", inverse(body::of_joint(k, body::RATIO)))],
        Effect::Backlash => vec![("half_width_rad", plain(body::PLAY))],
        Effect::Compliance => vec![("stiffness_nm_rad", inverse(body::of_joint(k, body::FLEX)))],
        _ => Vec::new(),
    }
}

fn camera_parameters(effect: Effect) -> Vec<(&'static str, Convert<'static>)> {
    let get = |c: C| -> Convert<'static> { Box::new(move |t: &[f64]| t[c as usize]) };
    match effect {
        Effect::CameraHeight => vec![("value_m", get(C::Height))],
        Effect::CameraOffset => vec![("x_m", get(C::X)), ("y_m", get(C::Y))],
        Effect::CameraYaw => vec![("angle_rad", get(C::Yaw))],
        Effect::CameraTimeShift => vec![("shift_s", get(C::Shift))],
        _ => Vec::new(),
    }
}

/// Standard deviations that a rival is worse: likelihood ratio of two fits to errors of unknown size.
fn margin(ratio: f64, independent: f64) -> f64 {
    (independent * libm::log(ratio.max(1.0))).sqrt()
}

fn members(
    a: &Answer,
    place: impl Fn(usize) -> Place,
    convert: impl Fn(&super::search::Candidate) -> BTreeMap<String, Estimate>,
) -> Vec<Item> {
    let last = a.last();
    let one = |(m, c): (usize, &usize)| {
        let candidate = &a.candidates[*c];
        let mut rivals: Vec<Rival> = Vec::new();
        for r in &a.rivals[m] {
            let x = &a.candidates[r.candidate];
            if rivals
                .iter()
                .all(|k| (k.effect, k.joint) != (x.effect, x.joint))
            {
                rivals.push(Rival {
                    effect: x.effect,
                    joint: x.joint,
                    margin: margin(r.ratio, a.limits.independent),
                });
            }
        }
        Item {
            effect: candidate.effect,
            joint: candidate.joint,
            parameters: convert(candidate),
            gain: a.removed_alone[m].0.cost - last.cost,
            strength: a.strengths[m],
            rivals,
            place: place(m),
            plausible: true,
        }
    };
    last.members.iter().enumerate().map(one).collect()
}

/// What explains the loads of all joints as well. A film is too coarse to show whether friction or mass made them larger (emulated
/// robots: the windows' cost with the one over that with the other is 1.00 to 1.04 whichever is true).
fn twin(d: &Parts, effect: Effect) -> Option<Rival> {
    let other = match effect {
        Effect::Mass => Effect::GroundFriction,
        Effect::GroundFriction => Effect::Mass,
        _ => return None,
    };
    d.data.filmed().then_some(Rival {
        effect: other,
        joint: None,
        margin: 0.0,
    })
}

/// A joint scale of minus one is a sign: of a joint that hardly moves within a run no slope tells, but the places where it stands do.
fn mirrored(mut item: Item) -> Item {
    let ratio = item.parameters.get("ratio").map(|p| p.value);
    if item.effect == Effect::JointScale && ratio.is_some_and(|r| (r + 1.0).abs() < MIRRORED) {
        item.effect = Effect::JointSign;
        item.parameters = BTreeMap::from([("sign".to_string(), fixed(-1.0))]);
    }
    item
}

/// One clock drives all joints: what several joints say of it is one finding, with the median of their values.
fn one_clock(mut items: Vec<Item>) -> Vec<Item> {
    let is_clock = |i: &&Item| i.effect == Effect::ClockSkew && i.joint.is_some();
    let clocks: Vec<&Item> = items.iter().filter(is_clock).collect();
    if clocks.len() < ONE_CLOCK {
        return items;
    }
    let gain = clocks.iter().map(|i| i.gain).sum();
    let values = clocks
        .iter()
        .filter_map(|i| i.parameters.get("ratio").map(|p| p.value));
    let middle = math::median(&values.collect::<Vec<_>>());
    let mut kept = false;
    items.retain_mut(|i| {
        if !is_clock(&&*i) {
            return true;
        }
        if let Some(p) = i.parameters.get_mut("ratio") {
            let shift = middle - p.value;
            p.value = middle;
            p.ci95.iter_mut().for_each(|x| *x += shift);
        }
        (i.joint, i.gain) = (None, gain);
        !std::mem::replace(&mut kept, true)
    });
    items
}

/// Everything found that may be named.
pub(super) fn items(d: &Parts) -> Vec<Item> {
    let mut out = all(d);
    out.retain(|i| !d.withhold.contains(&i.effect));
    out
}

/// What the signals show and nothing that may be named explains.
pub(super) fn nameless(d: &Parts) -> Vec<Item> {
    let mut out = all(d);
    out.retain(|i| d.withhold.contains(&i.effect));
    out
}

/// Where a reading of `effect` lives.
fn told(d: &Parts, effect: Effect) -> Place {
    match effect {
        Effect::GroundFriction if d.body.is_some() => Place::Told(B::Friction),
        Effect::Restitution if d.body.is_some() => Place::Told(B::Bounce),
        _ => Place::Direct,
    }
}

fn all(d: &Parts) -> Vec<Item> {
    let mut out = conventions(d);
    out.extend(d.direct.iter().map(|r| Item {
        effect: r.effect,
        joint: r.joint,
        parameters: BTreeMap::from([(r.key.to_string(), r.estimate.clone())]),
        gain: r.gain,
        strength: r.strength(),
        rivals: twin(d, r.effect).into_iter().collect(),
        place: told(d, r.effect),
        plausible: true,
    }));
    for (at, f) in d.joints.iter().enumerate() {
        let last = f.answer.last();
        out.extend(members(
            &f.answer,
            |m| Place::Joint(at, m),
            |c| {
                let parameters = joint_parameters(c.effect, &c.free, &f.tier.nominal);
                let own = estimates(&parameters, &c.free, last);
                if c.effect.stage() == Stage::Drivetrain && d.body.is_some() {
                    sensed(own, REPLAYED)
                } else {
                    own
                }
            },
        ));
    }
    if let Some(b) = &d.body {
        let last = b.answer.last();
        let sloped = b.tier.slope.is_some();
        let apart_m = body_library::apart_m(&b.tier.model);
        out.extend(members(&b.answer, Place::Body, |c| {
            let parameters = body_parameters(c.effect, c.joint, d.friction);
            let own = estimates(&parameters, &c.free, last);
            played(c.effect, own, (sloped, apart_m))
        }));
    }
    if let Some(c) = &d.camera {
        let last = c.answer.last();
        out.extend(members(&c.answer, Place::Camera, |x| {
            estimates(&camera_parameters(x.effect), &x.free, last)
        }));
        out.extend(c.tier.drops().map(frame_drop));
    }
    let held = d.body.as_ref().map(|b| b.contacts.law);
    if held.is_some_and(|law| law != Law::Nominal) {
        let widen = |i: &mut Item| held_otherwise(i.effect, &mut i.parameters);
        out.iter_mut().for_each(widen);
    }
    // What changes during a run is none of the library's.
    match d.body.as_ref().and_then(|b| b.changes) {
        Some(Change::Friction) => out.retain(|i| i.effect != Effect::GroundFriction),
        Some(Change::Zero(k)) => {
            out.retain(|i| (i.effect, i.joint) != (Effect::JointOffset, Some(k)));
        }
        None => {}
    }
    // What body and joint both show of a joint is one row, the body's: there it came out first.
    let on_body: Vec<(Effect, Option<usize>)> = out
        .iter()
        .filter(|i| matches!(i.place, Place::Body(_)))
        .map(|i| (i.effect, i.joint))
        .collect();
    out.retain(|i| !matches!(i.place, Place::Joint(..)) || !on_body.contains(&(i.effect, i.joint)));
    one_clock(out.into_iter().map(mirrored).collect())
}

/// Frames that are missing with probability `p`, and its standard deviation.
fn frame_drop((p, deviation): (f64, f64)) -> Item {
    let half = 1.96 * deviation;
    let estimate = Estimate {
        value: p,
        ci95: [p - half, p + half],
    };
    Item {
        parameters: BTreeMap::from([("probability".to_string(), estimate)]),
        gain: (p / deviation.max(1e-6)).powi(2).min(1e3),
        strength: p / deviation.max(1e-6) / 3.0,
        place: Place::Direct,
        ..convention(Effect::FrameDrop, None, "probability", p)
    }
}

/// A number without error.
const fn fixed(value: f64) -> Estimate {
    Estimate {
        value,
        ci95: [value, value],
    }
}

fn convention(effect: Effect, joint: Option<usize>, key: &str, value: f64) -> Item {
    Item {
        effect,
        joint,
        parameters: BTreeMap::from([(key.to_string(), fixed(value))]),
        // Far above anything that a fit gains; a wrong order outweighs all.
        gain: 1e4,
        strength: 100.0,
        rivals: Vec::new(),
        place: Place::Convention,
        plausible: true,
    }
}

/// Orders and signs, of the command and of the recording.
fn conventions(d: &Parts) -> Vec<Item> {
    let mut out = Vec::new();
    let identity: [usize; 6] = std::array::from_fn(|k| k);
    let body = d.body.as_ref();
    let orders = [Some(d.conventions.order), body.map(|b| b.tier.order)];
    for order in orders.into_iter().flatten().filter(|o| *o != identity) {
        out.push(convention(
            Effect::JointOrder,
            None,
            "permutation",
            permutation(&order),
        ));
    }
    for k in 0..6 {
        let command = d.conventions.slope[k].is_some_and(|s| s < 0.0);
        let recording = body.is_some_and(|b| b.tier.maps[k].ratio < 0.0);
        if command || recording {
            out.push(convention(Effect::JointSign, Some(k), "sign", -1.0));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::{Item, Place, fixed, mirrored};
    use crate::vocabulary::Effect;

    #[test]
    fn a_scale_of_minus_one_is_a_sign() {
        let effects = [
            (-1.004, Effect::JointSign),
            (-0.96, Effect::JointScale),
            (1.0, Effect::JointScale),
        ];
        for (ratio, effect) in effects {
            let item = mirrored(Item {
                effect: Effect::JointScale,
                joint: Some(4),
                parameters: BTreeMap::from([("ratio".to_string(), fixed(ratio))]),
                gain: 1.0,
                strength: 1.0,
                rivals: Vec::new(),
                place: Place::Body(0),
                plausible: true,
            });
            assert_eq!((item.effect, item.joint), (effect, Some(4)), "{ratio}");
            let signed = item.parameters.get("sign").map(|s| s.value);
            let expected = (effect == Effect::JointSign).then_some(-1.0);
            assert_eq!(signed, expected, "{ratio}");
        }
    }
}
