//! The values of a data set that are read, by tag; and the error of an invalid value.

use std::collections::BTreeMap;
use std::io;

/// Group and element of a tag.
pub type Tag = u32;

/// Declares the tags that are read, each with its name in messages.
macro_rules! tags {
    ($($name:ident = $tag:literal, $text:literal;)*) => {
        /// The tags that are read.
        pub mod tag {
            $(pub const $name: super::Tag = $tag;)*
        }
        /// Names of the tags.
        const NAMES: &[(Tag, &str)] = &[$(($tag, $text)),*];
    };
}

tags! {
    TRANSFER_SYNTAX = 0x0002_0010, "TransferSyntaxUID";
    INSTANCE = 0x0008_0018, "SOPInstanceUID";
    MODALITY = 0x0008_0060, "Modality";
    SPACING_BETWEEN_SLICES = 0x0018_0088, "SpacingBetweenSlices";
    TRIGGER_TIME = 0x0018_1060, "TriggerTime";
    CARDIAC_SYNCHRONIZATION = 0x0018_9118, "CardiacSynchronizationSequence";
    SERIES = 0x0020_000e, "SeriesInstanceUID";
    SERIES_NUMBER = 0x0020_0011, "SeriesNumber";
    ACQUISITION_NUMBER = 0x0020_0012, "AcquisitionNumber";
    POSITION = 0x0020_0032, "ImagePositionPatient";
    ORIENTATION = 0x0020_0037, "ImageOrientationPatient";
    TEMPORAL_POSITION = 0x0020_0100, "TemporalPositionIdentifier";
    STACK = 0x0020_9056, "StackID";
    FRAME_CONTENT = 0x0020_9111, "FrameContentSequence";
    PLANE_POSITION = 0x0020_9113, "PlanePositionSequence";
    PLANE_ORIENTATION = 0x0020_9116, "PlaneOrientationSequence";
    TEMPORAL_INDEX = 0x0020_9128, "TemporalPositionIndex";
    TRIGGER_DELAY = 0x0020_9153, "NominalCardiacTriggerDelayTime";
    FRAME_ACQUISITION = 0x0020_9156, "FrameAcquisitionNumber";
    SAMPLES_PER_PIXEL = 0x0028_0002, "SamplesPerPixel";
    PHOTOMETRIC = 0x0028_0004, "PhotometricInterpretation";
    PLANAR = 0x0028_0006, "PlanarConfiguration";
    FRAMES = 0x0028_0008, "NumberOfFrames";
    FRAME_INCREMENT = 0x0028_0009, "FrameIncrementPointer";
    ROWS = 0x0028_0010, "Rows";
    COLUMNS = 0x0028_0011, "Columns";
    PIXEL_SPACING = 0x0028_0030, "PixelSpacing";
    BITS_ALLOCATED = 0x0028_0100, "BitsAllocated";
    BITS_STORED = 0x0028_0101, "BitsStored";
    HIGH_BIT = 0x0028_0102, "HighBit";
    REPRESENTATION = 0x0028_0103, "PixelRepresentation";
    PADDING = 0x0028_0120, "PixelPaddingValue";
    PADDING_LIMIT = 0x0028_0121, "PixelPaddingRangeLimit";
    FLOAT_PADDING = 0x0028_0122, "FloatPixelPaddingValue";
    DOUBLE_PADDING = 0x0028_0123, "DoubleFloatPixelPaddingValue";
    FLOAT_PADDING_LIMIT = 0x0028_0124, "FloatPixelPaddingRangeLimit";
    DOUBLE_PADDING_LIMIT = 0x0028_0125, "DoubleFloatPixelPaddingRangeLimit";
    INTERCEPT = 0x0028_1052, "RescaleIntercept";
    SLOPE = 0x0028_1053, "RescaleSlope";
    RESCALE_TYPE = 0x0028_1054, "RescaleType";
    MODALITY_TABLE = 0x0028_3000, "ModalityLUTSequence";
    PIXEL_MEASURES = 0x0028_9110, "PixelMeasuresSequence";
    VALUE_TRANSFORMATION = 0x0028_9145, "PixelValueTransformationSequence";
    ENERGY_WINDOWS = 0x0054_0010, "EnergyWindowVector";
    DETECTOR_NUMBERS = 0x0054_0020, "DetectorVector";
    DETECTORS = 0x0054_0022, "DetectorInformationSequence";
    PHASES = 0x0054_0030, "PhaseVector";
    ROTATIONS = 0x0054_0050, "RotationVector";
    INTERVALS = 0x0054_0060, "RRIntervalVector";
    TIME_SLOTS = 0x0054_0070, "TimeSlotVector";
    SLICES = 0x0054_0080, "SliceVector";
    ANGULAR_VIEWS = 0x0054_0090, "AngularViewVector";
    TIME_SLICES = 0x0054_0100, "TimeSliceVector";
    UNITS = 0x0054_1001, "Units";
    SEGMENTATION_TYPE = 0x0062_0001, "SegmentationType";
    SEGMENTS = 0x0062_0002, "SegmentSequence";
    SEGMENT_NUMBER = 0x0062_0004, "SegmentNumber";
    SEGMENT_LABEL = 0x0062_0005, "SegmentLabel";
    SEGMENT_IDENTIFICATION = 0x0062_000a, "SegmentIdentificationSequence";
    REFERENCED_SEGMENT = 0x0062_000b, "ReferencedSegmentNumber";
    SEGMENT_COLOR = 0x0062_000d, "RecommendedDisplayCIELabValue";
    MAX_FRACTION = 0x0062_000e, "MaximumFractionalValue";
    DOSE_UNITS = 0x3004_0002, "DoseUnits";
    FRAME_OFFSETS = 0x3004_000c, "GridFrameOffsetVector";
    DOSE_SCALING = 0x3004_000e, "DoseGridScaling";
    SHARED_GROUPS = 0x5200_9229, "SharedFunctionalGroupsSequence";
    FRAME_GROUPS = 0x5200_9230, "PerFrameFunctionalGroupsSequence";
    FLOAT_PIXELS = 0x7fe0_0008, "FloatPixelData";
    DOUBLE_PIXELS = 0x7fe0_0009, "DoubleFloatPixelData";
    PIXELS = 0x7fe0_0010, "PixelData";
}

