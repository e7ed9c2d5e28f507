//! Data set folder: every error names file, line, column and reason; real recordings parse.

use files::dataset::{
    ControllerKind, Manifest, Motion, Output, Recording, Role, Signal, Warning, repeat_groups,
};

const HEAD: &str = "format = 1\nrobot = \"bench\"\nname = \"t\"\n";

fn manifest(rest: &str) -> Manifest {
    Manifest::parse(
        "dataset.toml",
        &format!("{HEAD}{rest}\n[[run]]\nfile = \"a.csv\"\n"),
    )
    .expect("valid")
    .0
}

#[test]
fn manifest_errors_name_line_and_key() {
    let table = [
        (
            "robot = \"bench\"\n[[run]]\nfile=\"a\"\n",
            "key `format` is missing",
        ),
        (
            "format = 2\nrobot = \"bench\"\n",
            "dataset.toml:1: `format` must be a number from 1 to 1, found 2",
        ),
        (
            "format = 1\nrobot = \"dog\"\n",
            "dataset.toml:2: `robot` must be one of \"bench\", \"metamodule\"",
        ),
        ("format = 1\nrobot = \"bench\"\n", "key `run` is missing"),
        (
            "format = 1\nrobot = \"bench\"\n[bench]\ninertia_kg_m2 = -1\n",
            ":4: `bench.inertia_kg_m2` must be a number from",
        ),
        (
            "format = 1\nrobot = \"bench\"\n[bench]\nsupply_v = { value = nan }\n",
            ":4: `bench.supply_v.value` must be",
        ),
        (
            "format = 1\nrobot = \"bench\"\n[bench]\nsupply_v = { tolerance = 0.1 }\n",
            "`bench.supply_v.value` is missing",
        ),
        (
            "format = 1\nrobot = \"bench\"\n[[run]]\ngait = \"g\"\n",
            "key `run.file` is missing",
        ),
        ("format = 1\nrobot = \n", "dataset.toml:2: not valid TOML"),
    ];
    for (text, want) in table {
        let got = Manifest::parse("dataset.toml", text)
            .expect_err(text)
            .to_string();
        assert!(got.contains(want), "{got}\nwanted: {want}");
    }
}

#[test]
fn unknown_keys_are_named_and_ignored() {
    let text = format!("{HEAD}[bench]\ninertia = 2\n[[run]]\nfile = \"a.csv\"\n");
    let (_, warnings) = Manifest::parse("d.toml", &text).expect("valid");
    assert!(
        warnings[0]
            .to_string()
            .starts_with("d.toml:5: unknown key `bench.inertia`"),
        "{}",
        warnings[0]
    );
}

#[test]
fn overrides_keep_the_base_and_its_tolerance() {
    let text = format!(
        "{HEAD}[bench]\nmotion = \"linear\"\nmass_kg = {{ value = 95, tolerance = 0.1 }}\n[bench.controller]\nkind = \"cascade\"\n\
         output = \"voltage\"\nkp = {{ value = 1.0, tolerance = 0.2 }}\n[[run]]\nfile = \"a.csv\"\ngait = \"g\"\nrole = \"check\"\n\
         bench.controller.kp = 4.0\n[[run]]\nfile = \"b.csv\"\n"
    );
    let (m, warnings) = Manifest::parse("d.toml", &text).expect("valid");
    assert!(warnings.is_empty(), "{warnings:?}");
    let kp = m.runs[0].bench.controller.kp.expect("set");
    assert_eq!((kp.value, kp.tolerance), (4.0, Some(0.2)));
    assert_eq!(m.runs[1].bench.controller.kp.expect("set").value, 1.0);
    assert_eq!(m.runs[0].role, Some(Role::Check));
    assert_eq!(m.bench.motion, Motion::Linear);
    assert_eq!(m.bench.controller.kind, Some(ControllerKind::Cascade));
    assert_eq!(m.bench.controller.output, Some(Output::Voltage));
    assert_eq!(m.bench.inertia.expect("set").value, 95.0);
}

