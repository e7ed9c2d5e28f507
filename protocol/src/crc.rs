//! The checksums of both wires.

use crc::{CRC_16_UMTS, CRC_32_ISCSI, Crc, Table};

/// CRC-16 of the motor bus: polynomial 0x8005, initial value 0, not reflected (Dynamixel Protocol 2.0).
const BUS: Crc<u16, Table<1>> = Crc::<u16, Table<1>>::new(&CRC_16_UMTS);

/// CRC-32C (Castagnoli, 0x1EDC6F41) of the host link. Hamming distance 6 up to 655 bytes, more than the largest frame.
const LINK: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISCSI);

static BUS_CRC: Crc<u16, Table<1>> = BUS;
static LINK_CRC: Crc<u32, Table<1>> = LINK;

/// CRC-16 over one slice, as the last two bytes (little end first) of every bus packet carry it.
#[must_use]
pub fn crc16(bytes: &[u8]) -> u16 {
    BUS_CRC.checksum(bytes)
}

/// CRC-32C over one slice.
#[must_use]
pub fn crc32c(bytes: &[u8]) -> u32 {
    LINK_CRC.checksum(bytes)
}

/// CRC-32C fed piece by piece: the running fingerprint of set-points in [`crate::link::RunEnd`], stored records.
#[derive(Clone)]
pub struct Crc32c(crc::Digest<'static, u32, Table<1>>);

impl Crc32c {
    /// Start of a new checksum.
    #[must_use]
    pub fn new() -> Self {
        Self(LINK_CRC.digest())
    }

    /// Adds bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// The checksum of all bytes so far.
    #[must_use]
    pub fn value(&self) -> u32 {
        self.0.clone().finalize()
    }
}

impl Default for Crc32c {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn check_values_of_the_crc_catalogue() {
        assert_eq!(crc16(b"123456789"), 0xFEE8);
        assert_eq!(crc32c(b"123456789"), 0xE306_9283);
        let mut running = Crc32c::new();
        running.update(b"1234");
        running.update(b"56789");
        assert_eq!(running.value(), 0xE306_9283);
    }
}
