//! The whole robot on the ground behind the joints: the physics crate's body, driven by these motors.
//!
//! The rotor of a geared motor outweighs most links, so the body is told of it as armature and solves rotor, link and
//! contacts together; the motor's torque then acts on both. With play or compliance the rotor stays with the motor
//! and the spring's torque acts on the link. Between two steps of the body each joint goes on under its own inertia
//! and the load of the step before, smoothed over three steps so that a hard contact does not ring.

use std::sync::Arc;

use physics::{Imu, JointDrive, Options, Params, Pose, RunError, Twist};

use crate::body::{Body, Disturbance, LinkState, Load};
use crate::lab::Lab;
use crate::motor::LinkDrive;
use crate::world::WorldParams;

/// The robot on the ground.
pub struct Ground {
    body: physics::Body,
    step_s: f64,
    links: Vec<LinkState>,
    disturbances: Vec<Disturbance>,
    lab: Option<Lab>,
}

/// Where the robot is put down, at home, lying on the ground.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Place {
    /// Body 3 [m].
    pub x_m: f64,
    /// Body 3 [m].
    pub y_m: f64,
    /// Turn about the vertical [rad].
    pub yaw_rad: f64,
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
            disturbances: Vec::new(),
            lab: None,
        })
    }

    /// Puts the robot down at `place`, before its first step.
    ///
    /// # Errors
    /// None that a robot of the right number of joints meets.
    pub fn put_down(&mut self, place: &Place) -> Result<(), RunError> {
        let half = 0.5 * place.yaw_rad;
        let [_, _, z_m] = self.body.base().position_m;
        let base = Pose {
            position_m: [place.x_m as f32, place.y_m as f32, z_m],
            quaternion: [libm::cos(half) as f32, 0.0, 0.0, libm::sin(half) as f32],
        };
        let still = Twist {
            linear_m_s: [0.0; 3],
            angular_rad_s: [0.0; 3],
        };
        let zeros = vec![0.0; self.links.len()];
        self.body.place(&base, &still, &zeros, &zeros)
    }

    /// Lets a random torque act on every joint: why repeats differ.
    pub fn disturb(&mut self, sigma_nm: &[f64], seed: u64) {
        let each = sigma_nm.iter().enumerate();
        self.disturbances = if sigma_nm.iter().any(|sigma| *sigma > 0.0) {
            each.map(|(joint, sigma)| Disturbance::new(*sigma, seed, joint))
                .collect()
        } else {
            Vec::new()
        };
    }

    /// Sets instruments up beside the robot.
    pub fn watch(&mut self, lab: Lab) {
        self.lab = Some(lab);
    }

    /// The instruments and what they have seen.
    #[must_use]
    pub fn lab(&self) -> Option<&Lab> {
        self.lab.as_ref()
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
        let mut orders: Vec<_> = drives
            .iter()
            .map(|drive| JointDrive::Torque {
                nm: drive.torque_nm,
            })
            .collect();
        let now_s = self.body.time_s();
        for ((order, disturbance), link) in orders
            .iter_mut()
            .zip(&mut self.disturbances)
            .zip(&self.links)
        {
            if let JointDrive::Torque { nm } = order {
                *nm += disturbance.torque_nm(now_s, link.angle_rad, link.velocity_rad_s);
            }
        }
        self.body.step(&orders);
        if let Some(lab) = &mut self.lab {
            lab.look(self.body.time_s(), &self.body);
        }
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
