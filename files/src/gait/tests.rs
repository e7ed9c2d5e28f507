//! Gait files through the public interface.

use super::{Problem, parse, to_toml};

const CRAWL: &str = include_str!("../../../gaits/crawl.toml");

/// Every shipped gait.
const SHIPPED: &[(&str, &str)] = &[
    ("crawl", CRAWL),
    ("first-move", include_str!("../../../gaits/first-move.toml")),
    ("inchworm", include_str!("../../../gaits/inchworm.toml")),
    ("paddle", include_str!("../../../gaits/paddle.toml")),
    ("roll", include_str!("../../../gaits/roll.toml")),
    ("sidewind", include_str!("../../../gaits/sidewind.toml")),
    ("turn", include_str!("../../../gaits/turn.toml")),
];

#[test]
fn shipped_gaits_are_valid_and_within_joint_speeds() {
    for (name, text) in SHIPPED {
        let gait = parse(name, text).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(gait.name(), *name);
        gait.check_speed(control::robot::RobotModel::default().joints())
            .unwrap_or_else(|e| panic!("{name}: {e}"));
    }
}

#[test]
fn written_gait_reads_back_to_the_same_bits() {
    for (name, text) in SHIPPED {
        let gait = parse(name, text).unwrap();
        let written = to_toml(&gait);
        let again = parse("again", &written).unwrap_or_else(|e| panic!("{e}\n{written}"));
        assert_eq!(gait, again, "{written}");
        assert_eq!(written, to_toml(&again));
    }
}

#[test]
fn angles_without_short_degrees_are_written_in_radians() {
    let text = CRAWL.replacen("amplitude_deg = 20", "amplitude_rad = 0.34906587", 1);
    let gait = parse("g", &text.replacen("0.34906587", "0.34906590", 1)).unwrap();
    let written = to_toml(&gait);
    assert!(written.contains("amplitude_rad = 0.3490659"), "{written}");
    assert_eq!(parse("again", &written).unwrap(), gait);
}

#[test]
fn absent_phases_start_locked() {
    let gait = parse("crawl", CRAWL).unwrap();
    let raw = gait.raw();
    for link in gait.links() {
        let phase = |i: u8| raw.oscillators[usize::from(i)].initial_phase_rad;
        let miss = phase(link.to) - phase(link.from) - link.phase_lag_rad;
        assert!(control::math::wrap_pi(miss).abs() < 1e-5);
    }
}

#[test]
fn links_replace_the_chain() {
    let head = "format = 1\nname = \"ring\"\nfrequency_hz = 0.2\n";
    let rows = "[[oscillator]]\namplitude_deg = 10\n".repeat(3);
    let ring = |last: i32| {
        let link = |from: i32, to: i32, lag: i32| {
            format!("[[link]]\nfrom = {from}\nto = {to}\nphase_lag_deg = {lag}\n")
        };
        format!(
            "{head}{rows}{}{}{}",
            link(0, 1, 120),
            link(1, 2, 120),
            link(2, 0, last)
        )
    };
    let gait = parse("ring.toml", &ring(120)).unwrap();
    assert_eq!(gait.links().len(), 3);
    assert_eq!(parse("again", &to_toml(&gait)).unwrap(), gait);
    let error = parse("ring.toml", &ring(90)).unwrap_err();
    assert_eq!(*error.problem, Problem::OpenLoop);
}

#[test]
fn byte_order_mark_and_windows_line_ends_are_read() {
    let windows = format!("\u{feff}{}", CRAWL.replace('\n', "\r\n"));
    assert_eq!(parse("g", &windows).unwrap(), parse("g", CRAWL).unwrap());
}

#[test]
fn message_names_file_line_column_key_value_range_and_unit() {
    let text = CRAWL.replacen("amplitude_deg = 40", "amplitude_deg = 400", 1);
    let error = parse("gaits/mine.toml", &text).unwrap_err();
    assert_eq!(
        error.to_string(),
        "gaits/mine.toml:16:17: amplitude_deg = 400 is out of range; allowed: 0 to 180 deg\n    16 | amplitude_deg = 400"
    );
}

#[test]
fn escape_codes_never_reach_the_terminal() {
    let text = "format = 1\nname = \"a\\u001b[31mred\"\n\u{1b}[2Jfrequency = 3\n";
    let error = parse("\u{1b}]0;title\u{7}.toml", text).unwrap_err();
    assert!(
        !error
            .to_string()
            .chars()
            .any(|c| c.is_control() && c != '\n')
    );
    let text = CRAWL.replacen("\"crawl\"", "\"a\\u001b[31m\"", 1);
    let error = parse("g", &text).unwrap_err();
    assert!(
        matches!(*error.problem, Problem::NameCharacter { .. }),
        "{error}"
    );
}

/// Every prefix of a valid file is refused or is itself a whole gait; none panics.
#[test]
fn every_truncation_is_refused_or_whole() {
    let mut whole = 0;
    for end in 0..CRAWL.len() {
        if parse("cut", &CRAWL[..end]).is_ok() {
            whole += 1;
        }
    }
    // Only cuts in the last oscillator's optional lines (offset, or digits of its numbers) leave six oscillators.
    assert!(whole <= 40, "{whole} cuts were accepted");
}
