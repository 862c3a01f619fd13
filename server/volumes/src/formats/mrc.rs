//! MRC and CCP4 maps (MRC2014, <https://www.ccpem.ac.uk/mrc_format/mrc2014.php>): `.mrc`, `.map`, `.ccp4`.
//!
//! Read: modes 0, 1, 2, 6 and 12; both byte orders, by the machine stamp; columns, rows and sections along any axes; an extended
//! header, which is skipped; oblique cells; stacks of volumes, which become time steps. Lengths are in ångström. Refused with the
//! reason: complex and 4-bit modes. Repaired with a notice: unusual machine stamps, headers of before 2000, which have no `MAP`, types without
//! sign that the mode does not say, cells without all lengths.

use std::path::Path;

use super::super::stored::{Begin, Endian, StoredSamples, StoredType};
use super::super::{FileLocation, Geometry, LengthUnit, Notices, OpenedFile, ReadError};
use super::header::{self, Channels, FieldHead, GridFields};

/// Bytes of the header. The extended one follows it.
const HEADER_BYTES: usize = 1024;
/// Offset of the word `MAP`.
const MAP_AT: usize = 208;
/// IMOD's stamp. If a header has it, the next word holds IMOD's flags.
const IMOD_STAMP: i32 = 1_146_047_817;
/// IMOD's sign that bytes have a sign; without it they have none.
const IMOD_SIGNED_BYTES: i32 = 1;
/// Space groups whose sections are those of several volumes.
const STACKS: std::ops::RangeInclusive<i32> = 401..=630;

const GRID_FIELDS: GridFields = GridFields {
    dims: "NX, NY, NZ",
    spacing: "CELLA, MX, MY, MZ",
    origin: "ORIGIN",
    direction: "CELLB",
};

/// Whether a file with such a name holds a map: other files have most of these names, too.
pub fn is_volume(location: &FileLocation) -> bool {
    let name = location.stored_name();
    let is_usual = [".mrc", ".mrcs", ".ccp4"].iter().any(|end| name.ends_with(end));
    is_usual || location.begins_as(is_map)
}

/// Whether a header has the word `MAP`.
pub fn is_map(head: &[u8]) -> bool {
    matches!(head.get(MAP_AT..MAP_AT + 4), Some(b"MAP " | b"MAP\0"))
}

/// Reads the header of a map.
///
/// # Errors
/// What is wrong with it, by field.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let path = location.path();
    let head = location.open()?.head(HEADER_BYTES)?;
    let mut notices = Notices::default();
    let header = Header::parse(path, &head, &mut notices)?;
    let (stored, stored_type) = header.stored_type(path, &mut notices)?;
    let layout = header.layout(path)?;
    let geometry = header.geometry(path, layout.dims, layout.axes, &mut notices)?;
    let begin = Begin::At(HEADER_BYTES as u64 + header.extended_bytes(path)?);
    let mut samples = StoredSamples::new(location, begin, stored, &geometry, layout.steps, GRID_FIELDS.dims)?;
    samples.endian = header.endian;
    let [columns, rows, sections] = layout.axes;
    samples.strides[columns] = 1;
    samples.strides[rows] = u64::from(layout.dims[columns]);
    samples.strides[sections] = u64::from(layout.dims[columns]) * u64::from(layout.dims[rows]);
    samples.check(GRID_FIELDS.dims)?;
    let like = FieldHead {
        name: location.stem(),
        stored_type: stored_type.to_owned(),
        missing: None,
        unit: None,
    };
    Ok(OpenedFile {
        geometry,
        steps: layout.steps,
        uneven: None,
        axes: None,
        times: None,
        fields: Channels::numbered(&like.name, 1).fields(&samples, 0, &like),
        notices,
    })
}

/// The values of a header that are read.
struct Header {
    endian: Endian,
    /// Columns, rows, sections.
    counts: [i32; 3],
    mode: i32,
    /// Indices of the first column, row and section.
    starts: [i32; 3],
    /// Intervals along the cell's x, y, z.
    intervals: [i32; 3],
    cell_lengths: [f64; 3],
    cell_angles: [f64; 3],
    /// Axes of columns, rows and sections, from 1.
    axes: [i32; 3],
    space_group: i32,
    extended_bytes: i32,
    origin: [f64; 3],
    /// Minimum and maximum, if the header states them.
    range: Option<[f64; 2]>,
    imod_flags: Option<i32>,
}

