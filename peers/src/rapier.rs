//! Rapier (f64) on the same robot: rigid bodies, revolute impulse joints with Rapier's own motors, convex pieces of the exported surface.
//!
//! The servo is held as it is: a Rapier motor with velocity target and gain `factor` is a velocity constraint with compliance
//! 1 / (step factor), clamped at `max_force`; with a factor of [`MOTOR_FACTOR`] the compliance vanishes beside the bodies'.
//! Everything else stays at Rapier's defaults (contact springs of 60 Hz at the ground), but for [`SUBSTEPS`], Coulomb friction at every
//! contact point, and lengths that count in cubes. Cubes do not meet each other: the gaits keep them apart.

use crate::foreign::PER_TURN;
use crate::speed::cpu_s;
use crate::track::{JOINTS, Report, TICKS, Track, set_points};
use physics::mjcf::{self, RigidBody as Masses};
use physics::{Params, Trial};
use rapier3d_f64::prelude::*;

/// Gain of a motor's velocity error, N m s/rad: 10^6 holds a speed to a part in 10^5 of what 5 N m would change in a step.
const MOTOR_FACTOR: f64 = 1e6;

/// Solver iterations per step, each a substep; Rapier's default of 4 leaves the motors short by a degree in the first 50 ms.
const SUBSTEPS: usize = 16;

/// Corners of a face's disc: 15 degrees, the arc between them rises by 0.24 mm.
const RIM: f64 = 24.0;

/// Groups: the robot meets the ground, nothing else.
const ROBOT: InteractionGroups =
    InteractionGroups::new(Group::GROUP_1, Group::GROUP_2, InteractionTestMode::And);
const GROUND: InteractionGroups =
    InteractionGroups::new(Group::GROUP_2, Group::GROUP_1, InteractionTestMode::And);

struct World {
    physics: PhysicsWorld,
    bodies: Vec<RigidBodyHandle>,
    /// By joint index.
    hinges: Vec<ImpulseJointHandle>,
    /// Whole angles: Rapier reports them within half a turn.
    angles_rad: [f64; JOINTS],
}

/// Every trial. Figures: `speed` (simulated s per s of processor time), `tracking_rms_rad`.
#[must_use]
pub fn run(params: &Params, trials: &[Trial], time_step_s: f64) -> Report {
    let (mut squares, mut count) = (0.0, 0u32);
    let start_s = cpu_s();
    let mut play = |trial: &Trial| -> Track {
        let mut world = World::new(params, time_step_s);
        let per_tick = (0.05 / time_step_s).round() as usize;
        let mut track = vec![world.row()];
        for now in set_points(trial).as_chunks::<JOINTS>().0 {
            for (wanted, angle) in now.iter().zip(&world.angles_rad) {
                squares += (wanted - angle) * (wanted - angle);
                count += 1;
            }
            (0..per_tick).for_each(|_| world.step(params, now));
            track.push(world.row());
        }
        track
    };
    let tracks: Vec<Track> = trials.iter().map(&mut play).collect();
    let spent_s = cpu_s() - start_s;
    let simulated_s = (trials.len() * TICKS) as f64 / 20.0;
    let figures = vec![
        ("speed".to_owned(), simulated_s / spent_s),
        (
            "tracking_rms_rad".to_owned(),
            (squares / f64::from(count)).sqrt(),
        ),
    ];
    Report { tracks, figures }
}

