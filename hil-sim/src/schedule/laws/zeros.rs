//! No motion before homing: encoders are relative, so a joint has a zero only by an order since its last restart and that of the module.

use super::{JOINTS, Law, Laws};
use crate::schedule::wire::Sent;

impl Laws {
    /// An order to take the present pose of some joints for their zero went in. It may have been refused: nobody but the module knows.
    pub(super) fn zero_ordered(&mut self, joint_mask: u16, at_us: u64) {
        self.zeros.push((joint_mask, at_us));
    }

    /// Whether the module cannot rule out that a joint has a zero when a packet leaves.
    fn has_zero(&self, joint: usize, packet: &Sent) -> bool {
        let lost_us = self.lost_us[joint].unwrap_or(0);
        let mut since = self
            .zeros
            .iter()
            .filter(|(_, at_us)| (lost_us..=packet.at_us).contains(at_us));
        since.any(|(joint_mask, _)| joint_mask >> joint & 1 != 0) || self.unheard(joint, packet)
    }

    /// Torque goes on for a run: it takes every joint.
    pub(super) fn torque_without_zero(&mut self, packet: &Sent) {
        if let Some(joint) = (0..JOINTS).find(|joint| !self.has_zero(*joint, packet)) {
            let what = format!("torque on, and joint {joint} has no zero");
            self.break_law(Law::Homed, packet.at_us, what);
        }
    }

    /// Set-points leave for some joints.
    pub(super) fn set_points_without_zero(&mut self, packet: &Sent, values: &[(usize, i32)]) {
        let mut joints = values.iter().map(|(joint, _)| *joint);
        let bare = joints.find(|joint| *joint < JOINTS && !self.has_zero(*joint, packet));
        if let Some(joint) = bare {
            let what = format!("a set-point for joint {joint}, which has no zero");
            self.break_law(Law::Homed, packet.at_us, what);
        }
    }
}
