//! NIfTI-1, one file: `.nii` and `.nii.gz` (<https://nifti.nimh.nih.gov/nifti-1>). The header is parsed by the crate
//! `nifti`; samples are read as those of every other format, which does not trust the header.
//!
//! Read: every integer type and both floating-point types, `scl_slope` and `scl_inter` (values become f32), the affine of
//! `sform`, else of `qform`, else `pixdim` alone, the fourth axis as time steps. Axes stay as the file has them (LAS, RAS, …). The format
//! has no missing value. Refused with the reason: NIfTI-2, `.hdr`/`.img` pairs, complex and colour types, more than one component.

use std::io::Read;
use std::path::Path;

use flate2::read::MultiGzDecoder;
use nifti::{NiftiHeader, NiftiType};

use super::super::stored::{Begin, Encoding, Endian, StoredSamples, StoredType};
use super::super::{FileLocation, Geometry, OpenedFile, ReadError};
use super::header::{self, GridFields, not_3d};

/// Bytes of a NIfTI-1 header.
const HEADER_BYTES: u64 = 348;

/// Reads the header of a NIfTI file.
///
/// # Errors
/// What is wrong with it, by field.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let path = location.path();
    let blob = location.open()?;
    let fail = |field: &str, why: String| Err(ReadError::new(path, field, why));
    let gzip = blob.head(2)? == [0x1f, 0x8b];
    let mut head = Vec::new();
    let read = if gzip {
        MultiGzDecoder::new(std::io::BufReader::new(blob.reader(0)))
            .take(HEADER_BYTES)
            .read_to_end(&mut head)
    } else {
        blob.reader(0).take(HEADER_BYTES).read_to_end(&mut head)
    };
    read.map_err(|e| ReadError::io(path, "header", "cannot be read or decompressed", e))?;
    if head.starts_with(&540i32.to_le_bytes()) || head.starts_with(&540i32.to_be_bytes()) {
        return fail("sizeof_hdr", "540, this is NIfTI-2, expected NIfTI-1 (348)".into());
    }
    if (head.len() as u64) < HEADER_BYTES {
        return fail("header", format!("{} bytes, expected {HEADER_BYTES}", head.len()));
    }
    let header = NiftiHeader::from_reader(head.as_slice()).map_err(|e| ReadError::new(path, "magic", e.to_string()))?;
    if header.sizeof_hdr != HEADER_BYTES as i32 {
        return fail("sizeof_hdr", format!("{}, expected {HEADER_BYTES}", header.sizeof_hdr));
    }
    if &header.magic != nifti::header::MAGIC_CODE_NIP1 {
        return fail(
            "magic",
            "a header whose samples are in an .img file, expected one file (n+1)".into(),
        );
    }
    let (dims, steps) = dimensions(path, &header)?;
    let (stored, stored_name) = stored_type(path, &header)?;
    let offset = header.vox_offset;
    // The field is a float, which is exact up to 2^24.
    if !(352.0..=16_777_216.0).contains(&offset) || offset.fract() != 0.0 {
        return fail(
            "vox_offset",
            format!("{offset}, expected a whole number of bytes from 352 to 16777216"),
        );
    }
    let geometry = geometry(path, &header, dims)?;
    let begin = Begin::At(if gzip { 0 } else { offset as u64 });
    let mut samples = StoredSamples::new(location, begin, stored, &geometry, steps, "dim")?;
    if gzip {
        samples.encoding = Encoding::Deflate;
        samples.skip_decoded = offset as u64;
    }
    if header.endianness == nifti::Endianness::Big {
        samples.endian = Endian::Big;
    }
    samples.scale = scale(path, &header)?;
    header::opened(location, "dim", geometry, samples, stored_name, None, None)
}

fn dimensions(path: &Path, header: &NiftiHeader) -> Result<([u32; 3], u32), ReadError> {
    let count = usize::from(header.dim[0]);
    if !(3..=7).contains(&count) {
        return Err(not_3d(path, "dim", format!("dim[0] is {count}")));
    }
    let axes = &header.dim[1..=count];
    if let Some((i, n)) = axes
        .iter()
        .enumerate()
        .find(|(_, n)| !(1..=i16::MAX as u16).contains(n))
    {
        return Err(ReadError::new(
            path,
            "dim",
            format!("dim[{}] is {}, expected 1 to 32767", i + 1, *n as i16),
        ));
    }
    if axes[2..].iter().all(|&n| n == 1) {
        return Err(not_3d(
            path,
            "dim",
            format!("{} x {} samples in 2 dimensions", axes[0], axes[1]),
        ));
    }
    if let Some(n) = axes.iter().skip(4).find(|&&n| n > 1) {
        return Err(ReadError::new(
            path,
            "dim",
            format!("{n} components a sample, expected 1"),
        ));
    }
    let steps = axes.get(3).copied().unwrap_or(1);
    Ok(([axes[0], axes[1], axes[2]].map(u32::from), u32::from(steps)))
}

