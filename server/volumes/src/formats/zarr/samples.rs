//! Samples of Zarr and N5 arrays, which are stored in chunks.

mod chunks;

use std::any::TypeId;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

use chunks::{Reading, Stored};
use half::f16;
use isopeel_kernels::{SampleType, Samples};

use super::super::store::Store;
use super::metadata::Array;
use crate::conversion::ConvertRow;
use crate::formats::variables::{layout::Layout, values::Values};
use crate::parallel::{try_map, try_map_items};
use crate::scalar::{DeviceScalar, Scalar};
use crate::stored::{Endian, StoredType};
use crate::{FileLocation, Findings, LabelRanks, Notices, ReadError, ReadProgress, Source, only_piece};

/// Maximum chunks of a time step.
const MAX_CHUNKS: u64 = 1 << 19;
/// Maximum ratio of samples to stored bytes: that of Zstandard. A volume with fewer chunks is almost empty.
const MAX_RATIO: u64 = 32768;
/// Maximum bytes of decoded chunks that are held at once.
const HELD_BYTES: u64 = 256 << 20;

/// The axes of an array by role.
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
    /// Returns the axes of a layout.
    pub(super) fn of_layout(layout: &Layout) -> Self {
        Self {
            space: layout.axes,
            time: layout.time,
            channel: layout.channel,
            dims: layout.dims,
            steps: layout.steps,
            channels: layout.channels,
        }
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
    /// Samples along each axis of the unit that is decoded at once: a chunk, or an inner chunk of a shard.
    block: Arc<Vec<u64>>,
    stored_bytes: OnceLock<u64>,
    findings: Findings,
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
            findings: Findings::default(),
        })
    }

    pub(super) fn of_channel(&self, channel: u32) -> Self {
        let findings = Findings::default();
        findings.set_missing(self.missing());
        Self {
            channel,
            stored_bytes: OnceLock::new(),
            findings,
            ..self.clone()
        }
    }

    pub(super) fn sample_type(&self) -> SampleType {
        self.values.sample_type()
    }

    /// Returns the value that means "no sample here", if it is a single one.
    pub(super) fn missing(&self) -> Option<f32> {
        self.values.missing()
    }

    /// Whether values are the stored numbers.
    fn is_as_stored(&self) -> bool {
        self.values.scale.is_none() && !self.values.needs_nan()
    }

    fn error(&self, why: impl Into<String>) -> ReadError {
        ReadError::new(&self.store.path(&self.path), "data", why)
    }

    /// Returns the index of the first sample of a time step along each axis.
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

    /// Returns the number of pieces of `size` along x, y and z.
    fn counts(&self, size: &[u64]) -> [u64; 3] {
        self.axes.space.map(|axis| self.array.shape[axis].div_ceil(size[axis]))
    }

    /// Returns the number along each axis of the `index`th piece of `size` of a time step.
    fn piece(&self, step: u32, size: &[u64], index: u64) -> Vec<u64> {
        let mut piece: Vec<u64> = self.at(step).iter().zip(size).map(|(at, size)| at / size).collect();
        let [nx, ny, _] = self.counts(size);
        let numbers = [index % nx, index / nx % ny, index / (nx * ny)];
        for (axis, number) in self.axes.space.into_iter().zip(numbers) {
            piece[axis] = number;
        }
        piece
    }

    /// Reads one time step, whose samples are `S` in the file and `T` on the device. `convert` computes the values of a row.
    fn read_as<S: Scalar, T: Scalar>(
        &self,
        step: u32,
        progress: &ReadProgress,
        fill: S,
        convert: &ConvertRow<'_, S, T>,
    ) -> Result<Vec<T>, ReadError> {
        let reading = Reading::new(progress);
        if !self.store.is_remote() {
            self.check(step, self.chunk_bytes(step)?)?;
        }
        // Zeroed memory that is not written takes no physical memory: claimed samples that are not stored cost nothing.
        let count = self.axes.dims.iter().map(|&n| n as usize).product::<usize>();
        let mut values = bytemuck::allocation::try_zeroed_vec(count)
            .map_err(|_| self.error(format!("no memory for {:?} samples", self.axes.dims)))?;
        let (mut stored_bytes, mut not_stored) = (0, Vec::new());
        self.read_blocks(step, &reading, &mut |block, stored, bytes| {
            stored_bytes += bytes;
            match stored {
                Some(stored) => self.scatter(step, &block, &stored, &mut values, convert),
                None => not_stored.push(block),
            }
        })?;
        if self.store.is_remote() {
            self.check(step, stored_bytes)?;
        }
        let stored = fill;
        let mut fill = T::zeroed();
        convert(&|_| stored, std::slice::from_mut(&mut fill));
        if bytemuck::bytes_of(&fill).iter().any(|&byte| byte != 0) {
            for block in not_stored {
                self.rows(&block).for_each(|(row, _)| values[row].fill(fill));
            }
        }
        Ok(values)
    }

    /// Decodes the chunks of a time step and hands them on with their stored bytes; `None` for a chunk that is not stored.
    fn read_blocks(
        &self,
        step: u32,
        reading: &Reading<'_>,
        take: &mut dyn FnMut(Vec<u64>, Option<Vec<u8>>, u64),
    ) -> Result<(), ReadError> {
        let blocks: u64 = self.counts(&self.block).iter().product();
        let bytes = self.block_bytes();
        let fit = HELD_BYTES / bytes.max(1);
        let get = |index: u64| {
            let block = self.piece(step, &self.block, index);
            let stored = self.stored(&block, reading)?;
            Ok((block, stored))
        };
        let decode = |(block, stored): (Vec<u64>, Option<Stored>)| {
            let length = stored.as_ref().map_or(0, Stored::len);
            reading
                .work
                .progress
                .add(if self.store.is_remote() { bytes } else { length });
            let decoded = stored.map(|stored| self.decode(stored)).transpose()?;
            Ok((block, decoded, length))
        };
        let mut hand_on = |decoded: Vec<_>| {
            for (block, decoded, length) in decoded {
                take(block, decoded, length);
            }
        };
        if self.store.is_remote() {
            let shown = self.store.path(&self.path);
            return reading.work.get_ahead(&shown, blocks, fit / 2, get, |some| {
                hand_on(try_map_items(some, decode)?);
                Ok(())
            });
        }
        let at_once = fit.clamp(1, 4 * rayon::current_num_threads() as u64);
        for first in (0..blocks).step_by(at_once as usize) {
            reading.work.progress.go_on(&self.store.path(&self.path))?;
            let some = blocks.min(first + at_once) - first;
            hand_on(try_map(some as usize, |i| decode(get(first + i as u64)?))?);
        }
        Ok(())
    }

    /// Compares the size that the metadata claim with the stored bytes.
    fn check(&self, step: u32, have: u64) -> Result<(), ReadError> {
        let samples = self.axes.dims.iter().map(|&n| u64::from(n)).product::<u64>();
        let needed = samples.saturating_mul(self.array.stored.bytes());
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

    /// Returns the rows of the volume that a chunk has samples of: the range of each in the volume, and its y and z in the chunk.
    fn rows(&self, block: &[u64]) -> impl Iterator<Item = (Range<usize>, [usize; 2])> {
        let first = self.axes.space.map(|axis| (block[axis] * self.block[axis]) as usize);
        let dims = self.axes.dims.map(|n| n as usize);
        let size: [usize; 3] =
            std::array::from_fn(|i| (self.block[self.axes.space[i]] as usize).min(dims[i] - first[i]));
        let rows = (0..size[2]).flat_map(move |z| (0..size[1]).map(move |y| [y, z]));
        rows.map(move |[y, z]| {
            let row = ((first[2] + z) * dims[1] + first[1] + y) * dims[0] + first[0];
            (row..row + size[0], [y, z])
        })
    }

    /// Copies the samples of a chunk to their places in the volume.
    fn scatter<S: Scalar, T: Scalar>(
        &self,
        step: u32,
        block: &[u64],
        stored: &[u8],
        values: &mut [T],
        convert: &ConvertRow<'_, S, T>,
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
        let width = size_of::<S>();
        let is_copy = stride[0] == 1 && !swap && self.is_as_stored() && TypeId::of::<S>() == TypeId::of::<T>();
        for (row, [y, z]) in self.rows(block) {
            let (values, from) = (&mut values[row], base + z * stride[2] + y * stride[1]);
            if is_copy {
                let stored = &stored[from * width..(from + values.len()) * width];
                bytemuck::cast_slice_mut(values).copy_from_slice(stored);
                continue;
            }
            let sample = |x: usize| {
                let at = (from + x * stride[0]) * width;
                let one: S = bytemuck::pod_read_unaligned(&stored[at..at + width]);
                if swap { one.swapped() } else { one }
            };
            convert(&sample, values);
        }
    }

    /// Reads one time step, in the type in which its samples are stored.
    fn as_stored<T: DeviceScalar>(&self, step: u32, progress: &ReadProgress, fill: T) -> Result<Samples, ReadError> {
        let convert = |stored: &dyn Fn(usize) -> T, values: &mut [T]| {
            values.iter_mut().enumerate().for_each(|(x, value)| *value = stored(x));
        };
        self.read_as(step, progress, fill, &convert).map(T::samples)
    }

    fn as_f32<S: Scalar>(&self, step: u32, progress: &ReadProgress, fill: S) -> Result<Samples, ReadError> {
        let path = self.store.path(&self.path);
        only_piece(|sink| {
            self.findings.read((&path, self.axes.steps), sink, |conversion, sink| {
                let convert = |stored: &dyn Fn(usize) -> S, values: &mut [f32]| {
                    if self.is_as_stored() {
                        return conversion.convert(stored, values);
                    }
                    values
                        .iter_mut()
                        .enumerate()
                        .for_each(|(x, value)| *value = self.values.value(stored(x).to_f64()));
                };
                sink(Samples::F32(self.read_as(step, progress, fill, &convert)?))
            })
        })
    }
}

