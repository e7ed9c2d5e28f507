//! The time account of the paper's section VIII: what the cycle took, against optimising on the robot alone.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::settings::HybridSettings;

/// Robot time of one experiment beside the run itself [s]: 30 s to reset and maintain the robot (paper, section VIII: at least
/// one minute with the 30 s of the run).
const HANDLING_S: f64 = 30.0;
/// Building the initial simulation model [s]: the paper's upper bound of 50 hours.
const MODEL_S: f64 = 50.0 * 3600.0;
/// A typical optimisation on the robot: 50 particles, 100 iterations, 3 repetitions (paper, section VIII).
const ONLINE_TYPICAL: u64 = 50 * 100 * 3;
/// One hour [s].
const HOUR_S: f64 = 3600.0;

/// What was measured so far, over interruptions. Computing is wall time.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Times {
    /// Wall time of each step, s, by `cycle1/search`.
    pub wall_s: BTreeMap<String, f64>,
    /// Runs on the robot.
    pub experiments: u64,
    /// Robot time of these runs from power-up or connection to the end, s; of an emulated robot its own time.
    pub robot_s: f64,
}

/// One line of the account.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Line {
    /// What.
    pub what: String,
    /// Hours here.
    pub hours: f64,
    /// Hours in the paper, where it gives them.
    pub paper_hours: Option<f64>,
}

/// The account.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Account {
    /// What the cycles took.
    pub hybrid: Vec<Line>,
    /// The sum without the building of the model.
    pub hybrid_hours: f64,
    /// The sum with it.
    pub with_model_hours: f64,
    /// Optimising on the robot alone.
    pub online: Vec<Line>,
    /// How many times shorter the hybrid way is, model included, against each line of `online`.
    pub factors: Vec<f64>,
    /// How many times less a person stands beside the robot.
    pub attended_factors: Vec<f64>,
}

impl Account {
    /// Sums up.
    #[must_use]
    pub fn new(times: &Times, settings: &HybridSettings) -> Self {
        let step = |name: &str| {
            let of = times.wall_s.iter().filter(|(key, _)| key.ends_with(name));
            of.map(|(_, s)| s).sum::<f64>() / HOUR_S
        };
        let line = |what: &str, hours: f64, paper_hours: Option<f64>| Line {
            what: what.to_owned(),
            hours,
            paper_hours,
        };
        let handling = times.experiments as f64 * HANDLING_S;
        let attended = (times.robot_s + handling) / HOUR_S;
        let hybrid = vec![
            line("search in simulation", step("/search"), Some(22.0)),
            line("experiments on the robot", attended, Some(2.0)),
            line("matching the model", step("/match"), Some(20.2)),
            line("simulating again", step("/resimulate"), None),
        ];
        let hybrid_hours = hybrid.iter().map(|line| line.hours).sum::<f64>();
        let search = &settings.search;
        let minute = f64::from(search.space.duration_s) + HANDLING_S;
        let own = search.particles as f64
            * f64::from(search.iterations)
            * f64::from(search.score.repetitions);
        let online = vec![
            line(
                "online, typical: 50 particles, 100 iterations, 3 repetitions",
                ONLINE_TYPICAL as f64 * minute / HOUR_S,
                Some(250.0),
            ),
            line(
                &format!(
                    "online, as searched here: {} particles, {} iterations, {} repetitions",
                    search.particles, search.iterations, search.score.repetitions
                ),
                own * minute / HOUR_S,
                Some(3000.0),
            ),
        ];
        let with_model_hours = hybrid_hours + MODEL_S / HOUR_S;
        let against = |hours: f64| online.iter().map(|line| line.hours / hours).collect();
        Self {
            factors: against(with_model_hours),
            attended_factors: against(attended.max(1e-9)),
            hybrid_hours,
            with_model_hours,
            hybrid,
            online,
        }
    }

    /// For programs.
    #[must_use]
    pub fn json(&self) -> Value {
        json!(self)
    }

    /// For people.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = format!("{:62} {:>10} {:>12}\n", "Time account [h]", "here", "paper");
        for line in self.rows() {
            let paper = line
                .paper_hours
                .map_or_else(|| "-".to_owned(), |h| format!("{h:.1}"));
            let _ = writeln!(out, "{:62} {:>10.3} {paper:>12}", line.what, line.hours);
        }
        let show = |f: &[f64]| match f {
            [typical, own] => format!("{typical:.1} to {own:.1}"),
            _ => String::new(),
        };
        let _ = writeln!(
            out,
            "shorter than online by {} (paper: 2.5 to 30); less time beside the robot by {} (paper: more than 100)",
            show(&self.factors),
            show(&self.attended_factors)
        );
        out
    }

    /// All lines with their sums.
    fn rows(&self) -> Vec<Line> {
        let mut rows = self.hybrid.clone();
        let sum = |what: &str, hours, paper| Line {
            what: what.to_owned(),
            hours,
            paper_hours: Some(paper),
        };
        rows.push(sum("hybrid, sum", self.hybrid_hours, 44.2));
        rows.push(sum(
            "with 50 h for building the model (the paper's bound)",
            self.with_model_hours,
            94.2,
        ));
        rows.extend(self.online.clone());
        rows
    }

    /// Bars on a scale of powers of ten, as SVG.
    #[must_use]
    pub fn svg(&self) -> String {
        const ROW: f64 = 26.0;
        const LEFT: f64 = 430.0;
        const DECADE: f64 = 55.0;
        // From a thousandth of an hour to ten thousand hours.
        const DECADES: (i32, i32) = (-3, 4);
        let rows = self.rows();
        let (width, height) = (LEFT + DECADE * 7.0 + 70.0, ROW * rows.len() as f64 + 50.0);
        let at = |hours: f64| {
            let decade = hours.max(1e-3).log10().min(f64::from(DECADES.1));
            LEFT + (decade - f64::from(DECADES.0)) * DECADE
        };
        let mut out = format!(
            r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" aria-label="time account"><style>text{{font:13px system-ui,sans-serif;fill:#333}}</style><rect width="{width}" height="{height}" fill="#fff"/>"##
        );
        for decade in DECADES.0..=DECADES.1 {
            let x = at(10f64.powi(decade));
            let _ = write!(
                out,
                r##"<line x1="{x:.0}" x2="{x:.0}" y1="8" y2="{:.0}" stroke="#ddd"/><text x="{x:.0}" y="{:.0}" text-anchor="middle">{} h</text>"##,
                height - 34.0,
                height - 14.0,
                10f64.powi(decade)
            );
        }
        for (k, line) in rows.iter().enumerate() {
            let y = 12.0 + ROW * k as f64;
            let colour = if k < rows.len() - self.online.len() {
                "#3b6fd4"
            } else {
                "#d6453d"
            };
            let _ = write!(
                out,
                r##"<text x="{:.0}" y="{:.0}" text-anchor="end">{}</text><rect x="{LEFT}" y="{y:.0}" width="{:.1}" height="{}" fill="{colour}"/><text x="{:.0}" y="{:.0}">{:.3}</text>"##,
                LEFT - 8.0,
                y + 14.0,
                line.what,
                (at(line.hours) - LEFT).max(1.0),
                ROW - 8.0,
                at(line.hours) + 6.0,
                y + 14.0,
                line.hours
            );
        }
        out.push_str("</svg>\n");
        out
    }
}
