//! HDF5 and NetCDF-4, by the crate `hdf5-reader`.
//!
//! Groups are walked here, and every object is visited once: links may form cycles. Samples in other files are not read.

use std::collections::{HashMap, HashSet};
use std::ops::Range;
use std::sync::Arc;

use bytemuck::TransparentWrapper;
use hdf5_reader::io::Cursor;
use hdf5_reader::messages::HdfMessage;
use hdf5_reader::messages::layout::DataLayout;
use hdf5_reader::{Dataset, Datatype, H5Type, Hdf5File, OpenOptions, SliceInfo, SliceInfoElem, Storage};

use super::super::super::FileLocation;
use super::super::super::stored::{DEFLATE_RATIO, Endian};
use super::file::{Attributes, Axis, Variable, VariableFile};
use super::filters::{self, ChunkLimit};
use super::hdf5_attributes::{known_attributes, value};
use super::hdf5_types::stored_type;
use super::labels::labels;

/// Maximum groups and datasets that are visited. In a file with more, the location must name one.
const MAX_OBJECTS: usize = 10_000;

/// An HDF5 file.
pub struct Hdf5 {
    file: Hdf5File,
    file_bytes: u64,
    chunk_limit: ChunkLimit,
}

impl Hdf5 {
    /// Reads the superblock.
    pub fn open(location: &FileLocation, storage: Arc<dyn Storage>) -> Result<Self, String> {
        let file_bytes = storage.len();
        let chunk_limit = ChunkLimit::default();
        // A chunk may be as large as its bytes can decode to. The caches are off: no chunk is read twice.
        let largest = usize::try_from(file_bytes.saturating_mul(DEFLATE_RATIO)).unwrap_or(usize::MAX);
        let options = OpenOptions::default()
            .with_filter_registry(filters::registry(&chunk_limit))
            .with_chunk_cache_bytes(0)
            .with_max_chunk_bytes(largest)
            .with_max_object_header_bytes(1 << 24);
        let file = Hdf5File::from_storage_with_options(storage, options)
            .map_err(|e| format!("{e}, expected an HDF5 or NetCDF file ({:?})", location.stem()))?;
        Ok(Self {
            file,
            file_bytes,
            chunk_limit,
        })
    }

    fn dataset(&self, path: &str) -> Result<Dataset, String> {
        self.file.dataset(path).map_err(|e| explain(&e))
    }

    /// Returns every group's datasets, each once, by path; and the groups that cannot be listed.
    fn walk(&self) -> (Vec<(String, Dataset)>, Vec<Variable>) {
        let (mut found, mut failed) = (Vec::new(), Vec::new());
        let mut seen = HashSet::new();
        let mut waiting = Vec::new();
        match self.file.root_group() {
            Ok(root) => waiting.push((String::new(), root)),
            Err(e) => failed.push(unreadable("/", explain(&e))),
        }
        while let Some((path, group)) = waiting.pop() {
            if !seen.insert(group.address()) {
                continue;
            }
            if seen.len() > MAX_OBJECTS {
                failed.push(unreadable(
                    "/",
                    format!("more than {MAX_OBJECTS} objects, expected the name of one"),
                ));
                break;
            }
            let child = |name: &str| format!("{path}/{}", name.rsplit('/').next().unwrap_or(name));
            match group.members() {
                Ok((groups, datasets)) => {
                    // The first group is visited next.
                    waiting.extend(groups.into_iter().rev().map(|group| (child(group.name()), group)));
                    for dataset in datasets {
                        if seen.insert(dataset.address()) {
                            found.push((child(dataset.name()), dataset));
                        }
                    }
                }
                Err(e) => failed.push(unreadable(&format!("{path}/"), explain(&e))),
            }
        }
        // Groups of the old format list their members in an order of their own.
        found.sort_by(|a, b| a.0.cmp(&b.0));
        (found, failed)
    }

    fn describe(&self, path: &str, dataset: &Dataset, scales: &HashMap<u64, Scale>) -> Variable {
        let dimensions = dimensions(dataset, self.file.superblock().offset_size);
        let max_dims = dataset.max_dims().unwrap_or_default();
        let attributes = known_attributes(dataset.attributes(), || dataset.raw_attributes());
        let labels = labels(&attributes, dataset.ndim());
        let axes = dataset
            .shape()
            .iter()
            .zip(labels)
            .enumerate()
            .map(|(i, (&size, mut label))| {
                let scale = dimensions.get(i).and_then(|address| scales.get(address));
                label.name = label.name.or_else(|| scale.and_then(|scale| scale.name.clone()));
                Axis {
                    dimension: scale.map(|scale| scale.path.clone()),
                    scale: scale.filter(|scale| scale.has_values).map(|scale| scale.path.clone()),
                    label,
                    size,
                    is_unlimited: max_dims.get(i) == Some(&u64::MAX),
                }
            });
        let stored = stored_type(dataset.dtype(), || dataset.raw_datatype());
        let mut variable = Variable {
            path: path.to_owned(),
            axes: axes.collect(),
            endian: stored.as_ref().map_or(Endian::Little, |(_, endian)| *endian),
            stored: stored.map(|(stored, _)| stored),
            attributes,
            chunk: dataset.chunks().map(|chunk| chunk.into_iter().map(u64::from).collect()),
            plain: None,
            is_scale: scales.contains_key(&dataset.address()),
            is_netcdf: false,
        };
        match self.check(&variable, dataset) {
            Ok(begin) => variable.plain = begin.map(|begin| (begin, variable.endian)),
            Err(why) => variable.stored = variable.stored.and(Err(why)),
        }
        variable
    }

