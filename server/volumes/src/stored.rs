//! What a header says about the samples in a file, checked against the file's length.
//!
//! Headers are not trusted. Before anything is allocated the claimed size is compared with the file's length: exactly for plain samples,
//! by the maximum ratio of deflate for compressed ones. `decode` then reads the samples.

use isopeel_kernels::SampleType;

pub(super) use super::codec::DEFLATE_RATIO;
pub use super::codec::{Encoding, Endian};
use super::{FileLocation, Findings, Geometry, ReadError};

/// Type of a sample in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[expect(missing_docs, reason = "u, i or f and the width in bits")]
pub enum StoredType {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F16,
    F32,
    F64,
}

impl StoredType {
    /// Every type, for tests and messages.
    pub const ALL: [Self; 11] = [
        Self::U8,
        Self::I8,
        Self::U16,
        Self::I16,
        Self::U32,
        Self::I32,
        Self::U64,
        Self::I64,
        Self::F16,
        Self::F32,
        Self::F64,
    ];

    /// Whether all of its values are whole numbers.
    pub const fn is_whole(self) -> bool {
        !matches!(self, Self::F16 | Self::F32 | Self::F64)
    }

    /// Returns the bytes of one sample.
    pub const fn bytes(self) -> u64 {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 | Self::F16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// Returns the short name, as in the raw sidecar.
    pub const fn name(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::I8 => "i8",
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::U32 => "u32",
            Self::I32 => "i32",
            Self::U64 => "u64",
            Self::I64 => "i64",
            Self::F16 => "f16",
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }

    /// Returns the type on the device, for values that are not scaled.
    pub const fn on_device(self) -> SampleType {
        match self {
            Self::U8 => SampleType::U8,
            Self::I8 => SampleType::I8,
            Self::U16 => SampleType::U16,
            Self::I16 => SampleType::I16,
            _ => SampleType::F32,
        }
    }
}

/// Maximum bytes behind the last sample that are ignored, such as block devices and editors leave.
pub(super) const MAX_PADDING: u64 = 1 << 20;

/// Whether bytes are zeros or white space.
pub(super) fn is_blank(bytes: &[u8]) -> bool {
    bytes.iter().all(|byte| *byte == 0 || byte.is_ascii_whitespace())
}

/// Position in the file at which samples begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begin {
    /// At this offset, in bytes of the file itself.
    At(u64),
    /// Right before the end of the file. Plain samples only.
    BeforeEnd,
}

/// Samples of one field in a file, all time steps.
#[derive(Clone, Debug)]
pub struct StoredSamples {
    /// The file with the samples.
    pub location: FileLocation,
    /// Length of that file when its header was read, in bytes.
    pub file_bytes: u64,
    /// Position of the first sample.
    pub begin: Begin,
    /// Offset of the first byte behind the samples, if something else follows in the file.
    pub end: Option<u64>,
    /// Bytes to skip after decoding.
    pub skip_decoded: u64,
    /// How the samples are written.
    pub encoding: Encoding,
    /// Byte order.
    pub endian: Endian,
    /// Type.
    pub stored: StoredType,
    /// Value = `scale[0]` · stored + `scale[1]`, if the file has a scale other than the identity.
    pub scale: Option<[f64; 2]>,
    /// Samples along x, y, z.
    pub dims: [u32; 3],
    /// Time steps.
    pub steps: u32,
    /// Distance in samples between neighbours along x, y, z and time.
    pub strides: [u64; 4],
    /// Number of channels of the array. Samples of the other channels are skipped.
    pub channels: u32,
    /// Number of samples before the first one of this field.
    pub first: u64,
    /// Distance in samples between red, green and blue, if the value is their luminance.
    pub luminance: Option<u64>,
    /// Findings about the file and its samples.
    pub findings: Findings,
}

/// Returns the strides of an order with x fastest, then y, z, time; `None` if the product exceeds 64 bits.
pub fn contiguous(dims: [u32; 3], steps: u32) -> Option<[u64; 4]> {
    let [x, y, z] = dims.map(u64::from);
    let plane = x.checked_mul(y)?;
    let volume = plane.checked_mul(z)?;
    volume.checked_mul(u64::from(steps))?.checked_mul(8)?;
    Some([1, x, plane, volume])
}

