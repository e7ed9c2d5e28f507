//! Drivers, joints, supply, body and bus on one virtual clock.
//!
//! Time is nanoseconds since the world began. The world only moves when told to: [`World::advance_to`] or
//! [`World::advance_to_byte`]; bytes written with [`World::write_bytes`] travel in between. Equal calls give equal
//! bits.

mod params;

use std::collections::VecDeque;

use protocol::bus::server::Reply;

use crate::body::{Body, Disturbance, Load, Stand, StandJoint};
use crate::bus::{Bus, BusCounters, Delivery, Talker};
use crate::driver::unit::Unit;
use crate::driver::{Driver, Sensors};
use crate::fault::{FaultCount, Faults};
use crate::motor::{Bridge, JointState, ParamError, current_limit_a};
use crate::plant::Plant;

pub use params::{DEFAULT_STEP_NS, JointSetup, LoadParams, WorldParams};

/// A byte that reached the master.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// Instant of its stop bit [ns].
    pub at_ns: u64,
    /// Value.
    pub byte: u8,
    /// False = spoiled on the wire: the receiver may see a framing error.
    pub clean: bool,
}

/// What faults have made of one driver.
#[derive(Clone, Debug, Default)]
struct Condition {
    /// Off the bus.
    missing: bool,
    /// Misses the request under way.
    deaf: bool,
    /// No supply for the electronics.
    dead: bool,
    /// Encoder stands at this angle [rad].
    stuck_rad: Option<f64>,
    /// Sum of encoder jumps [rad].
    shift_rad: f64,
    /// Jammed.
    jammed: bool,
}

/// The emulated motors on their bus.
pub struct World {
    now_ns: u64,
    plant_ns: u64,
    step_ns: u64,
    plant: Plant,
    units: Vec<Unit>,
    conditions: Vec<Condition>,
    bridges: Vec<Bridge>,
    bus: Bus,
    /// The master has said at which rate it talks; before, all are at that of the scenario.
    baud_set: bool,
    faults: Faults,
    inbox: VecDeque<Arrival>,
}

fn stand_joint(load: &LoadParams, seed: u64, index: usize) -> StandJoint {
    let noise = load.disturbance_nm;
    StandJoint {
        inertia_kg_m2: load.inertia_kg_m2,
        gravity_nm: load.gravity_nm,
        hang_rad: load.hang_rad,
        load: (noise > 0.0)
            .then(|| Box::new(Disturbance::new(noise, seed, index)) as Box<dyn Load>),
    }
}

/// A bridge that does nothing.
const IDLE: Bridge = Bridge {
    duty: 0.0,
    enabled: false,
    limit_a: f64::INFINITY,
    bus_v: 0.0,
};

impl World {
    /// A world at time 0 whose joints stand alone, each with its own load, at rest at 0 rad.
    ///
    /// # Errors
    /// A joint parameter outside its range.
    pub fn on_stand(params: &WorldParams) -> Result<Self, ParamError> {
        let joints = params
            .joints
            .iter()
            .enumerate()
            .map(|(index, setup)| stand_joint(&setup.load, params.seed, index))
            .collect();
        Self::new(params, Box::new(Stand::new(joints)))
    }

    /// A world at time 0, every driver just powered, joints where the body says.
    ///
    /// # Errors
    /// A joint parameter outside its range.
    pub fn new(params: &WorldParams, body: Box<dyn Body>) -> Result<Self, ParamError> {
        let joints: Vec<_> = params
            .joints
            .iter()
            .map(|setup| setup.joint.clone())
            .collect();
        let count = joints.len();
        let plant = Plant::new(
            joints,
            params.supply.clone(),
            body,
            params.step_ns,
            params.body_every,
        )?;
        let byte_ns = params.bus.byte_ns();
        let units = params
            .joints
            .iter()
            .enumerate()
            .map(|(index, setup)| {
                Unit::new(setup.id, setup.driver.clone(), params.seed, index, byte_ns)
            })
            .collect();
        let mut world = Self {
            now_ns: 0,
            plant_ns: 0,
            step_ns: params.step_ns.max(1),
            plant,
            units,
            conditions: vec![Condition::default(); count],
            bridges: vec![IDLE; count],
            bus: Bus::new(params.bus.clone(), params.seed),
            baud_set: false,
            faults: Faults::new(&params.faults, params.seed, count),
            inbox: VecDeque::new(),
        };
        world.suffer();
        world.tick_drivers();
        Ok(world)
    }

