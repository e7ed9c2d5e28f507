//! Seeded faults on wire, drivers and joints: scheduled by a window, drawn by a probability, and counted.
//!
//! A world without faults draws nothing and is bit-identical to one that never heard of them.

use crate::bus::Delivery;
use crate::rng::Rng;

/// What goes wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultKind {
    /// A byte vanishes on the wire. Opportunity: every byte.
    ByteLoss,
    /// One bit of a byte flips on the wire. Opportunity: every byte.
    Corruption,
    /// The driver misses a request. Opportunity: every request.
    RequestLoss,
    /// The driver's answer never leaves. Opportunity: every answer.
    ReplyLoss,
    /// The driver answers late. Opportunity: every answer.
    ReplyDelay {
        /// Extra time before the first byte [s].
        delay_s: f64,
    },
    /// The driver is off the bus: deaf and mute.
    Missing,
    /// The driver sends garbage. Opportunity: every joint step while it is silent.
    Babble,
    /// The encoder stands still whatever the motor does.
    StuckEncoder,
    /// The encoder jumps once at the start of the window.
    EncoderJump {
        /// Size at the output [rad].
        jump_rad: f64,
    },
    /// The joint is jammed.
    Stall,
    /// The supply drops to a share of its voltage.
    BrownOut {
        /// Share of the healthy voltage.
        ratio: f64,
    },
    /// The driver restarts at the start of the window; with a probability also again at any joint step.
    Reset,
    /// The driver answers to another driver's address.
    DuplicateId {
        /// That address.
        id: u8,
    },
}

impl FaultKind {
    /// Name in files and reports.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::ByteLoss => "byte_loss",
            Self::Corruption => "corruption",
            Self::RequestLoss => "request_loss",
            Self::ReplyLoss => "reply_loss",
            Self::ReplyDelay { .. } => "reply_delay",
            Self::Missing => "missing",
            Self::Babble => "babble",
            Self::StuckEncoder => "stuck_encoder",
            Self::EncoderJump { .. } => "encoder_jump",
            Self::Stall => "stall",
            Self::BrownOut { .. } => "brown_out",
            Self::Reset => "reset",
            Self::DuplicateId { .. } => "duplicate_id",
        }
    }
}

/// One fault.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// What goes wrong.
    pub kind: FaultKind,
    /// Which joint; `None` = all of them, or the wire.
    pub joint: Option<usize>,
    /// From when [s].
    pub from_s: f64,
    /// Until when [s].
    pub to_s: f64,
    /// Probability per opportunity inside the window.
    pub probability: f64,
}

impl Fault {
    /// Always, on every joint.
    #[must_use]
    pub fn always(kind: FaultKind) -> Self {
        Self {
            kind,
            joint: None,
            from_s: 0.0,
            to_s: f64::INFINITY,
            probability: 1.0,
        }
    }

    /// Limited to one joint.
    #[must_use]
    pub fn on(mut self, joint: usize) -> Self {
        self.joint = Some(joint);
        self
    }

    /// Limited to a window [s].
    #[must_use]
    pub fn during(mut self, from_s: f64, to_s: f64) -> Self {
        self.from_s = from_s;
        self.to_s = to_s;
        self
    }

    /// With a probability per opportunity.
    #[must_use]
    pub fn chance(mut self, probability: f64) -> Self {
        self.probability = probability;
        self
    }

    fn covers(&self, joint: usize) -> bool {
        self.joint.is_none_or(|only| only == joint)
    }

    fn open(&self, now_ns: u64) -> bool {
        let now_s = now_ns as f64 * 1e-9;
        now_s >= self.from_s && now_s < self.to_s
    }
}

/// How often a fault struck.
#[derive(Clone, Debug, PartialEq)]
pub struct FaultCount {
    /// Name of the kind.
    pub name: &'static str,
    /// Joint, if the fault names one.
    pub joint: Option<usize>,
    /// Times it struck (windows entered, bytes spoiled, answers held back).
    pub count: u64,
}

/// What the faults ask of one joint and its driver at an instant.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct JointOrders {
    /// Deaf and mute.
    pub(crate) missing: bool,
    /// Bytes to babble now.
    pub(crate) babble: Option<Vec<u8>>,
    /// Encoder frozen.
    pub(crate) stuck: bool,
    /// Encoder shifts by this much now [rad].
    pub(crate) jump_rad: f64,
    /// Jammed.
    pub(crate) stall: bool,
    /// Restart now.
    pub(crate) reset: bool,
    /// Answer to this address.
    pub(crate) alias: Option<u8>,
}

#[derive(Clone, Debug)]
struct Entry {
    fault: Fault,
    rng: Rng,
    count: u64,
    /// Inside its window at the last look, per joint.
    inside: Vec<bool>,
}

/// All faults of a world.
#[derive(Clone, Debug)]
pub(crate) struct Faults {
    entries: Vec<Entry>,
}

/// Stream number of faults.
const PURPOSE_FAULT: u64 = 0xFA;
/// Bytes per burst of a babbling driver: a burst as long as a short packet.
const BABBLE_BYTES: usize = 12;

