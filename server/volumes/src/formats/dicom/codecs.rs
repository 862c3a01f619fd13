//! Compressed images: run lengths are decoded here, the kinds of JPEG by libraries without unsafe code.
//!
//! The size that a compressed image claims is compared with the header's before a library is called. The libraries panic on some invalid
//! streams. The panic is caught: no other state is involved.

use std::panic::{AssertUnwindSafe, catch_unwind};

use hayro_jpeg2000::{DecodeSettings, DecoderContext, Image};
use jpeg_decoder::{CodingProcess, ColorTransform, Decoder, PixelFormat};

use super::data_set::{Fault, tag};
use super::samples::{Color, SampleFormat};
use super::syntax::Codec;
use crate::formats::jpeg::check_scans;

/// Decodes a compressed image. Returns its samples, words with the least significant byte first, and the order of their components.
pub fn decode(codec: Codec, encoded: &[u8], format: &SampleFormat) -> Result<(Vec<u8>, Color), Fault> {
    let decode = || match codec {
        Codec::RunLength => run_lengths(encoded, format),
        Codec::Jpeg => jpeg(encoded, format),
        Codec::JpegLs => jpeg_ls(encoded, format),
        Codec::Jpeg2000 => jpeg_2000(encoded, format),
    };
    catch_unwind(AssertUnwindSafe(decode)).unwrap_or_else(|_| Err(fault("is false, its decoder gave up")))
}

fn fault(why: impl Into<String>) -> Fault {
    Fault::of(tag::PIXELS, why)
}

/// Decodes run lengths (part 5, annex G): a segment for each byte of a sample, the most significant first; one component after
/// the other.
fn run_lengths(encoded: &[u8], format: &SampleFormat) -> Result<(Vec<u8>, Color), Fault> {
    /// Two bytes decode to at most 128.
    const MAX_RATIO: usize = 64;
    const HEAD_BYTES: usize = 64;
    let bytes = format.frame_bytes() as usize;
    if encoded.len() < HEAD_BYTES || bytes / MAX_RATIO > encoded.len() {
        let why = format!(
            "{} bytes of run lengths cannot hold {}",
            encoded.len(),
            format.describe(1)
        );
        return Err(fault(why));
    }
    let head: Vec<usize> = encoded[..HEAD_BYTES]
        .chunks_exact(4)
        .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize)
        .collect();
    let samples = format.samples() as usize;
    let segments = bytes / samples;
    if head[0] != segments || segments >= head.len() {
        return Err(fault(format!(
            "{} segments of run lengths, expected {segments}",
            head[0]
        )));
    }
    let mut frame = vec![0; bytes];
    for segment in 0..segments {
        let from = head[segment + 1];
        let to = if segment + 1 < segments {
            head[segment + 2]
        } else {
            encoded.len()
        };
        let packed = encoded.get(from..to);
        let packed = packed.ok_or_else(|| fault("segments of run lengths lie outside of the fragment"))?;
        let (component, byte) = (segment / format.bytes, segment % format.bytes);
        let at = component * samples * format.bytes + format.bytes - 1 - byte;
        let mut bytes_left = frame[at..].iter_mut().step_by(format.bytes).take(samples);
        unpack(packed, &mut bytes_left);
        let missing = bytes_left.len();
        if missing > 0 {
            return Err(fault(format!(
                "a segment of run lengths lacks {missing} of {samples} bytes"
            )));
        }
    }
    Ok((frame, planes(format.color)))
}

/// Decodes runs into `bytes_left` until it is full; the rest is padding.
fn unpack<'a>(mut packed: &[u8], bytes_left: &mut impl ExactSizeIterator<Item = &'a mut u8>) {
    while let [control, rest @ ..] = packed {
        let literal = usize::from(*control) + 1;
        match (control, rest) {
            (0..=127, rest) if rest.len() >= literal => {
                let (bytes, rest) = rest.split_at(literal);
                bytes.iter().zip(&mut *bytes_left).for_each(|(byte, to)| *to = *byte);
                packed = rest;
            }
            (129..=255, [byte, rest @ ..]) => {
                let run = 257 - usize::from(*control);
                bytes_left.take(run).for_each(|to| *to = *byte);
                packed = rest;
            }
            (128, rest) => packed = rest,
            _ => return,
        }
        if bytes_left.len() == 0 {
            return;
        }
    }
}

/// Returns the same components, each in a plane of its own.
fn planes(color: Color) -> Color {
    match color {
        Color::Grey => Color::Grey,
        Color::Rgb { .. } => Color::Rgb { planes: true },
        Color::Ybr { .. } => Color::Ybr { planes: true },
    }
}

/// The values of a JPEG frame header that are used.
struct FrameHeader {
    precision: u8,
    components: u8,
}

