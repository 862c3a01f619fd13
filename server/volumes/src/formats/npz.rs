//! NumPy's `.npz`: a zip file of `.npy` arrays (<https://numpy.org/doc/stable/reference/generated/numpy.savez.html>).
//!
//! Arrays of one shape are fields of one dataset; a part names one of several (`a.npz:ct`). Stored members are read
//! like plain samples, deflated ones as a stream. Arrays that are no volume are skipped. The crate `zip` reads the
//! directory of the file.

use std::path::Path;

use zip::{CompressionMethod, ZipArchive};

use super::super::codec;
use super::super::location::Blob;
use super::super::stored::{Begin, Encoding};
use super::super::{Field, FileLocation, Notices, OpenedFile, ReadError};
use super::{header, npy};

/// Maximum members of a file.
const MAX_MEMBERS: usize = 1024;

/// Reads the headers of the arrays in an `.npz` file.
///
/// # Errors
/// What is wrong with the file, by field; arrays of several shapes if none is named.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let path = location.path();
    let blob = location.open()?;
    let members = members(path, &blob)?;
    let mut volumes = Vec::new();
    let mut refused = None;
    for member in &members {
        if location
            .part()
            .is_some_and(|part| part.strip_suffix(".npy").unwrap_or(part) != member.name)
        {
            continue;
        }
        match member.array(path, &blob) {
            Ok(array) => volumes.push((member, array)),
            Err(error) => refused = Some(error),
        }
    }
    let Some((_, first)) = volumes.first() else {
        return Err(refused.unwrap_or_else(|| none(location, &members)));
    };
    if volumes
        .iter()
        .any(|(_, array)| (array.dims, array.steps) != (first.dims, first.steps))
    {
        return Err(several(path, &volumes));
    }
    let geometry = first.geometry(path)?;
    let field = |(member, array): &(&Member, npy::Array)| -> Result<Field, ReadError> {
        let mut samples = array.samples(location, Begin::At(member.begin), &geometry)?;
        samples.end = Some(member.end);
        samples.encoding = member.encoding;
        samples.skip_decoded = array.header_bytes;
        samples.check("shape")?;
        Ok(header::field(member.name.clone(), samples, &array.descr, None, None))
    };
    let fields = volumes.iter().map(field).collect::<Result<_, _>>()?;
    let file = OpenedFile {
        geometry,
        steps: first.steps,
        uneven: None,
        axes: None,
        times: None,
        fields,
        notices: Notices::default(),
    };
    // Arrays of one shape have the same doubts, which are listed once.
    let notices = volumes.iter().flat_map(|(_, array)| array.notices.clone());
    Ok(header::with_notices(file, notices))
}

/// Returns the error for arrays of different shapes.
fn several(path: &Path, volumes: &[(&Member, npy::Array)]) -> ReadError {
    let of = |(member, array): &(&Member, npy::Array)| format!("{} {:?} x {}", member.name, array.dims, array.steps);
    let shapes: Vec<String> = volumes.iter().map(of).collect();
    let why = format!(
        "arrays of several shapes, expected one: name it, as {}:{} ({})",
        path.display(),
        volumes[0].0.name,
        shapes.join(", ")
    );
    ReadError::new(path, "shape", why)
}

/// Returns the error for a file without an array, or without one of the requested name.
fn none(location: &FileLocation, members: &[Member]) -> ReadError {
    let names: Vec<&str> = members.iter().map(|member| member.name.as_str()).collect();
    let why = match location.part() {
        Some(part) => format!("no array {part:?} in it, expected one of {names:?}"),
        None => "no array in it, expected one of 3 or 4 axes".to_owned(),
    };
    ReadError::new(location.path(), "array", why)
}

/// An array in the file.
struct Member {
    name: String,
    encoding: Encoding,
    begin: u64,
    end: u64,
}

impl Member {
    /// Reads the header of the array.
    fn array(&self, path: &Path, blob: &Blob<'_>) -> Result<npy::Array, ReadError> {
        let stream = codec::decoder(self.encoding, blob.reader(self.begin), self.end - self.begin);
        let stream = stream.map_err(|e| ReadError::io(path, "header", format!("cannot be read: {e}"), e))?;
        npy::Array::read(path, stream).map_err(|error| ReadError {
            field: format!("{}: {}", self.name, error.field),
            ..error
        })
    }
}

/// Lists the arrays of the file, from its directory.
fn members(path: &Path, blob: &Blob<'_>) -> Result<Vec<Member>, ReadError> {
    let fail = |why: String| ReadError::new(path, "zip", why);
    let mut archive = ZipArchive::new(blob.reader(0)).map_err(|e| fail(format!("{e}, expected a file of np.savez")))?;
    if archive.len() > MAX_MEMBERS {
        return Err(fail(format!(
            "{} members, expected {MAX_MEMBERS} at most",
            archive.len()
        )));
    }
    let mut members: Vec<Member> = Vec::new();
    for index in 0..archive.len() {
        let member = archive.by_index_raw(index).map_err(|e| fail(e.to_string()))?;
        let whole = String::from_utf8_lossy(member.name_raw()).into_owned();
        let Some(name) = whole.strip_suffix(".npy") else {
            continue;
        };
        if members.iter().any(|other| other.name == name) {
            return Err(fail(format!("{name:?} is in it twice, expected different names")));
        }
        let encoding = match member.compression() {
            _ if member.encrypted() => return Err(fail(format!("{name:?} is encrypted, expected a plain file"))),
            CompressionMethod::Stored => Encoding::Raw,
            CompressionMethod::DEFLATE => Encoding::BareDeflate,
            other => {
                return Err(fail(format!(
                    "{name:?} is compressed by {other}, expected stored or deflated"
                )));
            }
        };
        let begin = member.data_start();
        let end = begin.and_then(|begin| begin.checked_add(member.compressed_size()));
        let (Some(begin), Some(end)) = (begin, end) else {
            return Err(fail(format!("{name:?} begins nowhere, expected its place in the file")));
        };
        members.push(Member {
            name: name.to_owned(),
            encoding,
            begin,
            end,
        });
    }
    Ok(members)
}
