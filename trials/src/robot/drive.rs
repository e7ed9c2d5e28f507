//! One joint of the whole robot: Table II's servo on a DC motor behind a gear.
//!
//! The servo asks for the speed v = clamp(P (set-point - encoder), +-vmax), a thousand times a second. The gear turns
//! at that speed as long as the motor can give the torque it takes; current and duty are what the motor needs for it.
//! There is no rotor inertia, as in Table II's servo. With play or a spring the rotor is a body of its own and drives
//! the link through it.

use std::collections::VecDeque;

use physics::JointDrive;

use hil_sim::driver::transport::{Transport, TransportParams};
use hil_sim::motor::{self, JointParams, JointState};

/// The servo law of one joint.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ServoParams {
    /// P, 1/s.
    pub(super) gain_1_s: f64,
    /// Largest speed asked for, rad/s.
    pub(super) max_speed_rad_s: f64,
    /// Joint damping, N m s/rad.
    pub(super) damping_nm_s_rad: f64,
    /// `deadband`: half width of the error that counts as none, rad.
    pub(super) deadband_rad: f64,
    /// `feedback_delay`, s.
    pub(super) feedback_delay_s: f64,
    /// `motor_lag`: first-order lag of the speed asked for, s.
    pub(super) lag_s: f64,
}

/// How a wire angle relates to the joint's: joint = sign scale wire + offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Convention {
    pub(super) sign: f64,
    pub(super) scale: f64,
    pub(super) offset_rad: f64,
    /// Whether readings pass through it too (a wrong frame), or set-points alone (a wrong command).
    pub(super) readings_too: bool,
}

impl Convention {
    pub(super) const RIGHT: Self = Self {
        sign: 1.0,
        scale: 1.0,
        offset_rad: 0.0,
        readings_too: false,
    };

    pub(super) fn to_joint(self, wire_rad: f64) -> f64 {
        self.sign * self.scale * wire_rad + self.offset_rad
    }

    /// Reading on the wire of a joint angle.
    pub(super) fn reading(self, joint_rad: f64) -> f64 {
        if self.readings_too {
            (joint_rad - self.offset_rad) / (self.sign * self.scale)
        } else {
            joint_rad
        }
    }

    /// Joint angle that gives a reading on the wire.
    pub(super) fn read_as(self, wire_rad: f64) -> f64 {
        if self.readings_too {
            self.to_joint(wire_rad)
        } else {
            wire_rad
        }
    }

    /// Factor of speeds and torques on the wire.
    pub(super) fn reading_sign(self) -> f64 {
        if self.readings_too { self.sign } else { 1.0 }
    }
}

/// Everything fixed about one joint.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct DriveParams {
    pub(super) servo: ServoParams,
    pub(super) transport: TransportParams,
    pub(super) motor: JointParams,
}

/// Driver tick, s: 1 kHz.
pub(super) const TICK_S: f64 = 1e-3;
/// Time constant of the current reading, s: a shunt filter of 80 Hz.
const SHUNT_S: f64 = 2e-3;
/// Inertia of gear output and link flange where the rotor is a body of its own, kg m2.
pub(super) const FLANGE_KG_M2: f64 = 1e-3;
/// Speed by which a joint may miss what it was asked for and count as following: what sweeps of the solver leave,
/// rad/s.
const BEHIND_RAD_S: f64 = 0.02;
/// Average of the torque that sets the speed at full duty, s: shorter ones ring with the body's own constraint.
const LINE_S: f64 = 0.02;
/// Stiffness of the stops when play is set and compliance is not, N m/rad: 2 mrad under 2 N m.
const STOP_NM_RAD: f64 = 1.0e3;
/// Damping ratio of spring and stops with the flange and a light link (5e-3 kg m2).
const SPRING_DAMPING_NM_S_RAD: f64 = 0.5;

/// State of one joint.
#[derive(Clone, Debug)]
pub(super) struct DriveState {
    transport: Transport,
    /// Set-point in force, wire angle.
    pub(super) applied_wire_rad: f64,
    goal_rad: f64,
    seen: VecDeque<f64>,
    asked_rad_s: f64,
    pub(super) motor: JointState,
    link_nm: f64,
    inner_nm: f64,
    /// Torque of the motor, averaged over [`LINE_S`], N m.
    steady_nm: f64,
    /// Current as the driver reads it, A.
    pub(super) current_a: f64,
    /// Inertia that the body was last told to add, kg m2.
    pub(super) armature_kg_m2: f64,
}