/// Returns the byte order: that of the machine stamp, if it is a known one and the header is valid in that order; else the order in which
/// the header is valid.
fn endian(path: &Path, head: &[u8], notices: &mut Notices) -> Result<Endian, ReadError> {
    let [a, b] = [head[212], head[213]];
    let stamped = match (a, b) {
        (0x44, _) => Some(Endian::Little),
        (0x11, _) => Some(Endian::Big),
        _ => None,
    };
    let orders = [Endian::Little, Endian::Big].into_iter();
    let sensible: Vec<Endian> = orders.filter(|&endian| makes_sense(head, endian)).collect();
    let is_usual = matches!((a, b), (0x44, 0x41 | 0x44) | (0x11, 0x11));
    let is_named = is_map(head);
    if !is_named {
        let found = String::from_utf8_lossy(&head[MAP_AT..MAP_AT + 4]).into_owned();
        if sensible.is_empty() {
            let why = format!("{found:?}, expected \"MAP \": this is no MRC or CCP4 map, or its header is damaged");
            return Err(ReadError::new(path, "MAP", why));
        }
        notices.add("the word MAP is missing, as in headers of before 2000: the header is read as one of today");
    }
    let endian = match (stamped, sensible.as_slice()) {
        (Some(endian), _) if is_usual && sensible.is_empty() => return Ok(endian),
        (Some(endian), sensible) if sensible.contains(&endian) => endian,
        (_, &[endian]) => endian,
        _ => {
            let why = format!(
                "{a:#04x} {b:#04x}, expected 0x44 0x44 or 0x44 0x41 (little-endian), 0x11 0x11 (big-endian), or a header that makes sense in one \
                 byte order alone"
            );
            return Err(ReadError::new(path, "MACHST", why));
        }
    };
    if is_named && (!is_usual || stamped != Some(endian)) {
        let name = if endian == Endian::Little { "little" } else { "big" };
        notices.add(format!(
            "the machine stamp {a:#04x} {b:#04x} is none of the standard's: the file is read as {name}-endian, in which its header makes sense"
        ));
    }
    Ok(endian)
}

/// Whether mode, counts and axes are valid in this byte order.
fn makes_sense(head: &[u8], endian: Endian) -> bool {
    let word = |number: usize| {
        let bytes: [u8; 4] = std::array::from_fn(|i| head[4 * number + i]);
        match endian {
            Endian::Little => i32::from_le_bytes(bytes),
            Endian::Big => i32::from_be_bytes(bytes),
        }
    };
    let counts = (0..3).all(|i| (1..1 << 24).contains(&word(i)));
    let axes = [word(16), word(17), word(18)];
    let mut sorted = axes;
    sorted.sort_unstable();
    counts && matches!(word(3), 0..=4 | 6 | 12 | 101) && (axes == [0; 3] || sorted == [1, 2, 3])
}

/// Layout of the samples in the file.
struct Layout {
    /// Along x, y, z.
    dims: [u32; 3],
    steps: u32,
    /// Axes of columns, rows and sections, from 0.
    axes: [usize; 3],
}

impl Header {
    fn parse(path: &Path, head: &[u8], notices: &mut Notices) -> Result<Self, ReadError> {
        if head.len() < HEADER_BYTES {
            let why = format!("{} bytes, expected {HEADER_BYTES}", head.len());
            return Err(ReadError::new(path, "header", why));
        }
        let endian = endian(path, head, notices)?;
        let word = |number: usize| {
            let bytes: [u8; 4] = std::array::from_fn(|i| head[4 * number + i]);
            match endian {
                Endian::Little => i32::from_le_bytes(bytes),
                Endian::Big => i32::from_be_bytes(bytes),
            }
        };
        // Words are numbered from 0 here, from 1 in the specification.
        let words = |first: usize| std::array::from_fn(|i| word(first + i));
        let floats = |first: usize| words(first).map(|bits: i32| f64::from(f32::from_bits(bits.cast_unsigned())));
        Ok(Self {
            endian,
            counts: words(0),
            mode: word(3),
            starts: words(4),
            intervals: words(7),
            cell_lengths: floats(10),
            cell_angles: floats(13),
            axes: words(16),
            space_group: word(22),
            extended_bytes: word(23),
            origin: floats(49),
            range: Some(floats(19))
                .filter(|[low, high, _]| low < high)
                .map(|[low, high, _]| [low, high]),
            imod_flags: (word(38) == IMOD_STAMP).then(|| word(39)),
        })
    }

