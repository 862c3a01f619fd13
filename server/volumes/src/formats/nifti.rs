//! NIfTI-1 and NIfTI-2 (<https://nifti.nimh.nih.gov/nifti-1>, <https://nifti.nimh.nih.gov/nifti-2>): `.nii`, and `.hdr`
//! with its samples in an `.img` file.
//!
//! Read: every integer type and both floating-point types, colours (as luminance), `scl_slope` and `scl_inter` (values
//! become f32), the affine of `sform`, else of `qform`, else `pixdim` alone; the fourth axis as time steps, the fifth
//! as channels. The world of `sform` and `qform` is RAS. The format has no missing value. Refused with the reason:
//! complex types, more than five axes. Repaired with a notice: an `sform` that describes no grid, distances below or equal to 0, `bitpix`,
//! no `vox_offset`. Headers of Analyze are read by [`analyze`](super::analyze).

use std::path::Path;

use super::super::stored::{Begin, Encoding, Endian, StoredSamples, StoredType};
use super::super::{FileLocation, Frame, Geometry, LengthUnit, Notices, OpenedFile, ReadError, TimeAxis};
use super::header::{self, Channels, FieldHead, GridFields, MAX_CHANNELS, not_3d};
use super::pair::{Bytes, header_of_pair, image_of_pair};

/// Bytes of the headers of both versions.
const HEADER_BYTES: [usize; 2] = [348, 540];

/// Meanings of the fifth axis.
/// Values are labels.
const INTENT_LABEL: i32 = 1002;
const INTENT_DISPLACEMENT: i32 = 1006;
const INTENT_VECTOR: i32 = 1007;
const INTENT_RGB: [i32; 2] = [2003, 2004];

/// Reads the header of a NIfTI file.
///
/// # Errors
/// What is wrong with it, by field.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    // A file may be compressed whatever its name states.
    if location.packing().is_none() && location.open()?.head(2)? == [0x1f, 0x8b] {
        return open(&location.clone().packed(Encoding::Deflate));
    }
    let path = location.path();
    let head = location.open()?.head(HEADER_BYTES[1])?;
    let is_image = location.stored_name().ends_with(".img");
    if is_image && !super::content::is_nifti(&head) {
        return open(&header_of_pair(location)?);
    }
    if let Some(bytes) = analyze_header(&head) {
        return super::analyze::open(location, &bytes);
    }
    let header = Header::parse(path, &head)?;
    let shape = header.shape(path)?;
    let mut notices = Notices::default();
    let stored = stored_type(path, &header, &mut notices)?;
    let mut geometry = header.geometry(path, shape.dims, &mut notices)?;
    // A patient's lengths are in millimetres unless the file states another unit.
    let usual = geometry.frame.is_anatomical().then_some(LengthUnit::Millimetre);
    geometry.unit = length_unit(header.xyzt_units).or(usual);
    let (data, begin) = header.samples_begin(location, &mut notices)?;
    let mut samples = StoredSamples::new(&data, begin, stored.stored, &geometry, shape.steps, "dim")?;
    samples.endian = header.endian;
    let name = location.stem();
    let (samples, distance, channels) = if stored.colours > 1 {
        if shape.channels > 1 {
            let why = format!(
                "{} colours a sample, expected numbers in so many channels",
                shape.channels
            );
            return Err(ReadError::new(path, "dim", why));
        }
        (samples.interleaved(stored.colours, "dim")?, 1, Channels::Luminance)
    } else {
        samples.scale = header.scale(path)?;
        let distance = samples.total_samples();
        (
            samples.with_channels(shape.channels, "dim")?,
            distance,
            header.channels(&name, shape.channels),
        )
    };
    samples.check("dim")?;
    let like = FieldHead {
        name,
        stored_type: stored.name.to_owned(),
        missing: None,
        unit: None,
    };
    let mut fields = channels.fields(&samples, distance, &like);
    for field in &mut fields {
        field.declares_labels = header.intent == INTENT_LABEL;
    }
    Ok(OpenedFile {
        geometry,
        steps: shape.steps,
        uneven: None,
        axes: None,
        times: header.times(shape.steps),
        fields,
        notices,
    })
}

