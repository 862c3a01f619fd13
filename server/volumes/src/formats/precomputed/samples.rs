//! Samples in chunks, each in a file of its own or in a shard.

use std::collections::{BTreeSet, HashMap};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use isopeel_kernels::Samples;

use super::super::ahead::Work;
use super::super::store::{Store, join};
use super::encoding::{Encoding, Shape, gunzip, max_stored};
use super::sharding::{Entry, Minishard, Sharding, compressed_morton, find};
use crate::conversion::ConvertRow;
use crate::parallel::{try_map, try_map_items, try_sum};
use crate::remote::Part;
use crate::scalar::{DeviceScalar, Scalar};
use crate::stored::StoredType;
use crate::{FileLocation, Findings, LabelRanks, Notices, ReadError, ReadProgress, Source, only_piece};

/// Maximum chunks of a scale.
const MAX_CHUNKS: u64 = 1 << 19;
/// Maximum ratio of samples to stored bytes, as for Zarr. A volume with fewer chunks is almost empty.
const MAX_RATIO: u64 = 32768;
/// Maximum bytes of decoded chunks that are held at once.
const HELD_BYTES: u64 = 256 << 20;

/// Layout of a scale, as `info` states it.
#[derive(Debug)]
pub(super) struct Layout {
    /// Folder of its chunks.
    pub(super) key: String,
    pub(super) dims: [u32; 3],
    /// Index of the first voxel. The names of chunks count from it.
    pub(super) offset: [i64; 3],
    pub(super) chunk: [u64; 3],
    pub(super) channels: u32,
    pub(super) stored: StoredType,
    pub(super) encoding: Encoding,
    pub(super) sharding: Option<Sharding>,
}

/// One channel of a scale.
#[derive(Clone, Debug)]
pub(super) struct PrecomputedSamples {
    store: Arc<Store>,
    layout: Arc<Layout>,
    channel: u32,
    findings: Findings,
}

/// The chunks of a minishard, known after its index was read.
type Known = Mutex<Option<Arc<Vec<Entry>>>>;

/// State that the chunks of one reading share.
struct Reading<'a> {
    work: Work<'a>,
    minishards: Mutex<HashMap<Minishard, Arc<Known>>>,
    /// Number of chunks in the indices that were read.
    indexed: AtomicU64,
}

/// A chunk of the grid: its index, its first voxel, and its size in voxels, which is smaller at the ends of the volume.
#[derive(Clone, Copy)]
struct Chunk {
    at: [u64; 3],
    first: [u64; 3],
    shape: Shape,
}

impl Layout {
    fn grid(&self) -> [u64; 3] {
        std::array::from_fn(|axis| u64::from(self.dims[axis]).div_ceil(self.chunk[axis]))
    }

    fn chunk(&self, index: u64) -> Chunk {
        let [nx, ny, _] = self.grid();
        let at = [index % nx, index / nx % ny, index / (nx * ny)];
        let first = std::array::from_fn(|axis| at[axis] * self.chunk[axis]);
        let size = std::array::from_fn(|axis| self.chunk[axis].min(u64::from(self.dims[axis]) - first[axis]));
        let shape = Shape {
            size,
            channels: self.channels,
            width: self.stored.bytes() as usize,
        };
        Chunk { at, first, shape }
    }

    /// Returns the name of a chunk's own file: along each axis its first voxel and the one behind its last.
    fn file(&self, chunk: &Chunk) -> String {
        let range = |axis: usize| {
            let first = i128::from(self.offset[axis]) + i128::from(chunk.first[axis]);
            format!("{first}-{}", first + i128::from(chunk.shape.size[axis]))
        };
        join(&self.key, &format!("{}_{}_{}", range(0), range(1), range(2)))
    }
}

impl PrecomputedSamples {
    pub(super) fn new(store: Arc<Store>, layout: Layout) -> Result<Self, ReadError> {
        let grid = layout.grid();
        let count = grid.iter().try_fold(1u64, |n, &count| n.checked_mul(count));
        if count.is_none_or(|count| count > MAX_CHUNKS) {
            let why = format!("{grid:?} chunks along x, y and z, expected {MAX_CHUNKS} at most");
            return Err(ReadError::new(&store.path(&layout.key), "chunk_sizes", why));
        }
        Ok(Self {
            store,
            layout: Arc::new(layout),
            channel: 0,
            findings: Findings::default(),
        })
    }

    pub(super) fn of_channel(&self, channel: u32) -> Self {
        Self {
            channel,
            findings: Findings::default(),
            ..self.clone()
        }
    }

