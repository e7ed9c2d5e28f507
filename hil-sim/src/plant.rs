//! Joints, supply and body under one step.

use crate::body::{Body, LinkState};
use crate::motor::{self, Bridge, JointParams, JointState, LinkDrive, ParamError};
use crate::supply::SupplyParams;

/// Everything that is not electronics.
pub struct Plant {
    params: Vec<JointParams>,
    states: Vec<JointState>,
    supply: SupplyParams,
    /// Multiplies the supply voltage (brown-out fault); 1 = healthy.
    supply_ratio: f64,
    body: Box<dyn Body>,
    links: Vec<LinkState>,
    drives: Vec<LinkDrive>,
    mean_torque_nm: Vec<f64>,
    jams: Vec<Option<f64>>,
    bus_v: f64,
    dt_s: f64,
    body_every: u32,
    since_body: u32,
}

/// Spring and damper of a jammed joint. Chosen: 2.5 mrad under the nominal torque, critically damped with the rotor.
const JAM_STIFFNESS_NM_RAD: f64 = 2.0e3;
const JAM_DAMPING_NM_S_RAD: f64 = 20.0;

impl Plant {
    /// Joints at rest where the body says.
    ///
    /// # Errors
    /// A parameter outside its range, or a spring too stiff for the step.
    pub fn new(
        params: Vec<JointParams>,
        supply: SupplyParams,
        body: Box<dyn Body>,
        step_ns: u64,
        body_every: u32,
    ) -> Result<Self, ParamError> {
        let mut links = vec![LinkState::default(); params.len()];
        body.links(&mut links);
        let dt_s = step_ns as f64 * 1e-9;
        for (joint, link) in params.iter().zip(&links) {
            joint.validate()?;
            check_stiffness(joint, link, dt_s)?;
        }
        let states = params
            .iter()
            .zip(&links)
            .map(|(joint, link)| JointState::at_rest(link.angle_rad, joint.thermal.ambient_c))
            .collect();
        let count = params.len();
        Ok(Self {
            bus_v: supply.bus_v(0.0),
            params,
            states,
            supply,
            supply_ratio: 1.0,
            body,
            links,
            drives: vec![LinkDrive::default(); count],
            mean_torque_nm: vec![0.0; count],
            jams: vec![None; count],
            dt_s,
            body_every: body_every.max(1),
            since_body: 0,
        })
    }

    /// Parameters of the joints.
    #[must_use]
    pub fn params(&self) -> &[JointParams] {
        &self.params
    }

    /// State of the joints.
    #[must_use]
    pub fn states(&self) -> &[JointState] {
        &self.states
    }

    /// Bus voltage of the last step [V].
    #[must_use]
    pub fn bus_v(&self) -> f64 {
        self.bus_v
    }

    /// The body; upcast to `Any` to reach its own type.
    #[must_use]
    pub fn body(&self) -> &dyn Body {
        self.body.as_ref()
    }

    /// Scales the supply voltage (brown-out); 1 = healthy.
    pub fn set_supply_ratio(&mut self, ratio: f64) {
        self.supply_ratio = ratio.clamp(0.0, 2.0);
    }

    /// Jams or frees a joint at its present angle.
    pub fn set_jam(&mut self, joint: usize, jammed: bool) {
        if let (Some(jam), Some(link)) = (self.jams.get_mut(joint), self.links.get(joint)) {
            *jam = jammed.then_some(link.angle_rad);
        }
    }

    /// One step under the bridges' commands; their `bus_v` is filled in here.
    pub fn step(&mut self, bridges: &[Bridge]) {
        let drawn_a: f64 = self
            .states
            .iter()
            .map(|state| state.applied_duty * state.current_a)
            .sum();
        self.bus_v = self.supply.bus_v(drawn_a) * self.supply_ratio;
        for (index, command) in bridges.iter().enumerate().take(self.states.len()) {
            let bridge = Bridge {
                bus_v: self.bus_v,
                ..*command
            };
            let mut drive = motor::step(
                &self.params[index],
                &mut self.states[index],
                bridge,
                self.dt_s,
            );
            if let Some(held_rad) = self.jams[index] {
                let link = &self.links[index];
                drive.torque_nm -= JAM_STIFFNESS_NM_RAD * (link.angle_rad - held_rad)
                    + JAM_DAMPING_NM_S_RAD * link.velocity_rad_s;
            }
            self.drives[index] = drive;
            self.mean_torque_nm[index] += drive.torque_nm;
        }
        self.since_body += 1;
        if self.since_body == self.body_every {
            self.step_body();
        } else {
            self.predict_links();
        }
        for ((state, drive), link) in self.states.iter_mut().zip(&self.drives).zip(&self.links) {
            motor::follow_link(
                state,
                *drive,
                link.angle_rad,
                link.velocity_rad_s,
                self.dt_s,
            );
        }
    }

    fn step_body(&mut self) {
        let steps = f64::from(self.body_every);
        for (drive, sum) in self.drives.iter_mut().zip(&mut self.mean_torque_nm) {
            drive.torque_nm = *sum / steps;
            *sum = 0.0;
        }
        self.since_body = 0;
        self.body
            .step(self.dt_s * steps, &self.drives, &mut self.links);
    }

    /// Between two body steps each link moves under the last known load and inertia.
    fn predict_links(&mut self) {
        for (link, drive) in self.links.iter_mut().zip(&self.drives) {
            let inertia = link.inertia_kg_m2 + drive.armature_kg_m2;
            link.velocity_rad_s += (drive.torque_nm - link.load_nm) / inertia * self.dt_s;
            link.angle_rad += link.velocity_rad_s * self.dt_s;
        }
    }
}

/// Semi-implicit Euler is stable while step times natural frequency stays below 2; 0.5 is asked for accuracy.
const STIFFNESS_MARGIN: f64 = 0.5;

fn check_stiffness(joint: &JointParams, link: &LinkState, dt_s: f64) -> Result<(), ParamError> {
    if joint.transmission.is_rigid() {
        return Ok(());
    }
    let stiffness_nm_rad = joint.transmission.contact_stiffness_nm_rad();
    let rotor = joint.motor.reflected_inertia_kg_m2() * joint.inertia_ratio;
    let rate = libm::sqrt(stiffness_nm_rad * (1.0 / rotor + 1.0 / link.inertia_kg_m2));
    let limit_s = STIFFNESS_MARGIN / rate;
    if dt_s > limit_s {
        return Err(ParamError::TooStiff {
            stiffness_nm_rad,
            step_us: dt_s * 1e6,
            limit_us: limit_s * 1e6,
        });
    }
    Ok(())
}
