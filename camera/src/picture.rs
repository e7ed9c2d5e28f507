//! Pictures in the paper's colours: simulation blue, robot red, overlap green.

use crate::Silhouette;
use crate::depth::MAX_EDGE;

pub(crate) const BLUE: [u8; 3] = [0x3b, 0x6f, 0xd4];
pub(crate) const RED: [u8; 3] = [0xd6, 0x45, 0x3d];
pub(crate) const GREEN: [u8; 3] = [0x3c, 0xa9, 0x5a];
/// Lines between the frames of a strip.
const BORDER: [u8; 3] = [0xbb, 0xbb, 0xbb];
pub(crate) const GROUND: [u8; 3] = [0xfa, 0xfa, 0xf7];

/// Why a picture could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// No frame given.
    #[error("no frame to draw")]
    NoFrame,
    /// Frames of different sizes.
    #[error("frame {frame} has another size than the first")]
    Size {
        /// Index of the frame.
        frame: usize,
    },
    /// The encoder refused.
    #[error("PNG encoding: {0}")]
    Encode(#[from] png::EncodingError),
    /// The file is no valid PNG.
    #[error("PNG decoding: {0}")]
    Decode(#[from] png::DecodingError),
    /// More pixels than a camera of this use has.
    #[error("the PNG is {width} x {height} pixels; at most {MAX_EDGE} x {MAX_EDGE} are read")]
    Large {
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
    },
    /// Not 1 channel.
    #[error("the PNG is {found:?}; silhouettes are grey scale with 1, 8 or 16 bit")]
    Colour {
        /// Colour type of the file.
        found: png::ColorType,
    },
    /// Not a depth picture.
    #[error("the PNG is {colour:?} with {bits} bit; depth is grey scale with 16 bit")]
    NoDepth {
        /// Colour type of the file.
        colour: png::ColorType,
        /// Bits per channel.
        bits: u8,
    },
}

/// One frame as a 1-bit PNG (white is robot).
///
/// # Errors
/// When the encoder fails.
pub fn silhouette_png(frame: &Silhouette) -> Result<Vec<u8>, PictureError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, edge(frame.width()), edge(frame.height()));
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::One);
    let row_bytes = frame.width().div_ceil(8);
    let mut data = Vec::with_capacity(row_bytes * frame.height());
    for y in 0..frame.height() {
        // PNG has the leftmost pixel in the highest bit.
        let row = frame.row_words(y);
        let row = row.iter().flat_map(|word| word.to_le_bytes());
        data.extend(row.map(u8::reverse_bits).take(row_bytes));
    }
    encoder.write_header()?.write_image_data(&data)?;
    Ok(bytes)
}

/// Read a grey-scale PNG; a pixel at half brightness or more is robot.
///
/// # Errors
/// When it is no PNG or not grey scale.
pub fn read_silhouette_png(bytes: &[u8]) -> Result<Silhouette, PictureError> {
    let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
    let header = decoder.read_header_info()?;
    must_be_small(header)?;
    let packed = header.bit_depth == png::BitDepth::One;
    decoder.set_transformations(if packed {
        png::Transformations::IDENTITY
    } else {
        png::Transformations::EXPAND | png::Transformations::STRIP_16
    });
    let mut reader = decoder.read_info()?;
    // Three or four channels of many pixels are refused before memory is taken for them.
    let found = reader.output_color_type().0;
    if found != png::ColorType::Grayscale {
        return Err(PictureError::Colour { found });
    }
    let mut data = vec![0; reader.output_buffer_size().unwrap_or(0)];
    let info = reader.next_frame(&mut data)?;
    let mut frame = Silhouette::new(info.width as usize, info.height as usize);
    let mut words = Vec::new();
    for (y, row) in data.chunks_exact(info.line_size).enumerate() {
        words.clear();
        if packed {
            words.extend(row.chunks(8).map(|bytes| {
                let mut eight = [0; 8];
                eight[..bytes.len()].copy_from_slice(bytes);
                // PNG has the leftmost pixel in the highest bit of the first byte.
                u64::from_be_bytes(eight).reverse_bits()
            }));
        } else {
            words.extend(row.chunks(64).map(|grey| {
                let bits = grey.iter().rev().map(|&grey| u64::from(grey >= 128));
                bits.fold(0, |word, bit| word << 1 | bit)
            }));
        }
        frame.mark_words(y, &words);
    }
    Ok(frame.cropped())
}

