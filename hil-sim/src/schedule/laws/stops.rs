//! A STOP that arrived whole takes effect, whether or not anybody was told so.
//!
//! From its last byte on, no torque goes on. Set-points of the cycle under way may leave, then those of the ramp.
//! A cycle in which none leaves lets the ramp wait, so moves are counted and not time.

use super::{Law, Laws};

/// Moves of a ramp. A cycle leaves 0.7 of an amplitude at a rate of 6 1/s, and 16 of them bring 0.25 rad below 1 mrad.
pub(super) const RAMP_MOVES: u32 = 16;
/// A cycle that has decided when STOP comes sends its set-points.
const UNDER_WAY_MOVES: u32 = 1;

/// What is known of STOPs that go in, whatever the answer.
#[derive(Debug, Default)]
pub(super) struct Stops {
    /// Whole frames that nothing has struck on their way: link, and when the last byte arrives, us.
    coming: Vec<(usize, u64)>,
    /// Since when no order holds, us, and the moves since.
    obeyed: Option<(u64, u32)>,
}

impl Laws {
    /// A whole STOP is on a link that is up, and its last byte arrives at `at_us`.
    pub(super) fn stop_comes(&mut self, link: usize, at_us: u64) {
        self.stops.coming.push((link, at_us));
    }

    /// Something strikes a link: frames that are half received are not certain to be heard.
    pub(crate) fn link_struck(&mut self, link: usize, now_us: u64) {
        let coming = &mut self.stops.coming;
        coming.retain(|(of, at_us)| *of != link || *at_us <= now_us);
    }

    /// The module restarted: its run is over.
    pub(super) fn forget_stops(&mut self) {
        self.stops = Stops::default();
    }

    /// STOPs that have arrived by now take effect on what was ordered before.
    pub(super) fn obey_stops(&mut self, now_us: u64) {
        let coming = std::mem::take(&mut self.stops.coming);
        let (mut arrived, coming): (Vec<_>, Vec<_>) =
            coming.into_iter().partition(|(_, at_us)| *at_us <= now_us);
        self.stops.coming = coming;
        arrived.sort_by_key(|(_, at_us)| *at_us);
        for (_, at_us) in arrived {
            self.counts.stops += 1;
            self.renew(at_us);
            self.void_before(at_us, at_us);
            // A second one gives a ramp no more time.
            self.stops.obeyed.get_or_insert((at_us, 0));
        }
        self.renew(now_us);
    }

    /// A start order that came after a STOP ends what the STOP forbids.
    fn renew(&mut self, now_us: u64) {
        let since = |stopped_us: u64| {
            let mut times = self.grants.iter().map(|grant| grant.newest_us);
            times.any(|at_us| at_us >= stopped_us && at_us <= now_us)
        };
        self.stops.obeyed = self.stops.obeyed.filter(|(at_us, _)| !since(*at_us));
    }

    /// Torque goes on at `at_us`.
    pub(super) fn torque_after_stop(&mut self, at_us: u64) {
        if let Some((stopped_us, _)) = self.stops.obeyed
            && at_us > stopped_us
        {
            let what = format!("torque on after a STOP that came at {stopped_us} us");
            self.break_law(Law::Stops, at_us, what);
        }
    }

    /// Set-points that differ from the ones before leave at `at_us`.
    pub(super) fn move_after_stop(&mut self, at_us: u64) {
        let Some((stopped_us, moves)) = &mut self.stops.obeyed else {
            return;
        };
        *moves += 1;
        if *moves > UNDER_WAY_MOVES + RAMP_MOVES {
            let what = format!("move {moves} after a STOP that came at {stopped_us} us");
            self.break_law(Law::Stops, at_us, what);
        }
    }
}