#[test]
fn csv_errors_name_line_and_column() {
    let m = manifest("");
    let table = [
        (
            "setpoint_rad,position_rad\n0,0\n0,0\n",
            "column `t_s` is missing",
        ),
        (
            "t_s,position_rad\n0,0\n1,0\n",
            "column `setpoint_rad` is missing",
        ),
        (
            "t_s,setpoint_rad\n0,0\n1,x\n",
            "a.csv:3: column `setpoint_rad`: `x` is not a finite number",
        ),
        (
            "t_s,setpoint_rad\n0,0\n1,NaN\n",
            "a.csv:3: column `setpoint_rad`: `NaN`",
        ),
        (
            "t_s,setpoint_rad\n0,0\n1,inf\n",
            "`inf` is not a finite number",
        ),
        ("t_s,setpoint_rad\n,0\n1,0\n", "a.csv:2: column `t_s`"),
        (
            "t_s,setpoint_rad\n0,0\n2,0\n1,0\n",
            "a.csv:4: column `t_s`: 1 comes after 2",
        ),
        (
            "t_s,setpoint_rad,duty\n0,0,0\n1,0,55\n",
            "a.csv:3: column `duty`: 55 is outside -1.05 .. 1.05",
        ),
        (
            "t_s,setpoint_rad,enable\n0,0,2\n1,0,1\n",
            "column `enable`: 2 is outside 0 .. 1",
        ),
        (
            "t_s,setpoint_rad,setpoint_rad\n0,0,0\n1,0,0\n",
            "`setpoint_rad` stands twice",
        ),
        ("t_s,setpoint_rad\n0,0\n", "only 1 rows"),
        ("t_s,setpoint_rad\n0,0\n1,0,5\n", "a.csv:3: not valid CSV"),
    ];
    for (text, want) in table {
        let got = Recording::parse("a.csv", text, &m)
            .expect_err(text)
            .to_string();
        assert!(got.contains(want), "{got}\nwanted: {want}");
    }
}

#[test]
fn renamed_columns_empty_cells_and_joint_suffixes() {
    let m = manifest("[signals]\n\"setpoint_rad_0\" = \"setpoint_Rotation\"");
    let text = "t_s,setpoint_Rotation,position_rad,bus_v,colour\n0,1,,7.4,1\n0.1,,0.5,,2\n";
    let (r, warnings) = Recording::parse("a.csv", text, &m).expect("valid");
    let joint = r.joint(0).expect("one joint");
    let setpoint = joint.get(Signal::Setpoint).expect("renamed");
    assert!(setpoint[0] == 1.0 && setpoint[1].is_nan());
    assert_eq!(r.body().bus_v.as_ref().expect("there")[0], 7.4);
    assert!(
        warnings
            .iter()
            .any(|w| matches!(w, Warning::UnknownColumn { column, .. } if column == "colour"))
    );
    let missing = Recording::parse("a.csv", "t_s,position_rad\n0,0\n1,0\n", &m)
        .expect_err("renamed command absent");
    assert!(
        missing.to_string().contains("setpoint_Rotation"),
        "{missing}"
    );
}

#[test]
fn a_renamed_response_may_be_missing_from_a_run() {
    let m = manifest("[signals]\n\"position_rad\" = \"pos\"");
    let (r, warnings) =
        Recording::parse("a.csv", "t_s,setpoint_rad\n0,0\n1,0\n", &m).expect("valid");
    assert!(
        r.joint(0)
            .expect("one joint")
            .get(Signal::Position)
            .is_none()
    );
    assert!(
        warnings
            .iter()
            .any(|w| w.to_string().contains("`pos` is missing"))
    );
    // Where both stand, the renamed one is the signal.
    let text = "t_s,setpoint_rad,position_rad,pos\n0,0,9,1\n1,0,9,2\n";
    let (r, _) = Recording::parse("a.csv", text, &m).expect("valid");
    let position = r.joint(0).and_then(|j| j.get(Signal::Position));
    assert_eq!(position, Some(&[1.0, 2.0][..]));
}

#[test]
fn a_byte_order_mark_and_seconds_since_1970_are_read() {
    let m = manifest("");
    let text = "\u{feff}t_s,setpoint_rad\r\n1763742000.5,0\r\n1763742000.6,1\r\n";
    let (r, _) = Recording::parse("a.csv", text, &m).expect("valid");
    assert_eq!(r.t_s(), [1_763_742_000.5, 1_763_742_000.6]);
}

