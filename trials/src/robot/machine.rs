//! One gait on one robot.

use control::cpg::{self, CpgState};
use control::gait::Gait;
use physics::{Body, Options, Params, Pose, Twist};
use std::sync::Arc;

use super::drive::{DriveState, FLANGE_KG_M2, TICK_S};
use super::reality::Reality;
use super::{JOINTS, SAMPLE_TICKS, SEND_TICKS};
use hil_sim::rng::Rng;

/// Body step, s, and sweeps: a quarter of the simulator's step and twice its sweeps.
const STEP_S: f64 = 1e-3;
/// Step with play or springs, s.
const FINE_STEP_S: f64 = 5e-4;
const SWEEPS: u32 = 24;
/// Speed of the way to the first set-points, and rest after it.
const APPROACH_RAD_S: f64 = 1.0;
const SETTLE_S: f64 = 0.5;

/// What differs between two runs of the same gait.
#[derive(Clone, Debug)]
pub(super) struct Process {
    rng: Rng,
    /// Slow random torque in every joint, N m.
    torque_nm: [f64; JOINTS],
}

/// Standard deviation and correlation time of the joints' random torque: as of cables and seals.
const TORQUE_NM: f64 = 0.05;
const TORQUE_S: f64 = 0.2;
/// Ground friction between runs, relative; heading of the start; homing error; battery.
const FRICTION_SPREAD: f64 = 0.02;
const HEADING_RAD: f64 = 0.05;
const HOMING_RAD: f64 = 1.0e-3;
const BATTERY_V: f64 = 0.04;

/// One instant.
#[derive(Clone, Debug)]
pub(super) struct Sample {
    pub(super) t_s: f64,
    /// Set-points of the gait at this time, as they stand in the recording.
    pub(super) sent_rad: [f64; JOINTS],
    pub(super) applied_rad: [f64; JOINTS],
    pub(super) encoder_rad: [f64; JOINTS],
    pub(super) speed_rad_s: [f64; JOINTS],
    pub(super) current_a: [f64; JOINTS],
    pub(super) duty: [f64; JOINTS],
    pub(super) case_c: [f64; JOINTS],
    pub(super) effort_nm: [f64; JOINTS],
    pub(super) bus_v: f64,
    pub(super) gyro_rad_s: [f64; 3],
    /// Mean since the sample before.
    pub(super) accel_m_s2: [f64; 3],
    pub(super) base: Pose,
    pub(super) link_rad: [f32; JOINTS],
}

impl Sample {
    /// Whether the numbers belong to no robot: an angle of a thousand turns, a base a kilometre away, or none at all.
    pub(super) fn is_absurd(&self) -> bool {
        let far = |x: &f64| !x.is_finite() || x.abs() > 6e3;
        let lost = |x: &f32| !x.is_finite() || x.abs() > 1e3;
        self.encoder_rad.iter().any(far) || self.base.position_m.iter().any(lost)
    }
}

/// Everything that goes on, to begin again from it.
#[derive(Clone)]
pub(super) struct Snapshot {
    base: Pose,
    twist: Twist,
    angles_rad: [f64; JOINTS],
    speeds_rad_s: [f64; JOINTS],
    drives: Vec<DriveState>,
    played: CpgState,
    listed: CpgState,
    next_send_ns: u64,
    listed_now_rad: [f64; JOINTS],
    bus_v: f64,
    tick: u64,
}

impl Snapshot {
    /// The drives, and the links' angles and speeds, of the reality `now` in which every reading is what it was.
    fn rejoined(
        &self,
        was: &Reality,
        now: &Reality,
    ) -> (Vec<DriveState>, [f64; JOINTS], [f64; JOINTS]) {
        let mut drives = self.drives.clone();
        let (mut angles_rad, mut speeds_rad_s) = ([0.0; JOINTS], [0.0; JOINTS]);
        for column in 0..JOINTS {
            let (from, to) = (was.reads(column), now.reads(column));
            let [before, after] = [was.conventions[from], now.conventions[to]];
            let mut state = self.drives[from].clone();
            let read = |joint_rad: f64| after.read_as(before.reading(joint_rad));
            let encoder_rad = state.encoder_rad(&was.drives[from]);
            let factor = read(1.0) - read(0.0);
            let column_of = |order: &[usize; JOINTS], joint: usize| {
                order.iter().position(|j| *j == joint).unwrap_or(joint)
            };
            let sender = was.order[column_of(&now.order, to)];
            (angles_rad[to], speeds_rad_s[to]) =
                state.rejoin(&now.drives[to], read(encoder_rad), factor);
            state.take_orders(&self.drives[sender], after);
            drives[to] = state;
        }
        (drives, angles_rad, speeds_rad_s)
    }
}

