//! Parameter sets of a run as the numbers that the loop needs, worked out once.

use files::dataset::Output;

use super::simd::{Eight, LANES, Lane};
use crate::joint::data::RunData;
use crate::joint::param::{P, Params};

/// Which optional parts of the model any lane uses.
pub(super) struct Used {
    pub(super) ripple: bool,
    pub(super) stribeck: bool,
    pub(super) load: bool,
    pub(super) directional: bool,
    pub(super) sag: bool,
    pub(super) derate: bool,
    pub(super) limit: bool,
    pub(super) lag: bool,
    pub(super) feedback_delay: bool,
    pub(super) gravity: bool,
    pub(super) output_play: bool,
    /// Play or give between the rotor and the load.
    pub(super) elastic: bool,
    pub(super) give: bool,
    pub(super) droop: bool,
}

/// Parameters of a run, as absolute values.
pub(super) struct Model<F> {
    pub(super) used: Used,
    pub(super) dt: F,
    /// dt / 2.
    pub(super) half: F,
    /// dt / inertia.
    pub(super) k: F,
    /// inertia / dt.
    pub(super) per_k: F,
    pub(super) gravity: F,
    pub(super) mech: F,
    /// Effort per unit of duty and volt.
    pub(super) gv: F,
    /// Effort per speed lost to the back-EMF.
    pub(super) ge: F,
    /// Effort per ampere.
    pub(super) kt: F,
    pub(super) supply: F,
    pub(super) kp: F,
    pub(super) ki: F,
    pub(super) windup: F,
    pub(super) kd: F,
    pub(super) band: F,
    pub(super) lag: F,
    pub(super) limit: F,
    /// Effort per speed error of a velocity servo: the inertia over `droop` and the time constant of its inner loop, which is
    /// a step at least.
    pub(super) stiff: F,
    /// Ratio of what a load takes from its speed to what that time constant implies.
    pub(super) droop: F,
    /// Largest duty of a drive that is asked for a voltage.
    pub(super) duty_limit: F,
    pub(super) effort_limit: F,
    pub(super) speed_limit: F,
    pub(super) sag: F,
    pub(super) regeneration: F,
    pub(super) derate: F,
    pub(super) warming: F,
    pub(super) coulomb: F,
    /// Travel that dry friction gives before it slides.
    pub(super) give: F,
    pub(super) viscous: F,
    pub(super) asymmetry: F,
    pub(super) asymmetry_viscous: F,
    pub(super) quadratic: F,
    pub(super) stick: F,
    pub(super) stribeck_speed: F,
    pub(super) load_share: F,
    pub(super) load_of: F,
    /// Share of the inertia that sits behind the gear.
    pub(super) behind: F,
    pub(super) ripple: [F; 3],
    pub(super) play: F,
    pub(super) output_play: F,
    /// Of a gear that gives or has play, effort per angle; 0 of a rigid one.
    pub(super) stiffness: F,
    /// Inertia before the gear; dt over it, and the inertia behind it over dt.
    pub(super) rotor: F,
    pub(super) k_motor: F,
    pub(super) load_per_dt: F,
    pub(super) record_scale: F,
    pub(super) read_after: F,
    /// Steps of the controller's speed estimate; `None` where it is exact.
    pub(super) speed: Option<Late<F>>,
    /// Ticks of a controller slower than the steps: it holds its output from tick to tick.
    pub(super) ticks_per_step: Option<f64>,
    pub(super) delay: Late<F>,
}

/// Square of the angle by which the stiffest gear turns its phase in a step: the stops of play are as stiff.
const STIFFEST: f64 = 0.25;

impl<F: Lane> Model<F> {
    /// How far the load hangs from a rotor at rest at `q`; as far as play and give let it, rigid lanes not at all.
    #[inline(always)]
    pub(super) fn sags(&self, q: F) -> F {
        if !(self.used.elastic && self.used.gravity) {
            return F::zero();
        }
        let effort = self.gravity * super::laws::sin(q + self.mech);
        let gives = self.stiffness.gt(F::zero());
        let far = effort / self.stiffness + effort.sign() * self.play;
        F::select(gives, far, F::zero())
    }
}

