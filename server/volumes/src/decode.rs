//! Reads samples of a file into host memory, in the types of the device.
//!
//! Plain samples are read in parallel, each piece directly to its destination. Compressed samples are decoded into memory that grows with
//! the decoded bytes, whatever the header claims. Byte order, type and scale are converted piece by piece.

use std::io::Read;
use std::sync::Arc;

use half::f16;
use isopeel_kernels::Samples;

use super::codec::decoder;
use super::conversion::Conversion;
use super::location::Blob;
use super::parallel::{for_each_row, try_for_each_chunk};
use super::scalar::{DeviceScalar, Scalar};
use super::stored::{Begin, Encoding, MAX_PADDING, StoredSamples, StoredType, contiguous, is_blank};
use super::{FileLocation, LabelRanks, Notices, ReadError, ReadProgress, Sink, Source, only_piece};

/// Samples of a task of a parallel read: enough for long reads, few enough to balance the threads.
const READ_CHUNK: usize = 1 << 18;
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

    /// Returns the number of samples at each position of the grid; `None` unless the array has x fastest, then y, z and time.
    pub(super) fn interleave(&self) -> Option<usize> {
        let [one, together] = [1, u64::from(self.channels)].map(|n| {
            let strides = contiguous(self.dims, self.steps).map(|strides| strides.map(|stride| stride * n));
            strides == Some(self.strides)
        });
        let last = self.first + 2 * self.luminance.unwrap_or(0);
        if one && self.luminance.is_none() {
            Some(1)
        } else if together && last < u64::from(self.channels) {
            Some(self.channels as usize)
        } else {
            None
        }
    }

    /// Returns the bytes of the array before the samples of `step`, if each position has `interleave` samples.
    fn bytes_before(&self, step: u32, interleave: usize) -> u64 {
        let planes = if interleave == 1 { self.first } else { 0 };
        (planes + u64::from(step) * self.step_samples() * interleave as u64) * self.stored.bytes()
    }

    /// Returns the offset of plain samples in the file.
    fn plain_offset(&self) -> u64 {
        match self.begin {
            Begin::At(offset) => offset + self.skip_decoded,
            Begin::BeforeEnd => self.end() - self.array_samples() * self.stored.bytes(),
        }
    }

    /// Reads plain samples in parallel. `same`: stored type and `T` are equal, and nothing is converted.
    fn read_plain<S: Scalar, T: Scalar>(
        &self,
        blob: &Blob<'_>,
        offset: u64,
        samples: u64,
        pixels: &Pixels<'_, S, T>,
        same: bool,
    ) -> Result<Vec<T>, ReadError> {
        let mut values = self.allocate::<T>(samples)?;
        let swap = !self.endian.is_native();
        let bytes = pixels.interleave * size_of::<S>();
        let read_chunk = |chunk: usize, out: &mut [T]| {
            let at = offset + (chunk * READ_CHUNK * bytes) as u64;
            if same {
                blob.read_exact_at(bytemuck::cast_slice_mut(out), at)?;
                if swap {
                    out.iter_mut().for_each(|v| *v = v.swapped());
                }
                return Ok(());
            }
            let piece = pixels.piece(out.len());
            let mut buffer = vec![S::zeroed(); piece * pixels.interleave];
            for (i, part) in out.chunks_mut(piece).enumerate() {
                let stored = &mut buffer[..part.len() * pixels.interleave];
                let at = at + (i * piece * bytes) as u64;
                blob.read_exact_at(bytemuck::cast_slice_mut(stored), at)?;
                if swap {
                    stored.iter_mut().for_each(|v| *v = v.swapped());
                }
                pixels.convert(stored, part);
            }
            Ok(())
        };
        try_for_each_chunk(&mut values, READ_CHUNK, read_chunk).map_err(|e| self.io(e))?;
        Ok(values)
    }

    /// Returns a stream of decoded bytes that starts at the first sample.
    fn stream<'a>(&self, blob: &'a Blob<'a>) -> Result<Box<dyn Read + Send + 'a>, ReadError> {
        let Begin::At(begin) = self.begin else {
            return Err(self.error("compressed samples cannot be counted from the end of the file"));
        };
        let (encoding, from, end, skip) = match self.packing() {
            Some(packing) => (packing, 0, self.file_bytes, begin.saturating_add(self.skip_decoded)),
            None => (self.encoding, begin, self.end(), self.skip_decoded),
        };
        let stored_bytes = end.saturating_sub(from);
        let mut stream = decoder(encoding, blob.reader(from), stored_bytes).map_err(|e| self.io(e))?;
        self.skip(&mut stream, skip)?;
        Ok(stream)
    }

    fn skip(&self, stream: &mut dyn Read, bytes: u64) -> Result<(), ReadError> {
        let skipped = std::io::copy(&mut stream.take(bytes), &mut std::io::sink()).map_err(|e| self.io(e))?;
        if skipped < bytes {
            return Err(self.io(std::io::ErrorKind::UnexpectedEof.into()));
        }
        Ok(())
    }

    /// Reads samples from a stream. Memory grows with the decoded samples, at most to twice their size.
    fn read_stream<S: Scalar, T: Scalar>(
        &self,
        stream: &mut dyn Read,
        samples: u64,
        pixels: &Pixels<'_, S, T>,
    ) -> Result<Vec<T>, ReadError> {
        let samples = usize::try_from(samples).map_err(|_| self.error("more samples than this machine can address"))?;
        let mut values: Vec<T> = Vec::new();
        let piece = pixels.piece(samples);
        let mut buffer = vec![S::zeroed(); piece * pixels.interleave];
        while values.len() < samples {
            let done = values.len();
            let count = piece.min(samples - done);
            let stored = &mut buffer[..count * pixels.interleave];
            stream
                .read_exact(bytemuck::cast_slice_mut(stored))
                .map_err(|e| self.io(e))?;
            if !self.endian.is_native() {
                stored.iter_mut().for_each(|v| *v = v.swapped());
            }
            if values.capacity() < done + count {
                let more = done.max(count).min(samples - done);
                values
                    .try_reserve_exact(more)
                    .map_err(|_| self.error(format!("no memory for {}", self.describe())))?;
            }
            values.resize(done + count, T::zeroed());
            pixels.convert(stored, &mut values[done..]);
        }
        Ok(values)
    }

    /// Checks that the stream has ended. Reading to the end also makes the decoder verify its checksum.
    fn expect_end(&self, mut stream: impl Read) -> Result<(), ReadError> {
        // If the header states that other data follow the samples of a compressed file, these are not read.
        let rest_is_known = self.packing().is_some() && self.end.is_some();
        if rest_is_known {
            return Ok(());
        }
        let mut rest = Vec::new();
        let limit = MAX_PADDING.min(self.array_samples() * self.stored.bytes());
        let read = stream.by_ref().take(MAX_PADDING + 1).read_to_end(&mut rest);
        read.map_err(|e| self.io(e))?;
        let is_padding = (rest.len() as u64) < limit || rest.len() as u64 <= MAX_PADDING && is_blank(&rest);
        if !is_padding {
            return Err(self.error(format!("goes on after the last sample, expected {}", self.describe())));
        }
        if !rest.is_empty() {
            let what = self.describe();
            let notice =
                format!("the file goes on after its last sample, which is the end of {what}: the rest is not read");
            self.findings.report(self.location.path(), notice);
        }
        Ok(())
    }

    /// Reads all samples of all steps and channels, as stored. Needs as much memory as the decoded file.
    fn read_all<S: Scalar>(&self, blob: &Blob<'_>) -> Result<Vec<S>, ReadError> {
        let total = self.array_samples();
        let alone = Pixels::alone(&copy::<S>);
        match self.encoding {
            Encoding::Raw if self.packing().is_none() => {
                self.read_plain(blob, self.plain_offset(), total, &alone, true)
            }
            Encoding::Text => self.read_text(blob),
            _ => {
                let mut stream = self.stream(blob)?;
                let values = self.read_stream(&mut stream, total, &alone)?;
                self.expect_end(stream)?;
                Ok(values)
            }
        }
    }

    fn read_text<S: Scalar>(&self, blob: &Blob<'_>) -> Result<Vec<S>, ReadError> {
        let offset = match self.begin {
            Begin::At(offset) => offset.saturating_add(self.skip_decoded),
            Begin::BeforeEnd => return Err(self.error("text cannot be counted from the end of the file")),
        };
        let mut text = Vec::new();
        let length = self.end().saturating_sub(offset);
        blob.reader(offset)
            .take(length)
            .read_to_end(&mut text)
            .map_err(|e| self.io(e))?;
        // Without white space behind the last number, it may have been cut off.
        if self.end.is_none() && !text.last().is_some_and(u8::is_ascii_whitespace) {
            let notice = "the last line has no end: if the file was cut off, its last number may be too short";
            self.findings.report(self.location.path(), notice);
        }
        let total = self.array_samples();
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

    /// Reads one time step of stored type `S` as the device's type `T`.
    fn read_step<S: Scalar, T: DeviceScalar>(
        &self,
        blob: &Blob<'_>,
        step: u32,
        fill: &Fill<'_, S, T>,
        same: bool,
        out: &mut Out<'_, '_>,
    ) -> Result<(), ReadError> {
        let samples = self.step_samples();
        let Some(interleave) = self.interleave().filter(|_| self.encoding != Encoding::Text) else {
            return out.put(self.gather(&self.read_all::<S>(blob)?, step, fill)?);
        };
        let before = self.bytes_before(step, interleave);
        let first = if interleave == 1 { 0 } else { self.first as usize };
        let pixels = Pixels {
            interleave,
            first,
            fill,
        };
        let bytes = interleave as u64 * self.stored.bytes();
        let piece = out.piece;
        let pieces = (0..samples)
            .step_by(piece)
            .map(|first| (first, (samples - first).min(piece as u64)));
        if self.encoding == Encoding::Raw && self.packing().is_none() {
            let same = same && interleave == 1;
            for (first, count) in pieces {
                let at = self.plain_offset() + before + first * bytes;
                out.put(self.read_plain(blob, at, count, &pixels, same)?)?;
            }
            return Ok(());
        }
        let mut stream = self.stream(blob)?;
        self.skip(&mut stream, before)?;
        for (_, count) in pieces {
            out.put(self.read_stream(&mut stream, count, &pixels)?)?;
        }
        if before + samples * bytes == self.array_samples() * self.stored.bytes() {
            self.expect_end(stream)?;
        }
        Ok(())
    }

    /// Reads one time step of an array in any order.
    fn gather<S: Scalar, T: Scalar>(&self, all: &[S], step: u32, fill: &Fill<'_, S, T>) -> Result<Vec<T>, ReadError> {
        let mut values = self.allocate::<T>(self.step_samples())?;
        let [nx, ny, _] = self.dims.map(|n| n as usize);
        let [sx, sy, sz, st] = self.strides.map(|s| s as usize);
        for_each_row(&mut values, nx, |row, out| {
            let base = self.first as usize + row % ny * sy + row / ny * sz + step as usize * st;
            fill(&all[base..], sx, out);
        });
        Ok(values)
    }

    fn as_stored<T: DeviceScalar>(&self, blob: &Blob<'_>, step: u32, out: &mut Out<'_, '_>) -> Result<(), ReadError> {
        self.read_step(blob, step, &copy::<T>, true, out)
    }

    fn as_f32<S: Scalar>(
        &self,
        blob: &Blob<'_>,
        step: u32,
        conversion: &Conversion,
        out: &mut Out<'_, '_>,
    ) -> Result<(), ReadError> {
        let [slope, inter] = self.scale.unwrap_or([1.0, 0.0]);
        match (self.scale, self.luminance) {
            (_, Some(distance)) => {
                let distance = distance as usize;
                let fill = move |from: &[S], apart: usize, values: &mut [f32]| {
                    for (i, value) in values.iter_mut().enumerate() {
                        let [r, g, b] = [0, 1, 2].map(|color| from[i * apart + color * distance].to_f64());
                        *value = (slope * (0.2126 * r + 0.7152 * g + 0.0722 * b) + inter) as f32;
                    }
                };
                self.read_step(blob, step, &fill, false, out)
            }
            (Some(_), None) => {
                let fill = |from: &[S], apart: usize, values: &mut [f32]| {
                    conversion.convert_computed(|i| slope * from[i * apart].to_f64() + inter, values);
                };
                self.read_step(blob, step, &fill, false, out)
            }
            (None, None) => {
                let fill =
                    |from: &[S], apart: usize, values: &mut [f32]| conversion.convert(|i| from[i * apart], values);
                self.read_step(blob, step, &fill, false, out)
            }
        }
    }

    /// Reads one time step in the type of the device.
    fn read_converted(
        &self,
        blob: &Blob<'_>,
        step: u32,
        conversion: &Conversion,
        out: &mut Out<'_, '_>,
    ) -> Result<(), ReadError> {
        let as_stored = self.scale.is_none() && self.luminance.is_none();
        match self.stored {
            StoredType::U8 if as_stored => self.as_stored::<u8>(blob, step, out),
            StoredType::I8 if as_stored => self.as_stored::<i8>(blob, step, out),
            StoredType::U16 if as_stored => self.as_stored::<u16>(blob, step, out),
            StoredType::I16 if as_stored => self.as_stored::<i16>(blob, step, out),
            StoredType::F32 if as_stored => self.as_stored::<f32>(blob, step, out),
            StoredType::U8 => self.as_f32::<u8>(blob, step, conversion, out),
            StoredType::I8 => self.as_f32::<i8>(blob, step, conversion, out),
            StoredType::U16 => self.as_f32::<u16>(blob, step, conversion, out),
            StoredType::I16 => self.as_f32::<i16>(blob, step, conversion, out),
            StoredType::F16 => self.as_f32::<f16>(blob, step, conversion, out),
            StoredType::F32 => self.as_f32::<f32>(blob, step, conversion, out),
            StoredType::U32 => self.as_f32::<u32>(blob, step, conversion, out),
            StoredType::I32 => self.as_f32::<i32>(blob, step, conversion, out),
            StoredType::U64 => self.as_f32::<u64>(blob, step, conversion, out),
            StoredType::I64 => self.as_f32::<i64>(blob, step, conversion, out),
            StoredType::F64 => self.as_f32::<f64>(blob, step, conversion, out),
        }
    }
}

