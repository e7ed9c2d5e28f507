//! How engines differ: a remainder is something that the simulator misses only where it is more than what contacts of another make leave.
//!
//! Every window ends elsewhere when its contacts give, push apart faster or touch at a surface that lies within the tolerance of the ball. How far
//! and in which directions is played for each window, and is part of what it may be off by. Emulated robots, whose body is played by this
//! project's own equations, leave 0.6 times as much then; robots that MuJoCo plays 0.6 to 0.8 times.

use std::sync::Arc;

use files::model::{Effect, Key, Model};
use physics::{Params, Robot, Trial};

use super::{B, FLOOR, Tier, numbers};
use crate::whole::windows;

/// Stiffness, N/m, and damping, N s/m, of a contact point that gives as MuJoCo's default contact (`solref` 0.02, 1) does: of 88 windows of 1 s from exact
/// starts three quarters end within 10 mm of MuJoCo's then, within 14 mm on the hard ground; half within 4.6 mm on both, within 5.6 mm at 8 kN/m.
const GIVING: [f64; 2] = [2.0e4, 60.0];
/// Share of the depth that is removed in one step of 4 ms by contacts that push apart faster than the nominal 0.2.
const PUSHING: f64 = 0.5;

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
        let mut out = vec![pushes];
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
            let of = |w: &windows::Window| w.trial(&params, &maps, &self.order);
            let trials: Vec<Trial> = self.windows.iter().map(of).collect();
            let ends = windows::run(&trials, &options);
            let apart = nominal.iter().zip(&ends).map(|(n, o)| numbers(n, o));
            // A window that cannot be played on them says nothing about them.
            apart.map(Option::unwrap_or_default).collect()
        };
        self.other_makes(theta).into_iter().map(make).collect()
    }

    /// What `of` makes of the tier at the tolerances of the inertial sensor, whatever they have been widened to; `None` without one.
    pub(in crate::whole) fn sharp<T>(&mut self, of: impl FnOnce(&Self) -> T) -> Option<T> {
        self.weighed(&[], of)
    }

    /// The same with windows that may end off by what contacts of other makes around `theta` do.
    pub(in crate::whole) fn among_makes<T>(
        &mut self,
        theta: &[f64],
        of: impl FnOnce(&Self) -> T,
    ) -> Option<T> {
        let contacts = self.sensed.then(|| self.contacts(theta))?;
        self.weighed(&contacts, of)
    }

    fn weighed<T>(&mut self, columns: &[Vec<Vec<f64>>], of: impl FnOnce(&Self) -> T) -> Option<T> {
        if !self.sensed {
            return None;
        }
        let told = std::mem::replace(&mut self.floor, FLOOR);
        self.weigh_with(columns);
        let out = of(self);
        self.floor = told;
        self.weigh();
        Some(out)
    }
}
