//! Volumes: file formats, datasets and the catalog.
//!
//! A file is read in two steps: [`read_file`] turns its header into a [`Field`] without reading samples, [`Source::read`] reads one
//! time step. A [`ReadError`] says what is wrong with a file.
//!
//! - [`Frame`], [`LengthUnit`]: what world positions mean.
//! - [`location`]: files on disk or in memory; tests and fuzzers use the latter. `remote`: stores over a network.
//! - [`formats`]: one header parser a format.
//! - [`Notices`]: what readers repaired or assumed. [`Label`]: what values of labels mean.
//! - `unpacked`: files that are compressed as a whole.
//! - [`stored`]: what a header says about the samples, checked against the file; `decode` reads them, by their type (`scalar`).
//! - `rectilinear`: uneven positions, and samples interpolated onto an even grid.
//! - [`open`]: makes a dataset of a file or a folder; `numbered`: files that are time steps.
//! - [`catalog`], [`demo`]: the datasets of a server; [`private`]: volumes of single users; [`watch`]: updates them when files change.
//! - `described`: a dataset that is sent to another process, without its samples; `json`: the JSON in it.
//! - [`memory_dataset`]: a dataset of samples in memory.
//! - `turned`: samples that are stored in another order than x fastest.
//! - [`TimeAxis`]: times of the steps. [`InputIdentity`]: identity of the files that steps are read from, to detect changes.
//! - [`disk`]: free space, and errors of full disks.
//! - [`statistics`]: range and histogram of a field, on the host.

mod axis_scales;
mod beneath;
pub mod catalog;
mod codec;
mod conversion;
mod decode;
pub mod demo;
mod described;
pub mod disk;
mod findings;
pub mod formats;
mod frame;
mod identity;
mod json;
mod labels;
pub mod location;
mod memory;
mod notices;
mod numbered;
pub mod open;
mod parallel;
mod pieces;
pub mod private;
mod progress;
mod read_error;
mod rectilinear;
mod remote;
mod replaced;
mod scalar;
pub mod statistics;
mod step;
pub mod stored;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
mod times;
mod turned;
mod unpacked;
pub mod vectors;
pub mod watch;

use std::collections::BTreeMap;
use std::sync::Arc;

use isopeel_geometry::{DAffine3, DVec3, IndexSpace, UnevenAxes};
use isopeel_kernels::interned::{self, StaticText};
use serde::{Deserialize, Serialize};

pub use axis_scales::{AxisKind, AxisScale, AxisScales};
pub use beneath::follow_links;
pub use catalog::{Catalog, SharedCatalog, Unreadable, open_each, open_path};
pub use demo::demo;
pub use findings::{Findings, LabelRanks};
pub use frame::{Frame, LengthUnit};
pub use identity::{IdentityError, InputIdentity, SeenFiles};
pub use isopeel_kernels::Samples;
pub use labels::{Label, MAX_LABELS};
pub use location::{FileLocation, FileStamp};
pub use memory::memory_dataset;
pub use notices::Notices;
pub use open::{open_dataset, read_file};
pub use private::{Lease, Reader};
pub use progress::ReadProgress;
pub use read_error::ReadError;
pub use remote::is_this_machine;
pub use step::{DatasetKey, StepKey, UnknownStep, VolumeStep};
pub use times::TimeAxis;