/// Returns the header of Analyze 7.5, which has the size of NIfTI-1's and no mark.
fn analyze_header(head: &[u8]) -> Option<Bytes<'_>> {
    let orders = [Endian::Little, Endian::Big].into_iter();
    let of = |endian| Bytes { bytes: head, endian };
    let is_analyze = |bytes: &Bytes<'_>| bytes.i32(0) == 348 && head[344..348] == [0; 4];
    (head.len() >= HEADER_BYTES[0]).then(|| orders.map(of).find(is_analyze))?
}

/// The values of a header of either version that are read.
struct Header {
    endian: Endian,
    /// Whether the samples follow the header in the same file.
    is_one_file: bool,
    header_bytes: usize,
    dim: [i64; 8],
    intent: i32,
    datatype: i32,
    bitpix: i32,
    pixdim: [f64; 8],
    vox_offset: f64,
    scl_slope: f64,
    scl_inter: f64,
    xyzt_units: u8,
    time_offset: f64,
    qform: i32,
    sform: i32,
    quaternion: [f64; 3],
    quaternion_offset: [f64; 3],
    rows: [[f64; 4]; 3],
}

impl Header {
    fn parse(path: &Path, head: &[u8]) -> Result<Self, ReadError> {
        let fail = |field: &str, why: String| Err(ReadError::new(path, field, why));
        let Some(first) = head.first_chunk::<4>() else {
            return fail("header", format!("{} bytes, expected {}", head.len(), HEADER_BYTES[0]));
        };
        let sizes = [
            (Endian::Little, i32::from_le_bytes(*first)),
            (Endian::Big, i32::from_be_bytes(*first)),
        ];
        let known = sizes.into_iter().find_map(|(endian, size)| {
            HEADER_BYTES
                .into_iter()
                .find(|&n| n as i32 == size)
                .map(|n| (endian, n))
        });
        let Some((endian, header_bytes)) = known else {
            let why = format!("{}, expected 348 (NIfTI-1) or 540 (NIfTI-2)", sizes[0].1);
            return fail("sizeof_hdr", why);
        };
        if head.len() < header_bytes {
            return fail("header", format!("{} bytes, expected {header_bytes}", head.len()));
        }
        let bytes = Bytes { bytes: head, endian };
        let is_first = header_bytes == HEADER_BYTES[0];
        let magic = &head[if is_first { 344..348 } else { 4..12 }];
        let is_one_file = match magic {
            b"n+1\0" | b"n+2\0\r\n\x1a\n" => true,
            b"ni1\0" | b"ni2\0\r\n\x1a\n" => false,
            other => {
                return fail(
                    "magic",
                    format!("{:?}, expected n+1, ni1, n+2 or ni2", String::from_utf8_lossy(other)),
                );
            }
        };
        Ok(if is_first {
            Self::first_version(&bytes, is_one_file)
        } else {
            Self::second_version(&bytes, is_one_file)
        })
    }

    fn first_version(bytes: &Bytes<'_>, is_one_file: bool) -> Self {
        let [vox_offset, scl_slope, scl_inter] = bytes.f32s(108);
        Self {
            endian: bytes.endian,
            is_one_file,
            header_bytes: HEADER_BYTES[0],
            dim: std::array::from_fn(|i| i64::from(bytes.i16(40 + 2 * i))),
            intent: bytes.i16(68),
            datatype: bytes.i16(70),
            bitpix: bytes.i16(72),
            pixdim: bytes.f32s(76),
            vox_offset,
            scl_slope,
            scl_inter,
            xyzt_units: bytes.bytes[123],
            time_offset: bytes.f32s::<1>(136)[0],
            qform: bytes.i16(252),
            sform: bytes.i16(254),
            quaternion: bytes.f32s(256),
            quaternion_offset: bytes.f32s(268),
            rows: [280, 296, 312].map(|at| bytes.f32s(at)),
        }
    }

