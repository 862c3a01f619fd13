//! VTK's images: the XML format [`.vti`](xml), the same with positions along each axis (`.vtr`), both in [pieces](pieces), lists of such
//! files with a time for each, [`.pvd`](collection), in which several may be parts of one time, and the older format, [`.vtk`](legacy).
//!
//! Images hold arrays of point data or cell data on one grid, of which each component is a field, the active scalars
//! first. Cell data are read if there are no point data; their grid is that of the cells' centres. Positions are in
//! the file's own world, without a unit; arrays `frame` and `unit` in the field data, as isopeel's own VTP has them,
//! are read back. The format has no missing value.

pub mod collection;
pub mod legacy;
mod parts;
pub mod pieces;
pub mod xml;

use std::path::Path;

use super::header::{self, Channels, FieldHead, GridFields, MAX_CHANNELS};
use crate::rectilinear::{self, Positions};
use crate::stored::{StoredSamples, StoredType};
use crate::{Field, FileLocation, Frame, Geometry, LengthUnit, Notices, OpenedFile, ReadError};

/// Arrays that mark points and cells as copies of another piece's. They are no samples of the volume.
const GHOSTS: [&str; 2] = ["vtkGhostType", "vtkGhostLevels"];

/// Notices of features that other programs treat differently.
pub(super) const UNUSED_GHOSTS: &str = "vtkGhostType is not used: points and cells that it hides are shown";
pub(super) const CELL_DATA: &str = "there are no point data: cell data are read, at the cells' centres";

/// A grid of points.
struct Grid {
    dims: [u32; 3],
    spacing: [f64; 3],
    origin: [f64; 3],
    direction: [[f64; 3]; 3],
    /// Positions of the samples along the axes, if the file lists them.
    positions: Option<[Positions; 3]>,
}

impl Grid {
    /// Points at these positions along x, y and z.
    fn of_positions(positions: [Result<Positions, String>; 3]) -> Result<Self, String> {
        let [x, y, z] = positions;
        let positions = [x?, y?, z?];
        let mut direction = Geometry::IDENTITY;
        for (axis, positions) in positions.iter().enumerate() {
            direction[axis][axis] = positions.step().signum();
        }
        Ok(Self {
            dims: [0, 1, 2].map(|axis: usize| positions[axis].count() as u32),
            spacing: [0, 1, 2].map(|axis: usize| positions[axis].step().abs()),
            origin: [0, 1, 2].map(|axis: usize| positions[axis].first()),
            direction,
            positions: Some(positions),
        })
    }
}

/// An array that a header describes.
#[derive(Clone, Debug)]
struct Array {
    name: String,
    components: u64,
    /// Names of the components, if the file has them.
    component_names: Vec<String>,
    stored: StoredType,
    type_name: String,
    /// Whether it is the active array of its kind, which programs show first.
    active: bool,
}

/// Meaning of the positions, as the field data state it.
#[derive(Default)]
struct World {
    frame: Frame,
    unit: Option<LengthUnit>,
}

impl World {
    /// Evaluates a string of the field data.
    fn set(&mut self, name: &str, value: &str) {
        match name {
            "frame" => {
                let known = [Frame::Lps, Frame::Ras, Frame::Index];
                self.frame = known.into_iter().find(|f| f.name() == value).unwrap_or_default();
            }
            "unit" => self.unit = LengthUnit::parse(value),
            _ => {}
        }
    }
}

/// Arrays on points or on cells, each with what its format knows about its place in the file.
struct Arrays<P> {
    point: Vec<(Array, P)>,
    cell: Vec<(Array, P)>,
}

impl<P> Default for Arrays<P> {
    fn default() -> Self {
        Self {
            point: Vec::new(),
            cell: Vec::new(),
        }
    }
}

/// Returns the grid of the cells' centres.
fn of_cells(mut grid: Grid) -> Result<Grid, String> {
    if let Some(positions) = &grid.positions {
        return Grid::of_positions([0, 1, 2].map(|axis: usize| positions[axis].between()));
    }
    for axis in 0..3 {
        grid.dims[axis] = grid.dims[axis].saturating_sub(1);
        let half = 0.5 * grid.spacing[axis];
        for row in 0..3 {
            grid.origin[row] += half * grid.direction[axis][row];
        }
    }
    Ok(grid)
}

