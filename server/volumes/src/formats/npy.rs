//! NumPy's `.npy`, format versions 1 to 3 (<https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html>).
//!
//! An array of shape `(z, y, x)` is a volume, `(t, z, y, x)` one with time steps; axes of one sample are ignored. C and Fortran order,
//! both byte orders. The format has neither spacing nor origin nor missing value: samples are 1 apart from 0. Nothing in the header is
//! evaluated.

use std::io::Read;
use std::path::Path;

use super::super::stored::{Begin, Endian, StoredSamples, StoredType};
use super::super::{FileLocation, Geometry, OpenedFile, ReadError};
use super::header::{self, GridFields, MAX_HEADER_BYTES, not_3d};
use super::named_axes::doubt_of_order;

const FIELDS: GridFields = GridFields {
    dims: "shape",
    spacing: "shape",
    origin: "shape",
    direction: "shape",
};

/// Reads the header of a `.npy` file.
///
/// # Errors
/// What is wrong with it, by field.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let array = Array::read(location.path(), location.open()?.reader(0))?;
    let geometry = array.geometry(location.path())?;
    let samples = array.samples(location, Begin::At(array.header_bytes), &geometry)?;
    let file = header::opened(location, "shape", geometry, samples, array.descr, None, None)?;
    Ok(header::with_notices(file, array.notices))
}

/// Properties of an array that its header states.
#[derive(Debug)]
pub(super) struct Array {
    pub(super) descr: String,
    endian: Endian,
    stored: StoredType,
    fortran_order: bool,
    /// Along x, y and z.
    pub(super) dims: [u32; 3],
    pub(super) steps: u32,
    /// What its header does not state and was assumed.
    pub(super) notices: Vec<String>,
    /// Bytes before the samples.
    pub(super) header_bytes: u64,
}

impl Array {
    /// Reads a header from the start of an array.
    pub(super) fn read(path: &Path, stream: impl Read) -> Result<Self, ReadError> {
        let (text, header_bytes) = header_text(path, stream)?;
        let Dict {
            descr,
            fortran_order,
            shape,
        } = Dict::parse(&text).map_err(|why| ReadError::new(path, "header", why))?;
        let Some((order, stored)) = parse_descr(&descr) else {
            let why = format!("{descr:?}, expected an integer, a bool, f4 or f8, one component a sample");
            return Err(ReadError::new(path, "descr", why));
        };
        let unordered = order
            .is_none()
            .then(|| format!("descr {descr:?} does not state the byte order: little-endian was taken"));
        let mut sizes = header::sizes(path, "shape", &shape)?;
        // Axes of one sample are removed while more than three axes remain.
        while let Some(one) = sizes.iter().rposition(|&n| n == 1).filter(|_| sizes.len() > 3) {
            sizes.remove(one);
        }
        let (steps, [nz, ny, nx]) = match *sizes.as_slice() {
            [z, y, x] => (1, [z, y, x]),
            [t, z, y, x] => (t, [z, y, x]),
            _ => return Err(not_3d(path, "shape", format!("{} axes", sizes.len()))),
        };
        Ok(Self {
            notices: doubt_of_order(&shape).into_iter().chain(unordered).collect(),
            descr,
            endian: order.unwrap_or(Endian::Little),
            stored,
            fortran_order,
            dims: [nx, ny, nz],
            steps,
            header_bytes,
        })
    }

    pub(super) fn geometry(&self, path: &Path) -> Result<Geometry, ReadError> {
        header::geometry(path, &FIELDS, self.dims, [1.0; 3], [0.0; 3], Geometry::IDENTITY)
    }

    /// Describes the samples, which begin in `location` behind the header.
    pub(super) fn samples(
        &self,
        location: &FileLocation,
        begin: Begin,
        geometry: &Geometry,
    ) -> Result<StoredSamples, ReadError> {
        let mut samples = StoredSamples::new(location, begin, self.stored, geometry, self.steps, "shape")?;
        samples.endian = self.endian;
        if self.fortran_order {
            // The first index is the fastest: time, then z, y, x. `new` has checked the product.
            let [_, y, z] = self.dims.map(u64::from);
            let t = u64::from(self.steps);
            samples.strides = [t * z * y, t * z, t, 1];
        }
        Ok(samples)
    }
}

