//! Bits of the code of a sample, and Golomb-Rice codes of them.

use super::MAX_SAMPLE;

/// Ones that announce a number written plainly, in 32 bits: no number costs more than 44 bits.
pub(super) const ESCAPE: u32 = 12;
pub(super) const PLAIN_BITS: u32 = 32;

/// Where bits go to or come from; the same walk over a sample serves both.
pub(super) trait Bits {
    /// Writes `code`, or reads one and returns it.
    fn bits(&mut self, code: u32, width: u32) -> Option<u32>;

    /// As many ones as `count` says and a zero, or [`ESCAPE`] ones; returns how many.
    fn ones(&mut self, count: u32) -> Option<u32>;

    /// The Golomb-Rice code with parameter `k`, or [`ESCAPE`] ones and the number itself.
    fn rice(&mut self, code: u32, k: u32) -> Option<u32> {
        let ones = self.ones(code >> k)?;
        if ones == ESCAPE {
            return self.bits(code, PLAIN_BITS);
        }
        let low = self.bits(code & ((1 << k) - 1), k)?;
        Some(ones << k | low)
    }
}

/// Bits into the bytes of a sample.
pub(super) struct Writer<'a> {
    out: &'a mut [u8; MAX_SAMPLE],
    /// Whole bytes written.
    len: usize,
    /// Bits that wait for their word to be full, lowest first, and how many there are: fewer than 32.
    word: u32,
    waiting: u32,
}

impl<'a> Writer<'a> {
    pub(super) fn new(out: &'a mut [u8; MAX_SAMPLE]) -> Self {
        Self {
            out,
            len: 0,
            word: 0,
            waiting: 0,
        }
    }

    /// Writes the first bytes of `word`.
    fn store(&mut self, bytes: usize) -> Option<()> {
        let end = self.len.saturating_add(bytes);
        // MAX_SAMPLE is the sum of all maxima of six motors: only more of them find no place.
        let places = self.out.get_mut(self.len..end)?;
        for (place, byte) in places.iter_mut().zip(self.word.to_le_bytes()) {
            *place = byte;
        }
        self.len = end;
        Some(())
    }

    /// Writes what waits, its last byte filled up with zeros; returns how many bytes there are.
    pub(super) fn finish(mut self) -> Option<usize> {
        self.store(self.waiting.div_ceil(8) as usize)?;
        Some(self.len)
    }
}

impl Bits for Writer<'_> {
    fn bits(&mut self, code: u32, width: u32) -> Option<u32> {
        // At most 32.
        let code = code & u32::MAX.checked_shr(u32::BITS - width).unwrap_or(0);
        self.word |= code << self.waiting;
        let waiting = self.waiting + width;
        if waiting >= u32::BITS {
            self.store(4)?;
            // What found no place: nothing when the word was just filled.
            self.word = code.checked_shr(u32::BITS - self.waiting).unwrap_or(0);
            self.waiting = waiting - u32::BITS;
        } else {
            self.waiting = waiting;
        }
        Some(code)
    }

    fn ones(&mut self, count: u32) -> Option<u32> {
        let ones = count.min(ESCAPE);
        self.bits((1 << ones) - 1, ones + u32::from(ones < ESCAPE))?;
        Some(ones)
    }

    fn rice(&mut self, code: u32, k: u32) -> Option<u32> {
        let ones = (code >> k).min(ESCAPE);
        let width = ones + 1 + k;
        if ones == ESCAPE || width > u32::BITS {
            self.ones(ones)?;
            let (rest, width) = if ones == ESCAPE {
                (code, PLAIN_BITS)
            } else {
                (code, k)
            };
            self.bits(rest, width)?;
        } else {
            // All of it at once: the ones, a zero, the low bits. A shift by 32 has no low bits to bring.
            let low = (code & ((1 << k) - 1)).checked_shl(ones + 1).unwrap_or(0);
            self.bits(low | ((1 << ones) - 1), width)?;
        }
        Some(code)
    }
}

/// Bits out of the bytes of a sample.
pub(super) struct Reader<'a> {
    pub(super) bytes: &'a [u8],
    /// Bits.
    pub(super) at: usize,
}

impl Bits for Reader<'_> {
    fn bits(&mut self, _code: u32, width: u32) -> Option<u32> {
        let mut code = 0;
        for bit in 0..width {
            let byte = self.bytes.get(self.at >> 3)?;
            code |= u32::from(byte >> (self.at & 7) & 1) << bit;
            self.at = self.at.saturating_add(1);
        }
        Some(code)
    }

    fn ones(&mut self, _count: u32) -> Option<u32> {
        let mut ones = 0;
        while ones < ESCAPE && self.bits(0, 1)? == 1 {
            ones += 1;
        }
        Some(ones)
    }
}