    fn stored_type(&self, path: &Path, notices: &mut Notices) -> Result<(StoredType, &'static str), ReadError> {
        // Older programs write unsigned bytes and state so only in the statistics.
        let exceeds = |largest: f64| self.range.filter(|&[low, high]| low >= 0.0 && high > largest);
        let mut unsigned = |exceeded: Option<[f64; 2]>, kind: (StoredType, &'static str)| {
            if let Some([low, high]) = exceeded {
                notices.add(format!(
                    "samples are read as {}, as DMIN and DMAX are {low} and {high}; the mode says a type with sign",
                    kind.1
                ));
            }
            kind
        };
        let imod_signed = self.imod_flags.map(|flags| flags & IMOD_SIGNED_BYTES != 0);
        Ok(match self.mode {
            0 if imod_signed == Some(false) => (StoredType::U8, "mode 0, uint8"),
            0 if imod_signed.is_none() && exceeds(127.0).is_some() => {
                unsigned(exceeds(127.0), (StoredType::U8, "mode 0, uint8"))
            }
            0 => (StoredType::I8, "mode 0, int8"),
            1 if exceeds(32767.0).is_some() => unsigned(exceeds(32767.0), (StoredType::U16, "mode 1, uint16")),
            1 => (StoredType::I16, "mode 1, int16"),
            2 => (StoredType::F32, "mode 2, float32"),
            6 => (StoredType::U16, "mode 6, uint16"),
            12 => (StoredType::F16, "mode 12, float16"),
            other => {
                let what = match other {
                    3 | 4 => " (complex)",
                    101 => " (4 bits)",
                    _ => "",
                };
                let why =
                    format!("{other}{what}, expected 0 (int8), 1 (int16), 2 (float32), 6 (uint16) or 12 (float16)");
                return Err(ReadError::new(path, "MODE", why));
            }
        })
    }

    fn layout(&self, path: &Path) -> Result<Layout, ReadError> {
        let fail = |field: &str, why: String| Err(ReadError::new(path, field, why));
        let axes = match self.axes {
            // Some programs write zeros instead of the usual order.
            [0, 0, 0] => [0, 1, 2],
            axes => {
                let mut sorted = axes;
                sorted.sort_unstable();
                if sorted != [1, 2, 3] {
                    return fail(
                        "MAPC, MAPR, MAPS",
                        format!("{axes:?}, expected 1, 2 and 3 in some order"),
                    );
                }
                axes.map(|axis| axis as usize - 1)
            }
        };
        let mut counts = [0; 3];
        for (i, (&n, name)) in self.counts.iter().zip(["NX", "NY", "NZ"]).enumerate() {
            match u32::try_from(n) {
                Ok(n) if n > 0 => counts[i] = n,
                _ => return fail(name, format!("{n}, expected at least 1")),
            }
        }
        let steps = self.volumes(path, counts[2], axes[2])?;
        counts[2] /= steps;
        let mut dims = [0; 3];
        for (axis, n) in axes.into_iter().zip(counts) {
            dims[axis] = n;
        }
        Ok(Layout { dims, steps, axes })
    }

    /// Returns the number of volumes among the sections.
    fn volumes(&self, path: &Path, sections: u32, axis: usize) -> Result<u32, ReadError> {
        if !STACKS.contains(&self.space_group) {
            return Ok(1);
        }
        let of_each = self.intervals[axis];
        match u32::try_from(of_each) {
            Ok(n) if n > 0 && sections.is_multiple_of(n) => Ok(sections / n),
            _ => {
                let name = ["MX", "MY", "MZ"][axis];
                let why = format!(
                    "{of_each} sections of each volume, expected a divisor of the {sections} of all: ISPG {} says a stack of volumes",
                    self.space_group
                );
                Err(ReadError::new(path, name, why))
            }
        }
    }

