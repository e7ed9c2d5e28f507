//! What the bus master's packets are made of: addresses, lists of drivers, values.

use super::types::Values;
use control::machine::MAX_JOINTS;
use protocol::bus::{Field, ProfileInfo, Request};

/// Bus address of joint 0; joint k has this plus k.
pub const FIRST_ID: u8 = 1;

/// Bus address of a joint.
pub(super) fn id_of(joint: usize) -> u8 {
    // Joints are 0..12.
    FIRST_ID.saturating_add(joint as u8)
}

/// Takes the first joint off a list.
pub(super) fn take_first(mask: &mut u16) -> Option<usize> {
    let joint = (0..MAX_JOINTS).find(|joint| *mask >> joint & 1 != 0)?;
    *mask &= !(1 << joint);
    Some(joint)
}

/// Torque on or off for these joints.
pub(super) fn torque(info: &ProfileInfo, joints: u16, on: i32) -> Option<Request> {
    if joints == 0 {
        return None;
    }
    let values = ids_of(joints).map(|id| (id, on));
    sync_write(info, &info.torque, &collect(values))
}

pub(super) fn ids_of(mask: u16) -> impl Iterator<Item = u8> {
    (0..MAX_JOINTS)
        .filter(move |joint| mask >> joint & 1 != 0)
        .map(id_of)
}

pub(crate) fn collect(values: impl Iterator<Item = (u8, i32)>) -> Values {
    let mut list = Values::new();
    for value in values {
        // At most one per joint.
        let _ = list.push(value);
    }
    list
}

pub(super) fn sync_write(info: &ProfileInfo, field: &Field, values: &Values) -> Option<Request> {
    if values.is_empty() {
        None
    } else {
        info.sync_write(field, values).ok()
    }
}

pub(super) fn set_points(info: &ProfileInfo, goals: &Values) -> Option<Request> {
    if goals.is_empty() {
        None
    } else {
        info.set_points(goals).ok()
    }
}
