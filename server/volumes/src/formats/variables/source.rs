//! Reads the samples of a channel of a variable, one time step at a time, by boxes of whole slices.

use std::ops::Range;
use std::sync::Arc;

use isopeel_kernels::{SampleType, Samples};

use super::super::super::conversion::Conversion;
use super::super::super::pieces::Pieces;
use super::super::super::stored::{Endian, StoredType};
use super::super::super::turned::Turned;
use super::super::super::{
    FileLocation, Findings, LabelRanks, Notices, ReadError, ReadProgress, Sink, Source, only_piece,
};
use super::file::Variable;
use super::layout::Layout;
use super::reader::open_file;
use super::values::Values;

/// Decoded bytes of a box, unless a row of chunks needs more: enough for all threads, little beside the volume.
const BOX_BYTES: u64 = 8 << 20;

/// Samples of a channel of a variable.
#[derive(Clone, Debug)]
pub struct VariableSource {
    pub location: FileLocation,
    /// Length of the file when its header was read.
    pub file_bytes: u64,
    pub variable: Variable,
    pub values: Values,
    pub layout: Layout,
    pub channel: u32,
    pub findings: Findings,
}

impl VariableSource {
    /// Type on the device.
    pub fn sample_type(&self) -> SampleType {
        self.values.sample_type()
    }

    fn error(&self, why: impl Into<String>) -> ReadError {
        ReadError::new(self.location.path(), &self.variable.path, why)
    }

    fn step_bytes(&self) -> u64 {
        let samples: u64 = self.layout.dims.map(u64::from).iter().product();
        samples * self.values.stored.bytes()
    }

    /// Returns the number of slices across x, y or z that are read at once: whole chunks, so that none is decoded twice.
    fn slices_at_once(&self, along: usize) -> u64 {
        let axis = self.layout.axes[along];
        let chunk = self.variable.chunk.as_ref().and_then(|chunk| chunk.get(axis));
        let chunk = chunk.map_or(1, |&n| n.max(1));
        let slice = self.step_bytes() / u64::from(self.layout.dims[along]).max(1);
        chunk * (BOX_BYTES / slice.saturating_mul(chunk).max(1)).max(1)
    }

    /// Reads a step box by box, each of whole slices across x, y or z (`along`), in their order.
    fn read_boxes(
        &self,
        step: u32,
        along: usize,
        progress: &ReadProgress,
        take: &mut dyn FnMut(Range<u64>, Vec<u8>) -> Result<(), ReadError>,
    ) -> Result<(), ReadError> {
        let have = self.location.open()?.len();
        if have != self.file_bytes {
            let had = self.file_bytes;
            return Err(self.error(format!(
                "the file has {have} bytes, it had {had} when its header was read"
            )));
        }
        let file = open_file(&self.location)?;
        let count = u64::from(self.layout.dims[along]);
        let at_once = self.slices_at_once(along);
        for first in (0..count).step_by(at_once as usize) {
            progress.go_on(self.location.path())?;
            let slices = first..(first + at_once).min(count);
            let selection = self.layout.selection(step, self.channel, along, slices.clone());
            let bytes = file.read(&self.variable, &selection).map_err(|why| self.error(why))?;
            progress.add(bytes.len() as u64);
            take(slices, bytes)?;
        }
        Ok(())
    }

    /// Appends samples to the pieces, and converts them if needed.
    fn push(&self, pieces: &mut Pieces<'_>, bytes: &[u8]) -> Result<(), ReadError> {
        if self.values.needs_nan() {
            let values = self.values.decode(bytes, self.variable.endian);
            return pieces.push(bytemuck::cast_slice(&values), StoredType::F32, Endian::NATIVE, None);
        }
        pieces.push(bytes, self.values.stored, self.variable.endian, self.values.scale)
    }

    /// Reads a step whose samples are stored in another order than x fastest, then y, z.
    fn read_turned(&self, step: u32, progress: &ReadProgress, conversion: &Conversion) -> Result<Samples, ReadError> {
        let along = self.layout.slowest();
        let mut order = [0, 1, 2];
        order.sort_by_key(|&axis| std::cmp::Reverse(self.layout.axes[axis]));
        let path = self.location.path();
        let mut turned = Turned::new(path, self.sample_type(), self.layout.dims, order)?;
        let slice =
            self.layout.dims.iter().map(|&n| u64::from(n)).product::<u64>() / u64::from(self.layout.dims[along]);
        self.read_boxes(step, along, progress, &mut |slices, bytes| {
            let mut pieces = Pieces::new(
                path,
                self.sample_type(),
                slice * (slices.end - slices.start),
                conversion,
            );
            self.push(&mut pieces, &bytes)?;
            pieces.finish(&mut |samples| turned.put(slices.start, &samples))
        })?;
        Ok(turned.samples)
    }
}

impl Source for VariableSource {
    fn stored_bytes(&self) -> u64 {
        self.step_bytes()
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
        let Layout { dims, steps, .. } = self.layout;
        if step >= steps {
            return Err(self.error(format!("step {step}, expected 0 to {}", steps - 1)));
        }
        let expected = dims.iter().map(|&n| u64::from(n)).product();
        let path = self.location.path();
        self.findings.read((path, steps), sink, |conversion, sink| {
            if !self.layout.is_x_fastest() {
                return sink(self.read_turned(step, progress, conversion)?);
            }
            let mut pieces = Pieces::new(path, self.sample_type(), expected, conversion);
            self.read_boxes(step, 2, progress, &mut |_, bytes| {
                self.push(&mut pieces, &bytes)?;
                pieces.hand_over(piece, sink)
            })?;
            pieces.finish(sink)
        })
    }
}
