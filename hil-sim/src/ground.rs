//! The whole robot on the ground behind the joints: the physics crate's body, driven by these motors.
//!
//! The rotor of a geared motor outweighs most links, so the body is told of it as armature and solves rotor, link and
//! contacts together; the motor's torque then acts on both. With play or compliance the rotor stays with the motor
//! and the spring's torque acts on the link. Between two steps of the body each joint goes on under its own inertia
//! and the load of the step before, smoothed over three steps so that a hard contact does not ring.

use std::sync::Arc;

use physics::{Imu, JointDrive, Options, Params, Pose, RunError};

use crate::body::{Body, LinkState};
use crate::motor::LinkDrive;
use crate::world::WorldParams;

/// The robot on the ground.
pub struct Ground {
    body: physics::Body,
    step_s: f64,
    links: Vec<LinkState>,
}

/// Share of a step's load that is taken over for the prediction. Chosen: three steps, so that one contact's blow does
/// not move the joint twice.
const LOAD_SHARE: f64 = 0.3;

/// Joint inertia assumed until the body has made a step [kg m2]: two half-spheres about their cube's centre.
const FIRST_INERTIA_KG_M2: f64 = 1.31e-3;

/// Smallest joint inertia [kg m2]: a guard against a division by nothing.
const LEAST_INERTIA_KG_M2: f64 = 1e-4;

impl Ground {
    /// The robot of `params` at home, lying on the ground. Give a model without joint effects: friction, play and
    /// limits are the motors' here.
    ///
    /// # Errors
    /// A time step or number of sweeps that the body refuses.
    pub fn new(params: Arc<Params>, options: &Options) -> Result<Self, RunError> {
        let motors = params.robot.motors();
        let body = physics::Body::new(params, options)?;
        let links = body
            .angles_rad()
            .map(|angle_rad| LinkState {
                angle_rad,
                inertia_kg_m2: FIRST_INERTIA_KG_M2,
                ..LinkState::default()
            })
            .take(motors)
            .collect();
        Ok(Self {
            body,
            step_s: options.time_step_s,
            links,
        })
    }

    /// Makes a world call this body once per time step of the body.
    pub fn suit(&self, world: &mut WorldParams) {
        world.body_every = ((self.step_s * 1e9) as u64 / world.step_ns.max(1)).max(1) as u32;
    }

    /// Pose of body 3.
    #[must_use]
    pub fn base(&self) -> Pose {
        self.body.base()
    }

    /// Inertial sensor at body 3's origin.
    #[must_use]
    pub fn imu(&self) -> Imu {
        self.body.imu()
    }

    /// Everything else the body can tell.
    #[must_use]
    pub fn body(&self) -> &physics::Body {
        &self.body
    }

    fn step_once(&mut self, dt_s: f64, drives: &[LinkDrive]) {
        for (joint, drive) in drives.iter().enumerate() {
            self.body.set_armature(joint, drive.armature_kg_m2);
        }
        let orders: Vec<_> = drives
            .iter()
            .map(|drive| JointDrive::Torque {
                nm: drive.torque_nm,
            })
            .collect();
        self.body.step(&orders);
        let measured = self
            .body
            .angles_rad()
            .zip(self.body.speeds_rad_s())
            .zip(self.body.inertias_kg_m2());
        for ((link, drive), ((angle, speed), inertia)) in
            self.links.iter_mut().zip(drives).zip(measured)
        {
            let acceleration = (speed - link.velocity_rad_s) / dt_s;
            let load_nm = drive.torque_nm - inertia * acceleration;
            link.load_nm += LOAD_SHARE * (load_nm - link.load_nm);
            link.angle_rad = angle;
            link.velocity_rad_s = speed;
            link.inertia_kg_m2 = (inertia - drive.armature_kg_m2).max(LEAST_INERTIA_KG_M2);
        }
    }
}

impl Body for Ground {
    fn joints(&self) -> usize {
        self.links.len()
    }

    fn links(&self, links: &mut [LinkState]) {
        for (out, link) in links.iter_mut().zip(&self.links) {
            *out = *link;
        }
    }

    fn step(&mut self, dt_s: f64, drives: &[LinkDrive], links: &mut [LinkState]) {
        // Whole steps of the body; a world whose steps do not divide its time runs a little slow or fast.
        let count = (dt_s / self.step_s).round().max(1.0) as u32;
        for _ in 0..count {
            self.step_once(self.step_s, drives);
        }
        self.links(links);
    }
}
