//! From samples in a file to samples on the host in the device's types.
//!
//! Plain samples are read in parallel, each piece directly to its destination. Compressed ones are decoded into memory that grows with
//! what was decoded, whatever the header claims. Byte order, type and scale are converted piece by piece.

use std::io::{BufRead, BufReader, Read};

use flate2::bufread::{MultiGzDecoder, ZlibDecoder};
use isopeel_kernels::{SampleType, Samples};
use rayon::prelude::*;

use super::location::Blob;
use super::stored::{Begin, Encoding, StoredSamples, StoredType, contiguous};
use super::{ReadError, ReadProgress, Source};

/// Samples of a task of a parallel read: enough for long reads, few enough to balance the threads.
const READ_CHUNK: usize = 1 << 20;
/// Samples converted at once, in a buffer that stays in the cache.
const DECODE_CHUNK: usize = 1 << 16;

impl StoredSamples {
    /// Zeroed memory, which the system provides lazily. Only for sizes that [`Self::check`] has compared with the file.
    fn allocate<T: Scalar>(&self, samples: u64) -> Result<Vec<T>, ReadError> {
        usize::try_from(samples)
            .ok()
            .and_then(|n| bytemuck::allocation::try_zeroed_vec(n).ok())
            .ok_or_else(|| self.error(format!("no memory for {}", self.describe())))
    }

    /// Whether a time step is one piece of the file, x fastest.
    fn is_in_order(&self) -> bool {
        contiguous(self.dims, self.steps) == Some(self.strides)
    }

    /// Start of the samples of `step` in the file, for plain and contiguous samples.
    fn offset(&self, step: u32) -> u64 {
        let first = match self.begin {
            Begin::At(offset) => offset + self.skip_decoded,
            Begin::BeforeEnd => self.file_bytes - self.total_samples() * self.stored.bytes(),
        };
        first + u64::from(step) * self.step_samples() * self.stored.bytes()
    }

    /// Plain samples, read in parallel. `same`: stored type and `T` are equal, nothing is converted.
    fn read_plain<S: Scalar, T: Scalar>(
        &self,
        blob: &Blob<'_>,
        offset: u64,
        samples: u64,
        convert: impl Fn(&[S], &mut [T]) + Sync,
        same: bool,
    ) -> Result<Vec<T>, ReadError> {
        let mut values = self.allocate::<T>(samples)?;
        let swap = !self.endian.is_native();
        values
            .par_chunks_mut(READ_CHUNK)
            .enumerate()
            .try_for_each(|(chunk, out)| {
                let at = offset + (chunk * READ_CHUNK * size_of::<S>()) as u64;
                if same {
                    blob.read_exact_at(bytemuck::cast_slice_mut(out), at)?;
                    if swap {
                        out.iter_mut().for_each(|v| *v = v.swapped());
                    }
                    return Ok(());
                }
                let mut buffer = vec![S::zeroed(); DECODE_CHUNK.min(out.len())];
                for (i, part) in out.chunks_mut(DECODE_CHUNK).enumerate() {
                    let stored = &mut buffer[..part.len()];
                    let at = at + (i * DECODE_CHUNK * size_of::<S>()) as u64;
                    blob.read_exact_at(bytemuck::cast_slice_mut(stored), at)?;
                    if swap {
                        stored.iter_mut().for_each(|v| *v = v.swapped());
                    }
                    convert(stored, part);
                }
                Ok(())
            })
            .map_err(|e| self.io(e))?;
        Ok(values)
    }

    /// A stream of decoded bytes that starts at the first sample.
    fn inflate<'a>(&self, blob: &'a Blob<'a>) -> Result<Inflate<impl Read + 'a>, ReadError> {
        let Begin::At(begin) = self.begin else {
            return Err(self.error("compressed samples cannot be counted from the end of the file"));
        };
        let mut magic = [0; 2];
        blob.read_exact_at(&mut magic, begin).map_err(|e| self.io(e))?;
        let buffered = BufReader::with_capacity(1 << 16, blob.reader(begin));
        let mut stream = match magic {
            [0x1f, 0x8b] => Inflate::Gzip(MultiGzDecoder::new(buffered)),
            _ => Inflate::Zlib(ZlibDecoder::new(buffered)),
        };
        self.skip(&mut stream, self.skip_decoded)?;
        Ok(stream)
    }

