//! The supervisor: every state with every event, and invariants over random sequences.

use control::supervisor::{
    ALL_JOINTS, Event, Fault, Motion, Order, Refusal, State, StopPhase, StopReason, Supervisor,
    SupervisorParams,
};
use proptest::prelude::*;

const P: SupervisorParams = SupervisorParams {
    joints: 6,
    duration_max_us: 3_600_000_000,
    lease_us: (100_000, 60_000_000),
    arm_max_us: 30_000_000,
    ramp_max_us: 4_000_000,
    hold_us: 1_000_000,
};
const START: Event = Event::Order(Order::Start {
    duration_us: 30_000_000,
    countdown_us: 0,
    lease_us: None,
});
const STOP: Event = Event::Order(Order::Stop);
const CLEAR: Event = Event::Order(Order::ClearFault);
const HOME: Event = Event::Order(Order::Home {
    joint_mask: ALL_JOINTS,
});
const RAMP: Event = Event::Fault(Fault::LowBattery);
const HOLD: Event = Event::Fault(Fault::DriverLost { joint: 2 });
const OFF: Event = Event::Fault(Fault::BusLost);
const PRESS: Event = Event::StopInput { pressed: true };
const RELEASE: Event = Event::StopInput { pressed: false };

/// One letter per kind of state: Boot, Unhomed, Idle, Armed, Run, Ramp, Hold (of a stop), ramp and hold with a fault as reason (r, h),
/// Fault holding (F), Fault with torque off (f), EStop.
fn letter(state: State) -> char {
    let by_fault = |reason, fault, other| {
        if matches!(reason, StopReason::Fault(_)) {
            fault
        } else {
            other
        }
    };
    match state {
        State::Boot => 'B',
        State::Unhomed => 'U',
        State::Idle => 'I',
        State::Armed { .. } => 'A',
        State::Run { .. } => 'R',
        State::Stopping {
            reason,
            phase: StopPhase::Ramp { .. },
        } => by_fault(reason, 'm', 'M'),
        State::Stopping {
            reason,
            phase: StopPhase::Hold { .. },
        } => by_fault(reason, 'h', 'H'),
        State::Fault {
            hold_until_us: Some(_),
            ..
        } => 'F',
        State::Fault {
            hold_until_us: None,
            ..
        } => 'f',
        State::EStop => 'E',
    }
}

fn after(events: &[Event]) -> Supervisor {
    let mut s = Supervisor::new();
    for e in events {
        s.step(&P, 1_000, *e);
    }
    s
}

/// The ways into each state, from reset.
fn ways() -> Vec<(&'static str, Supervisor)> {
    let idle = [Event::Booted, HOME];
    let run = [Event::Booted, HOME, START, Event::InPosition];
    let with = |base: &[Event], more: &[Event]| after(&[base, more].concat());
    vec![
        ("B", after(&[])),
        ("U", after(&[Event::Booted])),
        ("I", after(&idle)),
        ("A", with(&idle, &[START])),
        ("R", after(&run)),
        ("M", with(&run, &[STOP])),
        ("H", with(&run, &[STOP, Event::Settled])),
        ("m", with(&run, &[RAMP])),
        ("h", with(&run, &[RAMP, Event::Settled])),
        ("F", with(&run, &[HOLD])),
        ("f", with(&run, &[OFF])),
        ("E", with(&run, &[PRESS])),
        ("E released", with(&run, &[PRESS, RELEASE])),
    ]
}

