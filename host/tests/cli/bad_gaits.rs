//! Gait files that must be refused: exit code 3 (file) or 7 (the robot would refuse), with a message that names the place.

use crate::rig::{Folder, rb};

const GOOD: &str = include_str!("../../../gaits/crawl.toml");

/// Name, file, words that must be in the message.
fn cases() -> Vec<(&'static str, Vec<u8>, &'static str)> {
    let swap = |from: &str, to: &str| {
        assert!(GOOD.contains(from), "{from}");
        GOOD.replacen(from, to, 1).into_bytes()
    };
    let f = "frequency_hz = 0.2";
    let a = "amplitude_deg = 40";
    let mut cases = vec![
        ("empty", Vec::new(), "format is missing"),
        (
            "only a comment",
            b"# nothing\n".to_vec(),
            "format is missing",
        ),
        (
            "truncated in a string",
            GOOD[..GOOD.find("crawl\"").unwrap() + 3].into(),
            "TOML",
        ),
        (
            "truncated in a list",
            GOOD[..GOOD.find("180,").unwrap()].into(),
            "TOML",
        ),
        (
            "truncated after the head",
            GOOD[..GOOD.find("[[osc").unwrap()].into(),
            "oscillator is missing",
        ),
        ("nan", swap(f, "frequency_hz = nan"), "not a finite number"),
        (
            "minus nan",
            swap(f, "frequency_hz = -nan"),
            "not a finite number",
        ),
        ("inf", swap(f, "frequency_hz = inf"), "not a finite number"),
        (
            "minus inf amplitude",
            swap(a, "amplitude_deg = -inf"),
            "not a finite number",
        ),
        ("overflow", swap(f, "frequency_hz = 1e400"), "frequency_hz"),
        ("huge", swap(f, "frequency_hz = 1e308"), "out of range"),
        (
            "huge whole number",
            swap(f, "frequency_hz = 99999999999999999999999999"),
            "frequency_hz",
        ),
        (
            "hexadecimal",
            swap(f, "frequency_hz = 0x10"),
            "not written in decimal",
        ),
        (
            "octal",
            swap(f, "frequency_hz = 0o17"),
            "not written in decimal",
        ),
        (
            "binary",
            swap(a, "amplitude_deg = 0b1"),
            "not written in decimal",
        ),
        (
            "negative frequency",
            swap(f, "frequency_hz = -0.2"),
            "allowed: 0 to 2 Hz",
        ),
        (
            "frequency as text",
            swap(f, "frequency_hz = \"0.2\""),
            "expected a number",
        ),
        (
            "frequency as a list",
            swap(f, "frequency_hz = [0.2]"),
            "expected a number",
        ),
        (
            "frequency as a date",
            swap(f, "frequency_hz = 2020-01-01"),
            "expected a number",
        ),
        (
            "frequency as truth",
            swap(f, "frequency_hz = true"),
            "expected a number",
        ),
        (
            "duration zero",
            swap("duration_s = 30", "duration_s = 0"),
            "duration_s",
        ),
        (
            "duration negative",
            swap("duration_s = 30", "duration_s = -30"),
            "duration_s",
        ),
        (
            "duration of a day",
            swap("duration_s = 30", "duration_s = 86400"),
            "0.05 to 3600 s",
        ),
        (
            "rate zero",
            swap("rate_a_per_s = 2.0", "rate_a_per_s = 0"),
            "rate_a_per_s",
        ),
        (
            "rate huge",
            swap("rate_a_per_s = 2.0", "rate_a_per_s = 1e9"),
            "rate_a_per_s",
        ),
        (
            "weight negative",
            swap("weight = 0.5", "weight = -0.5"),
            "weight",
        ),
        (
            "weight huge",
            swap("weight = 0.5", "weight = 50"),
            "allowed: 0 to 3",
        ),
        (
            "amplitude in Hz",
            swap(a, "amplitude_hz = 40"),
            "unknown key `amplitude_hz`",
        ),
        (
            "amplitude without unit",
            swap(a, "amplitude = 40"),
            "amplitude_deg` or `amplitude_rad",
        ),
        (
            "offset without unit",
            swap("offset_deg = 0", "offset = 0"),
            "no unit",
        ),
        (
            "lag without unit",
            swap("phase_lag_deg = [", "phase_lag = ["),
            "no unit",
        ),
        (
            "degrees given as radians",
            swap(a, "amplitude_rad = 40"),
            "3.14",
        ),
        (
            "both units",
            swap(a, "amplitude_deg = 40\namplitude_rad = 0.7"),
            "are both given",
        ),
        (
            "negative amplitude",
            swap(a, "amplitude_deg = -40"),
            "0 to 180 deg",
        ),
        (
            "amplitude over half a turn",
            swap(a, "amplitude_deg = 180.1"),
            "0 to 180 deg",
        ),
        (
            "offset over half a turn",
            swap("offset_deg = 0", "offset_deg = 190"),
            "-180 to 180 deg",
        ),
        (
            "phase over a turn",
            swap("offset_deg = 0", "offset_deg = 0\ninitial_phase_deg = 361"),
            "-360 to 360 deg",
        ),
        (
            "phase on one only",
            swap("offset_deg = 0", "offset_deg = 0\ninitial_phase_deg = 10"),
            "for some oscillators only",
        ),
        (
            "misspelt key",
            swap(f, "freqency_hz = 0.2"),
            "did you mean `frequency_hz`?",
        ),
        (
            "unknown key",
            swap(f, "frequency_hz = 0.2\nspeed = 3"),
            "unknown key `speed`",
        ),
        (
            "unknown key in an oscillator",
            swap(a, "amplitude_deg = 40\ncolour = 1"),
            "unknown key `colour`",
        ),
        (
            "unknown table",
            [GOOD.as_bytes(), b"\n[motor]\nx = 1\n"].concat(),
            "unknown key `motor`",
        ),
        (
            "key twice",
            swap(f, "frequency_hz = 0.2\nfrequency_hz = 0.3"),
            "TOML",
        ),
        (
            "dotted key",
            swap(f, "frequency_hz.x = 0.2"),
            "expected a number",
        ),
        (
            "format 2",
            swap("format = 1", "format = 2"),
            "reads format = 1",
        ),
        (
            "format as text",
            swap("format = 1", "format = \"1\""),
            "format",
        ),
        ("no format", swap("format = 1\n", ""), "format is missing"),
        ("no name", swap("name = \"crawl\"\n", ""), "name is missing"),
        ("name empty", swap("\"crawl\"", "\"\""), "name has 0 bytes"),
        ("name of blanks", swap("\"crawl\"", "\"   \""), "name"),
        (
            "name too long",
            swap("\"crawl\"", &format!("\"{}\"", "n".repeat(33))),
            "33 bytes",
        ),
        (
            "name with escape code",
            swap("\"crawl\"", "\"\\u001b[31mred\""),
            "control character",
        ),
        (
            "name that turns the line round",
            swap("\"crawl\"", "\"a\\u202eb\""),
            "control character",
        ),
        (
            "name as number",
            swap("\"crawl\"", "7"),
            "expected a string",
        ),
        (
            "lag missing",
            swap("phase_lag_deg = [90, -90, 180, 90, -90]\n", ""),
            "phase_lag_deg is missing",
        ),
        (
            "lag too short",
            swap("[90, -90, 180, 90, -90]", "[90, -90]"),
            "phase_lag has 2 entries",
        ),
        (
            "lag too long",
            swap("[90, -90, 180, 90, -90]", "[90, -90, 180, 90, -90, 0]"),
            "phase_lag has 6 entries",
        ),
        (
            "lag nan",
            swap("[90, -90,", "[90, nan,"),
            "not a finite number",
        ),
        (
            "lag as number",
            swap("[90, -90, 180, 90, -90]", "90"),
            "a list of numbers",
        ),
        (
            "lag out of range",
            swap("[90, -90,", "[90, -900,"),
            "-360 to 360 deg",
        ),
        (
            "lag of strings",
            swap("[90, -90,", "[90, \"x\","),
            "expected a number",
        ),
        (
            "coupling unknown",
            swap("\"chain\"", "\"star\""),
            "\"chain\", \"none\"",
        ),
        (
            "coupling missing",
            swap("coupling = \"chain\"\n", ""),
            "coupling is missing",
        ),
        (
            "no coupling but lags",
            swap("\"chain\"", "\"none\""),
            "does not go with",
        ),
        (
            "chain and links",
            [
                GOOD.as_bytes(),
                b"\n[[link]]\nfrom = 0\nto = 1\nphase_lag_deg = 0\n",
            ]
            .concat(),
            "does not go with [[link]]",
        ),
        (
            "13 oscillators",
            [
                GOOD.as_bytes(),
                "\n[[oscillator]]\namplitude_deg = 1\n".repeat(7).as_bytes(),
            ]
            .concat(),
            "13 entries",
        ),
        (
            "oscillator as a table",
            b"format = 1\nname = \"x\"\nfrequency_hz = 1\n[oscillator]\namplitude_deg = 1\n"
                .to_vec(),
            "double brackets",
        ),
        (
            "oscillator as a number",
            b"format = 1\nname = \"x\"\nfrequency_hz = 1\noscillator = 3\n".to_vec(),
            "double brackets",
        ),
        (
            "not UTF-8",
            b"format = 1\nname = \"\xff\xfe\"\n".to_vec(),
            "not UTF-8",
        ),
        (
            "UTF-16",
            GOOD.encode_utf16().flat_map(u16::to_le_bytes).collect(),
            "TOML",
        ),
        ("zero bytes", vec![0; 100], "TOML"),
        ("an ELF file", b"\x7fELF\x02\x01\x01\0\0\0".to_vec(), "TOML"),
        ("JSON", b"{\"format\": 1, \"name\": \"x\"}".to_vec(), "TOML"),
        (
            "one megabyte",
            format!("# {}\n{GOOD}", "x".repeat(1 << 20)).into_bytes(),
            "at most 65536",
        ),
        (
            "deep lists",
            format!(
                "format = 1\nx = {}{}\n",
                "[".repeat(20_000),
                "]".repeat(20_000)
            )
            .into_bytes(),
            "TOML",
        ),
        (
            "deep dotted keys",
            format!("format = 1\n{}x = 1\n", "a.".repeat(20_000)).into_bytes(),
            "TOML",
        ),
        (
            "escape codes outside a string",
            b"format = 1\n\x1b[2Jname = \"x\"\n".to_vec(),
            "TOML",
        ),
    ];
    cases.push(("path as a key", swap(f, "\"../../etc\" = 1"), "unknown key"));
    cases
}

