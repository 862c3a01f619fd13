//! The images of one file, and the properties of their samples in its header.

use std::io::BufReader;
use std::sync::Arc;

use flate2::bufread::DeflateDecoder;

use super::super::super::location::{Blob, BlobReader};
use super::super::super::stored::DEFLATE_RATIO;
use super::super::super::{FileLocation, ReadError};
use super::beginning::Beginning;
use super::data_set::{DataSet, Fault, tag};
use super::elements::{Elements, PixelElement, Stream, Writing};
use super::frames::{self, Image};
use super::label::FileLabel;
use super::samples::{Kind, SampleFormat};
use super::segments::Segmentation;
use super::syntax::{Packing, Syntax};

/// A header has a few kilobytes, only parts of which are read.
const BUFFER_BYTES: usize = 1 << 13;
/// Maximum frames of a file; each takes some hundred bytes beside its samples.
const MAX_FRAMES: f64 = 65_536.0;

/// A file with images. Must not be printed, as it holds identifiers.
pub struct ImageFile {
    pub location: FileLocation,
    pub label: FileLabel,
    /// Bytes of the file when its header was read.
    pub file_bytes: u64,
    /// Identifier of the series. Never shown.
    pub series: String,
    /// Identifier of the file. Never shown.
    pub instance: String,
    pub series_number: Option<i32>,
    pub modality: &'static str,
    /// Unit of the values.
    pub unit: Option<&'static str>,
    pub format: SampleFormat,
    /// For a segmentation: its segments.
    pub segmentation: Option<Segmentation>,
    pub syntax: Syntax,
    pub pixels: Pixels,
    /// Notices of repairs, and of elements that are not used.
    pub repairs: Vec<&'static str>,
}

/// Location of the samples in the file.
pub enum Pixels {
    /// All frames, one behind the other.
    Plain { at: u64, words: bool },
    /// The same in a deflated data set that begins at `from`; `at` counts decoded bytes.
    Deflated { from: u64, at: u64 },
    /// Each frame in fragments of its own: offset and length of each fragment.
    Fragments(Vec<Vec<(u64, u32)>>),
}

/// What a file holds.
pub enum Found {
    /// No image with a position in space: a report, a directory, a photograph.
    Nothing,
    Images(Arc<ImageFile>, Vec<Image>),
    /// Images that cannot be read. Their series is refused, others are not.
    Refused {
        series: String,
        error: ReadError,
    },
}

/// Reads the header of a file.
///
/// # Errors
/// The file cannot be read, so its series is unknown.
pub fn read(location: &FileLocation, label: &FileLabel) -> Result<Found, ReadError> {
    let fail = |fault: Fault| label.error(fault.field, fault.why);
    // The path in the error would be that of a file in the folder, which may identify a patient.
    let blob = location.open().map_err(|e| label.error("file", e.why))?;
    let beginning = Beginning::of_blob(&blob);
    let beginning = beginning.ok_or_else(|| label.error("magic", "expected DICM behind the first 128 bytes"))?;
    let (syntax, from, set, element) = elements(&blob, beginning).map_err(fail)?;
    let Some(element) = element else {
        return Ok(Found::Nothing);
    };
    let header = Header {
        blob: &blob,
        syntax,
        from,
        set: &set,
        beginning,
    };
    Ok(match header.images(&element, location, label) {
        Ok((_, images)) if images.is_empty() => Found::Nothing,
        Ok((file, images)) => Found::Images(Arc::new(file), images),
        Err(fault) => Found::Refused {
            series: set.text(tag::SERIES).unwrap_or_default(),
            error: fail(fault),
        },
    })
}

const EXPLICIT: Writing = Writing {
    implicit: false,
    big: false,
};

fn buffered<'a>(blob: &'a Blob<'_>, at: u64) -> BufReader<BlobReader<'a>> {
    BufReader::with_capacity(BUFFER_BYTES, blob.reader(at))
}

/// Returns the transfer syntax, the offset of the data set, the elements before the samples, and the element with the samples.
fn elements(blob: &Blob<'_>, beginning: Beginning) -> Result<(Syntax, u64, DataSet, Option<PixelElement>), Fault> {
    let (syntax, from) = match beginning {
        Beginning::Meta { at, .. } => {
            let meta = Elements::new(buffered(blob, at), EXPLICIT, at, blob.len());
            let (meta, from) = meta.meta()?;
            (Syntax::of(meta.text(tag::TRANSFER_SYNTAX).as_deref())?, from)
        }
        Beginning::DataSet(writing) => {
            let packing = Packing::Plain;
            (Syntax { writing, packing }, 0)
        }
    };
    let stream = buffered(blob, from);
    let (set, element) = if syntax.packing == Packing::Deflated {
        let reach = blob.len().saturating_mul(DEFLATE_RATIO);
        Elements::new(DeflateDecoder::new(stream), syntax.writing, 0, reach).data_set()?
    } else {
        Elements::new(stream, syntax.writing, from, blob.len()).data_set()?
    };
    Ok((syntax, from, set, element))
}

