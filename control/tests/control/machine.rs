//! Robots of other than six joints, and of what nobody checks.

use control::cpg;
use control::gait::{Gait, Oscillator, RawGait, RobotMismatch, chain};
use control::machine::{Angles, Contact, MAX_JOINTS, Machine, MachineError};
use control::motion::{BeginError, MotionParams, MotionSettings, Planner};
use control::robot::{JointLimits, RobotModel};
use control::supervisor::{
    Event, Motion, Order, Refusal, State, Supervisor, SupervisorParams, Transition,
};

const SPEED: JointLimits = JointLimits {
    no_load_speed_rad_s: 2.0,
};

fn params(joints: usize) -> MotionParams {
    let machine = Machine::new(&vec![SPEED; joints], Contact::Unchecked).expect("valid");
    MotionParams::new(machine, MotionSettings::default()).expect("valid")
}

fn wave(oscillators: usize) -> Gait {
    let one = Oscillator {
        amplitude_rad: 0.7,
        offset_rad: 0.2,
        initial_phase_rad: 0.0,
    };
    let mut raw = RawGait {
        name: "wave".try_into().expect("short"),
        frequency_hz: 0.2,
        rate_a_per_s: 2.0,
        duration_s: 10.0,
        oscillators: (0..oscillators).map(|_| one).collect(),
        links: chain(0.5, &vec![0.6; oscillators - 1]),
    };
    raw.lock_phases();
    raw.try_into().expect("valid")
}

#[test]
fn what_leaves_is_the_gait_for_any_number_of_joints() {
    for joints in 1..=MAX_JOINTS {
        let (p, g) = (params(joints), wave(joints));
        let pose = Angles::new(&vec![0.0; joints]).expect("one to twelve");
        let mut planner = Planner::begin(&p, &g, &pose).expect("begins");
        for _ in 0..200 {
            planner.cycle(&p, Motion::Approach, None).expect("sound");
        }
        let mut state = cpg::start(&g);
        for cycle in 0..200 {
            let out = planner.cycle(&p, Motion::Run, Some(&pose)).expect("sound");
            let alone = cpg::step(&g, &mut state, control::CYCLE_S);
            assert_eq!(
                out.set_point_rad.as_slice(),
                alone.as_slice(),
                "{joints} {cycle}"
            );
            assert!(!out.held);
        }
        for _ in 0..200 {
            let out = planner.cycle(&p, Motion::Ramp, None).expect("sound");
            assert_eq!(out.set_point_rad.len(), joints);
        }
        assert!(
            planner
                .cycle(&p, Motion::Ramp, None)
                .expect("sound")
                .settled
        );
    }
}

#[test]
fn another_number_of_oscillators_or_angles_is_refused() {
    let p = params(6);
    let home = Angles::from([0.0; 6]);
    let mismatch = RobotMismatch::JointCount {
        oscillators: 4,
        joints: 6,
    };
    assert_eq!(
        mismatch.to_string(),
        "the gait has 4 oscillators, the robot 6 joints"
    );
    assert_eq!(
        Planner::begin(&p, &wave(4), &home).err(),
        Some(BeginError::Mismatch(mismatch))
    );
    let few = BeginError::PoseCount {
        angles: 5,
        joints: 6,
    };
    assert_eq!(
        Planner::begin(&p, &wave(6), &[0.0; 5].into()).err(),
        Some(few)
    );
}

#[test]
fn a_machine_has_one_to_twelve_joints_of_finite_speed() {
    let new = |joints: usize, contact| Machine::new(&vec![SPEED; joints], contact);
    for joints in [0, 13, 300] {
        let error = new(joints, Contact::Unchecked).expect_err("refused");
        let shown = joints.min(255);
        assert_eq!(
            error.to_string(),
            format!("{shown} motors, allowed are 1 to 12")
        );
    }
    let model = RobotModel::default();
    for (contact, expected) in [(Contact::Module, 3), (Contact::MetaModule(model), 6)] {
        for joints in 1..=12 {
            let wrong = MachineError::WrongCount { joints, expected };
            let expected = (joints != expected).then_some(wrong);
            assert_eq!(new(usize::from(joints), contact).err(), expected);
        }
    }
    for value_rad_s in [f32::NAN, f32::INFINITY, 0.0, -1.0, 20.1] {
        let limits = [
            SPEED,
            JointLimits {
                no_load_speed_rad_s: value_rad_s,
            },
        ];
        let error = Machine::new(&limits, Contact::Unstated);
        assert!(matches!(error, Err(MachineError::Speed { joint: 1, .. })));
    }
}

#[test]
fn all_joints_of_the_robot_have_to_be_homed_and_no_other_ones() {
    for joints in 1..=12_u8 {
        let p = SupervisorParams {
            joints,
            ..SupervisorParams::default()
        };
        let all = control::machine::all_joints(joints);
        let mut supervisor = Supervisor::new();
        supervisor.step(&p, 0, Event::Booted);
        let mut home = |joint_mask| -> Transition {
            supervisor.step(&p, 0, Event::Order(Order::Home { joint_mask }))
        };
        let joint_mask = all + 1;
        let refusal = Some(Refusal::BadJointMask { joint_mask });
        assert_eq!(home(joint_mask).refusal, refusal);
        if joints > 1 {
            assert_eq!(home(all >> 1).to, State::Unhomed);
        }
        assert_eq!(home(1 << (joints - 1)).to, State::Idle);
        let joint = joints - 1;
        let lost = supervisor.step(&p, 0, Event::DriverReset { joint });
        assert_eq!(lost.to, State::Unhomed);
        assert_eq!(supervisor.homed_mask(), all >> 1);
    }
}
