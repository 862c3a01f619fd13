//! NRRD: `.nrrd`, and `.nhdr` with its samples in another file (<http://teem.sourceforge.net/nrrd/format.html>).
//!
//! Read: encodings raw, gzip, bzip2, hex and text; every integer type and both floating-point types; `spacings`, or
//! `space directions` with `space origin`; an axis of kind `time`, else one of kind `list`, as time steps, wherever it
//! stands; one axis of another kind as channels, of which colours become their luminance; line and byte skips; `space`
//! (a patient's are turned to LPS) and units. Values of fields are compared in any case. A missing value is taken from
//! a key/value pair `missing value`, `missing_value` or `_FillValue`. Refused with the reason: several axes of
//! channels, samples split over several files.

use super::super::stored::{Begin, Encoding, Endian, StoredSamples, StoredType};
use super::super::{
    FileLocation, Frame, Geometry, Label, LengthUnit, MAX_LABELS, Notices, OpenedFile, ReadError, TimeAxis,
};
use super::header::{self, Channels, FieldHead, GridFields, MAX_CHANNELS, MAX_HEADER_BYTES, not_3d, numbers, three};

const FIELDS: GridFields = GridFields {
    dims: "sizes",
    spacing: "spacings",
    origin: "space origin",
    direction: "space directions",
};

/// Reads the header of a NRRD file.
///
/// # Errors
/// What is wrong with it, by field.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let blob = location.open()?;
    let head = blob.head(MAX_HEADER_BYTES)?;
    let header = Header::parse(location, &head)?;
    let stored_name = header.required("type")?;
    let stored = stored_type(stored_name).ok_or_else(|| {
        header.error(
            "type",
            format!("{stored_name:?}, expected an integer type, float or double"),
        )
    })?;
    let axes = Axes::parse(&header)?;
    let mut notices = Notices::default();
    let geometry = header.geometry(&axes, &mut notices)?;
    let samples = header.samples(&axes, &geometry, stored)?;
    let unit = header
        .get("sample units")
        .map(|u| u.trim_matches('"').to_owned())
        .filter(|u| !u.is_empty());
    let like = FieldHead {
        name: location.stem(),
        stored_type: stored_name.to_owned(),
        missing: header.missing()?,
        unit,
    };
    samples.check("sizes")?;
    let mut fields = axes.channels(&like.name).fields(&samples, axes.channel_distance, &like);
    for (layer, field) in fields.iter_mut().enumerate() {
        field.labels = header.segments(layer);
    }
    Ok(OpenedFile {
        geometry,
        steps: axes.steps,
        uneven: None,
        axes: None,
        times: header.times(&axes),
        fields,
        notices,
    })
}

fn stored_type(name: &str) -> Option<StoredType> {
    Some(match name.to_ascii_lowercase().as_str() {
        "signed char" | "int8" | "int8_t" => StoredType::I8,
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => StoredType::U8,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => StoredType::I16,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => StoredType::U16,
        "int" | "signed int" | "int32" | "int32_t" => StoredType::I32,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => StoredType::U32,
        "longlong"
        | "long long"
        | "long long int"
        | "signed long long"
        | "signed long long int"
        | "int64"
        | "int64_t" => StoredType::I64,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => StoredType::U64,
        "float" => StoredType::F32,
        "double" => StoredType::F64,
        _ => return None,
    })
}

struct Header<'a> {
    location: &'a FileLocation,
    fields: Vec<(String, String)>,
    pairs: Vec<(String, String)>,
    /// Offset of samples in the same file: after the empty line, or at the end of the bytes.
    data_offset: usize,
}

