//! Runs one gait on one emulated joint and writes down what a bench would measure.

use core::f64::consts::TAU;

use super::{JOINT, Plan, Planted};
use hil_sim::body::{Stand, StandJoint};
use hil_sim::driver::control::ControlState;
use hil_sim::driver::transport::Transport;
use hil_sim::motor::Bridge;
use hil_sim::plant::Plant;
use hil_sim::rng::Rng;
use hil_sim::world::{JointSetup, WorldParams};

/// Channels of a row: encoder, current, duty, bus, link, applied set-point.
pub(super) const CHANNELS: usize = 6;

/// Columns of the channels, and their digits.
pub(super) const NAMES: [&str; CHANNELS] = [
    "position_rad",
    "current_a",
    "duty",
    "bus_v",
    "link_position_rad",
    "applied_setpoint_rad",
];
pub(super) const DIGITS: [usize; CHANNELS] = [6, 4, 4, 3, 6, 6];

/// One row of a recording.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Row {
    pub(super) t_s: f64,
    pub(super) setpoint_rad: f64,
    pub(super) channels: [f64; CHANNELS],
}

const STEP_NS: u64 = 50_000;
/// Plant steps per driver tick (1 ms), ticks per row (10 ms) and per set-point (50 ms).
const STEPS: u64 = 20;
pub(super) const ROW_TICKS: u64 = 10;
const SEND_TICKS: u64 = 50;
/// Length of a run, ms.
const TICKS: u64 = 8000;

/// Resolution or noise of what a bench measures: encoder 1 mrad/8192-step class, 5 mA, 0.2 % duty, 20 mV.
pub(super) const NOISE: [f64; CHANNELS] = [2.0e-4, 5.0e-3, 2.0e-3, 0.02, 3.0e-4, 0.0];

/// Set-point of gait `gait` at `t_s`.
fn wave(gait: usize, t_s: f64, rng: &[f64]) -> f64 {
    let (a, b, c) = (rng[0], rng[1], rng[2]);
    match gait % 6 {
        0 => (0.5 + 0.4 * a) * libm::sin(TAU * (0.2 + 0.2 * b) * t_s) + 0.3 * (c - 0.5),
        1 => (0.3 + 0.3 * a) * libm::sin(TAU * (0.4 + 0.4 * b) * t_s) + 0.8 * c,
        // Chirp from 0.1 Hz to about 1.5 Hz.
        2 => (0.2 + 0.15 * a) * libm::sin(TAU * (0.1 + 0.09 * t_s) * t_s) - 0.4 * b,
        // Steps up and down.
        3 => {
            let k = (t_s / (1.0 + 0.3 * a)) as u64;
            [0.0, 0.5, -0.3, 0.8, 0.1, -0.6, 0.3, 0.0][(k % 8) as usize] * (0.6 + 0.4 * b)
        }
        // Slow triangle.
        4 => {
            let period = 4.0 + 3.0 * a;
            let x = t_s / period - libm::floor(t_s / period);
            (0.6 + 0.4 * b) * (1.0 - 4.0 * (x - 0.5).abs()) * if c > 0.5 { 1.0 } else { -1.0 }
        }
        _ => {
            0.4 * (0.5 + a) * libm::sin(TAU * 0.23 * t_s)
                + 0.25 * (0.5 + b) * libm::sin(TAU * 0.61 * t_s + TAU * c)
                + 0.1 * libm::sin(TAU * 1.1 * t_s)
        }
    }
}

/// World of a case, and the faults of the set-point path, which are applied here.
fn world(plan: &Plan, planted: &[Planted]) -> (WorldParams, [f64; 3]) {
    let mut world = WorldParams::metamodule(1, |_| JOINT.neutral());
    world.joints.truncate(1);
    world.supply.voltage_v = 12.0 * plan.ratios[2];
    let joint = &mut world.joints[0];
    joint.load.inertia_kg_m2 = plan.nominal_link_inertia * plan.ratios[0];
    joint.joint.inertia_ratio = plan.ratios[0];
    joint.load.gravity_nm = plan.nominal_gravity * plan.ratios[1];
    joint.joint.electrical.motor_constant_ratio = plan.ratios[3];
    joint.joint.electrical.winding_resistance_ratio = plan.ratios[4];
    joint.joint.electrical.torque_limit_nm = f64::INFINITY;
    let mut path = [1.0, 1.0, 0.0];
    for p in planted {
        for (key, value) in &p.parameters {
            plant(&mut world, &mut path, p.effect, key, *value);
        }
    }
    (world, path)
}

fn plant(world: &mut WorldParams, path: &mut [f64; 3], effect: &str, key: &str, value: f64) {
    let joint: &mut JointSetup = &mut world.joints[0];
    match effect {
        // The command reaches the driver in another convention than the recording is in.
        "joint_sign" => path[0] = value,
        "joint_scale" => path[1] = value,
        "joint_offset" => path[2] = value,
        // Ratios multiply what the tolerances drew.
        "motor_constant" => joint.joint.electrical.motor_constant_ratio *= value,
        "winding_resistance" => joint.joint.electrical.winding_resistance_ratio *= value,
        "inertia" => {
            joint.joint.inertia_ratio *= value;
            joint.load.inertia_kg_m2 *= value;
        }
        _ => {
            let known = hil_sim::effects::set(world, effect, None, key, value);
            debug_assert!(known.is_ok(), "{effect}.{key}");
        }
    }
}