impl DriveState {
    pub(super) fn new(angle_rad: f64, ambient_c: f64, seed: u64, joint: usize) -> Self {
        Self {
            transport: Transport::new(seed, joint),
            applied_wire_rad: 0.0,
            goal_rad: angle_rad,
            seen: VecDeque::new(),
            asked_rad_s: 0.0,
            motor: JointState::at_rest(angle_rad, ambient_c),
            link_nm: 0.0,
            inner_nm: 0.0,
            steady_nm: 0.0,
            current_a: 0.0,
            armature_kg_m2: 0.0,
        }
    }

    /// A set-point sent at `now_ns`; it is in force after the transport's delay.
    pub(super) fn send(&mut self, p: &DriveParams, now_ns: u64, wire_rad: f64) {
        self.transport.submit(&p.transport, now_ns, wire_rad);
    }

    /// The set-point at once (the way to the start).
    pub(super) fn place_goal(&mut self, convention: Convention, wire_rad: f64) {
        self.applied_wire_rad = wire_rad;
        self.goal_rad = convention.to_joint(wire_rad);
    }

    /// Angle that the encoder reads, joint frame.
    pub(super) fn encoder_rad(&self, p: &DriveParams) -> f64 {
        self.motor.gear_rad + p.motor.encoder_error_rad(&self.motor)
    }

    /// Torque of the motor at the gear, N m.
    pub(super) fn motor_nm(&self) -> f64 {
        self.link_nm + self.inner_nm
    }

    /// Set-points that are due come into force.
    pub(super) fn receive(&mut self, convention: Convention, now_ns: u64) {
        if let Some(wire) = self.transport.due(now_ns) {
            self.place_goal(convention, wire);
        }
    }

    /// One driver tick: the speed asked for.
    pub(super) fn tick(&mut self, p: &DriveParams) {
        // Between two ticks the encoder is taken on a straight line.
        let late = p.servo.feedback_delay_s / TICK_S;
        let ticks = libm::floor(late);
        self.seen.push_back(self.encoder_rad(p));
        while self.seen.len() > ticks as usize + 2 {
            self.seen.pop_front();
        }
        let now = self.seen.back().copied().unwrap_or(self.motor.gear_rad);
        let of = |back: usize| {
            let place = self.seen.len().checked_sub(1 + back);
            place.and_then(|i| self.seen.get(i)).or(self.seen.front())
        };
        let newer = of(ticks as usize).copied().unwrap_or(now);
        let older = of(ticks as usize + 1).copied().unwrap_or(newer);
        let seen = newer + (older - newer) * (late - ticks);
        let error = self.goal_rad - seen;
        let band = p.servo.deadband_rad;
        let error = error - error.clamp(-band, band);
        let most = p.servo.max_speed_rad_s;
        let wanted = (p.servo.gain_1_s * error).clamp(-most, most);
        self.asked_rad_s = if p.servo.lag_s > 0.0 {
            wanted + (self.asked_rad_s - wanted) * libm::exp(-TICK_S / p.servo.lag_s)
        } else {
            wanted
        };
    }

