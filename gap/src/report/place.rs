//! Where, as a picture: the robot with the share of the gap at each joint, or the chain of stages of one joint.

use std::fmt::Write as _;

use super::subject::Subject;
use super::words::{capital, escape, listed};
use crate::sentence::{Kind, Spot, part, percent, perhaps, place, spots, together};
use crate::verdict::{Verdict, Word};
use crate::vocabulary::Stage;

/// Shares below this have no row of their own on a robot.
const LEAST: f64 = 0.01;
/// Rows of a robot; the others are folded.
const ROWS: usize = 6;
/// Width of the picture.
const WIDTH: f64 = 360.0;

fn class(kind: Kind) -> &'static str {
    match kind {
        Kind::Cause => "cause",
        Kind::Calibrated => "bent",
        Kind::Rest => "rest",
    }
}

/// What the share of a spot is.
fn role(v: &Verdict, spot: &Spot, subject: &Subject) -> &'static str {
    let open = perhaps(v);
    match (spot.kind, v.verdict) {
        (Kind::Cause, word) if word != Word::Unknown && subject.tentative => ": perhaps the cause",
        (Kind::Cause, word) if word != Word::Unknown && !open.is_empty() => ": most likely cause",
        (Kind::Calibrated, _) if spot.stage.is_some_and(|s| open.contains(&s)) => {
            ": perhaps the cause"
        }
        (Kind::Cause, Word::Unknown) => ": most likely here",
        (Kind::Cause, _) => ": cause",
        (Kind::Calibrated, Word::Unknown) => ": fitted",
        (Kind::Calibrated, _) => ": calibration",
        (Kind::Rest, Word::Unknown | Word::PartlyExplained) => ": not explained",
        (Kind::Rest, _) => ": remainder within the uncertainty",
    }
}

/// A spot in words.
fn name(v: &Verdict, spot: &Spot, subject: &Subject) -> String {
    match spot.stage {
        None => role(v, spot, subject).trim_start_matches(": ").to_owned(),
        stage => place(stage, &spot.joints, subject.robot) + role(v, spot, subject),
    }
}

/// One row: a box that is filled by the share.
fn row(s: &mut String, y: f64, name: &str, spot: Option<&Spot>) {
    let (kind, share) = spot.map_or((Kind::Calibrated, 0.0), |s| (s.kind, s.share));
    let fill = share.clamp(0.0, 1.0) * WIDTH;
    // What is too long for the row is set smaller.
    const FITS: usize = 38;
    let strong = if kind == Kind::Cause { "strong" } else { "" };
    let small = if name.len() > FITS { " small" } else { "" };
    let look = format!("{strong}{small}");
    let _ = write!(
        s,
        "<rect class=\"{}\" x=\"0\" y=\"{y}\" width=\"{fill:.1}\" height=\"24\"/><rect class=\"box\" x=\".5\" y=\"{}\" width=\"{}\" height=\"23\" rx=\"3\"/>\
         <text class=\"{}\" x=\"8\" y=\"{}\">{}</text>",
        class(kind),
        y + 0.5,
        WIDTH - 1.0,
        look,
        y + 16.5,
        escape(&capital(name))
    );
    if spot.is_some() {
        let _ = write!(
            s,
            "<text class=\"end\" x=\"{}\" y=\"{}\">{}</text>",
            WIDTH - 8.0,
            y + 16.5,
            percent(share)
        );
    }
}

/// How dark a part with this share is.
fn depth(share: f64) -> f64 {
    0.3 + 0.7 * share.clamp(0.0, 1.0)
}

/// Four cubes, six joints, the ground; each joint with its share.
fn robot(s: &mut String, all: &[Spot]) {
    // Centres of the joints: in the cubes 0, 1, 2, 3 and between the cubes of a module.
    const X: [f64; 6] = [40.0, 85.0, 130.0, 230.0, 275.0, 320.0];
    for x in [8.0, 98.0, 198.0, 288.0] {
        let _ = write!(
            s,
            "<rect class=\"box\" x=\"{x}\" y=\"22\" width=\"64\" height=\"64\" rx=\"8\"/>"
        );
    }
    s.push_str("<path class=\"box\" d=\"M162 54H198M0 88H360\"/>");
    let body = all.iter().find(|p| p.stage == Some(Stage::Body));
    let (of, share, words) = match body {
        Some(p) => (
            class(p.kind),
            p.share,
            format!("ground {:.0} %", 100.0 * p.share),
        ),
        None => ("paper", 0.0, "ground".into()),
    };
    let _ = write!(
        s,
        "<rect class=\"{of}\" x=\"0\" y=\"89\" width=\"360\" height=\"16\" fill-opacity=\"{:.2}\"/><text class=\"middle small\" x=\"180\" y=\"101\">{words}</text>",
        depth(share)
    );
    for (k, x) in X.iter().enumerate() {
        let own = || all.iter().filter(|p| p.joints.contains(&k));
        let share: f64 = own().map(|p| p.share).sum();
        let cause = own().any(|p| p.kind == Kind::Cause);
        let (of, weight) = if cause {
            ("cause", "strong")
        } else {
            ("bent", "")
        };
        let depth = match share >= LEAST {
            true => depth(share),
            false => 0.0,
        };
        let _ = write!(
            s,
            "<circle class=\"paper\" cx=\"{x}\" cy=\"54\" r=\"20\"/><circle class=\"{of}\" cx=\"{x}\" cy=\"54\" r=\"20\" fill-opacity=\"{depth:.2}\"/>\
             <circle class=\"box\" cx=\"{x}\" cy=\"54\" r=\"20\"/><text class=\"middle small\" x=\"{x}\" y=\"16\">joint {k}</text>"
        );
        if cause || share >= LEAST {
            let text = format!("{:.0} %", 100.0 * share);
            let _ = write!(
                s,
                "<text class=\"middle {weight}\" x=\"{x}\" y=\"58.5\">{text}</text>"
            );
        }
    }
}

