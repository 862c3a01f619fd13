//! Reads the samples of a variable, one time step at a time, by boxes of whole slices.

use isopeel_kernels::{SampleType, Samples};

use super::super::super::pieces::Pieces;
use super::super::super::stored::{Endian, StoredType};
use super::super::super::{FileLocation, ReadError, ReadProgress, Sink, Source, only_piece};
use super::axes::Layout;
use super::file::Variable;
use super::reader::open_file;
use super::values::Values;

/// Decoded bytes of a box, where chunks do not decide: enough for all threads, little beside the volume.
const BOX_BYTES: u64 = 8 << 20;

/// Samples of a variable.
#[derive(Debug)]
pub struct VariableSource {
    pub location: FileLocation,
    /// Length of the file when its header was read.
    pub file_bytes: u64,
    pub variable: Variable,
    pub values: Values,
    pub layout: Layout,
}

impl VariableSource {
    /// Type on the device.
    pub fn sample_type(&self) -> SampleType {
        self.values.sample_type()
    }

    fn error(&self, why: impl Into<String>) -> ReadError {
        ReadError::new(self.location.path(), &self.variable.path, why)
    }

    fn slice_bytes(&self) -> u64 {
        let [nx, ny, _] = self.layout.dims.map(u64::from);
        nx * ny * self.values.stored.bytes()
    }

    /// Slices that are read at once: whole chunks, so that none is decoded twice.
    fn slices_at_once(&self) -> u64 {
        let [_, _, z] = self.layout.axes;
        let chunk = self
            .variable
            .chunk
            .as_ref()
            .and_then(|chunk| chunk.get(z))
            .map_or(1, |&n| n.max(1));
        let chunks = BOX_BYTES / self.slice_bytes().saturating_mul(chunk).max(1);
        chunk * chunks.max(1)
    }
}

impl Source for VariableSource {
    fn stored_bytes(&self) -> u64 {
        self.slice_bytes() * u64::from(self.layout.dims[2])
    }

    fn inputs(&self, _: u32) -> Vec<FileLocation> {
        vec![self.location.clone()]
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
        let have = self.location.open()?.len();
        if have != self.file_bytes {
            let had = self.file_bytes;
            return Err(self.error(format!(
                "the file has {have} bytes, it had {had} when its header was read"
            )));
        }
        let file = open_file(&self.location)?;
        let expected = dims.iter().map(|&n| u64::from(n)).product();
        let mut pieces = Pieces::new(self.location.path(), self.sample_type(), expected);
        let [_, _, nz] = dims.map(u64::from);
        let at_once = self.slices_at_once();
        for z in (0..nz).step_by(at_once as usize) {
            progress.go_on(self.location.path())?;
            let selection = self.layout.selection(step, z..(z + at_once).min(nz));
            let bytes = file.read(&self.variable, &selection).map_err(|why| self.error(why))?;
            if self.values.needs_nan() {
                let values = self.values.decode(&bytes, self.variable.endian);
                pieces.push(bytemuck::cast_slice(&values), StoredType::F32, Endian::NATIVE, None)?;
            } else {
                pieces.push(&bytes, self.values.stored, self.variable.endian, self.values.scale)?;
            }
            progress.add(bytes.len() as u64);
            pieces.hand_over(piece, sink)?;
        }
        pieces.finish(sink)
    }
}