/// A robot playing a gait.
pub(super) struct Machine<'a> {
    reality: &'a Reality,
    gait: &'a Gait,
    params: Arc<Params>,
    body: Body,
    step_s: f64,
    drives: Vec<DriveState>,
    /// Oscillators on the robot's clock, and on the recording's.
    played: CpgState,
    listed: CpgState,
    next_send_ns: u64,
    listed_now_rad: [f64; JOINTS],
    bus_v: f64,
    battery_v: f64,
    homing_rad: [f64; JOINTS],
    process: Option<Process>,
    /// Driver ticks since the gait began.
    tick: u64,
    accel: ([f64; 3], f64),
}

fn options(step_s: f64) -> Options {
    Options {
        time_step_s: step_s,
        sweeps: SWEEPS,
        ..Options::default()
    }
}

fn first(gait: &Gait) -> [f64; JOINTS] {
    let mut out = [0.0; JOINTS];
    for (slot, o) in out.iter_mut().zip(gait.oscillators()) {
        *slot = f64::from(o.offset_rad);
    }
    out
}

impl<'a> Machine<'a> {
    /// The robot at the first set-points, at rest, the gait about to begin. `run` draws what differs between runs;
    /// `None` = nothing.
    pub(super) fn new(
        reality: &'a Reality,
        gait: &'a Gait,
        run: Option<(u64, u64)>,
    ) -> Option<Self> {
        let mut process = run.map(|(seed, index)| Process {
            rng: Rng::new(seed, 0x50, index),
            torque_nm: [0.0; JOINTS],
        });
        let mut draw = |sigma: f64| process.as_mut().map_or(0.0, |p| sigma * p.rng.normal());
        let mut params = (*reality.params).clone();
        params.friction *= 1.0 + draw(FRICTION_SPREAD);
        let params = Arc::new(params);
        let step_s = if reality.is_loose() {
            FINE_STEP_S
        } else {
            STEP_S
        };
        let mut body = Body::new(Arc::clone(&params), &options(step_s)).ok()?;
        let half = 0.5 * draw(HEADING_RAD);
        let mut base = body.base();
        base.quaternion = [libm::cos(half) as f32, 0.0, 0.0, libm::sin(half) as f32];
        body.place(&base, &Twist::default(), &[0.0; JOINTS], &[0.0; JOINTS])
            .ok()?;
        let homing_rad = std::array::from_fn(|_| draw(HOMING_RAD));
        let battery_v = draw(BATTERY_V);
        let seed = run.map_or(0, |(seed, index)| seed ^ index.wrapping_mul(0x9E37));
        let drives = (0..JOINTS)
            .map(|k| {
                let ambient_c = reality.drives[k].motor.thermal.ambient_c;
                DriveState::new(0.0, ambient_c, seed, k)
            })
            .collect();
        let mut machine = Self {
            reality,
            gait,
            params,
            body,
            step_s,
            drives,
            played: cpg::start(gait),
            listed: cpg::start(gait),
            next_send_ns: 0,
            listed_now_rad: first(gait),
            bus_v: reality.supply.voltage_v + battery_v,
            battery_v,
            homing_rad,
            process,
            tick: 0,
            accel: ([0.0; 3], 0.0),
        };
        machine.approach();
        Some(machine)
    }

    /// Goes on from a snapshot of a machine of the same gait in the reality `was`, with the same readings and the same
    /// pose of the base: of the rest no recording tells.
    pub(super) fn resume(
        reality: &'a Reality,
        gait: &'a Gait,
        (from, was): (&Snapshot, &Reality),
        run: Option<(u64, u64)>,
    ) -> Option<Self> {
        let mut params = (*reality.params).clone();
        let mut process = run.map(|(seed, index)| Process {
            rng: Rng::new(seed, 0x51, index),
            torque_nm: [0.0; JOINTS],
        });
        if let Some(p) = &mut process {
            params.friction *= 1.0 + FRICTION_SPREAD * p.rng.normal();
            p.torque_nm = std::array::from_fn(|_| TORQUE_NM * p.rng.normal());
        }
        let params = Arc::new(params);
        let step_s = if reality.is_loose() {
            FINE_STEP_S
        } else {
            STEP_S
        };
        let mut body = Body::new(Arc::clone(&params), &options(step_s)).ok()?;
        let (drives, angles_rad, speeds_rad_s) = from.rejoined(was, reality);
        body.place(&from.base, &from.twist, &angles_rad, &speeds_rad_s)
            .ok()?;
        Some(Self {
            reality,
            gait,
            params,
            body,
            step_s,
            drives,
            played: from.played.clone(),
            listed: from.listed.clone(),
            next_send_ns: from.next_send_ns,
            listed_now_rad: from.listed_now_rad,
            bus_v: from.bus_v,
            battery_v: 0.0,
            homing_rad: [0.0; JOINTS],
            process,
            tick: from.tick,
            accel: ([0.0; 3], 0.0),
        })
    }

