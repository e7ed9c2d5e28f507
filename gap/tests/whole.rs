//! The whole-robot diagnosis on recordings of a stand-in that is stepped and parametrised otherwise.

mod robot;

use files::model::{Effect, Model};
use gap::whole::{Settings, diagnose};
use robot::{Plan, Reality, record};

#[test]
fn debug() {
    let cases: Vec<(&str, Reality)> = vec![
        ("null", Reality::default()),
        ("latency 0.1 on 2", Reality::with(|m| m.set_effect(Effect::Latency, Some(2), &[0.1]).unwrap())),
        ("coulomb 0.5 on 1", Reality::with(|m| m.set_effect(Effect::CoulombFriction, Some(1), &[0.5]).unwrap())),
        ("offset 0.05 on 3", Reality::with(|m| m.set_effect(Effect::JointOffset, Some(3), &[0.05]).unwrap())),
        ("torque limit 1.0 on 2", Reality::with(|m| m.set_effect(Effect::TorqueLimit, Some(2), &[1.0]).unwrap())),
        ("viscous 0.5 on 4", Reality::with(|m| m.set_effect(Effect::ViscousFriction, Some(4), &[0.5]).unwrap())),
        ("scale 0.9 on 4", Reality::with(|m| m.set_effect(Effect::JointScale, Some(4), &[0.9]).unwrap())),
        ("sign on 4", Reality::with(|m| m.set_effect(Effect::JointSign, Some(4), &[-1.0]).unwrap())),
        ("quant on 4", Reality::with(|m| m.set_effect(Effect::Quantisation, Some(4), &[0.05]).unwrap())),
        ("gain on 0", Reality::with(|m| m.set_effect(Effect::LoopGain, Some(0), &[0.5]).unwrap())),
        ("vel on 0", Reality::with(|m| m.set_effect(Effect::VelocityLimit, Some(0), &[0.3]).unwrap())),
        ("load fric 0", Reality::with(|m| m.set_effect(Effect::LoadDependentFriction, Some(0), &[0.4]).unwrap())),
        ("gravity 0", Reality::with(|m| m.set_effect(Effect::GravityLoad, Some(0), &[1.5]).unwrap())),
        ("stribeck 0", Reality::with(|m| m.set_effect(Effect::StribeckFriction, Some(0), &[0.5, 0.1]).unwrap())),
        ("asym 0", Reality::with(|m| m.set_effect(Effect::AsymmetricFriction, Some(0), &[0.5, 0.0]).unwrap())),
        ("ripple 0", Reality::with(|m| m.set_effect(Effect::TorqueRipple, Some(0), &[0.4, 8.0, 1.0]).unwrap())),
        ("backlash 0 link", Reality::with(|m| m.set_effect(Effect::Backlash, Some(0), &[0.02]).unwrap())),
        ("compliance 0 link", Reality::with(|m| m.set_effect(Effect::Compliance, Some(0), &[30.0]).unwrap())),
        ("b friction", Reality::with(|m| m.set_effect(Effect::GroundFriction, None, &[0.35]).unwrap())),
        ("b aniso", Reality::with(|m| m.set_effect(Effect::FrictionAnisotropy, None, &[2.5, 0.7]).unwrap())),
        ("b torsion", Reality::with(|m| m.set_effect(Effect::TorsionalFriction, None, &[0.02]).unwrap())),
        ("b slope", Reality::with(|m| m.set_effect(Effect::GroundSlope, None, &[0.05, -0.03]).unwrap())),
        ("b soft", Reality::with(|m| m.set_effect(Effect::GroundCompliance, None, &[2000.0, 20.0]).unwrap())),
        ("b com", Reality::with(|m| m.set_effect(Effect::ComOffset, None, &[0.02, 0.0, 0.01]).unwrap())),
        ("b connector", Reality::with(|m| m.set_effect(Effect::ConnectorCompliance, None, &[20.0]).unwrap())),
        ("b play", Reality::with(|m| m.set_effect(Effect::ConnectorPlay, None, &[0.03]).unwrap())),
        ("b backlash", Reality::with(|m| m.set_effect(Effect::Backlash, Some(2), &[0.04]).unwrap())),
        ("b compliance", Reality::with(|m| m.set_effect(Effect::Compliance, Some(2), &[15.0]).unwrap())),
        ("deadband 0.03 on 5", Reality::with(|m| m.set_effect(Effect::Deadband, Some(5), &[0.03]).unwrap())),
    ];
    let only = std::env::var("CASE").ok();
    for (name, reality) in cases {
        if only.as_ref().is_some_and(|o| !name.contains(o.as_str())) { continue; }
        let (m, r) = record(&Plan { link: name.contains("link"), ..Plan::default() }, &reality);
        let t = std::time::Instant::now();
        let d = diagnose(&m, &r, &Model::hand_tuned(), &Settings::default()).unwrap();
        println!("=== {name} {:.2} s\n{}", t.elapsed().as_secs_f64(), d.debug());
    }
}