    fn error(&self, why: impl Into<String>) -> ReadError {
        ReadError::new(&self.store.path(&self.layout.key), "data", why)
    }

    fn count(&self) -> u64 {
        self.layout.grid().iter().product()
    }

    fn decoded_bytes(&self) -> u64 {
        let voxels: u64 = self.layout.dims.iter().map(|&n| u64::from(n)).product();
        voxels * u64::from(self.layout.channels) * self.layout.stored.bytes()
    }

    /// Returns the total bytes of the files with the chunks, on disk.
    fn file_bytes(&self) -> Result<u64, ReadError> {
        let bytes = |name: String| -> Result<u64, ReadError> {
            let plain = self.store.disk_bytes(&name)?;
            let packed = || self.store.disk_bytes(&format!("{name}.gz"));
            Ok(plain.map_or_else(packed, |bytes| Ok(Some(bytes)))?.unwrap_or(0))
        };
        if let Some(sharding) = &self.layout.sharding {
            let shard = |index| sharding.minishard(self.id(&self.layout.chunk(index))).shard;
            let shards: BTreeSet<u64> = (0..self.count()).map(shard).collect();
            let shards = Vec::from_iter(shards);
            let file = |i: usize| join(&self.layout.key, &sharding.file(shards[i]));
            return try_sum(shards.len() as u64, |i| bytes(file(i as usize)));
        }
        try_sum(self.count(), |index| bytes(self.layout.file(&self.layout.chunk(index))))
    }

    /// Compares the size that `info` claims with the stored bytes.
    fn check(&self, have: u64) -> Result<(), ReadError> {
        let needed = self.decoded_bytes();
        if have == 0 {
            return Err(self.error("no chunk is stored, expected one at least"));
        }
        if have.saturating_mul(MAX_RATIO) < needed {
            let (dims, name) = (self.layout.dims, self.layout.stored.name());
            let why = format!("{have} stored bytes cannot hold the {needed} of {dims:?} samples of {name}");
            return Err(self.error(why));
        }
        Ok(())
    }

    /// Reads all samples, which are `S` in the file and `T` on the device. Samples of chunks that are not stored are 0.
    fn read_as<S: Scalar, T: Scalar>(
        &self,
        progress: &ReadProgress,
        fill: &ConvertRow<'_, S, T>,
    ) -> Result<Vec<T>, ReadError> {
        if !self.store.is_remote() {
            self.check(self.file_bytes()?)?;
        }
        // Zeroed memory that is not written takes no physical memory: claimed samples that are not stored cost nothing.
        let samples = self.layout.dims.iter().map(|&n| n as usize).product::<usize>();
        let mut values = bytemuck::allocation::try_zeroed_vec(samples)
            .map_err(|_| self.error(format!("no memory for {:?} samples", self.layout.dims)))?;
        let mut stored_bytes = 0;
        self.read_chunks(progress, &mut |chunk, stored, bytes| {
            stored_bytes += bytes;
            if let Some(stored) = stored {
                self.scatter(&chunk, &stored, &mut values, fill);
            }
        })?;
        if self.store.is_remote() {
            self.check(stored_bytes)?;
        }
        Ok(values)
    }

    /// Decodes all chunks and hands them on with their stored bytes; `None` for a chunk that is not stored.
    fn read_chunks(
        &self,
        progress: &ReadProgress,
        take: &mut dyn FnMut(Chunk, Option<Vec<u8>>, u64),
    ) -> Result<(), ReadError> {
        let reading = Reading {
            work: Work::new(progress),
            minishards: Mutex::default(),
            indexed: AtomicU64::new(0),
        };
        let count = self.count();
        let fit = HELD_BYTES / self.layout.chunk(0).shape.bytes().max(1);
        let get = |index: u64| {
            let chunk = self.layout.chunk(index);
            let stored = self.stored(&chunk, &reading)?;
            Ok((chunk, stored))
        };
        let decode = |(chunk, stored): (Chunk, Option<Vec<u8>>)| {
            progress.add(chunk.shape.bytes());
            let length = stored.as_ref().map_or(0, |bytes| bytes.len() as u64);
            let decoded = stored.map(|stored| self.layout.encoding.decode(stored, chunk.shape));
            let decoded = decoded.transpose().map_err(|why| {
                let name = self.layout.file(&chunk);
                self.error(format!("chunk {}: {why}", name.rsplit('/').next().unwrap_or_default()))
            })?;
            Ok((chunk, decoded, length))
        };
        let mut hand_on = |decoded: Vec<_>| {
            for (chunk, decoded, length) in decoded {
                take(chunk, decoded, length);
            }
        };
        let shown = self.store.path(&self.layout.key);
        if self.store.is_remote() {
            return reading.work.get_ahead(&shown, count, fit / 2, get, |some| {
                hand_on(try_map_items(some, decode)?);
                Ok(())
            });
        }
        let at_once = fit.clamp(1, 4 * rayon::current_num_threads() as u64);
        for first in (0..count).step_by(at_once as usize) {
            progress.go_on(&shown)?;
            let some = count.min(first + at_once) - first;
            hand_on(try_map(some as usize, |i| decode(get(first + i as u64)?))?);
        }
        Ok(())
    }