    fn skip(&self, stream: &mut dyn Read, bytes: u64) -> Result<(), ReadError> {
        let skipped = std::io::copy(&mut stream.take(bytes), &mut std::io::sink()).map_err(|e| self.io(e))?;
        if skipped < bytes {
            return Err(self.io(std::io::ErrorKind::UnexpectedEof.into()));
        }
        Ok(())
    }

    /// Samples from a stream. Memory grows with what was decoded, at most to twice that.
    fn read_stream<S: Scalar, T: Scalar>(
        &self,
        stream: &mut dyn Read,
        samples: u64,
        convert: impl Fn(&[S], &mut [T]) + Sync,
    ) -> Result<Vec<T>, ReadError> {
        let samples = usize::try_from(samples).map_err(|_| self.error("more samples than this machine can address"))?;
        let mut values: Vec<T> = Vec::new();
        let mut buffer = vec![S::zeroed(); DECODE_CHUNK.min(samples)];
        while values.len() < samples {
            let done = values.len();
            let stored = &mut buffer[..DECODE_CHUNK.min(samples - done)];
            stream
                .read_exact(bytemuck::cast_slice_mut(stored))
                .map_err(|e| self.io(e))?;
            if !self.endian.is_native() {
                stored.iter_mut().for_each(|v| *v = v.swapped());
            }
            if values.capacity() < done + stored.len() {
                let more = done.max(stored.len()).min(samples - done);
                values
                    .try_reserve_exact(more)
                    .map_err(|_| self.error(format!("no memory for {}", self.describe())))?;
            }
            values.resize(done + stored.len(), T::zeroed());
            convert(stored, &mut values[done..]);
        }
        Ok(values)
    }

    /// Fails if the stream or its file goes on. Reading to the end also makes the decoder compare its checksum.
    fn expect_end<R: Read>(&self, mut stream: Inflate<R>) -> Result<(), ReadError> {
        let more = stream.read(&mut [0]).map_err(|e| self.io(e))? > 0
            || match stream {
                Inflate::Gzip(_) => false, // reads members to the end of the file
                Inflate::Zlib(zlib) => !zlib.into_inner().fill_buf().map_err(|e| self.io(e))?.is_empty(),
            };
        if more {
            return Err(self.error(format!("goes on after the last sample, expected {}", self.describe())));
        }
        Ok(())
    }

    /// All samples of all steps, as stored. Costs as much memory as the decoded file.
    fn read_all<S: Scalar>(&self, blob: &Blob<'_>) -> Result<Vec<S>, ReadError> {
        let total = self.total_samples();
        let copy = |from: &[S], to: &mut [S]| to.copy_from_slice(from);
        match self.encoding {
            Encoding::Raw => self.read_plain(blob, self.offset(0), total, copy, true),
            Encoding::Deflate => {
                let mut stream = self.inflate(blob)?;
                let values = self.read_stream(&mut stream, total, copy)?;
                self.expect_end(stream)?;
                Ok(values)
            }
            Encoding::Text => self.read_text(blob),
        }
    }

