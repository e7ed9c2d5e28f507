//! The little of an ELF32 file that the runner and the table need: symbols, section sizes, call sites.

use thiserror::Error;

/// Why a file is not a usable image.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
pub enum ElfError {
    /// Wrong magic, class or byte order.
    #[error("not a little-endian ELF32 file")]
    NotElf32,
    /// A table points outside the file.
    #[error("ELF file is cut short at byte {offset}")]
    Truncated {
        /// Where reading failed.
        offset: usize,
    },
    /// No symbol's name holds this text: it was renamed, or inlined away.
    #[error("no function in the image whose name contains \"{part}\"")]
    NoSymbol {
        /// The text looked for.
        part: &'static str,
    },
    /// More than one function fits.
    #[error("several functions in the image contain \"{part}\"")]
    Ambiguous {
        /// The text looked for.
        part: &'static str,
    },
    /// Nothing calls the function by a direct branch.
    #[error("no direct call of \"{part}\" in the image")]
    NoCaller {
        /// The text looked for.
        part: &'static str,
    },
}

/// One symbol.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Symbol {
    /// Mangled name.
    pub name: String,
    /// Value; of a Thumb function without the mode bit.
    pub address: u32,
    /// Bytes.
    pub size: u32,
    /// True for functions.
    pub function: bool,
}

/// One section that takes memory on the chip.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Section {
    /// Name, for example `.text`.
    pub name: String,
    /// Run-time address.
    pub address: u32,
    /// Bytes.
    pub size: u32,
    /// Offset in the file; no meaning for sections without content.
    pub offset: u32,
    /// True if its content lies in the file (and in flash).
    pub stored: bool,
    /// True if it may be written, so it takes RAM.
    pub writable: bool,
    /// True if it holds instructions.
    pub code: bool,
}

/// A parsed image.
#[derive(Clone, Debug)]
pub struct Elf<'a> {
    bytes: &'a [u8],
    /// Sections that are loaded or reserved on the chip.
    pub sections: Vec<Section>,
    /// All symbols.
    pub symbols: Vec<Symbol>,
}

/// A counted region: from the first instruction of a function to the return to any of its callers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Region {
    /// Name in the table.
    pub label: String,
    /// First instruction.
    pub begin: u32,
    /// Instructions that end it.
    pub ends: Vec<u32>,
}

const SECTION_HEADER_BYTES: usize = 40;
const SYMBOL_BYTES: usize = 16;
const TYPE_SYMBOLS: u32 = 2;
const TYPE_NO_BITS: u32 = 8;
const FLAG_WRITE: u32 = 1;
const FLAG_ALLOC: u32 = 2;
const FLAG_CODE: u32 = 4;
const SYMBOL_FUNCTION: u8 = 2;

fn u16_at(bytes: &[u8], offset: usize) -> Result<u16, ElfError> {
    let part = bytes
        .get(offset..offset + 2)
        .and_then(|b| b.try_into().ok());
    part.map(u16::from_le_bytes)
        .ok_or(ElfError::Truncated { offset })
}

fn u32_at(bytes: &[u8], offset: usize) -> Result<u32, ElfError> {
    let part = bytes
        .get(offset..offset.saturating_add(4))
        .and_then(|b| b.try_into().ok());
    part.map(u32::from_le_bytes)
        .ok_or(ElfError::Truncated { offset })
}

fn text_at(bytes: &[u8], offset: usize) -> Result<String, ElfError> {
    let rest = bytes.get(offset..).ok_or(ElfError::Truncated { offset })?;
    let end = rest
        .iter()
        .position(|&b| b == 0)
        .ok_or(ElfError::Truncated { offset })?;
    Ok(String::from_utf8_lossy(&rest[..end]).into_owned())
}

