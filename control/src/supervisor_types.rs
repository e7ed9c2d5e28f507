//! States, events, orders and faults of the supervisor.

/// Times of the supervisor, microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SupervisorParams {
    /// Joints of the robot, 1 to [`crate::machine::MAX_JOINTS`].
    pub joints: u8,
    /// Longest run a start may ask for.
    pub duration_max_us: u64,
    /// Shortest and longest lease of a tethered run.
    pub lease_us: (u64, u64),
    /// Longest countdown, and longest time the approach may take after it.
    pub arm_max_us: u64,
    /// Longest ramp of the amplitudes to zero.
    pub ramp_max_us: u64,
    /// Time the last pose is held before torque goes off.
    pub hold_us: u64,
}

impl SupervisorParams {
    /// The default; a constant, so that a static can hold it.
    pub const NOMINAL: SupervisorParams = SupervisorParams {
        joints: crate::robot::JOINTS as u8,
        // One battery charge (paper, Table I: about 1 h).
        duration_max_us: 3_600_000_000,
        // Two cycles, so that one late cycle ends no run; a minute of a robot that nobody watches is no tether any more.
        lease_us: (100_000, 60_000_000),
        // A full turn of the slowest joint at half its no-load speed takes 6.2 s; three joints one after the other and reserve.
        arm_max_us: 30_000_000,
        // Rate a = 2 takes 1 rad below 1 mrad in 3.5 s.
        ramp_max_us: 4_000_000,
        // Long enough for the body to come to rest, short enough not to heat a stalled motor.
        hold_us: 1_000_000,
    };
}

impl Default for SupervisorParams {
    fn default() -> Self {
        SupervisorParams::NOMINAL
    }
}

/// What a user or host asks. Start and ClearFault reach the supervisor only after authentication; Stop always.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Order {
    /// Arm, move to the start pose, run for the duration.
    Start {
        /// Length of the run from t = 0, us.
        duration_us: u64,
        /// Earliest t = 0 after the order, us.
        countdown_us: u64,
        /// Tethered: from the order on the run goes on no longer than this after the last [`Order::Heartbeat`], us. `None`: autonomous,
        /// the run needs no host.
        lease_us: Option<u64>,
    },
    /// The host that watches a tethered run is still there.
    Heartbeat,
    /// Bring the robot to rest. Accepted in every state.
    Stop,
    /// Leave Fault or EStop.
    ClearFault,
    /// The user has placed these joints in the home pose and their zero is stored.
    Home {
        /// Bit k: joint k.
        joint_mask: u16,
    },
}

/// What can go wrong, with the joint where there is one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Fault {
    /// A driver did not answer for several cycles.
    DriverLost {
        /// Joint index.
        joint: u8,
    },
    /// A driver restarted while its joint was in use.
    DriverReset {
        /// Joint index.
        joint: u8,
    },
    /// A driver latched a hardware error (overload, over-temperature, voltage).
    DriverError {
        /// Joint index.
        joint: u8,
        /// Hardware error status bits of the driver.
        bits: u8,
    },
    /// A position jumped further than the joint can turn.
    EncoderJump {
        /// Joint index.
        joint: u8,
    },
    /// A joint draws current and does not follow.
    Stall {
        /// Joint index.
        joint: u8,
    },
    /// A driver applied another set-point than it was sent.
    EchoMismatch {
        /// Joint index.
        joint: u8,
    },
    /// The bus is unusable (babbling or stuck line).
    BusLost,
    /// Control cycles were missed in a row.
    Overrun,
    /// Battery below the level at which the drivers still work.
    LowBattery,
    /// The running gait no longer matches its checksum.
    GaitCorrupt,
    /// A set-point was not finite or left its limits; it was not sent.
    BadSetPoint,
    /// The module's own check failed (watchdog, stack, storage).
    Internal,
}

/// What the motors do when a fault strikes a moving robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FaultReaction {
    /// Amplitudes to zero, hold, then torque off: motors, bus and law are sound.
    Ramp,
    /// Hold the last pose, then torque off: the pose is known but no new motion may be planned.
    Hold,
    /// Torque off at once: a command can no longer be trusted to arrive, or pushing on does damage.
    Off,
}

impl Fault {
    /// The torque policy, one row per fault.
    #[must_use]
    pub const fn reaction(self) -> FaultReaction {
        match self {
            Fault::LowBattery => FaultReaction::Ramp,
            Fault::DriverLost { .. } => FaultReaction::Hold,
            Fault::DriverReset { .. } => FaultReaction::Hold,
            Fault::DriverError { .. } => FaultReaction::Hold,
            Fault::EncoderJump { .. } => FaultReaction::Hold,
            Fault::EchoMismatch { .. } => FaultReaction::Hold,
            Fault::Overrun => FaultReaction::Hold,
            Fault::GaitCorrupt => FaultReaction::Hold,
            Fault::BadSetPoint => FaultReaction::Hold,
            Fault::Stall { .. } => FaultReaction::Off,
            Fault::BusLost => FaultReaction::Off,
            Fault::Internal => FaultReaction::Off,
        }
    }
}

/// Why a run or its approach ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StopReason {
    /// A Stop order.
    Ordered,
    /// The run had its length: the normal end.
    DurationOver,
    /// A tethered run heard no heartbeat for the length of its lease.
    LeaseOver,
    /// The way to the start pose would collide.
    ApproachBlocked,
    /// The start pose was not reached in time.
    ArmTimeout,
    /// A fault that allows a ramp.
    Fault(Fault),
}

