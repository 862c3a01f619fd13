//! MetaImage: `.mha`, and `.mhd` with its samples in another file (<https://itk.org/Wiki/MetaIO/Documentation>).
//!
//! Read: plain, zlib-compressed and text samples, `ElementSpacing` (or `ElementSize`), `Offset` (`Position`, `Origin`),
//! `TransformMatrix` (`Rotation`, `Orientation`) whose rows are the axes in the world, byte order, `HeaderSize` −1, a
//! fourth axis as time steps, channels as fields. The format has no missing value. Refused with the reason: samples
//! split over several files.

use std::path::Path;

use super::super::stored::{Begin, Encoding, Endian, StoredSamples, StoredType};
use super::super::{FileLocation, Frame, Geometry, LengthUnit, Notices, OpenedFile, ReadError, TimeAxis};
use super::header::{self, Channels, FieldHead, GridFields, MAX_CHANNELS, MAX_HEADER_BYTES, not_3d, numbers, sizes};

const FIELDS: GridFields = GridFields {
    dims: "DimSize",
    spacing: "ElementSpacing",
    origin: "Offset",
    direction: "TransformMatrix",
};

/// Reads the header of a MetaImage file.
///
/// # Errors
/// What is wrong with it, by field.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let blob = location.open()?;
    let head = blob.head(MAX_HEADER_BYTES)?;
    let header = Header::parse(location, &head)?;
    let path = location.path();
    if let Some(kind) = header.get(&["ObjectType"])
        && !kind.eq_ignore_ascii_case("image")
    {
        return Err(header.error("ObjectType", format!("{kind:?}, expected Image")));
    }
    let dimension: usize = header.number("NDims")?;
    if !(3..=4).contains(&dimension) {
        return Err(not_3d(path, "NDims", dimension));
    }
    let channels = header.channels()?;
    let stored_name = header.required("ElementType")?;
    let stored = stored_type(stored_name).ok_or_else(|| {
        header.error(
            "ElementType",
            format!("{stored_name:?}, expected MET_CHAR to MET_DOUBLE"),
        )
    })?;
    let mut notices = Notices::default();
    let (mut geometry, steps, times) = header.geometry(dimension, &mut notices)?;
    // The world of MetaIO is that of ITK; a writer of patients' data states the directions of the axes.
    if header
        .get(&["AnatomicalOrientation"])
        .is_some_and(|letters| !letters.starts_with('?'))
    {
        geometry.frame = Frame::Lps;
        geometry.unit = Some(LengthUnit::Millimetre);
    }
    if let Some(unit) = header.get(&["DistanceUnits"]).filter(|unit| !unit.starts_with('?')) {
        geometry.unit = LengthUnit::parse(unit);
        if geometry.unit.is_none() {
            notices.add(format!(
                "DistanceUnits is {unit:?}, which is no unit of lengths: distances have none"
            ));
        }
    }

    header.tell_of_intensities(&mut notices);
    let samples = header
        .samples(&geometry, stored, steps)?
        .interleaved(channels, "DimSize")?;
    samples.check("DimSize")?;
    let like = FieldHead {
        name: location.stem(),
        stored_type: stored_name.to_owned(),
        missing: None,
        unit: None,
    };
    // The format does not distinguish colours from vectors.
    let fields = Channels::numbered(&like.name, channels).fields(&samples, 1, &like);
    Ok(OpenedFile {
        geometry,
        steps,
        uneven: None,
        axes: None,
        times,
        fields,
        notices,
    })
}

fn stored_type(name: &str) -> Option<StoredType> {
    Some(match name {
        "MET_CHAR" | "MET_ASCII_CHAR" => StoredType::I8,
        "MET_UCHAR" => StoredType::U8,
        "MET_SHORT" => StoredType::I16,
        "MET_USHORT" => StoredType::U16,
        // MetaIO's long has 4 bytes on every machine.
        "MET_INT" | "MET_LONG" => StoredType::I32,
        "MET_UINT" | "MET_ULONG" => StoredType::U32,
        "MET_LONG_LONG" => StoredType::I64,
        "MET_ULONG_LONG" => StoredType::U64,
        "MET_FLOAT" => StoredType::F32,
        "MET_DOUBLE" => StoredType::F64,
        _ => return None,
    })
}

