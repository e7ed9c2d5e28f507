//! The next experiment as a file beside the report: a motion for a bench, a gait for a robot.

use std::fmt::Write as _;

use crate::rig::{Folder, rb};

/// Three motions of a joint with 30 mrad of play behind a lag of 0.1 s: set-point and position alone do not tell its causes.
fn bench(folder: &Folder) {
    std::fs::create_dir(folder.path("joint")).unwrap();
    let mut manifest = String::from("format = 1\nrobot = \"bench\"\n");
    for (run, hz) in [0.2_f64, 0.35, 0.5].iter().enumerate() {
        let mut csv = String::from("t_s,setpoint_rad,position_rad\n");
        let mut q = 0.0;
        for i in 0..500 {
            let t = f64::from(i) * 0.02;
            let sp = 0.8 * (1.0 - 4.0 * ((hz * t).fract() - 0.5).abs());
            let error: f64 = sp - q;
            q += 0.2 * (error - error.clamp(-0.03, 0.03));
            writeln!(csv, "{t:.3},{sp:.5},{q:.5}").unwrap();
        }
        folder.write(&format!("joint/run{run}.csv"), csv);
        let row = format!("[[run]]\nfile = \"run{run}.csv\"\ngait = \"g{run}\"\n");
        manifest.push_str(&row);
    }
    folder.write("joint/dataset.toml", manifest);
}

#[test]
fn a_bench_gets_set_points_that_it_has_been_asked_for_before() {
    let folder = Folder::new("next_bench");
    bench(&folder);
    let args = ["--json", "gap", "report", "joint", "-o", "out.html"];
    let verdict = rb(&folder, &args).expect(0).json();
    let next = &verdict["next_experiment"];
    assert_eq!(next["gait"], "out.next.csv", "{next}");
    assert!(next["separates"].as_array().unwrap().len() > 1, "{next}");
    let text = std::fs::read_to_string(folder.path("out.next.csv")).unwrap();
    let mut rows = text.lines();
    assert_eq!(rows.next(), Some("t_s,setpoint_rad"));
    let numbers = |row: &str| -> Vec<f64> { row.split(',').map(|x| x.parse().unwrap()).collect() };
    let (mut last, mut count) = (-1.0, 0);
    for row in rows.map(numbers) {
        assert!(row[0] > last && row[1].abs() <= 0.8, "{row:?}");
        last = row[0];
        count += 1;
    }
    assert!(last > 10.0 && count > 200, "{last} s in {count} rows");
}

#[test]
fn a_robot_gets_a_gait_that_its_own_check_lets_pass() {
    let folder = Folder::new("next_robot");
    let cause = "torque_limit@2:0.8";
    let case = [
        "gap",
        "blind",
        "--make-case",
        cause,
        "--gaits",
        "3",
        "-o",
        "case",
    ];
    rb(&folder, &case).expect(0);
    let args = ["--json", "gap", "report", "case", "-o", "out.html"];
    let verdict = rb(&folder, &args).expect(0).json();
    let next = &verdict["next_experiment"];
    assert_eq!(next["gait"], "out.next.toml", "{next}");
    let moved = rb(&folder, &["gait", "check", "out.next.toml"]).expect(0);
    assert!(!moved.out.is_empty());
    let gait = std::fs::read_to_string(folder.path("out.next.toml")).unwrap();
    assert!(gait.contains("joint2"), "{gait}");
}
