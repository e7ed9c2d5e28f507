//! Orders that went into the module, and what a STOP leaves of them.

use super::{Laws, REST_US};
use crate::schedule::channel::{Delivered, Order};

/// Life of a challenge, us.
const CHALLENGE_US: u64 = 5_000_000;

/// A start order that reached the module.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grant {
    number: u64,
    pub(super) at_us: u64,
    /// When its newest copy went in, us.
    pub(super) newest_us: u64,
    runs_us: u64,
    lease_us: Option<u64>,
    beat_us: u64,
}

impl Grant {
    /// Until when torque may be on by this order, us.
    pub(super) fn until_us(&self) -> u64 {
        let run_us = self.at_us + self.runs_us;
        let leased_us = self.lease_us.map(|lease_us| self.beat_us + lease_us);
        leased_us.map_or(run_us, |at| at.min(run_us)) + REST_US
    }
}

impl Laws {
    /// An undamaged frame goes into the module. `epoch`: its restarts so far.
    pub(crate) fn delivered(&mut self, link: usize, delivered: &Delivered, epoch: u32) {
        let Delivered { frame, at_us, sure } = delivered;
        let Some((number, order)) = frame.order else {
            return;
        };
        if order == Order::Stop {
            // In any session.
            self.stops_in.push((number, *at_us));
            if *sure {
                self.stop_comes(link, *at_us);
            }
            return;
        }
        let late = at_us.saturating_sub(frame.made_us) > CHALLENGE_US;
        let void = frame.made_us < self.stopped_us || late;
        if frame.epoch != epoch || self.keyed && void {
            return;
        }
        match order {
            Order::Start { runs_us, lease_us } => {
                let grant = Grant {
                    number,
                    at_us: *at_us,
                    newest_us: *at_us,
                    runs_us,
                    lease_us,
                    beat_us: *at_us,
                };
                let known = self.grants.iter_mut().find(|known| known.number == number);
                match known {
                    // A STOP voids the copies too.
                    Some(_) if self.keyed => {}
                    // Without a key nothing voids the copy of an order whose first one the receiver has lost.
                    Some(known) if known.newest_us < self.stopped_us => *known = grant,
                    Some(known) => known.newest_us = *at_us,
                    None => {
                        self.orders += 1;
                        self.grants.push(grant);
                    }
                }
            }
            Order::Stop => {}
            Order::Zero { joint_mask } => self.zero_ordered(joint_mask, *at_us),
            Order::Beat => {
                for grant in &mut self.grants {
                    grant.beat_us = grant.beat_us.max(*at_us);
                }
            }
        }
    }

    /// A host was told that its STOP of this number was heard. One of the copies that went in until now was it: nobody but the module knows
    /// which. Every order of before the first is void; one that came between a STOP and its acknowledgement is a new one.
    pub(super) fn stopped(&mut self, number: u64, now_us: u64) {
        let copies = self
            .stops_in
            .iter()
            .filter(|(of, at_us)| *of == number && *at_us <= now_us);
        let times = copies.map(|(_, at_us)| *at_us);
        let (Some(first_us), Some(last_us)) = (times.clone().min(), times.max()) else {
            // It was of an earlier boot, whose orders are void anyway.
            return;
        };
        self.void_before(first_us, last_us);
    }

    /// What was ordered before `first_us` was stopped at `last_us` at the latest: it ramps down and holds; afterwards it counts no more.
    pub(super) fn void_before(&mut self, first_us: u64, last_us: u64) {
        self.stopped_us = self.stopped_us.max(first_us);
        let grants = self.grants.iter_mut();
        for grant in grants.filter(|grant| grant.newest_us < first_us) {
            let left_us = last_us - grant.at_us;
            grant.runs_us = grant.runs_us.min(left_us);
        }
    }
}