/// Returns the name of a tag, for messages.
pub fn name(tag: Tag) -> &'static str {
    match NAMES.binary_search_by_key(&tag, |(tag, _)| *tag) {
        Ok(at) => NAMES[at].1,
        Err(_) => "data element",
    }
}

/// Whether the value of a tag is read.
pub fn is_kept(tag: Tag) -> bool {
    NAMES.binary_search_by_key(&tag, |(tag, _)| *tag).is_ok()
}

/// Whether the value of a tag that is read is a sequence, which implicit value representations do not state.
pub fn is_sequence(tag: Tag) -> bool {
    use tag::*;
    matches!(
        tag,
        CARDIAC_SYNCHRONIZATION
            | FRAME_CONTENT
            | PLANE_POSITION
            | PLANE_ORIENTATION
            | PIXEL_MEASURES
            | DETECTORS
            | SEGMENTS
            | SEGMENT_IDENTIFICATION
            | VALUE_TRANSFORMATION
            | MODALITY_TABLE
            | SHARED_GROUPS
            | FRAME_GROUPS
    )
}

/// What is wrong, and in which element.
#[derive(Debug)]
pub struct Fault {
    pub field: &'static str,
    pub why: String,
}

impl Fault {
    pub fn new(field: &'static str, why: impl Into<String>) -> Self {
        Self { field, why: why.into() }
    }

    pub fn of(tag: Tag, why: impl Into<String>) -> Self {
        Self::new(name(tag), why)
    }
}

impl From<io::Error> for Fault {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::UnexpectedEof => {
                Self::new("data set", "the file ends inside of an element, expected its end")
            }
            _ => Self::new("data set", format!("cannot be read: {error}")),
        }
    }
}

