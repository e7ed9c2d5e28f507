//! CDR (XCDR1, little endian) as ROS 2 writes it: what `ros2msg` schemas describe.

/// Encapsulation header: plain CDR, little endian, no options [OMG DDSI-RTPS 10.2].
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Writes one message.
#[derive(Debug)]
pub struct CdrWriter(Vec<u8>);

impl Default for CdrWriter {
    fn default() -> Self {
        Self(ENCAPSULATION.to_vec())
    }
}

impl CdrWriter {
    /// The finished message.
    #[must_use]
    pub fn finish(self) -> Vec<u8> {
        self.0
    }

    /// Pads to a multiple of `size`, counted from behind the encapsulation header, then appends.
    fn aligned<const N: usize>(&mut self, bytes: [u8; N]) {
        while !(self.0.len() - ENCAPSULATION.len()).is_multiple_of(N) {
            self.0.push(0);
        }
        self.0.extend(bytes);
    }

    /// `bool`
    pub fn bool(&mut self, value: bool) {
        self.0.push(u8::from(value));
    }

    /// `uint16`
    pub fn u16(&mut self, value: u16) {
        self.aligned(value.to_le_bytes());
    }

    /// `int32`
    pub fn i32(&mut self, value: i32) {
        self.aligned(value.to_le_bytes());
    }

    /// `uint32`
    pub fn u32(&mut self, value: u32) {
        self.aligned(value.to_le_bytes());
    }

    /// `uint64`
    pub fn u64(&mut self, value: u64) {
        self.aligned(value.to_le_bytes());
    }

    /// `float64`
    pub fn f64(&mut self, value: f64) {
        self.aligned(value.to_le_bytes());
    }

    /// `string`: length with the final zero, bytes, zero.
    pub fn string(&mut self, value: &str) {
        self.length(value.len() + 1);
        self.0.extend(value.as_bytes());
        self.0.push(0);
    }

    /// A sequence.
    pub fn sequence<T>(
        &mut self,
        items: impl ExactSizeIterator<Item = T>,
        mut write: impl FnMut(&mut Self, T),
    ) {
        self.length(items.len());
        for item in items {
            write(self, item);
        }
    }

    fn length(&mut self, length: usize) {
        self.u32(u32::try_from(length).unwrap_or(u32::MAX));
    }
}

/// Why a message could not be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CdrError {
    /// The message ends before its last field.
    #[error("the message ends early")]
    Short,
    /// Not plain little-endian CDR.
    #[error("not little-endian CDR")]
    Encapsulation,
    /// A string that is not UTF-8 or lacks its final zero.
    #[error("a string is damaged")]
    Text,
    /// A sequence longer than its message.
    #[error("a sequence is longer than its message")]
    Length,
}

/// Reads one message.
#[derive(Debug)]
pub struct CdrReader<'a> {
    body: &'a [u8],
    at: usize,
}

impl<'a> CdrReader<'a> {
    /// Checks the encapsulation header.
    ///
    /// # Errors
    /// [`CdrError`]
    pub fn new(message: &'a [u8]) -> Result<Self, CdrError> {
        let (header, body) = message.split_first_chunk::<4>().ok_or(CdrError::Short)?;
        if header[..2] != ENCAPSULATION[..2] {
            return Err(CdrError::Encapsulation);
        }
        Ok(Self { body, at: 0 })
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], CdrError> {
        let at = self.at.next_multiple_of(N);
        let bytes = self.body.get(at..at + N).ok_or(CdrError::Short)?;
        self.at = at + N;
        bytes.try_into().map_err(|_| CdrError::Short)
    }

    /// `bool`
    ///
    /// # Errors
    /// [`CdrError::Short`]
    pub fn bool(&mut self) -> Result<bool, CdrError> {
        self.take::<1>().map(|[b]| b != 0)
    }

    /// `uint16`
    ///
    /// # Errors
    /// [`CdrError::Short`]
    pub fn u16(&mut self) -> Result<u16, CdrError> {
        self.take().map(u16::from_le_bytes)
    }