    pub(super) fn snapshot(&self) -> Snapshot {
        let gather = |it: &mut dyn Iterator<Item = f64>| {
            let mut out = [0.0; JOINTS];
            for (slot, x) in out.iter_mut().zip(it) {
                *slot = x;
            }
            out
        };
        Snapshot {
            base: self.body.base(),
            twist: self.body.twist(),
            angles_rad: gather(&mut self.body.angles_rad()),
            speeds_rad_s: gather(&mut self.body.speeds_rad_s()),
            drives: self.drives.clone(),
            played: self.played.clone(),
            listed: self.listed.clone(),
            next_send_ns: self.next_send_ns,
            listed_now_rad: self.listed_now_rad,
            bus_v: self.bus_v,
            tick: self.tick,
        }
    }

    /// From home to the first set-points, then rest.
    fn approach(&mut self) {
        let goal = first(self.gait);
        let largest = goal.iter().fold(0.0f64, |a, x| a.max(x.abs()));
        let ticks = ((largest / APPROACH_RAD_S + SETTLE_S) / TICK_S) as u64;
        for tick in 0..ticks {
            let reach = APPROACH_RAD_S * tick as f64 * TICK_S;
            for (k, x) in goal.iter().enumerate() {
                let wire = x.clamp(-reach, reach);
                let joint = self.reality.order[k];
                let convention = self.reality.conventions[joint];
                self.drives[joint].place_goal(convention, wire);
            }
            self.drive_tick();
        }
        self.accel = ([0.0; 3], 0.0);
    }

    /// One driver tick of everything, without the gait.
    fn drive_tick(&mut self) {
        for (state, p) in self.drives.iter_mut().zip(&self.reality.drives) {
            state.tick(p);
        }
        self.disturb();
        let steps = libm::round(TICK_S / self.step_s) as u32;
        for _ in 0..steps {
            self.step();
        }
    }

    fn disturb(&mut self) {
        let Some(p) = &mut self.process else {
            return;
        };
        // Ornstein-Uhlenbeck, exact over the tick.
        let keep = libm::exp(-TICK_S / TORQUE_S);
        for x in &mut p.torque_nm {
            *x = keep * *x + TORQUE_NM * (1.0 - keep * keep).sqrt() * p.rng.normal();
        }
    }

    fn step(&mut self) {
        let r = self.reality;
        let mut links = [(0.0, 0.0); JOINTS];
        for (slot, link) in links
            .iter_mut()
            .zip(self.body.angles_rad().zip(self.body.speeds_rad_s()))
        {
            *slot = link;
        }
        let mut orders = Vec::with_capacity(JOINTS);
        for (k, link) in links.iter().enumerate() {
            let p = &r.drives[k];
            orders.push(self.drives[k].order(p, self.bus_v, *link, self.step_s));
        }
        self.arm();
        self.body.step(&orders);
        let after = self
            .body
            .angles_rad()
            .zip(self.body.speeds_rad_s())
            .zip(self.body.torques_nm());
        let mut drawn_a = 0.0;
        for (k, ((angle, speed), torque)) in after.enumerate() {
            let extra_nm = self.process.as_ref().map_or(0.0, |p| p.torque_nm[k]);
            let (p, state) = (&r.drives[k], &mut self.drives[k]);
            state.follow(p, self.bus_v, (angle, speed, torque), extra_nm, self.step_s);
            drawn_a += state.motor.applied_duty * state.motor.current_a;
        }
        self.bus_v = (r.supply.bus_v(drawn_a) + self.battery_v).max(0.1);
        let imu = self.body.imu();
        for (sum, a) in self.accel.0.iter_mut().zip(imu.accel_m_s2) {
            *sum += a;
        }
        self.accel.1 += 1.0;
    }

