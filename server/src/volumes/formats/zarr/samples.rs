//! Samples in chunks of their own.

use std::collections::HashMap;
use std::fs::File;
use std::io::Read;
use std::os::unix::fs::FileExt;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use isopeel_kernels::{SampleType, Samples};
use rayon::prelude::*;

use super::metadata::Array;
use super::ome::Axis;
use super::store::Store;
use crate::volumes::formats::variables::{axes::Layout, values::Values};
use crate::volumes::formats::{header, header::not_3d};
use crate::volumes::scalar::Scalar;
use crate::volumes::stored::{Endian, StoredType};
use crate::volumes::{ReadError, ReadProgress, Source};

/// Maximum chunks of a time step.
const MAX_CHUNKS: u64 = 1 << 19;
/// Bytes of samples to one stored byte at most: what Zstandard gives. A volume with fewer chunks is next to empty.
const MAX_RATIO: u64 = 32768;
/// Decoded chunks that are held at once, in bytes.
const HELD_BYTES: u64 = 256 << 20;

/// What the axes of an array are.
#[derive(Clone, Debug)]
pub(super) struct Axes {
    /// x, y and z.
    pub(super) space: [usize; 3],
    pub(super) time: Option<usize>,
    channel: Option<usize>,
    pub(super) dims: [u32; 3],
    pub(super) steps: u32,
    pub(super) channels: u32,
}

impl Axes {
    /// Those of a variable.
    pub(super) fn of_layout(layout: &Layout) -> Self {
        Self {
            space: layout.axes,
            time: layout.time,
            channel: None,
            dims: layout.dims,
            steps: layout.steps,
            channels: 1,
        }
    }

    pub(super) fn of(store: &Store, path: &str, axes: &[Axis], array: &Array) -> Result<Self, ReadError> {
        let shown = store.path(path);
        let shape = header::sizes(&shown, "shape", &array.shape)?;
        if axes.len() != shape.len() {
            return Err(not_3d(
                &shown,
                "axes",
                format!("{} names for {} axes", axes.len(), shape.len()),
            ));
        }
        let find = |names: &[&str]| axes.iter().position(|axis| names.contains(&axis.name.as_str()));
        let [Some(x), Some(y), Some(z)] = [find(&["x"]), find(&["y"]), find(&["z"])] else {
            let names: Vec<&str> = axes.iter().map(|axis| axis.name.as_str()).collect();
            return Err(not_3d(&shown, "axes", format!("axes {names:?} without x, y and z")));
        };
        let (space, time, channel) = ([x, y, z], find(&["t", "time"]), find(&["c", "channel"]));
        for (axis, &size) in shape.iter().enumerate() {
            if size > 1 && !space.contains(&axis) && time != Some(axis) && channel != Some(axis) {
                return Err(not_3d(
                    &shown,
                    "axes",
                    format!("{size} samples along {:?}", axes[axis].name),
                ));
            }
        }
        Ok(Self {
            space,
            time,
            channel,
            dims: space.map(|axis| shape[axis]),
            steps: time.map_or(1, |axis| shape[axis]),
            channels: channel.map_or(1, |axis| shape[axis]),
        })
    }
}

/// One channel of an array.
#[derive(Clone, Debug)]
pub(super) struct ZarrSamples {
    store: Arc<Store>,
    path: String,
    array: Arc<Array>,
    axes: Arc<Axes>,
    channel: u32,
    values: Arc<Values>,
    /// Samples along each axis of what is decoded at once: a chunk, or one in a shard.
    block: Arc<Vec<u64>>,
    stored_bytes: OnceLock<u64>,
}

/// Offsets and lengths of the chunks in a shard.
type Index = Arc<Vec<Option<[u64; 2]>>>;

/// What is remembered between the chunks of a time step.
struct Reading<'a> {
    progress: &'a ReadProgress,
    /// Of the shards by their names; `None` of those that are not stored.
    indices: Mutex<HashMap<String, Option<Index>>>,
}

impl ZarrSamples {
    pub(super) fn new(
        store: Arc<Store>,
        path: String,
        array: Array,
        axes: Axes,
        values: Values,
    ) -> Result<Self, ReadError> {
        let block = array
            .pipeline
            .shard
            .as_ref()
            .map_or(&array.chunks, |shard| &shard.chunks)
            .clone();
        let counts = axes.space.map(|axis| array.shape[axis].div_ceil(block[axis]));
        let count = counts.iter().try_fold(1u64, |n, &count| n.checked_mul(count));
        if count.is_none_or(|count| count > MAX_CHUNKS) {
            let why = format!("{counts:?} chunks along x, y and z, expected {MAX_CHUNKS} at most");
            return Err(store.error(&path, why));
        }
        if let Some(shard) = &array.pipeline.shard {
            let inner = array
                .chunks
                .iter()
                .zip(&shard.chunks)
                .try_fold(1u64, |n, (a, b)| n.checked_mul(a / b));
            if inner.is_none_or(|inner| inner > MAX_CHUNKS) {
                return Err(store.error(&path, format!("more than {MAX_CHUNKS} chunks in a shard")));
            }
        }
        let (array, axes, block) = (Arc::new(array), Arc::new(axes), Arc::new(block));
        Ok(Self {
            store,
            path,
            array,
            axes,
            channel: 0,
            values: Arc::new(values),
            block,
            stored_bytes: OnceLock::new(),
        })
    }

