//! Battery and bus wire that all drivers share.

/// Source behind the drivers.
#[derive(Clone, Debug, PartialEq)]
pub struct SupplyParams {
    /// `supply_voltage` without load [V].
    pub voltage_v: f64,
    /// `supply_sag`: resistance of battery, connectors and wire [ohm]; neutral 0.
    pub resistance_ohm: f64,
}

impl Default for SupplyParams {
    fn default() -> Self {
        // The paper gives the packs (two of two cells) but not how they are wired; 12 V is the voltage at which
        // Table I's no-load speeds hold for the 012 windings.
        Self {
            voltage_v: 12.0,
            resistance_ohm: 0.0,
        }
    }
}

impl SupplyParams {
    /// Bus voltage under a load of `current_a`, never below 0 [V].
    #[must_use]
    pub fn bus_v(&self, current_a: f64) -> f64 {
        (self.voltage_v - self.resistance_ohm * current_a).max(0.0)
    }
}