/// A dataset: fields that share one grid.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(remote = "Self")]
pub struct Dataset {
    /// Stable name in URLs: `[a-z0-9-]+`, unique in the catalog.
    pub id: String,
    /// Name for people.
    pub title: String,
    /// Layout of the samples in files, for display: `file`, `numbered steps`.
    #[serde(deserialize_with = "interned::deserialize")]
    pub layout: StaticText,
    /// Grid that all fields share.
    pub geometry: Geometry,
    /// Time steps, at least 1.
    pub steps: u32,
    /// Positions of the samples along the uneven axes, for which `geometry` has the mean distance; `None` if all axes are even.
    pub uneven: Option<Arc<UnevenAxes>>,
    /// What the positions along the axes are, if the file states it.
    pub axes: Option<Arc<AxisScales>>,
    /// Times of the steps, if the file states them and there are several steps.
    pub times: Option<TimeAxis>,
    /// Fields, the main one first; at least one.
    pub fields: Vec<Field>,
    /// Incremented when another dataset takes this one's id. Not incremented if the other one only has more steps: then see `rewrites`.
    pub revision: u32,
    /// How often the files of each step were rewritten; 0 for a step beyond the end of the list.
    pub rewrites: Vec<u32>,
    /// Copyright, source, and what readers repaired or assumed when they read headers, to show beside the data.
    pub notices: Notices,
    /// Edit that viewers open with, as JSON of the protocol; `None`: the defaults.
    #[serde(with = "json")]
    pub opening: Option<serde_json::Value>,
}

impl Dataset {
    /// Returns the field of this name.
    pub fn field(&self, name: &str) -> Option<&Field> {
        self.fields.iter().find(|f| f.name == name)
    }

    /// Returns the key that identifies the dataset and its revision.
    pub fn key(&self) -> DatasetKey {
        DatasetKey {
            id: self.id.clone(),
            revision: self.revision,
        }
    }

    /// Returns how often the files of a step were rewritten.
    pub fn rewrites(&self, step: u32) -> u32 {
        self.rewrites.get(step as usize).copied().unwrap_or(0)
    }

    /// Whether this is the earlier dataset again, perhaps with more time steps or with other samples in some of them.
    pub fn continues(&self, earlier: &Self) -> bool {
        let kinds =
            |dataset: &Self| -> Vec<_> { dataset.fields.iter().map(|f| (f.name.clone(), f.sample_type)).collect() };
        (&self.id, self.revision, self.geometry) == (&earlier.id, earlier.revision, earlier.geometry)
            && self.uneven == earlier.uneven
            && self.steps >= earlier.steps
            && kinds(self) == kinds(earlier)
    }

    /// Returns all notices to show beside the data, one a line, including those of the samples that were read so far.
    pub fn notice(&self) -> Option<String> {
        let mut notices = self.notices.clone();
        self.fields
            .iter()
            .for_each(|field| notices.extend(field.source.notices()));
        notices.text()
    }

    /// Changes the frame ([`Geometry::in_frame`]). The index frame counts samples, also those at uneven positions.
    pub fn set_frame(&mut self, frame: Frame) {
        self.geometry = self.geometry.in_frame(frame);
        if frame == Frame::Index && self.uneven.take().is_some() {
            self.notices.add(rectilinear::COUNTED);
        }
    }

    /// Returns the grid with one more sample at each end of each axis, and the positions of its samples in the world.
    pub fn padded_space(&self) -> (Geometry, IndexSpace) {
        let geometry = self.geometry.padded();
        let space = IndexSpace {
            world_from_even: geometry.world_from_index(),
            uneven: self.uneven.as_ref().map(|uneven| Arc::new(uneven.padded())),
        };
        (geometry, space)
    }

    /// Returns the positions of the samples in the world.
    pub fn sample_space(&self) -> IndexSpace {
        IndexSpace {
            world_from_even: self.geometry.world_from_index(),
            uneven: self.uneven.clone(),
        }
    }

    /// Returns the positions of the samples along the axes, world units from the first one; `padded`: with one more sample at each end.
    pub fn positions(&self, padded: bool) -> [Vec<f64>; 3] {
        let uneven = self.uneven.as_deref();
        let with_padding = uneven.filter(|_| padded).map(UnevenAxes::padded);
        let uneven = with_padding.as_ref().or(uneven);
        std::array::from_fn(|axis| {
            let spacing = self.geometry.spacing[axis];
            let count = self.geometry.dims[axis] + if padded { 2 } else { 0 };
            match uneven.and_then(|uneven| uneven.of_axis(axis)) {
                Some(even) => even.iter().map(|at| at * spacing).collect(),
                None => (0..count).map(|i| f64::from(i) * spacing).collect(),
            }
        })
    }