    fn second_version(bytes: &Bytes<'_>, is_one_file: bool) -> Self {
        let [scl_slope, scl_inter] = bytes.f64s(176);
        Self {
            endian: bytes.endian,
            is_one_file,
            header_bytes: HEADER_BYTES[1],
            dim: std::array::from_fn(|i| bytes.i64(16 + 8 * i)),
            intent: bytes.i32(504),
            datatype: bytes.i16(12),
            bitpix: bytes.i16(14),
            pixdim: bytes.f64s(104),
            vox_offset: bytes.i64(168) as f64,
            scl_slope,
            scl_inter,
            xyzt_units: bytes.i32(500) as u8,
            time_offset: bytes.f64s::<1>(216)[0],
            qform: bytes.i32(344),
            sform: bytes.i32(348),
            quaternion: bytes.f64s(352),
            quaternion_offset: bytes.f64s(376),
            rows: [400, 432, 464].map(|at| bytes.f64s(at)),
        }
    }

    /// Returns the file with the samples, and the offset at which they begin in it.
    fn samples_begin(
        &self,
        location: &FileLocation,
        notices: &mut Notices,
    ) -> Result<(FileLocation, Begin), ReadError> {
        let path = location.path();
        // At least four bytes follow the header; they state whether extensions follow.
        let minimum = if self.is_one_file { self.header_bytes + 4 } else { 0 };
        let mut offset = self.vox_offset;
        // Other readers take this offset, too, if the writer left it out.
        if self.is_one_file && offset == 0.0 {
            offset = minimum as f64;
            notices.add(format!(
                "vox_offset is 0: samples are taken to begin behind the header, at byte {minimum}"
            ));
        }
        // In the first version a float, exact up to 2^24. No header is longer.
        if !(minimum as f64..=16_777_216.0).contains(&offset) || offset.fract() != 0.0 {
            let why = format!("{offset}, expected a whole number of bytes from {minimum} to 16777216");
            return Err(ReadError::new(path, "vox_offset", why));
        }
        let begin = Begin::At(offset as u64);
        if self.is_one_file {
            return Ok((location.clone(), begin));
        }
        Ok((image_of_pair(location)?, begin))
    }

    fn shape(&self, path: &Path) -> Result<Shape, ReadError> {
        let fail = |why: String| Err(ReadError::new(path, "dim", why));
        let count = self.dim[0];
        if !(3..=7).contains(&count) {
            return Err(not_3d(path, "dim", format!("dim[0] is {count}")));
        }
        let axes = &self.dim[1..=count as usize];
        if let Some((i, n)) = axes
            .iter()
            .enumerate()
            .find(|(_, n)| !(1..=i64::from(u32::MAX)).contains(*n))
        {
            return fail(format!("dim[{}] is {n}, expected 1 to {}", i + 1, u32::MAX));
        }
        if axes[2..].iter().all(|&n| n == 1) {
            return Err(not_3d(
                path,
                "dim",
                format!("{} x {} samples in 2 dimensions", axes[0], axes[1]),
            ));
        }
        if let Some(n) = axes.iter().skip(5).find(|&&n| n > 1) {
            return fail(format!(
                "{n} along a sixth axis or more, expected x, y, z, time and channels"
            ));
        }
        let size = |axis: usize| axes.get(axis).map_or(1, |&n| n as u32);
        let channels = size(4);
        if u64::from(channels) > MAX_CHANNELS {
            return fail(format!("{channels} channels, expected {MAX_CHANNELS} at most"));
        }
        Ok(Shape {
            dims: [0, 1, 2].map(size),
            steps: size(3),
            channels,
        })
    }

    /// Returns the times of the steps, if the file has a unit of time.
    fn times(&self, steps: u32) -> Option<TimeAxis> {
        let unit = match self.xyzt_units & 0x38 {
            8 => "s",
            16 => "ms",
            24 => "µs",
            // None, or that of a spectrum.
            _ => return None,
        };
        TimeAxis::even(self.time_offset, self.pixdim[4], steps, unit).filter(|_| steps > 1)
    }

    /// Returns the meaning of the fifth axis.
    fn channels(&self, name: &str, count: u32) -> Channels {
        match self.intent {
            INTENT_VECTOR | INTENT_DISPLACEMENT => Channels::vector(name, count),
            code if INTENT_RGB.contains(&code) && count >= 3 => Channels::Luminance,
            _ => Channels::numbered(name, count),
        }
    }

