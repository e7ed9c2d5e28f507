//! One robot, step by step, for a program that owns the motors: in double precision, joints driven from outside.

use crate::engine::{self, Command, LaneParams, State, Switches, Tree, Work};
use crate::params::Params;
use crate::robot::MAX_BODIES;
use crate::trial::{Options, Pose, RunError, Twist};
use std::sync::Arc;

/// What drives one joint during a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JointDrive {
    /// The model's own servo with its speed and torque limits.
    Servo {
        /// Set-point, rad.
        set_point_rad: f64,
    },
    /// The link turns at this speed as long as the torque stays under the limit.
    Speed {
        /// Speed of the link, rad/s.
        rad_s: f64,
        /// Largest torque, N m; infinite = always.
        limit_nm: f64,
    },
    /// This torque acts between the bodies; nothing else does, but friction and damping of the model.
    Torque {
        /// Torque on the distal body, N m.
        nm: f64,
    },
}

/// What an inertial sensor at the origin of body 3 shows, in that body's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imu {
    /// Angular velocity, rad/s.
    pub gyro_rad_s: [f64; 3],
    /// Specific force (acceleration less gravity), mean over the last step, m/s2.
    pub accel_m_s2: [f64; 3],
}

/// A robot on the ground, one step at a time.
pub struct Body {
    params: Arc<Params>,
    tree: Tree,
    lane: LaneParams<f64>,
    switches: Switches,
    state: State<f64>,
    work: Box<Work<f64>>,
    command: Command<f64>,
    time_step_s: f64,
    accel_m_s2: [f64; 3],
    steps: u64,
}

impl Body {
    /// The robot at home, lying on the ground, at rest. Only time step and sweeps of the options are used.
    ///
    /// # Errors
    /// [`RunError::Setting`] for a time step or number of sweeps out of range.
    pub fn new(params: Arc<Params>, options: &Options) -> Result<Body, RunError> {
        let numeric = Options {
            sample_rate_hz: 0.0,
            ..options.clone()
        };
        numeric.check()?;
        let h = options.time_step_s;
        let tree = Tree::new(&params.robot);
        let (lane, switches) = LaneParams::new(&params.robot, &[&params], h, options.sweeps);
        let mut state = State::at_rest();
        state.position.z = tree.home_height_m;
        let gravity = params.gravity_m_s2;
        Ok(Body {
            params,
            tree,
            lane,
            switches,
            state,
            work: Work::new(),
            command: Command::hold(),
            time_step_s: h,
            accel_m_s2: gravity.map(|g| -g),
            steps: 0,
        })
    }

    /// Puts the robot into a state at rest or in motion; contacts and torques start anew.
    ///
    /// # Errors
    /// [`RunError::JointCount`] unless there is one angle and one speed per motor.
    pub fn place(
        &mut self,
        base: &Pose,
        twist: &Twist,
        angles_rad: &[f64],
        speeds_rad_s: &[f64],
    ) -> Result<(), RunError> {
        let motors = self.params.robot.motors();
        for found in [angles_rad.len(), speeds_rad_s.len()] {
            if found != motors {
                return Err(RunError::JointCount {
                    trial: 0,
                    found,
                    motors,
                });
            }
        }
        let mut state = State::at_rest();
        let vector = |v: [f32; 3]| {
            let [x, y, z] = v.map(f64::from);
            crate::linear::V3::new(x, y, z)
        };
        state.position = vector(base.position_m);
        state.quaternion = base.quaternion.map(f64::from);
        state.linear = vector(twist.linear_m_s);
        state.angular = vector(twist.angular_rad_s);
        for (joint, (angle, speed)) in angles_rad.iter().zip(speeds_rad_s).enumerate() {
            let body = self.params.robot.body_of_joint(joint);
            state.angle[body] = *angle;
            state.encoder[body] = *angle;
            state.speed[body] = *speed;
        }
        self.state = state;
        Ok(())
    }

    /// One time step. Joints without an entry keep their servo at the last set-point.
    pub fn step(&mut self, drives: &[JointDrive]) {
        for (joint, drive) in drives.iter().enumerate().take(self.params.robot.motors()) {
            self.drive(joint, *drive);
        }
        let before = self.state.linear;
        engine::step(
            &self.tree,
            &self.lane,
            &self.switches,
            &self.command,
            &mut self.state,
            &mut self.work,
            &mut engine::NoProbe,
        );
        let after = self.state.linear;
        let g = self.params.gravity_m_s2;
        let h = self.time_step_s;
        let world = [
            (after.x - before.x) / h - g[0],
            (after.y - before.y) / h - g[1],
            (after.z - before.z) / h - g[2],
        ];
        self.accel_m_s2 = self.to_body(world);
        self.steps += 1;
    }