/// The two parts of a stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StopPhase {
    /// Amplitudes go to zero.
    Ramp {
        /// Latest end.
        until_us: u64,
    },
    /// The pose is held.
    Hold {
        /// End, torque goes off.
        until_us: u64,
    },
}

/// Where the robot is between power-up and motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum State {
    /// Self-test.
    Boot,
    /// At least one joint does not know its zero.
    Unhomed,
    /// Ready for a start order, torque off.
    Idle,
    /// Moving to the start pose, or waiting there for t = 0.
    Armed {
        /// Length of the run to come.
        duration_us: u64,
        /// Earliest t = 0.
        run_at_us: u64,
        /// Latest t = 0.
        give_up_us: u64,
    },
    /// Following the gait.
    Run {
        /// End of the run.
        until_us: u64,
    },
    /// Coming to rest.
    Stopping {
        /// Why.
        reason: StopReason,
        /// How far.
        phase: StopPhase,
    },
    /// A latched fault; torque stays on until `hold_until_us`, if that is given.
    Fault {
        /// The first fault.
        fault: Fault,
        /// End of the hold.
        hold_until_us: Option<u64>,
    },
    /// The STOP input was pressed; torque off.
    EStop,
}

impl State {
    /// What motors and motion planner have to do in this state.
    #[must_use]
    pub const fn command(&self) -> Command {
        let (torque, motion) = match self {
            State::Boot | State::Unhomed | State::Idle | State::EStop => (false, Motion::None),
            State::Armed { .. } => (true, Motion::Approach),
            State::Run { .. } => (true, Motion::Run),
            State::Stopping {
                phase: StopPhase::Ramp { .. },
                ..
            } => (true, Motion::Ramp),
            State::Stopping {
                phase: StopPhase::Hold { .. },
                ..
            } => (true, Motion::Hold),
            State::Fault {
                hold_until_us: Some(_),
                ..
            } => (true, Motion::Hold),
            State::Fault {
                hold_until_us: None,
                ..
            } => (false, Motion::None),
        };
        Command { torque, motion }
    }

    /// Why an order that needs a resting robot is refused here.
    pub(crate) const fn refusal(&self) -> Refusal {
        match self {
            State::Boot => Refusal::Booting,
            State::Fault { fault, .. } => Refusal::FaultLatched(*fault),
            State::EStop => Refusal::EStopLatched,
            _ => Refusal::Busy,
        }
    }
}

/// What has to be moved how.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Motion {
    /// Send no set-points.
    None,
    /// Move to the offsets of the gait.
    Approach,
    /// Follow the gait.
    Run,
    /// Amplitudes to zero.
    Ramp,
    /// Repeat the last set-point.
    Hold,
}

/// What a state demands of the rest of the firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Command {
    /// Torque of all drivers on.
    pub torque: bool,
    /// Kind of motion.
    pub motion: Motion,
}

/// What happens to the supervisor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Event {
    /// The self-test passed.
    Booted,
    /// An order from the host.
    Order(Order),
    /// The STOP input changed, or was found pressed.
    StopInput {
        /// Pressed.
        pressed: bool,
    },
    /// Something failed.
    Fault(Fault),
    /// A driver reports that it restarted: its zero is lost. A joint index above 5 means all.
    DriverReset {
        /// Joint index.
        joint: u8,
    },
    /// The approach has reached the start pose. Repeat it every cycle until Run.
    InPosition,
    /// The approach cannot go on without a collision.
    ApproachBlocked,
    /// The amplitudes have reached zero.
    Settled,
    /// A control cycle passed.
    Tick,
}

/// Why an order was not followed. The state is as before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// Still in the self-test.
    Booting,
    /// Joints without a zero.
    NotHomed {
        /// Bit k: joint k has no zero.
        missing_mask: u16,
    },
    /// The robot is moving; stop it first.
    Busy,
    /// A fault is latched; clear it first.
    FaultLatched(Fault),
    /// The STOP input was pressed; release it and clear.
    EStopLatched,
    /// The STOP input is still pressed.
    StopInputPressed,
    /// There is nothing to clear.
    NoFault,
    /// No joint or a joint that does not exist.
    BadJointMask {
        /// The mask that was given.
        joint_mask: u16,
    },
    /// A length of zero or above the limit.
    BadDuration {
        /// The length asked for.
        duration_us: u64,
        /// The longest one.
        max_us: u64,
    },
    /// A lease outside its range.
    BadLease {
        /// The lease asked for.
        lease_us: u64,
        /// The shortest one.
        min_us: u64,
        /// The longest one.
        max_us: u64,
    },
    /// A heartbeat, and no tethered run is under way.
    NotTethered,
    /// A countdown above the limit.
    BadCountdown {
        /// The countdown asked for.
        countdown_us: u64,
        /// The longest countdown.
        max_us: u64,
    },
}

/// Outcome of one event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Transition {
    /// State before.
    pub from: State,
    /// State after.
    pub to: State,
    /// Why an order was not followed, if it was not.
    pub refusal: Option<Refusal>,
}

impl Transition {
    /// Whether the state changed.
    #[must_use]
    pub fn changed(&self) -> bool {
        self.from != self.to
    }
}
