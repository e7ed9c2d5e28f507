//! What the joints carry: the hook for a physics engine, and the default stand.

use std::any::Any;

use crate::motor::LinkDrive;
use crate::rng::Rng;

/// Motion of one link as the body reports it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkState {
    /// Joint angle on the link side, continuous [rad].
    pub angle_rad: f64,
    /// Its speed [rad/s].
    pub velocity_rad_s: f64,
    /// Inertia that the joint feels now, armature excluded [kg m2]: used between two body steps, and to check
    /// that the step suits the stiffness.
    pub inertia_kg_m2: f64,
    /// Torque that the body puts against + motion at rest (gravity, contact) [N m]: used between two body steps.
    pub load_nm: f64,
}

/// The body behind the joints. Joint order is the caller's; there is one entry per joint.
///
/// Contract: `step` integrates over `dt_s` under constant drives. A drive's torque acts on the link, its reaction on
/// the proximal body; its armature is added to the joint's own diagonal inertia. The joint model may call with any
/// multiple of its own step (see `WorldParams::body_every`). To read more than links (a base pose), upcast
/// [`crate::plant::Plant::body`] to `Any` and down to the body's own type.
pub trait Body: Any + Send {
    /// Number of joints.
    fn joints(&self) -> usize;

    /// Writes the present state of every link.
    fn links(&self, links: &mut [LinkState]);

    /// Advances by `dt_s` and writes the new state of every link.
    fn step(&mut self, dt_s: f64, drives: &[LinkDrive], links: &mut [LinkState]);
}

/// An outside torque on one joint of a [`Stand`].
pub trait Load: Send {
    /// Torque on the link at time `t_s`, positive towards + angle [N m].
    fn torque_nm(&mut self, t_s: f64, angle_rad: f64, velocity_rad_s: f64) -> f64;
}

/// A random torque: normal, correlated over [`Disturbance::CORRELATION_S`].
#[derive(Clone, Debug)]
pub struct Disturbance {
    sigma_nm: f64,
    present_nm: f64,
    last_s: f64,
    rng: Rng,
}

/// Stream number of disturbances.
const PURPOSE_DISTURBANCE: u64 = 0xD1;

impl Disturbance {
    /// Correlation time [s]. Chosen: slower than the loop's answer, faster than a gait cycle.
    pub const CORRELATION_S: f64 = 0.1;

    /// A disturbance of standard deviation `sigma_nm` on joint `index`.
    #[must_use]
    pub fn new(sigma_nm: f64, seed: u64, index: usize) -> Self {
        let mut rng = Rng::new(seed, PURPOSE_DISTURBANCE, index as u64);
        let present_nm = sigma_nm * rng.normal();
        Self {
            sigma_nm,
            present_nm,
            last_s: 0.0,
            rng,
        }
    }
}

impl Load for Disturbance {
    fn torque_nm(&mut self, t_s: f64, _angle_rad: f64, _velocity_rad_s: f64) -> f64 {
        // Ornstein-Uhlenbeck, exact over the step.
        let keep = libm::exp(-(t_s - self.last_s) / Self::CORRELATION_S);
        self.last_s = t_s;
        self.present_nm =
            keep * self.present_nm + self.sigma_nm * (1.0 - keep * keep).sqrt() * self.rng.normal();
        self.present_nm
    }
}

/// One joint on a stand: an inertia, a hanging mass, and any outside load.
pub struct StandJoint {
    /// Inertia of what the joint carries [kg m2].
    pub inertia_kg_m2: f64,
    /// Gravity amplitude m g l [N m]; the load hangs down at `hang_rad`.
    pub gravity_nm: f64,
    /// Angle at which the load hangs [rad].
    pub hang_rad: f64,
    /// Outside load, if any.
    pub load: Option<Box<dyn Load>>,
}

impl StandJoint {
    /// A bare inertia without gravity.
    #[must_use]
    pub fn inertia(inertia_kg_m2: f64) -> Self {
        Self {
            inertia_kg_m2,
            gravity_nm: 0.0,
            hang_rad: 0.0,
            load: None,
        }
    }
}

/// Joints on stands: independent of each other.
pub struct Stand {
    joints: Vec<StandJoint>,
    links: Vec<LinkState>,
    time_s: f64,
}

impl Stand {
    /// All joints at rest at 0 rad.
    #[must_use]
    pub fn new(joints: Vec<StandJoint>) -> Self {
        let links = joints
            .iter()
            .map(|joint| LinkState {
                inertia_kg_m2: joint.inertia_kg_m2,
                ..LinkState::default()
            })
            .collect();
        Self {
            joints,
            links,
            time_s: 0.0,
        }
    }

    /// Places every joint at rest at `angle_rad`.
    pub fn place(&mut self, angle_rad: f64) {
        for link in &mut self.links {
            link.angle_rad = angle_rad;
            link.velocity_rad_s = 0.0;
        }
    }
}

impl Body for Stand {
    fn joints(&self) -> usize {
        self.joints.len()
    }

    fn links(&self, links: &mut [LinkState]) {
        for (out, link) in links.iter_mut().zip(&self.links) {
            *out = *link;
        }
    }

    fn step(&mut self, dt_s: f64, drives: &[LinkDrive], links: &mut [LinkState]) {
        for ((joint, link), drive) in self.joints.iter_mut().zip(&mut self.links).zip(drives) {
            let gravity = if joint.gravity_nm == 0.0 {
                0.0
            } else {
                joint.gravity_nm * libm::sin(link.angle_rad - joint.hang_rad)
            };
            let outside = joint.load.as_mut().map_or(0.0, |load| {
                load.torque_nm(self.time_s, link.angle_rad, link.velocity_rad_s)
            });
            link.load_nm = gravity - outside;
            let inertia = joint.inertia_kg_m2 + drive.armature_kg_m2;
            link.velocity_rad_s += (drive.torque_nm - link.load_nm) / inertia * dt_s;
            link.angle_rad += link.velocity_rad_s * dt_s;
        }
        self.time_s += dt_s;
        self.links(links);
    }
}
