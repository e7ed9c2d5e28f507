//! Scores of the whole-robot blind check: opened labels against verdicts, by effect and joint.

use serde_json::Value;

use super::score::{
    Group, Opened, Row, Table, calibration, failures, median, row, several, share, sizes, words,
};

/// The figures of a suite.
pub(super) fn table(pairs: &[(Value, Value)]) -> Table {
    let all: Vec<Opened> = pairs.iter().map(Opened::new).collect();
    let pick =
        |f: &dyn Fn(&Opened) -> bool| -> Vec<&Opened> { all.iter().filter(|o| f(o)).collect() };
    let motion = |o: &Opened| o.floors("floors");
    let any = |o: &Opened| o.floors("floors_any");
    let one = pick(&|o| o.kind() == "single" && motion(o));
    let one_any = pick(&|o| o.kind() == "single" && any(o));
    let one_all = pick(&|o| o.kind() == "single");
    let more = pick(&|o| matches!(o.kind(), "pair" | "triple") && any(o));
    let mut rows = singles(&one, &one_any, &one_all);
    let adds = pick(&|o| o.kind() == "single" && o.adds("floors"));
    let adds_any = pick(&|o| o.kind() == "single" && o.adds("floors_any"));
    let names = [
        "top-1, singles that add two floors in motion",
        "exact set, singles that add two floors in motion",
        "stage and joint, singles that add two floors in motion",
    ];
    rows.extend(adding(&adds, names));
    let names = [
        "top-1, singles that add two floors in any channel",
        "exact set, singles that add two floors in any channel",
        "stage and joint, singles that add two floors in any channel",
    ];
    rows.extend(adding(&adds_any, names));
    let moved = pick(&|o| matches!(o.kind(), "pair" | "triple") && motion(o));
    let names = [
        "precision, two or three causes detectable in motion",
        "recall, two or three causes detectable in motion",
        "exact, two or three causes detectable in motion",
    ];
    rows.extend(several(&moved, names));
    let names = [
        "precision, two or three causes detectable in any channel",
        "recall, two or three causes detectable in any channel",
        "exact, two or three causes detectable in any channel",
    ];
    rows.extend(several(&more, names));
    rows.extend(words(&all, &any));
    let known = pick(&|o| !matches!(o.kind(), "null" | "outside"));
    // Of what nobody can see, no probability is right.
    let clear = pick(&|o| o.kind() == "null" || any(o));
    rows.extend(sizes(&known, &one_any));
    rows.push(row(
        "confidence calibration error, nulls and detectable",
        calibration(&clear),
        clear.len(),
        "<= 0.05",
    ));
    let times = all
        .iter()
        .filter_map(|o| o.verdict["provenance"]["wall_time_s"].as_f64())
        .collect();
    rows.push(row(
        "wall time of a diagnosis, median, s",
        median(times),
        all.len(),
        "<= 60",
    ));
    Table::new(rows, failures(&all, &any))
}

/// The figures with the planted effect of every single withheld from the library; beside each pair the verdict of the whole library, where there is one.
pub(super) fn left_out(pairs: &[(Value, Value)], whole: &[Option<Value>]) -> Table {
    let all: Vec<(Opened, Option<&Value>)> = pairs
        .iter()
        .zip(whole)
        .map(|(pair, whole)| (Opened::new(pair), whole.as_ref()))
        .filter(|(o, _)| o.floors("floors_any"))
        .collect();
    let right = |o: &Opened| o.word() == "unknown" && o.stage_right() && o.joint_right();
    let equivalent = |o: &Opened| !o.said.is_empty() && o.stage_right() && o.joint_right();
    let parted = |far: bool, is: &dyn Fn(&Opened, Option<&Value>) -> bool| -> Vec<&Opened> {
        let own = all.iter().filter(|(o, whole)| is(o, *whole) == far);
        own.map(|x| &x.0).collect()
    };
    let off = |o: &Opened, _: Option<&Value>| o.far_off();
    let from = |o: &Opened, whole: Option<&Value>| o.far_from(whole);
    let [far, near] = [true, false].map(|far| parted(far, &off));
    let [beyond, within] = [true, false].map(|far| parted(far, &from));
    let unknown = |o: &Opened| o.word() == "unknown";
    let said = |o: &Opened| o.word() != "none";
    let of = |name, group: &Vec<&Opened>, is: &dyn Fn(&Opened) -> bool, target| {
        row(name, share(group, is), group.len(), target)
    };
    let rows = vec![
        of("unknown, more than 2 floors left", &far, &unknown, "-"),
        of(
            "unknown, right stage and joint, more than 2 floors left",
            &far,
            &right,
            ">= 0.85",
        ),
        of(
            "something said or unknown, more than 2 floors left",
            &far,
            &said,
            "-",
        ),
        of(
            "an equivalent with right stage and joint, otherwise",
            &near,
            &equivalent,
            ">= 0.85",
        ),
        of(
            "unknown, right stage and joint, more than twice left what the right diagnosis leaves",
            &beyond,
            &right,
            "-",
        ),
        of(
            "an equivalent with right stage and joint, within that",
            &within,
            &equivalent,
            "-",
        ),
    ];
    let wrong = |(o, _): &&(Opened, Option<&Value>)| {
        if o.far_off() {
            !right(o)
        } else {
            !equivalent(o)
        }
    };
    Table::new(rows, all.iter().filter(wrong).map(|x| x.0.told()).collect())
}

/// The figures of singles whose cause adds two floors to the error of a diagnosis without it.
fn adding(group: Group<'_>, names: [&'static str; 3]) -> Vec<Row> {
    let place = |o: &Opened| o.stage_right() && o.joint_right();
    let figures = [
        share(group, Opened::top_right),
        share(group, Opened::exact),
        share(group, place),
    ];
    let told = |(name, value)| row(name, value, group.len(), "-");
    names.into_iter().zip(figures).map(told).collect()
}

fn singles(one: Group<'_>, any: Group<'_>, all: Group<'_>) -> Vec<Row> {
    let (n, m) = (one.len(), any.len());
    vec![
        row(
            "top-1, singles detectable in motion",
            share(one, Opened::top_right),
            n,
            ">= 0.97",
        ),
        row(
            "top-1, singles detectable in any channel",
            share(any, Opened::top_right),
            m,
            "-",
        ),
        row(
            "top-1, all singles",
            share(all, Opened::top_right),
            all.len(),
            "-",
        ),
        row(
            "exact set, singles detectable in motion",
            share(one, Opened::exact),
            n,
            ">= 0.95",
        ),
        row(
            "exact set, singles detectable in any channel",
            share(any, Opened::exact),
            m,
            "-",
        ),
        row(
            "stage, singles detectable in any channel",
            share(any, Opened::stage_right),
            m,
            ">= 0.99",
        ),
        row(
            "joint, singles detectable in any channel",
            share(any, Opened::joint_right),
            m,
            ">= 0.99",
        ),
    ]
}