/// Values by tag. The value of a sequence is the data sets of its items.
#[derive(Debug, Default)]
pub struct DataSet {
    pub big: bool,
    pub values: BTreeMap<Tag, Vec<u8>>,
    pub sequences: BTreeMap<Tag, Vec<DataSet>>,
}

impl DataSet {
    /// Returns the text of a tag without padding; `None` if it is absent or empty.
    pub fn text(&self, tag: Tag) -> Option<String> {
        let bytes = self.values.get(&tag)?;
        let text = String::from_utf8_lossy(bytes);
        let text = text.trim_matches(|c: char| c.is_whitespace() || c == '\0');
        (!text.is_empty()).then(|| text.to_owned())
    }

    /// Returns numbers that are written as text (DS, IS).
    pub fn numbers(&self, tag: Tag) -> Result<Option<Vec<f64>>, Fault> {
        let Some(text) = self.text(tag) else {
            return Ok(None);
        };
        let parsed: Result<Vec<f64>, _> = text.split('\\').map(|word| word.trim().parse()).collect();
        match parsed {
            Ok(values) if values.iter().all(|v| v.is_finite()) => Ok(Some(values)),
            // The text itself is not shown, as it may identify a patient.
            _ => Err(Fault::of(tag, "is no list of numbers, expected finite decimal numbers")),
        }
    }

    /// Returns `N` numbers that are written as text.
    pub fn array<const N: usize>(&self, tag: Tag) -> Result<Option<[f64; N]>, Fault> {
        let Some(values) = self.numbers(tag)? else {
            return Ok(None);
        };
        let found = values.len();
        let array = values.try_into();
        array
            .map(Some)
            .map_err(|_| Fault::of(tag, format!("{found} numbers, expected {N}")))
    }

    /// Returns one number that is written as text.
    pub fn number(&self, tag: Tag) -> Result<Option<f64>, Fault> {
        Ok(self.array::<1>(tag)?.map(|[v]| v))
    }

    /// Returns the bytes of a binary value, the least significant first.
    fn binary<const N: usize>(&self, tag: Tag) -> Result<Option<[u8; N]>, Fault> {
        let Some(bytes) = self.values.get(&tag).filter(|bytes| !bytes.is_empty()) else {
            return Ok(None);
        };
        let mut value: [u8; N] = bytes.as_slice().try_into().map_err(|_| {
            let found = bytes.len();
            Fault::of(tag, format!("{found} bytes, expected one value of {N}"))
        })?;
        if self.big {
            value.reverse();
        }
        Ok(Some(value))
    }

    /// Returns a 16-bit number (US).
    pub fn short(&self, tag: Tag) -> Result<Option<u16>, Fault> {
        Ok(self.binary(tag)?.map(u16::from_le_bytes))
    }

    /// Returns 16-bit numbers (US).
    pub fn shorts(&self, tag: Tag) -> Option<Vec<f64>> {
        let order = if self.big {
            u16::from_be_bytes
        } else {
            u16::from_le_bytes
        };
        let numbers = self
            .values
            .get(&tag)?
            .chunks_exact(2)
            .map(|b| f64::from(order([b[0], b[1]])));
        Some(numbers.collect())
    }

    /// Returns a 32-bit number (UL).
    pub fn long(&self, tag: Tag) -> Result<Option<u32>, Fault> {
        Ok(self.binary(tag)?.map(u32::from_le_bytes))
    }

    /// Returns a floating-point number (FL).
    pub fn single(&self, tag: Tag) -> Result<Option<f32>, Fault> {
        Ok(self.binary(tag)?.map(f32::from_le_bytes))
    }

    /// Returns a floating-point number (FD).
    pub fn double(&self, tag: Tag) -> Result<Option<f64>, Fault> {
        Ok(self.binary(tag)?.map(f64::from_le_bytes))
    }

    /// Returns the items of a sequence.
    pub fn items(&self, tag: Tag) -> &[Self] {
        self.sequences.get(&tag).map_or(&[], Vec::as_slice)
    }
}
