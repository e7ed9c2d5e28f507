//! Pictures of runs and gaits as self-contained SVG files.

mod panel;
mod strip;
mod svg;

use control::gait::Gait;
use control::robot::{JOINT_NAMES, JOINTS, RobotModel};

use crate::recording::check::gaps;
use crate::recording::timing::Timing;
use crate::recording::{RunData, SampleRow, joint_names};
use panel::{Band, Curve, Panel};
use svg::Svg;

/// Width of the picture: two columns of panels on a laptop screen.
const WIDTH: f64 = 1160.0;
const MARGIN: f64 = 24.0;
const COLUMN: f64 = (WIDTH - 3.0 * MARGIN) / 2.0;
const PANEL_HEIGHT: f64 = 150.0;
const STRIP_HEIGHT: f64 = 132.0;

/// Colours that stay apart in grey and for colour-blind readers (Okabe and Ito 2008).
pub(crate) const MODULE_A: &str = "#0072b2";
pub(crate) const MODULE_B: &str = "#d55e00";
const SETPOINT: &str = "#666666";
const CURRENT: &str = "#cc79a7";
const VOLTAGE: &str = "#009e73";

fn colour(joint: usize) -> &'static str {
    if joint < 3 { MODULE_A } else { MODULE_B }
}

/// A run: film strip of a meta-module, set-points against positions of every joint, currents and bus voltage.
#[must_use]
pub fn run_svg(run: &RunData, model: &RobotModel, emulated: bool) -> String {
    let first_us = run.samples.first().map_or(0, |s| s.t_us);
    let timing = Timing::of(run).unwrap_or(Timing {
        period_us: control::CYCLE_US,
        start_us: first_us,
        end_us: first_us,
    });
    let seconds = |t_us: u64| (t_us as f64 - timing.start_us as f64) / 1e6;

    let span = (
        run.samples.first().map_or(0.0, |s| seconds(s.t_us)),
        run.samples.last().map_or(1.0, |s| seconds(s.t_us)),
    );
    let joints = run
        .samples
        .iter()
        .map(|s| s.joints.len())
        .max()
        .unwrap_or(0);
    let names = joint_names(joints);
    let strip_height = if joints == JOINTS { STRIP_HEIGHT } else { 0.0 };
    let rows = joints.div_ceil(2).max(1);
    let place = |column, row| place(strip_height, column, row);
    let height = 96.0 + strip_height + (rows + 1) as f64 * (PANEL_HEIGHT + 34.0) + 50.0;
    let mut out = Svg::new(WIDTH, height);
    title(&mut out, run, emulated);
    if joints == JOINTS {
        strip::draw(
            &mut out,
            run,
            model,
            span,
            &seconds,
            (MARGIN, 96.0),
            WIDTH - 2.0 * MARGIN,
        );
    }
    let bands = bands(run, &seconds);
    for (joint, name) in names.iter().enumerate() {
        // Module A on the left, B on the right.
        let at = place(joint / rows, joint % rows);
        joint_panel(run, joint, name, &timing, &seconds).draw(
            &mut out,
            at,
            (COLUMN, PANEL_HEIGHT),
            span,
            &bands,
        );
    }
    current_panel(run, &seconds).draw(
        &mut out,
        place(0, rows),
        (COLUMN, PANEL_HEIGHT),
        span,
        &bands,
    );
    voltage_panel(run, &seconds).draw(
        &mut out,
        place(1, rows),
        (COLUMN, PANEL_HEIGHT),
        span,
        &bands,
    );
    legend(&mut out, height - 14.0);
    out.finish()
}

fn place(strip_height: f64, column: usize, row: usize) -> (f64, f64) {
    let x = MARGIN + column as f64 * (COLUMN + MARGIN);
    (
        x,
        96.0 + strip_height + 24.0 + row as f64 * (PANEL_HEIGHT + 34.0),
    )
}