    /// A slope of 0 means "no scale"; writers also leave NaN there.
    fn scale(&self, path: &Path) -> Result<Option<[f64; 2]>, ReadError> {
        let (slope, inter) = (self.scl_slope, self.scl_inter);
        if slope.is_nan() || slope == 0.0 || (slope == 1.0 && inter == 0.0) {
            return Ok(None);
        }
        if !slope.is_finite() || !inter.is_finite() {
            let why = format!("slope {slope} and intercept {inter}, expected finite numbers");
            return Err(ReadError::new(path, "scl_slope", why));
        }
        Ok(Some([slope, inter]))
    }

    /// Returns the grid by `sform`, else by `qform`, else by `pixdim` alone. Invalid ones are skipped with a notice.
    fn geometry(&self, path: &Path, dims: [u32; 3], notices: &mut Notices) -> Result<Geometry, ReadError> {
        let mut failed = None;
        if self.sform > 0 {
            match self.by_sform(path, dims) {
                Err(error) if self.is_sform_empty() || self.qform > 0 => failed = Some(error),
                geometry => {
                    self.compare_with_qform(path, geometry.as_ref().ok(), notices);
                    return geometry;
                }
            }
        }
        let pixdim = self.distances(notices);
        let geometry = if self.qform > 0 {
            self.by_qform(path, dims, pixdim)?
        } else {
            header::geometry(path, &names("pixdim"), dims, pixdim, [0.0; 3], Geometry::IDENTITY)?
        };
        if let Some(error) = failed {
            let instead = if self.qform > 0 { "qform" } else { "pixdim" };
            notices.add(format!(
                "sform describes no grid, {instead} is taken in its place: {}",
                error.why
            ));
        }
        Ok(geometry)
    }

    /// Adds a notice if `qform`, which other readers prefer, gives the samples other positions.
    fn compare_with_qform(&self, path: &Path, by_sform: Option<&Geometry>, notices: &mut Notices) {
        let pixdim = self.distances(&mut Notices::default());
        let (Some(by_sform), 1..) = (by_sform, self.qform) else {
            return;
        };
        let Ok(by_qform) = self.by_qform(path, by_sform.dims, pixdim) else {
            return;
        };
        let smallest = by_sform.spacing.into_iter().fold(f64::INFINITY, f64::min);
        let distance = by_sform.farthest_from(&by_qform);
        if distance > 0.5 * smallest {
            notices.add(format!(
                "sform and qform put samples up to {} apart, in the file's unit: sform is taken, check the orientation",
                distance as f32
            ));
        }
    }

    /// Whether all vectors of `sform` are 0.
    fn is_sform_empty(&self) -> bool {
        self.rows.iter().all(|row| row[..3] == [0.0; 3])
    }

    fn by_sform(&self, path: &Path, dims: [u32; 3]) -> Result<Geometry, ReadError> {
        let rows = self.rows;
        let axes = std::array::from_fn(|axis| std::array::from_fn(|i| rows[i][axis]));
        let (spacing, direction) = header::split_axes(axes);
        let names = names("srow_x, srow_y, srow_z");
        let origin = rows.map(|r| r[3]);
        ras(header::geometry(path, &names, dims, spacing, origin, direction))
    }

    fn by_qform(&self, path: &Path, dims: [u32; 3], pixdim: [f64; 3]) -> Result<Geometry, ReadError> {
        let names = names("quatern_b, quatern_c, quatern_d");
        let [b, c, d] = self.quaternion;
        let rest = 1.0 - (b * b + c * c + d * d);
        // Single precision may make the vector a little too long. If it is longer than that, it is no rotation.
        if rest.is_nan() || rest < -1e-4 {
            let why = format!("({b}, {c}, {d}) is longer than 1, expected a part of a unit quaternion");
            return Err(ReadError::new(path, names.direction, why));
        }
        // A half turn has a = 0; a smaller remainder than this is rounding.
        let a = if rest < 1e-7 { 0.0 } else { rest.sqrt() };
        let direction = self.rotation(a);
        let origin = self.quaternion_offset;
        ras(header::geometry(path, &names, dims, pixdim, origin, direction))
    }