impl<'a> Header<'a> {
    fn parse(location: &'a FileLocation, bytes: &[u8]) -> Result<Self, ReadError> {
        let mut header = Header {
            location,
            fields: Vec::new(),
            pairs: Vec::new(),
            data_offset: bytes.len(),
        };
        let mut at = 0;
        for (number, line) in bytes.split_inclusive(|&b| b == b'\n').enumerate() {
            at += line.len();
            let line = line.strip_suffix(b"\n").unwrap_or(line);
            let line = line.strip_suffix(b"\r").unwrap_or(line);
            if number == 0 {
                // The first version used another magic word.
                if !matches!(
                    line,
                    b"NRRD00.01" | [b'N', b'R', b'R', b'D', b'0', b'0', b'0', b'1'..=b'5']
                ) {
                    return Err(header.error("magic", "expected NRRD0001 to NRRD0005 on the first line"));
                }
                continue;
            }
            if line.is_empty() {
                header.data_offset = at;
                break;
            }
            if header.get("data file").is_some_and(|file| file.starts_with("LIST")) {
                // Names of files follow, one a line, up to the end.
                break;
            }
            let line = String::from_utf8_lossy(line);
            if line.starts_with('#') {
            } else if let Some((key, value)) = line.split_once(":=") {
                header.pairs.push((key.trim().to_owned(), value.trim().to_owned()));
            } else if let Some((name, value)) = line.split_once(": ").or_else(|| line.split_once(':')) {
                let name = canonical(name);
                if header.get(&name).is_some() {
                    return Err(header.error(name, "given twice, expected once"));
                }
                header.fields.push((name, value.trim().to_owned()));
            } else {
                let shown: String = line.chars().take(40).collect();
                let why = format!(
                    "line {} is {shown:?}, expected `field: value` or `key:=value`",
                    number + 1
                );
                return Err(header.error("header", why));
            }
        }
        Ok(header)
    }

    fn error(&self, field: impl Into<String>, why: impl Into<String>) -> ReadError {
        ReadError::new(self.location.path(), field, why)
    }

