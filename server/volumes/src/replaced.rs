//! Files that are replaced after their header was read: their samples are read by the new header, if it describes the same volume.

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use isopeel_geometry::UnevenAxes;
use isopeel_kernels::{SampleType, Samples};

use super::{
    FileLocation, FileStamp, Geometry, LabelRanks, LengthUnit, Notices, OpenedFile, ReadError, ReadProgress, Sink,
    Source,
};

/// Reads the header of a file. Called again if the file was replaced.
type Open = fn(&FileLocation) -> Result<OpenedFile, ReadError>;

/// A field of a file. Reads the header again if the file was replaced.
#[derive(Debug)]
struct CheckedSource {
    location: FileLocation,
    open: Open,
    /// Index of the field in the file.
    index: usize,
    expected: Arc<Header>,
    current: Mutex<Current>,
}

/// Source of the samples, opened when the file had this stamp.
#[derive(Debug)]
struct Current {
    stamp: FileStamp,
    source: Arc<dyn Source>,
}

/// What the header of a volume states, and the header of a replacing file must state, too.
#[derive(Debug, PartialEq)]
struct Header {
    geometry: Geometry,
    uneven: Option<Arc<UnevenAxes>>,
    steps: u32,
    fields: Vec<FieldHeader>,
}

#[derive(Debug, PartialEq)]
struct FieldHeader {
    name: String,
    stored_type: String,
    sample_type: SampleType,
    /// Bits of the value of missing samples.
    missing: Option<u32>,
}

impl Header {
    fn of(file: &OpenedFile) -> Self {
        let fields = file.fields.iter().map(|field| FieldHeader {
            name: field.name.clone(),
            stored_type: field.stored_type.clone(),
            sample_type: field.sample_type,
            missing: field.missing.map(f32::to_bits),
        });
        Self {
            geometry: file.geometry,
            uneven: file.uneven.clone(),
            steps: file.steps,
            fields: fields.collect(),
        }
    }

    /// Returns what differs from the expected header, with both values.
    fn difference(&self, expected: &Self) -> Option<(&'static str, String, String)> {
        let names = |header: &Self| {
            let fields = header.fields.iter();
            let named = fields.map(|field| {
                let missing = field
                    .missing
                    .map_or(String::new(), |bits| format!(", missing {}", f32::from_bits(bits)));
                format!("{} ({}{missing})", field.name, field.stored_type)
            });
            named.collect::<Vec<_>>().join(", ")
        };
        let (a, b) = (self, expected);
        if a.geometry.dims != b.geometry.dims {
            let show = |header: &Self| format!("{:?}", header.geometry.dims);
            Some(("dimensions", show(a), show(b)))
        } else if a.geometry != b.geometry {
            let show = |header: &Self| {
                let geometry = &header.geometry;
                format!(
                    "spacing {:?}, origin {:?}, axes {:?}, frame {}, unit {}",
                    geometry.spacing,
                    geometry.origin,
                    geometry.direction,
                    geometry.frame.name(),
                    geometry.unit.map_or("none", LengthUnit::symbol)
                )
            };
            Some(("geometry", show(a), show(b)))
        } else if a.uneven != b.uneven {
            let text = |what: &str| what.to_owned();
            Some(("positions", text("others"), text("those of before")))
        } else if a.steps != b.steps {
            Some(("time steps", a.steps.to_string(), b.steps.to_string()))
        } else if a != b {
            Some(("fields", names(a), names(b)))
        } else {
            None
        }
    }
}

/// Returns the same file, with fields that check before each read whether the file was replaced. `stamp`: taken before the header was
/// read; `open` reads the header.
pub(super) fn checked(
    location: &FileLocation,
    stamp: Option<FileStamp>,
    mut file: OpenedFile,
    open: Open,
) -> OpenedFile {
    let Some(stamp) = stamp else { return file };
    let expected = Arc::new(Header::of(&file));
    for (index, field) in file.fields.iter_mut().enumerate() {
        let source = Arc::clone(&field.source);
        field.source = Arc::new(CheckedSource {
            location: location.clone(),
            open,
            index,
            expected: Arc::clone(&expected),
            current: Mutex::new(Current { stamp, source }),
        });
    }
    file
}