impl StoredSamples {
    /// Describes plain little-endian samples, x fastest; the caller sets all other values afterwards. `size_field` is the header's field
    /// that holds the dimensions.
    ///
    /// # Errors
    /// The file cannot be opened, or the number of samples passes 64 bits.
    pub fn new(
        location: &FileLocation,
        begin: Begin,
        stored: StoredType,
        geometry: &Geometry,
        steps: u32,
        size_field: &str,
    ) -> Result<Self, ReadError> {
        let file_bytes = location.open_stored()?.len();
        let strides = contiguous(geometry.dims, steps).ok_or_else(|| {
            let why = format!("{:?} samples and {steps} steps pass 64 bits", geometry.dims);
            ReadError::new(location.path(), size_field, why)
        })?;
        Ok(Self {
            location: location.clone(),
            file_bytes,
            begin,
            end: None,
            skip_decoded: 0,
            encoding: Encoding::Raw,
            endian: Endian::Little,
            stored,
            scale: None,
            dims: geometry.dims,
            steps,
            strides,
            channels: 1,
            first: 0,
            luminance: None,
            findings: Findings::default(),
        })
    }

    /// Selects one of several channels, whose samples are side by side at each position: `channels` samples apart along x.
    ///
    /// # Errors
    /// The number of samples passes 64 bits.
    pub fn interleaved(mut self, channels: u32, size_field: &str) -> Result<Self, ReadError> {
        self = self.with_channels(channels, size_field)?;
        self.strides = self.strides.map(|stride| stride * u64::from(channels));
        Ok(self)
    }

    /// Selects the first of several channels; leaves the strides as they are.
    ///
    /// # Errors
    /// The number of samples passes 64 bits.
    pub fn with_channels(mut self, channels: u32, size_field: &str) -> Result<Self, ReadError> {
        let bytes = self.total_samples().checked_mul(u64::from(channels));
        if bytes.and_then(|n| n.checked_mul(8)).is_none() {
            let why = format!("{} in {channels} channels pass 64 bits", self.describe());
            return Err(ReadError::new(self.location.path(), size_field, why));
        }
        self.channels = channels;
        Ok(self)
    }

    /// Returns the type on the device.
    pub fn sample_type(&self) -> SampleType {
        match (self.scale, self.luminance) {
            (None, None) => self.stored.on_device(),
            _ => SampleType::F32,
        }
    }

    /// Returns the number of samples of all channels and steps.
    pub(super) fn array_samples(&self) -> u64 {
        self.total_samples() * u64::from(self.channels)
    }

    /// Returns the encoding of a compressed file of plain samples, which is decoded as a stream from its first byte.
    pub(super) fn packing(&self) -> Option<Encoding> {
        self.location.packing().filter(|_| self.encoding == Encoding::Raw)
    }

    /// Returns the offset of the first byte behind the samples: `end`, else the file's length. The length of a compressed file is unknown
    /// before it is decoded: [`u64::MAX`].
    pub(super) fn end(&self) -> u64 {
        let length = self.location.packing().map_or(self.file_bytes, |_| u64::MAX);
        self.end.unwrap_or(length)
    }

    pub(super) fn step_samples(&self) -> u64 {
        self.dims.iter().map(|&n| u64::from(n)).product()
    }

    pub(super) fn total_samples(&self) -> u64 {
        self.step_samples() * u64::from(self.steps)
    }

    pub(super) fn describe(&self) -> String {
        let [x, y, z] = self.dims;
        let several = |n: u32, what: &str| match n {
            1 => String::new(),
            n => format!(" x {n} {what}"),
        };
        let (steps, channels) = (several(self.steps, "steps"), several(self.channels, "channels"));
        format!("{x} x {y} x {z}{steps}{channels} samples of {}", self.stored.name())
    }

    /// As [`Self::check`], for samples whose number only the file's length confirms.
    ///
    /// # Errors
    /// The file is too short, or plain and too long; the message names `header_field`.
    pub fn check_exactly(&self, header_field: &str) -> Result<(), ReadError> {
        self.check(header_field)?;
        match self.excess() {
            0 => Ok(()),
            more => {
                let what = self.describe();
                let have = self.file_bytes;
                Err(self.error(format!(
                    "{have} bytes, {more} more than expected: {header_field} says {what}"
                )))
            }
        }
    }

    /// Returns the number of bytes behind the last of plain samples.
    fn excess(&self) -> u64 {
        match (self.encoding, self.begin) {
            (Encoding::Raw, Begin::At(begin)) if self.packing().is_none() => {
                let needed = (self.array_samples() * self.stored.bytes()).saturating_add(self.skip_decoded);
                self.end().saturating_sub(begin).saturating_sub(needed)
            }
            _ => 0,
        }
    }