fn stored_type(path: &Path, header: &NiftiHeader) -> Result<(StoredType, String), ReadError> {
    let expected = "expected an integer or floating-point type, one component a sample";
    let kind = header
        .data_type()
        .map_err(|_| ReadError::new(path, "datatype", format!("code {}, {expected}", header.datatype)))?;
    let stored = match kind {
        NiftiType::Uint8 => StoredType::U8,
        NiftiType::Int8 => StoredType::I8,
        NiftiType::Uint16 => StoredType::U16,
        NiftiType::Int16 => StoredType::I16,
        NiftiType::Uint32 => StoredType::U32,
        NiftiType::Int32 => StoredType::I32,
        NiftiType::Uint64 => StoredType::U64,
        NiftiType::Int64 => StoredType::I64,
        NiftiType::Float32 => StoredType::F32,
        NiftiType::Float64 => StoredType::F64,
        other => return Err(ReadError::new(path, "datatype", format!("{other:?}, {expected}"))),
    };
    let bits = stored.bytes() * 8;
    if i64::from(header.bitpix) != bits as i64 {
        return Err(ReadError::new(
            path,
            "bitpix",
            format!("{}, expected {bits} for {kind:?}", header.bitpix),
        ));
    }
    Ok((stored, format!("{kind:?}").to_uppercase()))
}

/// A slope of 0 means "no scale"; writers also leave NaN there.
fn scale(path: &Path, header: &NiftiHeader) -> Result<Option<[f64; 2]>, ReadError> {
    let (slope, inter) = (header.scl_slope, header.scl_inter);
    if slope.is_nan() || slope == 0.0 || (slope == 1.0 && inter == 0.0) {
        return Ok(None);
    }
    if !slope.is_finite() || !inter.is_finite() {
        let why = format!("slope {slope} and intercept {inter}, expected finite numbers");
        return Err(ReadError::new(path, "scl_slope", why));
    }
    Ok(Some([f64::from(slope), f64::from(inter)]))
}

fn geometry(path: &Path, header: &NiftiHeader, dims: [u32; 3]) -> Result<Geometry, ReadError> {
    let pixdim: [f64; 3] = std::array::from_fn(|a| f64::from(header.pixdim[a + 1]));
    if header.sform_code > 0 {
        let rows = [header.srow_x, header.srow_y, header.srow_z].map(|r| r.map(f64::from));
        let axes = std::array::from_fn(|axis| std::array::from_fn(|i| rows[i][axis]));
        let (spacing, direction) = header::split_axes(axes);
        let names = names("srow_x, srow_y, srow_z");
        return header::geometry(path, &names, dims, spacing, rows.map(|r| r[3]), direction);
    }
    let names = names("quatern_b, quatern_c, quatern_d");
    if header.qform_code > 0 {
        let [b, c, d] = [header.quatern_b, header.quatern_c, header.quatern_d].map(f64::from);
        let rest = 1.0 - (b * b + c * c + d * d);
        // In single precision the vector may be a little too long; if it is longer, it is no rotation.
        if rest.is_nan() || rest < -1e-4 {
            let why = format!("({b}, {c}, {d}) is longer than 1, expected a part of a unit quaternion");
            return Err(ReadError::new(path, names.direction, why));
        }
        let a = rest.max(0.0).sqrt();
        let norm = (a * a + b * b + c * c + d * d).sqrt();
        let [a, b, c, d] = [a, b, c, d].map(|q| q / norm);
        let handed = if header.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
        let direction = [
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
        ];
        let origin = [header.quatern_x, header.quatern_y, header.quatern_z].map(f64::from);
        return header::geometry(path, &names, dims, pixdim, origin, direction);
    }
    header::geometry(path, &names, dims, pixdim, [0.0; 3], Geometry::IDENTITY)
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