    fn get(&self, name: &str) -> Option<&str> {
        self.fields.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_str())
    }

    fn required(&self, name: &str) -> Result<&str, ReadError> {
        self.get(name)
            .ok_or_else(|| self.error(name, "missing, expected in every NRRD header"))
    }

    fn number<T: std::str::FromStr>(&self, name: &str) -> Result<Option<T>, ReadError> {
        self.get(name)
            .map(|v| {
                v.parse()
                    .map_err(|_| self.error(name, format!("{v:?}, expected a whole number")))
            })
            .transpose()
    }

    /// Returns the value of a key.
    fn pair(&self, key: &str) -> Option<&str> {
        self.pairs
            .iter()
            .find(|(k, _)| k == key)
            .map(|(_, value)| value.as_str())
    }

    /// Whether the file is a segmentation of 3D Slicer, whose axis of kind `list` has layers.
    fn is_segmentation(&self) -> bool {
        self.pair("Segment0_ID").or(self.pair("Segment0_Name")).is_some()
    }

    /// Returns the segments of a layer.
    fn segments(&self, layer: usize) -> Vec<Label> {
        let value = |i: usize, name: &str| self.pair(&format!("Segment{i}_{name}"));
        let is_there = |i: &usize| value(*i, "ID").or(value(*i, "Name")).is_some();
        let segments = (0..MAX_LABELS).take_while(is_there).filter_map(|i| {
            // Files from before layers existed have one layer for each segment, with the value 1.
            let number = |name: &str| value(i, name).and_then(|text| text.parse::<i64>().ok());
            let own = number("Layer").map_or(i, |own| usize::try_from(own).unwrap_or(usize::MAX));
            let color = value(i, "Color").and_then(|text| {
                let channels: Vec<f64> = text.split_whitespace().map(str::parse).collect::<Result<_, _>>().ok()?;
                let channels: [f64; 3] = channels.try_into().ok()?;
                Some(channels.map(|channel| (255.0 * channel).round() as u8))
            });
            let name = value(i, "Name").or(value(i, "ID")).unwrap_or_default();
            (own == layer).then(|| Label::new(number("LabelValue").unwrap_or(1), name, color))
        });
        let mut labels: Vec<Label> = segments.collect();
        labels.sort_by_key(|label| label.value);
        labels
    }

    fn missing(&self) -> Result<Option<f32>, ReadError> {
        let names = ["missing value", "missing_value", "_FillValue"];
        let Some((key, value)) = self.pairs.iter().find(|(k, _)| names.contains(&k.as_str())) else {
            return Ok(None);
        };
        let value: f64 = value
            .parse()
            .map_err(|_| self.error(key, format!("{value:?}, expected a number")))?;
        Ok(Some(value as f32))
    }

    fn samples(&self, axes: &Axes, geometry: &Geometry, stored: StoredType) -> Result<StoredSamples, ReadError> {
        let encoding = match self.required("encoding")?.to_ascii_lowercase().as_str() {
            "raw" => Encoding::Raw,
            "gzip" | "gz" => Encoding::Deflate,
            "bzip2" | "bz2" => Encoding::Bzip2,
            "hex" => Encoding::Hex,
            "text" | "txt" | "ascii" => Encoding::Text,
            other => return Err(self.error("encoding", format!("{other:?}, expected raw, gzip, bzip2, hex or text"))),
        };
        let data = self.data_file()?;
        let detached = self.get("data file").is_some();
        let first = if detached { 0 } else { self.data_offset as u64 };
        let mut samples = StoredSamples::new(&data, Begin::At(first), stored, geometry, axes.steps, "sizes")?;
        samples.encoding = encoding;
        samples.strides = axes.strides;
        samples = samples.with_channels(axes.channel_count, "sizes")?;
        samples.endian = self.endian(stored, encoding)?;
        let lines: u64 = self.number("line skip")?.unwrap_or(0);
        if lines > 0 {
            samples.begin = Begin::At(self.skip_lines(&data, first, lines)?);
        }
        match self.number::<i64>("byte skip")? {
            None => {}
            Some(-1) if encoding == Encoding::Raw => samples.begin = Begin::BeforeEnd,
            Some(skip) => {
                samples.skip_decoded = u64::try_from(skip).map_err(|_| {
                    self.error(
                        "byte skip",
                        format!("{skip}, expected 0 or more, or -1 with encoding raw"),
                    )
                })?;
            }
        }
        Ok(samples)
    }

    /// Returns the file with the samples: this one, or the one that `data file` names.
    fn data_file(&self) -> Result<FileLocation, ReadError> {
        match self.get("data file") {
            None if self.data_offset == MAX_HEADER_BYTES => {
                let why = format!("no empty line within {MAX_HEADER_BYTES} bytes, expected one after the header");
                Err(self.error("header", why))
            }
            None => Ok(self.location.clone()),
            Some(name) => match self.location.sibling(name, "data file") {
                Err(_) if name.starts_with("LIST") || name.contains('%') => {
                    let why = format!(
                        "{name:?}: samples in many files, which are not read; expected one file, as `unu save -f nrrd -i IN.nhdr -o OUT.nrrd` \
                         writes it"
                    );
                    Err(self.error("data file", why))
                }
                file => file,
            },
        }
    }

    fn endian(&self, stored: StoredType, encoding: Encoding) -> Result<Endian, ReadError> {
        match self.get("endian").map(str::to_ascii_lowercase).as_deref() {
            Some("little") => Ok(Endian::Little),
            Some("big") => Ok(Endian::Big),
            None if stored.bytes() == 1 || encoding == Encoding::Text => Ok(Endian::Little),
            other => {
                let why = format!(
                    "{}, expected little or big",
                    other.map_or("missing".into(), |o| format!("{o:?}"))
                );
                Err(self.error("endian", why))
            }
        }
    }

    /// Returns the offset after `lines` line ends of the data file.
    fn skip_lines(&self, data: &FileLocation, first: u64, lines: u64) -> Result<u64, ReadError> {
        use std::io::BufRead;
        let blob = data.open()?;
        let mut reader = std::io::BufReader::new(blob.reader(first));
        let (mut at, mut left) = (first, lines);
        while left > 0 {
            let buffer = reader
                .fill_buf()
                .map_err(|e| ReadError::io(data.path(), "data", "cannot be read", e))?;
            if buffer.is_empty() {
                return Err(self.error("line skip", format!("{lines}, the data have {} lines", lines - left)));
            }
            let (used, ended) = match buffer.iter().position(|&b| b == b'\n') {
                Some(i) => (i + 1, 1),
                None => (buffer.len(), 0),
            };
            reader.consume(used);
            at += used as u64;
            left -= ended;
        }
        Ok(at)
    }

    fn geometry(&self, axes: &Axes, notices: &mut Notices) -> Result<Geometry, ReadError> {
        let path = self.location.path();
        let (spacing, direction) = if let Some(text) = self.get("space directions") {
            let all = vectors(text).ok_or_else(|| self.error("space directions", malformed(text)))?;
            let mut chosen = [[0.0; 3]; 3];
            for (out, &axis) in chosen.iter_mut().zip(&axes.space) {
                *out = match all.get(axis) {
                    Some(Some(v)) => three(path, "space directions", in_space(v))?,
                    _ => return Err(self.error("space directions", format!("no vector for axis {axis}, expected one"))),
                };
            }
            header::split_axes(chosen)
        } else if let Some(text) = self.get("spacings") {
            let all: Vec<f64> = numbers(path, "spacings", text, Some(axes.count))?;
            header::signed_distances(axes.space.map(|a| all[a]), Geometry::IDENTITY, notices)
        } else if let Some(distances) = self.axis_distances(axes) {
            header::signed_distances(distances, Geometry::IDENTITY, notices)
        } else {
            ([1.0; 3], Geometry::IDENTITY)
        };
        let origin = match self.get("space origin") {
            None => [0.0; 3],
            Some(text) => match vectors(text).as_deref() {
                Some([Some(v)]) => header::known_origin(three(path, "space origin", at_a_time(v))?, notices),
                _ => return Err(self.error("space origin", malformed(text))),
            },
        };
        let origin = match self.axis_mins(axes) {
            Some(mins) if self.get("space origin").is_none() && self.get("space directions").is_none() => mins,
            _ => origin,
        };
        let geometry = header::geometry(path, &FIELDS, axes.dims, spacing, origin, direction)?;
        Ok(self.framed(geometry, axes, notices))
    }

    /// Returns the numbers for the axes in space, from a field with one number for each axis.
    fn of_space(&self, field: &str, axes: &Axes) -> Option<[f64; 3]> {
        let words: Vec<&str> = self.get(field)?.split_whitespace().collect();
        let number = |axis: usize| words.get(axis)?.parse::<f64>().ok().filter(|number| number.is_finite());
        let [x, y, z] = axes.space.map(number);
        Some([x?, y?, z?])
    }

    /// Returns the positions of the first samples by `axis mins`. If samples are at the centres of cells, `axis mins` states the beginning
    /// of the first cell, and half a cell is added.
    fn axis_mins(&self, axes: &Axes) -> Option<[f64; 3]> {
        let mins = self.of_space("axis mins", axes)?;
        let half = self.half_cells(axes);
        let spacings = self.of_space("spacings", axes);
        let distances = spacings.or_else(|| self.axis_distances(axes)).unwrap_or([1.0; 3]);
        Some(std::array::from_fn(|axis| mins[axis] + half[axis] * distances[axis]))
    }

    /// Returns half a cell for each axis whose samples are at the centres of cells, 0 for other axes.
    fn half_cells(&self, axes: &Axes) -> [f64; 3] {
        let words: Vec<&str> = self
            .get("centers")
            .map_or_else(Vec::new, |text| text.split_whitespace().collect());
        axes.space
            .map(|axis| words.get(axis).is_some_and(|word| word.eq_ignore_ascii_case("cell")))
            .map(|is_cell| if is_cell { 0.5 } else { 0.0 })
    }

    /// Returns the distances of samples by `axis mins` and `axis maxs`.
    fn axis_distances(&self, axes: &Axes) -> Option<[f64; 3]> {
        let (mins, maxs) = (self.of_space("axis mins", axes)?, self.of_space("axis maxs", axes)?);
        let half = self.half_cells(axes);
        Some(std::array::from_fn(|axis| {
            let intervals = f64::from(axes.dims[axis]) - 1.0 + 2.0 * half[axis];
            (maxs[axis] - mins[axis]) / intervals
        }))
    }

    /// Returns the times of the steps, if the file states their distance: in `space directions` with four components, else in `spacings`
    /// with `axis mins` and `units`.
    fn times(&self, axes: &Axes) -> Option<TimeAxis> {
        let axis = axes.time?;
        // In a world with time, it is the last component of the vectors.
        let last = |text: &str, at: usize| match vectors(text)?.get(at) {
            Some(Some(vector)) if vector.len() == 4 => Some(vector[3]),
            _ => None,
        };
        if let Some(between) = self.get("space directions").and_then(|text| last(text, axis)) {
            let start = self.get("space origin").and_then(|text| last(text, 0)).unwrap_or(0.0);
            let unit = self.get("space units").and_then(|text| quoted(text).nth(3));
            return TimeAxis::even(start, between, axes.steps, unit.unwrap_or_default());
        }
        let number = |name: &str| -> Option<f64> { self.get(name)?.split_whitespace().nth(axis)?.parse().ok() };
        let unit = self
            .get("units")
            .and_then(|text| quoted(text).nth(axis))
            .unwrap_or_default();
        let start = number("axis mins").filter(|start| start.is_finite()).unwrap_or(0.0);
        TimeAxis::even(start, number("spacings")?, axes.steps, unit)
    }

    /// Returns the grid in the frame that `space` names. Lengths are in `space units`, or in `units` if there are none, provided that the
    /// units of the axes agree; else in millimetres if the frame is a patient's.
    fn framed(&self, mut geometry: Geometry, axes: &Axes, notices: &mut Notices) -> Geometry {
        let (frame, signs) = self
            .get("space")
            .map_or((Frame::World, [1.0; 3]), header::frame_of_space);
        for vector in geometry.direction.iter_mut().chain([&mut geometry.origin]) {
            *vector = std::array::from_fn(|i| 0.0 + vector[i] * signs[i]);
        }
        geometry.frame = frame;
        let of_space = self.get("space units").map(|text| quoted(text).take(3).collect());
        let of_axes = || {
            self.get("units")
                .map(|text| axes.space.iter().filter_map(|&a| quoted(text).nth(a)).collect())
        };
        let named: Option<Vec<&str>> = of_space.or_else(of_axes);
        let named = named.map(|units| named_units(units, notices));
        geometry.unit = match named.as_deref() {
            Some([first, rest @ ..]) if rest.iter().all(|unit| unit == first) => LengthUnit::parse(first),
            Some(units) if units.len() > 1 && frame == Frame::World => {
                notices.add(format!(
                    "the units of the axes differ: {}; distances are the numbers of the file, without a unit",
                    units.join(", ")
                ));
                None
            }
            _ => None,
        }
        .or(frame.is_anatomical().then_some(LengthUnit::Millimetre));
        geometry
    }
}