/// Finds the frame header, whose marker is one of `markers`, and compares its size with the file's header.
fn frame_header(encoded: &[u8], markers: &[u8], format: &SampleFormat) -> Result<FrameHeader, Fault> {
    let mut rest = encoded.strip_prefix(&[0xff, 0xd8]);
    while let Some([0xff, marker, after @ ..]) = rest {
        let [high, low, body @ ..] = after else { break };
        let [precision, y1, y0, x1, x0, components, ..] = body else {
            break;
        };
        if markers.contains(marker) {
            let (rows, columns) = (u16::from_be_bytes([*y1, *y0]), u16::from_be_bytes([*x1, *x0]));
            if (u32::from(rows), u32::from(columns)) != (format.rows, format.columns) {
                let why = format!("{columns} x {rows} compressed samples, expected {}", format.describe(1));
                return Err(fault(why));
            }
            return Ok(FrameHeader {
                precision: *precision,
                components: *components,
            });
        }
        rest = after.get(usize::from(u16::from_be_bytes([*high, *low]))..);
    }
    Err(fault(
        "no frame header of the compression that the transfer syntax names",
    ))
}

/// Decodes baseline, extended of 8 bits, and lossless JPEG.
fn jpeg(encoded: &[u8], format: &SampleFormat) -> Result<(Vec<u8>, Color), Fault> {
    let header = frame_header(encoded, &[0xc0, 0xc1, 0xc3], format)?;
    let color = match format.color {
        Color::Grey => ColorTransform::Grayscale,
        Color::Rgb { .. } => ColorTransform::RGB,
        Color::Ybr { .. } => ColorTransform::YCbCr,
    };
    let expected = if format.color == Color::Grey { 1 } else { 3 };
    if header.components != expected {
        return Err(fault(format!(
            "{} compressed components, expected {expected}",
            header.components
        )));
    }
    if usize::from(header.precision) > 8 * format.bytes {
        let why = format!(
            "{} compressed bits, expected at most {}",
            header.precision,
            8 * format.bytes
        );
        return Err(fault(why));
    }
    check_scans(encoded).map_err(fault)?;
    let mut decoder = Decoder::new(encoded);
    decoder.set_color_transform(color);
    decoder.set_max_decoding_buffer_size(2 * format.frame_bytes() as usize);
    let failed = |e| fault(format!("is no JPEG that is read: {e}"));
    decoder.read_info().map_err(failed)?;
    let info = decoder.info().ok_or_else(|| fault("is no JPEG"))?;
    if info.coding_process == CodingProcess::DctProgressive {
        return Err(fault("progressive JPEG, expected baseline, extended or lossless"));
    }
    let decoded = decoder.decode().map_err(failed)?;
    let frame = match info.pixel_format {
        PixelFormat::L16 => {
            let words = decoded.chunks_exact(2).map(|b| u16::from_ne_bytes([b[0], b[1]]));
            words.flat_map(u16::to_le_bytes).collect()
        }
        _ => decoded,
    };
    let color = match format.color {
        Color::Grey => Color::Grey,
        _ => Color::Rgb { planes: false },
    };
    Ok((widened(frame, header.precision, format)?, color))
}

/// Checks the size of decoded samples, and widens those of up to 8 bits if the file's words are larger.
fn widened(frame: Vec<u8>, precision: u8, format: &SampleFormat) -> Result<Vec<u8>, Fault> {
    let width = if precision > 8 { 2 } else { 1 };
    let samples = format.frame_bytes() as usize / format.bytes;
    if frame.len() != samples * width {
        let why = format!("{} decoded bytes, expected {}", frame.len(), format.describe(1));
        return Err(fault(why));
    }
    if width == format.bytes {
        return Ok(frame);
    }
    let mut words = vec![0; samples * format.bytes];
    for (word, stored) in words.chunks_exact_mut(format.bytes).zip(frame.chunks_exact(width)) {
        word[..width].copy_from_slice(stored);
    }
    Ok(words)
}

/// Decodes JPEG-LS, lossless or near-lossless, of one component.
fn jpeg_ls(encoded: &[u8], format: &SampleFormat) -> Result<(Vec<u8>, Color), Fault> {
    let header = frame_header(encoded, &[0xf7], format)?;
    if header.components != 1 || format.color != Color::Grey || usize::from(header.precision) > 8 * format.bytes {
        let (bits, components) = (header.precision, header.components);
        let why = format!(
            "{components} components of {bits} bits in JPEG-LS, expected 1 of at most {}",
            8 * format.bytes
        );
        return Err(fault(why));
    }
    let (words, ..) = jpegls::decode(encoded, format.columns, format.rows)
        .map_err(|e| fault(format!("is no JPEG-LS that is read: {e}")))?;
    let frame = words.into_iter().flat_map(u16::to_le_bytes).collect();
    // The library returns 16 bits for all samples.
    let frame = widened(
        frame,
        16,
        &SampleFormat {
            bytes: format.bytes.max(2),
            ..*format
        },
    )?;
    if format.bytes > 1 {
        return Ok((frame, Color::Grey));
    }
    Ok((frame.into_iter().step_by(2).collect(), Color::Grey))
}

