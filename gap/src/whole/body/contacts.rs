//! How engines differ: a remainder is something that the simulator misses only where it is more than what contacts of another make leave.
//!
//! Every window ends elsewhere when its contacts hold by another law, give, push apart faster or touch at a surface that lies within the tolerance of the
//! ball. How far and in which directions is played for each window, and is part of what it may be off by. Without a cause emulated robots, whose body is
//! played by this project's own equations, leave 0.5 times as much then; robots that MuJoCo plays 0.5 to 0.6 times.

use std::sync::Arc;

use files::model::{Effect, Key, Model};
use physics::{Params, Robot};

use super::{B, FLOOR, FLOOR_BLIND, Tier, numbers};
use crate::whole::windows;

/// Stiffness, N/m, and damping, N s/m, of a contact point that gives as MuJoCo's default contact (`solref` 0.02, 1) does. Of 88 windows of
/// 1 s from exact starts three quarters end within 10 mm of MuJoCo's then, within 14 mm on the hard ground; half within 4.6 mm on both,
/// within 5.6 mm at 8 kN/m.
const GIVING: [f64; 2] = [2.0e4, 60.0];
/// Share of the depth that is removed in one step of 4 ms by contacts that push apart faster than the nominal 0.2.
const PUSHING: f64 = 0.5;
/// Creep of a contact point, m/s per N, of grounds that hold by another law. MuJoCo's default contact creeps by 0.001 m/s per m/s2 of what a point
/// must hold (`solimp` 0.9, `solref` 0.02: (1 - d) / d over 2 / (d tc)), which is this at the half kilogram that a point moves. Windows of 1 s from exact
/// starts end 10 and 21 mm off (root mean square; impratio 1 with a pyramid, and MuJoCo's default) instead of 18 and 25 mm then; 0.001 to 0.004 are as good.
const CREEPING_M_S_N: f64 = 0.002;

/// How contact points hold on the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Grip {
    /// Friction is limited by a pyramid inside Coulomb's cone.
    pyramid: bool,
    /// What sticks creeps under load, m/s per N.
    slip_m_s_n: f64,
}

impl Grip {
    /// Coulomb's round cone, and what sticks does not move.
    const CONE: Self = Self {
        pyramid: false,
        slip_m_s_n: 0.0,
    };
    /// A pyramid inside the cone, and what sticks creeps under load.
    const CREEPING: Self = Self {
        pyramid: true,
        slip_m_s_n: CREEPING_M_S_N,
    };

    /// That of a simulation.
    const fn of(params: &Params) -> Self {
        Self {
            pyramid: params.pyramid,
            slip_m_s_n: params.slip_m_s_n,
        }
    }

    const fn put(self, params: &mut Params) {
        (params.pyramid, params.slip_m_s_n) = (self.pyramid, self.slip_m_s_n);
    }

    fn other(self) -> Self {
        if self == Self::CONE {
            Self::CREEPING
        } else {
            Self::CONE
        }
    }
}

impl Tier {
    /// The model with the connector of `theta`; `None` where that is rigid.
    pub(super) fn connected(&self, theta: &[f64]) -> Option<Model> {
        let (give, play) = (
            theta[B::ConnectorGive as usize],
            theta[B::ConnectorPlay as usize],
        );
        let (effect, size) = match (give > 0.0, play > 0.0) {
            (true, _) => (Effect::ConnectorCompliance, 1.0 / give),
            (false, true) => (Effect::ConnectorPlay, play),
            (false, false) => return None,
        };
        let mut model = self.model.clone();
        model.set_effect(effect, None, &[size]).ok()?;
        Some(model)
    }

    /// The body `theta` on contacts of other makes.
    fn other_makes(&self, theta: &[f64]) -> Vec<Params> {
        let own = self.params(theta);
        let mut gives = own.clone();
        [gives.ground_stiffness_n_m, gives.ground_damping_n_s_m] = GIVING;
        let pushes = Params {
            erp: PUSHING,
            ..own.clone()
        };
        let mut holds = own.clone();
        Grip::of(&own).other().put(&mut holds);
        let mut out = vec![pushes, holds];
        if own.ground_stiffness_n_m > GIVING[0] {
            out.push(gives);
        }
        let mut model = self.connected(theta).unwrap_or_else(|| self.model.clone());
        let ball = self.model.parameter(Key::BallRadius);
        if model
            .set(Key::BallRadius, ball.value - ball.tolerance)
            .is_ok()
            && let Ok(robot) = Robot::meta_module(&model)
        {
            out.push(Params {
                robot: Arc::new(robot),
                ..own
            });
        }
        out
    }

    /// How far each window of `theta` ends elsewhere on contacts of other makes, by make.
    fn contacts(&self, theta: &[f64]) -> Vec<Vec<Vec<f64>>> {
        let options = windows::options(false);
        let nominal = windows::run(&self.trials(theta), &options);
        let maps = self.links(theta);
        let make = |params: Params| {
            let params = Arc::new(params);
            let trials = windows::trials(self.windows.iter(), &params, &maps, &self.order);
            let ends = windows::run(&trials, &options);
            let apart = nominal.iter().zip(&ends).map(|(n, o)| numbers(n, o));
            // A window that cannot be played on them says nothing about them.
            apart.map(Option::unwrap_or_default).collect()
        };
        self.other_makes(theta).into_iter().map(make).collect()
    }

    /// Windows may end off by what contacts of other makes around `theta` do.
    pub(in crate::whole) fn among(&mut self, theta: &[f64]) {
        let contacts = self.contacts(theta);
        self.floor = self.own_floor();
        self.weigh_with(&contacts);
    }

    /// The tolerances that its measurements allow.
    pub(super) const fn own_floor(&self) -> [f64; 3] {
        if self.sensed { FLOOR } else { FLOOR_BLIND }
    }
}
