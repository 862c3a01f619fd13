//! Stored samples of a file, and their values.

use isopeel_kernels::{SampleType, Samples};

use super::data_set::{DataSet, Fault, Tag, tag};

/// How the samples of an image are stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleFormat {
    pub columns: u32,
    pub rows: u32,
    /// Bytes of a component.
    pub bytes: usize,
    pub kind: Kind,
    pub color: Color,
    /// Range of stored values that mean "no sample here".
    pub padding: Option<[f64; 2]>,
}

/// Type of a component.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// `bits` of a word, above `shift` other bits, which may have any value.
    Integer {
        bits: u32,
        shift: u32,
        signed: bool,
    },
    Float,
    /// One bit. In the file, a byte has eight, the first one the least significant; in a frame that was read, each has a byte.
    Bit,
}

/// The components of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Color {
    Grey,
    /// Red, green and blue; each in a plane of its own, or side by side.
    Rgb {
        planes: bool,
    },
    /// Luma and differences of colours, in the full range.
    Ybr {
        planes: bool,
    },
}

impl SampleFormat {
    /// Reads the format from a header.
    pub fn of(set: &DataSet, pixels: Tag) -> Result<Self, Fault> {
        let size = |tag| match set.short(tag)? {
            Some(size) if size > 1 => Ok(u32::from(size)),
            found => Err(Fault::of(tag, format!("{}, expected 2 to 65535", found.unwrap_or(0)))),
        };
        let (rows, columns) = (size(tag::ROWS)?, size(tag::COLUMNS)?);
        let (bytes, kind) = match pixels {
            tag::FLOAT_PIXELS => (4, Kind::Float),
            tag::DOUBLE_PIXELS => (8, Kind::Float),
            _ => integer(set)?,
        };
        Ok(Self {
            columns,
            rows,
            bytes,
            kind,
            color: color(set)?,
            padding: padding(set, pixels, kind)?,
        })
    }

    fn components(&self) -> usize {
        if self.color == Color::Grey { 1 } else { 3 }
    }

    /// Returns the number of samples of an image.
    pub fn samples(&self) -> u64 {
        u64::from(self.rows) * u64::from(self.columns)
    }

    /// Returns the bytes of an image.
    pub fn frame_bytes(&self) -> u64 {
        self.samples() * self.components() as u64 * self.bytes as u64
    }

    /// Returns the bytes of this many images in a file, one behind the other.
    pub fn stored_bytes(&self, count: u32) -> u64 {
        match self.kind {
            Kind::Bit => (self.samples() * u64::from(count)).div_ceil(8),
            _ => self.frame_bytes() * u64::from(count),
        }
    }

    /// Returns the type, named as in other formats.
    pub fn type_name(&self) -> String {
        let letter = match self.kind {
            Kind::Float => 'f',
            Kind::Integer { signed: true, .. } => 'i',
            Kind::Integer { signed: false, .. } => 'u',
            Kind::Bit => return "u1".to_owned(),
        };
        format!("{letter}{}", 8 * self.bytes)
    }

    /// Returns size and type, for messages.
    pub fn describe(&self, frames: u32) -> String {
        let of = if self.color == Color::Grey { "" } else { "3 x " };
        let (name, columns, rows) = (self.type_name(), self.columns, self.rows);
        format!("{columns} x {rows} x {frames} samples of {of}{name}")
    }

    /// Returns the smallest and largest integer that can be stored; `None` for floating-point samples.
    pub fn range(&self) -> Option<[i64; 2]> {
        match self.kind {
            Kind::Float => None,
            Kind::Bit => Some([0, 1]),
            Kind::Integer { bits, signed: true, .. } => Some([-(1 << (bits - 1)), (1 << (bits - 1)) - 1]),
            Kind::Integer { bits, .. } => Some([0, (1 << bits) - 1]),
        }
    }

    /// Returns the word of a component, whose least significant byte comes first.
    fn word(&self, frame: &[u8], component: usize) -> u64 {
        let at = component * self.bytes;
        let bytes = &frame[at..at + self.bytes];
        bytes.iter().rev().fold(0, |word, &byte| word << 8 | u64::from(byte))
    }