    fn read_text<S: Scalar>(&self, blob: &Blob<'_>) -> Result<Vec<S>, ReadError> {
        let offset = match self.begin {
            Begin::At(offset) => offset.saturating_add(self.skip_decoded),
            Begin::BeforeEnd => return Err(self.error("text cannot be counted from the end of the file")),
        };
        let mut text = Vec::new();
        blob.reader(offset).read_to_end(&mut text).map_err(|e| self.io(e))?;
        // Without a final white space a truncated last number would not be noticed.
        if !text.last().is_some_and(u8::is_ascii_whitespace) {
            return Err(self.error("the last line has no end, expected one: the file may be cut off"));
        }
        let total = self.total_samples();
        let mut values: Vec<S> = Vec::new();
        for word in text
            .split(|b| b.is_ascii_whitespace() || *b == b',')
            .filter(|w| !w.is_empty())
        {
            if values.len() as u64 == total {
                return Err(self.error(format!("goes on after the last sample, expected {}", self.describe())));
            }
            let value = std::str::from_utf8(word).ok().and_then(S::parse).ok_or_else(|| {
                let word = String::from_utf8_lossy(&word[..word.len().min(40)]).into_owned();
                self.error(format!(
                    "sample {} is {word:?}, expected a number of type {}",
                    values.len(),
                    self.stored.name()
                ))
            })?;
            values.push(value);
        }
        if (values.len() as u64) < total {
            return Err(self.error(format!("{} numbers, expected {}", values.len(), self.describe())));
        }
        Ok(values)
    }

    /// One time step of stored type `S` as the device's type `T`.
    fn read_step<S: Scalar, T: Scalar>(
        &self,
        blob: &Blob<'_>,
        step: u32,
        convert: impl Fn(&[S], &mut [T]) + Sync,
        same: bool,
    ) -> Result<Vec<T>, ReadError> {
        let samples = self.step_samples();
        match self.encoding {
            Encoding::Raw if self.is_in_order() => self.read_plain(blob, self.offset(step), samples, convert, same),
            Encoding::Deflate if self.is_in_order() => {
                let mut stream = self.inflate(blob)?;
                self.skip(&mut stream, u64::from(step) * samples * self.stored.bytes())?;
                let values = self.read_stream(&mut stream, samples, convert)?;
                if step + 1 == self.steps {
                    self.expect_end(stream)?;
                }
                Ok(values)
            }
            _ => {
                let all = self.read_all::<S>(blob)?;
                let mut values = self.allocate::<T>(samples)?;
                let [nx, ny, _] = self.dims.map(|n| n as usize);
                let [sx, sy, sz, st] = self.strides.map(|s| s as usize);
                values.par_chunks_mut(nx).enumerate().for_each(|(row, out)| {
                    let base = row % ny * sy + row / ny * sz + step as usize * st;
                    let line: Vec<S> = (0..nx).map(|x| all[base + x * sx]).collect();
                    convert(&line, out);
                });
                Ok(values)
            }
        }
    }

    fn as_stored<T: Scalar>(&self, blob: &Blob<'_>, step: u32) -> Result<Vec<T>, ReadError> {
        self.read_step(blob, step, |from: &[T], to: &mut [T]| to.copy_from_slice(from), true)
    }

    fn as_f32<S: Scalar>(&self, blob: &Blob<'_>, step: u32) -> Result<Samples, ReadError> {
        let values = match self.scale {
            Some([slope, inter]) => self.read_step(
                blob,
                step,
                move |from: &[S], to: &mut [f32]| {
                    to.iter_mut()
                        .zip(from)
                        .for_each(|(t, f)| *t = (slope * f.to_f64() + inter) as f32);
                },
                false,
            ),
            None => self.read_step(
                blob,
                step,
                |from: &[S], to: &mut [f32]| to.iter_mut().zip(from).for_each(|(t, f)| *t = f.to_f32()),
                false,
            ),
        }?;
        Ok(Samples::F32(values))
    }
}

impl Source for StoredSamples {
    fn stored_bytes(&self) -> u64 {
        match (self.encoding, self.begin) {
            (Encoding::Raw, _) if self.is_in_order() => self.step_samples() * self.stored.bytes(),
            (Encoding::Raw, _) => self.total_samples() * self.stored.bytes(),
            (Encoding::Deflate | Encoding::Text, Begin::At(begin)) => self.file_bytes.saturating_sub(begin),
            (Encoding::Deflate | Encoding::Text, Begin::BeforeEnd) => self.file_bytes,
        }
    }