impl Source for ZarrSamples {
    fn stored_bytes(&self) -> u64 {
        if self.store.is_remote() {
            // Requesting the size of each chunk takes as many requests as reading the chunks, so decoded bytes are counted.
            return self.counts(&self.block).iter().product::<u64>() * self.block_bytes();
        }
        // Bytes of the first step. If they cannot be determined, reading returns the error.
        *self.stored_bytes.get_or_init(|| self.chunk_bytes(0).unwrap_or(0))
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
        if step >= self.axes.steps {
            let why = format!("{step}, expected 0 to {}", self.axes.steps - 1);
            return Err(ReadError::new(&self.store.path(&self.path), "step", why));
        }
        let fill = self.array.fill;
        let as_stored = self.is_as_stored();
        match self.values.stored {
            StoredType::U8 if as_stored => self.as_stored(step, progress, fill as u8),
            StoredType::I8 if as_stored => self.as_stored(step, progress, fill as i8),
            StoredType::U16 if as_stored => self.as_stored(step, progress, fill as u16),
            StoredType::I16 if as_stored => self.as_stored(step, progress, fill as i16),
            StoredType::U8 => self.as_f32(step, progress, fill as u8),
            StoredType::I8 => self.as_f32(step, progress, fill as i8),
            StoredType::U16 => self.as_f32(step, progress, fill as u16),
            StoredType::I16 => self.as_f32(step, progress, fill as i16),
            StoredType::U32 => self.as_f32(step, progress, fill as u32),
            StoredType::I32 => self.as_f32(step, progress, fill as i32),
            StoredType::U64 => self.as_f32(step, progress, fill as u64),
            StoredType::I64 => self.as_f32(step, progress, fill as i64),
            StoredType::F16 => self.as_f32(step, progress, f16::from_f64(fill)),
            StoredType::F32 => self.as_f32(step, progress, fill as f32),
            StoredType::F64 => self.as_f32(step, progress, fill),
        }
    }
}
