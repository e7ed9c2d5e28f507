//! May anything move? The supervisor as an explicit state machine: a pure function of state, time and event.
//!
//! ```text
//!            Booted              all joints homed                 Start (all homed)             InPosition and countdown over
//!   Boot ──────────────▶ Unhomed ───────────────▶ Idle ─────────────────────▶ Armed ─────────────────────────▶ Run
//!                           ▲                      ▲ ▲                          │ Stop, blocked, timeout         │ Stop, length or lease over,
//!                           │ DriverReset          │ │                          ▼                                ▼ fault with ramp
//!                           └──── (any state) ─────┘ └── hold over ─────── Stopping { Ramp ─settled or timeout─▶ Hold } ◀┘
//!                                                  │                            │ hold over, stopped by a fault
//!   any state ── fault ──▶ Fault ── ClearFault ────┤ ◀──────────────────────────┘ (to Fault)
//!   any state ── STOP input ──▶ EStop ── released, ClearFault ──▶ Unhomed or Idle (Boot before the self-test)
//! ```
//!
//! Invariants (tested over every state and event and over random sequences):
//! * torque is on only in Armed, Run, Stopping and the hold of a Fault; the motors get new set-points only in Armed, Run and the
//!   ramp of Stopping;
//! * Armed is entered by a `Start` order alone, from Idle alone, with every joint homed; Run from Armed alone. So nothing moves after
//!   a reset, a fault or a stop without a new order;
//! * a tethered run has no longer than its lease after the last heartbeat before it is stopped, in Armed as in Run;
//! * `Stop` is accepted in every state and leaves no state that moves along a gait;
//! * a driver reset revokes the homing of its joint in every state (the encoders are relative);
//! * the first fault is kept until `ClearFault`; a pressed STOP input beats everything.

pub use crate::supervisor_types::{
    Command, Event, Fault, FaultReaction, Motion, Order, Refusal, State, StopPhase, StopReason,
    SupervisorParams, Transition,
};

use crate::machine::all_joints;
use crate::robot::JOINTS;

/// One bit per joint of a meta-module, all set.
pub const ALL_JOINTS: u16 = all_joints(JOINTS as u8);

/// The state machine with its homing mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Supervisor {
    state: State,
    homed_mask: u16,
    booted: bool,
    stop_input: bool,
    lease: Option<Lease>,
}

/// The tether of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Lease {
    length_us: u64,
    until_us: u64,
}

impl Lease {
    const fn renewed(length_us: u64, now_us: u64) -> Self {
        Lease {
            length_us,
            until_us: now_us.saturating_add(length_us),
        }
    }
}

impl Default for Supervisor {
    fn default() -> Self {
        Supervisor::new()
    }
}

impl Supervisor {
    /// The state after any reset: Boot, nothing homed.
    #[must_use]
    pub const fn new() -> Self {
        Supervisor {
            state: State::Boot,
            homed_mask: 0,
            booted: false,
            stop_input: false,
            lease: None,
        }
    }

    /// Present state.
    #[must_use]
    pub const fn state(&self) -> State {
        self.state
    }

    /// Bit k set: the zero of joint k is known.
    #[must_use]
    pub const fn homed_mask(&self) -> u16 {
        self.homed_mask
    }

    /// What motors and motion planner have to do in the present state.
    #[must_use]
    pub const fn command(&self) -> Command {
        self.state.command()
    }

    /// Takes one event at `now_us` (microseconds of the module's clock). Call it with [`Event::Tick`] once a cycle.
    pub fn step(&mut self, params: &SupervisorParams, now_us: u64, event: Event) -> Transition {
        let from = self.state;
        let refusal = self.take(params, now_us, event).err();
        Transition {
            from,
            to: self.state,
            refusal,
        }
    }

