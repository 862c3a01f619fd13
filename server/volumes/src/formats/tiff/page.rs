//! One page: the image that a directory describes, and reading its samples.

use std::io::{BufReader, Read, Seek, SeekFrom};

use tiff::decoder::{Decoder, DecodingResult, Limits};

use super::super::super::location::{Blob, BlobReader};
use super::super::super::stored::{DEFLATE_RATIO, Endian, StoredType};
use super::directory::{Directory, Header, tag};

/// Properties that all pages of a volume share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Image {
    pub width: u32,
    pub height: u32,
    pub stored: StoredType,
    /// Number of samples of a pixel.
    pub samples: u16,
    /// Whether they are red, green and blue.
    pub is_rgb: bool,
}

/// One page.
#[derive(Clone, Copy, Debug)]
pub struct Page {
    pub image: Image,
    /// Offset of its directory.
    pub directory: u64,
    /// Offset of its samples, if they are contiguous in the file and need no decoding.
    pub plain: Option<u64>,
    /// Whether each component of the pixels is in a plane of its own.
    pub is_planar: bool,
    /// Whether 0 is shown white. The samples stay as they are stored; the library inverts them, which is undone.
    pub is_white_zero: bool,
    /// The wider page that is decoded in its place, if the library cannot decode the page itself.
    pub whole: Option<WholeTiles>,
    pub header: Header,
}

/// A page as wide as its whole tiles. The library cannot decode tiles in LZW that extend beyond the page
/// (<https://github.com/image-rs/image-tiff/issues/395>).
#[derive(Clone, Copy, Debug)]
pub struct WholeTiles {
    width: u32,
    /// Offset of the image's width in the file, and the number of bytes of that entry.
    place: (u64, usize),
}

impl WholeTiles {
    /// Maximum bytes that are decoded in the place of a small page; for larger pages twice their size.
    const MAX_BYTES: u64 = 16 << 20;

    fn of(directory: &Directory<'_>, image: &Image, compression: u64) -> Result<Option<Self>, String> {
        let across = directory.number(tag::TILE_WIDTH, 0)?;
        let is_planar = directory.number(tag::PLANAR_CONFIGURATION, 1)? == 2;
        let Some(place) = directory.place_of(tag::IMAGE_WIDTH) else {
            return Ok(None);
        };
        if compression != 5 || across == 0 || is_planar {
            return Ok(None);
        }
        let width = u64::from(image.width);
        let whole = width.div_ceil(across).saturating_mul(across);
        if whole == width || whole >= 1 << (8 * place.1).min(31) {
            return Ok(None);
        }
        let tiles = Self {
            width: whole as u32,
            place,
        };
        let limit = image
            .bytes()
            .map_or(0, |bytes| bytes.saturating_mul(2).max(Self::MAX_BYTES));
        Ok((tiles.bytes(image) <= limit).then_some(tiles))
    }

    /// Returns the decoded bytes.
    fn bytes(self, image: &Image) -> u64 {
        let wide = Image {
            width: self.width,
            ..*image
        };
        wide.bytes().unwrap_or(u64::MAX)
    }

    /// Cuts the rows of the page out of the wider ones.
    fn crop(self, image: &Image, samples: Vec<u8>) -> Vec<u8> {
        let wide = samples.len() / image.height as usize;
        let row = wide / self.width as usize * image.width as usize;
        samples
            .chunks_exact(wide.max(1))
            .flat_map(|wide| &wide[..row])
            .copied()
            .collect()
    }
}

impl Image {
    /// Returns the bytes of a page; `None` above 64 bits.
    pub fn bytes(&self) -> Option<u64> {
        (u64::from(self.width) * u64::from(self.height)).checked_mul(u64::from(self.samples) * self.stored.bytes())
    }

    pub fn describe(&self) -> String {
        let Self {
            width,
            height,
            samples,
            stored,
            ..
        } = self;
        format!("{width} x {height} pixels of {samples} {}", stored.name())
    }
}