impl Faults {
    pub(crate) fn new(faults: &[Fault], seed: u64, joints: usize) -> Self {
        let entries = faults
            .iter()
            .enumerate()
            .map(|(index, fault)| Entry {
                fault: fault.clone(),
                rng: Rng::new(seed, PURPOSE_FAULT, index as u64),
                count: 0,
                inside: vec![false; joints],
            })
            .collect();
        Self { entries }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Whether a driver may start to talk unasked.
    pub(crate) fn may_babble(&self) -> bool {
        self.entries
            .iter()
            .any(|entry| entry.fault.kind == FaultKind::Babble)
    }

    pub(crate) fn counts(&self) -> Vec<FaultCount> {
        self.entries
            .iter()
            .map(|entry| FaultCount {
                name: entry.fault.kind.name(),
                joint: entry.fault.joint,
                count: entry.count,
            })
            .collect()
    }

    /// The byte as it leaves the wire; `None` = lost.
    pub(crate) fn on_wire(&mut self, mut delivery: Delivery) -> Option<Delivery> {
        for entry in &mut self.entries {
            if !entry.fault.open(delivery.at_ns) {
                continue;
            }
            let kind = entry.fault.kind;
            match kind {
                FaultKind::ByteLoss if entry.strikes() => return None,
                FaultKind::Corruption if entry.strikes() => {
                    delivery.byte ^= 1 << (entry.rng.next_u64() % 8);
                }
                _ => {}
            }
        }
        Some(delivery)
    }

    /// Whether driver `joint` misses the request that starts at `now_ns`.
    pub(crate) fn misses_request(&mut self, joint: usize, now_ns: u64) -> bool {
        self.any(joint, now_ns, |kind| kind == FaultKind::RequestLoss)
    }

    /// Whether the answer of driver `joint` is held back for good.
    pub(crate) fn loses_reply(&mut self, joint: usize, now_ns: u64) -> bool {
        self.any(joint, now_ns, |kind| kind == FaultKind::ReplyLoss)
    }

    /// Extra delay of the answer of driver `joint` [ns].
    pub(crate) fn reply_delay_ns(&mut self, joint: usize, now_ns: u64) -> u64 {
        let mut sum = 0;
        for entry in &mut self.entries {
            if let FaultKind::ReplyDelay { delay_s } = entry.fault.kind
                && entry.fault.covers(joint)
                && entry.fault.open(now_ns)
                && entry.strikes()
            {
                sum += (delay_s * 1e9) as u64;
            }
        }
        sum
    }

    fn any(&mut self, joint: usize, now_ns: u64, is: impl Fn(FaultKind) -> bool) -> bool {
        let mut hit = false;
        for entry in &mut self.entries {
            let due = is(entry.fault.kind) && entry.fault.covers(joint) && entry.fault.open(now_ns);
            hit |= due && entry.strikes();
        }
        hit
    }

    /// Share of the healthy supply voltage at `now_ns`.
    pub(crate) fn supply_ratio(&mut self, now_ns: u64) -> f64 {
        let mut ratio: f64 = 1.0;
        for entry in &mut self.entries {
            if let FaultKind::BrownOut { ratio: share } = entry.fault.kind {
                entry.enter(0, now_ns);
                if entry.inside.first() == Some(&true) {
                    ratio = ratio.min(share);
                }
            }
        }
        ratio
    }

    /// What joint `joint` has to suffer at `now_ns`. `silent` = its driver is not talking.
    pub(crate) fn orders(&mut self, joint: usize, now_ns: u64, silent: bool) -> JointOrders {
        let mut orders = JointOrders::default();
        for entry in &mut self.entries {
            if entry.fault.covers(joint) {
                entry.order(joint, now_ns, silent, &mut orders);
            }
        }
        orders
    }
}

impl Entry {
    fn strikes(&mut self) -> bool {
        let hit = self.fault.probability >= 1.0 || self.rng.chance(self.fault.probability);
        self.count += u64::from(hit);
        hit
    }

    /// Updates the window of a joint; true (and counted) at its start.
    fn enter(&mut self, joint: usize, now_ns: u64) -> bool {
        let open = self.fault.open(now_ns);
        let Some(inside) = self.inside.get_mut(joint) else {
            return false;
        };
        let entered = open && !*inside;
        *inside = open;
        self.count += u64::from(entered);
        entered
    }

    fn order(&mut self, joint: usize, now_ns: u64, silent: bool, orders: &mut JointOrders) {
        let kind = self.fault.kind;
        match kind {
            FaultKind::Babble => {
                if silent && self.fault.open(now_ns) && self.strikes() {
                    let burst = (0..BABBLE_BYTES)
                        .map(|_| self.rng.next_u64() as u8)
                        .collect();
                    orders.babble = Some(burst);
                }
                return;
            }
            FaultKind::Reset => {
                let started = self.enter(joint, now_ns);
                let again =
                    self.fault.probability < 1.0 && self.fault.open(now_ns) && self.strikes();
                orders.reset |= started || again;
                return;
            }
            FaultKind::Missing
            | FaultKind::StuckEncoder
            | FaultKind::EncoderJump { .. }
            | FaultKind::Stall
            | FaultKind::DuplicateId { .. } => {}
            _ => return,
        }
        let started = self.enter(joint, now_ns);
        let inside = self.inside.get(joint) == Some(&true);
        match kind {
            FaultKind::Missing => orders.missing |= inside,
            FaultKind::StuckEncoder => orders.stuck |= inside,
            FaultKind::Stall => orders.stall |= inside,
            FaultKind::DuplicateId { id } if inside => orders.alias = Some(id),
            FaultKind::EncoderJump { jump_rad } if started => orders.jump_rad += jump_rad,
            _ => {}
        }
    }
}