/// What the size marker of a JPEG 2000 stream states about a component.
struct SizedComponent {
    precision: u32,
    signed: bool,
}

/// Returns the components of a JPEG 2000 stream, whose size must be that of the header.
fn sized_components(encoded: &[u8], format: &SampleFormat) -> Result<Vec<SizedComponent>, Fault> {
    const SIZES_AT: usize = 8;
    const COMPONENTS_AT: usize = 40;
    /// Each tile has its own tables; real images have one tile.
    const MAX_TILES: u64 = 256;
    let no_stream = || fault("is no JPEG 2000 stream, expected one");
    let head = encoded
        .get(..COMPONENTS_AT + 2)
        .filter(|head| head.starts_with(&[0xff, 0x4f, 0xff, 0x51]));
    let head = head.ok_or_else(no_stream)?;
    let sizes = head[SIZES_AT..COMPONENTS_AT].chunks_exact(4);
    let sizes: Vec<u64> = sizes
        .map(|b| u32::from_be_bytes([b[0], b[1], b[2], b[3]]).into())
        .collect();
    let [x, y, x_from, y_from, tile_x, tile_y, ..] = sizes[..] else {
        return Err(no_stream());
    };
    let (columns, rows) = (x.saturating_sub(x_from), y.saturating_sub(y_from));
    if (columns, rows) != (format.columns.into(), format.rows.into()) {
        let why = format!("{columns} x {rows} compressed samples, expected {}", format.describe(1));
        return Err(fault(why));
    }
    if tile_x == 0 || tile_y == 0 || (x.div_ceil(tile_x)).saturating_mul(y.div_ceil(tile_y)) > MAX_TILES {
        return Err(fault(format!(
            "tiles of {tile_x} x {tile_y}, expected at most {MAX_TILES} tiles"
        )));
    }
    let count = usize::from(u16::from_be_bytes([head[COMPONENTS_AT], head[COMPONENTS_AT + 1]]));
    let expected = if format.color == Color::Grey { 1 } else { 3 };
    let components = encoded
        .get(head.len()..head.len() + 3 * expected)
        .ok_or_else(no_stream)?;
    let read = components.chunks_exact(3).map(|one| SizedComponent {
        precision: u32::from(one[0] & 0x7f) + 1,
        signed: one[0] & 0x80 != 0,
    });
    let whole = components.chunks_exact(3).all(|one| one[1..] == [1, 1]);
    let read: Vec<_> = read.collect();
    if count != expected || !whole || read.iter().any(|one| one.precision as usize > 8 * format.bytes) {
        let why = format!(
            "{count} components in JPEG 2000, expected {expected} of all samples and at most {} bits",
            8 * format.bytes
        );
        return Err(fault(why));
    }
    Ok(read)
}

/// Refuses small precincts and code blocks. Each takes some hundred bytes of memory, however few bytes of the stream it has, so
/// that a short stream with the smallest ones would take a gigabyte.
fn check_blocks(stream: &[u8]) -> Result<(), Fault> {
    const TILE: u8 = 0x90;
    const CODING: u8 = 0x52;
    const COMPONENT_CODING: u8 = 0x53;
    const DATA: u8 = 0x93;
    const END: u8 = 0xd9;
    let (mut at, mut tile_end) = (2, stream.len());
    while let Some([0xff, marker, rest @ ..]) = stream.get(at..) {
        match *marker {
            END => return Ok(()),
            DATA if tile_end > at => {
                at = tile_end;
                continue;
            }
            _ => {}
        }
        let [high, low, body @ ..] = rest else { break };
        let length = usize::from(u16::from_be_bytes([*high, *low]));
        if length < 2 {
            break;
        }
        let body = &body[..body.len().min(length - 2)];
        match *marker {
            TILE => {
                let bytes = body
                    .get(2..6)
                    .map_or(0, |b| u32::from_be_bytes([b[0], b[1], b[2], b[3]]) as usize);
                tile_end = if bytes == 0 {
                    stream.len()
                } else {
                    at.saturating_add(bytes)
                };
            }
            CODING => check_style(body.first(), body.get(5..))?,
            COMPONENT_CODING => check_style(body.get(1), body.get(2..))?,
            _ => {}
        }
        at += 2 + length;
    }
    if at < stream.len() {
        return Err(fault("is no JPEG 2000 stream, expected markers"));
    }
    Ok(())
}