impl Page {
    /// Checks a page; `None` for a copy in a lower resolution, or a mask. `file_bytes` is the file's length.
    pub fn read(directory: &Directory<'_>, header: Header, file_bytes: u64) -> Result<Option<Self>, String> {
        if directory.number(tag::NEW_SUBFILE_TYPE, 0)? & 0b101 != 0 {
            return Ok(None);
        }
        check_counts(directory)?;
        let size = |tag: u16, name: &str| match directory.number(tag, 0)? {
            size @ 1..=0x7fff_ffff => Ok(size as u32),
            size => Err(format!("{name} is {size}, expected 1 to 2147483647")),
        };
        let image = Image {
            width: size(tag::IMAGE_WIDTH, "ImageWidth")?,
            height: size(tag::IMAGE_LENGTH, "ImageLength")?,
            stored: stored_type(directory)?,
            samples: u16::try_from(directory.number(tag::SAMPLES_PER_PIXEL, 1)?).unwrap_or(0),
            is_rgb: directory.number(tag::PHOTOMETRIC, 1)? == 2,
        };
        let chunks = Chunks::read(directory, &image)?;
        let compression = directory.number(tag::COMPRESSION, 1)?;
        check(directory, &image, &chunks, compression, file_bytes)?;
        let is_plain = compression == 1
            && image.samples == 1
            && chunks.are_rows
            && directory.number(tag::PREDICTOR, 1)? == 1
            && chunks.bytes.iter().try_fold(0, |n: u64, bytes| n.checked_add(*bytes)) == image.bytes();
        Ok(Some(Self {
            image,
            directory: directory.offset,
            plain: chunks.begin().filter(|_| is_plain),
            is_planar: directory.number(tag::PLANAR_CONFIGURATION, 1)? == 2,
            is_white_zero: directory.number(tag::PHOTOMETRIC, 1)? == 0,
            whole: WholeTiles::of(directory, &image, compression)?,
            header,
        }))
    }

    /// Returns the samples of the page as they are stored, and their byte order. Of an RGB page, samples beside the colours may be
    /// left out.
    pub fn samples(&self, blob: &Blob<'_>) -> Result<(Vec<u8>, Endian), String> {
        // The size was checked when the page was opened.
        let bytes = self.image.bytes().unwrap_or(u64::MAX);
        if let Some(begin) = self.plain {
            let mut samples = vec![0; usize::try_from(bytes).map_err(|e| e.to_string())?];
            let read = blob.read_exact_at(&mut samples, begin);
            read.map_err(|_| format!("{bytes} bytes at {begin} lie behind the end of the file"))?;
            return Ok((samples, self.header.endian));
        }
        let expected = self.image.describe();
        let mut decoder = Decoder::new(BufReader::new(OnePage::new(self, blob))).map_err(|e| e.to_string())?;
        let mut limits = Limits::default();
        limits.decoding_buffer_size = self.whole.map_or(bytes, |whole| whole.bytes(&self.image)) as usize;
        limits.intermediate_buffer_size = usize::try_from(blob.len()).unwrap_or(usize::MAX);
        decoder = decoder.with_limits(limits);
        let mut samples = DecodingResult::U8(Vec::new());
        let decoded = decoder.read_image_to_buffer(&mut samples);
        decoded.map_err(|e| format!("{e}, expected {expected}"))?;
        let mut samples = samples.as_buffer(0).as_bytes().to_vec();
        if let Some(whole) = self.whole {
            samples = whole.crop(&self.image, samples);
        }
        let colours = bytes / u64::from(self.image.samples) * 3;
        if samples.len() as u64 != bytes && !(self.image.is_rgb && samples.len() as u64 == colours) {
            return Err(format!("{} bytes, expected {bytes}: {expected}", samples.len()));
        }
        if self.is_white_zero {
            samples.iter_mut().for_each(|byte| *byte = !*byte);
        }
        Ok((samples, Endian::NATIVE))
    }
}

/// Limits the counts of tags: the library allocates 32 bytes for each value that a tag claims, before it checks that the file has them.
fn check_counts(directory: &Directory<'_>) -> Result<(), String> {
    let once = [
        tag::IMAGE_WIDTH,
        tag::IMAGE_LENGTH,
        tag::COMPRESSION,
        tag::PHOTOMETRIC,
        tag::SAMPLES_PER_PIXEL,
        tag::ROWS_PER_STRIP,
        tag::PLANAR_CONFIGURATION,
        tag::PREDICTOR,
        tag::TILE_WIDTH,
        tag::TILE_LENGTH,
    ];
    let each_sample = [tag::BITS_PER_SAMPLE, tag::EXTRA_SAMPLES, tag::SAMPLE_FORMAT];
    let samples = directory.number(tag::SAMPLES_PER_PIXEL, 1)?;
    once.iter().try_for_each(|&tag| directory.check_max_values(tag, 1))?;
    each_sample
        .iter()
        .try_for_each(|&tag| directory.check_max_values(tag, samples))?;
    directory.check_max_values(tag::CHROMA_SUBSAMPLING, 2)
}