impl<'a> Elf<'a> {
    /// Reads the tables.
    ///
    /// # Errors
    /// [`ElfError::NotElf32`], [`ElfError::Truncated`].
    pub fn parse(bytes: &'a [u8]) -> Result<Self, ElfError> {
        if bytes.get(..6) != Some(&[0x7f, b'E', b'L', b'F', 1, 1]) {
            return Err(ElfError::NotElf32);
        }
        let table = u32_at(bytes, 32)? as usize;
        let count = usize::from(u16_at(bytes, 48)?);
        let header = |index: usize, field: usize| {
            u32_at(bytes, table + index * SECTION_HEADER_BYTES + field)
        };
        let names = header(usize::from(u16_at(bytes, 50)?), 16)? as usize;
        let mut elf = Elf {
            bytes,
            sections: Vec::new(),
            symbols: Vec::new(),
        };
        for index in 0..count {
            let (kind, flags) = (header(index, 4)?, header(index, 8)?);
            if flags & FLAG_ALLOC != 0 {
                elf.sections.push(Section {
                    name: text_at(bytes, names + header(index, 0)? as usize)?,
                    address: header(index, 12)?,
                    size: header(index, 20)?,
                    offset: header(index, 16)?,
                    stored: kind != TYPE_NO_BITS,
                    writable: flags & FLAG_WRITE != 0,
                    code: flags & FLAG_CODE != 0,
                });
            }
            if kind == TYPE_SYMBOLS {
                let strings = header(header(index, 24)? as usize, 16)? as usize;
                elf.read_symbols(
                    header(index, 16)? as usize,
                    header(index, 20)? as usize,
                    strings,
                )?;
            }
        }
        Ok(elf)
    }

    fn read_symbols(
        &mut self,
        start: usize,
        length: usize,
        strings: usize,
    ) -> Result<(), ElfError> {
        for at in (start..start.saturating_add(length)).step_by(SYMBOL_BYTES) {
            let info = *self
                .bytes
                .get(at + 12)
                .ok_or(ElfError::Truncated { offset: at })?;
            let function = info & 0xf == SYMBOL_FUNCTION;
            let value = u32_at(self.bytes, at + 4)?;
            self.symbols.push(Symbol {
                name: text_at(self.bytes, strings + u32_at(self.bytes, at)? as usize)?,
                address: if function { value & !1 } else { value },
                size: u32_at(self.bytes, at + 8)?,
                function,
            });
        }
        Ok(())
    }

    fn stored_at(&self, address: u32, length: u32) -> Option<&[u8]> {
        let holds = |s: &&Section| {
            s.stored && address >= s.address && address + length <= s.address + s.size
        };
        let section = self.sections.iter().find(holds)?;
        let start = (section.offset + (address - section.address)) as usize;
        self.bytes.get(start..start + length as usize)
    }

    /// Half-word of the image at a run-time address.
    #[must_use]
    pub fn half_at(&self, address: u32) -> Option<u16> {
        self.stored_at(address, 2)?
            .try_into()
            .ok()
            .map(u16::from_le_bytes)
    }

    /// Word of the image at a run-time address.
    #[must_use]
    pub fn word_at(&self, address: u32) -> Option<u32> {
        self.stored_at(address, 4)?
            .try_into()
            .ok()
            .map(u32::from_le_bytes)
    }

    /// Every aligned word of the image that has the mode bit of a Thumb address set, without that bit: whatever
    /// function's address is taken is among them.
    pub fn addresses_in_data(&self) -> impl Iterator<Item = u32> {
        self.sections.iter().filter(|s| s.stored).flat_map(|s| {
            let start = s.address.next_multiple_of(4);
            (start..s.address + s.size)
                .step_by(4)
                .filter_map(|at| self.word_at(at))
                .filter(|w| w & 1 == 1)
                .map(|w| w & !1)
        })
    }

    /// Value of the symbol with exactly this name.
    #[must_use]
    pub fn address_of(&self, name: &str) -> Option<u32> {
        self.symbols
            .iter()
            .find(|s| s.name == name)
            .map(|s| s.address)
    }

    /// The only function whose mangled name contains `part`, for example `7control3cpg4step`.
    ///
    /// # Errors
    /// [`ElfError::NoSymbol`], [`ElfError::Ambiguous`].
    pub fn function(&self, part: &'static str) -> Result<&Symbol, ElfError> {
        let mut found = self
            .symbols
            .iter()
            .filter(|s| s.function && s.name.contains(part));
        let first = found.next().ok_or(ElfError::NoSymbol { part })?;
        match found.find(|s| s.address != first.address) {
            None => Ok(first),
            Some(_) => Err(ElfError::Ambiguous { part }),
        }
    }