#[test]
fn bad_gait_files_are_refused_with_their_place() {
    let folder = Folder::new("bad-gaits");
    let cases = cases();
    assert!(cases.len() >= 60, "{}", cases.len());
    for (name, bytes, words) in cases {
        folder.write("bad.toml", bytes);
        let done = rb(&folder, &["gait", "check", "bad.toml"]);
        assert_eq!(done.code, 3, "{name}: {done:?}");
        assert!(done.err.contains(words), "{name}: {}", done.err);
        assert!(done.err.contains("bad.toml"), "{name}: {}", done.err);
        assert!(done.out.is_empty(), "{name}: {}", done.out);
        assert!(
            !done.err.chars().any(|c| c.is_control() && c != '\n'),
            "{name}: {:?}",
            done.err
        );
        assert!(
            done.err.len() < 1000,
            "{name}: {} bytes of message",
            done.err.len()
        );
    }
}

#[test]
fn gaits_that_the_robot_would_refuse_exit_7_before_anything_is_sent() {
    let folder = Folder::new("unfit-gaits");
    let five = GOOD.replacen(
        "phase_lag_deg = [90, -90, 180, 90, -90]",
        "phase_lag_deg = [90, -90, 180, 90]",
        1,
    );
    let five = five.rsplit_once("[[oscillator]]").unwrap().0.to_owned();
    // At (-140, -140) deg of A.M2 and B.M0 the centres of cubes 1 and 4 are 86 mm apart, less than two radii.
    let fold = GOOD.replacen(
        "amplitude_deg = 35\noffset_deg = 0",
        "amplitude_deg = 20\noffset_deg = -140",
        2,
    );
    let cases = [
        (
            "too fast",
            GOOD.replacen("frequency_hz = 0.2", "frequency_hz = 1.5", 1),
            "no-load speed",
        ),
        ("five joints", five, "5 oscillators"),
        ("hits itself", fold, "hit itself"),
    ];
    for (name, text, words) in cases {
        folder.write("g.toml", text);
        for args in [
            &["gait", "check", "g.toml"][..],
            &["-p", "tcp://127.0.0.1:1", "upload", "g.toml"],
        ] {
            let done = rb(&folder, args);
            assert_eq!(done.code, 7, "{name}: {done:?}");
            assert!(done.err.contains(words), "{name}: {}", done.err);
        }
    }
}

#[test]
fn a_missing_file_names_itself() {
    let folder = Folder::new("missing-gait");
    let done = rb(&folder, &["gait", "check", "nowhere.toml"]).expect(3);
    assert!(
        done.err.contains("cannot read nowhere.toml: No such file"),
        "{}",
        done.err
    );
}