/// Returns the units of axes. Axes without a unit get that of the others if these agree, with a notice.
fn named_units<'a>(units: Vec<&'a str>, notices: &mut Notices) -> Vec<&'a str> {
    let is_named = |unit: &&str| !matches!(unit.trim(), "" | "???");
    let named: Vec<&str> = units.iter().copied().filter(is_named).collect();
    match named[..] {
        [first, ..] if named.len() < units.len() && named.iter().all(|unit| *unit == first) => {
            let without = units.len() - named.len();
            notices.add(format!(
                "{without} of {} axes have no unit: {first:?} was taken for all, as the others have it",
                units.len()
            ));
            named
        }
        _ => units,
    }
}

/// Returns the space components of an axis, in a world that may include time.
fn in_space(vector: &[f64]) -> &[f64] {
    match vector {
        [space @ .., 0.0] if space.len() == 3 => space,
        _ => vector,
    }
}

/// Returns the space components of a position, in a world that may include time.
fn at_a_time(place: &[f64]) -> &[f64] {
    match place {
        [space @ .., _] if space.len() == 3 => space,
        _ => place,
    }
}

fn malformed(text: &str) -> String {
    let shown: String = text.chars().take(60).collect();
    format!("{shown:?}, expected vectors like (1,0,0)")
}