    fn take(
        &mut self,
        params: &SupervisorParams,
        now_us: u64,
        event: Event,
    ) -> Result<(), Refusal> {
        match event {
            Event::Booted => self.on_booted(params),
            Event::StopInput { pressed } => self.on_stop_input(pressed),
            Event::Fault(fault) => self.on_fault(params, now_us, fault),
            Event::DriverReset { joint } => self.on_driver_reset(params, now_us, joint),
            Event::InPosition => self.on_in_position(now_us),
            Event::ApproachBlocked => {
                if let State::Armed { .. } = self.state {
                    self.hold(params, now_us, StopReason::ApproachBlocked);
                }
            }
            Event::Settled => {
                if let State::Stopping {
                    reason,
                    phase: StopPhase::Ramp { .. },
                } = self.state
                {
                    self.hold(params, now_us, reason);
                }
            }
            Event::Tick => self.on_tick(params, now_us),
            Event::Order(Order::Stop) => self.on_stop(params, now_us, StopReason::Ordered),
            Event::Order(Order::ClearFault) => return self.on_clear_fault(params),
            Event::Order(Order::Home { joint_mask }) => return self.on_home(params, joint_mask),
            Event::Order(Order::Heartbeat) => return self.on_heartbeat(now_us),
            Event::Order(Order::Start {
                duration_us,
                countdown_us,
                lease_us,
            }) => {
                check_start(params, duration_us, countdown_us, lease_us)?;
                self.on_start(params, now_us, duration_us, countdown_us)?;
                self.lease = lease_us.map(|length_us| Lease::renewed(length_us, now_us));
            }
        }
        Ok(())
    }

    /// Where a robot without torque is: the self-test has to have passed, the joints to be homed.
    fn at_rest(&self, params: &SupervisorParams) -> State {
        if !self.booted {
            State::Boot
        } else if self.homed_mask == all_joints(params.joints) {
            State::Idle
        } else {
            State::Unhomed
        }
    }

    fn on_booted(&mut self, params: &SupervisorParams) {
        self.booted = true;
        if let State::Boot = self.state {
            self.state = self.at_rest(params);
        }
    }

    fn on_stop_input(&mut self, pressed: bool) {
        self.stop_input = pressed;
        if pressed {
            self.state = State::EStop;
        }
    }

    fn on_fault(&mut self, params: &SupervisorParams, now_us: u64, fault: Fault) {
        match self.state {
            State::Fault {
                fault: first,
                hold_until_us: Some(_),
            } if fault.reaction() == FaultReaction::Off => {
                self.latch(params, now_us, first, FaultReaction::Off);
            }
            State::EStop | State::Fault { .. } => {}
            State::Stopping {
                reason: StopReason::Fault(first),
                ..
            } => {
                // The first fault stays the reason; a worse one ends its ramp.
                if fault.reaction() != FaultReaction::Ramp {
                    self.latch(params, now_us, first, fault.reaction());
                }
            }
            State::Run { .. } if fault.reaction() == FaultReaction::Ramp => {
                self.ramp(params, now_us, StopReason::Fault(fault));
            }
            State::Armed { .. } | State::Run { .. } | State::Stopping { .. } => {
                self.latch(params, now_us, fault, fault.reaction());
            }
            State::Boot | State::Unhomed | State::Idle => {
                self.state = State::Fault {
                    fault,
                    hold_until_us: None,
                }
            }
        }
    }

    fn on_driver_reset(&mut self, params: &SupervisorParams, now_us: u64, joint: u8) {
        let bit = if joint < params.joints {
            1u16 << (joint & 15)
        } else {
            u16::MAX
        };
        self.homed_mask &= !bit;
        match self.state {
            State::Idle => self.state = State::Unhomed,
            State::Armed { .. } | State::Run { .. } | State::Stopping { .. } => {
                self.on_fault(params, now_us, Fault::DriverReset { joint });
            }
            State::Boot | State::Unhomed | State::Fault { .. } | State::EStop => {}
        }
    }

    fn on_in_position(&mut self, now_us: u64) {
        if let State::Armed {
            duration_us,
            run_at_us,
            ..
        } = self.state
            && now_us >= run_at_us
        {
            self.state = State::Run {
                until_us: now_us.saturating_add(duration_us),
            };
        }
    }

    fn on_heartbeat(&mut self, now_us: u64) -> Result<(), Refusal> {
        match (&mut self.lease, self.state) {
            (Some(lease), State::Armed { .. } | State::Run { .. }) => {
                *lease = Lease::renewed(lease.length_us, now_us);
                Ok(())
            }
            _ => Err(Refusal::NotTethered),
        }
    }

