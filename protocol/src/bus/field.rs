//! A number in a table of registers: where it stands, its bytes, its sign.

/// Order of the bytes of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Low byte first.
    Little,
    /// High byte first.
    Big,
}

/// How a register holds its sign.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sign {
    /// Never negative.
    None,
    /// Two's complement.
    Twos,
    /// Magnitude below this bit, sign in it.
    Magnitude(u8),
}

/// A number in a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// First address.
    pub address: u16,
    /// Bytes, 1 to 4.
    pub len: u8,
    /// Order of its bytes.
    pub order: Order,
    /// Its sign.
    pub sign: Sign,
}

impl Field {
    pub(super) const fn new(address: u16, len: u8, order: Order, sign: Sign) -> Self {
        Self {
            address,
            len,
            order,
            sign,
        }
    }

    /// The value of its first [`Field::len`] bytes. Missing bytes count as 0.
    #[must_use]
    pub fn value_of(&self, bytes: &[u8]) -> i32 {
        let mut word = [0; 4];
        let len = usize::from(self.len).min(4);
        for (k, place) in word.iter_mut().enumerate().take(len) {
            let from = match self.order {
                Order::Little => k,
                Order::Big => len.saturating_sub(k).saturating_sub(1),
            };
            *place = bytes.get(from).copied().unwrap_or(0);
        }
        let raw = u32::from_le_bytes(word);
        match self.sign {
            Sign::None => raw as i32,
            Sign::Twos => {
                let unused = 32_u32.saturating_sub(u32::from(self.len) * 8) & 31;
                ((raw << unused) as i32) >> unused
            }
            Sign::Magnitude(bit) => {
                let mask = 1_u32 << (bit & 31);
                let magnitude = (raw & mask.wrapping_sub(1)) as i32;
                if raw & mask != 0 {
                    magnitude.wrapping_neg()
                } else {
                    magnitude
                }
            }
        }
    }

    /// The bytes of a value, of which the first [`Field::len`] count.
    #[must_use]
    pub fn bytes_of(&self, value: i32) -> [u8; 4] {
        let raw = match self.sign {
            Sign::None | Sign::Twos => value as u32,
            Sign::Magnitude(bit) => {
                let mask = 1_u32 << (bit & 31);
                let magnitude = value.unsigned_abs() & mask.wrapping_sub(1);
                if value < 0 {
                    magnitude | mask
                } else {
                    magnitude
                }
            }
        };
        let little = raw.to_le_bytes();
        let len = usize::from(self.len).min(4);
        let mut bytes = [0; 4];
        for (k, place) in bytes.iter_mut().enumerate().take(len) {
            let from = match self.order {
                Order::Little => k,
                Order::Big => len.saturating_sub(k).saturating_sub(1),
            };
            *place = little.get(from).copied().unwrap_or(0);
        }
        bytes
    }
}
