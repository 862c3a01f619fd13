//! VTK's legacy format: `.vtk` with `STRUCTURED_POINTS` or `RECTILINEAR_GRID`
//! (<https://docs.vtk.org/en/latest/vtk_file_formats/vtk_legacy_file_format.html>).
//!
//! Read: text and binary (big-endian) files; scalars, vectors, normals, texture coordinates, tensors and arrays of
//! `FIELD`. Lookup tables and metadata are skipped. Refused with the reason: other data sets.

mod coordinates;

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read};

use super::{Array, Arrays, Grid, World};
use crate::formats::header::{self, GridFields, numbers};
use crate::location::{Blob, BlobReader};
use crate::rectilinear::Positions;
use crate::stored::{Begin, Encoding, Endian, StoredSamples, StoredType};
use crate::{FileLocation, Geometry, Notices, OpenedFile, ReadError};

const FIELDS: GridFields = GridFields {
    dims: "DIMENSIONS",
    spacing: "SPACING",
    origin: "ORIGIN",
    direction: "SPACING",
};

/// Maximum bytes of a line outside the data.
const MAX_LINE_BYTES: u64 = 4096;

/// Reads the keywords of a legacy VTK file.
///
/// # Errors
/// What is wrong with it, by keyword.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let blob = location.open()?;
    let mut parser = Parser::new(&blob)?;
    parser.parse()?;
    if parser.is_rectilinear {
        parser.grid = parser.rectilinear_grid()?;
    }
    let Parser {
        grid,
        world,
        arrays,
        text,
        notices,
        ..
    } = parser;
    let mut stored = super::opened(
        location,
        &FIELDS,
        grid,
        &world,
        arrays,
        |array, &Span { begin, end }, geometry| samples(location, text, array, begin, end, geometry),
    )?;
    stored.file.notices.extend(notices);
    stored.placed(location.path(), FIELDS.spacing)
}

fn samples(
    location: &FileLocation,
    text: bool,
    array: &Array,
    begin: u64,
    end: u64,
    geometry: &Geometry,
) -> Result<StoredSamples, ReadError> {
    let mut samples = StoredSamples::new(location, Begin::At(begin), array.stored, geometry, 1, FIELDS.dims)?;
    samples.end = Some(end);
    samples.endian = Endian::Big;
    if text {
        samples.encoding = Encoding::Text;
    }
    Ok(samples)
}

/// Offsets of the first byte of an array, and of the byte behind its last.
struct Span {
    begin: u64,
    end: u64,
}

struct Parser<'a> {
    blob: &'a Blob<'a>,
    stream: BufReader<BlobReader<'a>>,
    /// Offset in the file of the stream's next byte.
    at: u64,
    text: bool,
    grid: Grid,
    is_rectilinear: bool,
    /// For a rectilinear grid: positions by axis.
    positions: BTreeMap<String, Positions>,
    world: World,
    notices: Notices,
    arrays: Arrays<Span>,
    /// Whether the current attributes are those of cells, and how many tuples an array has. `None` before the first section.
    section: Option<(bool, u64)>,
}

impl<'a> Parser<'a> {
    /// Reads the first three lines.
    fn new(blob: &'a Blob<'a>) -> Result<Self, ReadError> {
        let mut parser = Self {
            blob,
            stream: BufReader::with_capacity(1 << 16, blob.reader(0)),
            at: 0,
            text: false,
            grid: Grid {
                dims: [0; 3],
                spacing: [1.0; 3],
                origin: [0.0; 3],
                direction: Geometry::IDENTITY,
                positions: None,
            },
            is_rectilinear: false,
            positions: BTreeMap::new(),
            world: World::default(),
            notices: Notices::default(),
            arrays: Arrays::default(),
            section: None,
        };
        let first = parser.line()?.unwrap_or_default();
        if !first.starts_with("# vtk DataFile") {
            return Err(parser.error("magic", "expected `# vtk DataFile Version` on the first line"));
        }
        parser.line()?;
        parser.text = match parser.line()?.unwrap_or_default().trim().to_ascii_uppercase().as_str() {
            "ASCII" => true,
            "BINARY" => false,
            other => return Err(parser.error("format", format!("{other:?}, expected ASCII or BINARY"))),
        };
        Ok(parser)
    }

    fn parse(&mut self) -> Result<(), ReadError> {
        while let Some(line) = self.line()? {
            let words: Vec<&str> = line.split_whitespace().collect();
            let Some((&keyword, rest)) = words.split_first() else {
                continue;
            };
            self.keyword(&keyword.to_ascii_uppercase(), rest)?;
        }
        match self.grid.dims {
            [0, ..] => Err(self.error("DIMENSIONS", "missing, expected three numbers")),
            _ => Ok(()),
        }
    }