/// Rows: events; columns: the ways in their order. The letter is the state after the event, `!` before it a refusal.
const TABLE: [(&str, Event, u64, [&str; 13]); 17] = [
    (
        "Booted",
        Event::Booted,
        1_000,
        [
            "U", "U", "I", "A", "R", "M", "H", "m", "h", "F", "f", "E", "E",
        ],
    ),
    (
        "Start",
        START,
        1_000,
        [
            "!B", "!U", "A", "!A", "!R", "!M", "!H", "!m", "!h", "!F", "!f", "!E", "!E",
        ],
    ),
    (
        "Stop",
        STOP,
        1_000,
        [
            "B", "U", "I", "H", "M", "M", "H", "m", "h", "F", "f", "E", "E",
        ],
    ),
    (
        "ClearFault",
        CLEAR,
        1_000,
        [
            "!B", "!U", "!I", "!A", "!R", "!M", "!H", "!m", "!h", "I", "I", "!E", "I",
        ],
    ),
    (
        "Home",
        HOME,
        1_000,
        [
            "!B", "I", "I", "!A", "!R", "!M", "!H", "!m", "!h", "!F", "!f", "!E", "!E",
        ],
    ),
    (
        "Home of no joint",
        Event::Order(Order::Home { joint_mask: 0x40 }),
        1_000,
        [
            "!B", "!U", "!I", "!A", "!R", "!M", "!H", "!m", "!h", "!F", "!f", "!E", "!E",
        ],
    ),
    ("pressed", PRESS, 1_000, ["E"; 13]),
    (
        "released",
        RELEASE,
        1_000,
        [
            "B", "U", "I", "A", "R", "M", "H", "m", "h", "F", "f", "E", "E",
        ],
    ),
    (
        "fault, ramp",
        RAMP,
        1_000,
        [
            "f", "f", "f", "F", "m", "F", "F", "m", "h", "F", "f", "E", "E",
        ],
    ),
    (
        "fault, hold",
        HOLD,
        1_000,
        [
            "f", "f", "f", "F", "F", "F", "F", "F", "F", "F", "f", "E", "E",
        ],
    ),
    (
        "fault, off",
        OFF,
        1_000,
        [
            "f", "f", "f", "f", "f", "f", "f", "f", "f", "f", "f", "E", "E",
        ],
    ),
    (
        "DriverReset",
        Event::DriverReset { joint: 1 },
        1_000,
        [
            "B", "U", "U", "F", "F", "F", "F", "F", "F", "F", "f", "E", "E",
        ],
    ),
    (
        "InPosition",
        Event::InPosition,
        1_000,
        [
            "B", "U", "I", "R", "R", "M", "H", "m", "h", "F", "f", "E", "E",
        ],
    ),
    (
        "ApproachBlocked",
        Event::ApproachBlocked,
        1_000,
        [
            "B", "U", "I", "H", "R", "M", "H", "m", "h", "F", "f", "E", "E",
        ],
    ),
    (
        "Settled",
        Event::Settled,
        1_000,
        [
            "B", "U", "I", "A", "R", "H", "H", "h", "h", "F", "f", "E", "E",
        ],
    ),
    (
        "Tick",
        Event::Tick,
        1_000,
        [
            "B", "U", "I", "A", "R", "M", "H", "m", "h", "F", "f", "E", "E",
        ],
    ),
    (
        "Tick, late",
        Event::Tick,
        u64::MAX,
        [
            "B", "U", "I", "H", "M", "H", "I", "h", "f", "f", "f", "E", "E",
        ],
    ),
];

#[test]
fn every_state_with_every_event() {
    for (name, event, now_us, row) in TABLE {
        for ((way, start), want) in ways().into_iter().zip(row) {
            assert_eq!(letter(start.state()), way.chars().next().expect("letter"));
            let mut s = start;
            let t = s.step(&P, now_us, event);
            let found = format!(
                "{}{}",
                if t.refusal.is_some() { "!" } else { "" },
                letter(s.state())
            );
            assert_eq!(found, want, "{way} with {name}: {t:?}");
            assert_eq!((t.from, t.to), (start.state(), s.state()));
            assert!(
                t.refusal.is_none() || t.from == t.to,
                "a refused order changes nothing"
            );
        }
    }
}

#[test]
fn a_second_fault_worse_than_the_first_ends_its_hold() {
    // Holding after a lost driver, then the whole bus is lost: pushing on blindly is no longer safe.
    let mut s = after(&[Event::Booted, HOME, START, Event::InPosition, HOLD]);
    s.step(&P, 2_000, OFF);
    assert_eq!(
        s.state(),
        State::Fault {
            fault: Fault::DriverLost { joint: 2 },
            hold_until_us: None
        }
    );
}