impl CheckedSource {
    fn lock(&self) -> MutexGuard<'_, Current> {
        self.current.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn last(&self) -> Arc<dyn Source> {
        Arc::clone(&self.lock().source)
    }

    /// Returns a source for the current file.
    fn now(&self) -> Result<Arc<dyn Source>, ReadError> {
        // If the file is gone, the source returns the error.
        let Some(stamp) = self.location.stamp() else {
            return Ok(self.last());
        };
        if self.lock().stamp == stamp {
            return Ok(self.last());
        }
        let opened = (self.open)(&self.location).map_err(|error| ReadError {
            why: format!(
                "{}; the file was replaced or cut off since its header was read",
                error.why
            ),
            ..error
        })?;
        if let Some((what, found, expected)) = Header::of(&opened).difference(&self.expected) {
            return Err(replaced(self.location.path(), what, &found, &expected));
        }
        let source = Arc::clone(&opened.fields[self.index].source);
        let mut current = self.lock();
        *current = Current { stamp, source };
        Ok(Arc::clone(&current.source))
    }
}

fn replaced(path: &Path, what: &'static str, found: &str, expected: &str) -> ReadError {
    let why = format!(
        "{found}, expected {expected}: the file was replaced since its header was read; with --watch the server takes another volume, else start it again"
    );
    ReadError::new(path, what, why)
}

impl Source for CheckedSource {
    fn stored_bytes(&self) -> u64 {
        self.last().stored_bytes()
    }

    fn inputs(&self, step: u32) -> Vec<FileLocation> {
        self.last().inputs(step)
    }

    fn read(&self, step: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        self.now()?.read(step, progress)
    }

    fn read_pieces(
        &self,
        step: u32,
        progress: &ReadProgress,
        piece: usize,
        sink: &mut Sink<'_>,
    ) -> Result<(), ReadError> {
        self.now()?.read_pieces(step, progress, piece, sink)
    }

    fn notices(&self) -> Notices {
        self.last().notices()
    }

    fn ranks(&self) -> Option<Arc<LabelRanks>> {
        self.last().ranks()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::open_dataset;

    const HEADER: &str = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 4 3 2\nspacings: 1 1 1\nencoding: raw\n\n";

    /// Replaces a file by one of this header, whose samples count from `first`.
    fn write(path: &Path, header: &str, first: u8) {
        let mut bytes = header.as_bytes().to_vec();
        bytes.extend(first..first + 24);
        let new = path.with_extension("new");
        std::fs::write(&new, bytes).unwrap();
        std::fs::rename(new, path).unwrap();
    }

    #[test]
    fn a_file_that_is_replaced_is_read_as_its_new_header_says_or_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("v.nrrd");
        write(&path, HEADER, 0);
        let dataset = open_dataset(&path).unwrap();
        let read = || dataset.fields[0].source.load(0);
        let first = || read().unwrap().get(0);
        assert_eq!(first(), 0.0);
        write(&path, HEADER, 5);
        assert_eq!(first(), 5.0);
        // Its samples begin elsewhere.
        write(&path, &HEADER.replace("type:", "# a comment\ntype:"), 7);
        assert_eq!(first(), 7.0);
        for (from, to, expected) in [
            (
                "4 3 2",
                "3 4 2",
                "dimensions: [3, 4, 2], expected [4, 3, 2]: the file was replaced",
            ),
            ("1 1 1", "1 1 9", "geometry: spacing [1.0, 1.0, 9.0]"),
            ("uint8", " int8", "fields: v (int8), expected v (uint8)"),
        ] {
            write(&path, &HEADER.replace(from, to), 9);
            let error = read().unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        write(&path, HEADER, 11);
        assert_eq!(first(), 11.0);
        std::fs::remove_file(&path).unwrap();
        assert!(read().is_err());
    }
}
