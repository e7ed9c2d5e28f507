//! `gap report` on robots that MuJoCo and the servo law of `tests/foreign/walker_reality.py` play: bodies, contacts and
//! integrator are another engine's. Skipped, loudly, where the environment of `cargo xtask setup` has no MuJoCo.

use crate::foreign_reality::{played, verdict};

/// Cases of the script, and the effect that causes their gap, with its joint, parameter, value and how far off that may be; none for the robot that is as stated.
/// `bi_` has an inertial sensor; `di_` stands on contacts as MuJoCo comes with. Delays: set-points are 50 ms apart, readings 25.
const CASES: [(&str, Option<Cause>); 5] = [
    ("w_null", None),
    ("bi_null_a", None),
    ("di_null_11", None),
    (
        "di_coulomb_2",
        Some(("coulomb_friction", Some(2), "torque_nm", [0.5, 0.1])),
    ),
    (
        "w_latency_1",
        Some(("latency", Some(1), "delay_s", [0.08, 0.006])),
    ),
];

/// Effect, joint, parameter, value and how far off.
type Cause = (&'static str, Option<u64>, &'static str, [f64; 2]);

#[test]
fn robots_of_another_engine_are_diagnosed() {
    let test = "robots_of_another_engine_are_diagnosed";
    let Some(folder) = played(test, "walker_reality.py", &CASES.map(|c| c.0)) else {
        return;
    };
    for (name, cause) in CASES {
        let v = verdict(&folder, name);
        let found = v["effects"].as_array().unwrap();
        match cause {
            None => assert_eq!(v["verdict"], "none", "{name}: {}", v["sentence"]),
            Some((effect, joint, key, [value, off])) => {
                // The turn-over of a dry friction may be named beside it.
                let first = found.first().unwrap_or(&serde_json::Value::Null);
                let beside = |f: &serde_json::Value| f["stage"] == first["stage"];
                let right = found.iter().all(beside) && first["effect"] == effect;
                let place = found.first().and_then(|f| f["joint"].as_u64());
                assert!(right && place == joint, "{name}: {}", v["sentence"]);
                let told = found[0]["parameters"][key]["value"].as_f64().unwrap();
                assert!((told - value).abs() < off, "{name}: {told}");
            }
        }
    }
}
