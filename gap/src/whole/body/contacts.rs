//! How engines differ: a remainder is something that the simulator misses only where it is more than what contacts of another make leave.
//!
//! Every window ends elsewhere when its contacts hold by another law, give, push apart faster or touch at a surface that lies within the tolerance of the
//! ball. How far and in which directions is played for each window, and is part of what it may be off by. Without a cause emulated robots, whose body is
//! played by this project's own equations, leave 0.5 times as much then; robots that MuJoCo plays 0.5 to 0.6 times.
//! Where the other law explains the windows better, the body is searched on it instead ([`Grip`]).

use std::sync::Arc;

use files::model::{Effect, Key, Model, Parameter};
use physics::{Params, Robot};

use super::{B, FLOOR, FLOOR_BLIND, Tier, numbers};
use crate::whole::data::Data;
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
pub(in crate::whole) struct Grip {
    /// Friction is limited by a pyramid inside Coulomb's cone.
    pub(in crate::whole) pyramid: bool,
    /// What sticks creeps under load, m/s per N.
    pub(in crate::whole) slip_m_s_n: f64,
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
    pub(in crate::whole) const fn of(params: &Params) -> Self {
        Self {
            pyramid: params.pyramid,
            slip_m_s_n: params.slip_m_s_n,
        }
    }

    pub(super) const fn put(self, params: &mut Params) {
        (params.pyramid, params.slip_m_s_n) = (self.pyramid, self.slip_m_s_n);
    }

    /// `model` on this grip.
    pub(in crate::whole) fn on(self, model: &Model) -> Model {
        let mut out = model.clone();
        let pyramid = f64::from(u8::from(self.pyramid));
        for (key, value) in [
            (Key::FrictionPyramid, pyramid),
            (Key::ContactSlip, self.slip_m_s_n),
        ] {
            let found = Parameter {
                value,
                tolerance: 0.0,
                source: "gap report".into(),
            };
            if out.value(key) != value {
                // In range: the constants above, or what stood in a model.
                out.set_parameter(key, found).ok();
            }
        }
        out
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
    /// The tier on the other grip, measured around `theta`.
    pub(in crate::whole) fn gripped(&self, data: &Data, theta: &[f64]) -> Self {
        let mut out = self.clone();
        out.grip = self.grip.other();
        out.floor = self.told_floor();
        out.measure(data, theta);
        out
    }

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
        self.grip.other().put(&mut holds);
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
        self.floor = self.told_floor();
        self.weigh_with(&contacts);
    }

    /// How its contacts hold.
    pub(in crate::whole) const fn grip(&self) -> Grip {
        self.grip
    }

    /// The same windows on the contacts of the nominal model.
    pub(in crate::whole) fn nominally_gripped(&self) -> Self {
        let mut out = self.clone();
        out.grip = Grip::of(&self.base);
        out
    }

    /// Whether windows start from an inertial sensor.
    pub(in crate::whole) const fn sensed(&self) -> bool {
        self.sensed
    }

    /// The tolerances that its measurements allow, whatever they have been widened to.
    pub(super) const fn told_floor(&self) -> [f64; 3] {
        if self.sensed { FLOOR } else { FLOOR_BLIND }
    }

    /// What `of` makes of the tier at the tolerances that its measurements allow.
    pub(in crate::whole) fn as_sharp<T>(&mut self, of: impl FnOnce(&Self) -> T) -> T {
        self.weighed(&[], of)
    }

    /// The same; `None` without an inertial sensor.
    pub(in crate::whole) fn sharp<T>(&mut self, of: impl FnOnce(&Self) -> T) -> Option<T> {
        self.sensed.then(|| self.weighed(&[], of))
    }

    /// The same with windows that may end off by what contacts of other makes around `theta` do.
    pub(in crate::whole) fn among_makes<T>(
        &mut self,
        theta: &[f64],
        of: impl FnOnce(&Self) -> T,
    ) -> Option<T> {
        let contacts = self.sensed.then(|| self.contacts(theta))?;
        Some(self.weighed(&contacts, of))
    }

    fn weighed<T>(&mut self, columns: &[Vec<Vec<f64>>], of: impl FnOnce(&Self) -> T) -> T {
        let told = self.floor;
        self.floor = self.told_floor();
        self.weigh_with(columns);
        let out = of(self);
        self.floor = told;
        self.weigh();
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grip_goes_into_the_model_and_comes_out_of_its_simulation() {
        let nominal = Model::hand_tuned();
        assert_eq!(
            Grip::CONE.on(&nominal),
            nominal,
            "nothing is marked as found"
        );
        for grip in [Grip::CONE, Grip::CREEPING] {
            let held = grip.on(&Grip::CREEPING.on(&nominal));
            let text = held.to_toml();
            let read = Model::parse("patched.toml", &text).expect("a model that was written");
            let params = Params::try_from(&read).expect("the simulator holds it");
            assert_eq!(Grip::of(&params), grip, "{text}");
            assert_ne!(grip.other(), grip);
        }
    }
}
