//! Reports answer five questions on their first screen: where, which, how sure, how far, what now.

mod reports;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use gap::report::{Evidence, markdown, page};
use reports::{Case, cases};

/// How far a picture may be from the one in the documents, where black and white are 1 apart: fonts differ between machines. A blank
/// page is 0.044 or more away, another of the five reports 0.033 or more.
const TOLERANCE: f64 = 0.015;

fn html(case: &Case) -> String {
    page(&case.verdict, &case.subject, &Evidence::default())
}

/// Text without tags.
fn text(html: &str) -> String {
    let mut out = String::new();
    let mut inside = false;
    for c in html.chars() {
        match c {
            '<' => inside = true,
            '>' => {
                inside = false;
                out.push(' ');
            }
            _ if !inside => out.push(c),
            _ => {}
        }
    }
    let words: Vec<&str> = out.split_whitespace().collect();
    words.join(" ")
}

/// What stands before the cards: title, sentence, picture and contents list.
fn first_screen(html: &str) -> String {
    let body = html.split_once("<main>").expect("a page").1;
    text(body.split_once("<section id=\"which\"").expect("cards").0)
}

/// What a reader must find: where, which, how sure, how far, what now.
const ANSWERS: [(&str, [&str; 5]); 5] = [
    (
        "none",
        [
            "Where nowhere: no gap",
            "Which none",
            "no gap to name (97 % sure)",
            "4.10 to 3.70 mrad; repeatability floor (what two takes of one motion differ by) 3.60 mrad",
            "What next Nothing is to be done",
        ],
    ),
    (
        "shared",
        [
            "Gear and load of all six joints: cause 85 %",
            "Which dry friction in the gear (all six joints), 0.600 to 0.800 N m",
            "comes from dry friction in the gear (all six joints) (96 % sure)",
            "21.3 to 4.10 mrad; repeatability floor (what two takes of one motion differ by) 3.60 mrad",
            "What next Put the found values into the simulator",
        ],
    ),
    (
        "class",
        [
            "gear play and twist (46 % of the gap), perhaps controller or gear and load",
            "play in the gear, a dead band of small errors that the controller ignores or extra friction near standstill, which these recordings cannot distinguish",
            "(57 % sure that it is one of them)",
            "18.9 to 7.20 mrad; repeatability floor (what two takes of one motion differ by) 5.20 mrad",
            "What next Bring the joint to 200 mrad and play the slow triangle",
        ],
    ),
    (
        "unknown",
        [
            "Body and ground: most likely here 71 %",
            "Which no effect of the library",
            "No effect of the library explains the gap (93 % sure); look first at the body and ground.",
            "31.2 to 29.1 mm; repeatability floor (what two takes of one motion differ by) 6.00 mm",
            "What next Record each joint alone in the air",
        ],
    ),
    (
        "little-stated",
        [
            "Controller: perhaps the cause 71 %",
            "Which another position gain (no plausible size), 2450 % and a late encoder in the loop, 21.0 ms",
            "State inertia, supply voltage, motor strength and controller gains under [bench] first: without them no cause is certain. Tentatively, a part of the gap comes from another position gain (no plausible size)",
            "83.4 to 19.5 mrad; repeatability floor (what two takes of one motion differ by) 4.80 mrad",
            "What next State this first: inertia, supply voltage, motor strength and controller gains",
        ],
    ),
];

#[test]
fn the_first_screen_answers_five_questions() {
    for (case, (name, answers)) in cases().iter().zip(ANSWERS) {
        assert_eq!(case.name, name);
        let screen = first_screen(&html(case));
        for answer in answers {
            assert!(screen.contains(answer), "{name}: `{answer}` in\n{screen}");
        }
        for about in [case.subject.name.as_str(), "files of 2026-11-20", "runs"] {
            assert!(screen.contains(about), "{name}: `{about}` in\n{screen}");
        }
        assert_eq!(screen.matches("floor (").count(), 1, "{name}: {screen}");
        assert!(screen.split_whitespace().count() < 190, "{name}: {screen}");
    }
}

#[test]
fn equal_effects_at_several_joints_are_one_card() {
    let page = html(&cases()[1]);
    assert_eq!(page.matches("class=\"card\"").count(), 1);
    assert!(
        text(&page)
            .contains("Dry friction of 0.600 to 0.800 N m brakes the gear of all six joints.")
    );
}

#[test]
fn ruled_out_are_rivals_that_the_verdict_distinguishes() {
    let page = text(&html(&cases()[2]));
    let (_, card) = page.split_once("It could as well be").expect("a class");
    let (_, ruled_out) = card.split_once("Ruled out").expect("rivals");
    let (ruled_out, _) = ruled_out.split_once("Error with it alone").expect("errors");
    assert!(
        ruled_out.contains("rounded set-points and dry friction in the gear"),
        "{ruled_out}"
    );
    assert!(!ruled_out.contains("small errors"), "{ruled_out}");
    let last = text(&html(&cases()[4]));
    assert!(
        last.contains("Not ruled out a drive that follows with a lag"),
        "{last}"
    );
}