    /// Present time [ns].
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        self.now_ns
    }

    /// State of joint `index`.
    #[must_use]
    pub fn joint(&self, index: usize) -> Option<&JointState> {
        self.plant.states().get(index)
    }

    /// Number of joints.
    #[must_use]
    pub fn joints(&self) -> usize {
        self.units.len()
    }

    /// Driver `index`, in body order.
    #[must_use]
    pub fn driver(&self, index: usize) -> Option<&Driver> {
        self.units.get(index).map(|unit| &unit.driver)
    }

    /// Driver `index` without the bus: tests, commissioning.
    pub fn driver_mut(&mut self, index: usize) -> Option<&mut Driver> {
        self.units.get_mut(index).map(|unit| &mut unit.driver)
    }

    /// Jams or frees joint `index` at its present angle.
    pub fn set_stall(&mut self, index: usize, jammed: bool) {
        self.plant.set_jam(index, jammed);
    }

    /// What the bus has seen.
    #[must_use]
    pub fn bus_counters(&self) -> &BusCounters {
        self.bus.counters()
    }

    /// The bus, if no fault can change what is on it.
    #[must_use]
    pub fn undisturbed_bus(&self) -> Option<&Bus> {
        self.faults.is_empty().then_some(&self.bus)
    }

    /// How often each fault struck, in the order of [`WorldParams::faults`].
    #[must_use]
    pub fn fault_counts(&self) -> Vec<FaultCount> {
        self.faults.counts()
    }

    /// Joints, supply and body.
    #[must_use]
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// Bytes from the master from `at_ns` (not before now) on. Returns when the last stop bit ends [ns].
    pub fn write_bytes(&mut self, at_ns: u64, bytes: &[u8]) -> u64 {
        let at_ns = at_ns.max(self.now_ns);
        for (index, condition) in self.conditions.iter_mut().enumerate() {
            condition.deaf = self.faults.misses_request(index, at_ns);
        }
        self.bus.send(at_ns, Talker::Master, bytes)
    }

    /// Bits per second at which the master talks and listens from now on. Drivers set to another rate hear nothing.
    pub fn set_baud(&mut self, baud: u32) {
        self.baud_set = true;
        self.bus.set_baud(baud);
    }

    /// Runs up to `until_ns`; bytes that reach the master wait in [`Self::next_byte`].
    pub fn advance_to(&mut self, until_ns: u64) {
        while let Some(at_ns) = self.next_event_ns().filter(|&at_ns| at_ns <= until_ns) {
            self.pass(at_ns);
        }
        self.run_plant(until_ns);
        self.now_ns = self.now_ns.max(until_ns);
    }

    /// The oldest byte that has reached the master.
    pub fn next_byte(&mut self) -> Option<Arrival> {
        self.inbox.pop_front()
    }

    /// Runs until a byte reaches the master, `limit_ns` at the latest; afterwards now is the byte's instant or the
    /// limit.
    pub fn advance_to_byte(&mut self, limit_ns: u64) -> Option<Arrival> {
        loop {
            if let Some(arrival) = self.inbox.pop_front() {
                return Some(arrival);
            }
            match self.next_event_ns().filter(|&at_ns| at_ns <= limit_ns) {
                Some(at_ns) => self.pass(at_ns),
                None => {
                    self.advance_to(limit_ns);
                    return self.inbox.pop_front();
                }
            }
        }
    }

    /// When something happens on the wire next: a byte ends, a waiting driver loses patience [ns].
    #[must_use]
    pub fn next_wire_ns(&self) -> Option<u64> {
        let silence = self.units.iter().filter_map(Unit::deadline_ns).min();
        [self.bus.next_delivery_ns(), silence]
            .into_iter()
            .flatten()
            .min()
    }

    /// When the next byte ends or the next driver gives up waiting [ns]. With a babbling driver also the next joint
    /// step: it may start then.
    #[must_use]
    pub fn next_event_ns(&self) -> Option<u64> {
        let step = self
            .faults
            .may_babble()
            .then_some(self.plant_ns + self.step_ns);
        [self.next_wire_ns(), step].into_iter().flatten().min()
    }

    /// Lets the joints come to `at_ns` and everything on the wire happen that is due.
    fn pass(&mut self, at_ns: u64) {
        self.run_plant(at_ns);
        self.now_ns = self.now_ns.max(at_ns);
        while let Some(delivery) = self.bus.deliver(at_ns) {
            if let Some(delivery) = self.faults.on_wire(delivery) {
                self.hand_out(delivery);
            }
        }
        for index in 0..self.units.len() {
            if let Some(reply) = self.units[index].poll(at_ns) {
                self.answer(index, &reply);
            }
        }
    }

    fn hand_out(&mut self, delivery: Delivery) {
        if delivery.from != Talker::Master || self.bus.params().echo {
            let Delivery {
                at_ns, byte, clean, ..
            } = delivery;
            self.inbox.push_back(Arrival { at_ns, byte, clean });
        }
        for index in 0..self.units.len() {
            let condition = &self.conditions[index];
            let baud = self.bus.params().baud;
            let rate = !self.baud_set || self.units[index].baud() == baud;
            let hears = rate && !(condition.missing || condition.deaf || condition.dead);
            if hears
                && delivery.from != Talker::Driver(index)
                && let Some(reply) = self.units[index].hear(delivery.byte, delivery.at_ns)
            {
                self.answer(index, &reply);
            }
        }
    }

    fn answer(&mut self, index: usize, reply: &Reply) {
        let now_ns = self.now_ns;
        if self.conditions[index].missing || self.faults.loses_reply(index, now_ns) {
            return;
        }
        let delay_ns = self.faults.reply_delay_ns(index, now_ns);
        self.bus.send(
            reply.send_at_ns + delay_ns,
            Talker::Driver(index),
            &reply.bytes,
        );
    }

    fn run_plant(&mut self, until_ns: u64) {
        while self.plant_ns + self.step_ns <= until_ns {
            self.plant.step(&self.bridges);
            self.plant_ns += self.step_ns;
            self.suffer();
            self.tick_drivers();
        }
    }

    /// Ticks every driver whose loop is due at the plant's time.
    fn tick_drivers(&mut self) {
        for index in 0..self.units.len() {
            if self.units[index].driver.next_tick_ns() <= self.plant_ns {
                let sensors = self.sensors(index);
                let unit = &mut self.units[index];
                let alive = unit.driver.tick(self.plant_ns, &sensors);
                self.conditions[index].dead = !alive;
                if !alive {
                    unit.restart(self.plant_ns);
                }
            }
            self.bridges[index] = self.units[index].driver.bridge();
        }
    }

    /// Lets the faults act on joints and drivers.
    fn suffer(&mut self) {
        if self.faults.is_empty() {
            return;
        }
        let now_ns = self.plant_ns;
        self.plant
            .set_supply_ratio(self.faults.supply_ratio(now_ns));
        for index in 0..self.units.len() {
            let silent = self.bus.free_from_ns(Talker::Driver(index)) <= now_ns;
            let orders = self.faults.orders(index, now_ns, silent);
            let gear_rad = self.plant.states()[index].gear_rad;
            let condition = &mut self.conditions[index];
            condition.missing = orders.missing;
            condition.shift_rad += orders.jump_rad;
            condition.stuck_rad = if orders.stuck {
                condition.stuck_rad.or(Some(gear_rad))
            } else {
                None
            };
            if orders.stall != condition.jammed {
                condition.jammed = orders.stall;
                self.plant.set_jam(index, orders.stall);
            }
            let unit = &mut self.units[index];
            unit.registers.set_alias(orders.alias);
            if orders.reset {
                unit.restart(now_ns);
            }
            if let Some(burst) = orders.babble {
                self.bus.send(now_ns, Talker::Driver(index), &burst);
            }
        }
    }

    fn sensors(&self, index: usize) -> Sensors {
        let params = &self.plant.params()[index];
        let state = &self.plant.states()[index];
        let condition = &self.conditions[index];
        let gear_rad = condition.stuck_rad.unwrap_or(state.gear_rad);
        Sensors {
            gear_rad: gear_rad + params.encoder_error_rad(state) + condition.shift_rad,
            edge_rad: params.motor.edge_rad(),
            current_a: state.current_a,
            applied_duty: state.applied_duty,
            bus_v: self.plant.bus_v(),
            case_c: state.case_c,
            limit_a: current_limit_a(params),
        }
    }
}