    fn read(&self, step: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        if step >= self.steps {
            return Err(ReadError::new(
                self.location.path(),
                "step",
                format!("{step}, expected 0 to {}", self.steps - 1),
            ));
        }
        let blob = self.location.open()?.counted(progress);
        if blob.len() != self.file_bytes {
            return Err(self.error(format!(
                "the file has {} bytes, it had {} when its header was read",
                blob.len(),
                self.file_bytes
            )));
        }
        match self.scale {
            Some([slope, inter]) => tracing::info!(
                path = %self.location.path().display(),
                "{} samples become f32, scaled: {slope} x stored + {inter}", self.stored.name()
            ),
            None if self.stored.on_device() == SampleType::F32 && self.stored != StoredType::F32 => tracing::warn!(
                path = %self.location.path().display(),
                "{} samples become f32 on the device, digits past 24 bits are lost", self.stored.name()
            ),
            None => {}
        }
        match (self.stored, self.scale) {
            (StoredType::U8, None) => self.as_stored(&blob, step).map(Samples::U8),
            (StoredType::I8, None) => self.as_stored(&blob, step).map(Samples::I8),
            (StoredType::U16, None) => self.as_stored(&blob, step).map(Samples::U16),
            (StoredType::I16, None) => self.as_stored(&blob, step).map(Samples::I16),
            (StoredType::F32, None) => self.as_stored(&blob, step).map(Samples::F32),
            (StoredType::U8, Some(_)) => self.as_f32::<u8>(&blob, step),
            (StoredType::I8, Some(_)) => self.as_f32::<i8>(&blob, step),
            (StoredType::U16, Some(_)) => self.as_f32::<u16>(&blob, step),
            (StoredType::I16, Some(_)) => self.as_f32::<i16>(&blob, step),
            (StoredType::F32, Some(_)) => self.as_f32::<f32>(&blob, step),
            (StoredType::U32, _) => self.as_f32::<u32>(&blob, step),
            (StoredType::I32, _) => self.as_f32::<i32>(&blob, step),
            (StoredType::U64, _) => self.as_f32::<u64>(&blob, step),
            (StoredType::I64, _) => self.as_f32::<i64>(&blob, step),
            (StoredType::F64, _) => self.as_f32::<f64>(&blob, step),
        }
    }
}

/// A deflate stream in a gzip or zlib container.
enum Inflate<R> {
    Gzip(MultiGzDecoder<BufReader<R>>),
    Zlib(ZlibDecoder<BufReader<R>>),
}

impl<R: Read> Read for Inflate<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        match self {
            Self::Gzip(stream) => stream.read(buffer),
            Self::Zlib(stream) => stream.read(buffer),
        }
    }
}

/// A type of stored samples.
trait Scalar: bytemuck::Pod + Send + Sync {
    fn swapped(self) -> Self;
    fn to_f32(self) -> f32;
    fn to_f64(self) -> f64;
    fn parse(text: &str) -> Option<Self>;
}

macro_rules! scalar {
    ($($t:ty: $swap:expr),*) => {$(
        impl Scalar for $t {
            fn swapped(self) -> Self {
                $swap(self)
            }
            fn to_f32(self) -> f32 {
                self as f32
            }
            fn to_f64(self) -> f64 {
                self as f64
            }
            fn parse(text: &str) -> Option<Self> {
                text.parse().ok()
            }
        }
    )*};
}
scalar!(
    u8: u8::swap_bytes, i8: i8::swap_bytes, u16: u16::swap_bytes, i16: i16::swap_bytes, u32: u32::swap_bytes,
    i32: i32::swap_bytes, u64: u64::swap_bytes, i64: i64::swap_bytes,
    f32: |v: f32| f32::from_bits(v.to_bits().swap_bytes()), f64: |v: f64| f64::from_bits(v.to_bits().swap_bytes())
);