#[test]
fn refusals_say_why() {
    let refusal = |events: &[Event], last| after(events).clone().step(&P, 1_000, last).refusal;
    assert_eq!(refusal(&[], START), Some(Refusal::Booting));
    let half = Event::Order(Order::Home { joint_mask: 0b1011 });
    assert_eq!(
        refusal(&[Event::Booted, half], START),
        Some(Refusal::NotHomed {
            missing_mask: 0b11_0100
        })
    );
    assert_eq!(
        refusal(&[Event::Booted, OFF], START),
        Some(Refusal::FaultLatched(Fault::BusLost))
    );
    assert_eq!(
        refusal(&[Event::Booted, PRESS], CLEAR),
        Some(Refusal::StopInputPressed)
    );
    let long = Event::Order(Order::Start {
        duration_us: u64::MAX,
        countdown_us: 0,
        lease_us: None,
    });
    assert!(matches!(
        refusal(&[Event::Booted, HOME], long),
        Some(Refusal::BadDuration { .. })
    ));
    let none = Event::Order(Order::Start {
        duration_us: 0,
        countdown_us: 0,
        lease_us: None,
    });
    assert!(matches!(
        refusal(&[Event::Booted, HOME], none),
        Some(Refusal::BadDuration { .. })
    ));
    let slow = Event::Order(Order::Start {
        duration_us: 1,
        countdown_us: u64::MAX,
        lease_us: None,
    });
    assert!(matches!(
        refusal(&[Event::Booted, HOME], slow),
        Some(Refusal::BadCountdown { .. })
    ));
}

#[test]
fn the_whole_course_of_a_run() {
    let mut s = after(&[Event::Booted, HOME]);
    let start = Event::Order(Order::Start {
        duration_us: 30_000_000,
        countdown_us: 3_000_000,
        lease_us: None,
    });
    s.step(&P, 10_000_000, start);
    s.step(&P, 12_999_999, Event::InPosition);
    assert_eq!(letter(s.state()), 'A', "the countdown is not over");
    s.step(&P, 13_000_000, Event::InPosition);
    assert_eq!(
        s.state(),
        State::Run {
            until_us: 43_000_000
        }
    );
    s.step(&P, 42_999_999, Event::Tick);
    assert_eq!(s.command().motion, Motion::Run);
    s.step(&P, 43_000_000, Event::Tick);
    assert_eq!(s.command().motion, Motion::Ramp);
    s.step(&P, 45_000_000, Event::Settled);
    assert_eq!(s.command().motion, Motion::Hold);
    assert!(s.command().torque);
    s.step(&P, 46_000_000, Event::Tick);
    assert_eq!(s.state(), State::Idle);
    assert!(!s.command().torque);
}

#[test]
fn a_tethered_run_goes_on_as_long_as_it_hears_a_heartbeat() {
    let start = Event::Order(Order::Start {
        duration_us: 30_000_000,
        countdown_us: 3_000_000,
        lease_us: Some(1_000_000),
    });
    let beat = Event::Order(Order::Heartbeat);
    for armed in [true, false] {
        let mut s = after(&[Event::Booted, HOME]);
        s.step(&P, 10_000_000, start);
        let mut now_us = 10_000_000;
        while now_us < 20_000_000 {
            now_us += 999_999;
            s.step(&P, now_us, Event::Tick);
            let before = s.state();
            if !armed {
                s.step(&P, now_us, Event::InPosition);
            }
            assert_eq!(s.step(&P, now_us, beat).refusal, None);
            assert!(matches!(before, State::Armed { .. } | State::Run { .. }));
        }
        s.step(&P, now_us + 999_999, Event::Tick);
        assert_eq!(letter(s.state()), if armed { 'A' } else { 'R' });
        s.step(&P, now_us + 1_000_000, Event::Tick);
        assert!(matches!(
            s.state(),
            State::Stopping {
                reason: StopReason::LeaseOver,
                ..
            }
        ));
        assert_eq!(letter(s.state()), if armed { 'H' } else { 'M' });
        assert_eq!(
            s.step(&P, now_us + 1_000_001, beat).refusal,
            Some(Refusal::NotTethered),
            "a lease that ran out is not renewed"
        );
    }
}

#[test]
fn a_heartbeat_starts_nothing_and_a_lease_has_its_range() {
    let beat = Event::Order(Order::Heartbeat);
    for (way, start) in ways() {
        let mut s = start;
        let t = s.step(&P, 1_000, beat);
        assert_eq!(t.refusal, Some(Refusal::NotTethered), "{way}");
        assert_eq!(t.from, t.to, "{way}");
    }
    for lease_us in [0, 99_999, 60_000_001, u64::MAX] {
        let start = Event::Order(Order::Start {
            duration_us: 1,
            countdown_us: 0,
            lease_us: Some(lease_us),
        });
        let mut s = after(&[Event::Booted, HOME]);
        let t = s.step(&P, 1_000, start);
        assert!(matches!(t.refusal, Some(Refusal::BadLease { .. })));
        assert_eq!(letter(t.to), 'I');
    }
    // The lease of one run does not reach into the next.
    let tethered = Event::Order(Order::Start {
        duration_us: 30_000_000,
        countdown_us: 0,
        lease_us: Some(100_000),
    });
    let mut s = after(&[
        Event::Booted,
        HOME,
        tethered,
        Event::InPosition,
        PRESS,
        RELEASE,
        CLEAR,
    ]);
    s.step(&P, 2_000, START);
    s.step(&P, 2_000, Event::InPosition);
    s.step(&P, 5_000_000, Event::Tick);
    assert_eq!(letter(s.state()), 'R', "autonomous");
}

