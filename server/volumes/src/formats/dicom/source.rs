//! Reads the samples of a stack of images, several at once.

use std::io::{BufReader, Read};
use std::sync::Arc;

use flate2::bufread::DeflateDecoder;
use isopeel_kernels::Samples;

use super::super::super::conversion::Conversion;
use super::super::super::location::Blob;
use super::super::super::parallel::try_map;
use super::super::super::pieces::Pieces;
use super::super::super::stored::{Endian, StoredType};
use super::super::super::{FileLocation, ReadError, ReadProgress, Sink, Source, only_piece};
use super::codecs;
use super::data_set::{Fault, tag};
use super::elements::Stream;
use super::frames::Image;
use super::image::{ImageFile, Pixels};
use super::label::FileLabel;
use super::samples::{Color, Kind, Target};
use super::syntax::Packing;

/// Bytes that are decoded at once, in the device's type: enough images for all threads, little beside the volume.
const BATCH_BYTES: u64 = 8 << 20;

/// An image and its file.
#[derive(Clone)]
pub struct StoredImage {
    pub file: Arc<ImageFile>,
    pub image: Image,
}

/// The samples of a stack.
pub struct DicomSamples {
    label: FileLabel,
    /// Step by step, in the order of the slices.
    images: Vec<StoredImage>,
    slices: usize,
    target: Target,
}

impl std::fmt::Debug for DicomSamples {
    /// Omits the identifiers of series and images.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "DicomSamples({} images, {} a step)", self.images.len(), self.slices)
    }
}

impl DicomSamples {
    /// `images`: step by step, `slices` images each.
    pub fn new(label: FileLabel, images: Vec<StoredImage>, slices: usize, target: Target) -> Self {
        Self {
            label,
            images,
            slices,
            target,
        }
    }
}

impl Source for DicomSamples {
    fn stored_bytes(&self) -> u64 {
        self.images[..self.slices].iter().map(StoredImage::bytes).sum()
    }

    fn inputs(&self, step: u32) -> Vec<FileLocation> {
        let images = self.images.chunks(self.slices).nth(step as usize).unwrap_or_default();
        images.iter().map(|image| image.file.location.clone()).collect()
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
        let Some(images) = self.images.chunks(self.slices).nth(step as usize) else {
            let why = format!("{step}, expected 0 to {}", self.images.len() / self.slices - 1);
            return Err(self.label.error("step", why));
        };
        let samples = images[0].file.format.samples();
        let sample_type = self.target.sample_type;
        // Each image is converted on its own, as it has its own scale.
        let conversion = Conversion::default();
        let mut pieces = Pieces::new(
            &self.label.asked,
            sample_type,
            samples * self.slices as u64,
            &conversion,
        );
        let bytes = samples * sample_type.bytes() as u64;
        let batch = (BATCH_BYTES / bytes).clamp(1, 64) as usize;
        for batch in images.chunks(batch) {
            progress.go_on(&self.label.asked)?;
            let decoded = try_map(batch.len(), |i| batch[i].read(self.target, progress))?;
            for values in decoded {
                let (bytes, stored) = (values.as_bytes(), stored_type(&values));
                pieces.push(bytes, stored, NATIVE, None)?;
            }
            pieces.hand_over(piece, sink)?;
        }
        pieces.finish(sink)
    }
}

const NATIVE: Endian = if cfg!(target_endian = "big") {
    Endian::Big
} else {
    Endian::Little
};

fn stored_type(samples: &Samples) -> StoredType {
    match samples {
        Samples::U8(_) => StoredType::U8,
        Samples::I8(_) => StoredType::I8,
        Samples::U16(_) => StoredType::U16,
        Samples::I16(_) => StoredType::I16,
        Samples::F32(_) => StoredType::F32,
    }
}

impl StoredImage {
    /// Returns the bytes of the file that hold the image.
    pub fn bytes(&self) -> u64 {
        match &self.file.pixels {
            Pixels::Plain { .. } => self.file.format.stored_bytes(1),
            Pixels::Deflated { from, .. } => self.file.file_bytes - from,
            Pixels::Fragments(frames) => {
                let frame = &frames[self.image.frame as usize];
                frame.iter().map(|(_, bytes)| u64::from(*bytes)).sum()
            }
        }
    }