/// Copies samples that are `apart` samples from each other.
fn copy<S: Scalar>(from: &[S], apart: usize, values: &mut [S]) {
    if apart == 1 {
        values.copy_from_slice(&from[..values.len()]);
    } else {
        let each = values.iter_mut().zip(from.iter().step_by(apart));
        each.for_each(|(to, from)| *to = *from);
    }
}

/// Receiver of the samples, and the number of samples in a piece.
struct Out<'a, 'b> {
    piece: usize,
    sink: &'a mut Sink<'b>,
}

impl Out<'_, '_> {
    fn put<T: DeviceScalar>(&mut self, values: Vec<T>) -> Result<(), ReadError> {
        (self.sink)(T::samples(values))
    }
}

/// Computes the values of consecutive positions. Its arguments are the samples, beginning with that of the first position, the distance
/// between positions in samples, and the values. Called once for a row or for thousands of samples, so that a call through a pointer costs little.
type Fill<'a, S, T> = dyn Fn(&[S], usize, &mut [T]) + Sync + 'a;

/// Positions with `interleave` samples each. `fill` computes the values of positions, from the sample `first` of each position.
struct Pixels<'a, S, T> {
    interleave: usize,
    first: usize,
    fill: &'a Fill<'a, S, T>,
}

impl<'a, S, T> Pixels<'a, S, T> {
    fn alone(fill: &'a Fill<'a, S, T>) -> Self {
        Self {
            interleave: 1,
            first: 0,
            fill,
        }
    }