/// A header whose elements were read.
struct Header<'a> {
    blob: &'a Blob<'a>,
    syntax: Syntax,
    /// Offset at which the data set begins.
    from: u64,
    set: &'a DataSet,
    beginning: Beginning,
}

impl Header<'_> {
    fn images(
        &self,
        element: &PixelElement,
        location: &FileLocation,
        label: &FileLabel,
    ) -> Result<(ImageFile, Vec<Image>), Fault> {
        let set = self.set;
        let format = SampleFormat::of(set, element.tag)?;
        let count = count(set)?;
        let modality = modality(set);
        let file = ImageFile {
            location: location.clone(),
            label: label.clone(),
            file_bytes: self.blob.len(),
            series: set.text(tag::SERIES).unwrap_or_default(),
            instance: set.text(tag::INSTANCE).unwrap_or_default(),
            series_number: set.number(tag::SERIES_NUMBER).ok().flatten().map(|n| n as i32),
            modality,
            unit: unit(set, modality),
            format,
            segmentation: Segmentation::of(set)?,
            syntax: self.syntax,
            pixels: self.pixels(element, &format, count)?,
            repairs: self.repairs(),
        };
        Ok((file, frames::images(set, count)?))
    }

    /// Returns notices of what other programs may show differently.
    fn repairs(&self) -> Vec<&'static str> {
        let has_table = !self.set.items(tag::MODALITY_TABLE).is_empty();
        let table = has_table.then_some("values are those stored: ModalityLUTSequence, a table of values, is not used");
        self.beginning.repair().into_iter().chain(table).collect()
    }

    /// Locates the samples, and compares their size with the header.
    fn pixels(&self, element: &PixelElement, format: &SampleFormat, count: u32) -> Result<Pixels, Fault> {
        match (self.syntax.packing, element.bytes) {
            (Packing::Other(name), _) => {
                let why =
                    format!("{name}, expected plain or deflated samples, run lengths, JPEG, JPEG-LS or JPEG 2000");
                Err(Fault::of(tag::TRANSFER_SYNTAX, why))
            }
            (packing, _) if format.kind == Kind::Bit && packing != Packing::Plain => Err(Fault::of(
                tag::TRANSFER_SYNTAX,
                "compressed samples of one bit, expected plain ones",
            )),
            (Packing::Deflated, _) => deflated(self.blob, self.from, element, format, count),
            (Packing::Plain, _) => plain(element, format, count),
            (Packing::Encoded(_), None) => {
                let stream = buffered(self.blob, element.at);
                let elements = Elements::new(stream, EXPLICIT, element.at, self.blob.len());
                fragments(elements, self.blob, format, count)
            }
            (Packing::Encoded(_), Some(_)) => Err(Fault::of(
                tag::PIXELS,
                "one value, expected fragments of compressed samples",
            )),
        }
    }
}

fn count(set: &DataSet) -> Result<u32, Fault> {
    let count = set.number(tag::FRAMES)?.unwrap_or(1.0);
    if count.fract() != 0.0 || !(1.0..=MAX_FRAMES).contains(&count) {
        return Err(Fault::of(
            tag::FRAMES,
            format!("{count}, expected a whole number from 1 to {MAX_FRAMES}"),
        ));
    }
    Ok(count as u32)
}

fn plain(element: &PixelElement, format: &SampleFormat, count: u32) -> Result<Pixels, Fault> {
    let expected = format.stored_bytes(count);
    let found = u64::from(element.bytes.unwrap_or(0));
    // Some writers pad the last block, but a whole further image is an error.
    if found < expected || found - expected >= format.frame_bytes().max(2) {
        let why = format!("{found} bytes, expected {expected}: {}", format.describe(count));
        return Err(Fault::of(element.tag, why));
    }
    Ok(Pixels::Plain {
        at: element.at,
        words: element.words,
    })
}

fn deflated(
    blob: &Blob<'_>,
    from: u64,
    element: &PixelElement,
    format: &SampleFormat,
    count: u32,
) -> Result<Pixels, Fault> {
    if count > 1 {
        // Each frame would be decoded from the start of the file.
        let why = format!("{count} in a deflated file, expected 1");
        return Err(Fault::of(tag::FRAMES, why));
    }
    plain(element, format, count)?;
    let reach = (blob.len() - from).saturating_mul(DEFLATE_RATIO);
    if element.at + format.frame_bytes() > reach {
        let why = format!("{} compressed bytes cannot hold {}", blob.len(), format.describe(count));
        return Err(Fault::of(element.tag, why));
    }
    Ok(Pixels::Deflated { from, at: element.at })
}

