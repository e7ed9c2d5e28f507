//! Names of stages and effects: the registry of `files`, and causes that are several effects at once.

use serde::{Serialize, Serializer};

pub use files::effects::{Effect, Stage};

/// One thing that has several effects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Compound {
    /// One mass more or less at the load: its weight and its inertia.
    Payload,
    /// A battery that is low and gives way: voltage and resistance.
    WeakBattery,
}

impl Compound {
    /// Its name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Payload => "payload",
            Self::WeakBattery => "weak_battery",
        }
    }

    /// As a noun.
    #[must_use]
    pub fn plain(self) -> &'static str {
        match self {
            Self::Payload => "another payload",
            Self::WeakBattery => "a weak battery",
        }
    }

    /// Its effects.
    #[must_use]
    pub fn effects(self) -> [Effect; 2] {
        match self {
            Self::Payload => [Effect::GravityLoad, Effect::Inertia],
            Self::WeakBattery => [Effect::SupplyVoltage, Effect::SupplySag],
        }
    }

    /// The one of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        let all = [Self::Payload, Self::WeakBattery];
        all.into_iter().find(|c| c.name() == name)
    }
}

impl Serialize for Compound {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}