    pub fn read(&self, target: Target, progress: &ReadProgress) -> Result<Samples, ReadError> {
        let label = &self.file.label;
        let blob = self.file.location.open().map_err(|e| label.error("file", e.why))?;
        let blob = blob.counted(progress);
        if blob.len() != self.file.file_bytes {
            let (found, expected) = (blob.len(), self.file.file_bytes);
            let why = format!("the file has {found} bytes, it had {expected} when its header was read");
            return Err(label.error("data", why));
        }
        let fail = |fault: Fault| label.error(fault.field, fault.why);
        let (frame, color) = self.frame(&blob).map_err(fail)?;
        let format = super::samples::SampleFormat {
            color,
            ..self.file.format
        };
        Ok(format.values(&frame, self.image.scale, target))
    }

    fn plain(&self, blob: &Blob<'_>, at: u64, words: bool) -> Result<Vec<u8>, Fault> {
        let format = &self.file.format;
        if format.kind == Kind::Bit {
            return self.bits(blob, at);
        }
        let bytes = format.frame_bytes();
        let first = u64::from(self.image.frame) * bytes;
        if !self.file.syntax.writing.big {
            return exactly(bytes, blob.reader(at + first));
        }
        // Read whole words: the first and last byte of an image of odd length share a word with its neighbours.
        let width = if words { format.bytes.max(2) } else { format.bytes };
        let before = first % width as u64;
        let all = (before + bytes).next_multiple_of(width as u64);
        let mut frame = exactly(all, blob.reader(at + first - before))?;
        frame.chunks_exact_mut(width).for_each(<[u8]>::reverse);
        frame.drain(..before as usize);
        frame.truncate(bytes as usize);
        Ok(frame)
    }

    /// Unpacks the bits of a frame, one a byte. A frame may begin inside a byte.
    fn bits(&self, blob: &Blob<'_>, at: u64) -> Result<Vec<u8>, Fault> {
        let samples = self.file.format.samples();
        let first = u64::from(self.image.frame) * samples;
        let (from, to) = (first / 8, (first + samples).div_ceil(8));
        let packed = exactly(to - from, blob.reader(at + from))?;
        let bit = |i: u64| {
            let at = first % 8 + i;
            packed[(at / 8) as usize] >> (at % 8) & 1
        };
        Ok((0..samples).map(bit).collect())
    }

    /// Reads the stored samples, words with the least significant byte first. Also returns the order of their components.
    fn frame(&self, blob: &Blob<'_>) -> Result<(Vec<u8>, Color), Fault> {
        let format = &self.file.format;
        let bytes = format.frame_bytes();
        match &self.file.pixels {
            Pixels::Plain { at, words } => self.plain(blob, *at, *words).map(|frame| (frame, format.color)),
            Pixels::Deflated { from, at } => {
                let mut inflated = DeflateDecoder::new(BufReader::new(blob.reader(*from)));
                inflated.pass(*at)?;
                Ok((exactly(bytes, inflated)?, format.color))
            }
            Pixels::Fragments(frames) => {
                let Packing::Encoded(codec) = self.file.syntax.packing else {
                    return Err(Fault::of(tag::PIXELS, "fragments of samples that are not compressed"));
                };
                let mut encoded = Vec::new();
                for &(at, bytes) in &frames[self.image.frame as usize] {
                    encoded.extend(exactly(bytes.into(), blob.reader(at))?);
                }
                codecs::decode(codec, &encoded, format)
            }
        }
    }
}

/// Reads exactly this many bytes of a stream. Memory grows with the bytes that are read.
fn exactly(bytes: u64, stream: impl Read) -> Result<Vec<u8>, Fault> {
    let mut read = Vec::new();
    stream.take(bytes).read_to_end(&mut read)?;
    if (read.len() as u64) < bytes {
        return Err(Fault::of(
            tag::PIXELS,
            format!("{} bytes, expected {bytes}", read.len()),
        ));
    }
    Ok(read)
}