    /// Returns the lengths of the cell in which surfaces are cut and measured: along each axis the length of the largest cell. So
    /// distances, areas and errors are upper bounds of those in the world.
    pub fn cell_lengths(&self) -> [f64; 3] {
        let largest = self.uneven.as_ref().map_or([1.0; 3], |uneven| uneven.largest_steps());
        std::array::from_fn(|axis| self.geometry.spacing[axis] * largest[axis])
    }

    /// Returns the smallest of the [cell lengths](Self::cell_lengths), in world units. It is the unit of length on the device.
    pub fn smallest_length(&self) -> f64 {
        self.cell_lengths().into_iter().fold(f64::INFINITY, f64::min)
    }

    /// Returns the names of the fields, the main one first.
    pub fn field_names(&self) -> Vec<&str> {
        self.fields.iter().map(|field| field.name.as_str()).collect()
    }
}

/// Position of the samples in the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self")]
pub struct Geometry {
    /// Samples along x (fastest), y, z; at least 2 each.
    pub dims: [u32; 3],
    /// World units between samples; finite, above 0.
    pub spacing: [f64; 3],
    /// World position of sample (0, 0, 0).
    pub origin: [f64; 3],
    /// Unit vectors of the axes x, y, z in the world, as columns: `world = origin + Σ direction[axis] · spacing[axis] · index[axis]`.
    pub direction: [[f64; 3]; 3],
    /// What the world's axes are.
    pub frame: Frame,
    /// Unit of lengths in the world, if the file states it.
    pub unit: Option<LengthUnit>,
}

impl Geometry {
    /// The axes of the world.
    pub const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    /// Samples at distance 1, from 0 on, along the axes of a world without description.
    pub const fn of_index(dims: [u32; 3]) -> Self {
        Self {
            dims,
            spacing: [1.0; 3],
            origin: [0.0; 3],
            direction: Self::IDENTITY,
            frame: Frame::World,
            unit: None,
        }
    }

    /// Returns the number of samples of one time step.
    pub fn sample_count(&self) -> u64 {
        self.dims.iter().map(|&n| u64::from(n)).product()
    }

    /// Returns the grid with one more sample at each end of each axis.
    #[must_use]
    pub fn padded(&self) -> Self {
        let mut padded = *self;
        for axis in 0..3 {
            padded.dims[axis] += 2;
            for (origin, component) in padded.origin.iter_mut().zip(self.direction[axis]) {
                *origin -= self.spacing[axis] * component;
            }
        }
        padded
    }

    /// Converts positions and lengths from the unit `from` to the unit `to`. If one of them is unknown, the numbers stay as they are.
    #[must_use]
    pub fn in_unit(self, [from, to]: [Option<LengthUnit>; 2]) -> Self {
        let metres = |unit: Option<LengthUnit>| unit.and_then(LengthUnit::metres);
        let factor = match (metres(from), metres(to)) {
            (Some(from), Some(to)) if from != to => from / to,
            _ => 1.0,
        };
        Self {
            spacing: self.spacing.map(|spacing| spacing * factor),
            origin: self.origin.map(|component| component * factor),
            unit: to.or(from).or(self.unit),
            ..self
        }
    }

    /// Returns the transform from index space to the world.
    pub fn world_from_index(&self) -> DAffine3 {
        let [x, y, z] = [0, 1, 2].map(|axis| DVec3::from(self.direction[axis]) * self.spacing[axis]);
        DAffine3::from_cols(x, y, z, self.origin.into())
    }

