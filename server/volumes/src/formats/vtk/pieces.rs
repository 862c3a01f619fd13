//! VTK's images in pieces, `.pvti`, and rectilinear grids in pieces, `.pvtr`, as programs with several processes write them.
//!
//! The file names `.vti` or `.vtr` files beside it, each with the part of the extent that it holds. Pieces share the samples on their
//! borders, and more if there are ghost levels: then those of the later piece are taken. All samples must be in a piece.

use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytemuck::Pod;
use isopeel_kernels::{SampleType, Samples};
use quick_xml::events::{BytesStart, Event};
use quick_xml::reader::Reader;

use super::xml::{self, GridKind, element};
use super::{AsStored, Grid, of_cells};
use crate::formats::header;
use crate::rectilinear::{self, Positions};
use crate::{Field, FileLocation, Geometry, Notices, OpenedFile, ReadError, ReadProgress, Source};
use element::{Extent, GridAttributes};

/// Maximum pieces of an image; programs write one for each process.
const MAX_PIECES: usize = 1 << 16;
/// Maximum boxes that remain free while pieces are subtracted. A regular division leaves a few for each of its layers.
const MAX_FREE_BOXES: usize = 1 << 14;

/// Reads the markup of a PVTI or PVTR file, and those of its pieces.
///
/// # Errors
/// What is wrong with the file or with a piece, by element or attribute.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let path = location.path();
    let image = Image::parse(location)?;
    let mut pieces = Vec::with_capacity(image.pieces.len());
    for (extent, name) in &image.pieces {
        let at = location.sibling(name, "Source")?;
        let stored = xml::open_piece(&at, image.kind)?;
        pieces.push(Piece {
            extent: *extent,
            stored,
            at,
        });
    }
    let Some(first) = pieces.first() else {
        return Err(ReadError::new(path, "Piece", "none, expected one at least"));
    };
    let of_points = element::dims(path, first.extent)?;
    // Cells have one sample fewer than points along each axis.
    let shrink = u32::from(first.stored.file.geometry.dims != of_points);
    let dims = element::dims(path, image.extent)?.map(|n| n - shrink.min(n));
    let boxes: Vec<Box3> = pieces
        .iter()
        .map(|piece| place(path, &image, shrink, piece))
        .collect::<Result<_, _>>()?;
    if let Some(free) = first_free(Box3::of(dims), &boxes) {
        let why = format!("sample {free:?} is in no piece, expected all of {dims:?} in one");
        return Err(ReadError::new(path, "Piece", why));
    }
    let (names, whole) = match image.kind {
        GridKind::Image if shrink == 1 => (&xml::FIELDS, of_cells(image.grid_attributes.grid(path, image.extent)?)),
        GridKind::Image => (&xml::FIELDS, Ok(image.grid_attributes.grid(path, image.extent)?)),
        GridKind::Rectilinear => (&xml::RECTILINEAR_FIELDS, joined_positions(dims, &pieces, &boxes)?),
    };
    let whole = whole.map_err(|why| ReadError::new(path, names.spacing, why))?;
    let placed = header::geometry(path, names, dims, whole.spacing, whole.origin, whole.direction)?;
    let of_first = &first.stored.file;
    let geometry = Geometry {
        frame: of_first.geometry.frame,
        unit: of_first.geometry.unit,
        ..placed
    };
    let sources: Vec<_> = pieces.iter().map(|piece| (&piece.at, &piece.stored.file)).collect();
    let fields = of_first
        .fields
        .iter()
        .map(|field| joined(path, field, &sources, &boxes, dims))
        .collect::<Result<_, _>>()?;
    let file = OpenedFile {
        geometry,
        steps: 1,
        uneven: None,
        axes: None,
        times: None,
        fields,
        notices: Notices::default(),
    };
    let stored = AsStored {
        file,
        positions: whole.positions,
    };
    stored.placed(path, names.spacing)
}

/// A piece as it is stored, with its location and with the extent that the image's file states.
struct Piece {
    extent: Extent,
    stored: AsStored,
    at: FileLocation,
}

