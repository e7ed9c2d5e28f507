//! `gap report` on emulated robots whose effect must not be named: what is left says `unknown` in the right place.

use crate::rig::{Folder, rb, trials};

/// Planted cause, effect that is withheld, and stage and joint that the verdict must point to.
const CASES: [(&str, &str, &str, Option<u64>); 2] = [
    ("joint_offset@2:0.1", "joint_offset", "driver", Some(2)),
    ("torque_limit@3:0.5", "torque_limit", "driver", Some(3)),
];

#[test]
fn a_cause_that_may_not_be_named_is_unknown_in_its_place() {
    for (cause, withheld, stage, joint) in CASES {
        let folder = Folder::new(&format!("withheld_{withheld}"));
        let made = [
            "make-case",
            cause,
            "--gaits",
            "3",
            "--seed",
            "5",
            "-o",
            "./case",
        ];
        trials(&folder, &made).expect("a case");
        let report = ["--json", "gap", "report", "case", "--withhold", withheld];
        let v = rb(&folder, &report).expect(0).json();
        assert_eq!(v["verdict"], "unknown", "{cause}: {}", v["sentence"]);
        let mut places = v["where"].as_array().expect("places").iter();
        let place = places
            .find(|p| p["stage"] != "unexplained")
            .expect("a place");
        assert_eq!(place["stage"], stage, "{cause}: {}", v["where"]);
        assert_eq!(place["joint"].as_u64(), joint, "{cause}: {}", v["where"]);
    }
}