fn title(out: &mut Svg, run: &RunData, emulated: bool) {
    let gait = run.start.as_ref().map_or("run", |s| s.gait.as_str());
    out.text((MARGIN, 38.0), 24.0, "#111111", "start", gait);
    let robot = if emulated { "emulated robot, " } else { "" };
    let mut words = format!("{robot}run {}, {} samples", run.run + 1, run.samples.len());
    match &run.end {
        Some(end) => {
            words.push_str(&format!(", {}, {} cycles", end.reason, end.cycles));
            for (count, what) in [
                (end.holds, "held"),
                (end.dropped_by_module, "dropped"),
                (end.lost_on_link, "lost"),
                (end.reconnects, "reconnects"),
            ] {
                if count > 0 {
                    words.push_str(&format!(", {count} {what}"));
                }
            }
        }
        None => words.push_str(", the end was not recorded"),
    }
    out.text((MARGIN, 60.0), 13.0, "#555555", "start", &words);
    out.text(
        (MARGIN, 80.0),
        12.0,
        "#555555",
        "start",
        "poses from the measured positions, body 3 held still; seen from above and the side",
    );
}

fn legend(out: &mut Svg, y: f64) {
    let mut x = MARGIN;
    let entries = [
        (SETPOINT, "set-point"),
        (MODULE_A, "position, module A"),
        (MODULE_B, "position, module B"),
        ("#f6c7c7", "pre-check hold"),
        ("#d9d9d9", "missing samples"),
        ("#e8f0fa", "way to the start pose"),
    ];
    for (colour, words) in entries {
        out.rect((x, y - 9.0), (18.0, 9.0), colour, 1.0);
        out.text((x + 24.0, y), 12.0, "#333333", "start", words);
        x += 36.0 + 7.0 * words.len() as f64;
    }
}

/// Shaded times: holds, missing samples, approach.
fn bands(run: &RunData, seconds: &impl Fn(u64) -> f64) -> Vec<Band> {
    let mut bands = Vec::new();
    let mut spans = |test: &dyn Fn(&SampleRow) -> bool, colour: &'static str| {
        let mut open: Option<f64> = None;
        let mut last = 0.0;
        for sample in &run.samples {
            let t = seconds(sample.t_us);
            match (test(sample), open) {
                (true, None) => open = Some(t),
                (false, Some(from)) => {
                    bands.push(Band {
                        from,
                        to: t,
                        colour,
                    });
                    open = None;
                }
                _ => {}
            }
            last = t;
        }
        if let Some(from) = open {
            bands.push(Band {
                from,
                to: last,
                colour,
            });
        }
    };
    spans(&|s| s.approach || s.cycle == 0, "#e8f0fa");
    spans(&|s| s.hold, "#f6c7c7");
    bands.extend(gaps(run).iter().map(|g| Band {
        from: seconds(g.after_us),
        to: seconds(g.before_us),
        colour: "#d9d9d9",
    }));
    bands
}

fn joint_panel(
    run: &RunData,
    joint: usize,
    name: &str,
    timing: &Timing,
    seconds: &impl Fn(u64) -> f64,
) -> Panel {
    let mut setpoint = Vec::new();
    let mut position = Vec::new();
    let mut squares = 0.0;
    for sample in &run.samples {
        let Some(row) = sample.joints.get(joint) else {
            continue;
        };
        // A set-point holds until the next one.
        let sent_s = seconds(timing.sent_us(sample));
        if let Some(&(_, before)) = setpoint.last() {
            setpoint.push((sent_s, before));
        }
        setpoint.push((sent_s, row.setpoint_rad.to_degrees()));

        if let Some(feedback) = row.feedback {
            let error = row.setpoint_rad - feedback.position_rad;
            squares += error * error;
            position.push((seconds(feedback.t_us), feedback.position_rad.to_degrees()));
        }
    }
    let rms = (squares / position.len().max(1) as f64).sqrt().to_degrees();
    Panel {
        title: format!("{joint}  {name}"),
        note: format!("error {rms:.2} deg rms"),
        unit: "deg",
        least_span: 10.0,
        curves: vec![
            Curve {
                colour: SETPOINT,
                width: 1.0,
                points: setpoint,
            },
            Curve {
                colour: colour(joint),
                width: 1.8,
                points: position,
            },
        ],
    }
}