    /// Addresses after every direct call (`bl`) of `target`.
    #[must_use]
    pub fn return_addresses(&self, target: u32) -> Vec<u32> {
        let mut found = Vec::new();
        for section in self.sections.iter().filter(|s| s.code && s.stored) {
            let start = section.offset as usize;
            let code = self
                .bytes
                .get(start..start + section.size as usize)
                .unwrap_or(&[]);
            for at in (0..code.len().saturating_sub(3)).step_by(2) {
                let first = u16::from_le_bytes([code[at], code[at + 1]]);
                let second = u16::from_le_bytes([code[at + 2], code[at + 3]]);
                let place = section.address.wrapping_add(at as u32);
                if branch_link_target(first, second, place) == Some(target) {
                    found.push(place.wrapping_add(4));
                }
            }
        }
        found
    }

    /// The region from the entry of a function to its return.
    ///
    /// # Errors
    /// Those of [`Self::function`], and [`ElfError::NoCaller`].
    pub fn region(&self, label: &str, part: &'static str) -> Result<Region, ElfError> {
        let begin = self.function(part)?.address;
        let ends = self.return_addresses(begin);
        if ends.is_empty() {
            return Err(ElfError::NoCaller { part });
        }
        Ok(Region {
            label: label.to_owned(),
            begin,
            ends,
        })
    }

    /// The region from one entry of a function to its next entry: a period.
    ///
    /// # Errors
    /// Those of [`Self::function`].
    pub fn period(&self, label: &str, part: &'static str) -> Result<Region, ElfError> {
        let begin = self.function(part)?.address;
        Ok(Region {
            label: label.to_owned(),
            begin,
            ends: vec![begin],
        })
    }
}

/// Target of a 32-bit Thumb `BL` at `place` (ARMv7-M A7.7.18, encoding T1).
fn branch_link_target(first: u16, second: u16, place: u32) -> Option<u32> {
    (first & 0xf800 == 0xf000 && second & 0xd000 == 0xd000)
        .then(|| branch_target(first, second, place))
}

/// Target of a 32-bit `B` (encoding T4) or `BL`.
pub(super) fn branch_target(first: u16, second: u16, place: u32) -> u32 {
    let bit = |value: u16, index: u32| u32::from(value >> index) & 1;
    let sign = bit(first, 10);
    let i1 = 1 ^ bit(second, 13) ^ sign;
    let i2 = 1 ^ bit(second, 11) ^ sign;
    let offset = (sign << 24)
        | (i1 << 23)
        | (i2 << 22)
        | (u32::from(first & 0x3ff) << 12)
        | (u32::from(second & 0x7ff) << 1);
    let extended = if sign == 1 {
        offset | 0xfe00_0000
    } else {
        offset
    };
    place.wrapping_add(4).wrapping_add(extended)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn branch_targets_forward_and_backward() {
        // Assembled with `arm-none-eabi-as`: `bl .+4` = f000 f800; `bl .` = f7ff fffe.
        assert_eq!(
            branch_link_target(0xf000, 0xf800, 0x0800_0400),
            Some(0x0800_0404)
        );
        assert_eq!(
            branch_link_target(0xf7ff, 0xfffe, 0x0800_0400),
            Some(0x0800_0400)
        );
        // `b.w` and `nop` are no calls.
        assert_eq!(branch_link_target(0xf000, 0xb800, 0x0800_0400), None);
        assert_eq!(branch_link_target(0xbf00, 0xbf00, 0x0800_0400), None);
    }

    #[test]
    fn hostile_files_are_errors() {
        assert_eq!(Elf::parse(b"").unwrap_err(), ElfError::NotElf32);
        let mut file = vec![0x7f, b'E', b'L', b'F', 1, 1];
        assert!(matches!(Elf::parse(&file), Err(ElfError::Truncated { .. })));
        file.resize(52, 0xff);
        assert!(matches!(Elf::parse(&file), Err(ElfError::Truncated { .. })));
    }
}