#[test]
fn commands_of_other_kinds_have_their_own_header() {
    let m = manifest("[bench]\ncommand = \"effort\"\nmotion = \"linear\"");
    let (r, _) =
        Recording::parse("a.csv", "t_s,setpoint_n,position_m\n0,1,0\n1,1,2\n", &m).expect("valid");
    assert_eq!(
        r.joint(0).and_then(|j| j.get(Signal::Setpoint)),
        Some(&[1.0, 1.0][..])
    );
}

#[test]
fn repeats_need_same_gait_same_overrides_and_same_setpoints() {
    let text = format!(
        "{HEAD}[[run]]\nfile = \"a\"\ngait = \"g\"\n[[run]]\nfile = \"b\"\ngait = \"g\"\n[[run]]\nfile = \"c\"\ngait = \"g\"\n\
         bench.controller.kp = 2\n[[run]]\nfile = \"d\"\ngait = \"g\"\n"
    );
    let (m, _) = Manifest::parse("d.toml", &text).expect("valid");
    let csv = |scale: f64| {
        let rows: Vec<String> = (0..50)
            .map(|i| {
                format!(
                    "{},{},{}",
                    f64::from(i) * 0.1,
                    scale * f64::from(i),
                    f64::from(i)
                )
            })
            .collect();
        format!("t_s,setpoint_rad,position_rad\n{}\n", rows.join("\n"))
    };
    let read = |scale| Recording::parse("x", &csv(scale), &m).expect("valid").0;
    let groups = repeat_groups(&m, &[read(1.0), read(1.0), read(1.0), read(3.0)]);
    assert_eq!(groups, [0, 0, 1, 2]);
}

#[test]
fn measured_recordings_parse() {
    let root = std::env::var("RB_DATA")
        .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data").into());
    let root = [
        root,
        concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data").into(),
    ]
    .into_iter()
    .find(|r| std::path::Path::new(r).is_dir());
    let Some(root) = root else {
        eprintln!("skipped: no measured data (set RB_DATA to its folder)");
        return;
    };
    for (set, runs) in [
        ("xl330", 12),
        ("so101_rotation", 12),
        ("so101_wrist_roll", 11),
    ] {
        let text = std::fs::read_to_string(format!("{root}/{set}/dataset.toml")).expect("manifest");
        let (m, warnings) = Manifest::parse("dataset.toml", &text).expect("valid");
        assert!(warnings.is_empty(), "{warnings:?}");
        assert_eq!(m.runs.len(), runs);
        for run in &m.runs {
            let text = std::fs::read_to_string(format!("{root}/{set}/{}", run.file)).expect("csv");
            let (r, _) = Recording::parse(&run.file, &text, &m).unwrap_or_else(|e| panic!("{e}"));
            assert!(r.len() > 1000);
        }
    }
}

#[test]
fn lines_are_counted_as_an_editor_does_whatever_ends_them() {
    let manifest = manifest("");
    for end in ["\n", "\r\n"] {
        // Empty lines are skipped by the reader, not by an editor.
        for (rows, line) in [
            (["0,0,0", "0.1,0,0", "0.2,0,abc", "0.3,0,0"], 4),
            (["0,0,abc", "0.1,0,0", "0.2,0,0", "0.3,0,0"], 2),
            (["0,0,0", "", "", "0.1,0,abc"], 5),
            (["0,0,0", "0.1,0,0", "0.2,0", "0.3,0,0"], 4),
            (["0,0,0", "0.2,0,0", "0.1,0,0", "0.3,0,0"], 4),
        ] {
            for bom in ["", "\u{feff}"] {
                let header = format!("{bom}t_s,setpoint_rad,position_rad");
                let text = [&[header.as_str()], &rows[..]].concat().join(end) + end;
                let error = Recording::parse("a.csv", &text, &manifest).unwrap_err();
                let said = error.to_string();
                assert!(
                    said.starts_with(&format!("a.csv:{line}: ")),
                    "{said}: {text:?}"
                );
                assert_eq!(said.matches("line").count(), 0, "{said}");
            }
        }
    }
}