/// Returns the grid of all pieces, by the positions of each. The inner error is one of the whole grid. The outer error: two pieces share a
/// sample and give different positions for it.
fn joined_positions(dims: [u32; 3], pieces: &[Piece], boxes: &[Box3]) -> Result<Result<Grid, String>, ReadError> {
    let mut axes = dims.map(|n| vec![f64::NAN; n as usize]);
    for (Piece { stored, at, .. }, of_box) in pieces.iter().zip(boxes) {
        for (axis, positions) in stored.positions.iter().flatten().enumerate() {
            let whole = &mut axes[axis][of_box.low[axis] as usize..of_box.high[axis] as usize];
            // Differences up to a thousandth of a step are rounding, as for even positions.
            let rounding = rectilinear::EVEN * positions.step().abs();
            for (i, (to, from)) in whole.iter_mut().zip(positions.values()).enumerate() {
                if (*to - from).abs() > rounding {
                    let why = format!(
                        "sample {i} along axis {axis} at {from}, and in another piece at {to}, expected the same"
                    );
                    return Err(ReadError::new(at.path(), "Coordinates", why));
                }
                *to = *from;
            }
        }
    }
    let [x, y, z] = axes;
    Ok(Grid::of_positions([
        Positions::new("x", x),
        Positions::new("y", y),
        Positions::new("z", z),
    ]))
}

/// Lists the pieces of an image on disk, as far as it can be read.
pub fn members(image: &Path) -> Vec<PathBuf> {
    let folder = image.parent().unwrap_or(Path::new(""));
    let parsed = Image::parse(&FileLocation::disk(image).packed_by_name());
    let pieces = parsed.map(|image| image.pieces).unwrap_or_default();
    pieces.into_iter().map(|(_, name)| folder.join(name)).collect()
}

/// Contents of the image's file.
struct Image {
    kind: GridKind,
    extent: Extent,
    grid_attributes: GridAttributes,
    /// The extent of each piece, and the name of its file.
    pieces: Vec<(Extent, String)>,
}

impl Image {
    fn parse(location: &FileLocation) -> Result<Self, ReadError> {
        let blob = location.open()?;
        let path = location.path();
        let mut reader = Reader::from_reader(BufReader::new(blob.reader(0)));
        let (mut buffer, mut kind, mut is_closed) = (Vec::new(), None, false);
        let (mut extent, mut grid_attributes, mut pieces) = (None, GridAttributes::default(), Vec::new());
        loop {
            buffer.clear();
            let event = reader.read_event_into(&mut buffer).map_err(|e| {
                let why = format!("{e}, at byte {}", reader.error_position());
                ReadError::new(path, "XML", why)
            })?;
            let element = match event {
                Event::Start(element) | Event::Empty(element) => element,
                Event::End(element) => {
                    is_closed |= element.name().as_ref() == "VTKFile";
                    continue;
                }
                Event::Eof => break,
                _ => continue,
            };
            match element.name().as_ref() {
                "VTKFile" => kind = Some(kind_of(path, &element)?),
                _ if kind.is_none() => break,
                "PImageData" | "PRectilinearGrid" => {
                    let numbers: Vec<i64> = element::list(path, &element, "WholeExtent", 6)?.unwrap_or_default();
                    extent = Some(element::extent(path, "WholeExtent", &numbers)?);
                    grid_attributes.read(path, &element)?;
                }
                "Piece" if pieces.len() < MAX_PIECES => pieces.push(piece(path, &element)?),
                "Piece" => {
                    let why = format!("more than {MAX_PIECES} of them, expected fewer");
                    return Err(ReadError::new(path, "Piece", why));
                }
                _ => {}
            }
        }
        let (Some(kind), Some(extent)) = (kind, extent) else {
            let why = "no such element, expected VTK's XML format for images or rectilinear grids in pieces";
            return Err(ReadError::new(path, "PImageData", why));
        };
        if !is_closed {
            let why = "ends too early, expected the element's end";
            return Err(ReadError::new(path, "VTKFile", why));
        }
        Ok(Self {
            kind,
            extent,
            grid_attributes,
            pieces,
        })
    }
}

/// Returns the kind of grid that the file holds, or an error.
fn kind_of(path: &Path, element: &BytesStart<'_>) -> Result<GridKind, ReadError> {
    let name = element::attribute(path, element, "type")?.unwrap_or_default();
    let is_of = |kind: &GridKind| name.strip_prefix('P') == Some(kind.name());
    GridKind::ALL.into_iter().find(is_of).ok_or_else(|| {
        let why = format!("type {name:?}, expected PImageData or PRectilinearGrid");
        ReadError::new(path, "VTKFile", why)
    })
}