    /// Returns the stored bytes of a chunk; `None` if it is not stored.
    fn stored(&self, chunk: &Chunk, reading: &Reading<'_>) -> Result<Option<Vec<u8>>, ReadError> {
        if let Some(sharding) = &self.layout.sharding {
            return self.in_shard(sharding, chunk, reading);
        }
        let (name, limit) = (self.layout.file(chunk), max_stored(chunk.shape));
        let read = |name: &str| self.store.read(name, Part::Whole, limit, &|| reading.work.is_over());
        let mut object = read(&name)?;
        // Programs write gzip chunks to a disk with this ending, as a file has no header with its encoding.
        if object.is_none() && !self.store.is_remote() {
            object = read(&format!("{name}.gz"))?;
        }
        Ok(object.map(|object| object.bytes))
    }

    /// Returns the number of a chunk in shards.
    fn id(&self, chunk: &Chunk) -> u64 {
        compressed_morton(chunk.at, self.layout.grid())
    }

    fn in_shard(
        &self,
        sharding: &Sharding,
        chunk: &Chunk,
        reading: &Reading<'_>,
    ) -> Result<Option<Vec<u8>>, ReadError> {
        let id = self.id(chunk);
        let minishard = sharding.minishard(id);
        let name = sharding.file(minishard.shard);
        let Some(entry) = find(&self.entries(sharding, minishard, reading)?, id) else {
            return Ok(None);
        };
        let limit = max_stored(chunk.shape);
        let end = entry.start.checked_add(entry.bytes).filter(|_| entry.bytes <= limit);
        let end = end.ok_or_else(|| {
            let Entry { start, bytes, .. } = entry;
            self.error(format!(
                "{name}: a chunk of {bytes} bytes at {start}, expected {limit} bytes at most"
            ))
        })?;
        let path = join(&self.layout.key, &name);
        let part = Part::At(entry.start..end);
        let object = self.store.read(&path, part, limit, &|| reading.work.is_over())?;
        Ok(object.map(|object| object.bytes))
    }

    /// Returns the chunks of a minishard. Its index is read once.
    fn entries(
        &self,
        sharding: &Sharding,
        minishard: Minishard,
        reading: &Reading<'_>,
    ) -> Result<Arc<Vec<Entry>>, ReadError> {
        let known = {
            let mut minishards = reading.minishards.lock().unwrap_or_else(PoisonError::into_inner);
            Arc::clone(minishards.entry(minishard).or_default())
        };
        let mut known = known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(entries) = &*known {
            return Ok(Arc::clone(entries));
        }
        let entries = Arc::new(self.read_entries(sharding, minishard, reading)?);
        let indexed = reading.indexed.fetch_add(entries.len() as u64, Ordering::Relaxed) + entries.len() as u64;
        if indexed > self.count() {
            let why = format!(
                "its indices have {indexed} chunks and more, the volume has {}",
                self.count()
            );
            return Err(self.error(format!("{}: {why}", sharding.file(minishard.shard))));
        }
        *known = Some(Arc::clone(&entries));
        Ok(entries)
    }

