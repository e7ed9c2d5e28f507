//! Bringing a driver into use: is it of the profile, and does it hold the settings that the profile wants?
//!
//! ```text
//! model ─▶ setting 0 ─▶ ... ─▶ setting n ─▶ ready
//!   │        read; where it differs write, and read again, at most three times
//!   └▶ wrong                                  └▶ wrong
//! ```
//!
//! Everything is compared before it is written, because some of it lies in the drivers' EEPROM.

use protocol::bus::{ProfileInfo, Request};

/// Times that one setting is written before the driver counts as wrong.
const WRITES: u8 = 3;

/// How far a driver is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Setup {
    /// Its model number is to be read.
    Model,
    /// A setting is to be read, or written first.
    Setting {
        /// Index in the profile's settings.
        index: u8,
        /// What was read differed.
        write: bool,
        /// Writes of this setting so far.
        writes: u8,
    },
    /// It is driven.
    Ready,
    /// It is of another profile: its model is asked again now and then.
    WrongModel {
        /// Model number; 0: it answered none.
        model: u16,
    },
    /// It does not take a setting: asked no more, or its EEPROM would wear.
    WrongSetting {
        /// Address.
        address: u16,
    },
}

impl Setup {
    /// Where a driver of a profile begins. Ours need no settings and are known by their block.
    #[must_use]
    pub fn begin(info: &ProfileInfo) -> Self {
        if info.settings.is_empty() {
            Self::Ready
        } else {
            Self::Model
        }
    }

    /// Whether it waits for packets.
    #[must_use]
    pub fn is_due(&self) -> bool {
        !matches!(self, Self::Ready | Self::WrongSetting { .. })
    }

    /// Whether the next packet writes.
    #[must_use]
    pub fn writes(&self) -> bool {
        matches!(self, Self::Setting { write: true, .. })
    }

    /// The next packet.
    #[must_use]
    pub fn request(&self, info: &ProfileInfo, id: u8) -> Option<Request> {
        match *self {
            Self::Model | Self::WrongModel { .. } => info.read_field(id, &info.model).ok(),
            Self::Setting { index, write, .. } => {
                let setting = info.settings.get(usize::from(index))?;
                if write {
                    info.write(id, setting.address, setting.bytes).ok()
                } else {
                    let len = u16::try_from(setting.bytes.len()).ok()?;
                    info.read(id, setting.address, len).ok()
                }
            }
            Self::Ready | Self::WrongSetting { .. } => None,
        }
    }

    /// A packet went out. After a write the setting is read again, whether the write was answered or not.
    #[must_use]
    pub fn sent(self) -> Self {
        match self {
            Self::Setting {
                index,
                write: true,
                writes,
            } => Self::Setting {
                index,
                write: false,
                writes: writes.saturating_add(1),
            },
            other => other,
        }
    }

    /// The data of an answer; `None`: the driver answered with an error.
    #[must_use]
    pub fn answered(self, info: &ProfileInfo, data: Option<&[u8]>) -> Self {
        match self {
            Self::Model | Self::WrongModel { .. } => {
                let model = data.map_or(0, |data| info.model.value_of(data) as u16);
                if info.models.contains(&model) {
                    Self::at(info, 0)
                } else {
                    Self::WrongModel { model }
                }
            }
            Self::Setting {
                index,
                write: false,
                writes,
            } => {
                let Some(setting) = info.settings.get(usize::from(index)) else {
                    return Self::Ready;
                };
                if data == Some(setting.bytes) {
                    Self::at(info, index.saturating_add(1))
                } else if writes >= WRITES || data.is_none() {
                    Self::WrongSetting {
                        address: setting.address,
                    }
                } else {
                    Self::Setting {
                        index,
                        write: true,
                        writes,
                    }
                }
            }
            other => other,
        }
    }

    fn at(info: &ProfileInfo, index: u8) -> Self {
        if usize::from(index) < info.settings.len() {
            Self::Setting {
                index,
                write: false,
                writes: 0,
            }
        } else {
            Self::Ready
        }
    }
}