    /// Inertia that turns with joint `joint` alone from now on, a rotor behind its gear, kg m2.
    pub fn set_armature(&mut self, joint: usize, inertia_kg_m2: f64) {
        if joint < self.params.robot.motors() {
            let b = self.params.robot.body_of_joint(joint);
            self.lane.joint[b].armature = inertia_kg_m2;
        }
    }

    fn drive(&mut self, joint: usize, drive: JointDrive) {
        let b = self.params.robot.body_of_joint(joint);
        let c = &mut self.command;
        let own_limit = self.params.joints[joint].max_torque_nm;
        c.torque[b] = 0.0;
        c.speed_given[b] = 0.0;
        c.limit_factor[b] = 1.0;
        match drive {
            JointDrive::Servo { set_point_rad } => c.set_point[b] = set_point_rad,
            JointDrive::Speed { rad_s, limit_nm } => {
                c.speed_given[b] = 1.0;
                c.speed[b] = rad_s;
                // A torque no robot of this kind reaches stands for "always".
                c.limit_factor[b] = limit_nm.min(1e6) / own_limit.max(1e-9);
            }
            JointDrive::Torque { nm } => {
                c.speed_given[b] = 1.0;
                c.speed[b] = 0.0;
                c.limit_factor[b] = 0.0;
                c.torque[b] = nm;
            }
        }
    }

    /// World vector in the axes of body 3.
    fn to_body(&self, v: [f64; 3]) -> [f64; 3] {
        let rot = crate::linear::Rot::from_quaternion(self.state.quaternion);
        let world = crate::linear::V3::splat(v);
        rot.c.map(|axis| axis.dot(world))
    }

    /// Time since the start, s.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        self.steps as f64 * self.time_step_s
    }

    /// Pose of body 3.
    #[must_use]
    pub fn base(&self) -> Pose {
        let p = self.state.position;
        Pose {
            position_m: [p.x as f32, p.y as f32, p.z as f32],
            quaternion: self.state.quaternion.map(|q| q as f32),
        }
    }

    /// Velocity of body 3, world axes.
    #[must_use]
    pub fn twist(&self) -> Twist {
        let (v, w) = (self.state.linear, self.state.angular);
        Twist {
            linear_m_s: [v.x as f32, v.y as f32, v.z as f32],
            angular_rad_s: [w.x as f32, w.y as f32, w.z as f32],
        }
    }

    fn by_joint<'a>(&self, of: &'a [f64; MAX_BODIES]) -> impl Iterator<Item = f64> + 'a {
        let robot = Arc::clone(&self.params.robot);
        (0..robot.motors()).map(move |joint| of[robot.body_of_joint(joint)])
    }

    /// Link angles in joint order, rad.
    pub fn angles_rad(&self) -> impl Iterator<Item = f64> + '_ {
        self.by_joint(&self.state.angle)
    }

    /// Encoder angles in joint order, rad; they differ from the link angles only with a transmission effect.
    pub fn encoders_rad(&self) -> impl Iterator<Item = f64> + '_ {
        self.by_joint(&self.state.encoder)
    }

    /// Joint speeds on the link side, rad/s.
    pub fn speeds_rad_s(&self) -> impl Iterator<Item = f64> + '_ {
        self.by_joint(&self.state.speed)
    }

    /// Torque that each motor gave in the last step, N m; for a driven speed, the torque it took. Zero for a torque drive.
    pub fn torques_nm(&self) -> impl Iterator<Item = f64> + '_ {
        self.by_joint(&self.state.torque)
    }

    /// Inertia that each joint sees while the other joints are rigid and the base is free, kg m2 (no ground), armature included; valid after a step.
    pub fn inertias_kg_m2(&self) -> impl Iterator<Item = f64> + '_ {
        let robot = &self.params.robot;
        (0..robot.motors()).map(|joint| {
            let b = robot.body_of_joint(joint);
            self.work.s[b][b]
        })
    }

    /// Inertial sensor at the origin of body 3.
    #[must_use]
    pub fn imu(&self) -> Imu {
        let w = self.state.angular;
        Imu {
            gyro_rad_s: self.to_body([w.x, w.y, w.z]),
            accel_m_s2: self.accel_m_s2,
        }
    }

    /// Smallest clearance between cubes that may meet so far, m (exact when small, at most 1); negative after a collision.
    #[must_use]
    pub fn clearance_m(&self) -> f64 {
        self.state.clearance
    }

    /// Kinetic energy, and potential energy above z = 0 along gravity, J.
    #[must_use]
    pub fn energy_j(&self) -> (f64, f64) {
        engine::energy(&self.tree, &self.lane, &self.state)
    }

    /// Whether all numbers are still numbers.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let s = &self.state;
        let sum = s.position.z + s.linear.dot(s.linear) + s.angular.dot(s.angular);
        (sum + s.speed.iter().sum::<f64>()).is_finite()
    }
}
