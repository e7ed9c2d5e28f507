//! What a data set must state before a cause can be named.

use files::dataset::{Bench, Command, ControllerKind, Manifest, Output};

/// Keys that are missing of any run, each as it is written in `dataset.toml`; empty where enough is stated.
pub(crate) fn missing(manifest: &Manifest) -> Vec<&'static str> {
    let mut out = Vec::new();
    for run in &manifest.runs {
        for key in of_bench(&run.bench) {
            if !out.contains(&key) {
                out.push(key);
            }
        }
    }
    out
}

fn of_bench(b: &Bench) -> Vec<&'static str> {
    let mut out = Vec::new();
    if b.command != Command::Position {
        if b.inertia.is_none() {
            out.push("bench.inertia_kg_m2");
        }
        return out;
    }
    let c = &b.controller;
    if c.output.is_none() {
        out.push("bench.controller.output");
    }
    if c.kp.is_none() {
        out.push("bench.controller.kp");
    }
    if c.kind == Some(ControllerKind::Cascade) && c.kv.is_none() {
        out.push("bench.controller.kv");
    }
    if c.output == Some(Output::Velocity) {
        return out;
    }
    if b.inertia.is_none() {
        out.push("bench.inertia_kg_m2");
    }
    if matches!(c.output, None | Some(Output::Duty | Output::Voltage)) {
        if b.max_effort.is_none() && b.effort_per_volt.is_none() {
            out.push("bench.max_effort_nm");
        }
        if b.max_speed.is_none() && b.effort_per_volt.is_none() {
            out.push("bench.max_speed_rad_s");
        }
    }
    out
}