/// What the picture shows, as shares that add up to 100 %: the circles' sum, with what of it is calibration, and the others.
fn sums(v: &Verdict, subject: &Subject) -> String {
    let squares = "Shares of the nominal model's squared error.";
    if !subject.robot {
        return squares.into();
    }
    let all = spots(v);
    let sum = |which: &dyn Fn(&Spot) -> bool| {
        let own = all.iter().filter(|p| which(p)).map(|p| p.share);
        (100.0 * own.sum::<f64>()).round()
    };
    let at_joint = |p: &Spot| !p.joints.is_empty();
    let parts = [
        (
            "ground",
            sum(&|p| p.stage == Some(Stage::Body) && !at_joint(p)),
        ),
        (
            "what joints share",
            sum(&|p| p.stage.is_some_and(|s| s != Stage::Body) && !at_joint(p)),
        ),
        ("remainder", sum(&|p| p.stage.is_none())),
    ];
    let others: f64 = parts.iter().map(|p| p.1).sum();
    // Rounding is the circles', which round each on its own.
    let joints = match sum(&|_| true) {
        100.0 => 100.0 - others,
        _ => sum(&at_joint),
    };
    let calibrated = sum(&|p| at_joint(p) && p.kind == Kind::Calibrated);
    let mut words = vec![match v.verdict != Word::Unknown && calibrated > 0.0 {
        true => format!("joints {joints:.0} % (of which calibration {calibrated:.0} %)"),
        false => format!("joints {joints:.0} %"),
    }];
    let rest = parts.iter().filter(|p| p.1 > 0.0);
    words.extend(rest.map(|(name, share)| format!("{name} {share:.0} %")));
    format!("{}. {squares}", capital(&words.join(", ")))
}

/// The picture.
pub(super) fn picture(s: &mut String, v: &Verdict, subject: &Subject) {
    let all = spots(v);
    if v.verdict == Word::None {
        let what = if subject.robot {
            "joint"
        } else {
            "stage of the joint"
        };
        let _ = write!(s, "<p>There is no gap to place: no {what} has a share.</p>");
        return;
    }
    let mut drawing = String::new();
    let mut y = 0.0;
    let last = |drawing: &mut String, y: &mut f64, spot: &Spot| {
        row(drawing, *y, &name(v, spot, subject), Some(spot));
        *y += 28.0;
    };
    if subject.robot {
        robot(&mut drawing, &all);
        y = 112.0;
        let large = |p: &&Spot| p.share >= LEAST || p.kind == Kind::Cause;
        for spot in together(&all).iter().filter(large).take(ROWS) {
            last(&mut drawing, &mut y, spot);
        }
    } else {
        for (k, stage) in Stage::JOINT.into_iter().enumerate() {
            if k > 0 {
                let _ = write!(
                    drawing,
                    "<path class=\"arrow\" d=\"M174 {}h12l-6 6z\"/>",
                    y - 7.0
                );
            }
            match all.iter().find(|p| p.stage == Some(stage)) {
                Some(spot) => last(&mut drawing, &mut y, spot),
                None => {
                    let maybe = match perhaps(v).contains(&stage) {
                        true => ": perhaps the cause",
                        false => "",
                    };
                    row(&mut drawing, y, &(part(stage).to_owned() + maybe), None);
                    y += 28.0;
                }
            }
            y += 4.0;
        }
        if let Some(rest) = all.iter().find(|p| p.stage.is_none()) {
            last(&mut drawing, &mut y, rest);
        }
    }
    let what = if subject.robot {
        "robot"
    } else {
        "chain of stages of the joint"
    };
    let _ = write!(
        s,
        "<figure><svg class=\"where\" viewBox=\"0 0 {WIDTH} {}\" role=\"img\" aria-label=\"{what} with the share of the gap: {}\">{drawing}</svg><figcaption>{}</figcaption></figure>",
        y.max(1.0),
        escape(&answer(v, subject)),
        escape(&sums(v, subject))
    );
}

/// Where, in words: the places of the causes, or of what nothing explains.
pub(super) fn answer(v: &Verdict, subject: &Subject) -> String {
    if v.verdict == Word::None {
        return "nowhere: no gap".into();
    }
    let all = together(&spots(v));
    let named: Vec<&Spot> = all.iter().filter(|p| p.kind == Kind::Cause).collect();
    let shown = if named.is_empty() {
        all.iter().take(1).collect()
    } else {
        named
    };
    let one = |p: &&Spot| {
        let name = place(p.stage, &p.joints, subject.robot);
        format!("{name} ({} of the gap)", percent(p.share))
    };
    let names: Vec<String> = shown.iter().map(one).collect();
    let open: Vec<&str> = perhaps(v).into_iter().map(part).collect();
    let mut out = listed(&names, 3, "and");
    if v.verdict != Word::Unknown && !open.is_empty() {
        out = format!("{out}, perhaps {}", listed(&open, 3, "or"));
    }
    out
}

/// The same as lines of a table: place and share.
pub(super) fn rows(v: &Verdict, subject: &Subject) -> Vec<Vec<String>> {
    let mut out = vec![vec!["place".to_owned(), "share of the gap".to_owned()]];
    let large = |p: &&Spot| p.share >= LEAST || p.kind == Kind::Cause;
    for spot in together(&spots(v)).iter().filter(large) {
        out.push(vec![name(v, spot, subject), percent(spot.share)]);
    }
    out
}
