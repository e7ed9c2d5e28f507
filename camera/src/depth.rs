//! The real side: depth frames of an overhead Kinect, cut down to the robot.

use crate::Silhouette;
use crate::picture::{PictureError, must_be_small};

/// A raw depth frame, row by row; 0 and [`NO_READING`] are pixels without a distance.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DepthFrame {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Raw readings; larger is farther.
    pub raw: Vec<u16>,
}

/// The Kinect's 11-bit mark for "no reading" (libfreenect, `FREENECT_DEPTH_RAW_NO_VALUE`).
pub const NO_READING: u16 = 2047;

/// Byte order of 16-bit samples behind a PGM header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Samples {
    /// The PGM standard: most significant byte first.
    BigEndian,
    /// `fakenect-record` dumps the host's order (little endian on every PC) behind the same header.
    LittleEndian,
}

/// Why a depth frame could not be read; offsets are bytes from the start of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DepthError {
    /// Not a binary PGM.
    #[error("not a binary grey map: the file must begin with `P5`")]
    Magic,
    /// A number of the header is missing or wrong.
    #[error("header field {field} at byte {offset} is not a number in range")]
    Header {
        /// `width`, `height` or `maximum`.
        field: &'static str,
        /// Where it was looked for.
        offset: usize,
    },
    /// Fewer samples than the header promises.
    #[error("{found} bytes of samples, the header promises {needed}: the file is cut short")]
    Short {
        /// Bytes needed.
        needed: usize,
        /// Bytes found.
        found: usize,
    },
    /// Frames of different sizes in one sequence.
    #[error("frame {frame} is {width} x {height}, the first is {first_width} x {first_height}")]
    Size {
        /// Index of the frame.
        frame: usize,
        /// Its width.
        width: usize,
        /// Its height.
        height: usize,
        /// Width of the first frame.
        first_width: usize,
        /// Height of the first frame.
        first_height: usize,
    },
    /// No frame to take a background from.
    #[error("no frame given to take the background from")]
    NoFrame,
}

/// Largest edge accepted from a header, px.
pub const MAX_EDGE: usize = 4096;

/// Read a binary PGM (8 or 16 bit).
///
/// # Errors
/// See [`DepthError`].
pub fn read_pgm(bytes: &[u8], samples: Samples) -> Result<DepthFrame, DepthError> {
    if !bytes.starts_with(b"P5") {
        return Err(DepthError::Magic);
    }
    let mut offset = 2;
    let mut number = |field| -> Result<usize, DepthError> {
        let (value, next) =
            header_number(bytes, offset).ok_or(DepthError::Header { field, offset })?;
        offset = next;
        Ok(value)
    };
    let (width, height, maximum) = (number("width")?, number("height")?, number("maximum")?);
    for (field, value, limit) in [
        ("width", width, MAX_EDGE),
        ("height", height, MAX_EDGE),
        ("maximum", maximum, 65535),
    ] {
        if value == 0 || value > limit {
            return Err(DepthError::Header { field, offset });
        }
    }
    let data = bytes.get(offset + 1..).unwrap_or_default();
    let size = if maximum > 255 { 2 } else { 1 };
    let needed = width * height * size;
    let data = data.get(..needed).ok_or(DepthError::Short {
        needed,
        found: data.len(),
    })?;
    let raw = match (size, samples) {
        (1, _) => data.iter().map(|&b| u16::from(b)).collect(),
        (_, Samples::BigEndian) => data
            .as_chunks()
            .0
            .iter()
            .map(|&b| u16::from_be_bytes(b))
            .collect(),
        (_, Samples::LittleEndian) => data
            .as_chunks()
            .0
            .iter()
            .map(|&b| u16::from_le_bytes(b))
            .collect(),
    };
    Ok(DepthFrame { width, height, raw })
}

/// One frame as a 16-bit PGM in the standard's byte order.
#[must_use]
pub fn write_pgm(frame: &DepthFrame) -> Vec<u8> {
    let mut bytes = format!("P5\n{} {}\n65535\n", frame.width, frame.height).into_bytes();
    bytes.extend(frame.raw.iter().flat_map(|raw| raw.to_be_bytes()));
    bytes
}

/// Read a 16-bit grey-scale PNG.
///
/// # Errors
/// When it is no PNG, or not grey scale with 16 bit.
pub fn read_png(bytes: &[u8]) -> Result<DepthFrame, PictureError> {
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info()?;
    must_be_small(reader.info())?;
    let (colour, depth) = reader.output_color_type();
    if (colour, depth) != (png::ColorType::Grayscale, png::BitDepth::Sixteen) {
        let bits = depth as u8;
        return Err(PictureError::NoDepth { colour, bits });
    }
    let mut data = vec![0; reader.output_buffer_size().unwrap_or(0)];
    let info = reader.next_frame(&mut data)?;
    let samples = data.as_chunks().0.iter();
    Ok(DepthFrame {
        width: info.width as usize,
        height: info.height as usize,
        raw: samples.map(|&b| u16::from_be_bytes(b)).collect(),
    })
}

