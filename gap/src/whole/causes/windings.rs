//! What the drivers recorded of motors and supply, and the blocks of it.

use rayon::prelude::*;

use super::{Asked, ORDER};
use crate::evidence::block::White;
use crate::whole::blocks::electrical;
use crate::whole::data::{JOINTS, Run, Track};
use crate::whole::nominal::Motors;

/// What the drivers recorded of a joint's motor.
pub(in crate::whole) fn signals(run: &Run, k: usize) -> Option<electrical::Signals<'_>> {
    let j = &run.joints[k];
    Some(electrical::Signals {
        position: j.position.as_ref()?,
        velocity: j.velocity.as_ref(),
        duty: j.duty.as_ref(),
        current: j.current.as_ref(),
        effort: j.effort.as_ref(),
        bus_v: run.bus_v.as_ref(),
    })
}

/// Torque of a motor: as recorded, or of its current.
pub(super) fn effort(run: &Run, k: usize, motor: &electrical::Motor) -> Option<Track> {
    let j = &run.joints[k];
    if let Some(e) = &j.effort {
        return Some(e.clone());
    }
    let c = j.current.as_ref()?;
    let v = c.v.iter().map(|x| x * motor.nm_per_a[0]).collect();
    Some(Track {
        t_s: c.t_s.clone(),
        v,
    })
}

/// The motor of joint `k` as the model states it.
pub(in crate::whole) fn motor(motors: &Motors, k: usize) -> electrical::Motor {
    electrical::Motor {
        nm_per_a: motors.nm_per_a[k],
        winding_ohm: motors.winding_ohm[k],
        supply_v: motors.supply_v,
    }
}

impl Asked<'_> {
    pub(super) fn motor(&self, k: usize) -> electrical::Motor {
        motor(&self.data.motors, k)
    }

    /// Current that all joints draw in each run, A; empty where it was not recorded.
    pub(super) fn drawn(&self) -> Vec<Track> {
        let one = |r: &usize| {
            let run = &self.data.runs[*r];
            let joints: Option<Vec<_>> = (0..JOINTS)
                .map(|k| Some((signals(run, k)?, self.motor(k))))
                .collect();
            joints
                .and_then(|j| electrical::drawn(&j))
                .unwrap_or_default()
        };
        self.runs.par_iter().map(one).collect()
    }

    /// Blocks of the windings and of the supply.
    pub(super) fn electrical(&self, drawn: &[Track]) -> Vec<White> {
        let one = |k: usize| {
            let motor = self.motor(k);
            let runs: Vec<_> = self
                .runs
                .iter()
                .zip(drawn)
                .filter_map(|(r, drawn)| Some((signals(&self.data.runs[*r], k)?, drawn)))
                .collect();
            let both = [
                electrical::duties(k, &runs, &motor),
                electrical::torques(k, &runs, &motor),
            ];
            let whiten = |raw| White::new(raw, ORDER);
            both.into_iter()
                .flatten()
                .map(whiten)
                .collect::<Vec<White>>()
        };
        let mut out: Vec<White> = (0..JOINTS).into_par_iter().flat_map(one).collect();
        let runs: Vec<_> = self
            .runs
            .iter()
            .zip(drawn)
            .filter(|(_, drawn)| !drawn.t_s.is_empty())
            .filter_map(|(r, drawn)| Some((self.data.runs[*r].bus_v.as_ref()?, drawn)))
            .collect();
        let supply = electrical::supply(&runs, self.data.motors.supply_v);
        out.extend(supply.map(|raw| White::new(raw, ORDER)));
        out
    }
}
