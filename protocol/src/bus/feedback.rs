//! The packed feedback block: everything the module wants from a driver, in 19 bytes.
//!
//! The 145 bits of the fields are laid one after the other, lowest bit first, over the bytes, but every byte whose index is a multiple of three carries seven
//! bits and has its top bit clear. So no three bytes in a row, not even across the block's ends, are FF FF FD: nothing is ever stuffed, and Fast Sync Read,
//! which foreign masters do not unstuff, carries the block as it is.

use serde::{Deserialize, Serialize};

/// Bytes of the block.
pub const PACKED_LEN: usize = 19;

/// What a driver measured at the end of the instruction packet that asked for it. Units: [`crate::units`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PackedFeedback {
    /// Driver's clock at the measurement, 4 us per count, wraps every 262 ms. 16 bits.
    pub tick_4us: u16,
    /// Set-point that the driver applies, urad. 28 bits.
    pub applied_urad: i32,
    /// Motor-side encoder divided by the gear ratio, urad. 28 bits.
    pub position_urad: i32,
    /// 0.5 mrad/s. 16 bits.
    pub velocity: i16,
    /// mA; positive drives towards positive angles. 14 bits.
    pub current_ma: i16,
    /// 1/2000 of bus voltage; positive drives towards positive angles. 12 bits.
    pub duty: i16,
    /// 5 mV. 12 bits.
    pub voltage_5mv: u16,
    /// deg C, -40..=215. 8 bits.
    pub temperature_c: i16,
    /// [`status`]. 8 bits.
    pub status: u8,
    /// Boots of the driver, modulo 8: another number means that it restarted and lost its zero. 3 bits.
    pub boots: u8,
}

/// Bits of [`PackedFeedback::status`].
pub mod status {
    /// Torque is on.
    pub const TORQUE: u8 = 1 << 0;
    /// The zero is known (set since the last restart).
    pub const HOMED: u8 = 1 << 1;
    /// Current or voltage limit is active.
    pub const LIMITED: u8 = 1 << 2;
    /// A set-point was refused as implausible since the last read.
    pub const REFUSED: u8 = 1 << 3;
    /// Hardware error, register 70 is not zero.
    pub const HARDWARE_ERROR: u8 = 1 << 4;
    /// The bus watchdog has tripped.
    pub const WATCHDOG: u8 = 1 << 5;
    /// Speed is above the moving threshold.
    pub const MOVING: u8 = 1 << 6;
    /// The driver has restarted since its settings were written. Only of off-the-shelf servos, which count no boots.
    pub const RESTARTED: u8 = 1 << 7;
}

/// Width of each field, in block order. They sum to the 145 bits that 19 bytes with 7 clear bits hold.
const WIDTHS: [u32; 10] = [16, 28, 28, 16, 14, 12, 12, 8, 8, 3];
/// Offset of the temperature code.
const TEMPERATURE_ZERO: i16 = 40;

const fn sum(widths: &[u32]) -> u32 {
    match widths {
        [] => 0,
        [first, rest @ ..] => *first + sum(rest),
    }
}

const _: () = assert!(sum(&WIDTHS) as usize == PACKED_LEN * 8 - PACKED_LEN.div_ceil(3));

impl PackedFeedback {
    /// All zero.
    pub const ZERO: Self = Self {
        tick_4us: 0,
        applied_urad: 0,
        position_urad: 0,
        velocity: 0,
        current_ma: 0,
        duty: 0,
        voltage_5mv: 0,
        temperature_c: 0,
        status: 0,
        boots: 0,
    };

    /// The block as it goes on the wire. Values beyond a field's width saturate.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; PACKED_LEN] {
        let fields = [
            u32::from(self.tick_4us),
            signed(self.applied_urad, 28),
            signed(self.position_urad, 28),
            signed(i32::from(self.velocity), 16),
            signed(i32::from(self.current_ma), 14),
            signed(i32::from(self.duty), 12),
            u32::from(self.voltage_5mv.min(0xFFF)),
            self.temperature_c
                .saturating_add(TEMPERATURE_ZERO)
                .clamp(0, 255) as u32,
            u32::from(self.status),
            u32::from(self.boots & 7),
        ];
        let mut source = fields
            .iter()
            .zip(WIDTHS)
            .flat_map(|(field, width)| (0..width).map(move |bit| field >> bit & 1));
        let mut bytes = [0; PACKED_LEN];
        for (index, byte) in bytes.iter_mut().enumerate() {
            for bit in 0..capacity(index) {
                *byte |= (source.next().unwrap_or(0) as u8) << bit;
            }
        }
        bytes
    }

    /// Reads a block. `None` when a bit that must be clear is set: this was no block of ours.
    #[must_use]
    pub fn from_bytes(bytes: &[u8; PACKED_LEN]) -> Option<Self> {
        if bytes.iter().step_by(3).any(|byte| byte & 0x80 != 0) {
            return None;
        }
        // Three bytes carry 23 bits. The last group is one byte.
        let mut groups = [0; PACKED_LEN.div_ceil(3)];
        for (group, part) in groups.iter_mut().zip(bytes.chunks(3)) {
            *group = match *part {
                [a, b, c] => u32::from(a) | u32::from(b) << 7 | u32::from(c) << 15,
                [a, ..] => u32::from(a),
                [] => 0,
            };
        }
        let [
            tick,
            applied,
            position,
            velocity,
            current,
            duty,
            voltage,
            temperature,
            status,
            boots,
        ] = unpack(&groups);
        Some(Self {
            tick_4us: tick as u16,
            applied_urad: extend(applied, 28),
            position_urad: extend(position, 28),
            velocity: extend(velocity, 16) as i16,
            current_ma: extend(current, 14) as i16,
            duty: extend(duty, 12) as i16,
            voltage_5mv: voltage as u16,
            temperature_c: temperature as i16 - TEMPERATURE_ZERO,
            status: status as u8,
            boots: boots as u8,
        })
    }
}

/// Bits that three bytes carry.
const GROUP: u32 = 23;

/// The fields of [`WIDTHS`] out of groups of [`GROUP`] bits.
fn unpack(groups: &[u32; PACKED_LEN.div_ceil(3)]) -> [u32; WIDTHS.len()] {
    let mut at = 0;
    WIDTHS.map(|width| {
        let field = bits_at(groups, at, width);
        at += width;
        field
    })
}

/// `width` bits from bit `at` on: at most 28, which may reach over three groups.
#[inline(always)]
fn bits_at(groups: &[u32; PACKED_LEN.div_ceil(3)], at: u32, width: u32) -> u32 {
    let group = |index: u32| groups.get(index as usize).copied().unwrap_or(0);
    let (first, bit) = (at / GROUP, at % GROUP);
    let mut value = group(first) >> bit | group(first + 1) << (GROUP - bit);
    if 2 * GROUP - bit < width {
        value |= group(first + 2) << (2 * GROUP - bit);
    }
    value & ((1 << width) - 1)
}

/// Bits that the byte at this index carries.
const fn capacity(index: usize) -> u32 {
    if index.is_multiple_of(3) { 7 } else { 8 }
}

/// Saturates to `width` bits, two's complement.
fn signed(value: i32, width: u32) -> u32 {
    let max = (1 << (width - 1)) - 1;
    (value.clamp(-max - 1, max) as u32) & ((1 << width) - 1)
}

/// Sign-extends from `width` bits.
fn extend(code: u32, width: u32) -> i32 {
    let unused = 32 - width;
    ((code << unused) as i32) >> unused
}
