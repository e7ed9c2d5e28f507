//! Indirect addresses of X servos: a block of data whose bytes stand for bytes elsewhere in the table.

use super::profile::Profile;

/// Indirect addresses of the X330 servos: 168..=206, data 208..=227 (e-manual XL330-M288, RAM area).
pub const X330_INDIRECT: Indirect = Indirect::new(168, 208, 20);
/// First block of indirect addresses of XM430: 168..=222, data 224..=251 (e-manual XM430-W350, RAM area).
pub const XM430_INDIRECT: Indirect = Indirect::new(168, 224, 28);

/// Most indirect addresses of one block.
const MAX_INDIRECT: usize = 28;

/// Indirect addresses of an X servo: which byte of the table each byte of the indirect data stands for (e-manual, "Indirect Address, Indirect
/// Data").
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Indirect {
    start: u16,
    data: u16,
    count: u16,
    /// 0: the place stands for itself.
    targets: [u16; MAX_INDIRECT],
}

impl Indirect {
    /// Every byte stands for itself, as after a start.
    const fn new(start: u16, data: u16, count: u16) -> Self {
        Self {
            start,
            data,
            count,
            targets: [0; MAX_INDIRECT],
        }
    }

    /// As after a start, for a profile that has them.
    #[must_use]
    pub const fn of(profile: Profile) -> Option<Self> {
        match profile {
            Profile::Xl330 | Profile::Xc330 => Some(X330_INDIRECT),
            Profile::Xm430 => Some(XM430_INDIRECT),
            Profile::Packed | Profile::Sts | Profile::Scs => None,
        }
    }

    /// Address of the first indirect address.
    #[must_use]
    pub const fn start(&self) -> u16 {
        self.start
    }

    /// Address of the first byte of the data.
    #[must_use]
    pub const fn data(&self) -> u16 {
        self.data
    }

    /// First address behind the data.
    #[must_use]
    pub const fn end(&self) -> u16 {
        self.data.saturating_add(self.count)
    }

    fn index(&self, offset: u16) -> Option<usize> {
        (offset < self.count).then_some(usize::from(offset))
    }

    /// What the byte of the data at this address stands for. `None` outside of the data.
    #[must_use]
    pub fn target_of(&self, address: u16) -> Option<u16> {
        self.target(address.checked_sub(self.data)?)
    }

    fn target(&self, offset: u16) -> Option<u16> {
        match *self.targets.get(self.index(offset)?)? {
            0 => Some(self.data.saturating_add(offset)),
            target => Some(target),
        }
    }

    /// A byte of the addresses themselves; 0 outside.
    #[must_use]
    pub fn address_byte(&self, address: u16) -> u8 {
        let Some(offset) = address.checked_sub(self.start) else {
            return 0;
        };
        let target = self.target(offset / 2).unwrap_or(0);
        let [low, high] = target.to_le_bytes();
        if offset.is_multiple_of(2) { low } else { high }
    }

    /// Sets the indirect address that stands at `address`. False when there is none, or the target lies outside of the RAM area.
    #[must_use]
    pub fn set(&mut self, address: u16, target: u16) -> bool {
        // Range of the register: 64 to the last byte of the data (e-manual).
        let allowed = (64..self.end()).contains(&target);
        let index = address
            .checked_sub(self.start)
            .and_then(|offset| self.index(offset / 2));
        match index.and_then(|index| self.targets.get_mut(index)) {
            Some(place) if allowed => {
                *place = target;
                true
            }
            _ => false,
        }
    }
}
