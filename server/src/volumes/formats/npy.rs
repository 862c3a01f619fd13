//! NumPy's `.npy`, format versions 1 to 3 (<https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html>).
//!
//! An array of shape `(z, y, x)` is a volume, `(t, z, y, x)` one with time steps; C and Fortran order, both byte orders. The format
//! has neither spacing nor origin nor missing value: samples are 1 apart from 0. Nothing in the header is evaluated.

use super::super::stored::{Begin, Endian, StoredSamples, StoredType};
use super::super::{FileLocation, Geometry, OpenedFile, ReadError};
use super::header::{self, GridFields, MAX_HEADER_BYTES, not_3d};

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
    let path = location.path();
    let blob = location.open()?;
    let head = blob.head(MAX_HEADER_BYTES)?;
    let fail = |field: &str, why: String| Err(ReadError::new(path, field, why));
    let (length_bytes, rest) = match head.as_slice() {
        [0x93, b'N', b'U', b'M', b'P', b'Y', 1, _, rest @ ..] => (2, rest),
        [0x93, b'N', b'U', b'M', b'P', b'Y', 2 | 3, _, rest @ ..] => (4, rest),
        [0x93, b'N', b'U', b'M', b'P', b'Y', version, ..] => {
            return fail("version", format!("{version}, expected 1 to 3"));
        }
        _ => return fail("magic", "expected \\x93NUMPY, as np.save writes it".into()),
    };
    let Some((length, rest)) = rest.split_at_checked(length_bytes) else {
        return fail("header length", "the file ends before it".into());
    };
    let length = length.iter().rev().fold(0usize, |n, &b| n << 8 | usize::from(b));
    let Some(text) = rest.get(..length) else {
        return fail(
            "header length",
            format!("{length} bytes, the file has {} there", rest.len()),
        );
    };
    let header = Dict::parse(&String::from_utf8_lossy(text)).map_err(|why| ReadError::new(path, "header", why))?;

    let (endian, stored) = match parse_descr(&header.descr) {
        Some(known) => known,
        None => {
            let why = format!(
                "{:?}, expected an integer, a bool, f4 or f8, one component a sample",
                header.descr
            );
            return fail("descr", why);
        }
    };
    let sizes = header::sizes(path, "shape", &header.shape)?;
    let (steps, [nz, ny, nx]) = match *sizes.as_slice() {
        [z, y, x] => (1, [z, y, x]),
        [t, z, y, x] => (t, [z, y, x]),
        _ => return Err(not_3d(path, "shape", format!("{} axes", sizes.len()))),
    };
    let geometry = header::geometry(path, &FIELDS, [nx, ny, nz], [1.0; 3], [0.0; 3], Geometry::IDENTITY)?;
    let begin = Begin::At((8 + length_bytes + length) as u64);
    let mut samples = StoredSamples::new(location, begin, stored, &geometry, steps, "shape")?;
    samples.endian = endian;
    if header.fortran_order {
        // The first index is the fastest: time, then z, y, x. `new` has checked the product.
        let [t, z, y] = [steps, nz, ny].map(u64::from);
        samples.strides = [t * z * y, t * z, t, 1];
    }
    header::opened(location, "shape", geometry, samples, header.descr, None, None)
}

fn parse_descr(descr: &str) -> Option<(Endian, StoredType)> {
    let mut rest = descr.chars();
    let endian = match rest.next()? {
        '>' => Endian::Big,
        '<' | '|' => Endian::Little,
        '=' if cfg!(target_endian = "big") => Endian::Big,
        '=' => Endian::Little,
        _ => return None,
    };
    let stored = match rest.as_str() {
        "u1" | "b1" => StoredType::U8,
        "i1" => StoredType::I8,
        "u2" => StoredType::U16,
        "i2" => StoredType::I16,
        "u4" => StoredType::U32,
        "i4" => StoredType::I32,
        "u8" => StoredType::U64,
        "i8" => StoredType::I64,
        "f4" => StoredType::F32,
        "f8" => StoredType::F64,
        _ => return None,
    };
    Some((endian, stored))
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
                    // A list is a structured type, which is refused by this `descr`.
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