    fn integer(&self, frame: &[u8], component: usize) -> i64 {
        let word = self.word(frame, component);
        match self.kind {
            Kind::Float => 0,
            Kind::Bit => (word & 1) as i64,
            Kind::Integer { bits, shift, signed } => {
                let left = word << (64 - bits - shift);
                if signed {
                    left as i64 >> (64 - bits)
                } else {
                    (left >> (64 - bits)) as i64
                }
            }
        }
    }

    /// Returns the stored integer of a sample; for colours the luminance, rounded.
    fn stored(&self, frame: &[u8], sample: usize) -> i64 {
        let of = |planes: bool| -> [f64; 3] {
            std::array::from_fn(|component| {
                let at = if planes {
                    component * self.samples() as usize + sample
                } else {
                    3 * sample + component
                };
                self.integer(frame, at) as f64
            })
        };
        let luminance = match self.color {
            Color::Grey => return self.integer(frame, sample),
            Color::Rgb { planes } => luminance(of(planes)),
            Color::Ybr { planes } => {
                let [y, blue, red] = of(planes);
                let middle = self.range().map_or(0.0, |[_, high]| (high / 2 + 1) as f64);
                let (blue, red) = (blue - middle, red - middle);
                luminance([
                    y + 1.402 * red,
                    y - 0.344_136 * blue - 0.714_136 * red,
                    y + 1.772 * blue,
                ])
            }
        };
        let [low, high] = self.range().unwrap_or_default();
        (luminance.round_ties_even() as i64).clamp(low, high)
    }

    fn float(&self, frame: &[u8], sample: usize) -> f64 {
        match (self.kind, self.bytes) {
            (Kind::Float, 4) => f32::from_bits(self.word(frame, sample) as u32).into(),
            (Kind::Float, _) => f64::from_bits(self.word(frame, sample)),
            _ => self.stored(frame, sample) as f64,
        }
    }

    /// Returns the values of an image, whose bytes must be [`Self::frame_bytes`].
    pub fn values(&self, frame: &[u8], scale: [f64; 2], target: Target) -> Samples {
        let whole = |sample| {
            let stored = self.stored(frame, sample);
            let is_missing = self
                .padding
                .is_some_and(|[low, high]| (low..=high).contains(&(stored as f64)));
            match target.missing {
                Some(missing) if is_missing => missing,
                _ => stored + scale[1] as i64,
            }
        };
        let float = |sample| {
            let stored = self.float(frame, sample);
            let is_missing = self.padding.is_some_and(|[low, high]| (low..=high).contains(&stored));
            if is_missing {
                f32::NAN
            } else {
                (scale[0] * stored + scale[1]) as f32
            }
        };
        let all = 0..self.samples() as usize;
        match target.sample_type {
            SampleType::U8 => Samples::U8(all.map(|sample| whole(sample) as u8).collect()),
            SampleType::I8 => Samples::I8(all.map(|sample| whole(sample) as i8).collect()),
            SampleType::U16 => Samples::U16(all.map(|sample| whole(sample) as u16).collect()),
            SampleType::I16 => Samples::I16(all.map(|sample| whole(sample) as i16).collect()),
            SampleType::F32 => Samples::F32(all.map(float).collect()),
        }
    }
}

/// Rec. 709.
fn luminance([red, green, blue]: [f64; 3]) -> f64 {
    0.2126 * red + 0.7152 * green + 0.0722 * blue
}

fn integer(set: &DataSet) -> Result<(usize, Kind), Fault> {
    let allocated = set.short(tag::BITS_ALLOCATED)?.unwrap_or(0);
    // One bit per sample is read only in segmentations: other such images are no measurements.
    if allocated == 1 && !set.items(tag::SEGMENTS).is_empty() {
        return Ok((1, Kind::Bit));
    }
    if !matches!(allocated, 8 | 16 | 32) {
        return Err(Fault::of(
            tag::BITS_ALLOCATED,
            format!("{allocated}, expected 8, 16 or 32"),
        ));
    }
    let stored = set.short(tag::BITS_STORED)?.unwrap_or(allocated);
    if !(1..=allocated).contains(&stored) {
        return Err(Fault::of(
            tag::BITS_STORED,
            format!("{stored}, expected 1 to {allocated}"),
        ));
    }
    let high = set.short(tag::HIGH_BIT)?.unwrap_or(stored - 1);
    if !(stored - 1..allocated).contains(&high) {
        let why = format!("{high}, expected {} to {}", stored - 1, allocated - 1);
        return Err(Fault::of(tag::HIGH_BIT, why));
    }
    let kind = Kind::Integer {
        bits: stored.into(),
        shift: u32::from(high + 1 - stored),
        signed: set.short(tag::REPRESENTATION)?.unwrap_or(0) == 1,
    };
    Ok((usize::from(allocated / 8), kind))
}

