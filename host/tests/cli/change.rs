//! A gait that takes over in mid-run, ordered with the run.

use crate::rig::{Folder, gait, rb};

#[test]
fn a_second_gait_takes_over_and_the_recording_says_when() {
    let folder = Folder::new("then");
    let (first, second) = (gait("crawl.toml"), gait("roll.toml"));
    let run = |more: &[&str]| {
        let args = ["-p", "sim:", "run", &first, "-d", "8s"];
        rb(&folder, &[&args, more].concat())
    };
    let done = run(&[
        "--then",
        &second,
        "--after",
        "3s",
        "-r",
        "then.mcap",
        "--json",
    ])
    .expect(0);
    let report = done.json();
    let run_report = &report["runs"][0];
    assert_eq!(run_report["reason"], "completed", "{report}");
    assert_eq!(run_report["recorded"], run_report["samples"], "{report}");
    assert!(
        done.err.contains("no set-points of this computer's law"),
        "{}",
        done.err
    );
    let plain = run(&["-r", "plain.mcap", "--json"]).expect(0).json();
    assert_ne!(
        plain["runs"][0]["setpoint_crc32c"], run_report["setpoint_crc32c"],
        "other set-points"
    );
    let events = rb(&folder, &["rec", "cat", "then.mcap", "--events"])
        .expect(0)
        .out;
    assert!(events.contains("gait_changed"), "{events}");
    rb(&folder, &["rec", "check", "then.mcap"]).expect(0);

    // One half of the two options, and a gait that would overwrite the first.
    run(&["--then", &second]).expect(2);
    run(&["--after", "3s"]).expect(2);
    let same = run(&["--then", &first, "--after", "3s"]).expect(2);
    assert!(same.err.contains("a name has one slot"), "{}", same.err);
}