/// A header of a few bytes can claim 2^31 x 2^31 pixels.
pub(crate) fn must_be_small(header: &png::Info<'_>) -> Result<(), PictureError> {
    let (width, height) = (header.width, header.height);
    if width.max(height) as usize > MAX_EDGE {
        return Err(PictureError::Large { width, height });
    }
    Ok(())
}

/// The colours of one overlaid frame, three bytes per pixel.
fn overlay_pixels(robot: &Silhouette, simulated: &Silhouette) -> Vec<u8> {
    let mut data = Vec::with_capacity(robot.width() * robot.height() * 3);
    for y in 0..robot.height() {
        for x in 0..robot.width() {
            data.extend(match (robot.get(x, y), simulated.get(x, y)) {
                (true, true) => GREEN,
                (true, false) => RED,
                (false, true) => BLUE,
                (false, false) => GROUND,
            });
        }
    }
    data
}

/// The paper's figure 5: one frame, robot and simulation laid over each other.
///
/// # Errors
/// When the sizes differ or the encoder fails.
pub fn overlay_png(robot: &Silhouette, simulated: &Silhouette) -> Result<Vec<u8>, PictureError> {
    animation_png(&[(robot, simulated)], 1)
}

/// All overlaid frames as an animated PNG that browsers play, `rate_hz` frames per second.
///
/// # Errors
/// When there is no frame, sizes differ or the encoder fails.
pub fn animation_png(
    frames: &[(&Silhouette, &Silhouette)],
    rate_hz: u16,
) -> Result<Vec<u8>, PictureError> {
    let (width, height) = common_size(frames.iter().flat_map(|(a, b)| [*a, *b]))?;
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, edge(width), edge(height));
    encoder.set_color(png::ColorType::Rgb);
    if frames.len() > 1 {
        encoder.set_animated(edge(frames.len()), 0)?;
        encoder.set_frame_delay(1, rate_hz.max(1))?;
    }
    let mut writer = encoder.write_header()?;
    for (robot, simulated) in frames {
        writer.write_image_data(&overlay_pixels(robot, simulated))?;
    }
    writer.finish()?;
    Ok(bytes)
}

/// The paper's figure 7: the robot's frames above the simulation's, time from left to right.
///
/// # Errors
/// When there is no frame, sizes differ or the encoder fails.
pub fn film_strip_png(
    robot: &[&Silhouette],
    simulated: &[&Silhouette],
) -> Result<Vec<u8>, PictureError> {
    let rows: Vec<_> = [(robot, RED), (simulated, BLUE)]
        .into_iter()
        .filter(|(row, _)| !row.is_empty())
        .collect();
    let (width, height) = common_size(rows.iter().flat_map(|(row, _)| row.iter().copied()))?;
    let columns = rows.iter().map(|(row, _)| row.len()).max().unwrap_or(0);
    let mut bytes = Vec::new();
    let mut encoder =
        png::Encoder::new(&mut bytes, edge(width * columns), edge(height * rows.len()));
    encoder.set_color(png::ColorType::Rgb);
    let mut data = Vec::with_capacity(width * columns * height * rows.len() * 3);
    for (k, (row, colour)) in rows.iter().enumerate() {
        for y in 0..height {
            for column in 0..columns {
                let frame = row.get(column);
                data.extend((0..width).flat_map(|x| match frame {
                    Some(frame) if frame.get(x, y) => *colour,
                    _ if (x == 0 && column > 0) || (y == 0 && k > 0) => BORDER,
                    _ => GROUND,
                }));
            }
        }
    }
    encoder.write_header()?.write_image_data(&data)?;
    Ok(bytes)
}

pub(crate) fn common_size<'a>(
    mut frames: impl Iterator<Item = &'a Silhouette>,
) -> Result<(usize, usize), PictureError> {
    let first = frames.next().ok_or(PictureError::NoFrame)?;
    let size = (first.width(), first.height());
    match frames.position(|frame| (frame.width(), frame.height()) != size) {
        Some(frame) => Err(PictureError::Size { frame: frame + 1 }),
        None => Ok(size),
    }
}

fn edge(pixels: usize) -> u32 {
    u32::try_from(pixels).unwrap_or(u32::MAX)
}