    /// `inertia`: more or less of what the joint alone feels; a flange where the rotor is a body of its own.
    fn arm(&mut self) {
        let own: Vec<f64> = self.body.inertias_kg_m2().collect();
        for (k, p) in self.reality.drives.iter().enumerate() {
            let mut extra = 0.0;
            if !p.motor.transmission.is_rigid() {
                extra += FLANGE_KG_M2;
            }
            if p.motor.inertia_ratio != 1.0 {
                let before = self.armature(k);
                extra += (p.motor.inertia_ratio - 1.0) * (own[k] - before).max(0.0);
            }
            if extra != 0.0 {
                self.drives[k].armature_kg_m2 = extra;
                self.body.set_armature(k, extra);
            }
        }
    }

    fn armature(&self, joint: usize) -> f64 {
        self.drives[joint].armature_kg_m2
    }

    /// Sends what the robot's clock says is due, and lists what the recording's clock says.
    fn play(&mut self) {
        let now_ns = self.tick * 1_000_000;
        if self.tick.is_multiple_of(SEND_TICKS) {
            let out = cpg::step(self.gait, &mut self.listed, 0.05);
            for (slot, x) in self.listed_now_rad.iter_mut().zip(out.as_slice()) {
                *slot = f64::from(*x);
            }
        }
        if now_ns >= self.next_send_ns {
            let out = cpg::step(self.gait, &mut self.played, 0.05);
            for (k, x) in out.as_slice().iter().enumerate().take(JOINTS) {
                let joint = self.reality.order[k];
                let wire = f64::from(*x) + self.homing_rad[joint];
                self.drives[joint].send(&self.reality.drives[joint], now_ns, wire);
            }
            self.next_send_ns += (0.05e9 / self.reality.clock) as u64;
        }
        for (state, convention) in self.drives.iter_mut().zip(self.reality.conventions) {
            state.receive(convention, now_ns);
        }
        if self.reality.friction_drift_1_s != 0.0 && self.tick % 1000 == 999 {
            self.wear();
        }
    }

    /// Outside the vocabulary: the ground loses friction as time passes.
    fn wear(&mut self) {
        let keep = 1.0 - self.reality.friction_drift_1_s;
        let mut params = (*self.params).clone();
        params.friction *= keep.clamp(0.0, 1.0);
        self.params = Arc::new(params);
        let s = self.snapshot();
        let next = Body::new(Arc::clone(&self.params), &options(self.step_s));
        if let Ok(mut body) = next
            && body
                .place(&s.base, &s.twist, &s.angles_rad, &s.speeds_rad_s)
                .is_ok()
        {
            self.body = body;
        }
    }

    /// Plays `samples` samples on.
    pub(super) fn record(&mut self, samples: usize) -> Vec<Sample> {
        let mut out = Vec::with_capacity(samples);
        while out.len() < samples {
            self.play();
            if self.tick.is_multiple_of(SAMPLE_TICKS) {
                out.push(self.sample());
            }
            self.drive_tick();
            self.tick += 1;
        }
        out
    }

    fn sample(&mut self) -> Sample {
        let r = self.reality;
        let of = |f: &dyn Fn(usize) -> f64| std::array::from_fn(|k| f(r.reads(k)));
        let wire = |j: usize, x: f64| r.conventions[j].reading(x);
        let sign = |j: usize| r.conventions[j].reading_sign();
        let drives = &self.drives;
        let imu = self.body.imu();
        let n = self.accel.1.max(1.0);
        let accel = if self.accel.1 > 0.0 {
            self.accel.0.map(|a| a / n)
        } else {
            imu.accel_m_s2
        };
        self.accel = ([0.0; 3], 0.0);
        let mut link_rad = [0.0; JOINTS];
        for (slot, x) in link_rad.iter_mut().zip(self.body.angles_rad()) {
            *slot = x as f32;
        }
        Sample {
            t_s: self.tick as f64 * TICK_S,
            sent_rad: self.listed_now_rad,
            // The echo of address k comes from the driver that holds it.
            applied_rad: std::array::from_fn(|k| {
                let j = r.order[k];
                drives[j].applied_wire_rad - self.homing_rad[j]
            }),
            encoder_rad: of(&|j| wire(j, drives[j].encoder_rad(&r.drives[j])) - self.homing_rad[j]),
            speed_rad_s: of(&|j| sign(j) * drives[j].motor.gear_rad_s),
            current_a: of(&|j| sign(j) * drives[j].current_a),
            duty: of(&|j| sign(j) * drives[j].motor.applied_duty),
            case_c: of(&|j| drives[j].motor.case_c),
            effort_nm: of(&|j| sign(j) * drives[j].motor_nm()),
            bus_v: self.bus_v,
            gyro_rad_s: imu.gyro_rad_s,
            accel_m_s2: accel,
            base: self.body.base(),
            link_rad,
        }
    }
}
