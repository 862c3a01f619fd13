//! A plane of samples with its place in the world: NRRD, and NIfTI-1 with one sample across the plane.

use isopeel_geometry::DVec3;
use isopeel_kernels::SampleType;
use isopeel_volumes::{Frame, LengthUnit};

use isopeel_extraction::Slice;

/// Bytes of a NIfTI-1 header.
const HEADER_BYTES: usize = 348;

/// Offset of the samples in a NIfTI-1 file: the header, and four bytes that state that no extension follows.
const SAMPLES_OFFSET: usize = HEADER_BYTES + 4;

/// A plane with evenly spaced samples.
pub(super) struct PlacedPlane {
    /// Samples along the two axes of the plane.
    pub dims: [u32; 2],
    /// World vectors from a sample to the next one: along the first and second axis of the plane, and across the plane. Last, the world
    /// position of the first sample.
    pub columns: [DVec3; 4],
    pub frame: Frame,
    pub unit: Option<LengthUnit>,
    pub title: String,
}

/// Returns a plane as an NRRD file.
pub(super) fn nrrd(plane: &PlacedPlane, slice: &Slice) -> Vec<u8> {
    let text = |vector: DVec3| format!("({},{},{})", vector[0], vector[1], vector[2]);
    let space = match plane.frame {
        Frame::Lps => "space: left-posterior-superior",
        Frame::Ras => "space: right-anterior-superior",
        Frame::World | Frame::Index => "space dimension: 3",
    };
    let kind = match slice.sample_type {
        SampleType::U8 => "uint8",
        SampleType::I8 => "int8",
        SampleType::U16 => "uint16",
        SampleType::I16 => "int16",
        SampleType::F32 => "float",
    };
    let [along, across, _, origin] = plane.columns.map(text);
    let unit = plane.unit.map_or(String::new(), |unit| {
        let unit = unit.ascii_symbol();
        format!("space units: \"{unit}\" \"{unit}\" \"{unit}\"\n")
    });
    let mut file = format!(
        "NRRD0005\n# {}\ntype: {kind}\ndimension: 2\n{space}\nsizes: {} {}\nspace directions: {along} {across}\n\
         space origin: {origin}\n{unit}endian: little\nencoding: raw\n\n",
        isopeel_mesh::mesh::ascii(&plane.title),
        plane.dims[0],
        plane.dims[1],
    )
    .into_bytes();
    file.extend_from_slice(&slice.bytes);
    file
}

/// Returns a plane as a NIfTI-1 file. Offsets of the header's fields are those of `nifti1.h`.
pub(super) fn nifti(plane: &PlacedPlane, slice: &Slice) -> Vec<u8> {
    let mut file = vec![0; SAMPLES_OFFSET];
    let mut write_at = |offset: usize, bytes: &[u8]| file[offset..offset + bytes.len()].copy_from_slice(bytes);
    write_at(0, &(HEADER_BYTES as i32).to_le_bytes());
    let dims = [3, plane.dims[0], plane.dims[1], 1, 1, 1, 1, 1];
    for (i, n) in dims.into_iter().enumerate() {
        // `Plane::check` refuses more than 32,767 samples along an axis.
        write_at(40 + 2 * i, &(n as i16).to_le_bytes());
    }
    let (code, bits): (i16, i16) = match slice.sample_type {
        SampleType::U8 => (2, 8),
        SampleType::I16 => (4, 16),
        SampleType::F32 => (16, 32),
        SampleType::I8 => (256, 8),
        SampleType::U16 => (512, 16),
    };
    write_at(70, &code.to_le_bytes());
    write_at(72, &bits.to_le_bytes());
    let (scale, unit) = unit(plane.unit);
    let columns = plane.columns.map(|column| column * scale);
    write_at(76, &1f32.to_le_bytes());
    for (i, column) in columns[..3].iter().enumerate() {
        write_at(80 + 4 * i, &(column.length() as f32).to_le_bytes());
    }
    write_at(108, &(SAMPLES_OFFSET as f32).to_le_bytes());
    write_at(112, &1f32.to_le_bytes());
    write_at(123, &[unit]);
    let title = isopeel_mesh::mesh::ascii(&plane.title);
    write_at(148, &title.as_bytes()[..title.len().min(79)]);
    // Code of the coordinates: the scanner's anatomy, or aligned to something else.
    let is_patient = matches!(plane.frame, Frame::Lps | Frame::Ras);
    write_at(254, &(if is_patient { 1i16 } else { 2 }).to_le_bytes());
    let flip = if plane.frame == Frame::Lps {
        [-1.0, -1.0, 1.0]
    } else {
        [1.0; 3]
    };
    for (row, flip) in flip.into_iter().enumerate() {
        for (i, column) in columns.iter().enumerate() {
            write_at(280 + 16 * row + 4 * i, &((flip * column[row]) as f32).to_le_bytes());
        }
    }
    write_at(344, b"n+1\0");
    file.extend_from_slice(&slice.bytes);
    file
}

/// Returns a factor for positions, and the code of the unit after multiplication. NIfTI-1 has codes for metres, millimetres and
/// micrometres; other units are converted to millimetres.
fn unit(unit: Option<LengthUnit>) -> (f64, u8) {
    match (unit, unit.and_then(LengthUnit::metres)) {
        (Some(LengthUnit::Metre), _) => (1.0, 1),
        (Some(LengthUnit::Micrometre), _) => (1.0, 3),
        (_, Some(metres)) => (metres * 1e3, 2),
        (_, None) => (1.0, 0),
    }
}