fn piece(path: &Path, element: &BytesStart<'_>) -> Result<(Extent, String), ReadError> {
    let numbers: Vec<i64> = element::list(path, element, "Extent", 6)?.unwrap_or_default();
    let source = element::attribute(path, element, "Source")?;
    let source =
        source.ok_or_else(|| ReadError::new(path, "Source", "missing, expected the name of a piece's file"))?;
    Ok((element::extent(path, "Extent", &numbers)?, source))
}

/// Returns the box of a piece's samples in the whole. `shrink`: by how much fewer samples than points there are along an axis.
fn place(path: &Path, image: &Image, shrink: u32, piece: &Piece) -> Result<Box3, ReadError> {
    let (extent, file, at) = (piece.extent, &piece.stored.file, &piece.at);
    let dims = element::dims(path, extent)?.map(|n| n - shrink.min(n));
    if dims != file.geometry.dims {
        let why = format!(
            "{:?} samples, expected {dims:?}, as {} says",
            file.geometry.dims,
            path.display()
        );
        return Err(ReadError::new(at.path(), "Extent", why));
    }
    let begin: [Option<u32>; 3] = std::array::from_fn(|axis| {
        let offset = extent[axis][0].checked_sub(image.extent[axis][0])?;
        (extent[axis][1] <= image.extent[axis][1]).then_some(u32::try_from(offset).ok()?)
    });
    let [Some(x), Some(y), Some(z)] = begin else {
        let why = format!("{extent:?} of a piece, expected a part of {:?}", image.extent);
        return Err(ReadError::new(path, "Extent", why));
    };
    let low = [x, y, z];
    Ok(Box3 {
        low,
        high: std::array::from_fn(|axis| low[axis] + dims[axis]),
    })
}

/// Joins a field of all pieces. Each piece must have it, in the same type.
pub(super) fn joined(
    path: &Path,
    field: &Field,
    pieces: &[(&FileLocation, &OpenedFile)],
    boxes: &[Box3],
    dims: [u32; 3],
) -> Result<Field, ReadError> {
    let of_piece = |(at, file): &(&FileLocation, &OpenedFile)| {
        let found = file.fields.iter().find(|other| other.name == field.name);
        match found {
            Some(other) if other.sample_type == field.sample_type => Ok(other.source.clone()),
            found => {
                let has = found.map_or("missing", |other| other.sample_type.name());
                let why = format!("{has}, expected {}, as in the first piece", field.sample_type.name());
                Err(ReadError::new(at.path(), field.name.clone(), why))
            }
        }
    };
    let sources = pieces.iter().map(of_piece).collect::<Result<Vec<_>, _>>()?;
    Ok(Field {
        labels: Vec::new(),
        declares_labels: false,
        source: Arc::new(JoinedPieces {
            path: path.to_owned(),
            dims,
            sample_type: field.sample_type,
            pieces: boxes.iter().copied().zip(sources).collect(),
        }),
        ..field.clone()
    })
}

/// A box of samples, from `low` up to but not including `high`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Box3 {
    pub low: [u32; 3],
    pub high: [u32; 3],
}

impl Box3 {
    fn of(dims: [u32; 3]) -> Self {
        Self {
            low: [0; 3],
            high: dims,
        }
    }

    /// Adds to `rest` what remains of this box without the other one: up to six boxes.
    fn without(self, other: Self, rest: &mut Vec<Self>) {
        let is_apart = (0..3).any(|a| other.low[a] >= self.high[a] || other.high[a] <= self.low[a]);
        if is_apart {
            rest.push(self);
            return;
        }
        let mut inner = self;
        for axis in 0..3 {
            if other.low[axis] > inner.low[axis] {
                let mut below = inner;
                below.high[axis] = other.low[axis];
                rest.push(below);
                inner.low[axis] = other.low[axis];
            }
            if other.high[axis] < inner.high[axis] {
                let mut above = inner;
                above.low[axis] = other.high[axis];
                rest.push(above);
                inner.high[axis] = other.high[axis];
            }
        }
    }
}

