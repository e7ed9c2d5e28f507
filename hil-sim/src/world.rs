//! Drivers, joints, supply, body and bus on one virtual clock.
//!
//! Time is nanoseconds since the world began. The world only moves when told to: [`World::advance_to`] or
//! [`World::advance_to_byte`]; bytes written with [`World::write_bytes`] travel in between. Equal calls give equal
//! bits.

use std::collections::VecDeque;

use crate::body::{Body, Stand, StandJoint};
use crate::bus::{Bus, BusCounters, BusParams, Delivery, Talker};
use crate::driver::{Driver, DriverParams, Sensors};
use crate::motor::{JointKind, JointParams, JointState, ParamError, current_limit_a};
use crate::plant::Plant;
use crate::supply::SupplyParams;

/// One joint and its driver.
#[derive(Clone, Debug, PartialEq)]
pub struct JointSetup {
    /// Bus address, 0..=252.
    pub id: u8,
    /// Motor, gear, friction.
    pub joint: JointParams,
    /// Electronics.
    pub driver: DriverParams,
    /// What the joint carries when it stands alone ([`World::on_stand`]).
    pub load: LoadParams,
}

/// One joint's load on the default stand.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadParams {
    /// Inertia of what the joint carries [kg m2].
    pub inertia_kg_m2: f64,
    /// Gravity amplitude m g l [N m].
    pub gravity_nm: f64,
    /// Angle at which the load hangs down [rad].
    pub hang_rad: f64,
}

impl Default for LoadParams {
    fn default() -> Self {
        // Two half-spheres in the air, turning about their cube's centre without gravity torque: 2 x 0.325 kg
        // (Table II) at the radius of gyration of a 110 mm cube, 0.65 * 0.11^2 / 6.
        Self {
            inertia_kg_m2: 1.31e-3,
            gravity_nm: 0.0,
            hang_rad: 0.0,
        }
    }
}

/// A whole world but for its body.
#[derive(Clone, Debug, PartialEq)]
pub struct WorldParams {
    /// Seed of every random stream.
    pub seed: u64,
    /// Step of joints and body [ns].
    pub step_ns: u64,
    /// Joint steps per body step.
    pub body_every: u32,
    /// Wire.
    pub bus: BusParams,
    /// Battery.
    pub supply: SupplyParams,
    /// Joints in body order.
    pub joints: Vec<JointSetup>,
}

impl WorldParams {
    /// Six drives of a meta-module, addresses 1 to 6, each made by `joint` for its kind; everything else neutral.
    #[must_use]
    pub fn metamodule(seed: u64, joint: fn(JointKind) -> JointParams) -> Self {
        Self::of(seed, &JointKind::METAMODULE.map(joint))
    }

    /// One joint alone, address 1; everything else neutral.
    #[must_use]
    pub fn bench(seed: u64, joint: JointParams) -> Self {
        Self::of(seed, &[joint])
    }

    fn of(seed: u64, joints: &[JointParams]) -> Self {
        let joints = joints
            .iter()
            .zip(1..)
            .map(|(joint, id)| JointSetup {
                id,
                joint: joint.clone(),
                driver: DriverParams::default(),
                load: LoadParams::default(),
            })
            .collect();
        Self {
            seed,
            step_ns: DEFAULT_STEP_NS,
            body_every: 1,
            bus: BusParams::default(),
            supply: SupplyParams::default(),
            joints,
        }
    }
}

/// Step of joints and body. Chosen: 80 times finer than the motors' mechanical time constant of about 4 ms.
pub const DEFAULT_STEP_NS: u64 = 50_000;

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

/// The emulated motors on their bus.
pub struct World {
    now_ns: u64,
    plant_ns: u64,
    step_ns: u64,
    plant: Plant,
    drivers: Vec<Driver>,
    bridges: Vec<(f64, bool)>,
    bus: Bus,
    inbox: VecDeque<Arrival>,
}

impl World {
    /// A world at time 0 whose joints stand alone, each with its own load, at rest at 0 rad.
    ///
    /// # Errors
    /// A joint parameter outside its range.
    pub fn on_stand(params: &WorldParams) -> Result<Self, ParamError> {
        let joints = params
            .joints
            .iter()
            .map(|setup| StandJoint {
                inertia_kg_m2: setup.load.inertia_kg_m2,
                gravity_nm: setup.load.gravity_nm,
                hang_rad: setup.load.hang_rad,
                load: None,
            })
            .collect();
        Self::new(params, Box::new(Stand::new(joints)))
    }

