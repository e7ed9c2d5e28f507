//! A host link of a schedule: frames that get lost, damaged, late, doubled and swapped between a host and the
//! module's port.

use crate::rng::Rng;
use crate::robot::link::LinkLine;

/// What an order was about, for the laws that hold of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Order {
    /// Start a run.
    Start {
        /// Longest time from the order to the first movement of the gait plus the run, us.
        runs_us: u64,
        /// Tethered: the lease, us.
        lease_us: Option<u64>,
    },
    /// Heartbeat of a tethered run.
    Beat,
    /// STOP: taken in every session.
    Stop,
    /// Where these joints stand is their zero.
    Zero {
        /// One bit per joint.
        joint_mask: u16,
    },
}

/// A frame of a host.
#[derive(Debug, Clone)]
pub(crate) struct Frame {
    /// The bytes.
    pub(crate) bytes: Vec<u8>,
    /// The order in it, if the laws look at it, with its number.
    pub(crate) order: Option<(u64, Order)>,
    /// When the host made it, us.
    pub(crate) made_us: u64,
    /// Restarts of the module that the host knows of.
    pub(crate) epoch: u32,
}

/// An undamaged frame that goes into the module's receiver.
#[derive(Debug, Clone)]
pub(crate) struct Delivered {
    /// The frame.
    pub(crate) frame: Frame,
    /// When its last byte arrives, us.
    pub(crate) at_us: u64,
    /// Whether the receiver's ring has taken all of it.
    pub(crate) sure: bool,
}

/// What happens to frames, either way.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct LinkFaults {
    /// Share of frames lost.
    pub(crate) loss: f64,
    /// Share of bytes in which one bit flips.
    pub(crate) corruption: f64,
    /// Longest delay of a frame, us.
    pub(crate) delay_us: f64,
    /// Share of frames that are overtaken.
    pub(crate) reorder: f64,
    /// Share of frames that come twice.
    pub(crate) duplicate: f64,
    /// Noise towards the module.
    pub(crate) babble: bool,
}

/// A frame that is overtaken waits this long, us.
const OVERTAKEN_US: u64 = 40_000;
/// A copy comes at most this much later, us.
const COPY_US: f64 = 400_000.0;
/// From one burst of noise to the next, us.
const BURST_EVERY_US: u64 = 9_000;
/// Stream number of link faults.
const PURPOSE_LINK: u64 = 0x1F;

/// A frame on its way: when it goes on, its number, the frame, whether it is as it was made.
type OnTheWay = (u64, u64, Frame, bool);

/// One link with its faults.
#[derive(Debug)]
pub(crate) struct Channel {
    line: LinkLine,
    rng: Rng,
    faults: LinkFaults,
    to_module: Vec<OnTheWay>,
    to_host: Vec<OnTheWay>,
    /// Bytes of the module that end no frame yet.
    partial: Vec<u8>,
    count: u64,
    last_us: [u64; 2],
    burst_us: u64,
}

impl Channel {
    /// A good channel.
    pub(crate) fn new(line: LinkLine, seed: u64, index: u64) -> Self {
        Self {
            line,
            rng: Rng::new(seed, PURPOSE_LINK, index),
            faults: LinkFaults::default(),
            to_module: Vec::new(),
            to_host: Vec::new(),
            partial: Vec::new(),
            count: 0,
            last_us: [0; 2],
            burst_us: 0,
        }
    }

    /// The line behind it.
    pub(crate) fn line(&self) -> &LinkLine {
        &self.line
    }

    /// What happens from now on.
    pub(crate) fn set_faults(&mut self, faults: LinkFaults) {
        self.faults = faults;
    }

    /// A host sends a frame.
    pub(crate) fn send(&mut self, now_us: u64, frame: Frame) {
        let mut on_the_way = Vec::new();
        self.suffer(now_us, 0, frame, &mut on_the_way);
        self.to_module.extend(on_the_way);
    }

    fn suffer(&mut self, now_us: u64, way: usize, mut frame: Frame, into: &mut Vec<OnTheWay>) {
        let LinkFaults {
            loss,
            corruption,
            delay_us,
            reorder,
            duplicate,
            babble: _,
        } = self.faults;
        if self.rng.chance(loss) {
            return;
        }
        let mut whole = true;
        if corruption > 0.0 {
            for byte in &mut frame.bytes {
                if self.rng.chance(corruption) {
                    *byte ^= 1 << (self.rng.next_u64() % 8);
                    whole = false;
                }
            }
        }
        let late_us = if delay_us > 0.0 {
            (self.rng.uniform() * delay_us) as u64
        } else {
            0
        };
        let mut at_us = (now_us + late_us).max(self.last_us[way]);
        if self.rng.chance(reorder) {
            at_us += OVERTAKEN_US;
        } else {
            self.last_us[way] = at_us;
        }
        self.count += 1;
        if self.rng.chance(duplicate) {
            let copy_us = at_us + (self.rng.uniform() * COPY_US) as u64;
            into.push((copy_us, self.count, frame.clone(), whole));
            self.count += 1;
        }
        into.push((at_us, self.count, frame, whole));
    }

    /// Moves everything that is due. Appends what has arrived at the host, returns what goes to the module.
    pub(crate) fn step(&mut self, now_us: u64, to_host: &mut Vec<u8>) -> Vec<Delivered> {
        self.take_from_module(now_us);
        for (_, _, frame, _) in due(&mut self.to_host, now_us) {
            to_host.extend(frame.bytes);
        }
        if self.faults.babble && now_us >= self.burst_us {
            self.burst_us = now_us + BURST_EVERY_US;
            let noise: Vec<u8> = (0..16).map(|_| self.rng.next_u64() as u8).collect();
            self.line.write(&noise);
        }
        let mut delivered = Vec::new();
        for (_, _, frame, whole) in due(&mut self.to_module, now_us) {
            let lost = self.line.lost_bytes();
            let at_us = self.line.write(&frame.bytes).div_ceil(1_000).max(now_us);
            let sure = self.line.lost_bytes() == lost;
            if whole && self.line.is_connected() {
                delivered.push(Delivered { frame, at_us, sure });
            }
        }
        delivered
    }

    fn take_from_module(&mut self, now_us: u64) {
        self.line.read(&mut self.partial);
        while let Some(end) = self.partial.iter().position(|byte| *byte == 0) {
            let bytes: Vec<u8> = self.partial.drain(..=end).collect();
            let frame = Frame {
                bytes,
                order: None,
                made_us: now_us,
                epoch: 0,
            };
            let mut on_the_way = Vec::new();
            self.suffer(now_us, 1, frame, &mut on_the_way);
            self.to_host.extend(on_the_way);
        }
    }

    /// When something is due next, us.
    pub(crate) fn next_us(&self) -> Option<u64> {
        let waiting = self.to_module.iter().chain(&self.to_host);
        let burst = self.faults.babble.then_some(self.burst_us);
        waiting.map(|(at_us, ..)| *at_us).chain(burst).min()
    }

    /// The link was cut: nothing that was on its way arrives.
    pub(crate) fn cut(&mut self) {
        self.to_module.clear();
        self.to_host.clear();
        self.partial.clear();
        self.line.cut();
    }
}

/// Takes out what is due, in order.
fn due(list: &mut Vec<OnTheWay>, now_us: u64) -> Vec<OnTheWay> {
    if list.is_empty() {
        return Vec::new();
    }
    list.sort_by_key(|(at_us, number, ..)| (*at_us, *number));
    let count = list.partition_point(|(at_us, ..)| *at_us <= now_us);
    list.drain(..count).collect()
}