    fn keyword(&mut self, keyword: &str, rest: &[&str]) -> Result<(), ReadError> {
        let path = self.blob.path();
        let three = || numbers::<f64>(path, keyword, &rest.join(" "), Some(3));
        match keyword {
            "DATASET" => match rest.join(" ").to_ascii_uppercase().as_str() {
                "STRUCTURED_POINTS" => {}
                "RECTILINEAR_GRID" => self.is_rectilinear = true,
                other => {
                    let why = format!("{other:?}, expected STRUCTURED_POINTS or RECTILINEAR_GRID: samples on a grid");
                    return Err(self.error("DATASET", why));
                }
            },
            "X_COORDINATES" | "Y_COORDINATES" | "Z_COORDINATES" => self.coordinates(keyword, rest)?,
            "DIMENSIONS" => {
                let sizes: Vec<u64> = numbers(path, keyword, &rest.join(" "), Some(3))?;
                self.grid.dims = header::three(path, keyword, &header::sizes(path, keyword, &sizes)?)?;
            }
            "SPACING" | "ASPECT_RATIO" => self.grid.spacing = header::three(path, keyword, &three()?)?,
            "ORIGIN" => self.grid.origin = header::three(path, keyword, &three()?)?,
            "POINT_DATA" | "CELL_DATA" => {
                self.section = Some((keyword == "CELL_DATA", self.number(keyword, rest.first())?));
            }
            "METADATA" => self.skip_metadata()?,
            "FIELD" => self.fields(rest)?,
            "LOOKUP_TABLE" => {
                // A colour has four bytes in a binary file, four numbers in a text file.
                let count = self.number(keyword, rest.get(1))?;
                self.skip_values(count.saturating_mul(4), 1)?;
            }
            _ => self.attribute(keyword, rest)?,
        }
        Ok(())
    }

    /// Reads an array that has a keyword of its own.
    fn attribute(&mut self, keyword: &str, rest: &[&str]) -> Result<(), ReadError> {
        let name = rest.first().copied().unwrap_or_default();
        let (components, kind) = match keyword {
            "SCALARS" => {
                let components = match rest.get(2) {
                    None => 1,
                    some => self.number(keyword, some)?,
                };
                // The line `LOOKUP_TABLE name` is a part of the keyword; some writers leave it out.
                if self.peek(12)?.eq_ignore_ascii_case(b"LOOKUP_TABLE") {
                    self.line()?;
                }
                (components, rest.get(1))
            }
            "VECTORS" | "NORMALS" => (3, rest.get(1)),
            "TENSORS" => (9, rest.get(1)),
            "TENSORS6" => (6, rest.get(1)),
            "TEXTURE_COORDINATES" => (self.number(keyword, rest.get(1))?, rest.get(2)),
            "GLOBAL_IDS" | "PEDIGREE_IDS" => (1, rest.get(1)),
            // Bytes in a binary file, numbers from 0 to 1 in a text file.
            "COLOR_SCALARS" => {
                if self.text {
                    self.notices.add(format!(
                        "{name:?} is of colours as text, from 0 to 1: 1 is the byte 255 that VTK shows"
                    ));
                }
                let kind: &&str = if self.text { &"float" } else { &"unsigned_char" };
                (self.number(keyword, rest.get(1))?, Some(kind))
            }
            _ => {
                let shown: String = keyword.chars().take(40).collect();
                return Err(self.error("header", format!("{shown:?}, expected a keyword of the format")));
            }
        };
        let Some((_, tuples)) = self.section else {
            return Err(self.error(keyword, "stands before POINT_DATA, expected it after"));
        };
        let kind = kind.copied().unwrap_or_default();
        self.array(name, kind, components, tuples, keyword == "SCALARS")
    }