/// Disturbance torque of a run: slow random walk with a time constant, as of a cable or a rubbing seal.
struct Disturbance {
    rng: Rng,
    value: f64,
    sigma_nm: f64,
}

impl hil_sim::body::Load for Disturbance {
    fn torque_nm(&mut self, _t_s: f64, _angle_rad: f64, _velocity_rad_s: f64) -> f64 {
        // Ornstein-Uhlenbeck with 0.2 s, stepped with the plant.
        let k = STEP_NS as f64 * 1e-9 / 0.2;
        self.value += -k * self.value + self.sigma_nm * libm::sqrt(2.0 * k) * self.rng.normal();
        self.value
    }
}

/// Records gait `gait`; without a repeat number there is neither disturbance nor noise.
pub(super) fn record(
    plan: &Plan,
    planted: &[Planted],
    gait: usize,
    repeat: Option<usize>,
) -> Vec<Row> {
    let (world, path) = world(plan, planted);
    let setup = &world.joints[0];
    let mut shape = Rng::new(plan.seed, 0x6A, gait as u64);
    let shape = [shape.uniform(), shape.uniform(), shape.uniform()];
    let stream = (gait * 16 + repeat.unwrap_or(15)) as u64;
    let mut noise = Rng::new(plan.seed, 0x4E, stream);
    let load = repeat.map(|_| {
        let rng = Rng::new(plan.seed, 0x44, stream);
        // 0.06 N m: the spread between repeats of real small geared joints at this load.
        Box::new(Disturbance {
            rng,
            value: 0.0,
            sigma_nm: 0.06,
        }) as Box<dyn hil_sim::body::Load>
    });
    let stand = StandJoint {
        load,
        gravity_nm: setup.load.gravity_nm,
        ..StandJoint::inertia(setup.load.inertia_kg_m2)
    };
    let mut stand = Stand::new(vec![stand]);
    let to_driver = |sp: f64| path[0] * path[1] * sp + path[2];
    let start = wave(gait, 0.0, &shape);
    stand.place(to_driver(start));
    let Ok(mut joint) = Plant::new(
        vec![setup.joint.clone()],
        world.supply.clone(),
        Box::new(stand),
        STEP_NS,
        1,
    ) else {
        return Vec::new();
    };
    let params = &setup.driver;
    let mut control = ControlState::default();
    let mut transport = Transport::new(plan.seed ^ stream, 0);
    let mut goal = to_driver(start);
    let mut sent = start;
    let mut rows = Vec::with_capacity((TICKS / ROW_TICKS) as usize);
    let clock = params.transport.clock_ratio;
    for tick in 0..TICKS {
        let t_s = tick as f64 * 1e-3;
        if tick % SEND_TICKS == 0 {
            sent = wave(gait, t_s, &shape);
            // With a skewed clock the robot plays the gait at its own rate.
            let value = wave(gait, t_s * clock, &shape);
            transport.submit(&params.transport, tick * 1_000_000, to_driver(value));
        }
        if let Some(due) = transport.due(tick * 1_000_000) {
            goal = due;
        }
        let state = &joint.states()[0];
        let seen = state.gear_rad + setup.joint.encoder_error_rad(state);
        let seen = control.measure(&params.control, seen, 1e-3);
        let duty = control.position_loop(&params.control, goal, seen, 1e-3);
        if tick % ROW_TICKS == 0 {
            let encoder = state.gear_rad + setup.joint.encoder_error_rad(state);
            let true_values = [
                encoder,
                state.current_a,
                duty,
                joint.bus_v(),
                state.link_rad,
                goal,
            ];
            let mut channels = true_values;
            if repeat.is_some() {
                channels
                    .iter_mut()
                    .zip(NOISE)
                    .for_each(|(c, n)| *c += n * noise.normal());
            }
            rows.push(Row {
                t_s,
                setpoint_rad: sent,
                channels,
            });
        }
        let bridge = Bridge {
            duty,
            enabled: true,
            limit_a: f64::INFINITY,
            bus_v: 12.0,
        };
        for _ in 0..STEPS {
            joint.step(&[bridge]);
        }
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::super::{case, plan};

    #[test]
    fn cases_repeat_by_seed_and_follow_their_composition() {
        let a = case(5, 3);
        assert_eq!(a, case(5, 3));
        assert_ne!(a.files, case(6, 3).files);
        assert_eq!(a.files.len(), 13);
        let kinds: Vec<&str> = (0..400).map(|i| plan(1, i).kind).collect();
        let share = |k: &str| kinds.iter().filter(|x| **x == k).count() as f64 / 400.0;
        // Binomial, 400 draws: 1 sigma is at most 2.5 %.
        for (kind, want) in [
            ("null", 0.25),
            ("single", 0.41),
            ("several", 0.26),
            ("outside", 0.08),
        ] {
            assert!(
                (share(kind) - want).abs() < 0.075,
                "{kind}: {}",
                share(kind)
            );
        }
    }

    #[test]
    fn every_planted_cause_shows_somewhere_and_nulls_follow_their_setpoint() {
        let mut seen = 0;
        for index in 0..16 {
            let c = case(9, index);
            for cause in &c.label.causes {
                let left = cause.delta_chi2_refitted;
                assert!(left.is_finite() && left <= cause.delta_chi2, "{cause:?}");
                seen += usize::from(left > 25.0);
            }
        }
        assert!(seen > 6, "{seen}");
    }
}
