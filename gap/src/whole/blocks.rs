//! The robot's chain as blocks of prediction errors: each cut at what was measured, each effect a column.

pub(super) mod body;
pub(super) mod position;
pub(super) mod torque;
