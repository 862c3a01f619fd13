//! The samples: in the same file or in another one, after lines and bytes that are skipped.

use super::super::super::stored::{Begin, Encoding, Endian, StoredSamples, StoredType};
use super::super::super::{FileLocation, Geometry, ReadError};
use super::super::header::MAX_HEADER_BYTES;
use super::axes::Axes;
use super::header::Header;

impl Header<'_> {
    pub(super) fn samples(
        &self,
        axes: &Axes,
        geometry: &Geometry,
        stored: StoredType,
    ) -> Result<StoredSamples, ReadError> {
        let encoding = match self.required("encoding")?.to_ascii_lowercase().as_str() {
            "raw" => Encoding::Raw,
            "gzip" | "gz" => Encoding::Deflate,
            "bzip2" | "bz2" => Encoding::Bzip2,
            "hex" => Encoding::Hex,
            "text" | "txt" | "ascii" => Encoding::Text,
            other => return Err(self.error("encoding", format!("{other:?}, expected raw, gzip, bzip2, hex or text"))),
        };
        let data = self.data_file()?;
        let detached = self.get("data file").is_some();
        let first = if detached { 0 } else { self.data_offset as u64 };
        let mut samples = StoredSamples::new(&data, Begin::At(first), stored, geometry, axes.steps, "sizes")?;
        samples.encoding = encoding;
        samples.strides = axes.strides;
        samples = samples.with_channels(axes.channel_count, "sizes")?;
        samples.endian = self.endian(stored, encoding)?;
        let lines: u64 = self.number("line skip")?.unwrap_or(0);
        if lines > 0 {
            samples.begin = Begin::At(self.skip_lines(&data, first, lines)?);
        }
        match self.number::<i64>("byte skip")? {
            None => {}
            Some(-1) if encoding == Encoding::Raw => samples.begin = Begin::BeforeEnd,
            Some(skip) => {
                samples.skip_decoded = u64::try_from(skip).map_err(|_| {
                    self.error(
                        "byte skip",
                        format!("{skip}, expected 0 or more, or -1 with encoding raw"),
                    )
                })?;
            }
        }
        Ok(samples)
    }

    /// Returns the file with the samples: this one, or the one that `data file` names.
    fn data_file(&self) -> Result<FileLocation, ReadError> {
        match self.get("data file") {
            None if self.data_offset == MAX_HEADER_BYTES => {
                let why = format!("no empty line within {MAX_HEADER_BYTES} bytes, expected one after the header");
                Err(self.error("header", why))
            }
            None => Ok(self.location.clone()),
            Some(name) => match self.location.sibling(name, "data file") {
                Err(_) if name.starts_with("LIST") || name.contains('%') => {
                    let why = format!(
                        "{name:?}: samples in many files, which are not read; expected one file, as `unu save -f nrrd -i IN.nhdr -o OUT.nrrd` \
                         writes it"
                    );
                    Err(self.error("data file", why))
                }
                file => file,
            },
        }
    }

    fn endian(&self, stored: StoredType, encoding: Encoding) -> Result<Endian, ReadError> {
        match self.get("endian").map(str::to_ascii_lowercase).as_deref() {
            Some("little") => Ok(Endian::Little),
            Some("big") => Ok(Endian::Big),
            None if stored.bytes() == 1 || encoding == Encoding::Text => Ok(Endian::Little),
            other => {
                let why = format!(
                    "{}, expected little or big",
                    other.map_or("missing".into(), |o| format!("{o:?}"))
                );
                Err(self.error("endian", why))
            }
        }
    }

    /// Returns the offset after `lines` line ends of the data file.
    fn skip_lines(&self, data: &FileLocation, first: u64, lines: u64) -> Result<u64, ReadError> {
        use std::io::BufRead;
        let blob = data.open()?;
        let mut reader = std::io::BufReader::new(blob.reader(first));
        let (mut at, mut left) = (first, lines);
        while left > 0 {
            let buffer = reader
                .fill_buf()
                .map_err(|e| ReadError::io(data.path(), "data", "cannot be read", e))?;
            if buffer.is_empty() {
                return Err(self.error("line skip", format!("{lines}, the data have {} lines", lines - left)));
            }
            let (used, ended) = match buffer.iter().position(|&b| b == b'\n') {
                Some(i) => (i + 1, 1),
                None => (buffer.len(), 0),
            };
            reader.consume(used);
            at += used as u64;
            left -= ended;
        }
        Ok(at)
    }
}