    pub(super) fn of_channel(&self, channel: u32) -> Self {
        Self {
            channel,
            stored_bytes: OnceLock::new(),
            ..self.clone()
        }
    }

    pub(super) fn sample_type(&self) -> SampleType {
        self.values.sample_type()
    }

    /// The value that means "no sample here", where one value says it.
    pub(super) fn missing(&self) -> Option<f32> {
        self.values.missing()
    }

    fn error(&self, why: impl Into<String>) -> ReadError {
        ReadError::new(&self.store.path(&self.path), "data", why)
    }

    /// Index of the first sample of a time step along each axis.
    fn at(&self, step: u32) -> Vec<u64> {
        let mut at = vec![0; self.array.shape.len()];
        if let Some(axis) = self.axes.time {
            at[axis] = u64::from(step);
        }
        if let Some(axis) = self.axes.channel {
            at[axis] = u64::from(self.channel);
        }
        at
    }

    /// Pieces of `size` along x, y and z.
    fn counts(&self, size: &[u64]) -> [u64; 3] {
        self.axes.space.map(|axis| self.array.shape[axis].div_ceil(size[axis]))
    }

    /// Number along each axis of the `index`th piece of `size` of a time step.
    fn piece(&self, step: u32, size: &[u64], index: u64) -> Vec<u64> {
        let mut piece: Vec<u64> = self.at(step).iter().zip(size).map(|(at, size)| at / size).collect();
        let [nx, ny, _] = self.counts(size);
        let numbers = [index % nx, index / nx % ny, index / (nx * ny)];
        for (axis, number) in self.axes.space.into_iter().zip(numbers) {
            piece[axis] = number;
        }
        piece
    }

    /// The decoded samples of a chunk; `None` where it is not stored.
    fn block(&self, block: &[u64], reading: &Reading<'_>) -> Result<Option<Vec<u8>>, ReadError> {
        let size = self.block.iter().product::<u64>() * self.array.stored.bytes();
        let (key, stored, pipeline) = match &self.array.pipeline.shard {
            None => {
                let key = self.array.key(block);
                let file = self.store.file(&super::store::join(&self.path, &key))?;
                let Some(file) = file else { return Ok(None) };
                (key, self.whole(file, size)?, &self.array.pipeline)
            }
            Some(shard) => {
                let Some((key, stored)) = self.in_shard(block, size, reading)? else {
                    return Ok(None);
                };
                (key, stored, &shard.pipeline)
            }
        };
        reading.progress.add(stored.len() as u64);
        let decoded = pipeline.decode(stored, size as usize);
        decoded
            .map(Some)
            .map_err(|why| self.error(format!("chunk {key}: {why}")))
    }

    /// Bytes of the files with the chunks of a time step.
    fn chunk_bytes(&self, step: u32) -> Result<u64, ReadError> {
        let files = &self.array.chunks;
        let bytes = |index: u64| -> Result<u64, ReadError> {
            let key = self.array.key(&self.piece(step, files, index));
            let file = self.store.file(&super::store::join(&self.path, &key))?;
            Ok(file.and_then(|file| file.metadata().ok()).map_or(0, |m| m.len()))
        };
        let count = self.counts(files).iter().product();
        (0..count).into_par_iter().map(bytes).try_reduce(|| 0, |a, b| Ok(a + b))
    }

    /// Bytes of a chunk's file. One that is far larger than its samples is none.
    fn whole(&self, file: File, size: u64) -> Result<Vec<u8>, ReadError> {
        let limit = size.saturating_mul(2).saturating_add(1 << 16);
        let mut bytes = Vec::new();
        let read = file.take(limit + 1).read_to_end(&mut bytes);
        read.map_err(|e| ReadError::io(&self.store.path(&self.path), "data", "cannot be read", e))?;
        if bytes.len() as u64 > limit {
            return Err(self.error(format!("a chunk of more than {limit} bytes, its samples have {size}")));
        }
        Ok(bytes)
    }