fn color(set: &DataSet) -> Result<Color, Fault> {
    let planes = set.short(tag::PLANAR)?.unwrap_or(0) == 1;
    let components = set.short(tag::SAMPLES_PER_PIXEL)?.unwrap_or(1);
    let name = set.text(tag::PHOTOMETRIC).unwrap_or_default();
    Ok(match (components, name.as_str()) {
        (1, "MONOCHROME1" | "MONOCHROME2" | "") => Color::Grey,
        // The codecs convert these kinds of colour to red, green and blue.
        (3, "RGB" | "YBR_RCT" | "YBR_ICT") => Color::Rgb { planes },
        (3, "YBR_FULL" | "YBR_FULL_422") => Color::Ybr { planes },
        _ => {
            // The text is not shown, as it may identify a patient.
            let why = format!(
                "another one, of {components} components; expected MONOCHROME1 or MONOCHROME2 of 1, RGB or YBR_FULL \
                 of 3"
            );
            return Err(Fault::of(tag::PHOTOMETRIC, why));
        }
    })
}

/// Returns the range of stored values that mean "no sample here".
fn padding(set: &DataSet, pixels: Tag, kind: Kind) -> Result<Option<[f64; 2]>, Fault> {
    let read = |tag| -> Result<Option<f64>, Fault> {
        match tag {
            tag::FLOAT_PADDING | tag::FLOAT_PADDING_LIMIT => Ok(set.single(tag)?.map(f64::from)),
            tag::DOUBLE_PADDING | tag::DOUBLE_PADDING_LIMIT => set.double(tag),
            _ => Ok(set.short(tag)?.map(|word| match kind {
                Kind::Integer { signed: true, .. } => f64::from(word as i16),
                _ => f64::from(word),
            })),
        }
    };
    let (value, limit) = match pixels {
        tag::FLOAT_PIXELS => (tag::FLOAT_PADDING, tag::FLOAT_PADDING_LIMIT),
        tag::DOUBLE_PIXELS => (tag::DOUBLE_PADDING, tag::DOUBLE_PADDING_LIMIT),
        _ => (tag::PADDING, tag::PADDING_LIMIT),
    };
    let Some(value) = read(value)? else {
        return Ok(None);
    };
    let limit = read(limit)?.unwrap_or(value);
    Ok(Some([value.min(limit), value.max(limit)]))
}

/// The type on the device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    pub sample_type: SampleType,
    /// Integer that means "no sample here"; in floating-point values NaN does.
    pub missing: Option<i64>,
}

