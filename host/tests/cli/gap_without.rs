//! `gap report` on emulated robots of which neither echo nor torque was recorded: what holds a joint back is a limit where whole runs bear it out.

use crate::rig::{Folder, rb, trials};

/// Everything but set-points, angles and base pose.
const LACKING: &str = "echo,velocity,current,duty,bus,temperature,inertial";

#[test]
fn set_points_that_are_lost_are_no_limit_where_whole_runs_refute_it() {
    for (cause, word, stage) in [
        ("packet_loss@3:0.4", "unknown", "transport"),
        ("torque_limit@3:0.5", "parametric", "electrical"),
    ] {
        let folder = Folder::new(&format!("without_{}", &cause[..6]));
        let made = ["make-case", cause, "--gaits", "3"];
        let lacking = ["--without", LACKING, "--seed", "5", "-o", "./case"];
        trials(&folder, &[&made[..], &lacking].concat()).expect("a case");
        let v = rb(&folder, &["--json", "gap", "report", "case"])
            .expect(0)
            .json();
        assert_eq!(v["verdict"], word, "{cause}: {}", v["sentence"]);
        let place = &v["where"][0];
        assert_eq!(
            (&place["stage"], &place["joint"]),
            (&stage.into(), &3.into()),
            "{cause}"
        );
        let next = &v["next_experiment"];
        if word == "unknown" {
            assert_eq!(v["effects"], serde_json::json!([]), "{cause}");
            let text = next["text"].as_str().unwrap_or_default();
            assert!(text.contains("applied_setpoint_rad"), "{next}");
        } else {
            assert_eq!(
                v["effects"][0]["effect"], "torque_limit",
                "{}",
                v["effects"]
            );
        }
    }
}
