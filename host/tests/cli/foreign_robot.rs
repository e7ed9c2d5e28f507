//! `gap report` on robots that MuJoCo and the servo law of `tests/foreign/walker_reality.py` play: bodies, contacts and
//! integrator are another engine's. Skipped, loudly, where the environment of `cargo xtask setup` has no MuJoCo.

use crate::foreign_reality::{played, verdict};

/// Cases of the script, and effect and joint that cause their gap; none for the robot that is as stated.
const CASES: [(&str, Option<(&str, u64)>); 2] =
    [("w_null", None), ("w_latency_1", Some(("latency", 1)))];

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
            Some((effect, joint)) => {
                let right = found.len() == 1 && found[0]["effect"] == effect;
                assert!(
                    right && found[0]["joint"] == joint,
                    "{name}: {}",
                    v["sentence"]
                );
                // Delays of 80 ms; set-points are 50 ms apart, readings 25.
                let delay_s = found[0]["parameters"]["delay_s"]["value"].as_f64().unwrap();
                assert!((delay_s - 0.08).abs() < 0.004, "{delay_s}");
            }
        }
    }
}