    /// Returns the number of positions that are converted at once, at most `count`.
    fn piece(&self, count: usize) -> usize {
        (DECODE_CHUNK / self.interleave).clamp(1, count.max(1))
    }

    fn convert(&self, stored: &[S], values: &mut [T]) {
        (self.fill)(&stored[self.first..], self.interleave, values);
    }
}

impl Source for StoredSamples {
    fn stored_bytes(&self) -> u64 {
        let width = self.stored.bytes();
        match (self.encoding, self.begin, self.interleave()) {
            _ if self.location.packing().is_some() => self.file_bytes,
            (Encoding::Raw, _, Some(interleave)) => self.step_samples() * interleave as u64 * width,
            (Encoding::Raw, _, None) => self.array_samples() * width,
            (_, Begin::At(begin), _) => self.end().saturating_sub(begin),
            (_, Begin::BeforeEnd, _) => self.end(),
        }
    }

    fn inputs(&self, _: u32) -> Vec<FileLocation> {
        vec![self.location.clone()]
    }

    fn notices(&self) -> Notices {
        self.findings.notices()
    }

    fn ranks(&self) -> Option<Arc<LabelRanks>> {
        self.findings.ranks()
    }

    fn read(&self, step: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        only_piece(|sink| self.read_pieces(step, progress, usize::MAX, sink))
    }

    fn read_pieces(
        &self,
        step: u32,
        progress: &ReadProgress,
        piece: usize,
        sink: &mut Sink<'_>,
    ) -> Result<(), ReadError> {
        if step >= self.steps {
            return Err(ReadError::new(
                self.location.path(),
                "step",
                format!("{step}, expected 0 to {}", self.steps - 1),
            ));
        }
        let blob = match self.packing() {
            Some(_) => self.location.open_stored(),
            None => self.location.open(),
        }?
        .counted(progress);
        if blob.stored_len() != self.file_bytes {
            return Err(self.error(format!(
                "the file has {} bytes, it had {} when its header was read",
                blob.stored_len(),
                self.file_bytes
            )));
        }
        self.findings
            .read((self.location.path(), self.steps), sink, |conversion, sink| {
                self.read_converted(&blob, step, conversion, &mut Out { piece, sink })
            })
    }
}