    /// A world at time 0, every driver just powered, joints where the body says.
    ///
    /// # Errors
    /// A joint parameter outside its range.
    pub fn new(params: &WorldParams, body: Box<dyn Body>) -> Result<Self, ParamError> {
        let joints = params
            .joints
            .iter()
            .map(|setup| setup.joint.clone())
            .collect();
        let plant = Plant::new(
            joints,
            params.supply.clone(),
            body,
            params.step_ns,
            params.body_every,
        )?;
        let drivers: Vec<_> = params
            .joints
            .iter()
            .enumerate()
            .map(|(index, setup)| Driver::new(setup.driver.clone(), params.seed, index, 0))
            .collect();
        let mut world = Self {
            now_ns: 0,
            plant_ns: 0,
            step_ns: params.step_ns.max(1),
            bridges: vec![(0.0, false); drivers.len()],
            plant,
            drivers,
            bus: Bus::new(params.bus.clone(), params.seed),
            inbox: VecDeque::new(),
        };
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

    /// Driver `index`, in body order.
    #[must_use]
    pub fn driver(&self, index: usize) -> Option<&Driver> {
        self.drivers.get(index)
    }

    /// Driver `index` without the bus: tests, commissioning.
    pub fn driver_mut(&mut self, index: usize) -> Option<&mut Driver> {
        self.drivers.get_mut(index)
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

    /// Joints, supply and body.
    #[must_use]
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// Bytes from the master from `at_ns` (not before now) on. Returns when the last stop bit ends [ns].
    pub fn write_bytes(&mut self, at_ns: u64, bytes: &[u8]) -> u64 {
        self.bus.send(at_ns.max(self.now_ns), Talker::Master, bytes)
    }

    /// Runs up to `until_ns`; bytes that reach the master wait in [`Self::next_byte`].
    pub fn advance_to(&mut self, until_ns: u64) {
        while let Some(at_ns) = self
            .bus
            .next_delivery_ns()
            .filter(|&at_ns| at_ns <= until_ns)
        {
            self.pass_byte(at_ns);
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
            match self
                .bus
                .next_delivery_ns()
                .filter(|&at_ns| at_ns <= limit_ns)
            {
                Some(at_ns) => self.pass_byte(at_ns),
                None => {
                    self.advance_to(limit_ns);
                    return None;
                }
            }
        }
    }

    /// Lets the wire and the joints come to `at_ns` and hands the byte due then to everybody.
    fn pass_byte(&mut self, at_ns: u64) {
        self.run_plant(at_ns);
        self.now_ns = self.now_ns.max(at_ns);
        while let Some(delivery) = self.bus.deliver(at_ns) {
            self.hand_out(delivery);
        }
    }

    fn hand_out(&mut self, delivery: Delivery) {
        if delivery.from != Talker::Master || self.bus.params().echo {
            self.inbox.push_back(Arrival {
                at_ns: delivery.at_ns,
                byte: delivery.byte,
                clean: delivery.clean,
            });
        }
    }

    fn run_plant(&mut self, until_ns: u64) {
        while self.plant_ns + self.step_ns <= until_ns {
            self.plant.step(&self.bridges);
            self.plant_ns += self.step_ns;
            self.tick_drivers();
        }
    }

    /// Ticks every driver whose loop is due at the plant's time.
    fn tick_drivers(&mut self) {
        for index in 0..self.drivers.len() {
            let due = self.drivers[index].next_tick_ns() <= self.plant_ns;
            if due {
                let sensors = self.sensors(index);
                let alive = self.drivers[index].tick(self.plant_ns, &sensors);
                if !alive {
                    self.drivers[index].reboot(self.plant_ns);
                }
                self.bridges[index] = self.drivers[index].bridge();
            }
        }
    }

    fn sensors(&self, index: usize) -> Sensors {
        let params = &self.plant.params()[index];
        let state = &self.plant.states()[index];
        Sensors {
            gear_rad: state.gear_rad + params.encoder_error_rad(state),
            edge_rad: params.motor.edge_rad(),
            current_a: state.current_a,
            applied_duty: state.applied_duty,
            bus_v: self.plant.bus_v(),
            case_c: state.case_c,
            limit_a: current_limit_a(params),
        }
    }
}
