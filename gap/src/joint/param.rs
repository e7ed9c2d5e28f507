//! The parameters of the joint model.

macro_rules! params {
    ($($id:ident = $neutral:expr, $doc:literal;)*) => {
        /// Index of a parameter.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
        pub enum P { $(#[doc = $doc] $id),* }

        impl P {
            /// Every parameter.
            pub const ALL: &'static [Self] = &[$(Self::$id),*];
        }

        const NEUTRAL: [f64; P::ALL.len()] = [$($neutral),*];
    };
}

params! {
    Inertia = 1.0, "ratio to the nominal inertia";
    Gravity = 1.0, "ratio to the nominal gravity effort";
    Weight = 0.0, "gravity effort where the nominal one is unknown";
    Motor = 1.0, "ratio to the nominal motor constant";
    Ampere = 1.0, "ratio to the nominal effort per ampere, where the controller puts out no voltage";
    Resistance = 1.0, "ratio to the nominal winding resistance";
    Supply = 1.0, "ratio to the nominal supply voltage";
    LoopGain = 1.0, "ratio to the nominal position gain";
    Damping = 1.0, "ratio to the nominal velocity gain";
    Scale = 1.0, "set-point scale";
    Sense = 1.0, "-1: the set-point counts in the other direction";
    Offset = 0.0, "added to the set-point";
    MechOffset = 0.0, "mechanical angle minus encoder angle";
    RecordScale = 1.0, "recorded position over true position";
    Delay = 0.0, "set-point delay, s";
    Skew = 0.0, "robot clock rate minus 1";
    Played = 0.0, "1: the clock plays the gait, set-points still leave at their instants";
    Quantum = 0.0, "set-point step";
    ReadAfter = 0.0, "0: a row at a tick holds current and voltage from before the controller acted, 1: from after";
    Deadband = 0.0, "half width of ignored errors";
    Windup = 1.0, "how fast a saturated controller goes on integrating: 1 fully, 0 not at all";
    Tightness = 0.0, "one over the controller's limit, where that is unknown";
    Grip = 0.0, "time constant of a velocity servo's inner loop, s";
    Droop = 1.0, "ratio of the speed that a load takes from a velocity servo to what the time constant of its inner loop implies";
    SlewLimit = f64::INFINITY, "largest speed of the set-point";
    FeedbackDelay = 0.0, "encoder delay in the controller, s";
    SpeedDelay = 1.0, "delay of the controller's speed estimate, in controller periods";
    Lag = 0.0, "time constant of the actuator, s";
    Strength = 1.0, "ratio to the nominal largest effort of an effort or velocity servo";
    CurrentLimit = f64::INFINITY, "A";
    TorqueLimit = f64::INFINITY, "N m or N";
    DerateTime = 60.0, "time constant of the derating, s";
    DerateShare = 0.0, "share of torque lost when warm";
    Sag = 0.0, "source resistance, ohm";
    Regeneration = 1.0, "share of the current that a braking motor feeds back into the source";
    Give = 0.0, "travel before dry friction slides";
    Coulomb = 0.0, "N m or N";
    Viscous = 0.0, "N m s/rad";
    Static = 0.0, "friction above Coulomb at standstill";
    StribeckSpeed = 0.1, "speed at which 1/e of it is left";
    LoadShare = 0.0, "friction over transmitted effort";
    Behind = 0.5, "share of the inertia that sits behind the gear";
    LoadOf = 0.0, "what rubs in a gear: 0 what it transmits to the load, 1 the larger of motor effort and hanging load";
    Asymmetry = 0.0, "half of the Coulomb difference, forward minus backward";
    AsymmetryViscous = 0.0, "half of the viscous difference";
    Quadratic = 0.0, "N m s^2/rad^2";
    RippleSin = 0.0, "sine part of the ripple";
    RippleCos = 0.0, "cosine part of the ripple";
    RipplePeriods = 1.0, "ripple periods per turn (per metre)";
    Play = 0.0, "half play between encoder and link";
    OutputPlay = 0.0, "half play before the encoder";
    Flexibility = 0.0, "twist per effort, rad/(N m)";
}

/// A full set of parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Params([f64; P::ALL.len()]);

impl Default for Params {
    fn default() -> Self {
        Self(NEUTRAL)
    }
}

impl Params {
    /// The value of `p`.
    #[must_use]
    pub fn get(&self, p: P) -> f64 {
        self.0[p as usize]
    }

    /// Sets `p`.
    pub fn set(&mut self, p: P, value: f64) {
        self.0[p as usize] = value;
    }

    /// The same with `p` set.
    #[must_use]
    pub fn with(mut self, p: P, value: f64) -> Self {
        self.set(p, value);
        self
    }

    /// Value of `p` at which it has no effect.
    #[must_use]
    pub fn neutral(p: P) -> f64 {
        NEUTRAL[p as usize]
    }
}
