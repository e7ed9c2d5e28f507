//! The bytes that a flash tool writes, out of a 32-bit little-endian ELF image.

use anyhow::{Context, Result, ensure};

/// An image without gaps.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Flat {
    /// Where its first byte goes.
    pub(crate) address: u32,
    /// Its bytes; gaps between segments are 0xFF, as erased flash is.
    pub(crate) bytes: Vec<u8>,
}

/// Largest image: the flash of the chip, bytes.
const FLASH: usize = 1 << 20;

/// All segments that are loaded from the file, at their physical addresses.
///
/// # Errors
/// No 32-bit little-endian ELF file, a segment outside the file, or no segment.
pub(crate) fn flatten(elf: &[u8]) -> Result<Flat> {
    ensure!(
        elf.starts_with(b"\x7fELF\x01\x01"),
        "no 32-bit little-endian ELF file"
    );
    let (table, size, count) = (word(elf, 28)?, half(elf, 42)?, half(elf, 44)?);
    let mut parts = Vec::new();
    for index in 0..count {
        let header = table as usize + usize::from(size) * usize::from(index);
        let (kind, offset) = (word(elf, header)?, word(elf, header + 4)? as usize);
        let (address, length) = (word(elf, header + 12)?, word(elf, header + 16)? as usize);
        if kind == 1 && length > 0 {
            let bytes = elf
                .get(offset..offset + length)
                .context("a segment lies outside the file")?;
            parts.push((address, bytes));
        }
    }
    parts.sort_by_key(|(address, _)| *address);
    let address = parts.first().context("no segment is loaded")?.0;
    let mut bytes = Vec::new();
    for (at, part) in parts {
        let start = (at - address) as usize;
        ensure!(start >= bytes.len(), "two segments overlap");
        ensure!(
            start + part.len() <= FLASH,
            "the image is larger than the flash"
        );
        bytes.resize(start, 0xFF);
        bytes.extend_from_slice(part);
    }
    Ok(Flat { address, bytes })
}

fn word(elf: &[u8], at: usize) -> Result<u32> {
    let bytes = elf.get(at..at + 4).context("the file is cut")?;
    Ok(u32::from_le_bytes(bytes.try_into()?))
}

fn half(elf: &[u8], at: usize) -> Result<u16> {
    let bytes = elf.get(at..at + 2).context("the file is cut")?;
    Ok(u16::from_le_bytes(bytes.try_into()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file with segments (kind, address, bytes).
    fn file(segments: &[(u32, u32, &[u8])]) -> Vec<u8> {
        let mut elf = b"\x7fELF\x01\x01".to_vec();
        elf.resize(52, 0);
        elf[28..32].copy_from_slice(&52_u32.to_le_bytes());
        elf[42..44].copy_from_slice(&32_u16.to_le_bytes());
        elf[44..46].copy_from_slice(&u16::try_from(segments.len()).unwrap().to_le_bytes());
        let mut offset = 52 + 32 * segments.len();
        for (kind, address, bytes) in segments {
            let length = bytes.len();
            let words = [
                *kind,
                offset as u32,
                0,
                *address,
                length as u32,
                length as u32,
                5,
                4,
            ];
            elf.extend(words.iter().flat_map(|word| word.to_le_bytes()));
            offset += length;
        }
        segments
            .iter()
            .for_each(|(_, _, bytes)| elf.extend_from_slice(bytes));
        elf
    }

    #[test]
    fn segments_follow_their_addresses_with_erased_flash_between() {
        let elf = file(&[
            (1, 0x0800_0006, b"cd"),
            (1, 0x0800_0000, b"ab"),
            (2, 0, b"note"),
        ]);
        let flat = flatten(&elf).unwrap();
        assert_eq!(flat.address, 0x0800_0000);
        assert_eq!(flat.bytes, b"ab\xff\xff\xff\xffcd");
    }

    #[test]
    fn what_is_no_image_is_refused() {
        let cut = file(&[(1, 0, b"abcd")]);
        let overlap = file(&[(1, 0, b"abcd"), (1, 2, b"ef")]);
        for bad in [
            b"".as_slice(),
            b"\x7fELF\x02\x01",
            &cut[..60],
            &cut[..cut.len() - 1],
            &overlap,
            &file(&[]),
        ] {
            assert!(flatten(bad).is_err());
        }
    }
}