fn any_event() -> impl Strategy<Value = Event> {
    let joint = 0u8..8;
    let fault = (0u8..6, joint.clone()).prop_map(|(k, joint)| {
        Event::Fault(match k {
            0 => Fault::LowBattery,
            1 => Fault::DriverLost { joint },
            2 => Fault::BusLost,
            3 => Fault::Stall { joint },
            4 => Fault::Overrun,
            _ => Fault::BadSetPoint,
        })
    });
    prop_oneof![
        2 => Just(Event::Booted),
        6 => (0u64..100_000_000, 0u64..2_000_000).prop_map(|(duration_us, countdown_us)| Event::Order(Order::Start { duration_us, countdown_us, lease_us: None })),
        2 => Just(STOP),
        4 => Just(CLEAR),
        4 => prop_oneof![Just(ALL_JOINTS), any::<u16>()].prop_map(|joint_mask| Event::Order(Order::Home { joint_mask })),
        1 => Just(PRESS),
        2 => Just(RELEASE),
        1 => fault,
        1 => joint.prop_map(|joint| Event::DriverReset { joint }),
        6 => Just(Event::InPosition),
        1 => Just(Event::ApproachBlocked),
        2 => Just(Event::Settled),
        8 => Just(Event::Tick),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn invariants_hold_over_any_sequence(events in prop::collection::vec((any_event(), 0u64..3_000_000), 1..120)) {
        let mut s = Supervisor::new();
        let mut now_us = 0u64;
        let mut pressed = false;
        for (event, dt_us) in events {
            now_us += dt_us;
            let (before, homed) = (s, s.homed_mask());
            let t = s.step(&P, now_us, event);
            let (from, to) = (letter(t.from), letter(t.to));
            if let Event::StopInput { pressed: p } = event { pressed = p; }
            prop_assert!(!pressed || t.to == State::EStop, "a pressed input beats everything");
            if to == 'A' && from != 'A' {
                let started = matches!(event, Event::Order(Order::Start { .. }));
                prop_assert!(started && from == 'I' && homed == ALL_JOINTS);
            }
            if to == 'R' && from != 'R' {
                prop_assert!(from == 'A' && event == Event::InPosition);
            }
            if to == 'M' || to == 'm' {
                prop_assert!(from == 'R' || from == to, "only a running gait is ramped down");
            }
            if matches!(t.to.command().motion, Motion::Approach | Motion::Run) {
                prop_assert_eq!(s.homed_mask(), ALL_JOINTS);
            }
            if event == STOP {
                prop_assert!(t.refusal.is_none() && to != 'A' && to != 'R');
            }
            if let Event::DriverReset { joint } = event {
                prop_assert!(joint > 5 || s.homed_mask() & (1 << joint) == 0);
                prop_assert!(to != 'A' && to != 'R' && to != 'I');
            }
            if let (State::Fault { fault: a, .. }, State::Fault { fault: b, .. }) = (t.from, t.to) {
                prop_assert_eq!(a, b, "the first fault is kept");
            }
            if matches!(event, Event::Fault(_)) {
                prop_assert!(!matches!(to, 'A' | 'R' | 'I' | 'U' | 'B'));
            }
            prop_assert!(t.refusal.is_none() || s == before);
            prop_assert!(t.to.command().torque || t.to.command().motion == Motion::None);
        }
        // Liveness: faults gone, the robot can be used again by orders alone.
        for event in [RELEASE, Event::Booted, STOP] {
            s.step(&P, now_us, event);
        }
        for _ in 0..3 {
            now_us += 5_000_000;
            s.step(&P, now_us, Event::Tick);
        }
        for event in [CLEAR, HOME, START] {
            s.step(&P, now_us, event);
        }
        prop_assert_eq!(letter(s.state()), 'A');
    }
}