struct Header<'a> {
    location: &'a FileLocation,
    fields: Vec<(String, String)>,
    /// Offset of samples in the same file: after the line `ElementDataFile`, the last of the header.
    data_offset: u64,
}

impl<'a> Header<'a> {
    fn parse(location: &'a FileLocation, bytes: &[u8]) -> Result<Self, ReadError> {
        let mut header = Header {
            location,
            fields: Vec::new(),
            data_offset: 0,
        };
        for (number, line) in bytes.split_inclusive(|&b| b == b'\n').enumerate() {
            header.data_offset += line.len() as u64;
            let line = String::from_utf8_lossy(line);
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let Some((name, value)) = line.split_once('=') else {
                let shown: String = line.chars().take(40).collect();
                let why = format!("line {} is {shown:?}, expected `Field = value`", number + 1);
                return Err(header.error("header", why));
            };
            let (name, value) = (name.trim(), value.trim());
            if header.get(&[name]).is_some() {
                return Err(header.error(name, "given twice, expected once"));
            }
            header.fields.push((name.to_owned(), value.to_owned()));
            if name.eq_ignore_ascii_case("ElementDataFile") {
                return Ok(header);
            }
        }
        Err(header.error("ElementDataFile", "missing, expected as the header's last line"))
    }

    fn error(&self, field: impl Into<String>, why: impl Into<String>) -> ReadError {
        ReadError::new(self.location.path(), field, why)
    }

    fn path(&self) -> &Path {
        self.location.path()
    }

    /// Returns the value of a field that has several possible names.
    fn get(&self, names: &[&str]) -> Option<&str> {
        names
            .iter()
            .find_map(|name| self.fields.iter().find(|(n, _)| n.eq_ignore_ascii_case(name)))
            .map(|(_, v)| v.as_str())
    }

    fn required(&self, name: &str) -> Result<&str, ReadError> {
        self.get(&[name])
            .ok_or_else(|| self.error(name, "missing, expected in every MetaImage header"))
    }

    fn number(&self, name: &str) -> Result<usize, ReadError> {
        let text = self.required(name)?;
        text.parse()
            .map_err(|_| self.error(name, format!("{text:?}, expected a whole number")))
    }

    fn channels(&self) -> Result<u32, ReadError> {
        let Some(text) = self.get(&["ElementNumberOfChannels"]) else {
            return Ok(1);
        };
        let channels = text
            .parse()
            .ok()
            .filter(|n| (1..=MAX_CHANNELS).contains(&u64::from(*n)));
        channels.ok_or_else(|| {
            let why = format!("{text:?}, expected 1 to {MAX_CHANNELS}");
            self.error("ElementNumberOfChannels", why)
        })
    }

    /// Adds a notice that values are the stored ones if the header has a function to intensities. No reader of ITK applies that function.
    fn tell_of_intensities(&self, notices: &mut Notices) {
        let number = |name: &str, usual: f64| self.get(&[name]).and_then(|text| text.parse().ok()).unwrap_or(usual);
        let slope: f64 = number("ElementToIntensityFunctionSlope", 1.0);
        let offset: f64 = number("ElementToIntensityFunctionOffset", 0.0);
        if (slope, offset) != (1.0, 0.0) {
            notices.add(format!(
                "values are those stored, as in ITK: the header has a function to intensities, {slope} x value + {offset}"
            ));
        }
    }

    fn flag(&self, names: &[&str], default: bool) -> Result<bool, ReadError> {
        match self.get(names).map(str::to_ascii_lowercase).as_deref() {
            None => Ok(default),
            Some("true" | "t" | "1") => Ok(true),
            Some("false" | "f" | "0") => Ok(false),
            Some(other) => Err(self.error(names[0], format!("{other:?}, expected True or False"))),
        }
    }