/// Returns the words of a list such as `"mm" "mm" ""`.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.split('"').skip(1).step_by(2)
}

/// Returns a field name in the first spelling of the format's specification.
fn canonical(name: &str) -> String {
    match name.trim().to_ascii_lowercase().as_str() {
        "datafile" => "data file".into(),
        "lineskip" => "line skip".into(),
        "byteskip" => "byte skip".into(),
        "sampleunits" => "sample units".into(),
        "spaceunits" => "space units".into(),
        "axismins" => "axis mins".into(),
        "axismaxs" => "axis maxs".into(),
        "centerings" => "centers".into(),
        other => other.into(),
    }
}

/// Parses vectors such as `(1,0,0) none (0, 1, 0)`.
fn vectors(text: &str) -> Option<Vec<Option<Vec<f64>>>> {
    let mut out = Vec::new();
    let mut rest = text.trim_start();
    while !rest.is_empty() {
        if let Some(inner) = rest.strip_prefix('(') {
            let (inside, after) = inner.split_once(')')?;
            out.push(Some(
                inside
                    .split(',')
                    .map(|n| n.trim().parse().ok())
                    .collect::<Option<Vec<f64>>>()?,
            ));
            rest = after.trim_start();
        } else {
            rest = rest.strip_prefix("none")?.trim_start();
            out.push(None);
        }
    }
    Some(out)
}

/// The axes of the array by role: space, time and channels.
struct Axes {
    count: usize,
    space: [usize; 3],
    time: Option<usize>,
    dims: [u32; 3],
    steps: u32,
    strides: [u64; 4],
    /// The kind of the channels' axis, in lower case; empty if it has none.
    channel_kind: String,
    channel_count: u32,
    /// Samples between channels.
    channel_distance: u64,
}

