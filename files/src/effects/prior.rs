//! Sizes: what is usual, what is worth a name, and in which measure of the joint both are stated.

/// Largest figures of one joint, which typical sizes are shares of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointScales {
    /// Largest torque (or force) of the motor, N m (N).
    pub torque_nm: f64,
    /// Largest speed of the motor, rad/s (m/s).
    pub speed_rad_s: f64,
    /// Largest current of the motor, A.
    pub current_a: f64,
    /// Nominal supply voltage, V.
    pub voltage_v: f64,
}

/// What a typical size is a share of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Nothing: it is stated in the unit of its key.
    Unit,
    /// Largest torque.
    Torque,
    /// Largest speed.
    Speed,
    /// Largest torque at largest speed.
    TorquePerSpeed,
    /// Largest torque at the square of the largest speed.
    TorquePerSpeed2,
    /// Largest current.
    Current,
    /// Nominal supply voltage.
    Voltage,
}

impl Scale {
    /// What one of this scale is in the unit of the key, for a joint of these figures.
    #[must_use]
    pub fn of(self, joint: &JointScales) -> f64 {
        match self {
            Scale::Unit => 1.0,
            Scale::Torque => joint.torque_nm,
            Scale::Speed => joint.speed_rad_s,
            Scale::TorquePerSpeed => joint.torque_nm / joint.speed_rad_s,
            Scale::TorquePerSpeed2 => joint.torque_nm / (joint.speed_rad_s * joint.speed_rad_s),
            Scale::Current => joint.current_a,
            Scale::Voltage => joint.voltage_v,
        }
    }

    /// The measure in words, empty for [`Scale::Unit`].
    #[must_use]
    pub const fn plain(self) -> &'static str {
        match self {
            Scale::Unit => "",
            Scale::Torque => "largest torque",
            Scale::Speed => "largest speed",
            Scale::TorquePerSpeed => "largest torque / largest speed",
            Scale::TorquePerSpeed2 => "largest torque / largest speed squared",
            Scale::Current => "largest current",
            Scale::Voltage => "nominal voltage",
        }
    }
}

/// What is believed about a size before any data, given that the effect is there. In the scale of its parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Prior {
    /// The logarithm is normal. Ratios have a median near 1.
    LogNormal {
        /// Median.
        median: f64,
        /// Standard deviation of the natural logarithm.
        ln_sigma: f64,
    },
    /// Normal, for sizes of either sign.
    Normal {
        /// Mean.
        mean: f64,
        /// Standard deviation.
        sigma: f64,
    },
    /// Every value of a range alike.
    Uniform {
        /// Lower end.
        low: f64,
        /// Upper end.
        high: f64,
    },
    /// One of so many values, each alike.
    OneOf(u32),
}

/// 90 % quantile of the standard normal distribution.
const Q90: f64 = 1.281_551_565_544_600_4;

impl Prior {
    /// Natural logarithm of the density at `x`; of the probability for [`Prior::OneOf`]. Minus infinity outside the range.
    #[must_use]
    pub fn ln_density(&self, x: f64) -> f64 {
        let normal = |z: f64, sigma: f64| {
            -0.5 * z * z - libm::log(sigma) - 0.5 * libm::log(std::f64::consts::TAU)
        };
        match *self {
            Prior::LogNormal { median, ln_sigma } if x > 0.0 => {
                let z = libm::log(x / median) / ln_sigma;
                normal(z, ln_sigma) - libm::log(x)
            }
            Prior::LogNormal { .. } => f64::NEG_INFINITY,
            Prior::Normal { mean, sigma } => normal((x - mean) / sigma, sigma),
            Prior::Uniform { low, high } if (low..=high).contains(&x) => -libm::log(high - low),
            Prior::Uniform { .. } => f64::NEG_INFINITY,
            Prior::OneOf(count) => -libm::log(f64::from(count)),
        }
    }

    /// Standard deviation; that of a logarithm times its median. Zero for [`Prior::OneOf`].
    #[must_use]
    pub fn spread(&self) -> f64 {
        match *self {
            Prior::LogNormal { median, ln_sigma } => median * ln_sigma,
            Prior::Normal { sigma, .. } => sigma,
            Prior::Uniform { low, high } => (high - low) / libm::sqrt(12.0),
            Prior::OneOf(_) => 0.0,
        }
    }

    /// The 10 %, 50 % and 90 % quantiles: where a fit may start. Meaningless for [`Prior::OneOf`], whose values are all tried.
    #[must_use]
    pub fn starts(&self) -> [f64; 3] {
        let at = |f: &dyn Fn(f64) -> f64| [f(-Q90), f(0.0), f(Q90)];
        match *self {
            Prior::LogNormal { median, ln_sigma } => at(&|z| median * libm::exp(z * ln_sigma)),
            Prior::Normal { mean, sigma } => at(&|z| mean + z * sigma),
            Prior::Uniform { low, high } => [0.1, 0.5, 0.9].map(|p| low + p * (high - low)),
            Prior::OneOf(_) => [0.0; 3],
        }
    }
}

/// Smallest size worth a name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resolution {
    /// Distance from the neutral value, in the scale of its parameter. Where neutral is infinite: the largest value worth a name.
    pub size: f64,
    /// Where the figure comes from.
    pub source: &'static str,
}