/// How many steps back a lane looks.
pub(super) struct Late<F> {
    pub(super) whole: [usize; LANES],
    /// What is left beyond whole steps.
    pub(super) part: F,
    /// One over the time back, for one step at least.
    pub(super) per_s: F,
    /// Steps, one at most.
    pub(super) share: F,
    /// Whether all lanes have the same whole steps.
    pub(super) alike: bool,
}

impl<F: Lane> Late<F> {
    #[inline(always)]
    fn new(steps: Eight, least: f64, dt: f64) -> Self {
        let back = steps.0.map(|s| s.max(least));
        let whole = back.map(|s| s as usize);
        let each = |f: &dyn Fn(usize) -> f64| F::of(Eight(std::array::from_fn(f)));
        Self {
            part: each(&|i| back[i] - whole[i] as f64),
            per_s: each(&|i| 1.0 / (steps.0[i].max(1.0) * dt)),
            share: each(&|i| steps.0[i].min(1.0)),
            alike: whole.iter().all(|w| *w == whole[0]),
            whole,
        }
    }
}

/// A number of every parameter set. Lanes beyond the last set repeat it: idle, but harmless.
fn lanes(p: &[Params], f: impl Fn(&Params) -> f64) -> Eight {
    Eight(std::array::from_fn(|i| {
        p.get(i).or(p.last()).map_or(0.0, &f)
    }))
}

