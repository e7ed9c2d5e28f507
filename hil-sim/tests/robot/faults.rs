//! Faults of drivers, bus, battery and link while the robot runs.