#[test]
fn one_probability_stands_on_top_and_on_every_card_and_no_rejected_step_at_all() {
    for case in cases() {
        let page = html(&case);
        let all = text(&page);
        let before: Vec<&str> = all.split("% sure").collect();
        let (_, before) = before.split_last().expect("text");
        let figure = |t: &&str| t.split_whitespace().next_back().map(|w| w.replace('(', ""));
        let figures: BTreeSet<_> = before.iter().map(figure).collect();
        let cards = page.matches("class=\"card\"").count();
        let (some, times) = match case.subject.tentative {
            true => (0, 0),
            false => (1, 1 + cards),
        };
        assert_eq!(figures.len(), some, "{}: {all}", case.name);
        assert_eq!(before.len(), times, "{}: {all}", case.name);
        assert!(!all.contains("warms up"), "{}", case.name);
    }
}

#[test]
fn shares_of_a_robot_add_up() {
    let shared = text(&html(&cases()[1]));
    let sum = "Joints 93 % (of which calibration 8 %), remainder 7 %.";
    assert!(shared.contains(sum), "{shared}");
    let unknown = text(&html(&cases()[3]));
    let sum = "Joints 9 %, ground 71 %, remainder 20 %.";
    assert!(unknown.contains(sum), "{unknown}");
}

#[test]
fn without_a_gap_no_empty_box_is_drawn() {
    let page = html(&cases()[0]);
    assert!(!page.contains("<svg class=\"where\""), "{page}");
    let words = "There is no gap to place: no stage of the joint has a share.";
    assert!(text(&page).contains(words), "{page}");
}

#[test]
fn no_certainty_is_claimed_where_too_little_is_stated() {
    let [.., case] = cases();
    assert!(case.subject.tentative);
    for shown in [text(&html(&case)), markdown(&case.verdict, &case.subject)] {
        for word in [" sure", "Otherwise"] {
            assert!(!shown.contains(word), "{word}: {shown}");
        }
    }
}

#[test]
fn no_identifier_stands_for_a_word() {
    let columns = ["link_position", "current_a", "applied_setpoint_rad"];
    for case in cases() {
        for shown in [text(&html(&case)), markdown(&case.verdict, &case.subject)] {
            let ours = shown.split(|c: char| !c.is_alphanumeric() && c != '_');
            let odd: Vec<&str> = ours
                .filter(|w| w.contains('_') && !columns.contains(w))
                .collect();
            assert!(odd.is_empty(), "{}: {odd:?}", case.name);
            assert!(!shown.contains("sigma"), "{}", case.name);
        }
    }
}

#[test]
fn markdown_fits_a_terminal_and_answers_too() {
    for (case, (name, _)) in cases().iter().zip(ANSWERS) {
        let shown = markdown(&case.verdict, &case.subject);
        for line in shown.lines() {
            assert!(line.chars().count() <= 100, "{name}: {line}");
        }
        for part in ["## Where", "## Which cause", "## How far", "## What next"] {
            assert!(shown.contains(part), "{name}: {part}");
        }
    }
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Chromium as Debian, Ubuntu and others call it, where Python is there to drive it.
fn chromium() -> Option<&'static str> {
    let runs = |name: &&str| {
        let asked = Command::new(name).arg("--version").output();
        asked.is_ok_and(|o| o.status.success())
    };
    let names = ["chromium", "chromium-browser", "google-chrome"];
    names.into_iter().find(runs).filter(|_| runs(&"python3"))
}

/// Pictures of the first screens, as `docs/pictures` shows them. New ones lie in `target/tmp/reports`: copy them where a
/// change is meant.
#[test]
fn first_screens_look_as_the_documents_show_them() {
    let Some(chromium) = chromium() else {
        println!("SKIPPED pictures of reports: no Chromium or no python3 (`cargo xtask setup`)");
        eprintln!("SKIPPED pictures of reports: no Chromium or no python3 (`cargo xtask setup`)");
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"));
        return;
    };
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("reports");
    std::fs::create_dir_all(&folder).expect("a folder");
    let mut command = Command::new("python3");
    command
        .arg(root().join("tests/foreign/read_report_in_chromium.py"))
        .args([chromium, "--pictures"])
        .arg(&folder)
        .arg(root().join("docs/pictures"));
    for case in cases() {
        let file = folder.join(format!("report-{}.html", case.name));
        std::fs::write(&file, html(&case)).expect("written");
        command.arg(file);
    }
    let said = command.output().expect("python3 runs");
    let errors = String::from_utf8_lossy(&said.stderr).into_owned();
    assert!(said.status.success(), "{errors}");
    let seen: serde_json::Value = serde_json::from_slice(&said.stdout).expect("json");
    for (name, answers) in ANSWERS {
        let one = &seen[format!("report-{name}")];
        let screen = one["first_screen"].as_str().expect("text");
        for answer in answers {
            let words: Vec<&str> = answer.split_whitespace().collect();
            assert!(
                screen.contains(&words.join(" ")),
                "{name}: `{answer}` in\n{screen}"
            );
        }
        let difference = one["difference"]
            .as_f64()
            .expect("a picture to compare with");
        assert!(difference < TOLERANCE, "{name}: {difference}");
        let others = one["difference_of_others"].as_f64().expect("pictures");
        assert!(
            others > 2.0 * TOLERANCE,
            "{name}: another page is {others} away"
        );
        assert!(
            one["dark"] == true && one["phone_width_px"] == 360,
            "{name}: {one}"
        );
        let size = std::fs::metadata(root().join(format!("docs/pictures/report-{name}.png")));
        assert!(size.expect("a picture").len() <= 150_000, "{name}");
    }
}
