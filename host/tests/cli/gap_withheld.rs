//! `gap report` on emulated robots whose effect must not be named: what is left says `unknown` in the right place.

use crate::rig::{Folder, rb, trials};

/// Planted cause, effect that is withheld, and stage and joint that the verdict must point to.
const CASES: [(&str, &str, &str, Option<u64>); 2] = [
    ("com_offset:0.02,-0.01,0.006", "com_offset", "body", None),
    ("latency@3:0.0065", "latency", "transport", Some(3)),
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
        let place = &v["where"][0];
        assert_eq!(place["stage"], stage, "{cause}: {}", v["where"]);
        assert_eq!(place["joint"].as_u64(), joint, "{cause}: {}", v["where"]);
    }
}
