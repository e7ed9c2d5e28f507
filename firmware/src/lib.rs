//! The module firmware: application tasks generic over traits, and the STM32L475VG binary.