#[inline(always)]
pub(super) fn resolve<F: Lane>(run: &RunData, p: &[Params], dt: f64) -> Model<F> {
    let n = &run.nominal;
    let of = |f: &dyn Fn(&Params) -> f64| F::of(lanes(p, f));
    let get = |q: P| of(&|p| p.get(q));
    let any = |q: P| p.iter().any(|p| p.get(q) != Params::neutral(q));
    let volts = n.supply_v.max(1e-9);
    let kt = |p: &Params| n.effort_per_a * p.get(P::Motor) * p.get(P::Ampere);
    let resistance = |p: &Params| p.get(P::Resistance).max(1e-6);
    let inertia = |p: &Params| (n.inertia * p.get(P::Inertia)).max(1e-12);
    let gravity = |p: &Params| n.gravity * p.get(P::Gravity) + p.get(P::Weight);
    let effort_limit = |p: &Params| {
        (n.effort_limit * p.get(P::Strength))
            .min(p.get(P::TorqueLimit))
            .min(p.get(P::CurrentLimit) * kt(p))
    };
    let limit = |p: &Params| {
        let tightness = p.get(P::Tightness);
        if tightness > 0.0 {
            n.limit.min(1.0 / tightness)
        } else {
            n.limit
        }
    };
    let lag = |p: &Params| {
        let lag = p.get(P::Lag).max(0.0);
        if lag > 0.0 {
            1.0 - libm::exp(-dt / lag)
        } else {
            1.0
        }
    };
    let elastic = |p: &Params| p.get(P::Play) > 0.0 || p.get(P::Flexibility) > 0.0;
    // Each side has a part of the inertia.
    let behind = |p: &Params| p.get(P::Behind).clamp(0.02, 0.98);
    let stiffness = |p: &Params| {
        let reduced = inertia(p) * behind(p) * (1.0 - behind(p));
        let most = STIFFEST * reduced / (dt * dt);
        let given = 1.0 / p.get(P::Flexibility).max(1e-300);
        if elastic(p) { given.min(most) } else { 0.0 }
    };
    let delay_steps = |p: &Params| (p.get(P::FeedbackDelay) / dt).max(0.0);
    let used = Used {
        ripple: any(P::RippleSin) || any(P::RippleCos),
        stribeck: any(P::Static),
        load: any(P::LoadShare),
        directional: any(P::Asymmetry) || any(P::AsymmetryViscous) || any(P::Quadratic),
        sag: any(P::Sag),
        derate: any(P::DerateShare),
        limit: p.iter().any(|p| effort_limit(p).is_finite()),
        lag: p.iter().any(|p| p.get(P::Lag) > 0.0),
        feedback_delay: p.iter().any(|p| delay_steps(p) > 0.0),
        gravity: p.iter().any(|p| gravity(p) != 0.0),
        output_play: any(P::OutputPlay),
        elastic: p.iter().any(elastic),
        give: any(P::Give),
        droop: n.output == Output::Velocity && any(P::Droop),
    };
    Model {
        used,
        dt: F::splat(dt),
        half: F::splat(0.5 * dt),
        k: of(&|p| dt / inertia(p)),
        per_k: of(&|p| inertia(p) / dt),
        gravity: of(&gravity),
        mech: get(P::MechOffset),
        gv: of(&|p| n.stall / volts * p.get(P::Motor) / resistance(p)),
        ge: of(&|p| n.stall / n.no_load_speed * p.get(P::Motor) * p.get(P::Motor) / resistance(p)),
        kt: of(&kt),
        supply: of(&|p| n.supply_v * p.get(P::Supply)),
        kp: of(&|p| n.kp * p.get(P::LoopGain)),
        ki: F::splat(n.ki),
        windup: get(P::Windup),
        kd: of(&|p| n.kd * p.get(P::Damping)),
        band: get(P::Deadband),
        lag: of(&lag),
        limit: of(&limit),
        stiff: of(&|p| inertia(p) / ((dt + p.get(P::Grip)) * p.get(P::Droop))),
        droop: get(P::Droop),
        duty_limit: F::splat(n.duty_limit),
        effort_limit: of(&effort_limit),
        speed_limit: F::splat(n.speed_limit),
        sag: get(P::Sag),
        regeneration: get(P::Regeneration),
        derate: get(P::DerateShare),
        warming: of(&|p| (dt / p.get(P::DerateTime).max(1e-3)).min(1.0)),
        coulomb: get(P::Coulomb),
        give: get(P::Give),
        viscous: get(P::Viscous),
        asymmetry: get(P::Asymmetry),
        asymmetry_viscous: get(P::AsymmetryViscous),
        quadratic: get(P::Quadratic),
        stick: get(P::Static),
        stribeck_speed: get(P::StribeckSpeed),
        load_share: get(P::LoadShare),
        load_of: get(P::LoadOf),
        behind: get(P::Behind),
        ripple: [get(P::RippleSin), get(P::RippleCos), get(P::RipplePeriods)],
        play: get(P::Play),
        output_play: get(P::OutputPlay),
        stiffness: of(&stiffness),
        rotor: of(&|p| inertia(p) * (1.0 - behind(p))),
        k_motor: of(&|p| dt / (inertia(p) * (1.0 - behind(p)))),
        load_per_dt: of(&|p| inertia(p) * behind(p) / dt),
        record_scale: get(P::RecordScale),
        read_after: get(P::ReadAfter),
        speed: speed_steps(p, n.period_s, dt).map(|s| Late::new(s, 1.0, dt)),
        delay: Late::new(lanes(p, delay_steps), 0.0, dt),
        ticks_per_step: (n.period_s > 1.5 * dt).then(|| dt / n.period_s),
    }
}

/// Steps over which the controller takes its difference of positions: as late as half their number.
fn speed_steps(p: &[Params], period_s: f64, dt: f64) -> Option<Eight> {
    if period_s <= 0.0 || p.iter().all(|p| p.get(P::SpeedDelay) <= 0.0) {
        return None;
    }
    let steps = |p: &Params| 2.0 * p.get(P::SpeedDelay) * period_s / dt;
    Some(lanes(p, |p| steps(p).max(0.0)))
}
