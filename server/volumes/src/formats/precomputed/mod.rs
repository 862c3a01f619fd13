//! Neuroglancer's precomputed volumes
//! (<https://github.com/google/neuroglancer/blob/master/src/datasource/precomputed/volume.md>): a folder with a file `info`, or
//! `precomputed://` before the address of a store over a network.
//!
//! Read: `raw`, `jpeg` and `compressed_segmentation` chunks, each plain or gzip; chunks in files of their own or in shards. The finest
//! scale of at most 2^31 samples is opened, or the scale that is named by its key or number: `folder:8_8_8`. Channels become fields.
//! Samples are at the centres of voxels; lengths are in nanometres.

mod encoding;
mod samples;
mod sharding;

use std::path::Path;
use std::sync::Arc;

use serde::Deserialize;

use super::FolderVolume;
use super::header::{self, GridFields, MAX_CHANNELS};
use super::store::{Store, never};
use crate::location::title_of;
use crate::remote::Part;
use crate::stored::StoredType;
use crate::{Field, FileLocation, Geometry, LengthUnit, Notices, OpenedFile, ReadError};
use encoding::Encoding;
use samples::PrecomputedSamples;
use sharding::Sharding;

const FIELDS: GridFields = GridFields {
    dims: "size",
    spacing: "resolution",
    origin: "voxel_offset",
    direction: "resolution",
};

/// Name of the file of metadata.
const INFO: &str = "info";
/// Maximum bytes of `info`, far above any real one.
const MAX_INFO_BYTES: u64 = 1 << 20;
/// Maximum samples of a scale that is opened without being named.
const MAX_SCALE_SAMPLES: u64 = 1 << 31;
/// Maximum bytes of a decoded chunk.
const MAX_CHUNK_BYTES: u64 = 1 << 30;

/// `info`. Members that do not describe samples are ignored.
#[derive(Deserialize)]
struct Info {
    #[serde(rename = "@type", default)]
    kind: Option<String>,
    data_type: String,
    num_channels: u32,
    scales: Vec<Scale>,
}

#[derive(Clone, Deserialize)]
struct Scale {
    key: String,
    size: [u64; 3],
    resolution: [f64; 3],
    #[serde(default)]
    voxel_offset: [i64; 3],
    chunk_sizes: Vec<[u64; 3]>,
    encoding: String,
    compressed_segmentation_block_size: Option<[u64; 3]>,
    #[serde(default)]
    sharding: Option<Sharding>,
}

/// Whether a folder has an `info` with scales.
pub fn holds(folder: &Path) -> bool {
    let has_scales =
        |text: &[u8]| serde_json::from_slice::<serde_json::Value>(text).is_ok_and(|info| info.get("scales").is_some());
    let info = folder.join(INFO);
    folder.is_dir()
        && info
            .metadata()
            .is_ok_and(|meta| meta.is_file() && meta.len() <= MAX_INFO_BYTES)
        && std::fs::read(info).is_ok_and(|text| has_scales(&text))
}

/// Reads `info` and opens a scale.
///
/// # Errors
/// What is wrong with `info`, by member.
pub fn open(location: &FileLocation) -> Result<Vec<FolderVolume>, ReadError> {
    let store = Arc::new(Store::plain(location, INFO)?);
    let shown = store.path(INFO);
    let Some(text) = store.read(INFO, Part::Whole, MAX_INFO_BYTES, &never)? else {
        return Err(store.error(INFO, "not there, expected it in a precomputed volume"));
    };
    let info: Info = serde_json::from_slice(&text.bytes).map_err(|e| store.error(INFO, e.to_string()))?;
    info.check(&shown)?;
    let scale = info.scale(&shown, location.part())?;
    let mut title = match location.address() {
        Some(address) => address.shown().rsplit('/').next().unwrap_or_default().to_owned(),
        None => title_of(location.path()),
    };
    let field = title.clone();
    if location.part().is_some() {
        title = format!("{title} {}", scale.key);
    }
    let file = open_scale(&store, &info, scale, &field)?;
    Ok(vec![FolderVolume { title, file }])
}

impl Info {
    fn check(&self, shown: &Path) -> Result<(), ReadError> {
        let fail = |field: &str, why: String| Err(ReadError::new(shown, field, why));
        match self.kind.as_deref() {
            None | Some("neuroglancer_multiscale_volume") => {}
            Some(other) => return fail("@type", format!("{other:?}, expected neuroglancer_multiscale_volume")),
        }
        if !(1..=MAX_CHANNELS).contains(&u64::from(self.num_channels)) {
            let why = format!("{}, expected 1 to {MAX_CHANNELS}", self.num_channels);
            return fail("num_channels", why);
        }
        Ok(())
    }

