//! The law every part links: gait, CPG, kinematics, collision pre-check, supervisor. no_std, no I/O, no clock.
#![no_std]
