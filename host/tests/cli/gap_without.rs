//! `gap report` on emulated robots of which neither echo nor torque was recorded: set-points that are lost are no limit, and a limit is one.

use crate::rig::{Folder, rb, trials};

/// Everything but set-points, angles and base pose.
const LACKING: &str = "echo,velocity,current,duty,bus,temperature,inertial";

#[test]
fn lost_set_points_are_no_limit_and_a_limit_is_one() {
    for (cause, effect, stage, key, value) in [
        (
            "packet_loss@3:0.4",
            "packet_loss",
            "transport",
            "probability",
            0.4,
        ),
        (
            "torque_limit@3:0.5",
            "torque_limit",
            "electrical",
            "limit_nm",
            0.5,
        ),
    ] {
        let folder = Folder::new(&format!("without_{effect}"));
        let made = ["make-case", cause, "--gaits", "3"];
        let lacking = ["--without", LACKING, "--seed", "5", "-o", "./case"];
        trials(&folder, &[&made[..], &lacking].concat()).expect("a case");
        let v = rb(&folder, &["--json", "gap", "report", "case"])
            .expect(0)
            .json();
        let first = &v["effects"][0];
        let named = (&first["effect"], &first["joint"]);
        assert_eq!(named, (&effect.into(), &3.into()), "{}", v["sentence"]);
        let found = first["parameters"][key]["value"].as_f64().unwrap();
        assert!((found / value - 1.0).abs() < 0.2, "{cause}: {found}");
        let place = &v["where"][0];
        let found = (&place["stage"], &place["joint"]);
        assert_eq!(found, (&stage.into(), &3.into()), "{cause}");
    }
}
