//! QEMU TCG plugin: lock-step with the emulated drivers, and the peripherals QEMU lacks. Developer tool, never shipped.