/// Finds the fragments of each frame.
fn fragments<S: Stream>(
    elements: Elements<S>,
    blob: &Blob<'_>,
    format: &SampleFormat,
    count: u32,
) -> Result<Pixels, Fault> {
    let all = elements.fragments()?;
    let Some((&(table_at, table_bytes), rest)) = all.split_first() else {
        return Err(Fault::of(
            tag::PIXELS,
            "no fragment, expected a table of offsets and compressed samples",
        ));
    };
    let frames: Vec<Vec<(u64, u32)>> = if count == 1 {
        vec![rest.to_vec()]
    } else if rest.len() == count as usize {
        rest.iter().map(|&fragment| vec![fragment]).collect()
    } else if u64::from(table_bytes) == 4 * u64::from(count) {
        let mut table = vec![0; table_bytes as usize];
        blob.read_exact_at(&mut table, table_at)?;
        let starts = table
            .chunks_exact(4)
            .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        by_table(&starts.collect::<Vec<_>>(), rest)?
    } else {
        let why = format!("{} fragments of {count} frames without a table of offsets", rest.len());
        return Err(Fault::of(tag::PIXELS, why + ", expected one each, or the table"));
    };
    for frame in &frames {
        let bytes: u64 = frame.iter().map(|(_, bytes)| u64::from(*bytes)).sum();
        // The best codec reaches this ratio for an empty image. Beyond it, an invalid header could claim any amount of memory.
        if format.frame_bytes() > bytes.saturating_mul(1000).max(2 << 20) {
            let why = format!("{bytes} compressed bytes of a frame cannot hold {}", format.describe(1));
            return Err(Fault::of(tag::PIXELS, why));
        }
    }
    Ok(Pixels::Fragments(frames))
}

/// Groups fragments to frames by the table's offsets, which count from the first fragment's head.
fn by_table(starts: &[u32], fragments: &[(u64, u32)]) -> Result<Vec<Vec<(u64, u32)>>, Fault> {
    let first = fragments.first().map_or(0, |f| f.0);
    let mut frames: Vec<Vec<(u64, u32)>> = Vec::new();
    for &(at, bytes) in fragments {
        let offset = at - first;
        if starts
            .get(frames.len())
            .is_some_and(|&start| u64::from(start) == offset)
        {
            frames.push(Vec::new());
        }
        let Some(frame) = frames.last_mut() else { break };
        frame.push((at, bytes));
    }
    if frames.len() != starts.len() {
        let (expected, found) = (starts.len(), frames.len());
        let why = format!("fragments begin at {found} of the table's offsets, expected it of all {expected}");
        return Err(Fault::of(tag::PIXELS, why));
    }
    Ok(frames)
}

/// Returns the kind of image, by the names of the standard. Any other text is not shown, as it may identify a patient.
fn modality(set: &DataSet) -> &'static str {
    const KNOWN: [&str; 18] = [
        "CT", "MR", "PT", "NM", "US", "XA", "RF", "CR", "DX", "MG", "RTDOSE", "RTIMAGE", "SEG", "OT", "OPT", "IVUS",
        "SM", "SC",
    ];
    let text = set.text(tag::MODALITY).unwrap_or_default();
    KNOWN.into_iter().find(|known| **known == text).unwrap_or("image")
}

/// Returns the unit of the values: of doses, of the rescaled values, of PET. Only texts of the standard are shown.
fn unit(set: &DataSet, modality: &str) -> Option<&'static str> {
    const KNOWN: [&str; 26] = [
        "HU",
        "HU_MOD",
        "OD",
        "MGML",
        "Z_EFF",
        "ED",
        "EDW",
        "PCT",
        "CNTS",
        "CM2",
        "PCNT",
        "CPS",
        "BQML",
        "MGMINML",
        "UMOLMINML",
        "MLMING",
        "MLG",
        "1CM",
        "UMOLML",
        "PROPCNTS",
        "PROPCPS",
        "MLMINML",
        "MLML",
        "GML",
        "STDDEV",
        "GY",
    ];
    let known = |text: &str| KNOWN.into_iter().find(|known| *known == text);
    let shared = set.items(tag::SHARED_GROUPS).first();
    let groups = shared.into_iter().chain(set.items(tag::FRAME_GROUPS).first());
    let nested = groups.flat_map(|group| group.items(tag::VALUE_TRANSFORMATION));
    let mut types = std::iter::once(set)
        .chain(nested)
        .filter_map(|set| set.text(tag::RESCALE_TYPE));
    if modality == "CT" {
        // HU is the default of CT. A file states an unspecified unit as US.
        return types.next().map_or(Some("HU"), |text| known(&text));
    }
    let other = [tag::UNITS, tag::DOSE_UNITS].into_iter().find_map(|tag| set.text(tag));
    types.chain(other).find_map(|text| known(&text))
}