    /// Returns the largest distance in the world between samples of equal indices in the two grids.
    pub(crate) fn farthest_from(&self, other: &Self) -> f64 {
        let [a, b] = [self, other].map(Self::world_from_index);
        let corners = (0..8).map(|corner: u32| {
            let at = [0, 1, 2].map(|axis| f64::from((corner >> axis & 1) * (self.dims[axis] - 1)));
            (a.transform_point3(at.into()) - b.transform_point3(at.into())).length()
        });
        corners.fold(0.0, f64::max)
    }

    /// Whether two grids are equal up to the rounding of a header that is written in decimal or in single precision.
    pub fn matches(&self, other: &Self) -> bool {
        const RELATIVE: f64 = 1e-4;
        let near = |a: f64, b: f64, scale: f64| (a - b).abs() <= RELATIVE * scale;
        self.dims == other.dims
            && self.frame == other.frame
            && self.unit == other.unit
            && (0..3).all(|a| {
                near(self.spacing[a], other.spacing[a], self.spacing[a])
                    && near(
                        self.origin[a],
                        other.origin[a],
                        self.spacing[a].max(self.origin[a].abs()),
                    )
                    && (0..3).all(|i| near(self.direction[a][i], other.direction[a][i], 1.0))
            })
    }

    /// Whether index axes are world axes.
    pub fn is_axis_aligned(&self) -> bool {
        self.direction == Self::IDENTITY
    }
}

/// One field of a dataset.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Field {
    /// Name, unique in its dataset: the file's stem, or the name inside the file.
    pub name: String,
    /// Type of the samples in the file, as the format names it.
    pub stored_type: String,
    /// Type on the device.
    pub sample_type: isopeel_kernels::SampleType,
    /// Value that means "no sample here", if the file declares one.
    pub missing: Option<f32>,
    /// Unit of the values, if the file declares one.
    pub unit: Option<String>,
    /// Names and colours of its labels, if the file has them; at most [`MAX_LABELS`].
    pub labels: Vec<Label>,
    /// Whether the file says that the values are labels, whatever they are called.
    pub declares_labels: bool,
    /// Reads the samples.
    #[serde(with = "described::source")]
    pub source: Arc<dyn Source>,
}

/// Words in names of fields whose values are labels, if they are whole numbers.
const LABEL_WORDS: [&str; 8] = [
    "label",
    "labels",
    "seg",
    "segmentation",
    "mask",
    "parcellation",
    "atlas",
    "aseg",
];

impl Field {
    /// Returns the labels of the field, each with the value of its samples: those that its file names, and those that are represented by
    /// ranks. In the order of their numbers in the file.
    pub fn all_labels(&self) -> Vec<(f32, Label)> {
        let ranks = self.source.ranks();
        let mut labels: BTreeMap<i128, (f32, Label)> = BTreeMap::new();
        for (rank, number) in ranks.iter().flat_map(|ranks| ranks.iter()).take(MAX_LABELS) {
            labels.insert(number, (rank, Label::new(number, "", None)));
        }
        for label in &self.labels {
            let value = ranks
                .as_ref()
                .map_or(label.value as f32, |ranks| ranks.position(label.value));
            labels.insert(label.value, (value, label.clone()));
        }
        labels.into_values().collect()
    }

    /// Whether the file says that the values are labels, by itself or by naming them.
    pub fn has_labels(&self) -> bool {
        self.declares_labels || !self.labels.is_empty()
    }

    /// Whether the values are labels as far as the header tells: the file says so, or the field's name and type suggest it.
    pub fn is_probably_labels(&self) -> bool {
        let name = self.name.to_lowercase();
        let mut words = name.split(|c: char| !c.is_ascii_alphabetic());
        self.has_labels()
            || (formats::label_table::may_be_labels(&self.stored_type) && words.any(|word| LABEL_WORDS.contains(&word)))
    }
}

/// Receives samples in the order of the grid.
pub type Sink<'a> = dyn FnMut(Samples) -> Result<(), ReadError> + 'a;