/// The next decimal number and the offset behind it; white space and `#` comments before it are skipped.
fn header_number(bytes: &[u8], mut at: usize) -> Option<(usize, usize)> {
    loop {
        match bytes.get(at)? {
            b'#' => at += bytes.get(at..)?.iter().position(|&b| b == b'\n')?,
            b if b.is_ascii_whitespace() => at += 1,
            _ => break,
        }
    }
    let digits = bytes
        .get(at..)?
        .iter()
        .take_while(|b| b.is_ascii_digit())
        .count();
    let text = std::str::from_utf8(bytes.get(at..at + digits)?).ok()?;
    Some((text.parse().ok()?, at + digits))
}

/// One line of a `fakenect-record` folder's `INDEX.txt`.
#[derive(Clone, Debug, PartialEq)]
pub struct IndexEntry {
    /// File name inside the folder.
    pub file: String,
    /// Host time of arrival in seconds.
    pub t_s: f64,
}

/// The depth frames (`d-TIME-STAMP.pgm`) of an `INDEX.txt`, in file order; colour and accelerometer lines are left out.
#[must_use]
pub fn read_fakenect_index(text: &str) -> Vec<IndexEntry> {
    text.lines()
        .filter_map(|line| {
            let file = line.trim();
            let t_s = file.strip_prefix("d-")?.split('-').next()?.parse().ok()?;
            f64::is_finite(t_s).then(|| IndexEntry {
                file: file.to_owned(),
                t_s,
            })
        })
        .collect()
}

/// The empty scene: the median reading of each pixel over frames without the robot, or over a run in which it moves.
///
/// # Errors
/// When there is no frame or sizes differ.
pub fn background(frames: &[DepthFrame]) -> Result<DepthFrame, DepthError> {
    let first = frames.first().ok_or(DepthError::NoFrame)?;
    for (frame, f) in frames.iter().enumerate() {
        same_size(frame, f, first)?;
    }
    let mut readings = Vec::with_capacity(frames.len());
    let raw = (0..first.raw.len())
        .map(|pixel| {
            readings.clear();
            readings.extend(
                frames
                    .iter()
                    .map(|f| f.raw[pixel])
                    .filter(|&r| is_reading(r)),
            );
            readings.sort_unstable();
            readings
                .get(readings.len() / 2)
                .copied()
                .unwrap_or(NO_READING)
        })
        .collect();
    Ok(DepthFrame {
        width: first.width,
        height: first.height,
        raw,
    })
}

/// The robot in `frame`: the largest connected region at least `step_raw` closer than `background`.
///
/// # Errors
/// When the sizes differ.
pub fn silhouette(
    frame: &DepthFrame,
    background: &DepthFrame,
    step_raw: u16,
) -> Result<Silhouette, DepthError> {
    same_size(0, frame, background)?;
    let closer: Vec<bool> = frame
        .raw
        .iter()
        .zip(&background.raw)
        .map(|(&f, &b)| is_reading(f) && is_reading(b) && f.saturating_add(step_raw) <= b)
        .collect();
    Ok(largest_region(&closer, frame.width, frame.height))
}

fn is_reading(raw: u16) -> bool {
    raw != 0 && raw != NO_READING
}

fn same_size(frame: usize, f: &DepthFrame, first: &DepthFrame) -> Result<(), DepthError> {
    if (f.width, f.height, f.raw.len()) == (first.width, first.height, first.raw.len()) {
        return Ok(());
    }
    Err(DepthError::Size {
        frame,
        width: f.width,
        height: f.height,
        first_width: first.width,
        first_height: first.height,
    })
}

/// Flood fill (4-connected) of every region; the largest is drawn, the first found wins a tie.
fn largest_region(mask: &[bool], width: usize, height: usize) -> Silhouette {
    let mut seen = vec![false; mask.len()];
    let (mut best, mut region, mut open) = (Vec::new(), Vec::new(), Vec::new());
    for start in 0..mask.len() {
        if !mask[start] || seen[start] {
            continue;
        }
        region.clear();
        open.push(start);
        seen[start] = true;
        while let Some(pixel) = open.pop() {
            region.push(pixel);
            let (x, y) = (pixel % width, pixel / width);
            let neighbours = [
                (x > 0).then(|| pixel - 1),
                (x + 1 < width).then(|| pixel + 1),
                (y > 0).then(|| pixel - width),
                (y + 1 < height).then(|| pixel + width),
            ];
            for next in neighbours.into_iter().flatten() {
                if mask[next] && !seen[next] {
                    seen[next] = true;
                    open.push(next);
                }
            }
        }
        if region.len() > best.len() {
            std::mem::swap(&mut best, &mut region);
        }
    }
    let mut frame = Silhouette::new(width, height);
    for pixel in best {
        let x = pixel % width;
        frame.fill(pixel / width, x, x + 1);
    }
    frame
}
