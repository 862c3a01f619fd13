//! VTK's XML image data, `.vti`, and rectilinear grids, `.vtr` (<https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html>).
//!
//! Read: text, base64 and appended arrays, plain or compressed with zlib or LZ4; both byte orders and both widths of
//! lengths; an extent that does not begin at 0; `Direction`; `Coordinates`. Refused with the reason: other data sets,
//! several pieces, LZMA.

pub(super) mod element;
mod numbers;

use std::io::{BufRead, BufReader};

use quick_xml::events::{BytesStart, Event};
use quick_xml::reader::Reader;

use super::{Array, Arrays, AsStored, Grid, World};
use crate::codec::VtkCompressor;
use crate::formats::header::GridFields;
use crate::location::{Blob, BlobReader};
use crate::rectilinear::Positions;
use crate::stored::Endian;
use crate::{FileLocation, OpenedFile, ReadError};
use element::GridAttributes;
use numbers::{Numbers, stored_type};

pub(super) const FIELDS: GridFields = GridFields {
    dims: "Extent",
    spacing: "Spacing",
    origin: "Origin",
    direction: "Direction",
};

pub(super) const RECTILINEAR_FIELDS: GridFields = GridFields {
    dims: "Extent",
    spacing: "Coordinates",
    origin: "Coordinates",
    direction: "Coordinates",
};

/// Maximum bytes of a string of the field data.
const MAX_TEXT_BYTES: u64 = 4096;

/// Reads the markup of a VTI or VTR file. Some rectilinear grids have the ending `.vti`.
///
/// # Errors
/// What is wrong with the file, by element or attribute.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let blob = location.open()?;
    let markup = Markup::parse(&blob)?;
    let field = markup.names().spacing;
    opened(location, &blob, markup)?.placed(location.path(), field)
}

/// As [`open`], for a piece of a larger grid, as it is stored.
///
/// # Errors
/// As for [`open`]; a grid of the other kind.
pub(super) fn open_piece(location: &FileLocation, kind: GridKind) -> Result<AsStored, ReadError> {
    let blob = location.open()?;
    let markup = Markup::parse(&blob)?;
    if markup.kind() != kind {
        let why = format!(
            "type {:?}, expected {}: a piece of such a grid",
            markup.kind().name(),
            kind.name()
        );
        return Err(markup.error("VTKFile", why));
    }
    opened(location, &blob, markup)
}

/// How a file gives the positions of its samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum GridKind {
    /// By a distance along each axis.
    Image,
    /// By a position of each sample along each axis.
    Rectilinear,
}

impl GridKind {
    pub const ALL: [Self; 2] = [Self::Image, Self::Rectilinear];

    /// Returns the format's name of the kind.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Image => "ImageData",
            Self::Rectilinear => "RectilinearGrid",
        }
    }
}

fn opened(location: &FileLocation, blob: &Blob<'_>, markup: Markup<'_>) -> Result<AsStored, ReadError> {
    let grid = markup.grid()?;
    let Markup { world, arrays, .. } = &markup;
    let arrays = Arrays {
        point: arrays.point.clone(),
        cell: arrays.cell.clone(),
    };
    let names = markup.names();
    super::opened(location, names, grid, world, arrays, |array, place, geometry| {
        markup.samples(location, blob, array, place, geometry)
    })
}

/// Elements whose arrays are read.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Section {
    Point,
    Cell,
    Field,
    Coordinates,
}

/// An array element that was opened and not closed yet.
struct OpenArray {
    section: Section,
    array: Option<Array>,
    name: String,
    format: String,
    offset: Option<u64>,
    content: Option<(u64, u64)>,
}

/// Everything in the file except the numbers.
struct Markup<'a> {
    blob: &'a Blob<'a>,
    endian: Endian,
    header_bytes: usize,
    compressor: Option<VtkCompressor>,
    extent: Vec<i64>,
    whole_extent: Vec<i64>,
    grid_attributes: GridAttributes,
    pieces: usize,
    world: World,
    arrays: Arrays<Numbers>,
    /// For a rectilinear grid: the positions along x, y and z.
    coordinates: Option<Vec<(Array, Numbers)>>,
    /// The section that is open.
    section: Option<Section>,
    /// Name of its active array.
    active: Option<String>,
    /// The array that is open.
    open: Option<OpenArray>,
    /// Offset at which appended data begin, and whether they are in base64.
    appended: Option<(u64, bool)>,
}