    /// A chunk in a shard: the shard's name and the bytes.
    fn in_shard(
        &self,
        block: &[u64],
        size: u64,
        reading: &Reading<'_>,
    ) -> Result<Option<(String, Vec<u8>)>, ReadError> {
        let per_shard: Vec<u64> = self
            .array
            .chunks
            .iter()
            .zip(self.block.iter())
            .map(|(a, b)| a / b)
            .collect();
        let (outer, inner): (Vec<u64>, Vec<u64>) = block.iter().zip(&per_shard).map(|(b, n)| (b / n, b % n)).unzip();
        let number = inner.iter().zip(&per_shard).fold(0, |at, (i, n)| at * n + i);
        let key = self.array.key(&outer);
        let Some(file) = self.store.file(&super::store::join(&self.path, &key))? else {
            return Ok(None);
        };
        let Some(index) = self.index(&key, &file, per_shard.iter().product(), reading)? else {
            return Ok(None);
        };
        let Some([offset, length]) = index[number as usize] else {
            return Ok(None);
        };
        let file_bytes = file.metadata().map_or(0, |m| m.len());
        if offset.checked_add(length).is_none_or(|end| end > file_bytes) || length > size.saturating_mul(2) + (1 << 16)
        {
            let why = format!("shard {key}: a chunk of {length} bytes at {offset}, the file has {file_bytes}");
            return Err(self.error(why));
        }
        let mut bytes = vec![0; length as usize];
        let read = file.read_exact_at(&mut bytes, offset);
        read.map_err(|e| ReadError::io(&self.store.path(&self.path), "data", format!("shard {key}"), e))?;
        Ok(Some((key, bytes)))
    }

    fn index(&self, key: &str, file: &File, count: u64, reading: &Reading<'_>) -> Result<Option<Index>, ReadError> {
        let known = |indices: &Mutex<HashMap<String, Option<Index>>>| {
            indices.lock().unwrap_or_else(PoisonError::into_inner).get(key).cloned()
        };
        if let Some(index) = known(&reading.indices) {
            return Ok(index);
        }
        let Some(shard) = &self.array.pipeline.shard else {
            return Ok(None);
        };
        let fail = |why: String| self.error(format!("shard {key}: {why}"));
        let (length, file_bytes) = (shard.index_bytes(count), file.metadata().map_or(0, |m| m.len()));
        let Some(last) = file_bytes.checked_sub(length) else {
            return Err(fail(format!(
                "{file_bytes} bytes, expected an index of {length} at least"
            )));
        };
        let mut bytes = vec![0; length as usize];
        let read = file.read_exact_at(&mut bytes, if shard.at_end { last } else { 0 });
        read.map_err(|e| fail(e.to_string()))?;
        let index = Some(Arc::new(shard.index(&bytes).map_err(fail)?));
        let mut indices = reading.indices.lock().unwrap_or_else(PoisonError::into_inner);
        indices.insert(key.to_owned(), index.clone());
        Ok(index)
    }

    /// One time step, whose samples are `S` in the file and `T` on the device.
    fn read_as<S: Scalar, T: Scalar>(
        &self,
        step: u32,
        progress: &ReadProgress,
        fill: S,
        convert: impl Fn(S) -> T + Sync,
    ) -> Result<Vec<T>, ReadError> {
        let reading = Reading {
            progress,
            indices: Mutex::default(),
        };
        let blocks: u64 = self.counts(&self.block).iter().product();
        let bytes = self.block.iter().product::<u64>() * self.array.stored.bytes();
        let at_once = (HELD_BYTES / bytes.max(1)).clamp(1, 4 * rayon::current_num_threads() as u64);
        let count = self.axes.dims.iter().map(|&n| n as usize).product::<usize>();
        self.check(step)?;
        let mut values = self.filled(count, convert(fill))?;
        for first in (0..blocks).step_by(at_once as usize) {
            progress.go_on(&self.store.path(&self.path))?;
            let some = first..blocks.min(first + at_once);
            let decode = |index: u64| {
                let block = self.piece(step, &self.block, index);
                let decoded = self.block(&block, &reading);
                decoded.map(|decoded| decoded.map(|decoded| (block, decoded)))
            };
            let decoded: Vec<_> = some.into_par_iter().map(decode).collect::<Result<_, _>>()?;
            for (block, stored) in decoded.into_iter().flatten() {
                self.scatter(step, &block, &stored, &mut values, &convert);
            }
        }
        Ok(values)
    }

    fn filled<T: Scalar>(&self, count: usize, fill: T) -> Result<Vec<T>, ReadError> {
        let mut values = bytemuck::allocation::try_zeroed_vec(count)
            .map_err(|_| self.error(format!("no memory for {:?} samples", self.axes.dims)))?;
        if bytemuck::bytes_of(&fill).iter().any(|&byte| byte != 0) {
            values.fill(fill);
        }
        Ok(values)
    }