    fn on_tick(&mut self, params: &SupervisorParams, now_us: u64) {
        let alone = self.lease.is_some_and(|lease| now_us >= lease.until_us);
        match self.state {
            State::Armed { .. } | State::Run { .. } if alone => {
                self.on_stop(params, now_us, StopReason::LeaseOver);
            }
            State::Armed { give_up_us, .. } if now_us >= give_up_us => {
                self.hold(params, now_us, StopReason::ArmTimeout)
            }
            State::Run { until_us } if now_us >= until_us => {
                self.ramp(params, now_us, StopReason::DurationOver)
            }
            State::Stopping {
                reason,
                phase: StopPhase::Ramp { until_us },
            } if now_us >= until_us => {
                self.hold(params, now_us, reason);
            }
            State::Stopping {
                reason,
                phase: StopPhase::Hold { until_us },
            } if now_us >= until_us => {
                self.state = match reason {
                    StopReason::Fault(fault) => State::Fault {
                        fault,
                        hold_until_us: None,
                    },
                    _ => self.at_rest(params),
                };
            }
            State::Fault {
                fault,
                hold_until_us: Some(until_us),
            } if now_us >= until_us => {
                self.state = State::Fault {
                    fault,
                    hold_until_us: None,
                };
            }
            _ => {}
        }
    }

    fn on_stop(&mut self, params: &SupervisorParams, now_us: u64, reason: StopReason) {
        match self.state {
            State::Armed { .. } => self.hold(params, now_us, reason),
            State::Run { .. } => self.ramp(params, now_us, reason),
            _ => {}
        }
    }

    fn on_clear_fault(&mut self, params: &SupervisorParams) -> Result<(), Refusal> {
        match self.state {
            State::EStop if self.stop_input => Err(Refusal::StopInputPressed),
            State::EStop | State::Fault { .. } => {
                self.state = self.at_rest(params);
                Ok(())
            }
            _ => Err(Refusal::NoFault),
        }
    }

    fn on_home(&mut self, params: &SupervisorParams, joint_mask: u16) -> Result<(), Refusal> {
        if joint_mask == 0 || joint_mask & !all_joints(params.joints) != 0 {
            return Err(Refusal::BadJointMask { joint_mask });
        }
        match self.state {
            State::Unhomed | State::Idle => {
                self.homed_mask |= joint_mask;
                self.state = self.at_rest(params);
                Ok(())
            }
            other => Err(other.refusal()),
        }
    }

    fn on_start(
        &mut self,
        params: &SupervisorParams,
        now_us: u64,
        duration_us: u64,
        countdown_us: u64,
    ) -> Result<(), Refusal> {
        match self.state {
            State::Idle => {
                let run_at_us = now_us.saturating_add(countdown_us);
                let give_up_us = run_at_us.saturating_add(params.arm_max_us);
                self.state = State::Armed {
                    duration_us,
                    run_at_us,
                    give_up_us,
                };
                Ok(())
            }
            State::Unhomed => Err(Refusal::NotHomed {
                missing_mask: all_joints(params.joints) & !self.homed_mask,
            }),
            other => Err(other.refusal()),
        }
    }

    fn ramp(&mut self, params: &SupervisorParams, now_us: u64, reason: StopReason) {
        self.state = State::Stopping {
            reason,
            phase: StopPhase::Ramp {
                until_us: now_us.saturating_add(params.ramp_max_us),
            },
        };
    }

    fn hold(&mut self, params: &SupervisorParams, now_us: u64, reason: StopReason) {
        self.state = State::Stopping {
            reason,
            phase: StopPhase::Hold {
                until_us: now_us.saturating_add(params.hold_us),
            },
        };
    }

    fn latch(
        &mut self,
        params: &SupervisorParams,
        now_us: u64,
        fault: Fault,
        reaction: FaultReaction,
    ) {
        let hold_until_us = match reaction {
            FaultReaction::Ramp | FaultReaction::Hold => {
                Some(now_us.saturating_add(params.hold_us))
            }
            FaultReaction::Off => None,
        };
        self.state = State::Fault {
            fault,
            hold_until_us,
        };
    }
}

/// The numbers of a start order.
fn check_start(
    params: &SupervisorParams,
    duration_us: u64,
    countdown_us: u64,
    lease_us: Option<u64>,
) -> Result<(), Refusal> {
    if duration_us == 0 || duration_us > params.duration_max_us {
        return Err(Refusal::BadDuration {
            duration_us,
            max_us: params.duration_max_us,
        });
    }
    if countdown_us > params.arm_max_us {
        return Err(Refusal::BadCountdown {
            countdown_us,
            max_us: params.arm_max_us,
        });
    }
    let (min_us, max_us) = params.lease_us;
    match lease_us {
        Some(lease_us) if lease_us < min_us || lease_us > max_us => Err(Refusal::BadLease {
            lease_us,
            min_us,
            max_us,
        }),
        _ => Ok(()),
    }
}