/// A file as it is stored. If it lists the positions of its samples along the axes, these are in `positions`; else the grid of `file`
/// holds.
struct AsStored {
    file: OpenedFile,
    positions: Option<[Positions; 3]>,
}

impl AsStored {
    /// Returns the file with its samples at their positions. `field` names the source of the positions in error messages.
    fn placed(self, path: &Path, field: &str) -> Result<OpenedFile, ReadError> {
        match &self.positions {
            Some(positions) => {
                let even = rectilinear::on_even_grid(path, self.file, positions);
                even.map_err(|why| ReadError::new(path, field, why))
            }
            None => Ok(self.file),
        }
    }
}

/// Makes fields of the arrays, one for each component. `samples` describes the samples of an array as if it had one component.
fn opened<P>(
    location: &FileLocation,
    names: &GridFields,
    mut grid: Grid,
    world: &World,
    mut arrays: Arrays<P>,
    samples: impl Fn(&Array, &P, &Geometry) -> Result<StoredSamples, ReadError>,
) -> Result<AsStored, ReadError> {
    let path = location.path();
    let mut notices = Notices::default();
    let has_ghosts = |list: &[(Array, P)]| list.iter().any(|(array, _)| array.name == GHOSTS[0]);
    if has_ghosts(&arrays.point) || has_ghosts(&arrays.cell) {
        notices.add(UNUSED_GHOSTS);
    }
    for list in [&mut arrays.point, &mut arrays.cell] {
        list.retain(|(array, _)| !GHOSTS.contains(&array.name.as_str()));
    }
    let mut chosen = arrays.point;
    if chosen.is_empty() {
        notices.add(CELL_DATA);
        chosen = arrays.cell;
        grid = of_cells(grid).map_err(|why| ReadError::new(path, names.spacing, why))?;
    }
    if chosen.is_empty() {
        let why = "no array of numbers in it, expected one at least";
        return Err(ReadError::new(path, "PointData", why));
    }
    chosen.sort_by_key(|(array, _)| !array.active);
    let placed = header::geometry(path, names, grid.dims, grid.spacing, grid.origin, grid.direction)?;
    let geometry = Geometry {
        frame: world.frame,
        unit: world.unit,
        ..placed
    };
    let mut file = OpenedFile {
        geometry,
        steps: 1,
        uneven: None,
        axes: None,
        times: None,
        fields: Vec::new(),
        notices,
    };
    for (array, place) in &chosen {
        for field in fields(path, names.dims, array, samples(array, place, &geometry)?)? {
            if file.fields.iter().any(|other| other.name == field.name) {
                let why = format!("two arrays {:?}, expected different names", field.name);
                return Err(ReadError::new(path, "Name", why));
            }
            file.fields.push(field);
        }
    }
    Ok(AsStored {
        file,
        positions: grid.positions,
    })
}

/// Makes a field for each component of an array.
fn fields(path: &Path, size_field: &str, array: &Array, samples: StoredSamples) -> Result<Vec<Field>, ReadError> {
    if !(1..=MAX_CHANNELS).contains(&array.components) {
        let why = format!("{} of {:?}, expected 1 to {MAX_CHANNELS}", array.components, array.name);
        return Err(ReadError::new(path, "NumberOfComponents", why));
    }
    let count = array.components as u32;
    let samples = samples.interleaved(count, size_field)?;
    samples.check(size_field)?;
    let channels = match array.component_names.len() {
        n if n as u64 == array.components && n > 1 => Channels::named(&array.name, &array.component_names),
        _ => Channels::vector(&array.name, count),
    };
    let like = FieldHead {
        name: array.name.clone(),
        stored_type: array.type_name.clone(),
        missing: None,
        unit: None,
    };
    Ok(channels.fields(&samples, 1, &like))
}