/// Checks a coding style. `parameters`: from the number of levels on.
fn check_style(style: Option<&u8>, parameters: Option<&[u8]>) -> Result<(), Fault> {
    /// Exponent of 16 samples, less 2.
    const MIN_BLOCK: u8 = 2;
    /// Exponent of 32 samples.
    const MIN_PRECINCT: u8 = 5;
    let (Some(style), Some([_, width, height, _, _, precincts @ ..])) = (style, parameters) else {
        return Err(fault("is no JPEG 2000 stream, expected a coding style"));
    };
    let small = |precinct: &u8| precinct & 15 < MIN_PRECINCT || precinct >> 4 < MIN_PRECINCT;
    if *width < MIN_BLOCK || *height < MIN_BLOCK || (style & 1 == 1 && precincts.iter().any(small)) {
        return Err(fault(
            "smaller blocks of JPEG 2000 than are read, expected at least 16 x 16, in precincts of 32 x 32",
        ));
    }
    Ok(())
}

/// Decodes JPEG 2000, lossless or lossy.
fn jpeg_2000(encoded: &[u8], format: &SampleFormat) -> Result<(Vec<u8>, Color), Fault> {
    const BEGIN: &[u8] = &[0xff, 0x4f, 0xff, 0x51];
    // Some writers put the stream into a container, which adds nothing to the header.
    let at = encoded.windows(BEGIN.len()).position(|bytes| bytes == BEGIN);
    let encoded = &encoded[at.unwrap_or(0)..];
    let components = sized_components(encoded, format)?;
    check_blocks(encoded)?;
    let failed = |e| fault(format!("is no JPEG 2000 that is read: {e}"));
    let settings = DecodeSettings {
        strict: true,
        ..DecodeSettings::default()
    };
    let image = Image::new(encoded, &settings).map_err(failed)?;
    let mut context = DecoderContext::default();
    let decoded = image.decode(&mut context).map_err(failed)?;
    let mut frame = Vec::new();
    for (component, of) in decoded.components().iter().zip(&components) {
        // The library treats all components as unsigned.
        let middle = if of.signed { 1i64 << (of.precision - 1) } else { 0 };
        for sample in component.samples() {
            let stored = sample.round_ties_even() as i64 - middle;
            frame.extend(&stored.to_le_bytes()[..format.bytes]);
        }
    }
    if frame.len() as u64 != format.frame_bytes() {
        let why = format!("{} decoded bytes, expected {}", frame.len(), format.describe(1));
        return Err(fault(why));
    }
    Ok((frame, planes(format.color)))
}

#[cfg(test)]
mod tests {
    use super::super::samples::Kind;
    use super::*;

    fn bytes(columns: u32) -> SampleFormat {
        SampleFormat {
            columns,
            rows: 1,
            bytes: 1,
            kind: Kind::Float,
            color: Color::Grey,
            padding: None,
        }
    }

    /// A frame of one segment of run lengths behind its table.
    fn run_length_frame(packed: &[u8]) -> Vec<u8> {
        let mut frame = vec![0; 64];
        (frame[0], frame[4]) = (1, 64);
        frame.extend(packed);
        frame
    }

    #[test]
    fn runs_copies_and_fillers_are_unpacked() {
        // Two literal bytes, a filler, three times 7, and padding.
        let frame = run_length_frame(&[1, 5, 6, 128, 254, 7, 0]);
        assert_eq!(run_lengths(&frame, &bytes(5)).unwrap().0, [5, 6, 7, 7, 7]);
        // A run that exceeds the last sample.
        assert_eq!(run_lengths(&frame, &bytes(4)).unwrap().0, [5, 6, 7, 7]);
        let error = run_lengths(&frame, &bytes(6)).unwrap_err();
        assert!(error.why.contains("lacks 1 of 6 bytes"), "{}", error.why);
    }

    #[test]
    fn segments_outside_of_the_fragment_are_refused() {
        let mut frame = run_length_frame(&[0, 1]);
        frame[4] = 200;
        assert!(run_lengths(&frame, &bytes(2)).unwrap_err().why.contains("outside"));
        assert!(
            run_lengths(&frame, &bytes(60_000))
                .unwrap_err()
                .why
                .contains("cannot hold")
        );
    }

    #[test]
    fn small_blocks_are_refused() {
        let stream = |block: u8, precinct: u8| {
            let style = [1, 0, 0, 1, 0, 1, block, block, 0, 1, precinct, precinct];
            [&[0xff, 0x4f, 0xff, 0x52, 0, 14][..], &style, &[0xff, 0xd9]].concat()
        };
        assert!(check_blocks(&stream(4, 0x77)).is_ok());
        for (block, precinct) in [(1, 0x77), (4, 0x17), (4, 0x71), (4, 0)] {
            let error = check_blocks(&stream(block, precinct)).unwrap_err();
            assert!(error.why.contains("smaller blocks"), "{}", error.why);
        }
    }
}