#[test]
fn files_of_a_data_set_lie_in_its_folder() {
    for (path, inside) in [
        ("a.csv", true),
        ("sub/a.csv", true),
        ("a..b.csv", true),
        ("", false),
        ("/dev/zero", false),
        ("..", false),
        ("sub/../../a.csv", false),
        ("..\\\\a.csv", false),
        ("C:\\\\a.csv", false),
        ("\\\\\\\\server\\\\a.csv", false),
    ] {
        for key in ["file", "frames"] {
            let other = if key == "file" {
                ""
            } else {
                "file = \"a.csv\"\n"
            };
            let text =
                format!("format = 1\nrobot = \"bench\"\n[[run]]\n{other}{key} = \"{path}\"\n");
            let parsed = Manifest::parse("dataset.toml", &text);
            assert_eq!(parsed.is_ok(), inside, "{key} = {path}");
        }
    }
}

#[test]
fn a_stated_supply_takes_the_place_of_the_models() {
    use files::model::{Key, Model};
    let of = |stated: &str| {
        let text = format!(
            "format = 1\nrobot = \"metamodule\"\n[metamodule]\n{stated}\n[[run]]\nfile = \"a.csv\"\n"
        );
        let parsed = Manifest::parse("dataset.toml", &text);
        parsed.map(|(m, _)| m.stated(&Model::hand_tuned()))
    };
    let supply = |model: &Model| {
        let p = model.parameter(Key::SupplyVoltage);
        (p.value, p.tolerance)
    };
    assert_eq!(of("").unwrap(), Model::hand_tuned());
    let both = of("supply_v = { value = 7.4, tolerance = 0.05 }").unwrap();
    assert!((supply(&both).1 - 0.37).abs() < 1e-12 && supply(&both).0 == 7.4);
    // Without a tolerance the model's relative one counts: 0.15 V of 12 V.
    let bare = of("supply_v = 7.4").unwrap();
    assert!((supply(&bare).1 - 7.4 * 0.15 / 12.0).abs() < 1e-12);
    let refused = of("supply_v = 0").unwrap_err().to_string();
    assert!(refused.contains("supply_v"), "{refused}");
}

#[test]
fn rows_written_twice_and_joints_left_out_are_told() {
    let warned = |manifest: &Manifest, csv: &str| -> Vec<String> {
        let (_, warnings) = Recording::parse("a.csv", csv, manifest).unwrap();
        warnings.iter().map(ToString::to_string).collect()
    };
    let bench = manifest("");
    let twice = "t_s,setpoint_rad,position_rad\n0,0,0\n0.1,,0.1\n0.1,,0.2\n0.2,0,0.3\n";
    let said = warned(&bench, twice);
    assert!(
        said[0].starts_with("a.csv:4: column `t_s`: 0.1 stands in two rows"),
        "{said:?}"
    );
    // A set-point and a position of one instant may stand in rows of their own.
    let apart = "t_s,setpoint_rad,position_rad\n0,0,0\n0.1,0.1,\n0.1,,0.2\n0.2,0,0.3\n";
    assert!(warned(&bench, apart).is_empty());
    let text = "format = 1\nrobot = \"metamodule\"\n[[run]]\nfile = \"a.csv\"\n";
    let robot = Manifest::parse("dataset.toml", text).unwrap().0;
    let header = |names: &[usize]| -> String {
        let of = |signal: &str, k: usize| format!(",{signal}_{k}");
        let setpoints: String = (0..6).map(|k| of("setpoint_rad", k)).collect();
        let positions: String = names.iter().map(|k| of("position_rad", *k)).collect();
        let cells = |t: f64| format!("{t}{}\n", format!(",{t}").repeat(6 + names.len()));
        format!("t_s{setpoints}{positions}\n{}{}", cells(0.0), cells(0.1))
    };
    assert!(warned(&robot, &header(&[0, 1, 2, 3, 4, 5])).is_empty());
    let said = warned(&robot, &header(&[0, 1, 3, 4, 5]));
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(
        said[0].starts_with("a.csv:1: column `position_rad_2` is missing"),
        "{said:?}"
    );
}
