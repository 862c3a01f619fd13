//! HDF5 files whose groups follow a convention for the positions of samples: [VTKHDF](vtkhdf), [openPMD](openpmd), [Imaris](imaris) and
//! [BigDataViewer](big_data_viewer).
//!
//! If a location names a dataset of such a file by its path, the dataset is read as that of any HDF5 file.

mod big_data_viewer;
mod imaris;
mod openpmd;
mod vtkhdf;

use std::sync::Arc;

use super::super::super::{
    Field, FileLocation, Geometry, LabelRanks, Notices, OpenedFile, ReadError, ReadProgress, Sink, Source, TimeAxis,
};
use super::super::header::{self, Channels, GridFields};
use super::super::named_axes::AxisRoles;
use super::super::spim_data::SpimData;
use super::fields::fields_of;
use super::file::{Variable, VariableFile};
use super::layout::Layout;

/// Maximum time steps of a file.
const MAX_STEPS: usize = 1 << 16;

/// Opens a view of BigDataViewer, with the description in `data`.
pub(super) fn open_views(
    location: &FileLocation,
    file: &dyn VariableFile,
    data: &SpimData,
) -> Result<OpenedFile, ReadError> {
    big_data_viewer::open_described(location, file, data)
}

/// Opens a file of one of these kinds; `None` for any other file.
pub(super) fn open(location: &FileLocation, file: &dyn VariableFile) -> Option<Result<OpenedFile, ReadError>> {
    let [groups, _] = file.members("/");
    let is_named = location
        .part()
        .is_some_and(|part| file.variable(&format!("/{}", part.trim_start_matches('/'))).is_ok());
    if is_named {
        return None;
    }
    let has = |name: &str| groups.iter().any(|group| group == name);
    if has("VTKHDF") {
        return Some(vtkhdf::open(location, file));
    }
    if has("DataSet") && has("DataSetInfo") {
        return Some(imaris::open(location, file));
    }
    if has("t00000") && has("s00") {
        return Some(big_data_viewer::open(location, file));
    }
    let is_openpmd = file.attributes_of("/").text("openPMD").is_some();
    is_openpmd.then(|| openpmd::open(location, file))
}

/// Grid of the samples of arrays in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
struct World {
    spacing: [f64; 3],
    origin: [f64; 3],
    direction: [[f64; 3]; 3],
}

/// An array that has fields of a volume.
struct Array {
    variable: Variable,
    layout: Layout,
    channels: Channels,
}

impl Array {
    /// Describes a dataset whose axes have these roles.
    fn new(location: &FileLocation, variable: Variable, roles: &AxisRoles) -> Result<Self, ReadError> {
        let fail = |why: String| ReadError::new(location.path(), &variable.path, why);
        let layout = Layout::new(variable.sizes(), roles).map_err(fail)?;
        let name = variable.path.rsplit('/').next().unwrap_or_default();
        Ok(Self {
            channels: Channels::vector(name, layout.channels),
            variable,
            layout,
        })
    }
}

/// Returns the roles of axes in this order: time, if there is one, then z, y, x, and channels, if there are any.
fn roles_in_order(has_time: bool, has_channels: bool) -> AxisRoles {
    let first = usize::from(has_time);
    AxisRoles {
        space: [first + 2, first + 1, first],
        time: has_time.then_some(0),
        channel: has_channels.then_some(first + 3),
        has_time_in_space: false,
        notices: Vec::new(),
    }
}

/// Makes a volume of arrays on one grid.
fn volume(
    location: &FileLocation,
    arrays: &[Array],
    world: &World,
    names: &GridFields,
) -> Result<OpenedFile, ReadError> {
    let Some(first) = arrays.first() else {
        return Err(ReadError::new(
            location.path(),
            "datasets",
            "none on the grid, expected one at least",
        ));
    };
    if let Some(other) = arrays.iter().find(|other| other.layout.dims != first.layout.dims) {
        let why = format!(
            "{:?} samples, but {} has {:?}",
            other.layout.dims, first.variable.path, first.layout.dims
        );
        return Err(ReadError::new(
            location.path(),
            &other.variable.path,
            why + "; expected one grid",
        ));
    }
    let World {
        spacing,
        origin,
        direction,
    } = *world;
    let geometry = header::geometry(location.path(), names, first.layout.dims, spacing, origin, direction)?;
    let mut fields: Vec<Field> = Vec::new();
    for array in arrays {
        fields.extend(fields_of(
            location,
            array.channels.clone(),
            &array.variable,
            &geometry,
            &array.layout,
        )?);
    }
    Ok(OpenedFile {
        geometry,
        steps: first.layout.steps,
        uneven: None,
        axes: None,
        times: None,
        fields,
        notices: Notices::default(),
    })
}

/// A field with selected steps: step `i` is step `steps[i]` of the source.
#[derive(Debug)]
struct ChosenSteps {
    source: Arc<dyn Source>,
    steps: Vec<u32>,
}

impl ChosenSteps {
    fn number(&self, step: u32) -> u32 {
        // The source refuses steps beyond the last one.
        self.steps.get(step as usize).copied().unwrap_or(u32::MAX)
    }
}

impl Source for ChosenSteps {
    fn stored_bytes(&self) -> u64 {
        self.source.stored_bytes()
    }

    fn inputs(&self, step: u32) -> Vec<FileLocation> {
        self.source.inputs(self.number(step))
    }

    fn notices(&self) -> Notices {
        self.source.notices()
    }

    fn ranks(&self) -> Option<Arc<LabelRanks>> {
        self.source.ranks()
    }

    fn read(&self, step: u32, progress: &ReadProgress) -> Result<isopeel_kernels::Samples, ReadError> {
        self.source.read(self.number(step), progress)
    }

    fn read_pieces(
        &self,
        step: u32,
        progress: &ReadProgress,
        piece: usize,
        sink: &mut Sink<'_>,
    ) -> Result<(), ReadError> {
        self.source.read_pieces(self.number(step), progress, piece, sink)
    }
}

/// Times in seconds.
fn seconds(times: Option<Vec<f64>>) -> Option<TimeAxis> {
    times.and_then(|times| TimeAxis::listed(times, "s", None))
}

/// Returns the names that consist of `prefix` and a number, in the order of the numbers.
fn numbered(names: Vec<String>, prefix: &str) -> Vec<(u64, String)> {
    let number = |name: String| {
        let number = name.strip_prefix(prefix)?.trim().parse().ok()?;
        Some((number, name))
    };
    let mut found: Vec<(u64, String)> = names.into_iter().filter_map(number).collect();
    found.sort();
    found
}

/// A grid of samples 1 apart from 0.
fn of_index() -> World {
    World {
        spacing: [1.0; 3],
        origin: [0.0; 3],
        direction: Geometry::IDENTITY,
    }
}