/// Returns a sample that is in no box. Also returns a sample, which may be in a later box, if the boxes leave too many free boxes to tell.
pub(super) fn first_free(whole: Box3, boxes: &[Box3]) -> Option<[u32; 3]> {
    let mut free = vec![whole];
    for &taken in boxes {
        let mut rest = Vec::with_capacity(free.len() + 6);
        free.iter().for_each(|space| space.without(taken, &mut rest));
        free = rest;
        if free.len() > MAX_FREE_BOXES {
            break;
        }
    }
    free.first().map(|space| space.low)
}

/// A field of an image in pieces.
#[derive(Debug)]
struct JoinedPieces {
    path: PathBuf,
    dims: [u32; 3],
    sample_type: SampleType,
    pieces: Vec<(Box3, Arc<dyn Source>)>,
}

impl Source for JoinedPieces {
    fn stored_bytes(&self) -> u64 {
        self.pieces.iter().map(|(_, source)| source.stored_bytes()).sum()
    }

    fn inputs(&self, step: u32) -> Vec<FileLocation> {
        self.pieces.iter().flat_map(|(_, source)| source.inputs(step)).collect()
    }

    fn read(&self, step: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        match self.sample_type {
            SampleType::U8 => self.join(step, progress, as_u8).map(Samples::U8),
            SampleType::I8 => self.join(step, progress, as_i8).map(Samples::I8),
            SampleType::U16 => self.join(step, progress, as_u16).map(Samples::U16),
            SampleType::I16 => self.join(step, progress, as_i16).map(Samples::I16),
            SampleType::F32 => self.join(step, progress, as_f32).map(Samples::F32),
        }
    }
}

macro_rules! typed {
    ($($name:ident: $variant:ident($t:ty)),*) => {$(
        fn $name(samples: &Samples) -> Option<&[$t]> {
            match samples {
                Samples::$variant(values) => Some(values),
                _ => None,
            }
        }
    )*};
}
typed!(as_u8: U8(u8), as_i8: I8(i8), as_u16: U16(u16), as_i16: I16(i16), as_f32: F32(f32));

impl JoinedPieces {
    /// Reads one piece after another, so that at most one is in memory beside the whole.
    fn join<T: Pod>(
        &self,
        step: u32,
        progress: &ReadProgress,
        typed: impl Fn(&Samples) -> Option<&[T]>,
    ) -> Result<Vec<T>, ReadError> {
        let error = |why: String| ReadError::new(&self.path, "data", why);
        let [nx, ny, nz] = self.dims.map(|n| n as usize);
        let count = nx.checked_mul(ny).and_then(|n| n.checked_mul(nz));
        let mut whole: Vec<T> = count
            .and_then(|n| bytemuck::allocation::try_zeroed_vec(n).ok())
            .ok_or_else(|| error(format!("no memory for {:?} samples", self.dims)))?;
        for (at, source) in &self.pieces {
            let samples = source.read(step, progress)?;
            let row = (at.high[0] - at.low[0]) as usize;
            let rows = (at.low[2]..at.high[2]).flat_map(|z| (at.low[1]..at.high[1]).map(move |y| (y, z)));
            let values = typed(&samples).ok_or_else(|| error("a piece of another type".to_owned()))?;
            for ((y, z), from) in rows.zip(values.chunks_exact(row)) {
                let to = (z as usize * ny + y as usize) * nx + at.low[0] as usize;
                whole[to..to + row].copy_from_slice(from);
            }
        }
        Ok(whole)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_that_is_in_no_box_is_found() {
        let whole = Box3::of([4, 3, 2]);
        let left = Box3 {
            low: [0; 3],
            high: [2, 3, 2],
        };
        let right = Box3 {
            low: [2, 0, 0],
            high: [4, 3, 2],
        };
        assert_eq!(first_free(whole, &[left, right]), None);
        assert_eq!(first_free(whole, &[left]), Some([2, 0, 0]));
        let short = Box3 {
            high: [4, 3, 1],
            ..right
        };
        assert_eq!(first_free(whole, &[left, short]), Some([2, 0, 1]));
        assert_eq!(first_free(whole, &[right, whole]), None);
    }
}
