//! Robots drawn at random inside the ranges of the paper's Table II, for experiments in which the truth is known to nobody
//! who fits.
//!
//! A drawn robot is a model and a scenario that names it. The body takes the rows for contact, masses and damping, and the
//! motors those for speed, torque and gain by [`motors_of`]: still geared DC motors behind a driver's position loop, not
//! the servo of the simulator.

use std::fmt::Write as _;

use files::model::{Key, Model};

use crate::motor::{JointKind, JointParams};
use crate::rng::Rng;
use crate::world::WorldParams;

/// Stream number of drawn rows.
const PURPOSE_ROW: u64 = 0xD2;
/// Stream number of what is drawn beside Table II.
const PURPOSE_LAB: u64 = 0xD3;

/// A robot whose 22 rows of Table II are uniform in their ranges, each from a stream of its own. The last row, the time
/// shift, is 0: recordings are synchronised by the first motion, and what a fit finds there is a check.
#[must_use]
pub fn model(seed: u64) -> Model {
    let mut model = Model::hand_tuned();
    model.set_name(&format!("drawn from Table II, seed {seed}"));
    for (row, key) in Key::TABLE_II.into_iter().enumerate() {
        let (low, high) = key.info().search;
        let share = Rng::new(seed, PURPOSE_ROW, row as u64).uniform();
        let value = match key {
            Key::CameraTimeShift => 0.0,
            _ => low + share * (high - low),
        };
        // The range of the search lies inside the accepted one.
        let _ = model.set(key, value);
    }
    model
}

/// The scenario of a drawn robot: on the ground, motors of the model in `model_file`, camera, tracker and inertial sensor
/// beside it, a camera clock that nobody knows, and noise that makes repeats differ.
#[must_use]
pub fn scenario_toml(model: &Model, model_file: &str, seed: u64) -> String {
    let mut rng = Rng::new(seed, PURPOSE_LAB, 0);
    let ahead_s = 60.0 * rng.uniform();
    // Crystals of cheap cameras and controllers: within 50 ppm.
    let ratio = 1.0 + 5e-5 * (2.0 * rng.uniform() - 1.0);
    let mut text = format!(
        "format = 1\nname = \"{}\"\nseed = {seed}\nbody = \"ground\"\nmodel = \"{model_file}\"\nmotor = \"model\"\n",
        model.name()
    );
    // Chosen: 1 % of the nominal torque, a foot's width of placing by hand.
    text.push_str("\n[noise]\ndisturbance_nm = 0.04\n");
    text.push_str("\n[start]\nsigma_m = 0.003\nsigma_deg = 1.0\n");
    let _ = write!(
        text,
        "\n[camera]\nheight_m = {}\nclock_ahead_s = {ahead_s:.3}\nclock_ratio = {ratio:.7}\n",
        model.value(Key::CameraHeight)
    );
    text.push_str("\n[tracker]\n\n[imu]\n");
    text
}

/// Largest motor torque as a share of the stall torque. Chosen: half, so that at half the no-load speed the limit can
/// still be held.
const LIMIT_OF_STALL: f64 = 0.5;
/// Rate of the speed loop on the rotor alone [1/s]: that of the catalogue motors behind their default gain,
/// 0.8 s/rad x 27 N m / 0.054 kg m2.
const SPEED_LOOP_1_S: f64 = 400.0;

/// Makes the motors of a meta-module those of the model's rows 13 to 20: no-load speed at 12 V, torque limit, position
/// gain. Winding and torque constant follow from speed and torque; rotor, gear, friction and heat stay the catalogue's.
/// The damping rows act in the body.
pub fn motors_of(model: &Model, world: &mut WorldParams) {
    for (setup, kind) in world.joints.iter_mut().zip(JointKind::METAMODULE) {
        let [speed, torque, gain] = match kind {
            JointKind::Intra => [Key::IntraSpeed, Key::IntraTorque, Key::IntraGain],
            JointKind::Inter => [Key::InterSpeed, Key::InterTorque, Key::InterGain],
        }
        .map(|key| model.value(key));
        let control = &mut setup.driver.control;
        control.kp_1_s = gain;
        let stall_nm = torque / LIMIT_OF_STALL;
        let inertia_kg_m2 = setup.joint.motor.reflected_inertia_kg_m2();
        control.kv_s_rad = SPEED_LOOP_1_S * inertia_kg_m2 / stall_nm;
        rewind(&mut setup.joint, speed, torque, stall_nm);
    }
}

/// Another winding on the same rotor.
fn rewind(joint: &mut JointParams, no_load_rad_s: f64, limit_nm: f64, stall_nm: f64) {
    let motor = &mut joint.motor;
    motor.kt_nm_a = motor.nominal_v / (no_load_rad_s * motor.ratio);
    let resistance_ohm = motor.kt_nm_a * motor.ratio * motor.nominal_v / stall_nm;
    // The electrical time constant stays.
    motor.inductance_h *= resistance_ohm / motor.resistance_ohm;
    motor.resistance_ohm = resistance_ohm;
    motor.nominal_torque_nm = limit_nm;
    joint.electrical.torque_limit_nm = limit_nm;
    // The copper of a stronger winding carries its nominal torque as warm as the catalogue's does.
    let heat_w = |amps: f64, ohm: f64| amps * amps * ohm;
    let amps = limit_nm / (motor.kt_nm_a * motor.ratio);
    let share = NOMINAL_HEAT_W / heat_w(amps, resistance_ohm).max(NOMINAL_HEAT_W);
    joint.thermal.winding_case_k_w *= share;
    joint.thermal.case_ambient_k_w *= share;
}

/// Heat of the catalogue's intra-cube motor at its nominal torque [W]: (4.9 N m / 305 / 14.1 mN m/A)^2 x 1.9 ohm.
const NOMINAL_HEAT_W: f64 = 2.5;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario;

    #[test]
    fn drawn_rows_lie_in_their_ranges_and_differ_by_seed() {
        let (a, b) = (model(1), model(2));
        assert_eq!(a, model(1));
        for key in Key::TABLE_II {
            let (low, high) = key.info().search;
            for m in [&a, &b] {
                let value = m.value(key);
                assert!(
                    value >= low && value <= high,
                    "{}: {value}",
                    key.info().path()
                );
            }
            let fixed = key == Key::CameraTimeShift;
            assert_eq!(a.value(key) == b.value(key), fixed, "{}", key.info().path());
        }
    }

    /// Every drawn motor has the speed and torque it was drawn with, and passes the checks of a joint.
    #[test]
    fn motors_have_the_drawn_speed_and_torque() {
        for seed in 0..50 {
            let model = model(seed);
            let text = scenario_toml(&model, "robot.toml", seed);
            let mut scenario = scenario::parse("drawn", &text).unwrap();
            assert_eq!(scenario.model_file.as_deref(), Some("robot.toml"));
            scenario.model = model.clone();
            let world = scenario.motors();
            let intra = &world.joints[0].joint;
            intra.validate().unwrap();
            let speed = intra.motor.no_load_speed_rad_s(12.0);
            assert!((speed / model.value(Key::IntraSpeed) - 1.0).abs() < 1e-12);
            assert_eq!(
                world.joints[1].joint.electrical.torque_limit_nm,
                model.value(Key::InterTorque)
            );
            scenario.build().unwrap();
        }
    }
}
