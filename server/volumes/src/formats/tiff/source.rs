//! Reads the slices of a volume from their pages, several at once.

use std::collections::BTreeSet;
use std::sync::Arc;

use isopeel_kernels::{SampleType, Samples};

use super::super::super::parallel::try_map;
use super::super::super::pieces::Pieces;
use super::super::super::scalar::numbers;
use super::super::super::stored::{Endian, StoredType};
use super::super::super::{
    FileLocation, Findings, LabelRanks, Notices, ReadError, ReadProgress, Sink, Source, only_piece,
};
use super::page::{Image, Page};
use super::stack::Calibration;

/// Bytes of slices that are decoded at once: enough for all threads, little beside the volume.
const BATCH_BYTES: u64 = 16 << 20;

/// A file with pages.
#[derive(Debug)]
pub struct Pages {
    pub location: FileLocation,
    /// Length of the file when its pages were read.
    pub file_bytes: u64,
    pub pages: Vec<Page>,
}

/// Selects the samples of a pixel that a field is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pick {
    /// The sample of this index.
    Sample(u16),
    /// The luminance of the first three samples, by Rec. 709.
    Luminance,
}

/// One field of a volume in pages.
#[derive(Debug)]
pub struct PageSource {
    pub files: Arc<Vec<Pages>>,
    pub image: Image,
    pub pick: Pick,
    /// ImageJ's calibration of the stored numbers.
    pub calibration: Option<Calibration>,
    /// File and page of the slices of every time step.
    pub steps: Vec<Vec<(usize, usize)>>,
    pub findings: Findings,
}

impl PageSource {
    /// Type on the device.
    pub fn sample_type(&self) -> SampleType {
        match self.pick {
            Pick::Sample(_) => match self.calibration {
                None => self.image.stored.on_device(),
                Some(Calibration::Signed) => SampleType::I16,
                Some(Calibration::Line { .. }) => SampleType::F32,
            },
            Pick::Luminance => SampleType::F32,
        }
    }

    /// Returns the scale, value = `scale[0]` · stored + `scale[1]`, if the calibration is linear.
    fn scale(&self) -> Option<[f64; 2]> {
        match self.calibration {
            Some(Calibration::Line { slope, intercept }) => Some([slope, intercept]),
            _ => None,
        }
    }

    /// Reads the samples of a slice, and returns them with their type and byte order.
    fn slice(&self, (file, page): (usize, usize)) -> Result<(Vec<u8>, StoredType, Endian), ReadError> {
        let Pages {
            location,
            pages,
            file_bytes,
        } = &self.files[file];
        let fail = |why: String| ReadError::new(location.path(), format!("page {}", page + 1), why);
        let (page, blob) = (&pages[page], location.open()?);
        if blob.len() != *file_bytes {
            let have = blob.len();
            return Err(fail(format!(
                "the file has {have} bytes, it had {file_bytes} when its header was read"
            )));
        }
        let stored = self.image.stored;
        let (bytes, endian) = page.samples(&blob).map_err(fail)?;
        let pixels = self.image.width as usize * self.image.height as usize;
        let samples = bytes.len() / (pixels * stored.bytes() as usize);
        // Distances between the samples of a pixel, and between pixels.
        let (apart, next) = if page.is_planar { (pixels, 1) } else { (1, samples) };
        match self.pick {
            Pick::Sample(_) if samples == 1 && self.calibration == Some(Calibration::Signed) => {
                let mut bytes = bytes;
                let high = if endian == Endian::Big { 0 } else { 1 };
                bytes.iter_mut().skip(high).step_by(2).for_each(|byte| *byte ^= 0x80);
                Ok((bytes, StoredType::I16, endian))
            }
            Pick::Sample(_) if samples == 1 => Ok((bytes, stored, endian)),
            Pick::Sample(sample) => {
                let width = stored.bytes() as usize;
                let first = usize::from(sample) * apart;
                let pixel = |i: usize| bytes[(first + i * next) * width..].iter().take(width);
                Ok(((0..pixels).flat_map(pixel).copied().collect(), stored, endian))
            }
            Pick::Luminance => {
                let values = numbers(&bytes, stored, endian);
                let pixel = |i: usize| {
                    let [red, green, blue] = [0, 1, 2].map(|sample| values[i * next + sample * apart]);
                    (0.2126 * red + 0.7152 * green + 0.0722 * blue) as f32
                };
                let values: Vec<f32> = (0..pixels).map(pixel).collect();
                Ok((bytemuck::cast_slice(&values).to_vec(), StoredType::F32, Endian::NATIVE))
            }
        }
    }
}

impl Source for PageSource {
    fn stored_bytes(&self) -> u64 {
        self.image
            .bytes()
            .unwrap_or(u64::MAX)
            .saturating_mul(self.steps[0].len() as u64)
    }

    fn inputs(&self, step: u32) -> Vec<FileLocation> {
        let slices = self.steps.get(step as usize).map_or(&[][..], Vec::as_slice);
        let files: BTreeSet<usize> = slices.iter().map(|&(file, _)| file).collect();
        files
            .into_iter()
            .map(|file| self.files[file].location.clone())
            .collect()
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
        let path = self.files[0].location.path();
        let Some(planes) = self.steps.get(step as usize) else {
            let why = format!("{step}, expected 0 to {}", self.steps.len() - 1);
            return Err(ReadError::new(path, "step", why));
        };
        // The product fits: the pages were compared with the file.
        let slice_bytes = self.image.bytes().unwrap_or(u64::MAX);
        let expected = u64::from(self.image.width) * u64::from(self.image.height) * planes.len() as u64;
        let at_once = (BATCH_BYTES / slice_bytes).max(1) as usize;
        let steps = u32::try_from(self.steps.len()).unwrap_or(u32::MAX);
        self.findings.read((path, steps), sink, |conversion, sink| {
            let mut pieces = Pieces::new(path, self.sample_type(), expected, conversion);
            for batch in planes.chunks(at_once) {
                progress.go_on(path)?;
                let read = |i: usize| self.slice(batch[i]).inspect(|_| progress.add(slice_bytes));
                let slices = try_map(batch.len(), read)?;
                for (bytes, stored, endian) in slices {
                    pieces.push(&bytes, stored, endian, self.scale())?;
                }
                pieces.hand_over(piece, sink)?;
            }
            pieces.finish(sink)
        })
    }
}