    fn extended_bytes(&self, path: &Path) -> Result<u64, ReadError> {
        u64::try_from(self.extended_bytes).map_err(|_| {
            let why = format!(
                "{}, expected the bytes of the extended header, 0 or more",
                self.extended_bytes
            );
            ReadError::new(path, "NSYMBT", why)
        })
    }

    fn geometry(
        &self,
        path: &Path,
        dims: [u32; 3],
        axes: [usize; 3],
        notices: &mut Notices,
    ) -> Result<Geometry, ReadError> {
        // Images of unknown scale have cells without lengths.
        let has_lengths = self.cell_lengths != [0.0; 3];
        let spacing = if has_lengths {
            self.spacing(path, dims, notices)?
        } else {
            [1.0; 3]
        };
        let direction = self.direction(path)?;
        let mut starts = [0.0; 3];
        for (axis, start) in axes.into_iter().zip(self.starts) {
            starts[axis] = f64::from(start);
        }
        let origin = if self.origin == [0.0; 3] {
            std::array::from_fn(|row| {
                (0..3)
                    .map(|axis| starts[axis] * spacing[axis] * direction[axis][row])
                    .sum()
            })
        } else {
            self.origin
        };
        let geometry = header::geometry(path, &GRID_FIELDS, dims, spacing, origin, direction)?;
        Ok(Geometry {
            unit: has_lengths.then_some(LengthUnit::Angstrom),
            ..geometry
        })
    }

    /// Returns the lengths of the cell divided by its intervals. An axis without either gets the distance of another one, with a notice.
    fn spacing(&self, path: &Path, dims: [u32; 3], notices: &mut Notices) -> Result<[f64; 3], ReadError> {
        if self
            .cell_lengths
            .iter()
            .any(|&length| !length.is_finite() || length < 0.0)
        {
            let why = format!("{:?}, expected three lengths of 0 or more", self.cell_lengths);
            return Err(ReadError::new(path, "CELLA", why));
        }
        let along = |axis: usize| {
            let intervals = match self.intervals[axis] {
                n if n > 0 => f64::from(n),
                _ => f64::from(dims[axis]),
            };
            // Lengths are in single precision, so the quotient is, too.
            Some(self.cell_lengths[axis] / intervals).filter(|&size| size > 0.0)
        };
        let known = [0, 1, 2].map(along);
        let other = known.into_iter().flatten().next().unwrap_or(1.0);
        for (axis, name) in ["X", "Y", "Z"].into_iter().enumerate() {
            if self.intervals[axis] <= 0 {
                notices.add(format!(
                    "M{name} is {}: {} intervals are assumed, the samples there are",
                    self.intervals[axis], dims[axis]
                ));
            }
            if known[axis].is_none() {
                notices.add(format!(
                    "CELLA has no length along {name}: samples are taken to be {other} Å apart, as along another axis"
                ));
            }
        }
        Ok(known.map(|size| size.unwrap_or(other)))
    }

    /// Returns the directions of the cell's axes: x along the world's x, y in the plane of the world's x and y.
    fn direction(&self, path: &Path) -> Result<[[f64; 3]; 3], ReadError> {
        let angles = self.cell_angles;
        if angles == [0.0; 3] || angles == [90.0; 3] {
            return Ok(Geometry::IDENTITY);
        }
        let fail = || {
            let why = format!("{angles:?} degrees, expected angles of a cell, each above 0 and below 180");
            ReadError::new(path, GRID_FIELDS.direction, why)
        };
        if angles.iter().any(|&angle| !(angle > 0.0 && angle < 180.0)) {
            return Err(fail());
        }
        // The cosine of 90 degrees is 0, not 6e-17.
        let cosine = |angle: f64| if angle == 90.0 { 0.0 } else { angle.to_radians().cos() };
        let [alpha, beta, gamma] = angles.map(cosine);
        let sine = (1.0 - gamma * gamma).sqrt();
        let y = (alpha - beta * gamma) / sine;
        let height = 1.0 - beta * beta - y * y;
        if height.is_nan() || height <= 0.0 {
            return Err(fail());
        }
        Ok([[1.0, 0.0, 0.0], [gamma, sine, 0.0], [beta, y, height.sqrt()]])
    }
}