impl<'a> Markup<'a> {
    fn parse(blob: &'a Blob<'a>) -> Result<Self, ReadError> {
        let mut markup = Markup {
            blob,
            endian: Endian::Little,
            header_bytes: 4,
            compressor: None,
            extent: Vec::new(),
            whole_extent: Vec::new(),
            grid_attributes: GridAttributes::default(),
            pieces: 0,
            world: World::default(),
            arrays: Arrays::default(),
            coordinates: None,
            section: None,
            active: None,
            open: None,
            appended: None,
        };
        markup.read()?;
        Ok(markup)
    }

    /// Reads elements up to the appended data or the end.
    fn read(&mut self) -> Result<(), ReadError> {
        let mut reader = Reader::from_reader(BufReader::with_capacity(1 << 16, self.blob.reader(0)));
        reader.config_mut().expand_empty_elements = true;
        let (mut buffer, mut is_vtk) = (Vec::new(), false);
        loop {
            buffer.clear();
            let event = reader
                .read_event_into(&mut buffer)
                .map_err(|e| self.error("XML", format!("{e}, at byte {}", reader.error_position())))?;
            match event {
                Event::Start(element) => {
                    is_vtk |= element.name().as_ref() == "VTKFile";
                    if !is_vtk {
                        break;
                    }
                    self.start(&element)?;
                    if element.name().as_ref() == "AppendedData" {
                        self.append(&element, &mut reader)?;
                        break;
                    }
                }
                Event::End(element) => self.end(element.name().as_ref())?,
                Event::Eof => break,
                _ => {}
            }
            // Numbers are skipped without being held in memory.
            if let Some(array) = self.open.as_mut().filter(|array| array.content.is_none()) {
                array.content =
                    skip_text(&mut reader).map_err(|e| ReadError::io(self.blob.path(), "XML", "cannot be read", e))?;
            }
        }
        if !is_vtk {
            return Err(self.error("VTKFile", "no such element, expected VTK's XML format"));
        }
        Ok(())
    }

    fn start(&mut self, element: &BytesStart<'_>) -> Result<(), ReadError> {
        match element.name().as_ref() {
            "VTKFile" => self.file(element)?,
            "ImageData" | "RectilinearGrid" => self.image(element)?,
            "Piece" => self.piece(element)?,
            "PointData" => self.begin(Section::Point, element)?,
            "CellData" => self.begin(Section::Cell, element)?,
            "FieldData" => self.section = Some(Section::Field),
            "Coordinates" => self.section = Some(Section::Coordinates),
            "DataArray" | "Array" => {
                self.open = self.section.map(|section| self.array(section, element)).transpose()?;
            }
            _ => {}
        }
        Ok(())
    }

