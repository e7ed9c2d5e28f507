//! `control` with numbers from the wire.

use crate::{Hostile, sink};
use control::gait::{self, Gait, Link, Oscillator, RawGait};
use control::machine::{Angles, Contact, Machine, all_joints};
use control::motion::{MotionParams, MotionSettings, Planner};
use control::precheck::{self, Margins};
use control::robot::{JointLimits, RobotModel, RobotParams};
use control::supervisor::{Event, Fault, Motion, Order, Supervisor, SupervisorParams};
use control::{cpg, geometry, kinematics, linalg, math};

pub(crate) fn drive(h: &mut Hostile) {
    mathematics(h);
    let Some(model) = robot(h) else { return };
    poses(h, &model);
    supervise(h);
    let (Some(first), Some(second)) = (some_gait(h), some_gait(h)) else {
        return;
    };
    oscillators(h, &first, &second);
    plan(h, model, &first, &second);
}

fn mathematics(h: &mut Hostile) {
    sink(math::sin_cos(h.float()));
    sink((
        math::sin(h.float()),
        math::cos(h.float()),
        math::wrap_pi(h.float()),
        math::sqrt(h.float()),
    ));
}

fn robot(h: &mut Hostile) -> Option<RobotModel> {
    let mut joints = [JointLimits {
        no_load_speed_rad_s: 0.0,
    }; 6];
    for j in &mut joints {
        j.no_load_speed_rad_s = h.float();
    }
    RobotModel::new(RobotParams {
        twist_rad: h.float(),
        cube_m: h.float(),
        ball_radius_m: h.float(),
        joints,
    })
    .ok()
}

fn poses(h: &mut Hostile, model: &RobotModel) {
    let poses = kinematics::forward(model, &h.floats());
    let base = linalg::Pose::default();
    let moved = poses.rebased(h.word() as usize, &base);
    sink((
        moved.cube_centres_m(),
        moved.end_face_m(),
        moved.bodies().map(|b| b.rotation.to_quaternion()),
    ));
    sink(geometry::half_spheres(model));
    sink(precheck::clearance(model, &h.floats()));
    sink(precheck::swept(model, &h.floats(), &h.floats(), h.float()));
    let margins = Margins {
        keep_m: h.float(),
        escape_m: h.float(),
    };
    sink(precheck::check_move(
        model,
        &h.floats(),
        &h.floats(),
        margins,
    ));
}

pub(crate) fn some_gait(h: &mut Hostile) -> Option<Gait> {
    let mut raw = RawGait {
        frequency_hz: h.float(),
        rate_a_per_s: h.float(),
        duration_s: h.float(),
        ..RawGait::default()
    };
    for _ in 0..h.byte() {
        let [amplitude_rad, offset_rad, initial_phase_rad] = h.floats();
        let _ = raw.oscillators.push(Oscillator {
            amplitude_rad,
            offset_rad,
            initial_phase_rad,
        });
    }
    for _ in 0..h.byte() {
        let _ = raw.links.push(Link {
            from: h.byte(),
            to: h.byte(),
            weight: h.float(),
            phase_lag_rad: h.float(),
        });
    }
    if let Ok(text) = core::str::from_utf8(&h.bytes::<16>()) {
        let _ = raw.name.push_str(text);
    }
    if h.byte() > 9 {
        raw.links = gait::chain(h.float(), &h.floats::<11>());
        raw.lock_phases();
    }
    Gait::try_from(raw).ok()
}

fn oscillators(h: &mut Hostile, first: &Gait, second: &Gait) {
    let mut state = cpg::start(first);
    for _ in 0..h.byte() {
        sink(cpg::step(first, &mut state, h.float()).joints());
    }
    sink(cpg::retarget(second, &state));
    cpg::advance(second, &mut state, h.float(), h.float());
    sink(state.set_points());
}

/// One to twelve angles.
fn angles(h: &mut Hostile) -> Option<Angles> {
    let count = usize::from(h.byte());
    Angles::new(h.floats::<12>().get(..count)?)
}

fn machine(h: &mut Hostile, model: RobotModel) -> Option<Machine> {
    let contact = match h.byte() {
        0 => Contact::MetaModule(model),
        1 => Contact::Module,
        2 => Contact::Unchecked,
        _ => Contact::Unstated,
    };
    let limits = h.floats::<13>().map(|no_load_speed_rad_s| JointLimits {
        no_load_speed_rad_s,
    });
    let count = usize::from(h.byte());
    Machine::new(limits.get(..count)?, contact).ok()
}

fn plan(h: &mut Hostile, model: RobotModel, first: &Gait, second: &Gait) {
    let settings = MotionSettings {
        lookahead_cycles: h.byte(),
        planned: Margins {
            keep_m: h.float(),
            escape_m: h.float(),
        },
        measured: Margins {
            keep_m: h.float(),
            escape_m: h.float(),
        },
        approach_ratio: h.float(),
    };
    let Some(machine) = machine(h, model) else {
        return;
    };
    sink((machine.all_joints(), all_joints(h.byte())));
    let Ok(params) = MotionParams::new(machine, settings) else {
        return;
    };
    let Some(pose) = angles(h) else { return };
    let Ok(mut planner) = Planner::begin(&params, first, &pose) else {
        return;
    };
    for _ in 0..h.byte() {
        let motion = match h.byte() {
            0 => Motion::None,
            1 => Motion::Approach,
            2 => Motion::Run,
            3 => Motion::Ramp,
            _ => Motion::Hold,
        };
        let measured = if h.byte() > 7 { angles(h) } else { None };
        sink(planner.cycle(&params, motion, measured.as_ref()));
        if h.byte() == 3 {
            sink(planner.retarget(&params, second).is_ok());
        }
    }
    sink((
        planner.held_cycles(),
        planner.holds(),
        planner.gait().check_speed(params.machine().limits()),
    ));
}

fn event(h: &mut Hostile) -> Event {
    let joint = h.byte();
    match h.byte() {
        0 => Event::Booted,
        1 => Event::Order(Order::Start {
            duration_us: h.time(),
            countdown_us: h.time(),
            lease_us: (h.byte() > 7).then(|| h.time()),
        }),
        2 => Event::Order(Order::Stop),
        3 => Event::Order(Order::ClearFault),
        4 => Event::Order(Order::Home {
            joint_mask: h.word() as u16,
        }),
        5 => Event::StopInput {
            pressed: h.byte() > 0,
        },
        6 => Event::Fault(Fault::DriverError {
            joint,
            bits: h.byte(),
        }),
        7 => Event::Fault(Fault::LowBattery),
        8 => Event::Fault(Fault::BusLost),
        9 => Event::DriverReset { joint },
        10 => Event::InPosition,
        11 => Event::ApproachBlocked,
        12 => Event::Settled,
        13 => Event::Order(Order::Heartbeat),
        _ => Event::Tick,
    }
}

fn supervise(h: &mut Hostile) {
    let params = SupervisorParams {
        joints: h.byte(),
        duration_max_us: h.time(),
        lease_us: (h.time(), h.time()),
        arm_max_us: h.time(),
        ramp_max_us: h.time(),
        hold_us: h.time(),
    };
    let mut supervisor = Supervisor::new();
    for _ in 0..h.byte() {
        let (now_us, event) = (h.time(), event(h));
        sink(supervisor.step(&params, now_us, event).changed());
        sink((supervisor.command(), supervisor.homed_mask()));
    }
}