    fn stored_type(&self, shown: &Path) -> Result<StoredType, ReadError> {
        Ok(match self.data_type.to_ascii_lowercase().as_str() {
            "uint8" => StoredType::U8,
            "int8" => StoredType::I8,
            "uint16" => StoredType::U16,
            "int16" => StoredType::I16,
            "uint32" => StoredType::U32,
            "int32" => StoredType::I32,
            "uint64" => StoredType::U64,
            "float32" => StoredType::F32,
            other => {
                let why = format!("{other:?}, expected uint8, int8, uint16, int16, uint32, int32, uint64 or float32");
                return Err(ReadError::new(shown, "data_type", why));
            }
        })
    }

    /// Returns the scale that is named, or the finest one that is not too large.
    fn scale(&self, shown: &Path, part: Option<&str>) -> Result<&Scale, ReadError> {
        let fail = |why: String| Err(ReadError::new(shown, "scales", why));
        let keys: Vec<&str> = self.scales.iter().map(|scale| scale.key.as_str()).collect();
        if let Some(part) = part {
            let number = || part.parse::<usize>().ok().filter(|&number| number < keys.len());
            return match keys.iter().position(|key| *key == part).or_else(number) {
                Some(at) => Ok(&self.scales[at]),
                None => fail(format!("no {part:?} among them, expected one of {keys:?}")),
            };
        }
        let samples = |scale: &Scale| scale.size.iter().try_fold(1u64, |n, &size| n.checked_mul(size));
        let fits = |scale: &&Scale| samples(scale).is_some_and(|n| n <= MAX_SCALE_SAMPLES);
        let Some(scale) = self.scales.iter().find(fits) else {
            return fail(format!(
                "{keys:?}, expected one of 2^31 samples at most, or one that is named"
            ));
        };
        Ok(scale)
    }
}

fn open_scale(store: &Arc<Store>, info: &Info, scale: &Scale, name: &str) -> Result<OpenedFile, ReadError> {
    let shown = store.path(INFO);
    let dims = header::three(&shown, "size", &header::sizes(&shown, "size", &scale.size)?)?;
    let origin = std::array::from_fn(|axis| (scale.voxel_offset[axis] as f64 + 0.5) * scale.resolution[axis]);
    let placed = header::geometry(&shown, &FIELDS, dims, scale.resolution, origin, Geometry::IDENTITY)?;
    let geometry = Geometry {
        unit: Some(LengthUnit::Nanometre),
        ..placed
    };
    let stored = info.stored_type(&shown)?;
    let chunk = scale.chunk(&shown, u64::from(info.num_channels) * stored.bytes())?;
    let layout = samples::Layout {
        key: scale.key.clone(),
        dims,
        offset: scale.voxel_offset,
        chunk,
        channels: info.num_channels,
        stored,
        encoding: Encoding::of(scale, info, stored).map_err(|why| ReadError::new(&shown, "encoding", why))?,
        sharding: scale.sharding.clone(),
    };
    if let Some(sharding) = &layout.sharding {
        sharding
            .check()
            .map_err(|why| ReadError::new(&shown, "sharding", why))?;
    }
    let base = PrecomputedSamples::new(store.clone(), layout)?;
    let header::Channels::Fields(names) = header::Channels::numbered(name, info.num_channels) else {
        unreachable!("channels that are numbered are fields");
    };
    let field = |(channel, name): (u32, String)| Field {
        name,
        stored_type: info.data_type.clone(),
        sample_type: stored.on_device(),
        missing: None,
        unit: None,
        labels: Vec::new(),
        declares_labels: false,
        source: Arc::new(base.of_channel(channel)),
    };
    let mut notices = Notices::default();
    if info.scales.first().is_some_and(|finest| finest.key != scale.key) {
        notices.add(format!(
            "scale {} of {} is read: another one is finer, which was not named, or has more than 2^31 samples",
            scale.key,
            info.scales.len()
        ));
    }
    Ok(OpenedFile {
        geometry,
        steps: 1,
        uneven: None,
        axes: None,
        times: None,
        fields: (0..).zip(names).map(field).collect(),
        notices,
    })
}

impl Scale {
    /// Returns the voxels of a chunk along x, y, z. If there are several sizes of chunks, those of the first size are read.
    fn chunk(&self, shown: &Path, voxel_bytes: u64) -> Result<[u64; 3], ReadError> {
        let fail = |why: String| Err(ReadError::new(shown, "chunk_sizes", why));
        let Some(&chunk) = self.chunk_sizes.first() else {
            return fail("none, expected one at least".to_owned());
        };
        if chunk.contains(&0) {
            return fail(format!("{chunk:?}, expected numbers above 0"));
        }
        // No chunk is larger than the volume.
        let within: [u64; 3] = std::array::from_fn(|axis| chunk[axis].min(self.size[axis]));
        let bytes = within.iter().try_fold(voxel_bytes, |n, &size| n.checked_mul(size));
        if bytes.is_none_or(|bytes| bytes > MAX_CHUNK_BYTES) {
            return fail(format!(
                "{chunk:?} voxels of {voxel_bytes} bytes, expected 1 GiB at most"
            ));
        }
        Ok(within)
    }
}