    /// Reads the arrays of `FIELD`: those of the data set, the points or the cells.
    fn fields(&mut self, rest: &[&str]) -> Result<(), ReadError> {
        let count = self.number("FIELD", rest.get(1))?;
        for _ in 0..count {
            let line = self.next_line("FIELD")?;
            let words: Vec<&str> = line.split_whitespace().collect();
            // Metadata may follow an array of the data set.
            if words == ["METADATA"] {
                self.skip_metadata()?;
            }
            let line = if words == ["METADATA"] {
                self.next_line("FIELD")?
            } else {
                line
            };
            let words: Vec<&str> = line.split_whitespace().collect();
            let &[name, components, tuples, kind] = words.as_slice() else {
                return Err(self.error("FIELD", format!("{line:?}, expected a name, two numbers and a type")));
            };
            let [components, tuples] = [components, tuples].map(|n| self.number("FIELD", Some(&n)));
            let (components, tuples) = (components?, tuples?);
            match self.section {
                Some((_, expected)) if tuples != expected => {
                    let why = format!("{tuples} values of {name:?}, expected {expected}");
                    return Err(self.error("FIELD", why));
                }
                None if kind == "string" => self.strings(name, components.saturating_mul(tuples))?,
                _ => self.array(name, kind, components, tuples, false)?,
            }
        }
        Ok(())
    }

    /// Reads strings of the data set. The first one may state the meaning of positions.
    fn strings(&mut self, name: &str, count: u64) -> Result<(), ReadError> {
        for i in 0..count {
            let value = if self.text {
                self.next_line(name)?
            } else {
                self.binary_string()?
            };
            if i == 0 {
                self.world.set(name, &decoded(&value));
            }
        }
        Ok(())
    }

    /// Reads a string: its length, whose first two bits give the width of the length, then that many bytes.
    fn binary_string(&mut self) -> Result<String, ReadError> {
        let first = self.bytes(1)?[0];
        let more: usize = match first >> 6 {
            3 => 0,
            2 => 1,
            1 => 3,
            _ => 7,
        };
        let low = self.bytes(more)?;
        let length = low.iter().fold(u64::from(first & 63), |n, &b| n << 8 | u64::from(b));
        if length > MAX_LINE_BYTES {
            return Err(self.error(
                "FIELD",
                format!("a string of {length} bytes, expected {MAX_LINE_BYTES} at most"),
            ));
        }
        Ok(String::from_utf8_lossy(&self.bytes(length as usize)?).into_owned())
    }

    /// Records an array and skips its values.
    fn array(&mut self, name: &str, kind: &str, components: u64, tuples: u64, active: bool) -> Result<(), ReadError> {
        let kind = kind.to_ascii_lowercase();
        let values = components.checked_mul(tuples).ok_or_else(|| {
            self.error(
                "header",
                format!("{components} x {tuples} values of {name:?} pass 64 bits"),
            )
        })?;
        if kind == "bit" && !self.text {
            return self.skip_bytes(values.div_ceil(8));
        }
        let Some(stored) = stored_type(&kind).or((kind == "bit").then_some(StoredType::U8)) else {
            return Err(self.error(
                "header",
                format!("{name:?} is of type {kind:?}, expected char to double"),
            ));
        };
        let begin = self.at;
        self.skip_values(values, stored.bytes())?;
        let place = Span { begin, end: self.at };
        let list = match self.section {
            Some((false, _)) => &mut self.arrays.point,
            Some((true, _)) => &mut self.arrays.cell,
            None => return Ok(()),
        };
        let array = Array {
            name: decoded(name),
            components,
            component_names: Vec::new(),
            stored,
            type_name: kind,
            active: active && list.iter().all(|(other, _)| !other.active),
        };
        list.push((array, place));
        Ok(())
    }

    fn error(&self, field: &str, why: impl Into<String>) -> ReadError {
        ReadError::new(self.blob.path(), field, why)
    }

    fn io(&self, error: std::io::Error) -> ReadError {
        ReadError::io(self.blob.path(), "header", "cannot be read", error)
    }

    fn number(&self, field: &str, word: Option<&&str>) -> Result<u64, ReadError> {
        let word = word.copied().unwrap_or_default();
        word.parse()
            .map_err(|_| self.error(field, format!("{word:?}, expected a number")))
    }

    /// Reads the next line, without its end; `None` at the end of the file.
    fn line(&mut self) -> Result<Option<String>, ReadError> {
        let mut line = Vec::new();
        let read = (&mut self.stream).take(MAX_LINE_BYTES).read_until(b'\n', &mut line);
        let n = read.map_err(|e| self.io(e))? as u64;
        self.at += n;
        if n == MAX_LINE_BYTES {
            return Err(self.error("header", format!("a line of {n} bytes or more, expected keywords")));
        }
        Ok((n > 0).then(|| String::from_utf8_lossy(&line).trim_end().to_owned()))
    }

    /// Reads the next line that is not empty.
    fn next_line(&mut self, field: &str) -> Result<String, ReadError> {
        loop {
            match self.line()? {
                None => return Err(self.error(field, "the file ends within it")),
                Some(line) if line.is_empty() => {}
                Some(line) => return Ok(line),
            }
        }
    }

