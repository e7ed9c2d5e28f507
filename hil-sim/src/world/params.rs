//! Everything that is fixed about a world.

use crate::bus::BusParams;
use crate::driver::DriverParams;
use crate::fault::Fault;
use crate::motor::{JointKind, JointParams};
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
    /// Standard deviation of a random torque on the load, correlated over 0.1 s: why repeats differ [N m].
    pub disturbance_nm: f64,
}

impl Default for LoadParams {
    fn default() -> Self {
        // Two half-spheres in the air, turning about their cube's centre without gravity torque: 2 x 0.325 kg
        // (Table II) at the radius of gyration of a 110 mm cube, 0.65 * 0.11^2 / 6.
        Self {
            inertia_kg_m2: 1.31e-3,
            gravity_nm: 0.0,
            hang_rad: 0.0,
            disturbance_nm: 0.0,
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
    /// What goes wrong.
    pub faults: Vec<Fault>,
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

    /// These joints, addresses from 1 on; everything else neutral.
    #[must_use]
    pub fn of(seed: u64, joints: &[JointParams]) -> Self {
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
            faults: Vec::new(),
        }
    }
}

/// Step of joints and body. Chosen: 80 times finer than the motors' mechanical time constant of about 4 ms.
pub const DEFAULT_STEP_NS: u64 = 50_000;
