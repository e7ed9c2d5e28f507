//! The faults of a schedule: a closed list, each with a name, a window and a size.

use std::fmt;
use std::str::FromStr;

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Frames on a host link vanish, either way.
    LinkLoss,
    /// Bits of frames on a host link flip, either way.
    LinkCorruption,
    /// Frames on a host link come late.
    LinkDelay,
    /// Frames on a host link overtake each other.
    LinkReorder,
    /// Frames on a host link come twice.
    LinkDuplicate,
    /// Somebody sends noise on a host link.
    LinkBabble,
    /// A host link is cut and comes back.
    LinkCut,
    /// The module's link receiver reports an error.
    LinkUart,
    /// Packets on the motor bus vanish, either way.
    BusLoss,
    /// Bits on the motor bus flip.
    BusCorruption,
    /// Packets of the module reach the drivers late.
    BusDelay,
    /// Packets of the module overtake each other.
    BusReorder,
    /// Packets of the module reach the drivers twice.
    BusDuplicate,
    /// Somebody talks on the motor bus all the time.
    BusBabble,
    /// The supply dips: the module restarts, and in half of the cases the drivers too.
    BrownOut,
    /// The module restarts.
    Reset,
    /// The power fails at one operation of the slot flash.
    StorageCut,
    /// The battery's voltage falls.
    BatterySag,
    /// The control task stands still for a while.
    Stall,
    /// A driver is off the bus.
    DriverMissing,
    /// A driver hears and does not answer.
    DriverMute,
    /// A driver restarts.
    DriverReset,
    /// A driver latches a hardware error.
    DriverError,
    /// A driver's measurement stands still.
    SensorFreeze,
    /// A driver's encoder jumps.
    SensorJump,
    /// A driver applies another set-point.
    WrongSetPoint,
    /// Clocks of drivers and hosts run fast or slow.
    ClockDrift,
    /// The host program dies and is started again later.
    HostDeath,
    /// A second host talks to the module.
    SecondHost,
    /// Somebody presses STOP on the robot.
    StopInput,
}

/// Every kind with its name.
const NAMES: [(Kind, &str); 30] = [
    (Kind::LinkLoss, "link_loss"),
    (Kind::LinkCorruption, "link_corruption"),
    (Kind::LinkDelay, "link_delay"),
    (Kind::LinkReorder, "link_reorder"),
    (Kind::LinkDuplicate, "link_duplicate"),
    (Kind::LinkBabble, "link_babble"),
    (Kind::LinkCut, "link_cut"),
    (Kind::LinkUart, "link_uart"),
    (Kind::BusLoss, "bus_loss"),
    (Kind::BusCorruption, "bus_corruption"),
    (Kind::BusDelay, "bus_delay"),
    (Kind::BusReorder, "bus_reorder"),
    (Kind::BusDuplicate, "bus_duplicate"),
    (Kind::BusBabble, "bus_babble"),
    (Kind::BrownOut, "brown_out"),
    (Kind::Reset, "reset"),
    (Kind::StorageCut, "storage_cut"),
    (Kind::BatterySag, "battery_sag"),
    (Kind::Stall, "stall"),
    (Kind::DriverMissing, "driver_missing"),
    (Kind::DriverMute, "driver_mute"),
    (Kind::DriverReset, "driver_reset"),
    (Kind::DriverError, "driver_error"),
    (Kind::SensorFreeze, "sensor_freeze"),
    (Kind::SensorJump, "sensor_jump"),
    (Kind::WrongSetPoint, "wrong_set_point"),
    (Kind::ClockDrift, "clock_drift"),
    (Kind::HostDeath, "host_death"),
    (Kind::SecondHost, "second_host"),
    (Kind::StopInput, "stop_input"),
];

/// Number of kinds.
pub const KINDS: usize = NAMES.len();

impl Kind {
    /// All kinds, in the order of the list.
    pub fn all() -> impl Iterator<Item = Self> {
        NAMES.iter().map(|(kind, _)| *kind)
    }

    /// Place in the list.
    #[must_use]
    pub fn index(self) -> usize {
        self as usize
    }

    /// Name in options and reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        NAMES[self.index()].1
    }

    /// Kinds by their names, with commas between them.
    ///
    /// # Errors
    /// A name is unknown, or there is none.
    pub fn list(text: &str) -> Result<Vec<Self>, BadFaults> {
        if text.trim().is_empty() {
            return Err(BadFaults::Empty);
        }
        text.split(',').map(|word| word.trim().parse()).collect()
    }

    /// Whether it disturbs what passes on the motor bus as a whole.
    #[must_use]
    pub fn is_on_the_bus(self) -> bool {
        matches!(
            self,
            Self::BusLoss
                | Self::BusCorruption
                | Self::BusDelay
                | Self::BusReorder
                | Self::BusDuplicate
                | Self::BusBabble
        )
    }
}

/// A list of faults that cannot be drawn from.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BadFaults {
    /// A name that no fault has.
    #[error("no fault {0:?}; there are {known}", known = known())]
    Unknown(String),
    /// Schedules without any fault would look as if they had held.
    #[error("an empty list of faults; there are {known}", known = known())]
    Empty,
}

fn known() -> String {
    NAMES.map(|(_, name)| name).join(", ")
}

impl FromStr for Kind {
    type Err = BadFaults;

    fn from_str(text: &str) -> Result<Self, BadFaults> {
        let found = NAMES.iter().find(|(_, name)| *name == text);
        found
            .map(|(kind, _)| *kind)
            .ok_or_else(|| BadFaults::Unknown(text.to_owned()))
    }
}

/// One fault of a schedule.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fault {
    /// What goes wrong.
    pub kind: Kind,
    /// From when, us of virtual time.
    pub from_us: u64,
    /// Until when, us.
    pub to_us: u64,
    /// Joint, 0..6, where it strikes one.
    pub joint: usize,
    /// Host link, 0 the cable, 1 the radio, where it strikes one.
    pub link: usize,
    /// How bad it is, 0 to 1; what that means hangs on the kind.
    pub size: f64,
    /// Seed of its own chance.
    pub seed: u64,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (from_s, to_s) = (self.from_us as f64 * 1e-6, self.to_us as f64 * 1e-6);
        write!(
            f,
            "{:<16} {from_s:8.4} s to {to_s:8.4} s, joint {}, link {}, size {:.3}",
            self.kind.name(),
            self.joint,
            self.link,
            self.size
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_list_is_in_the_order_of_the_enum_and_reads_back() {
        for (index, kind) in Kind::all().enumerate() {
            assert_eq!(kind.index(), index);
            assert_eq!(kind.name().parse(), Ok(kind));
        }
        let refused = "bus_los".parse::<Kind>().expect_err("no such fault");
        let text = refused.to_string();
        assert!(
            text.contains("bus_los\"") && text.contains("bus_loss"),
            "{text}"
        );
    }

    #[test]
    fn a_list_has_a_fault_or_is_refused() {
        let two = vec![Kind::BusLoss, Kind::Reset];
        assert_eq!(Kind::list("bus_loss, reset"), Ok(two));
        for empty in ["", " "] {
            assert_eq!(Kind::list(empty), Err(BadFaults::Empty));
        }
        for (text, word) in [("bus_loss,", ""), (",", ""), ("bus_loss,x", "x")] {
            let unknown = Err(BadFaults::Unknown(word.to_owned()));
            assert_eq!(Kind::list(text), unknown, "{text}");
        }
        let text = BadFaults::Empty.to_string();
        assert!(text.starts_with("an empty list") && text.contains("stop_input"));
    }
}
