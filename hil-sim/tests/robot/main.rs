//! The firmware's own tasks, natively, on a virtual clock: behaviour of the whole module seen from its wires.

mod change;
mod common;
mod faults;
mod joints;
mod lease;
mod orders;
mod physics;
mod run;
mod security;
mod serve;
mod servos;
mod torque;
mod upload;
mod withheld;