impl World {
    fn new(params: &Params, time_step_s: f64) -> Self {
        let mut physics = PhysicsWorld::new();
        physics.gravity = Vector::from_array(params.gravity_m_s2);
        let settings = &mut physics.integration_parameters;
        settings.dt = time_step_s;
        settings.length_unit = params.robot.raw().cube_m;
        settings.num_solver_iterations = SUBSTEPS;
        settings.friction_model = FrictionModel::Coulomb;
        let ground = ColliderBuilder::new(SharedShape::halfspace(Vector::Z))
            .friction(params.friction)
            .collision_groups(GROUND);
        physics.insert_collider(ground, None);
        let mut bodies = Vec::new();
        let mut origins = Vec::new();
        let raw = params.robot.raw();
        for (body, masses) in raw.bodies.iter().zip(mjcf::rigid_bodies(params)) {
            let parent = body.parent.map(|p| origins[p]);
            let lying = Vector::new(0.0, 0.0, raw.cube_m / 2.0);
            let origin: Vector = parent.unwrap_or(lying) + Vector::from_array(body.offset_m);
            origins.push(origin);
            let built = RigidBodyBuilder::dynamic()
                .translation(origin)
                .additional_mass_properties(mass_properties(&masses))
                .can_sleep(false);
            bodies.push(physics.insert_body(built));
        }
        for h in 0..raw.halves.len() {
            for points in pieces(params, h) {
                let hull = ColliderBuilder::convex_hull(&points)
                    .expect("the pieces have a volume")
                    .density(0.0)
                    .friction(params.friction)
                    .collision_groups(ROBOT);
                physics.insert_collider(hull, Some(bodies[raw.halves[h].body]));
            }
        }
        let hinges = (0..JOINTS)
            .map(|joint| {
                let at = raw.bodies.iter().position(|b| b.joint == Some(joint));
                let index = at.expect("the robot was checked");
                let body = &raw.bodies[index];
                let hinge = RevoluteJointBuilder::new(Vector::from_array(body.axis))
                    .local_anchor1(Vector::from_array(body.offset_m))
                    .local_anchor2(Vector::ZERO)
                    .contacts_enabled(false)
                    .motor_model(MotorModel::ForceBased)
                    .motor_max_force(params.joints[joint].max_torque_nm);
                let parent = bodies[body.parent.expect("only the base has none")];
                physics.insert_impulse_joint(parent, bodies[index], hinge)
            })
            .collect();
        Self {
            physics,
            bodies,
            hinges,
            angles_rad: [0.0; JOINTS],
        }
    }

    fn step(&mut self, params: &Params, set_points_rad: &[f64; JOINTS]) {
        for (k, handle) in self.hinges.iter().enumerate() {
            let servo = &params.joints[k];
            let wanted = servo.gain_per_s * (set_points_rad[k] - self.angles_rad[k]);
            let speed = wanted.clamp(-servo.max_speed_rad_s, servo.max_speed_rad_s);
            if let Some(joint) = self.physics.impulse_joints.get_mut(*handle, false) {
                joint
                    .data
                    .set_motor_velocity(JointAxis::AngX, speed, MOTOR_FACTOR);
            }
        }
        self.physics.step();
        for (k, handle) in self.hinges.iter().enumerate() {
            let Some(joint) = self.physics.impulse_joints.get(*handle) else {
                continue;
            };
            let rotation = |body: RigidBodyHandle| *self.physics.bodies[body].rotation();
            let hinge = joint.data.as_revolute().expect("built as one");
            let angle_rad = hinge.angle(&rotation(joint.body1()), &rotation(joint.body2()));
            self.angles_rad[k] +=
                libm::remainder(angle_rad - self.angles_rad[k], std::f64::consts::TAU);
        }
    }

    fn row(&self) -> [f64; 7 + JOINTS] {
        let base = &self.physics.bodies[self.bodies[0]];
        let (p, q) = (base.translation(), base.rotation());
        let pose = [p.x, p.y, p.z, q.w, q.x, q.y, q.z];
        let mut row = [0.0; 7 + JOINTS];
        let values = pose.iter().chain(&self.angles_rad);
        for (slot, value) in row.iter_mut().zip(values) {
            *slot = *value;
        }
        row
    }
}

/// A half-sphere as convex pieces in its body's frame. Rapier's plane contacts see the first four corners of the face that looks down, so a
/// disc of many corners would stand on one edge of it. Beside the hull, every face is a fan of wedges with four corners each.
fn pieces(params: &Params, half: usize) -> Vec<Vec<Vector>> {
    let raw = &params.robot.raw().halves[half];
    let shape = params.robot.shape();
    let centre = Vector::from_array(raw.centre_m);
    let surface = mjcf::surface(&params.robot, half, PER_TURN).into_iter();
    let mut pieces = vec![surface.map(|p| Vector::from_array(p) + centre).collect()];
    for (face, normal) in raw.faces.iter().enumerate() {
        let middle = centre + Vector::from_array(*normal) * shape.face_m;
        let [u, v] = [1, 2].map(|k| Vector::from_array(raw.faces[(face + k) % 3]));
        let rim = |k: u32| {
            let (sine, cosine) = libm::sincos(std::f64::consts::TAU * f64::from(k) / RIM);
            middle + (u * cosine + v * sine) * shape.rim_m
        };
        for wedge in 0..(RIM as u32) / 2 {
            let arc = [0, 1, 2].map(|k| rim(2 * wedge + k));
            pieces.push(vec![centre, middle, arc[0], arc[1], arc[2]]);
        }
    }
    pieces
}

fn mass_properties(masses: &Masses) -> MassProperties {
    let [xx, yy, zz, xy, xz, yz] = masses.inertia_kg_m2;
    let inertia = Matrix::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz]);
    MassProperties::with_inertia_matrix(Vector::from_array(masses.com_m), masses.mass_kg, inertia)
}
