//! `rb-host monitor`

use std::io::IsTerminal;
use std::time::Duration;

use protocol::link::{FromModule, Info, Sample, SampleBlock, TelemetryRate, ToModule};
use serde_json::json;

use crate::cli::parse_duration;
use crate::context::Context;
use crate::failure::Outcome;
use crate::link::{LinkError, telemetry, text};
use crate::recording::{SampleRow, joint_names};
use crate::terminal;

/// Show set-points, positions, currents and events live, until Ctrl-C; the robot is not touched
#[derive(Debug, clap::Args)]
pub struct Args {
    /// End after this time
    #[arg(short, long, value_name = "TIME", value_parser = parse_duration)]
    duration: Option<Duration>,
    /// Samples per second, 20 or 100
    #[arg(long, value_name = "HZ", default_value = "20", value_parser = ["20", "100"])]
    rate: String,
    /// Print one line per sample instead of a table that refreshes
    #[arg(long)]
    plain: bool,
}

/// The table is drawn this often: a person reads no faster.
const REFRESH: Duration = Duration::from_millis(200);

/// Shows telemetry.
///
/// # Errors
/// Exit codes 4, 5, 6.
pub fn run(args: &Args, context: &Context) -> Outcome {
    let mut robot = context.connect_to_change()?;
    let rate = if args.rate == "100" {
        TelemetryRate::Fast
    } else {
        TelemetryRate::Cycle
    };
    robot.order(&ToModule::Subscribe { rate })?;
    let table = std::io::stdout().is_terminal() && !args.plain && !context.out.json;
    if !table {
        let names = joint_names(usize::from(robot.machine()?.joints())).join(", ");
        context.out.say(format_args!(
            "time, then set-point/position in deg of {names}"
        ));
    }
    let until = args.duration.map(|d| robot.link().now() + d);
    let mut view = View {
        table,
        drawn_at: None,
        info: robot.info()?,
        event: String::new(),
    };
    while until.is_none_or(|until| robot.link().now() < until) {
        let message = match robot.next(Duration::from_millis(100)) {
            Ok(message) => message,
            Err(LinkError::Interrupted) => break,
            Err(error) => return Err(error.into()),
        };
        let now = robot.link().now();
        match message {
            Some(FromModule::Sample(sample) | FromModule::SampleOf(sample)) => {
                view.sample(&sample, now, context);
            }
            Some(FromModule::SampleBlock(block) | FromModule::SampleBlockOf(block)) => {
                view.block(&block, now, context);
            }
            Some(FromModule::Event(event)) => {
                let (kind, words) = text::event(&event);
                view.event = format!("{:.3} s {kind} {words}", event.t_us as f64 / 1e6);
                if !view.table {
                    context.out.say(&view.event);
                }
            }
            _ => {}
        }
    }
    robot.finish_in_peace();
    robot.order(&ToModule::Subscribe {
        rate: TelemetryRate::Off,
    })?;
    Ok(())
}

struct View {
    table: bool,
    drawn_at: Option<Duration>,
    info: Info,
    event: String,
}

impl View {
    fn block(&mut self, block: &SampleBlock, now: Duration, context: &Context) {
        for sample in block.samples().flatten() {
            self.sample(&sample, now, context);
        }
    }

    fn sample(&mut self, sample: &Sample, now: Duration, context: &Context) {
        let row = telemetry::row(0, sample);
        if !self.table {
            line(&row, context);
            return;
        }
        if self
            .drawn_at
            .is_some_and(|at| now.saturating_sub(at) < REFRESH)
        {
            return;
        }
        self.draw(&row, context);
        self.drawn_at = Some(now);
    }

    /// Home, clear, table: one write, so that it does not flicker.
    fn draw(&self, row: &SampleRow, context: &Context) {
        let flag = |on: bool, word: &'static str| if on { word } else { "" };
        let mut screen = format!(
            "\u{1b}[H\u{1b}[Jstate {}   t {:.2} s   cycle {}   {} {} {}\n\n{:8} {:>10} {:>10} {:>8} {:>9} {:>7} {:>7} {:>6}\n",
            text::state(self.info.state),
            row.t_us as f64 / 1e6,
            row.cycle,
            flag(row.torque, "torque"),
            flag(row.approach, "approach"),
            flag(row.hold, "HOLD"),
            "joint",
            "set deg",
            "pos deg",
            "err deg",
            "deg/s",
            "A",
            "V",
            "C",
        );
        for (joint, name) in row.joints.iter().zip(joint_names(row.joints.len())) {
            let set = joint.setpoint_rad.to_degrees();
            match joint.feedback {
                Some(f) => {
                    let pos = f.position_rad.to_degrees();
                    screen.push_str(&format!(
                        "{name:8} {set:>10.2} {pos:>10.2} {:>8.2} {:>9.1} {:>7.3} {:>7.2} {:>6.0}\n",
                        set - pos,
                        f.velocity_rad_s.to_degrees(),
                        f.current_a,
                        f.voltage_v,
                        f.temperature_c
                    ));
                }
                None => screen.push_str(&format!("{name:8} {set:>10.2}   no answer\n")),
            }
        }
        screen.push_str(&format!(
            "\nlast event: {}\nCtrl-C ends the view, the robot goes on; `rb-host stop` stops it\n",
            terminal::clean(&self.event)
        ));
        context.out.document(&screen);
    }
}

fn line(row: &SampleRow, context: &Context) {
    let positions: Vec<Option<f64>> = row
        .joints
        .iter()
        .map(|j| j.feedback.map(|f| f.position_rad))
        .collect();
    let setpoints: Vec<f64> = row.joints.iter().map(|j| j.setpoint_rad).collect();
    let currents: Vec<Option<f64>> = row
        .joints
        .iter()
        .map(|j| j.feedback.map(|f| f.current_a))
        .collect();
    let value = json!({
        "t_s": row.t_us as f64 / 1e6, "cycle": row.cycle, "hold": row.hold, "setpoint_rad": setpoints,
        "position_rad": positions, "current_a": currents,
    });
    context.out.result("rb.sample/1", value, || {
        let cells = row.joints.iter().map(|j| match j.feedback {
            Some(f) => format!(
                "{:8.2}/{:8.2}",
                j.setpoint_rad.to_degrees(),
                f.position_rad.to_degrees()
            ),
            None => format!("{:8.2}/    none", j.setpoint_rad.to_degrees()),
        });
        let hold = if row.hold { " HOLD" } else { "" };
        format!(
            "{:10.3} s {}{hold}",
            row.t_us as f64 / 1e6,
            cells.collect::<Vec<_>>().join(" ")
        )
    });
}