    /// What the body is told for a step of `dt_s` from a link at `link_rad`, `link_rad_s`.
    pub(super) fn order(
        &mut self,
        p: &DriveParams,
        bus_v: f64,
        (link_rad, link_rad_s): (f64, f64),
        dt_s: f64,
    ) -> JointDrive {
        let given_nm = self.link_nm + self.inner_nm;
        self.steady_nm += (given_nm - self.steady_nm) * (dt_s / LINE_S).min(1.0);
        // No duty beyond the full one: the line of the motor bounds the speed both ways, driving and driven.
        let [free_rad_s, lost] = motor::speed_line(&p.motor, &self.motor, bus_v);
        let bound = lost * self.steady_nm;
        let asked_rad_s = self.asked_rad_s.clamp(
            -(free_rad_s + bound).max(0.0),
            (free_rad_s - bound).max(0.0),
        );
        // A joint that is not as fast as asked is driven there, or braked; one that is gives what it has to.
        let behind_rad_s = asked_rad_s - link_rad_s;
        let rigid = p.motor.transmission.is_rigid();
        let way = if rigid && behind_rad_s.abs() > BEHIND_RAD_S {
            behind_rad_s
        } else {
            given_nm
        };
        let direction = if way >= 0.0 { 1.0 } else { -1.0 };
        let most_nm = motor::available_torque_nm(&p.motor, &self.motor, bus_v, direction);
        if rigid {
            return JointDrive::Speed {
                rad_s: asked_rad_s,
                limit_nm: (most_nm - direction * self.inner_nm).max(0.0),
            };
        }
        // A rotor that cannot give more is carried along by the link.
        let slips = given_nm.abs() > most_nm && asked_rad_s * direction > link_rad_s * direction;
        self.motor.gear_rad_s = if slips { link_rad_s } else { asked_rad_s };
        self.motor.gear_rad += self.motor.gear_rad_s * dt_s;
        self.link_nm = spring_nm(p, &self.motor, link_rad, link_rad_s);
        JointDrive::Torque { nm: self.link_nm }
    }

    /// Takes over the body's answer and works out what the motor had to give.
    pub(super) fn follow(
        &mut self,
        p: &DriveParams,
        bus_v: f64,
        (link_rad, link_rad_s, torque_nm): (f64, f64, f64),
        disturbance_nm: f64,
        dt_s: f64,
    ) {
        if p.motor.transmission.is_rigid() {
            self.motor.gear_rad = link_rad;
            self.motor.gear_rad_s = link_rad_s;
            self.link_nm = torque_nm;
        }
        self.motor.link_rad = link_rad;
        self.motor.link_rad_s = link_rad_s;
        self.motor.transmitted_nm = self.link_nm;
        self.inner_nm = motor::resistance_nm(&p.motor, &mut self.motor, dt_s)
            + p.servo.damping_nm_s_rad * self.motor.gear_rad_s
            + disturbance_nm;
        motor::bear(
            &p.motor,
            &mut self.motor,
            self.link_nm + self.inner_nm,
            bus_v,
            dt_s,
        );
        self.current_a += (self.motor.current_a - self.current_a) * (dt_s / SHUNT_S).min(1.0);
    }

    /// Goes on in another reality, in which the encoder reads `encoder_rad` and moves `factor` times as fast: without
    /// play the link stands there too, else it keeps its twist. Returns angle and speed of the link.
    pub(super) fn rejoin(&mut self, p: &DriveParams, encoder_rad: f64, factor: f64) -> (f64, f64) {
        let motor = &mut self.motor;
        let gear_rad = encoder_rad - p.motor.encoder_error_rad(motor);
        let moved_rad = gear_rad - motor.gear_rad;
        motor.gear_rad = gear_rad;
        motor.gear_rad_s *= factor;
        motor.link_rad_s *= factor;
        motor.link_rad = if p.motor.transmission.is_rigid() {
            gear_rad
        } else {
            motor.link_rad + moved_rad
        };
        let now = self.seen.back().copied().unwrap_or(encoder_rad);
        for seen in &mut self.seen {
            *seen = encoder_rad + factor * (*seen - now);
        }
        (motor.link_rad, motor.link_rad_s)
    }

    /// What is on its way to another driver, and in force there, is on its way to this one.
    pub(super) fn take_orders(&mut self, other: &Self, convention: Convention) {
        self.transport = other.transport.clone();
        self.place_goal(convention, other.applied_wire_rad);
    }
}

/// Torque of spring or stop on the link, N m.
fn spring_nm(p: &DriveParams, motor: &JointState, link_rad: f64, link_rad_s: f64) -> f64 {
    let t = &p.motor.transmission;
    let twist = motor.gear_rad - link_rad;
    let half = t.backlash_half_width_rad;
    let beyond = twist - twist.clamp(-half, half);
    if beyond == 0.0 {
        return 0.0;
    }
    let stiffness = if t.stiffness_nm_rad.is_infinite() {
        STOP_NM_RAD
    } else {
        t.stiffness_nm_rad
    };
    let torque = stiffness * beyond + SPRING_DAMPING_NM_S_RAD * (motor.gear_rad_s - link_rad_s);
    // A stop can push, never pull.
    if half > 0.0 && torque * beyond < 0.0 {
        0.0
    } else {
        torque
    }
}