    fn end(&mut self, name: &str) -> Result<(), ReadError> {
        match name {
            "PointData" | "CellData" | "FieldData" | "Coordinates" => self.section = None,
            "DataArray" | "Array" => {
                if let Some(array) = self.open.take() {
                    self.close(array)?;
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn error(&self, field: &str, why: impl Into<String>) -> ReadError {
        ReadError::new(self.blob.path(), field, why)
    }

    fn attribute(&self, element: &BytesStart<'_>, name: &str) -> Result<Option<String>, ReadError> {
        element::attribute(self.blob.path(), element, name)
    }

    fn list<T: std::str::FromStr>(
        &self,
        element: &BytesStart<'_>,
        name: &str,
        count: usize,
    ) -> Result<Option<Vec<T>>, ReadError>
    where
        T::Err: std::fmt::Display,
    {
        element::list(self.blob.path(), element, name, count)
    }

    /// Evaluates `VTKFile`.
    fn file(&mut self, element: &BytesStart<'_>) -> Result<(), ReadError> {
        let kind = self.attribute(element, "type")?.unwrap_or_default();
        match kind.as_str() {
            "ImageData" => {}
            "RectilinearGrid" => self.coordinates = Some(Vec::new()),
            _ => {
                let why = format!("type {kind:?}, expected ImageData or RectilinearGrid: samples on a grid");
                return Err(self.error("VTKFile", why));
            }
        }
        self.endian = match self.attribute(element, "byte_order")?.as_deref() {
            None | Some("LittleEndian") => Endian::Little,
            Some("BigEndian") => Endian::Big,
            Some(other) => {
                return Err(self.error("byte_order", format!("{other:?}, expected LittleEndian or BigEndian")));
            }
        };
        self.header_bytes = match self.attribute(element, "header_type")?.as_deref() {
            None | Some("UInt32") => 4,
            Some("UInt64") => 8,
            Some(other) => return Err(self.error("header_type", format!("{other:?}, expected UInt32 or UInt64"))),
        };
        self.compressor = match self.attribute(element, "compressor")?.as_deref() {
            None | Some("") => None,
            Some("vtkZLibDataCompressor") => Some(VtkCompressor::Zlib),
            Some("vtkLZ4DataCompressor") => Some(VtkCompressor::Lz4),
            Some(other) => {
                let why = format!("{other:?}, expected none, vtkZLibDataCompressor or vtkLZ4DataCompressor");
                return Err(self.error("compressor", why));
            }
        };
        Ok(())
    }

    /// Evaluates `ImageData`.
    fn image(&mut self, element: &BytesStart<'_>) -> Result<(), ReadError> {
        self.whole_extent = self.list(element, "WholeExtent", 6)?.unwrap_or_default();
        self.grid_attributes.read(self.blob.path(), element)
    }

    fn piece(&mut self, element: &BytesStart<'_>) -> Result<(), ReadError> {
        self.pieces += 1;
        if self.pieces > 1 {
            return Err(self.error(
                "Piece",
                "several of them, expected one: images in pieces are not joined",
            ));
        }
        self.extent = self
            .list(element, "Extent", 6)?
            .unwrap_or_else(|| self.whole_extent.clone());
        Ok(())
    }

    /// Opens a section, such as `PointData` or `CellData`.
    fn begin(&mut self, section: Section, element: &BytesStart<'_>) -> Result<(), ReadError> {
        self.active = self.attribute(element, "Scalars")?;
        self.section = Some(section);
        Ok(())
    }

    /// Evaluates `DataArray`, and `Array` of strings.
    fn array(&self, section: Section, element: &BytesStart<'_>) -> Result<OpenArray, ReadError> {
        let kind = self.attribute(element, "type")?.unwrap_or_default();
        let name = self.attribute(element, "Name")?.unwrap_or_else(|| "values".to_owned());
        let count = |field: &str| -> Result<Option<u64>, ReadError> {
            Ok(self.list(element, field, 1)?.map(|values: Vec<u64>| values[0]))
        };
        let components = count("NumberOfComponents")?.unwrap_or(1);
        let component_names: Option<Vec<String>> = (0..components.min(64))
            .map(|i| self.attribute(element, &format!("ComponentName{i}")).transpose())
            .collect::<Option<Result<_, _>>>()
            .transpose()?;
        let array = stored_type(&kind).map(|stored| Array {
            components,
            component_names: component_names.unwrap_or_default(),
            stored,
            type_name: kind,
            active: self.active.as_ref() == Some(&name),
            name: name.clone(),
        });
        Ok(OpenArray {
            section,
            array,
            name,
            format: self.attribute(element, "format")?.unwrap_or_default(),
            offset: count("offset")?,
            content: None,
        })
    }

    /// Evaluates the end of an array.
    fn close(&mut self, open: OpenArray) -> Result<(), ReadError> {
        if open.section == Section::Field {
            return self.field(&open);
        }
        let Some(array) = open.array else {
            let path = self.blob.path().display();
            tracing::warn!(%path, "{:?} is passed over: it does not hold numbers", open.name);
            return Ok(());
        };
        let place = match (open.format.as_str(), open.offset, open.content) {
            ("appended", Some(offset), _) => Numbers::Appended { offset },
            ("appended", None, _) => return Err(self.error("offset", format!("missing, of {:?}", array.name))),
            ("ascii" | "binary", _, Some((begin, end))) => Numbers::Inline {
                text: open.format == "ascii",
                begin,
                end,
            },
            ("ascii" | "binary", _, None) => {
                return Err(self.error("DataArray", format!("{:?} is empty, expected numbers", array.name)));
            }
            (other, ..) => {
                return Err(self.error("format", format!("{other:?}, expected ascii, binary or appended")));
            }
        };
        match open.section {
            Section::Point => self.arrays.point.push((array, place)),
            Section::Coordinates => self.coordinates.get_or_insert_default().push((array, place)),
            _ => self.arrays.cell.push((array, place)),
        }
        Ok(())
    }

    /// Reads a string of the field data, written as the numbers of its bytes, the last of which is 0.
    fn field(&mut self, open: &OpenArray) -> Result<(), ReadError> {
        let Some((begin, end)) = open.content.filter(|_| open.format == "ascii" && open.array.is_none()) else {
            return Ok(());
        };
        let mut text = vec![0; (end - begin).min(MAX_TEXT_BYTES) as usize];
        self.blob
            .read_exact_at(&mut text, begin)
            .map_err(|e| ReadError::io(self.blob.path(), "FieldData", "cannot be read", e))?;
        let words = String::from_utf8_lossy(&text);
        let bytes: Vec<u8> = words.split_whitespace().map_while(|word| word.parse().ok()).collect();
        let bytes = bytes.strip_suffix(&[0]).unwrap_or(&bytes);
        self.world.set(&open.name, &String::from_utf8_lossy(bytes));
        Ok(())
    }

    /// Evaluates `AppendedData`, whose bytes begin behind an underscore.
    fn append(
        &mut self,
        element: &BytesStart<'_>,
        reader: &mut Reader<BufReader<BlobReader<'_>>>,
    ) -> Result<(), ReadError> {
        let base64 = match self.attribute(element, "encoding")?.as_deref() {
            Some("raw") => false,
            None | Some("base64") => true,
            Some(other) => return Err(self.error("AppendedData", format!("{other:?}, expected raw or base64"))),
        };
        let at = reader.buffer_position();
        let mut head = Vec::new();
        let read = reader.stream().read_until(b'_', &mut head);
        read.map_err(|e| ReadError::io(self.blob.path(), "AppendedData", "cannot be read", e))?;
        match head.split_last() {
            Some((b'_', before)) if before.iter().all(u8::is_ascii_whitespace) => {
                self.appended = Some((at + head.len() as u64, base64));
                Ok(())
            }
            _ => Err(self.error("AppendedData", "no underscore, expected one before the data")),
        }
    }

    fn kind(&self) -> GridKind {
        match self.coordinates {
            Some(_) => GridKind::Rectilinear,
            None => GridKind::Image,
        }
    }

    fn names(&self) -> &'static GridFields {
        match self.kind() {
            GridKind::Rectilinear => &RECTILINEAR_FIELDS,
            GridKind::Image => &FIELDS,
        }
    }

    fn grid(&self) -> Result<Grid, ReadError> {
        if self.pieces == 0 {
            return Err(self.error("Piece", "none, expected one"));
        }
        let path = self.blob.path();
        let extent = element::extent(path, "WholeExtent", &self.extent)?;
        let Some(coordinates) = &self.coordinates else {
            return self.grid_attributes.grid(path, extent);
        };
        let dims = element::dims(path, extent)?;
        let [x, y, z] = coordinates.as_slice() else {
            let why = format!("{} arrays, expected positions along x, y and z", coordinates.len());
            return Err(self.error("Coordinates", why));
        };
        let along = |axis: &str, (array, place): &(Array, Numbers), count: u32| -> Result<_, ReadError> {
            let values = self.values(array, place, u64::from(count))?;
            Ok(Positions::new(axis, values))
        };
        let positions = [
            along("x", x, dims[0])?,
            along("y", y, dims[1])?,
            along("z", z, dims[2])?,
        ];
        Grid::of_positions(positions).map_err(|why| self.error("Coordinates", why))
    }
}

/// Skips text up to the next markup. If it is more than white space, returns the offsets of its first byte and of the byte behind its
/// last.
fn skip_text<R: BufRead>(reader: &mut Reader<R>) -> std::io::Result<Option<(u64, u64)>> {
    let begin = reader.buffer_position();
    let (mut length, mut blank) = (0, true);
    let mut stream = reader.stream();
    loop {
        let bytes = stream.fill_buf()?;
        let markup = bytes.iter().position(|&b| b == b'<');
        let used = markup.unwrap_or(bytes.len());
        blank &= bytes[..used].iter().all(u8::is_ascii_whitespace);
        length += used as u64;
        let end = markup.is_some() || bytes.is_empty();
        stream.consume(used);
        if end {
            return Ok((!blank).then_some((begin, begin + length)));
        }
    }
}