/// Maximum samples of a piece on its way to a device, 8 MiB. A transfer of this size takes longer than its fixed cost, and memory that was
/// freed is used again: from 32 MiB on, the allocator asks the system for new pages each time, and zeroing these took four fifths of the
/// reading time.
pub const PIECE_SAMPLES: usize = 2 << 20;

/// Returns the only piece of a reader whose pieces are whole time steps. Reads once more if the reader asks for it.
fn only_piece(mut read: impl FnMut(&mut Sink<'_>) -> Result<(), ReadError>) -> Result<Samples, ReadError> {
    let mut samples = Samples::U8(Vec::new());
    let mut take = |piece| {
        samples = piece;
        Ok(())
    };
    match read(&mut take) {
        Err(error) if error.can_retry => read(&mut take)?,
        read => read?,
    }
    Ok(samples)
}

/// Reads samples of one field.
pub trait Source: Send + Sync + std::fmt::Debug {
    /// Bytes of the file that [`Source::read`] reads for a time step. For compressed samples these are the bytes to the file's end, which
    /// are more than it reads for a step before the last one. If a library decodes the samples, decoded bytes.
    fn stored_bytes(&self) -> u64;

    /// Returns the files, folder or address that a time step is read from; none if the samples are in memory alone.
    fn inputs(&self, step: u32) -> Vec<FileLocation>;

    /// Reads one time step, x fastest, exactly `dims` samples. Adds to `progress` as it reads, [`Source::stored_bytes`] in all.
    ///
    /// # Errors
    /// What is wrong with the file.
    fn read(&self, step: u32, progress: &ReadProgress) -> Result<Samples, ReadError>;

    /// As [`Source::read`], but hands the samples to `sink` in their order. If the format allows it, in pieces of about `piece` samples
    /// each: the host holds a few of these, not the volume.
    ///
    /// # Errors
    /// What is wrong with the file, or what the sink says. [`ReadError::again`] asks the caller to drop all pieces and to read once more.
    fn read_pieces(
        &self,
        step: u32,
        progress: &ReadProgress,
        _piece: usize,
        sink: &mut Sink<'_>,
    ) -> Result<(), ReadError> {
        sink(self.read(step, progress)?)
    }

    /// Returns what was found in the samples that were read so far, such as values that the device's type cannot hold.
    fn notices(&self) -> Notices {
        Notices::default()
    }

    /// Returns the labels whose ranks the samples are, if the device's type cannot tell the labels apart; known after samples were read.
    fn ranks(&self) -> Option<Arc<LabelRanks>> {
        None
    }

    /// As [`Source::read`], without progress or cancellation.
    ///
    /// # Errors
    /// What is wrong with the file.
    fn load(&self, step: u32) -> Result<Samples, ReadError> {
        self.read(step, &ReadProgress::default())
    }
}

/// A file whose header was read.
#[derive(Clone, Debug)]
pub struct OpenedFile {
    /// Grid.
    pub geometry: Geometry,
    /// Time steps, at least 1.
    pub steps: u32,
    /// Positions of the samples along the uneven axes, for which `geometry` has the mean distance; `None` if all axes are even.
    pub uneven: Option<Arc<UnevenAxes>>,
    /// What the positions along the axes are, if the file states it.
    pub axes: Option<Arc<AxisScales>>,
    /// Times of the steps, if the file states them and there are several steps.
    pub times: Option<TimeAxis>,
    /// Its fields, the main one first; at least one.
    pub fields: Vec<Field>,
    /// What its reader repaired or assumed, and what the grid does not say.
    pub notices: Notices,
}

impl OpenedFile {
    /// Whether the samples of two files are at the same positions along axes that are not even.
    fn matches_positions(&self, other: &Self) -> bool {
        match (&self.uneven, &other.uneven) {
            (Some(a), Some(b)) => a.matches(b),
            (a, b) => a.is_none() && b.is_none(),
        }
    }
}