    /// Compares what the dataset claims with the file, and reports features that are not read. Returns the offset of its samples, if they
    /// are contiguous.
    fn check(&self, variable: &Variable, dataset: &Dataset) -> Result<Option<u64>, String> {
        let bytes = variable
            .bytes()
            .ok_or_else(|| format!("{} samples pass 64 bits", variable.shape()))?;
        let have = self.file_bytes;
        if bytes > have.saturating_mul(DEFLATE_RATIO) {
            return Err(format!("{bytes} bytes, which a file of {have} cannot hold"));
        }
        let header = self.file.get_or_parse_header(dataset.address());
        let mut begin = None;
        for message in &header.map_err(|e| explain(&e))?.messages {
            match message {
                HdfMessage::ExternalFiles(_) => {
                    return Err("its samples are in other files (external storage), which are not read".into());
                }
                HdfMessage::FilterPipeline(pipeline) => filters::check(pipeline)?,
                HdfMessage::DataLayout(message) => {
                    if let DataLayout::Contiguous { address, .. } = message.layout {
                        begin = self.contiguous(address, bytes)?;
                    }
                }
                _ => {}
            }
        }
        Ok(begin)
    }

    /// Returns the offset of contiguous samples in the file; `None` if none was written, so that all have the dataset's fill value.
    fn contiguous(&self, address: u64, bytes: u64) -> Result<Option<u64>, String> {
        let superblock = self.file.superblock();
        if Cursor::is_undefined_offset(address, superblock.offset_size) {
            return Ok(None);
        }
        let begin = address.checked_add(superblock.base_address);
        match begin.and_then(|begin| begin.checked_add(bytes)) {
            Some(end) if end <= self.file_bytes => Ok(begin),
            _ => {
                let have = self.file_bytes;
                Err(format!(
                    "{bytes} bytes from {address} on, expected them in the file's {have}"
                ))
            }
        }
    }
}

/// A dataset whose axis other datasets share: HDF5's dimension scale.
struct Scale {
    path: String,
    /// Its name, beside that of the dataset.
    name: Option<String>,
    /// Whether it has the positions along the axis, not only its size.
    has_values: bool,
    /// Whether NetCDF wrote it.
    is_netcdf: bool,
}

impl VariableFile for Hdf5 {
    fn variables(&self) -> Vec<Variable> {
        let (found, failed) = self.walk();
        let scales = found
            .iter()
            .filter_map(|(path, dataset)| Some((dataset.address(), scale(path, dataset)?)));
        let scales: HashMap<u64, Scale> = scales.collect();
        let is_netcdf = scales.values().any(|scale| scale.is_netcdf);
        let described = found.iter().map(|(path, dataset)| Variable {
            is_netcdf,
            ..self.describe(path, dataset, &scales)
        });
        described.chain(failed).collect()
    }

    fn variable(&self, path: &str) -> Result<Variable, String> {
        Ok(self.describe(path, &self.dataset(path)?, &HashMap::new()))
    }

    fn attributes_of(&self, path: &str) -> Attributes {
        let (all, raw) = match self.file.group(path) {
            Ok(group) => (group.attributes().unwrap_or_default(), group.raw_attributes()),
            Err(_) => match self.dataset(path) {
                Ok(dataset) => (dataset.attributes(), dataset.raw_attributes()),
                Err(_) => return Attributes::default(),
            },
        };
        let raw = raw.unwrap_or_default();
        let encoded = |name: &str| {
            let found = raw.iter().find(|attribute| attribute.name() == name);
            let missing = || hdf5_reader::error::Error::AttributeNotFound(name.to_owned());
            found.map(|found| found.raw_datatype().to_vec()).ok_or_else(missing)
        };
        let read = all
            .into_iter()
            .filter_map(|a| Some((a.name.clone(), value(&a, || encoded(&a.name))?)));
        Attributes(read.collect())
    }