    fn samples(&self, geometry: &Geometry, stored: StoredType, steps: u32) -> Result<StoredSamples, ReadError> {
        let file = self.required("ElementDataFile")?;
        let local = file.eq_ignore_ascii_case("local");
        let data = if local {
            self.location.clone()
        } else {
            match self.location.sibling(file, "ElementDataFile") {
                Err(_) if file.starts_with("LIST") || file.contains('%') => {
                    let why =
                        format!("{file:?}: samples in many files, which are not read; expected LOCAL or one file");
                    return Err(self.error("ElementDataFile", why));
                }
                data => data?,
            }
        };
        let compressed = self.flag(&["CompressedData"], false)?;
        let binary = self.flag(&["BinaryData"], true)?;
        let begin = match self.get(&["HeaderSize"]) {
            _ if local => Begin::At(self.data_offset),
            None => Begin::At(0),
            Some("-1") if !compressed && binary => Begin::BeforeEnd,
            Some(text) => Begin::At(text.parse().map_err(|_| {
                let why = format!("{text:?}, expected 0 or more, or -1 for plain samples at the end of the file");
                self.error("HeaderSize", why)
            })?),
        };
        let mut samples = StoredSamples::new(&data, begin, stored, geometry, steps, "DimSize")?;
        samples.encoding = match (compressed, binary) {
            (true, _) => Encoding::Deflate,
            (false, true) => Encoding::Raw,
            (false, false) => Encoding::Text,
        };
        if self.flag(&["BinaryDataByteOrderMSB", "ElementByteOrderMSB"], false)? {
            samples.endian = Endian::Big;
        }
        if compressed {
            self.check_compressed_bytes(&samples)?;
        }
        Ok(samples)
    }

    fn check_compressed_bytes(&self, samples: &StoredSamples) -> Result<(), ReadError> {
        if let (Some(text), Begin::At(first)) = (self.get(&["CompressedDataSize"]), samples.begin) {
            let have = samples.file_bytes.saturating_sub(first);
            let claimed: u64 = text
                .parse()
                .map_err(|_| self.error("CompressedDataSize", format!("{text:?}, expected a number of bytes")))?;
            if claimed != 0 && claimed != have {
                let why = format!("{claimed} bytes, the file has {have} where they should be");
                return Err(self.error("CompressedDataSize", why));
            }
        }
        Ok(())
    }

    fn geometry(
        &self,
        dimension: usize,
        notices: &mut Notices,
    ) -> Result<(Geometry, u32, Option<TimeAxis>), ReadError> {
        let path = self.path();
        let list = |names: &[&str], count: usize| -> Result<Option<Vec<f64>>, ReadError> {
            self.get(names)
                .map(|text| numbers(path, names[0], text, Some(count)))
                .transpose()
        };
        let dims: Vec<u64> = numbers(path, "DimSize", self.required("DimSize")?, Some(dimension))?;
        let dims = sizes(path, "DimSize", &dims)?;
        let spacing = list(&["ElementSpacing", "ElementSize"], dimension)?.unwrap_or(vec![1.0; dimension]);
        let origin = list(&["Offset", "Position", "Origin"], dimension)?.unwrap_or(vec![0.0; dimension]);
        let matrix = list(&["TransformMatrix", "Rotation", "Orientation"], dimension * dimension)?;
        let axes = match &matrix {
            Some(m) => std::array::from_fn(|axis| std::array::from_fn(|i| m[axis * dimension + i])),
            None => Geometry::IDENTITY,
        };
        // The rows should be unit vectors. ITK multiplies them by the spacing, whatever their length.
        let (lengths, direction) = header::split_axes(axes);
        let first = |v: &[f64]| [v[0], v[1], v[2]];
        let (distances, direction) = header::signed_distances(first(&spacing), direction, notices);
        let is_unit = lengths.iter().all(|length| (length - 1.0).abs() < 1e-4);
        let distances = if is_unit {
            distances
        } else {
            notices.add(format!(
                "the rows of TransformMatrix have lengths {lengths:?}, expected 1: distances of samples are multiplied by them"
            ));
            std::array::from_fn(|axis| distances[axis] * lengths[axis])
        };
        let geometry = header::geometry(
            path,
            &FIELDS,
            [dims[0], dims[1], dims[2]],
            distances,
            first(&origin),
            direction,
        )?;
        let steps = dims.get(3).copied().unwrap_or(1);
        // The format has no unit of time, and writers put 1 if they do not know the distance of steps.
        let between = spacing.get(3).copied().filter(|between| *between != 1.0);
        let times = between.and_then(|between| TimeAxis::even(origin[3], between, steps, ""));
        Ok((geometry, steps, times))
    }
}
