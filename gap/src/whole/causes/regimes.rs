//! Errors of the held-out runs by what the joint does: at its limit, at a reversal, at a blow of the ground.

use std::collections::BTreeMap;

use super::super::body::WINDOW_S;
use super::super::data::{JOINTS, Track};
use super::super::nominal::nominal;
use super::super::windows::PERIOD_S;
use super::errors::{ANGLE, POSE, TORQUE};
use super::held_out::Error;
use super::loads::Loads;
use super::windings::effort;
use super::{AT_LIMIT, Asked};
use crate::regimes::{Compared, Course, Marks, RegimeRow, Sums};

/// Sums of errors by regime, of every joint and of the body.
pub(super) struct Regimes {
    /// Regimes of a joint in a run, on a grid of `PERIOD_S`.
    marks: BTreeMap<(usize, usize), Vec<Marks>>,
    /// Blows of a run, s.
    blows_s: BTreeMap<usize, Vec<f64>>,
    joints: [Sums; JOINTS],
    body: Sums,
}

/// A track on the grid of a run.
fn grid(track: &Track, rows: usize) -> Vec<f64> {
    (0..rows).map(|i| track.at(i as f64 * PERIOD_S)).collect()
}

impl Regimes {
    /// Of the runs in question, under the `loads` of the joints, whose motors give `most_nm`.
    pub(super) fn new(asked: &Asked<'_>, loads: &Loads, most_nm: [f64; JOINTS]) -> Self {
        let (mut marks, mut blows_s) = (BTreeMap::new(), BTreeMap::new());
        for r in asked.runs {
            let run = &asked.data.runs[*r];
            let rows = (run.length_s / PERIOD_S) as usize + 1;
            let t_s: Vec<f64> = (0..rows).map(|i| i as f64 * PERIOD_S).collect();
            let bus_v = run.bus_v.as_ref().map(|v| grid(v, rows));
            blows_s.extend(run.blows_s.clone().map(|b| (*r, b)));
            for (k, most_nm) in most_nm.into_iter().enumerate() {
                let Some(position) = &run.joints[k].position else {
                    continue;
                };
                let full_nm = AT_LIMIT * nominal(asked.model, k).max_torque_nm.min(most_nm);
                let replayed = || {
                    let own = &loads.nominal[*r][k];
                    (0..rows)
                        .map(|i| own.get(i).copied().unwrap_or(0.0))
                        .collect()
                };
                let measured = effort(run, k, &asked.motor(k));
                let effort_nm = measured.map_or_else(replayed, |e| grid(&e, rows));
                let course = Course {
                    t_s: &t_s,
                    angle_rad: &grid(position, rows),
                    effort_nm: &effort_nm,
                    full: &|i| effort_nm[i].abs() >= full_nm,
                };
                let own = course.marks(bus_v.as_deref(), run.blows_s.as_deref());
                marks.insert((k, *r), own);
            }
        }
        Self {
            marks,
            blows_s,
            joints: Default::default(),
            body: Sums::default(),
        }
    }

    /// Adds an error of the nominal model, or of the final one.
    pub(super) fn add(&mut self, after: bool, e: Error) {
        let of = match e.signal {
            ANGLE => Compared::Position,
            TORQUE => Compared::Effort,
            POSE => Compared::Pose,
            _ => return,
        };
        let Some(k) = e.joint else {
            if let Some(blows_s) = self.blows_s.get(&e.run) {
                let within = |b: &f64| (e.t_s..e.t_s + WINDOW_S).contains(b);
                let marks = Marks::contact(blows_s.iter().any(within));
                self.body.add(of, after, marks, e.value);
            }
            return;
        };
        let marks = self.marks.get(&(k, e.run));
        if let Some(at) = marks.and_then(|m| m.get((e.t_s / PERIOD_S) as usize)) {
            self.joints[k].add(of, after, *at, e.value);
        }
    }

    /// The regimes that occurred.
    pub(super) fn rows(&self) -> Vec<RegimeRow> {
        let joints = self.joints.iter().enumerate();
        let joints = joints.flat_map(|(k, sums)| sums.rows(Some(k)));
        joints.chain(self.body.rows(None)).collect()
    }
}