    /// Compares what the header claims with the file's length, without reading a sample. Bytes behind the last sample give a notice.
    ///
    /// # Errors
    /// The file is too short; the message names `header_field`.
    pub fn check(&self, header_field: &str) -> Result<(), ReadError> {
        let fail = |why: String| Err(self.error(why));
        let claimed = self.array_samples() * self.stored.bytes();
        if let Some(packing) = self.packing() {
            return self.check_packed(packing, header_field);
        }
        let end = self.end();
        if end > self.file_bytes && self.location.packing().is_none() {
            return fail(format!(
                "the file has {} bytes, its samples should end at {end}",
                self.file_bytes
            ));
        }
        let begin = match self.begin {
            Begin::At(offset) => offset,
            Begin::BeforeEnd => end.saturating_sub(claimed),
        };
        let Some(have) = end.checked_sub(begin) else {
            return fail(format!("the file has {end} bytes, its samples should begin at {begin}"));
        };
        let needed = claimed.saturating_add(self.skip_decoded);
        let what = self.describe();
        match (self.encoding, self.encoding.max_ratio()) {
            (Encoding::Raw, _) if have < needed => {
                fail(format!("{have} bytes, expected {needed}: {header_field} says {what}"))
            }
            (Encoding::Raw, _) if have > needed && !self.is_padding(begin + needed, have - needed) => fail(format!(
                "{have} bytes, {} more than expected: {header_field} says {what}",
                have - needed
            )),
            (Encoding::Raw, _) if have > needed => {
                let more = have - needed;
                let bytes = if more == 1 { "byte" } else { "bytes" };
                let notice =
                    format!("passed over: {more} {bytes} behind the last sample, as {header_field} says {what}");
                self.findings.report(self.location.path(), notice);
                Ok(())
            }
            // One more: the last number needs no space behind it.
            (Encoding::Text, _) if have.div_ceil(2) < self.array_samples() => fail(format!(
                "{have} bytes of text, expected at least {}: {header_field} says {what}",
                2 * self.array_samples()
            )),
            (_, Some(ratio)) if have.saturating_mul(ratio) < needed => fail(format!(
                "{have} compressed bytes cannot hold the {needed} expected: {header_field} says {what}"
            )),
            _ => Ok(()),
        }
    }

    /// Whether bytes behind the last sample are padding: fewer than the samples have, or zeros. Else they may be samples that the header
    /// denies.
    fn is_padding(&self, at: u64, bytes: u64) -> bool {
        if self.end.is_some() || self.begin == Begin::BeforeEnd {
            return false;
        }
        let is_less = bytes < self.array_samples() * self.stored.bytes();
        bytes <= MAX_PADDING && (is_less || self.has_zeros(at, bytes))
    }

    fn has_zeros(&self, at: u64, bytes: u64) -> bool {
        let mut rest = vec![0; bytes as usize];
        let read = self
            .location
            .open_stored()
            .map(|blob| blob.read_exact_at(&mut rest, at));
        matches!(read, Ok(Ok(()))) && is_blank(&rest)
    }

    /// As [`Self::check`], for a compressed file of plain samples.
    fn check_packed(&self, packing: Encoding, header_field: &str) -> Result<(), ReadError> {
        let Begin::At(begin) = self.begin else {
            return Err(self.error("samples of a compressed file cannot be counted from its end"));
        };
        let claimed = self.array_samples() * self.stored.bytes();
        let needed = claimed.saturating_add(self.skip_decoded).saturating_add(begin);
        let (have, what) = (self.file_bytes, self.describe());
        if self.end.is_some_and(|end| end != needed) {
            let found = self.end().saturating_sub(begin);
            let why = format!("{found} bytes, expected {claimed}: {header_field} says {what}");
            return Err(self.error(why));
        }
        if have.saturating_mul(packing.max_ratio().unwrap_or(1)) < needed {
            let why = format!("{have} compressed bytes cannot hold the {needed} expected: {header_field} says {what}");
            return Err(self.error(why));
        }
        Ok(())
    }

    pub(super) fn error(&self, why: impl Into<String>) -> ReadError {
        ReadError::new(self.location.path(), "data", why)
    }

    pub(super) fn io(&self, error: std::io::Error) -> ReadError {
        let why = match error.kind() {
            std::io::ErrorKind::UnexpectedEof => format!("ends too early, expected {}", self.describe()),
            std::io::ErrorKind::InvalidData | std::io::ErrorKind::InvalidInput => {
                format!("cannot be decoded: {error}")
            }
            _ => "cannot be read".to_owned(),
        };
        ReadError::io(self.location.path(), "data", why, error)
    }
}