    /// Returns the next bytes without consuming them; fewer near the end of a buffer or the file.
    fn peek(&self, count: usize) -> Result<Vec<u8>, ReadError> {
        let mut bytes = Vec::new();
        let mut stream = self.blob.reader(self.at).take(count as u64);
        stream.read_to_end(&mut bytes).map_err(|e| self.io(e))?;
        Ok(bytes)
    }

    fn bytes(&mut self, count: usize) -> Result<Vec<u8>, ReadError> {
        let mut bytes = vec![0; count];
        self.stream.read_exact(&mut bytes).map_err(|e| self.io(e))?;
        self.at += count as u64;
        Ok(bytes)
    }

    /// Skips metadata, which end with an empty line.
    fn skip_metadata(&mut self) -> Result<(), ReadError> {
        while self.line()?.is_some_and(|line| !line.is_empty()) {}
        Ok(())
    }

    fn skip_values(&mut self, count: u64, bytes: u64) -> Result<(), ReadError> {
        if self.text {
            return self.skip_words(count);
        }
        let length = count
            .checked_mul(bytes)
            .ok_or_else(|| self.error("header", format!("{count} values pass 64 bits")))?;
        self.skip_bytes(length)
    }

    fn skip_bytes(&mut self, length: u64) -> Result<(), ReadError> {
        let end = self.at.checked_add(length).filter(|&end| end <= self.blob.len());
        self.at = end.ok_or_else(|| {
            let (left, at) = (self.blob.len() - self.at, self.at);
            self.error(
                "data",
                format!("{left} bytes from {at} on, expected {length}: the file may be cut off"),
            )
        })?;
        self.stream = BufReader::with_capacity(1 << 16, self.blob.reader(self.at));
        Ok(())
    }

    /// Skips numbers and the white space behind them.
    fn skip_words(&mut self, count: u64) -> Result<(), ReadError> {
        let (mut words, mut inside) = (0, false);
        loop {
            let blob = self.blob;
            let buffer = self
                .stream
                .fill_buf()
                .map_err(|e| ReadError::io(blob.path(), "header", "cannot be read", e))?;
            let mut used = 0;
            for byte in buffer {
                let blank = byte.is_ascii_whitespace();
                if !blank && !inside {
                    if words == count {
                        break;
                    }
                    words += 1;
                }
                inside = !blank;
                used += 1;
            }
            let end = used < buffer.len() || buffer.is_empty();
            self.stream.consume(used);
            self.at += used as u64;
            if end {
                break;
            }
        }
        if words < count {
            return Err(self.error(
                "data",
                format!("{words} numbers, expected {count}: the file may be cut off"),
            ));
        }
        if inside {
            let notice = "the last line has no end: if the file was cut off, its last number may be too short";
            self.notices.add(notice);
        }
        Ok(())
    }
}

fn stored_type(name: &str) -> Option<StoredType> {
    Some(match name {
        "char" | "signed_char" | "vtktypeint8" => StoredType::I8,
        "unsigned_char" | "vtktypeuint8" => StoredType::U8,
        "short" | "vtktypeint16" => StoredType::I16,
        "unsigned_short" | "vtktypeuint16" => StoredType::U16,
        "int" | "vtktypeint32" => StoredType::I32,
        "unsigned_int" | "vtktypeuint32" => StoredType::U32,
        // A long has 8 bytes in the writers that are in use. An id is written as an int.
        "long" | "vtktypeint64" => StoredType::I64,
        "unsigned_long" | "vtktypeuint64" => StoredType::U64,
        "vtkidtype" => StoredType::I32,
        "float" => StoredType::F32,
        "double" => StoredType::F64,
        _ => return None,
    })
}

/// Decodes a name, in which `%20` is a space.
fn decoded(name: &str) -> String {
    let mut bytes = Vec::new();
    let mut rest = name.as_bytes();
    while let [first, tail @ ..] = rest {
        let code = tail
            .get(..2)
            .filter(|_| *first == b'%')
            .and_then(|hex| u8::from_str_radix(std::str::from_utf8(hex).ok()?, 16).ok());
        bytes.push(code.unwrap_or(*first));
        rest = if code.is_some() { &tail[2..] } else { tail };
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

#[cfg(test)]
mod tests {
    use super::decoded;

    #[test]
    fn names_are_percent_decoded() {
        assert_eq!(decoded("a%20b%2"), "a b%2");
        assert_eq!(decoded("100%"), "100%");
    }
}