fn stored_type(directory: &Directory<'_>) -> Result<StoredType, String> {
    let bits = directory.numbers(tag::BITS_PER_SAMPLE)?;
    let formats = directory.numbers(tag::SAMPLE_FORMAT)?;
    let same = |values: &[u64]| values.windows(2).all(|pair| pair[0] == pair[1]);
    let (first, format) = (
        bits.first().copied().unwrap_or(1),
        formats.first().copied().unwrap_or(1),
    );
    Ok(match (first, format) {
        _ if !same(&bits) || !same(&formats) => return Err("samples of several types, expected one".into()),
        (8, 1 | 4) => StoredType::U8,
        (8, 2) => StoredType::I8,
        (16, 1 | 4) => StoredType::U16,
        (16, 2) => StoredType::I16,
        (32, 1 | 4) => StoredType::U32,
        (32, 2) => StoredType::I32,
        (64, 1 | 4) => StoredType::U64,
        (64, 2) => StoredType::I64,
        (16, 3) => StoredType::F16,
        (32, 3) => StoredType::F32,
        (64, 3) => StoredType::F64,
        _ => {
            let kind = ["integers", "integers with a sign", "floats"]
                .get((format as usize).wrapping_sub(1))
                .unwrap_or(&"samples");
            return Err(format!(
                "{kind} of {first} bits, expected integers of 8 to 64 bits, or floats of 16 to 64"
            ));
        }
    })
}

/// Strips or tiles.
struct Chunks {
    offsets: Vec<u64>,
    bytes: Vec<u64>,
    /// Whether the chunks, one after another, are the page: strips of one plane.
    are_rows: bool,
    /// Decoded bytes of a chunk.
    decoded: Option<u64>,
}

impl Chunks {
    fn read(directory: &Directory<'_>, image: &Image) -> Result<Self, String> {
        let planes = match directory.number(tag::PLANAR_CONFIGURATION, 1)? {
            1 => 1,
            2 => u64::from(image.samples),
            other => return Err(format!("PlanarConfiguration is {other}, expected 1 or 2")),
        };
        let [width, height] = [image.width, image.height].map(u64::from);
        let tile = [tag::TILE_WIDTH, tag::TILE_LENGTH].map(|tag| directory.number(tag, 0));
        let (offsets, counts, across, rows, are_rows) = match tile {
            [Ok(0), _] => {
                let rows = directory.number(tag::ROWS_PER_STRIP, height)?.min(height);
                (tag::STRIP_OFFSETS, tag::STRIP_BYTE_COUNTS, width, rows, planes == 1)
            }
            [across, rows] => (tag::TILE_OFFSETS, tag::TILE_BYTE_COUNTS, across?, rows?, false),
        };
        if across == 0 || rows == 0 {
            return Err(format!("chunks of {across} x {rows} pixels, expected at least one"));
        }
        let expected = width
            .div_ceil(across)
            .checked_mul(height.div_ceil(rows))
            .and_then(|n| n.checked_mul(planes))
            .ok_or_else(|| format!("chunks of {across} x {rows} pixels, expected fewer of them"))?;
        directory.check_max_values(offsets, expected)?;
        directory.check_max_values(counts, expected)?;
        let (offsets, bytes) = (directory.numbers(offsets)?, directory.numbers(counts)?);
        let found = [offsets.len(), bytes.len()];
        if found.map(|n| n as u64) != [expected; 2] {
            let [offsets, bytes] = found;
            return Err(format!(
                "{offsets} offsets and {bytes} lengths of strips or tiles, expected {expected} of each"
            ));
        }
        Ok(Self {
            offsets,
            bytes,
            are_rows,
            decoded: across
                .checked_mul(rows)
                .and_then(|n| n.checked_mul(u64::from(image.samples) * image.stored.bytes())),
        })
    }

    /// Returns the offset of the first chunk, if each chunk begins at the end of the one before.
    fn begin(&self) -> Option<u64> {
        let ends = self
            .offsets
            .iter()
            .zip(&self.bytes)
            .map(|(offset, bytes)| offset.saturating_add(*bytes));
        let follow = ends.zip(&self.offsets[1..]).all(|(end, next)| end == *next);
        follow.then(|| self.offsets[0])
    }
}