    fn members(&self, path: &str) -> [Vec<String>; 2] {
        let names = self.file.group(path).and_then(|group| group.member_names());
        let (mut groups, mut datasets) = names.unwrap_or_default();
        groups.sort();
        datasets.sort();
        [groups, datasets]
    }

    fn read(&self, variable: &Variable, selection: &[Range<u64>]) -> Result<Vec<u8>, String> {
        let dataset = self.dataset(&variable.path)?;
        self.chunk_limit.permit(variable.chunk_bytes());
        match variable.stored.clone()?.bytes() {
            1 => read_box::<1>(&dataset, selection),
            2 => read_box::<2>(&dataset, selection),
            4 => read_box::<4>(&dataset, selection),
            _ => read_box::<8>(&dataset, selection),
        }
    }
}

fn read_box<const N: usize>(dataset: &Dataset, selection: &[Range<u64>]) -> Result<Vec<u8>, String> {
    let selections = selection.iter().map(|range| SliceInfoElem::Slice {
        start: range.start,
        end: range.end,
        step: 1,
    });
    let selection = SliceInfo {
        selections: selections.collect(),
    };
    let samples = dataset.read_slice_parallel::<AsStored<N>>(&selection);
    let (samples, _) = samples.map_err(|e| explain(&e))?.into_raw_vec_and_offset();
    Ok(AsStored::peel_slice(&samples).as_flattened().to_vec())
}

/// A sample as bytes in the file's byte order.
#[derive(Clone, Copy, TransparentWrapper)]
#[repr(transparent)]
struct AsStored<const N: usize>([u8; N]);

impl<const N: usize> H5Type for AsStored<N> {
    fn hdf5_type() -> Datatype {
        Datatype::Opaque {
            size: N as u32,
            tag: String::new(),
        }
    }

    fn from_bytes(bytes: &[u8], _: &Datatype) -> hdf5_reader::error::Result<Self> {
        let bytes = bytes.get(..N).and_then(|bytes| bytes.try_into().ok());
        bytes
            .map(Self)
            .ok_or_else(|| hdf5_reader::error::Error::InvalidData(format!("a sample is cut off, expected {N} bytes")))
    }

    fn element_size(_: &Datatype) -> usize {
        N
    }

    fn decode_vec(bytes: &[u8], _: &Datatype, count: usize) -> Option<hdf5_reader::error::Result<Vec<Self>>> {
        let samples = Self::wrap_slice(bytes.as_chunks().0).get(..count)?;
        Some(Ok(samples.to_vec()))
    }

    /// Always true: every pattern of bytes is valid.
    fn native_copy_compatible(_: &Datatype) -> bool {
        true
    }
}

/// Returns the library's error text, with words for the format's numbers in the messages that are known here.
fn explain(error: &hdf5_reader::error::Error) -> String {
    error
        .to_string()
        .replace("unsupported layout class 3", "a virtual dataset, which is not read")
}

fn unreadable(path: &str, why: String) -> Variable {
    Variable {
        path: path.to_owned(),
        axes: Vec::new(),
        stored: Err(why),
        endian: Endian::Little,
        attributes: Attributes::default(),
        chunk: None,
        plain: None,
        is_scale: false,
        is_netcdf: false,
    }
}

fn scale(path: &str, dataset: &Dataset) -> Option<Scale> {
    let text = |name: &str| dataset.attribute(name).ok()?.read_string().ok();
    if text("CLASS")? != "DIMENSION_SCALE" {
        return None;
    }
    let name = text("NAME").filter(|name| !name.is_empty());
    let has_size_only = name
        .as_ref()
        .is_some_and(|name| name.starts_with("This is a netCDF dimension"));
    Some(Scale {
        path: path.to_owned(),
        // NetCDF stores the name of the dataset or a remark there.
        name: name.filter(|name| !has_size_only && name.len() <= 256),
        has_values: !has_size_only && dataset.ndim() == 1,
        is_netcdf: dataset.attribute("_Netcdf4Dimid").is_ok() || has_size_only,
    })
}

/// Returns the addresses of the dataset's scales, one for each axis; 0 for an axis without a scale.
fn dimensions(dataset: &Dataset, offset_bytes: u8) -> Vec<u64> {
    let Ok(list) = dataset.attribute("DIMENSION_LIST") else {
        return Vec::new();
    };
    let width = usize::from(offset_bytes);
    let entries = list
        .raw_data
        .chunks_exact(dataset.vlen_reference_size())
        .take(dataset.ndim());
    entries
        .map(|entry| {
            let references = dataset.resolve_vlen_reference_bytes(entry, width).unwrap_or_default();
            let first = references.get(..width).unwrap_or_default();
            first
                .iter()
                .rev()
                .fold(0, |address, &byte| address << 8 | u64::from(byte))
        })
        .collect()
}