    /// Returns the distances of samples along x, y, z, which are above 0.
    fn distances(&self, notices: &mut Notices) -> [f64; 3] {
        std::array::from_fn(|axis| {
            let stored = self.pixdim[axis + 1];
            // In single precision, to leave out digits of rounding.
            let shown = stored as f32;
            let number = axis + 1;
            match stored.abs() {
                size if size.is_finite() && size > 0.0 => {
                    if stored < 0.0 {
                        notices.add(format!(
                            "pixdim[{number}] is {shown}: samples are taken to be {} apart",
                            shown.abs()
                        ));
                    }
                    size
                }
                _ => {
                    notices.add(format!("pixdim[{number}] is {shown}: samples are taken to be 1 apart"));
                    1.0
                }
            }
        })
    }

    /// Returns the directions of the axes by the quaternion whose first number is `a`.
    fn rotation(&self, a: f64) -> [[f64; 3]; 3] {
        let [b, c, d] = self.quaternion;
        let norm = (a * a + b * b + c * c + d * d).sqrt();
        let [a, b, c, d] = [a, b, c, d].map(|q| q / norm);
        let handed = if self.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
        [
            [
                a * a + b * b - c * c - d * d,
                2.0 * (b * c + a * d),
                2.0 * (b * d - a * c),
            ],
            [
                2.0 * (b * c - a * d),
                a * a + c * c - b * b - d * d,
                2.0 * (c * d + a * b),
            ],
            [
                2.0 * (b * d + a * c),
                2.0 * (c * d - a * b),
                a * a + d * d - b * b - c * c,
            ]
            .map(|v| v * handed + 0.0),
        ]
    }
}

struct Shape {
    dims: [u32; 3],
    steps: u32,
    channels: u32,
}

/// A type of samples.
struct SampleKind {
    stored: StoredType,
    /// Number of components of a colour: red, green, blue, perhaps alpha; 1 for numbers.
    colours: u32,
    name: &'static str,
}

fn stored_type(path: &Path, header: &Header, notices: &mut Notices) -> Result<SampleKind, ReadError> {
    let (stored, colours, name) = match header.datatype {
        2 => (StoredType::U8, 1, "UINT8"),
        4 => (StoredType::I16, 1, "INT16"),
        8 => (StoredType::I32, 1, "INT32"),
        16 => (StoredType::F32, 1, "FLOAT32"),
        64 => (StoredType::F64, 1, "FLOAT64"),
        128 => (StoredType::U8, 3, "RGB24"),
        256 => (StoredType::I8, 1, "INT8"),
        512 => (StoredType::U16, 1, "UINT16"),
        768 => (StoredType::U32, 1, "UINT32"),
        1024 => (StoredType::I64, 1, "INT64"),
        1280 => (StoredType::U64, 1, "UINT64"),
        2304 => (StoredType::U8, 4, "RGBA32"),
        code => {
            let what = match code {
                1 => " (bits)",
                32 | 1792 | 2048 => " (complex)",
                1536 => " (128-bit floating point)",
                _ => "",
            };
            let why =
                format!("code {code}{what}, expected an integer or floating-point type of 8 to 64 bits, or colours");
            return Err(ReadError::new(path, "datatype", why));
        }
    };
    let bits = stored.bytes() * 8 * u64::from(colours);
    if i64::from(header.bitpix) != bits as i64 {
        notices.add(format!(
            "bitpix is {}, expected {bits}: samples are read as datatype says, {name}",
            header.bitpix
        ));
    }
    Ok(SampleKind { stored, colours, name })
}

/// Returns the unit that the low three bits of `xyzt_units` name.
fn length_unit(code: u8) -> Option<LengthUnit> {
    match code & 7 {
        1 => Some(LengthUnit::Metre),
        2 => Some(LengthUnit::Millimetre),
        3 => Some(LengthUnit::Micrometre),
        _ => None,
    }
}

/// Sets the frame to RAS: the world's axes in `sform` and `qform` point to a patient's right, front and head.
fn ras(geometry: Result<Geometry, ReadError>) -> Result<Geometry, ReadError> {
    geometry.map(|geometry| Geometry {
        frame: Frame::Ras,
        ..geometry
    })
}

fn names(direction: &'static str) -> GridFields {
    let by_sform = direction.starts_with("srow");
    GridFields {
        dims: "dim",
        spacing: if by_sform { direction } else { "pixdim" },
        origin: if by_sform {
            direction
        } else {
            "quatern_x, quatern_y, quatern_z"
        },
        direction,
    }
}
