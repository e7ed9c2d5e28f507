//! From a set-point received to a set-point applied: the effects of the transport stage.

use std::collections::VecDeque;

use crate::rng::Rng;

/// Transport effects; all neutral at 0, clock skew at 1.
#[derive(Clone, Debug, PartialEq)]
pub struct TransportParams {
    /// `latency` [s].
    pub latency_s: f64,
    /// `jitter`: standard deviation of an extra delay, never earlier than the latency [s].
    pub jitter_s: f64,
    /// `packet_loss`: probability that a set-point is not applied.
    pub loss_probability: f64,
    /// `quantisation`: step of the applied set-point [rad].
    pub quantisation_rad: f64,
    /// `clock_skew`: driver's clock rate over true rate.
    pub clock_ratio: f64,
}

impl Default for TransportParams {
    fn default() -> Self {
        Self {
            latency_s: 0.0,
            jitter_s: 0.0,
            loss_probability: 0.0,
            quantisation_rad: 0.0,
            clock_ratio: 1.0,
        }
    }
}

/// Set-points on their way.
#[derive(Clone, Debug)]
pub struct Transport {
    queue: VecDeque<(u64, f64)>,
    rng: Rng,
    lost: u64,
}

/// Stream number of transport noise.
const PURPOSE_TRANSPORT: u64 = 0x72;
/// Most set-points on their way at once; beyond it the oldest is applied at once.
const QUEUE_LIMIT: usize = 1024;

impl Transport {
    /// Nothing on the way.
    #[must_use]
    pub fn new(seed: u64, joint: usize) -> Self {
        Self {
            queue: VecDeque::new(),
            rng: Rng::new(seed, PURPOSE_TRANSPORT, joint as u64),
            lost: 0,
        }
    }

    /// Set-points lost so far.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// A set-point arrived on the wire at `now_ns`.
    pub fn submit(&mut self, params: &TransportParams, now_ns: u64, setpoint_rad: f64) {
        if self.rng.chance(params.loss_probability) {
            self.lost += 1;
            return;
        }
        let mut delay_s = params.latency_s;
        if params.jitter_s > 0.0 {
            delay_s += params.jitter_s * self.rng.normal().abs();
        }
        let step = params.quantisation_rad;
        let value = if step > 0.0 {
            libm::round(setpoint_rad / step) * step
        } else {
            setpoint_rad
        };
        let earliest = self.queue.back().map_or(0, |&(at_ns, _)| at_ns);
        let at_ns = (now_ns + (delay_s * 1e9) as u64).max(earliest);
        if self.queue.len() == QUEUE_LIMIT {
            self.queue.pop_front();
        }
        self.queue.push_back((at_ns, value));
    }

    /// The newest set-point due by `now_ns`, if a new one is due.
    pub fn due(&mut self, now_ns: u64) -> Option<f64> {
        let mut newest = None;
        while let Some(&(at_ns, value)) = self.queue.front() {
            if at_ns > now_ns {
                break;
            }
            newest = Some(value);
            self.queue.pop_front();
        }
        newest
    }

    /// Forgets what is on the way (torque off, reboot).
    pub fn clear(&mut self) {
        self.queue.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neutral_applies_at_once_and_exactly() {
        let mut transport = Transport::new(1, 0);
        transport.submit(&TransportParams::default(), 1_000, 0.123_456_789);
        assert_eq!(transport.due(1_000), Some(0.123_456_789));
        assert_eq!(transport.due(2_000), None);
    }

    #[test]
    fn latency_delays_and_quantisation_rounds() {
        let params = TransportParams {
            latency_s: 0.010,
            quantisation_rad: 0.25,
            ..TransportParams::default()
        };
        let mut transport = Transport::new(1, 0);
        transport.submit(&params, 0, 0.40);
        assert_eq!(transport.due(9_999_999), None);
        assert_eq!(transport.due(10_000_000), Some(0.5));
    }

    #[test]
    fn loss_rate_and_order_under_jitter() {
        let params = TransportParams {
            jitter_s: 0.050,
            loss_probability: 0.3,
            ..TransportParams::default()
        };
        let mut transport = Transport::new(3, 0);
        let mut last = -1.0;
        for k in 0..10_000_u64 {
            transport.submit(&params, k * 1_000_000, k as f64);
            if let Some(value) = transport.due(k * 1_000_000) {
                assert!(value > last, "{value} after {last}");
                last = value;
            }
        }
        // Binomial: 3000 +- 46 (1 sigma).
        assert!(
            (2_800..3_200).contains(&transport.lost()),
            "{}",
            transport.lost()
        );
    }
}