    /// Compares what the metadata claim with what is stored.
    fn check(&self, step: u32) -> Result<(), ReadError> {
        let samples = self.axes.dims.iter().map(|&n| u64::from(n)).product::<u64>();
        let (needed, have) = (
            samples.saturating_mul(self.array.stored.bytes()),
            self.chunk_bytes(step)?,
        );
        if have == 0 {
            return Err(self.error(format!("no chunk of step {step} is stored, expected one at least")));
        }
        if have.saturating_mul(MAX_RATIO) < needed {
            let (dims, name) = (self.axes.dims, self.array.stored.name());
            let why = format!("{have} stored bytes cannot hold the {needed} of {dims:?} samples of {name}");
            return Err(self.error(why));
        }
        Ok(())
    }

    /// Copies the samples of a chunk to where they belong.
    fn scatter<S: Scalar, T: Scalar>(
        &self,
        step: u32,
        block: &[u64],
        stored: &[u8],
        values: &mut [T],
        convert: &impl Fn(S) -> T,
    ) {
        let pipeline = self
            .array
            .pipeline
            .shard
            .as_ref()
            .map_or(&self.array.pipeline, |shard| &shard.pipeline);
        let strides = pipeline.strides(&self.block);
        let inside = self
            .at(step)
            .into_iter()
            .zip(self.block.iter())
            .map(|(at, size)| at % size);
        let base: usize = inside.zip(&strides).map(|(at, stride)| at as usize * stride).sum();
        let swap = (pipeline.endian == Endian::Little) != cfg!(target_endian = "little");
        let stride = self.axes.space.map(|axis| strides[axis]);
        let first = self.axes.space.map(|axis| (block[axis] * self.block[axis]) as usize);
        let dims = self.axes.dims.map(|n| n as usize);
        let size: [usize; 3] =
            std::array::from_fn(|i| (self.block[self.axes.space[i]] as usize).min(dims[i] - first[i]));
        let width = size_of::<S>();
        for (z, y) in (0..size[2]).flat_map(|z| (0..size[1]).map(move |y| (z, y))) {
            let row = ((first[2] + z) * dims[1] + first[1] + y) * dims[0] + first[0];
            let from = base + z * stride[2] + y * stride[1];
            for (x, value) in values[row..row + size[0]].iter_mut().enumerate() {
                let at = (from + x * stride[0]) * width;
                let one: S = bytemuck::pod_read_unaligned(&stored[at..at + width]);
                *value = convert(if swap { one.swapped() } else { one });
            }
        }
    }

    fn as_f32<S: Scalar>(&self, step: u32, progress: &ReadProgress, fill: S) -> Result<Samples, ReadError> {
        let values = if self.values.scale.is_some() || self.values.needs_nan() {
            self.read_as(step, progress, fill, |v: S| self.values.value(v.to_f64()))
        } else {
            self.read_as(step, progress, fill, Scalar::to_f32)
        }?;
        Ok(Samples::F32(values))
    }
}

impl Source for ZarrSamples {
    fn stored_bytes(&self) -> u64 {
        // Of the first step; what cannot be opened is an error when it is read.
        *self.stored_bytes.get_or_init(|| self.chunk_bytes(0).unwrap_or(0))
    }

    fn read(&self, step: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        if step >= self.axes.steps {
            let why = format!("{step}, expected 0 to {}", self.axes.steps - 1);
            return Err(ReadError::new(&self.store.path(&self.path), "step", why));
        }
        let fill = self.array.fill;
        let as_stored = self.values.scale.is_none() && !self.values.needs_nan();
        match self.values.stored {
            StoredType::U8 if as_stored => self.read_as(step, progress, fill as u8, |v| v).map(Samples::U8),
            StoredType::I8 if as_stored => self.read_as(step, progress, fill as i8, |v| v).map(Samples::I8),
            StoredType::U16 if as_stored => self.read_as(step, progress, fill as u16, |v| v).map(Samples::U16),
            StoredType::I16 if as_stored => self.read_as(step, progress, fill as i16, |v| v).map(Samples::I16),
            StoredType::U8 => self.as_f32(step, progress, fill as u8),
            StoredType::I8 => self.as_f32(step, progress, fill as i8),
            StoredType::U16 => self.as_f32(step, progress, fill as u16),
            StoredType::I16 => self.as_f32(step, progress, fill as i16),
            StoredType::U32 => self.as_f32(step, progress, fill as u32),
            StoredType::I32 => self.as_f32(step, progress, fill as i32),
            StoredType::U64 => self.as_f32(step, progress, fill as u64),
            StoredType::I64 => self.as_f32(step, progress, fill as i64),
            StoredType::F32 => self.as_f32(step, progress, fill as f32),
            StoredType::F64 => self.as_f32(step, progress, fill),
        }
    }
}