/// Compares what a page claims with the file, before anything is decoded.
fn check(
    directory: &Directory<'_>,
    image: &Image,
    chunks: &Chunks,
    compression: u64,
    file_bytes: u64,
) -> Result<(), String> {
    let photometric = directory.number(tag::PHOTOMETRIC, 1)?;
    check_colours(photometric, image)?;
    if photometric == 0 && !image.stored.is_whole() && compression != 1 {
        return Err("compressed floats in which 0 is white, expected BlackIsZero".into());
    }
    let have = chunks.bytes.iter().fold(0u64, |n, bytes| n.saturating_add(*bytes));
    let have = have.min(file_bytes);
    let reach = have.saturating_mul(ratio(compression)?);
    // The tile of a small image may be larger than the image.
    let is_too_much = |bytes: Option<u64>, limit: u64| bytes.is_none_or(|bytes| bytes > limit);
    if is_too_much(image.bytes(), reach) || is_too_much(chunks.decoded, reach.max(1 << 20)) {
        return Err(format!(
            "{have} bytes of samples, which cannot hold {}",
            image.describe()
        ));
    }
    Ok(())
}

fn check_colours(photometric: u64, image: &Image) -> Result<(), String> {
    match (photometric, image.samples) {
        (0 | 3, 1) | (1, 1..) | (2, 3..) => Ok(()),
        (_, samples) => {
            let names = [
                "WhiteIsZero",
                "grey",
                "RGB",
                "palette",
                "mask",
                "CMYK",
                "YCbCr",
                "",
                "CIELab",
            ];
            let name = names.get(photometric as usize).copied().unwrap_or_default();
            let expected = "expected grey or channels, RGB of 3 or more, or a palette of 1";
            Err(format!(
                "PhotometricInterpretation {photometric} {name} with {samples} samples, {expected}"
            ))
        }
    }
}

/// Returns the maximum number of bytes that a byte of this compression decodes to.
fn ratio(compression: u64) -> Result<u64, String> {
    Ok(match compression {
        1 => 1,
        // A code of 12 bits stands for at most 4096 bytes.
        5 => 4096 * 8 / 12,
        8 | 0x80b2 => DEFLATE_RATIO,
        0x8005 => 64,
        other => {
            let name = match other {
                6 | 7 => "JPEG",
                34712 => "JPEG 2000",
                34887 => "LERC",
                34925 => "LZMA",
                50000 => "Zstandard",
                50001 => "WebP",
                _ => "without a name",
            };
            return Err(format!(
                "compression {other} ({name}), expected none, LZW, deflate or PackBits"
            ));
        }
    })
}

/// The file, presented as if the page were its first one: the library reads the first page without the others.
struct OnePage<'a> {
    head: Vec<u8>,
    /// Bytes that replace those of the file at an offset.
    other: Option<(u64, Vec<u8>)>,
    file: BlobReader<'a>,
    at: u64,
}

impl<'a> OnePage<'a> {
    fn new(page: &Page, blob: &'a Blob<'a>) -> Self {
        let Header { endian, is_big, .. } = page.header;
        let (version, offset): (&[u16], usize) = if is_big { (&[43, 8, 0], 8) } else { (&[42], 4) };
        let bytes = |value: u64, width: usize| {
            let mut bytes = value.to_le_bytes()[..width].to_vec();
            if endian == Endian::Big {
                bytes.reverse();
            }
            bytes
        };
        let mark: &[u8] = if endian == Endian::Big { b"MM" } else { b"II" };
        let mut head = mark.to_vec();
        head.extend(version.iter().flat_map(|&n| bytes(u64::from(n), 2)));
        head.extend(bytes(page.directory, offset));
        let width = |whole: WholeTiles| (whole.place.0, bytes(u64::from(whole.width), whole.place.1));
        Self {
            head,
            other: page.whole.map(width),
            file: blob.reader(0),
            at: 0,
        }
    }
}

impl OnePage<'_> {
    fn replace_in(&self, read: &mut [u8]) {
        let Some((begin, bytes)) = &self.other else { return };
        for (at, byte) in (*begin..).zip(bytes) {
            let place = at.checked_sub(self.at).and_then(|at| read.get_mut(at as usize));
            if let Some(place) = place {
                *place = *byte;
            }
        }
    }
}

impl Read for OnePage<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let inside = usize::try_from(self.at)
            .ok()
            .and_then(|at| self.head.get(at..))
            .unwrap_or_default();
        let n = if inside.is_empty() {
            self.file.seek(SeekFrom::Start(self.at))?;
            let n = self.file.read(buffer)?;
            self.replace_in(&mut buffer[..n]);
            n
        } else {
            let n = inside.len().min(buffer.len());
            buffer[..n].copy_from_slice(&inside[..n]);
            n
        };
        self.at += n as u64;
        Ok(n)
    }
}

impl Seek for OnePage<'_> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.at = match to {
            SeekFrom::Current(by) => self.at.checked_add_signed(by).ok_or(std::io::ErrorKind::InvalidInput)?,
            to => self.file.seek(to)?,
        };
        Ok(self.at)
    }
}