    /// `int32`
    ///
    /// # Errors
    /// [`CdrError::Short`]
    pub fn i32(&mut self) -> Result<i32, CdrError> {
        self.take().map(i32::from_le_bytes)
    }

    /// `uint32`
    ///
    /// # Errors
    /// [`CdrError::Short`]
    pub fn u32(&mut self) -> Result<u32, CdrError> {
        self.take().map(u32::from_le_bytes)
    }

    /// `uint64`
    ///
    /// # Errors
    /// [`CdrError::Short`]
    pub fn u64(&mut self) -> Result<u64, CdrError> {
        self.take().map(u64::from_le_bytes)
    }

    /// `float64`
    ///
    /// # Errors
    /// [`CdrError::Short`]
    pub fn f64(&mut self) -> Result<f64, CdrError> {
        self.take().map(f64::from_le_bytes)
    }

    /// `string`
    ///
    /// # Errors
    /// [`CdrError`]
    pub fn string(&mut self) -> Result<String, CdrError> {
        let length = self.length(1)?;
        let bytes = self
            .body
            .get(self.at..self.at + length)
            .ok_or(CdrError::Short)?;
        self.at += length;
        let (zero, text) = bytes.split_last().ok_or(CdrError::Text)?;
        if *zero != 0 {
            return Err(CdrError::Text);
        }
        String::from_utf8(text.to_vec()).map_err(|_| CdrError::Text)
    }

    /// A sequence whose items take at least `size` bytes each.
    ///
    /// # Errors
    /// [`CdrError`]
    pub fn sequence<T>(
        &mut self,
        size: usize,
        mut item: impl FnMut(&mut Self) -> Result<T, CdrError>,
    ) -> Result<Vec<T>, CdrError> {
        let length = self.length(size)?;
        (0..length).map(|_| item(self)).collect()
    }

    /// A length that the rest of the message can hold: hostile lengths allocate nothing.
    fn length(&mut self, size: usize) -> Result<usize, CdrError> {
        let length = usize::try_from(self.u32()?).map_err(|_| CdrError::Length)?;
        let rest = self.body.len().saturating_sub(self.at);
        if length.saturating_mul(size.max(1)) > rest {
            return Err(CdrError::Length);
        }
        Ok(length)
    }
}

#[cfg(test)]
mod tests {
    use super::{CdrReader, CdrWriter};

    /// Bytes by hand from the rules: 4-byte header, then alignment counted from behind it.
    #[test]
    fn fields_are_aligned_from_behind_the_header() {
        let mut w = CdrWriter::default();
        w.bool(true);
        w.u16(0x0102);
        w.string("ab");
        w.f64(1.0);
        w.sequence([1u32, 2].into_iter(), CdrWriter::u32);
        let expected = [
            0, 1, 0, 0, // encapsulation
            1, 0, 2, 1, // bool, pad, u16
            3, 0, 0, 0, b'a', b'b', 0, 0, // string "ab", pad to 8: offset 11 -> 16
            0, 0, 0, 0, //
            0, 0, 0, 0, 0, 0, 0xf0, 0x3f, // 1.0
            2, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0,
        ];
        let bytes = w.finish();
        assert_eq!(bytes, expected);
        let mut r = CdrReader::new(&bytes).unwrap();
        assert!(r.bool().unwrap());
        assert_eq!(r.u16().unwrap(), 0x0102);
        assert_eq!(r.string().unwrap(), "ab");
        assert_eq!(r.f64().unwrap(), 1.0);
        assert_eq!(r.sequence(4, CdrReader::u32).unwrap(), [1, 2]);
    }

    #[test]
    fn hostile_lengths_are_refused_without_allocating() {
        let mut w = CdrWriter::default();
        w.u32(u32::MAX);
        let bytes = w.finish();
        assert!(
            CdrReader::new(&bytes)
                .unwrap()
                .sequence(8, CdrReader::f64)
                .is_err()
        );
        assert!(CdrReader::new(&bytes).unwrap().string().is_err());
    }
}
