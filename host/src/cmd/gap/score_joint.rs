//! Scores of the blind check of one joint: opened labels against verdicts, by effect.

use serde_json::Value;

use super::score::{Opened, Table, calibration, failures, row, several, share, sizes, words};

fn clear(o: &Opened) -> bool {
    o.floors("floors")
}

/// The figures of the mixed suite.
pub(super) fn table(pairs: &[(Value, Value)]) -> Table {
    let all: Vec<Opened> = pairs.iter().map(Opened::bench).collect();
    let pick =
        |f: &dyn Fn(&Opened) -> bool| -> Vec<&Opened> { all.iter().filter(|o| f(o)).collect() };
    let singles = pick(&|o| o.kind() == "single" && clear(o));
    let every_single = pick(&|o| o.kind() == "single");
    let pairs = pick(&|o| o.kind() == "pair" && clear(o));
    let known = pick(&|o| matches!(o.kind(), "single" | "pair" | "triple"));
    let n = singles.len();
    let mut rows = vec![
        row(
            "top-1, detectable singles",
            share(&singles, Opened::top_right),
            n,
            ">= 0.97",
        ),
        row(
            "top-1, all singles",
            share(&every_single, Opened::top_right),
            every_single.len(),
            "-",
        ),
        row(
            "exact set, detectable singles",
            share(&singles, Opened::exact),
            n,
            ">= 0.95",
        ),
        row(
            "stage, detectable singles",
            share(&singles, Opened::stage_said),
            n,
            ">= 0.99",
        ),
    ];
    let names = [
        "precision, detectable pairs",
        "recall, detectable pairs",
        "exact, detectable pairs",
    ];
    rows.extend(several(&pairs, names));
    rows.extend(words(&all, &clear));
    rows.extend(sizes(&known, &singles));
    let every = pick(&|_| true);
    rows.push(row(
        "confidence calibration error",
        calibration(&every),
        all.len(),
        "<= 0.05",
    ));
    Table::new(rows, failures(&all, &clear))
}

/// The figures with the planted effect withheld from the library. Where the best of the rest leaves more than two floors, the word
/// must be `unknown` and the first place of the gap the stage of the effect. Otherwise something must be declared to take its
/// place, in its stage: an effect, or a nominal value that calibration took off by more than three tolerances (`displaced`).
/// Withholding a base effect does not take its parameter out of the nominal model, so that value may be the effect's own.
pub(super) fn left_out(pairs: &[(Value, Value)]) -> Table {
    let all: Vec<Opened> = pairs.iter().map(Opened::bench).collect();
    let detectable = all.iter().filter(|o| clear(o));
    let (far, near): (Vec<&Opened>, Vec<&Opened>) = detectable.partition(|o| o.far_off());
    let unknown = |o: &Opened| o.word() == "unknown";
    let rows = vec![
        row(
            "unknown, more than 2 floors left",
            share(&far, unknown),
            far.len(),
            "-",
        ),
        row(
            "unknown and right stage",
            share(&far, |o| unknown(o) && o.stage_seen()),
            far.len(),
            ">= 0.85",
        ),
        row(
            "declared equivalent with right stage, otherwise (effect, or nominal value > 3 tolerances off)",
            share(&near, Opened::equivalent_stage),
            near.len(),
            ">= 0.85",
        ),
        row(
            "of these declared by a nominal value alone",
            share(&near, Opened::displaced_only),
            near.len(),
            "-",
        ),
        row(
            "of these declared by the nominal value of the withheld effect itself",
            share(&near, Opened::displaced_itself),
            near.len(),
            "-",
        ),
        row(
            "first place of the gap in the right stage, otherwise",
            share(&near, Opened::stage_seen),
            near.len(),
            "-",
        ),
    ];
    let far_missed = far.iter().filter(|o| !unknown(o) || !o.stage_seen());
    let near_missed = near.iter().filter(|o| !o.equivalent_stage());
    let missed = far_missed.chain(near_missed);
    Table::new(rows, missed.map(|o| o.told()).collect())
}