impl Axes {
    fn parse(header: &Header<'_>) -> Result<Self, ReadError> {
        let path = header.location.path();
        let count: usize = header
            .number("dimension")?
            .ok_or_else(|| header.error("dimension", "missing"))?;
        if !(1..=16).contains(&count) {
            return Err(header.error("dimension", format!("{count}, expected 1 to 16")));
        }
        let sizes: Vec<u64> = numbers(path, "sizes", header.required("sizes")?, Some(count))?;
        let sizes = header::sizes(path, "sizes", &sizes)?;
        let Roles {
            space,
            time,
            channels,
            kinds,
        } = Roles::parse(header, &sizes)?;
        let space: [usize; 3] = space
            .as_slice()
            .try_into()
            .map_err(|_| not_3d(path, "dimension", format!("{} axes in space", space.len())))?;
        // `StoredSamples::new` refuses products above 64 bits, so a saturated stride is never used.
        let stride = |axis: usize| sizes[..axis].iter().fold(1u64, |p, &n| p.saturating_mul(u64::from(n)));
        let total = stride(count);
        Ok(Self {
            count,
            space,
            time,
            dims: space.map(|a| sizes[a]),
            steps: time.map_or(1, |t| sizes[t]),
            strides: [
                stride(space[0]),
                stride(space[1]),
                stride(space[2]),
                time.map_or(total, stride),
            ],
            channel_kind: channels.map_or_else(String::new, |c| kinds[c].clone()),
            channel_count: channels.map_or(1, |c| sizes[c]),
            channel_distance: channels.map_or(total, stride),
        })
    }

    /// Returns how the channels become fields.
    fn channels(&self, name: &str) -> Channels {
        let is_vector = ["vector", "normal", "gradient"]
            .iter()
            .any(|word| self.channel_kind.ends_with(word));
        match self.channel_kind.as_str() {
            "list" => match self.channel_count {
                1 => Channels::numbered(name, 1),
                n => Channels::named(name, &(1..=n).map(|n| format!("layer {n}")).collect::<Vec<_>>()),
            },
            "rgb-color" | "rgba-color" if self.channel_count >= 3 => Channels::Luminance,
            _ if is_vector => Channels::vector(name, self.channel_count),
            _ => Channels::numbered(name, self.channel_count),
        }
    }
}

/// Roles of the axes.
struct Roles {
    space: Vec<usize>,
    time: Option<usize>,
    channels: Option<usize>,
    /// Kind of every axis, in lower case.
    kinds: Vec<String>,
}

impl Roles {
    fn parse(header: &Header<'_>, sizes: &[u32]) -> Result<Self, ReadError> {
        let count = sizes.len();
        let kinds: Vec<String> = match header.get("kinds") {
            Some(text) => text.split_whitespace().map(str::to_ascii_lowercase).collect(),
            None => vec!["???".to_owned(); count],
        };
        if kinds.len() != count {
            return Err(header.error("kinds", format!("{} kinds, expected {count}", kinds.len())));
        }
        let directions = header.get("space directions").and_then(vectors);
        let of_kind = |kind: &str| kinds.iter().position(|k| k == kind);
        let time = match header.is_segmentation() {
            true => None,
            false => of_kind("time").or_else(|| of_kind("list")),
        };
        let mut roles = Self {
            space: Vec::new(),
            time,
            channels: None,
            kinds,
        };
        for (axis, &size) in sizes.iter().enumerate() {
            let in_space = directions.as_ref().and_then(|d| d.get(axis)).map(Option::is_some);
            match roles.kinds[axis].as_str() {
                _ if roles.time == Some(axis) => {}
                "domain" | "space" => roles.space.push(axis),
                "???" | "none" if in_space == Some(true) || (in_space.is_none() && count == 3) => {
                    roles.space.push(axis);
                }
                _ if size == 1 => {}
                "???" | "none" if count == 4 => {
                    let why =
                        format!("axis {axis} of 4 may be time or components, expected `kinds` to tell (domain, time)");
                    return Err(header.error("kinds", why));
                }
                "???" | "none" => return Err(not_3d(header.location.path(), "dimension", count)),
                kind if roles.channels.is_some() || u64::from(size) > MAX_CHANNELS => {
                    let why = format!(
                        "{kind:?} along axis {axis}: {size} components a sample, \
                         expected one axis of {MAX_CHANNELS} at most"
                    );
                    return Err(header.error("kinds", why));
                }
                _ => roles.channels = Some(axis),
            }
        }
        Ok(roles)
    }
}