fn current_panel(run: &RunData, seconds: &impl Fn(u64) -> f64) -> Panel {
    let sum = |s: &SampleRow| {
        s.joints
            .iter()
            .flat_map(|j| j.feedback)
            .map(|f| f.current_a.abs())
            .sum::<f64>()
    };
    let points: Vec<(f64, f64)> = run
        .samples
        .iter()
        .map(|s| (seconds(s.t_us), sum(s)))
        .collect();
    let peak = points.iter().fold(0.0f64, |a, p| a.max(p.1));
    Panel {
        title: "motor current, sum of magnitudes".to_owned(),
        note: format!("peak {peak:.2} A"),
        unit: "A",
        least_span: 0.1,
        curves: vec![Curve {
            colour: CURRENT,
            width: 1.4,
            points,
        }],
    }
}

fn voltage_panel(run: &RunData, seconds: &impl Fn(u64) -> f64) -> Panel {
    let lowest = |s: &SampleRow| {
        s.joints
            .iter()
            .flat_map(|j| j.feedback)
            .map(|f| f.voltage_v)
            .reduce(f64::min)
    };
    let points: Vec<(f64, f64)> = run
        .samples
        .iter()
        .filter_map(|s| Some((seconds(s.t_us), lowest(s)?)))
        .collect();
    let least = points.iter().fold(f64::INFINITY, |a, p| a.min(p.1));
    Panel {
        title: "bus voltage, lowest of all drivers".to_owned(),
        note: if least.is_finite() {
            format!("lowest {least:.2} V")
        } else {
            "not measured".to_owned()
        },
        unit: "V",
        least_span: 0.2,
        curves: vec![Curve {
            colour: VOLTAGE,
            width: 1.4,
            points,
        }],
    }
}

/// The set-points of a gait over its duration, one panel per oscillator.
#[must_use]
pub fn gait_svg(gait: &Gait) -> String {
    let count = gait.oscillators().len();
    let rows = count.div_ceil(2);
    let height = 70.0 + rows as f64 * (PANEL_HEIGHT + 34.0);
    let mut out = Svg::new(WIDTH, height);
    out.text((MARGIN, 38.0), 24.0, "#111111", "start", gait.name());
    let words = format!(
        "set-points as computed, over {} s at {} Hz; no robot has run them here",
        gait.duration_s(),
        gait.frequency_hz()
    );
    out.text((MARGIN, 58.0), 13.0, "#555555", "start", &words);
    let mut points: Vec<Vec<(f64, f64)>> = vec![Vec::new(); count];
    let mut state = control::cpg::start(gait);
    let cycles = (gait.duration_s() / control::CYCLE_S).ceil() as u32;
    for cycle in 0..=cycles {
        let t_s = f64::from(cycle) * f64::from(control::CYCLE_S);
        let set_points = control::cpg::step(gait, &mut state, control::CYCLE_S);
        for (list, value) in points.iter_mut().zip(set_points.as_slice()) {
            list.push((t_s, f64::from(*value).to_degrees()));
        }
    }
    let span = (0.0, f64::from(gait.duration_s()));
    for (k, (points, o)) in points.into_iter().zip(gait.oscillators()).enumerate() {
        let at = (
            MARGIN + (k / rows) as f64 * (COLUMN + MARGIN),
            82.0 + (k % rows) as f64 * (PANEL_HEIGHT + 34.0),
        );
        let panel = Panel {
            title: format!("{k}  {}", JOINT_NAMES.get(k).copied().unwrap_or("")),
            note: format!(
                "amplitude R {:.1} deg, offset X {:.1} deg",
                o.amplitude_rad.to_degrees(),
                o.offset_rad.to_degrees()
            ),
            unit: "deg",
            least_span: 10.0,
            curves: vec![Curve {
                colour: colour(k),
                width: 1.8,
                points,
            }],
        };
        panel.draw(&mut out, at, (COLUMN, PANEL_HEIGHT), span, &[]);
    }
    out.finish()
}