    fn read_entries(
        &self,
        sharding: &Sharding,
        minishard: Minishard,
        reading: &Reading<'_>,
    ) -> Result<Vec<Entry>, ReadError> {
        let name = sharding.file(minishard.shard);
        let fail = |why: String| self.error(format!("{name}: minishard {}: {why}", minishard.number));
        let path = join(&self.layout.key, &name);
        let read = |from: u64, to: u64, limit: u64| {
            self.store
                .read(&path, Part::At(from..to), limit, &|| reading.work.is_over())
        };
        let at = 16 * minishard.number;
        let Some(object) = read(at, at + 16, 16)? else {
            return Ok(Vec::new());
        };
        let Some((first, second)) = object.bytes.split_first_chunk::<8>() else {
            return Err(fail("no index of minishards, expected one".to_owned()));
        };
        let second: [u8; 8] = second
            .try_into()
            .map_err(|_| fail("no index of minishards".to_owned()))?;
        let range =
            [u64::from_le_bytes(*first), u64::from_le_bytes(second)].map(|n| n.checked_add(sharding.index_bytes()));
        // One chunk more than there are, so that an index with too many is detected.
        let limit = 24 * (self.count() + 1);
        let (Some(from), Some(to)) = (range[0], range[1]) else {
            return Err(fail("an index beyond 2^64".to_owned()));
        };
        if from >= to {
            return Ok(Vec::new());
        }
        if to - from > limit + 1024 {
            let why = format!("an index of {} bytes, expected {limit} at most", to - from);
            return Err(fail(why));
        }
        let Some(object) = read(from, to, to - from)? else {
            return Err(fail("is there no more".to_owned()));
        };
        let index = if sharding.has_packed_index() {
            gunzip(&object.bytes, limit).map_err(fail)?
        } else {
            object.bytes
        };
        sharding.entries(&index).map_err(fail)
    }

    /// Converts the samples of a chunk and writes them to their places in `values`. `fill` converts a row.
    fn scatter<S: Scalar, T: Scalar>(
        &self,
        chunk: &Chunk,
        stored: &[u8],
        values: &mut [T],
        fill: &ConvertRow<'_, S, T>,
    ) {
        let [nx, ny, nz] = chunk.shape.size.map(|n| n as usize);
        let first = chunk.first.map(|n| n as usize);
        let dims = self.layout.dims.map(|n| n as usize);
        let channel = &stored[self.channel as usize * nx * ny * nz * size_of::<S>()..];
        let rows = channel.chunks_exact(nx * size_of::<S>()).take(ny * nz).enumerate();
        for (row, from) in rows {
            let (y, z) = (row % ny, row / ny);
            let at = ((first[2] + z) * dims[1] + first[1] + y) * dims[0] + first[0];
            let width = size_of::<S>();
            let sample = |i: usize| {
                let one: S = bytemuck::pod_read_unaligned(&from[i * width..(i + 1) * width]);
                if cfg!(target_endian = "big") {
                    one.swapped()
                } else {
                    one
                }
            };
            fill(&sample, &mut values[at..at + nx]);
        }
    }

    /// Reads all samples, in the type in which they are stored.
    fn as_stored<T: DeviceScalar>(&self, progress: &ReadProgress) -> Result<Samples, ReadError> {
        let fill = |stored: &dyn Fn(usize) -> T, values: &mut [T]| {
            values.iter_mut().enumerate().for_each(|(i, value)| *value = stored(i));
        };
        self.read_as(progress, &fill).map(T::samples)
    }

    fn as_f32<S: Scalar>(&self, progress: &ReadProgress) -> Result<Samples, ReadError> {
        let path = self.store.path(&self.layout.key);
        only_piece(|sink| {
            self.findings.read((&path, 1), sink, |conversion, sink| {
                let fill = |stored: &dyn Fn(usize) -> S, values: &mut [f32]| conversion.convert(stored, values);
                sink(Samples::F32(self.read_as(progress, &fill)?))
            })
        })
    }
}

impl Source for PrecomputedSamples {
    fn stored_bytes(&self) -> u64 {
        self.decoded_bytes()
    }

    fn inputs(&self, _: u32) -> Vec<FileLocation> {
        vec![self.store.location().clone()]
    }

    fn notices(&self) -> Notices {
        self.findings.notices()
    }

    fn ranks(&self) -> Option<Arc<LabelRanks>> {
        self.findings.ranks()
    }

    fn read(&self, step: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        if step > 0 {
            let why = format!("{step}, expected 0");
            return Err(ReadError::new(&self.store.path(&self.layout.key), "step", why));
        }
        match self.layout.stored {
            StoredType::U8 => self.as_stored::<u8>(progress),
            StoredType::I8 => self.as_stored::<i8>(progress),
            StoredType::U16 => self.as_stored::<u16>(progress),
            StoredType::I16 => self.as_stored::<i16>(progress),
            StoredType::U32 => self.as_f32::<u32>(progress),
            StoredType::I32 => self.as_f32::<i32>(progress),
            StoredType::U64 => self.as_f32::<u64>(progress),
            StoredType::I64 => self.as_f32::<i64>(progress),
            StoredType::F16 => self.as_f32::<half::f16>(progress),
            StoredType::F32 => self.as_f32::<f32>(progress),
            StoredType::F64 => self.as_f32::<f64>(progress),
        }
    }
}