/// Reads the dictionary as text, and returns the number of bytes up to its end.
fn header_text(path: &Path, mut stream: impl Read) -> Result<(String, u64), ReadError> {
    let fail = |field: &str, why: String| Err(ReadError::new(path, field, why));
    let mut take = |count: u64, field: &str| {
        let mut bytes = Vec::new();
        let read = (&mut stream).take(count).read_to_end(&mut bytes);
        read.map_err(|e| ReadError::io(path, field, format!("cannot be read: {e}"), e))?;
        Ok(bytes)
    };
    let length_bytes = match take(8, "magic")?.as_slice() {
        [0x93, b'N', b'U', b'M', b'P', b'Y', 1, _] => 2,
        [0x93, b'N', b'U', b'M', b'P', b'Y', 2 | 3, _] => 4,
        [0x93, b'N', b'U', b'M', b'P', b'Y', version, ..] => {
            return fail("version", format!("{version}, expected 1 to 3"));
        }
        _ => return fail("magic", "expected \\x93NUMPY, as np.save writes it".into()),
    };
    let length = take(length_bytes, "header length")?;
    if (length.len() as u64) < length_bytes {
        return fail("header length", "the file ends before it".into());
    }
    let length = length.iter().rev().fold(0u64, |n, &b| n << 8 | u64::from(b));
    if length > MAX_HEADER_BYTES as u64 {
        return fail(
            "header length",
            format!("{length} bytes, expected {MAX_HEADER_BYTES} at most"),
        );
    }
    let text = take(length, "header")?;
    if (text.len() as u64) < length {
        return fail(
            "header length",
            format!("{length} bytes, the file has {} there", text.len()),
        );
    }
    Ok((String::from_utf8_lossy(&text).into_owned(), 8 + length_bytes + length))
}

/// Returns byte order and type of samples. Without an order, or with `=`, the order is that of the machine that wrote the array: `None`,
/// unless the type has one byte.
pub(super) fn parse_descr(descr: &str) -> Option<(Option<Endian>, StoredType)> {
    let (order, code) = match descr.as_bytes().first()? {
        b'>' => (Some(Endian::Big), &descr[1..]),
        b'<' | b'|' => (Some(Endian::Little), &descr[1..]),
        b'=' => (None, &descr[1..]),
        _ => (None, descr),
    };
    let stored = match code {
        "u1" | "b1" => StoredType::U8,
        "i1" => StoredType::I8,
        "u2" => StoredType::U16,
        "i2" => StoredType::I16,
        "u4" => StoredType::U32,
        "i4" => StoredType::I32,
        "u8" => StoredType::U64,
        "i8" => StoredType::I64,
        "f2" => StoredType::F16,
        "f4" => StoredType::F32,
        "f8" => StoredType::F64,
        _ => return None,
    };
    Some((order.or((stored.bytes() == 1).then_some(Endian::Little)), stored))
}

/// The dictionary in the header.
#[derive(Debug, PartialEq)]
struct Dict {
    descr: String,
    fortran_order: bool,
    shape: Vec<u64>,
}

impl Dict {
    /// Parses the form of Python literal that the format allows.
    fn parse(text: &str) -> Result<Self, String> {
        let mut rest = text.trim();
        let (mut descr, mut fortran_order, mut shape) = (None, None, None);
        take(&mut rest, "{")?;
        while !rest.starts_with('}') {
            let key = quoted(&mut rest)?;
            take(&mut rest, ":")?;
            match key {
                "descr" if descr.is_none() => {
                    // A list is a structured type, which is refused because of this `descr`.
                    descr = Some(
                        if rest.starts_with('[') {
                            "[...]"
                        } else {
                            quoted(&mut rest)?
                        }
                        .to_owned(),
                    );
                    if rest.starts_with('[') {
                        let end = rest.rfind(']').ok_or("no `]` after `[`")?;
                        rest = rest[end + 1..].trim_start();
                    }
                }
                "fortran_order" if fortran_order.is_none() => {
                    fortran_order = Some(take(&mut rest, "True").is_ok());
                    if fortran_order == Some(false) {
                        take(&mut rest, "False")?;
                    }
                }
                "shape" if shape.is_none() => {
                    take(&mut rest, "(")?;
                    let (inside, after) = rest.split_once(')').ok_or("no `)` after `(`")?;
                    rest = after.trim_start();
                    let sizes = inside.split(',').map(str::trim).filter(|n| !n.is_empty());
                    let sizes = sizes.map(|n| {
                        n.trim_end_matches('L')
                            .parse()
                            .map_err(|_| format!("size {n:?} in `shape`"))
                    });
                    shape = Some(sizes.collect::<Result<Vec<u64>, _>>()?);
                }
                other => {
                    return Err(format!(
                        "key {other:?}, expected descr, fortran_order and shape, once each"
                    ));
                }
            }
            if take(&mut rest, ",").is_err() {
                break;
            }
        }
        take(&mut rest, "}")?;
        Ok(Self {
            descr: descr.ok_or("no `descr`")?,
            fortran_order: fortran_order.ok_or("no `fortran_order`")?,
            shape: shape.ok_or("no `shape`")?,
        })
    }
}

fn take(rest: &mut &str, token: &str) -> Result<(), String> {
    let after = rest.strip_prefix(token).ok_or_else(|| {
        let shown: String = rest.chars().take(20).collect();
        format!("{shown:?} where {token:?} was expected")
    })?;
    *rest = after.trim_start();
    Ok(())
}

fn quoted<'a>(rest: &mut &'a str) -> Result<&'a str, String> {
    let quote = if rest.starts_with('"') { "\"" } else { "'" };
    take(rest, quote)?;
    let (inside, after) = rest.split_once(quote).ok_or_else(|| format!("no closing {quote}"))?;
    *rest = after.trim_start();
    Ok(inside)
}
