//! Scenario files: what they switch on, and how they complain.

use hil_sim::fault::FaultKind;
use hil_sim::scenario::{BodyKind, parse};
use hil_sim::world::World;

#[test]
fn an_empty_file_is_six_catalogue_motors() {
    let scenario = parse("s.toml", "").expect("empty is fine");
    assert_eq!(scenario.world.joints.len(), 6);
    assert!(scenario.world.joints[0].joint.friction.coulomb_nm > 0.0);
    assert!(scenario.world.faults.is_empty());
}

const EVERY_SECTION: &str = r#"
format = 1
name = "stall in the third gait cycle"
seed = 42
robot = "metamodule"
motor = "neutral"
step_us = 25

[bus]
baud = 500000
echo = true
return_delay_us = 250

[stand]
inertia_kg_m2 = 0.01
gravity_nm = 2.0
hang_deg = 90

[control]
kp_1_s = 12
kv_s_rad = 0.5

[guard]
overload_s = 1.5

[noise]
disturbance_nm = 0.05
current_a = 0.002

[effect.supply_sag]
resistance_ohm = 0.3
[effect.coulomb_friction]
torque_nm = 0.2
[effect.coulomb_friction.joint_2]
torque_nm = 0.6
[effect.velocity_limit]
limit_rad_s = inf

[[fault]]
kind = "stall"
joint = 2
from_s = 4.0
to_s = 5.0
[[fault]]
kind = "brown_out"
ratio = 0.5
from_s = 10
[[fault]]
kind = "corruption"
probability = 1e-4
"#;

#[test]
fn every_section_arrives_in_the_world() {
    let scenario = parse("s.toml", EVERY_SECTION).expect("valid");
    let world = &scenario.world;
    assert_eq!(
        (scenario.name.as_str(), world.seed, world.step_ns),
        ("stall in the third gait cycle", 42, 25_000)
    );
    assert_eq!((world.bus.baud, world.bus.echo), (500_000, true));
    assert_eq!(world.joints[5].driver.return_delay_ns, 250_000);
    assert_eq!(world.joints[1].load.gravity_nm, 2.0);
    assert_eq!(world.joints[1].driver.control.kp_1_s, 12.0);
    assert_eq!(world.joints[0].driver.guard.overload_s, 1.5);
    assert_eq!(
        (
            world.joints[3].load.disturbance_nm,
            world.joints[3].driver.noise.current_a
        ),
        (0.05, 0.002)
    );
    assert_eq!(world.supply.resistance_ohm, 0.3);
    let friction: Vec<_> = world
        .joints
        .iter()
        .map(|j| j.joint.friction.coulomb_nm)
        .collect();
    assert_eq!(friction, [0.2, 0.2, 0.6, 0.2, 0.2, 0.2]);
    assert_eq!(world.faults[0].kind, FaultKind::Stall);
    assert_eq!(
        (
            world.faults[0].joint,
            world.faults[0].from_s,
            world.faults[0].to_s
        ),
        (Some(2), 4.0, 5.0)
    );
    assert_eq!(world.faults[1].kind, FaultKind::BrownOut { ratio: 0.5 });
    assert_eq!(world.faults[2].probability, 1e-4);
    World::on_stand(world).expect("runs");
    assert_eq!(scenario.body, BodyKind::Stand);
    let mut on_ground = parse("s.toml", "body = \"ground\"\n")
        .expect("valid")
        .build()
        .expect("shipped model");
    on_ground.advance_to(100_000_000);
    assert_eq!(on_ground.joints(), 6);
}

/// (file, line named, words that must be in the message)
const BROKEN: &[(&str, usize, &[&str])] = &[
    ("seed = 1\nbaud = 9600\n", 2, &["`baud`", "known: format"]),
    ("robot = \"dog\"\n", 1, &["dog", "metamodule, bench"]),
    ("\n[bus]\nbaud = \"fast\"\n", 3, &["`baud`", "whole number"]),
    ("[bus]\nspeed = 1\n", 2, &["[bus]", "`speed`", "baud, echo"]),
    (
        "[stand]\ngravity_nm = nan\n",
        2,
        &["gravity_nm", "NaN", "0 to 100"],
    ),
    (
        "[stand]\ngravity_nm = 0x10\n",
        2,
        &["gravity_nm", "decimal"],
    ),
    ("[stand]\ngravity_nm = -1\n", 2, &["-1", "0 to 100"]),
    (
        "[effect.gremlins]\nsize = 1\n",
        2,
        &["gremlins", "physics model"],
    ),
    (
        "[effect.latency]\ndelay = 1\n",
        2,
        &["`delay`", "it has delay_s"],
    ),
    (
        "[effect.latency.joint_9]\ndelay_s = 1\n",
        2,
        &["joint 9", "0 to 5"],
    ),
    (
        "[effect.latency.joint_x]\ndelay_s = 1\n",
        1,
        &["joint_x", "joint_0"],
    ),
    ("[effect]\nlatency = 3\n", 2, &["`latency`", "a table"]),
    (
        "[effect.coulomb_friction]\ntorque_nm = 1e9\n",
        1,
        &["coulomb_friction.torque_nm", "0 to 20"],
    ),
    (
        "robot = \"bench\"\nbody = \"ground\"\n",
        2,
        &["ground", "known: stand"],
    ),
    ("[[fault]]\njoint = 1\n", 1, &["[[fault]]", "`kind`"]),
    (
        "[[fault]]\nkind = \"stall\"\njoint = 6\n",
        3,
        &["`joint`", "0 to 5"],
    ),
    ("[[fault]]\nkind = \"reply_delay\"\n", 1, &["`delay_s`"]),
    (
        "[[fault]]\nkind = \"stall\"\ndelay_s = 1\n",
        3,
        &["`delay_s`"],
    ),
    (
        "[[fault]]\nkind = \"explode\"\n",
        2,
        &["explode", "brown_out"],
    ),
    (
        "[[fault]]\nkind = \"stall\"\nfrom_s = 2\nto_s = 1\n",
        1,
        &["later than from_s"],
    ),
    (
        "[[fault]]\nkind = \"stall\"\nprobability = 1.5\n",
        3,
        &["probability", "0 to 1"],
    ),
    ("[camera]\n", 1, &["[camera]", "body = \"ground\""]),
    ("[imu]\n", 1, &["[imu]", "body = \"ground\""]),
    (
        "\nmodel = \"robot.toml\"\n",
        2,
        &["`model`", "body = \"ground\""],
    ),
    ("motor = \"model\"\n", 1, &["motor", "body = \"ground\""]),
    (
        "body = \"ground\"\n[camera]\nheight_m = 0.1\n",
        3,
        &["height_m", "0.5 to 10"],
    ),
    (
        "body = \"ground\"\n[tracker]\nsigma = 1\n",
        3,
        &["[tracker]", "sigma_deg"],
    ),
    ("format = 2\n", 1, &["format"]),
    ("format = 0\n", 1, &["format"]),
    ("a = \n", 1, &["not valid TOML"]),
];

#[test]
fn errors_name_line_key_and_range() {
    for (text, line, words) in BROKEN {
        let error = parse("s.toml", text).expect_err(text).to_string();
        assert!(
            error.starts_with(&format!("s.toml:{line}: ")),
            "{text:?} gave {error}"
        );
        for word in *words {
            assert!(error.contains(word), "{text:?}: no {word:?} in {error}");
        }
    }
    let long = "#".repeat((1 << 20) + 1);
    assert!(
        parse("s.toml", &long)
            .expect_err("too long")
            .to_string()
            .contains("at most")
    );
}
