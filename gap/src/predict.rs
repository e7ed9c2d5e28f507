//! What the model predicts, as the CSV of a data set run.

use std::fmt::Write as _;

use crate::joint::Channel;
use crate::locate::{Scored, State};

/// CSV text of run `run` as a state of the joint predicts it: time, set-point, and every channel that the joint model has.
#[must_use]
pub fn csv(scored: &Scored<'_>, run: usize, state: &State) -> String {
    let problem = scored.sent;
    let (_, trace) = scored.played(state, run);
    let data = &problem.runs[run];
    let (angle, effort) = if problem.linear {
        ("m", "n")
    } else {
        ("rad", "nm")
    };
    let volts = data.nominal.supply_v != 1.0;
    let mut s = format!("t_s,setpoint_{angle},enable,position_{angle},link_position_{angle},duty");
    if problem.known.effort_unit {
        let _ = write!(s, ",effort_{effort}");
    }
    s.push_str(if volts { ",bus_v\n" } else { "\n" });
    let mut held = 0;
    for (row, y) in data.samples.iter().zip(&trace) {
        let t = (row.step as f64 + row.part) * problem.dt_s;
        while data
            .command_t_s
            .get(held + 1)
            .is_some_and(|c| *c <= t + 1e-9)
        {
            held += 1;
        }
        let c = |k: Channel| y[k as usize];
        let sp = data.command.get(held).copied().unwrap_or(0.0);
        let _ = write!(
            s,
            "{:.6},{sp:.6},{},{:.6},{:.6},{:.5}",
            data.t0_s + t,
            u8::from(row.enabled),
            c(Channel::Position),
            c(Channel::Link),
            c(Channel::Duty)
        );
        if problem.known.effort_unit {
            let _ = write!(s, ",{:.6}", c(Channel::Effort));
        }
        if volts {
            let _ = write!(s, ",{:.4}", c(Channel::BusVoltage));
        }
        s.push('\n');
    }
    s
}
