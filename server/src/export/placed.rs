//! A plane of samples with its place in the world: NRRD, and NIfTI-1 with one sample across the plane.

use isopeel_geometry::DVec3;
use isopeel_kernels::SampleType;
use isopeel_volumes::{Frame, LengthUnit};

use isopeel_extraction::Slice;

/// Bytes of the header.
const HEADER: usize = 348;

/// Offset of the samples in the file. The header comes first, then the four bytes that state that no extension follows.
const SAMPLES: usize = HEADER + 4;

/// A plane on even axes.
pub(super) struct PlacedPlane {
    /// Samples along its axes.
    pub dims: [u32; 2],
    /// In the world: one step along each of its axes, one step across it, and the position of the first sample.
    pub columns: [DVec3; 4],
    pub frame: Frame,
    pub unit: Option<LengthUnit>,
    /// Title, for people.
    pub title: String,
}

/// The NRRD of a plane.
pub(super) fn nrrd(plane: &PlacedPlane, slice: &Slice) -> Vec<u8> {
    let vector = |at: DVec3| format!("({},{},{})", at[0], at[1], at[2]);
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
    let [along, across, _, origin] = plane.columns.map(vector);
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

/// The NIfTI file of a plane.
pub(super) fn nifti(plane: &PlacedPlane, slice: &Slice) -> Vec<u8> {
    let mut file = vec![0; SAMPLES];
    let mut put = |at: usize, bytes: &[u8]| file[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &(HEADER as i32).to_le_bytes());
    let dims = [3, plane.dims[0], plane.dims[1], 1, 1, 1, 1, 1];
    for (i, n) in dims.into_iter().enumerate() {
        // Fits: more than 32767 samples were refused before.
        put(40 + 2 * i, &(n as i16).to_le_bytes());
    }
    let (code, bits): (i16, i16) = match slice.sample_type {
        SampleType::U8 => (2, 8),
        SampleType::I16 => (4, 16),
        SampleType::F32 => (16, 32),
        SampleType::I8 => (256, 8),
        SampleType::U16 => (512, 16),
    };
    put(70, &code.to_le_bytes());
    put(72, &bits.to_le_bytes());
    let (scale, unit) = unit(plane.unit);
    let columns = plane.columns.map(|column| column * scale);
    put(76, &1f32.to_le_bytes());
    for (i, column) in columns[..3].iter().enumerate() {
        put(80 + 4 * i, &(column.length() as f32).to_le_bytes());
    }
    put(108, &(SAMPLES as f32).to_le_bytes());
    put(112, &1f32.to_le_bytes());
    put(123, &[unit]);
    let title = isopeel_mesh::mesh::ascii(&plane.title);
    put(148, &title.as_bytes()[..title.len().min(79)]);
    // Code of the coordinates: the scanner's anatomy, or aligned to something else.
    let is_patient = matches!(plane.frame, Frame::Lps | Frame::Ras);
    put(254, &(if is_patient { 1i16 } else { 2 }).to_le_bytes());
    let flip = if plane.frame == Frame::Lps {
        [-1.0, -1.0, 1.0]
    } else {
        [1.0; 3]
    };
    for (row, flip) in flip.into_iter().enumerate() {
        for (i, column) in columns.iter().enumerate() {
            put(280 + 16 * row + 4 * i, &((flip * column[row]) as f32).to_le_bytes());
        }
    }
    put(344, b"n+1\0");
    file.extend_from_slice(&slice.bytes);
    file
}

/// Returns the factor of positions, and the code of their unit: the format has metres, millimetres and micrometres.
fn unit(unit: Option<LengthUnit>) -> (f64, u8) {
    match (unit, unit.and_then(LengthUnit::metres)) {
        (Some(LengthUnit::Metre), _) => (1.0, 1),
        (Some(LengthUnit::Micrometre), _) => (1.0, 3),
        (_, Some(metres)) => (metres * 1e3, 2),
        (_, None) => (1.0, 0),
    }
}