impl Target {
    /// Returns the smallest type for the values of images with these formats and scales: an integer type if all have the same format and
    /// scale, the slope is 1, the offset is a whole number, and the values fit; else 32-bit floats.
    pub fn of<'a>(images: impl Iterator<Item = (&'a SampleFormat, [f64; 2])> + Clone) -> Self {
        let float = Self {
            sample_type: SampleType::F32,
            missing: None,
        };
        let Some((format, [slope, offset])) = images.clone().next() else {
            return float;
        };
        let alike = images.clone().all(|(other, scale)| {
            (other.kind, other.padding, other.color) == (format.kind, format.padding, format.color)
                && scale == [slope, offset]
        });
        let (true, Some([low, high]), 1.0) = (
            alike && offset.fract() == 0.0 && offset.abs() < 1e9,
            format.range(),
            slope,
        ) else {
            return float;
        };
        let values = [low + offset as i64, high + offset as i64];
        let fits = |low: i64, high: i64| (low..=high).contains(&values[0]) && (low..=high).contains(&values[1]);
        let sample_type = match () {
            () if fits(0, 0xff) => SampleType::U8,
            () if fits(-0x80, 0x7f) => SampleType::I8,
            () if fits(-0x8000, 0x7fff) => SampleType::I16,
            () if fits(0, 0xffff) => SampleType::U16,
            () => return float,
        };
        // Limited to values that can be stored.
        let padded = format
            .padding
            .map(|[from, to]| [(from as i64).max(low), (to as i64).min(high)]);
        let missing = padded
            .filter(|[from, to]| from <= to)
            .map(|[from, _]| from + offset as i64);
        Self { sample_type, missing }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn format(bytes: usize, kind: Kind) -> SampleFormat {
        SampleFormat {
            columns: 2,
            rows: 1,
            bytes,
            kind,
            color: Color::Grey,
            padding: None,
        }
    }

    fn target(format: &SampleFormat, scale: [f64; 2]) -> Target {
        Target::of(std::iter::once((format, scale)))
    }

    #[test]
    fn bits_outside_of_those_stored_are_not_read() {
        let kind = Kind::Integer {
            bits: 12,
            shift: 4,
            signed: true,
        };
        let stored = format(2, kind);
        let values = stored.values(&[0xff, 0xff, 0x1a, 0x00], [1.0, 0.0], target(&stored, [1.0, 0.0]));
        assert_eq!(values, Samples::I16(vec![-1, 1]));
    }

    #[test]
    fn padding_is_missing_in_either_type() {
        let kind = Kind::Integer {
            bits: 8,
            shift: 0,
            signed: false,
        };
        let stored = SampleFormat {
            padding: Some([7.0, 9.0]),
            ..format(1, kind)
        };
        let whole = target(&stored, [1.0, -100.0]);
        assert_eq!((whole.sample_type, whole.missing), (SampleType::I16, Some(-93)));
        assert_eq!(
            stored.values(&[9, 10], [1.0, -100.0], whole),
            Samples::I16(vec![-93, -90])
        );
        let scaled = target(&stored, [0.5, 0.0]);
        let Samples::F32(values) = stored.values(&[9, 10], [0.5, 0.0], scaled) else {
            panic!("{scaled:?}");
        };
        assert!(values[0].is_nan() && values[1] == 5.0);
    }

    #[test]
    fn padding_that_cannot_be_stored_marks_nothing() {
        let kind = Kind::Integer {
            bits: 12,
            shift: 0,
            signed: false,
        };
        let stored = SampleFormat {
            padding: Some([63536.0; 2]),
            ..format(2, kind)
        };
        assert_eq!(target(&stored, [1.0, 0.0]).missing, None);
    }

    #[test]
    fn colors_become_luminance_from_either_order() {
        let kind = Kind::Integer {
            bits: 8,
            shift: 0,
            signed: false,
        };
        let of = |color, frame: &[u8]| {
            let stored = SampleFormat {
                color,
                ..format(1, kind)
            };
            stored.values(frame, [1.0, 0.0], target(&stored, [1.0, 0.0]))
        };
        let expected = Samples::U8(vec![182, 18]);
        assert_eq!(of(Color::Rgb { planes: false }, &[0, 255, 0, 0, 0, 255]), expected);
        assert_eq!(of(Color::Rgb { planes: true }, &[0, 0, 255, 0, 0, 255]), expected);
        // Green is (150, 44, 21) there, and blue (29, 255, 107).
        let Samples::U8(values) = of(Color::Ybr { planes: true }, &[150, 29, 44, 255, 21, 107]) else {
            panic!("bytes expected");
        };
        assert!(
            values[0].abs_diff(182) <= 1 && values[1].abs_diff(18) <= 1,
            "{values:?}"
        );
    }

    #[test]
    fn values_that_fit_no_integer_become_floats() {
        let kind = Kind::Integer {
            bits: 16,
            shift: 0,
            signed: false,
        };
        let stored = format(2, kind);
        for (scale, expected) in [
            ([1.0, 0.0], SampleType::U16),
            ([1.0, -32768.0], SampleType::I16),
            ([1.0, -1024.0], SampleType::F32),
            ([1.0, 0.5], SampleType::F32),
            ([2.0, 0.0], SampleType::F32),
        ] {
            assert_eq!(target(&stored, scale).sample_type, expected, "{scale:?}");
        }
        let both = [(&stored, [1.0, 0.0]), (&stored, [1.0, 1.0])];
        assert_eq!(Target::of(both.into_iter()).sample_type, SampleType::F32);
    }
}
