//! Planes of samples and their contours as files: raw samples, pictures, NRRD, NIfTI, SVG and GeoJSON.

use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::path::Path;

use clap::ValueEnum;
use flate2::Compression;
use flate2::write::GzEncoder;
use isopeel_extraction::{Slice, WorkError};
use isopeel_geometry::{DVec3, IndexSpace};
use isopeel_mesh::xml::escaped;
use isopeel_view::FeatureName;
use isopeel_volumes::{Field, Frame, LengthUnit, VolumeStep};
use serde::{Deserialize, Serialize};
use serde_json::json;
use utoipa::ToSchema;

use super::contours::{Contour, contours};
use super::picture::{Picture, samples_of};
use super::placed::{PlacedPlane, nifti, nrrd};
use crate::service::DeviceWorker;

/// Maximum number of isovalues in one file.
pub const MAX_ISOVALUES: usize = 64;

/// Colours of contours, in the order of isovalues: the dark colours of Tango.
const COLORS: [&str; 6] = ["#a40000", "#204a87", "#4e9a06", "#ce5c00", "#5c3566", "#8f5902"];

/// Axis that is perpendicular to a plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, ToSchema, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Axis {
    /// First.
    X,
    /// Second.
    Y,
    /// Third.
    Z,
}

impl Axis {
    /// Returns the axes of a plane across this axis: along its rows, and along its columns.
    pub const fn others(self) -> [Self; 2] {
        match self {
            Self::X => [Self::Y, Self::Z],
            Self::Y => [Self::X, Self::Z],
            Self::Z => [Self::X, Self::Y],
        }
    }

    /// Returns the name: `x`, `y` or `z`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
        }
    }
}

/// File format of a slice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, ToSchema, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum SliceFormat {
    /// The samples, little-endian.
    #[default]
    Raw,
    /// A grey picture.
    Png,
    /// The samples with their place in the world: NRRD, two axes in three dimensions.
    Nrrd,
    /// The samples with their place in the world: NIfTI-1, one sample across the plane.
    Nii,
    /// The same, compressed by gzip.
    #[serde(rename = "nii.gz")]
    #[value(name = "nii.gz")]
    NiiGz,
    /// Contours at isovalues, in the plane's own coordinates.
    Svg,
    /// Contours at isovalues, in the world's coordinates.
    Geojson,
}

impl SliceFormat {
    /// Returns the format that a file's name implies.
    pub fn from_path(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?.to_ascii_lowercase();
        let formats = Self::value_variants().iter().copied();
        let mut named = formats.filter_map(|format| Some((format, format.to_possible_value()?)));
        named
            .find(|(_, value)| name.ends_with(&format!(".{}", value.get_name())))
            .map(|(format, _)| format)
    }

    /// Media type for HTTP.
    pub const fn content_type(self) -> &'static str {
        match self {
            Self::Raw | Self::Nrrd | Self::Nii | Self::NiiGz => "application/octet-stream",
            Self::Png => "image/png",
            Self::Svg => "image/svg+xml",
            Self::Geojson => "application/geo+json",
        }
    }

    const fn is_nifti(self) -> bool {
        matches!(self, Self::Nii | Self::NiiGz)
    }

    /// Whether files of this format hold contours instead of samples.
    pub const fn has_contours(self) -> bool {
        matches!(self, Self::Svg | Self::Geojson)
    }
}

/// How a slice is shown.
#[derive(Clone, Debug, PartialEq)]
pub struct SliceOptions {
    /// File format.
    pub format: SliceFormat,
    /// Isovalues of contours.
    pub isovalues: Vec<f32>,
    /// For a picture: the difference between the values of white and black, in units of the field; `None`: the field's range.
    pub window: Option<f32>,
    /// For a picture: the value of middle grey; `None`: the middle of the field's range.
    pub level: Option<f32>,
}

/// Why a slice is refused, as a message for users.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct BadSlice(String);

/// The plane of a slice: its field, and its position in the volume.
#[derive(Clone, Debug)]
pub struct Plane {
    /// Field whose samples are shown.
    pub field: Field,
    /// Axis that is perpendicular to the plane.
    pub axis: Axis,
    /// Index of the plane along `axis`.
    pub index: u32,
    /// Samples in each row, and number of rows.
    pub dims: [u32; 2],
    volume: String,
    space: IndexSpace,
    frame: Frame,
    unit: Option<LengthUnit>,
}

impl Plane {
    /// Returns the plane of a field across an axis.
    ///
    /// # Errors
    /// The volume has no such plane.
    pub fn new(volume: &VolumeStep, field: Field, axis: Axis, index: u32) -> Result<Self, BadSlice> {
        let dataset = volume.dataset();
        let dims = dataset.geometry.dims;
        let planes = dims[axis as usize];
        if index >= planes {
            return Err(BadSlice(format!("index: {index}, expected 0 to {}", planes - 1)));
        }
        Ok(Self {
            field,
            axis,
            index,
            dims: axis.others().map(|axis| dims[axis as usize]),
            volume: dataset.id.clone(),
            space: dataset.sample_space(),
            frame: dataset.geometry.frame,
            unit: dataset.geometry.unit,
        })
    }

    /// Checks the options of a slice.
    ///
    /// # Errors
    /// Options that the format requires or does not have, numbers out of their range, or a plane that the format cannot hold.
    pub fn check(&self, options: &SliceOptions) -> Result<(), BadSlice> {
        let refuse = |message: String| Err(BadSlice(message));
        let SliceOptions {
            format,
            isovalues,
            window,
            level,
        } = options;
        if *format != SliceFormat::Png && (window.is_some() || level.is_some()) {
            return refuse("window and level are of pictures, expected format=png beside them".into());
        }
        if format.has_contours() == isovalues.is_empty() {
            return refuse(
                "iso: isovalues are of contours, expected some with format svg or geojson, and none with others".into(),
            );
        }
        if isovalues.len() > MAX_ISOVALUES {
            return refuse(format!(
                "iso: {} isovalues, expected at most {MAX_ISOVALUES}",
                isovalues.len()
            ));
        }
        if let Some(iso) = isovalues.iter().find(|iso| !iso.is_finite()) {
            return refuse(format!("iso: {iso}, expected a finite number"));
        }
        let is_placed = format.is_nifti() || *format == SliceFormat::Nrrd;
        if is_placed && self.space.uneven.is_some() {
            return refuse("format: NRRD and NIfTI hold samples at even distances, and the volume's axes are uneven: expected another format".into());
        }
        if format.is_nifti() && self.dims.iter().any(|&n| n > i16::MAX as u32) {
            return refuse(format!(
                "format: NIfTI holds {} samples along an axis, and the plane has {:?}: expected nrrd",
                i16::MAX,
                self.dims
            ));
        }
        match (window, level) {
            (Some(window), _) if !(window.is_finite() && *window > 0.0) => {
                refuse(format!("window: {window}, expected a finite number above 0"))
            }
            (_, Some(level)) if !level.is_finite() => refuse(format!("level: {level}, expected a finite number")),
            _ => Ok(()),
        }
    }

    /// Returns the world position of a point on the plane. The point is given in samples along the axes of the plane.
    pub fn world(&self, [x, y]: [f64; 2]) -> DVec3 {
        let mut index = DVec3::ZERO;
        let [first, second] = self.axis.others().map(|axis| axis as usize);
        index[first] = x;
        index[second] = y;
        index[self.axis as usize] = f64::from(self.index);
        self.space.world(index)
    }

    /// Returns the world vectors of one step of the even grid along each axis of the plane.
    pub fn steps(&self) -> [[f64; 3]; 2] {
        let world = self.space.world_from_even;
        self.axis
            .others()
            .map(|axis| world.matrix3.col(axis as usize).to_array())
    }

    /// Returns the plane as a file. `slice` holds its samples; `range` is the range of the field's values.
    ///
    /// # Errors
    /// The encoder of PNG or gzip failed.
    pub fn file(&self, slice: Slice, options: &SliceOptions, range: [f32; 2]) -> Result<Vec<u8>, png::EncodingError> {
        match options.format {
            SliceFormat::Raw => Ok(slice.bytes),
            SliceFormat::Png => self.picture(options, range).png(&slice),
            SliceFormat::Nrrd => Ok(nrrd(&self.placed(), &slice)),
            SliceFormat::Nii => Ok(nifti(&self.placed(), &slice)),
            SliceFormat::NiiGz => Ok(gzipped(&nifti(&self.placed(), &slice))?),
            SliceFormat::Svg => Ok(self.svg(&self.contours(&slice, &options.isovalues)).into_bytes()),
            SliceFormat::Geojson => Ok(self.geojson(&self.contours(&slice, &options.isovalues)).into_bytes()),
        }
    }

    fn picture(&self, options: &SliceOptions, range: [f32; 2]) -> Picture {
        Picture {
            dims: self.dims,
            missing: self.field.missing,
            window: options.window.unwrap_or(range[1] - range[0]),
            level: options.level.unwrap_or(0.5 * range[0] + 0.5 * range[1]),
        }
    }

    /// Returns the contours of each isovalue.
    fn contours(&self, slice: &Slice, isovalues: &[f32]) -> Vec<(f32, Vec<Contour>)> {
        let samples = samples_of(slice);
        let width = self.dims[0] as usize;
        let value = |x: u32, y: u32| {
            let value = samples.get(y as usize * width + x as usize);
            (!value.is_nan() && Some(value) != self.field.missing).then_some(value)
        };
        let contours_at = |&iso: &f32| (iso, contours(self.dims, value, iso));
        isovalues.iter().map(contours_at).collect()
    }

    fn placed(&self) -> PlacedPlane {
        let [along, across] = self.steps().map(DVec3::from);
        let through = self.space.world_from_even.matrix3.col(self.axis as usize);
        PlacedPlane {
            dims: self.dims,
            columns: [along, across, through, self.world([0.0; 2])],
            frame: self.frame,
            unit: self.unit,
            title: self.title(),
        }
    }

    /// Returns a title for users: volume, field, axis and index.
    fn title(&self) -> String {
        format!(
            "{}: {}, {} = {}",
            self.volume,
            self.field.name,
            self.axis.name(),
            self.index
        )
    }

    /// Converts a point in samples to coordinates of the plane: distances from the first sample along both axes, in world units.
    fn in_plane(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let first = self.world([0.0; 2]);
        [
            self.world([x, 0.0]).distance(first),
            self.world([0.0, y]).distance(first),
        ]
    }

    fn svg(&self, contours: &[(f32, Vec<Contour>)]) -> String {
        let [width, height] = self.in_plane(self.dims.map(|n| f64::from(n.saturating_sub(1))));
        // If the unit is known, the picture has the real size of the plane.
        let size = match self.unit.and_then(LengthUnit::metres) {
            Some(metres) => format!(
                "width=\"{}mm\" height=\"{}mm\"",
                width * metres * 1e3,
                height * metres * 1e3
            ),
            None => format!("width=\"{}\" height=\"{}\"", self.dims[0], self.dims[1]),
        };
        let mut text = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" {size} viewBox=\"0 0 {width} {height}\">\n<title>{}</title>\n",
            escaped(&self.title())
        );
        for ((iso, lines), color) in contours.iter().zip(COLORS.iter().cycle()) {
            // The width of a stroke is in pixels, because `non-scaling-stroke` applies to all paths.
            let _ = writeln!(
                text,
                "<g id=\"iso-{iso}\" data-isovalue=\"{iso}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"1\">"
            );
            for line in lines {
                let count = line.points.len() - usize::from(line.is_closed);
                text.push_str("<path vector-effect=\"non-scaling-stroke\" d=\"");
                for (i, point) in line.points[..count].iter().enumerate() {
                    let [x, y] = self.in_plane(*point);
                    let _ = write!(text, "{}{x} {y}", if i == 0 { 'M' } else { 'L' });
                }
                text.push_str(if line.is_closed { "Z\"/>\n" } else { "\"/>\n" });
            }
            text.push_str("</g>\n");
        }
        text.push_str("</svg>\n");
        text
    }

    fn geojson(&self, contours: &[(f32, Vec<Contour>)]) -> String {
        let line = |contour: &Contour| -> Vec<[f64; 3]> {
            let points = contour.points.iter();
            points.map(|point| self.world(*point).to_array()).collect()
        };
        let feature = |(iso, lines): &(f32, Vec<Contour>)| {
            json!({
                "type": "Feature",
                "geometry": { "type": "MultiLineString", "coordinates": lines.iter().map(line).collect::<Vec<_>>() },
                "properties": {
                    "volume": self.volume,
                    "field": self.field.name,
                    "isovalue": iso,
                    "valueUnit": self.field.unit,
                    "axis": self.axis.name(),
                    "index": self.index,
                    "frame": self.frame.name(),
                    "unit": self.unit.map(LengthUnit::symbol),
                },
            })
        };
        let features: Vec<_> = contours.iter().map(feature).collect();
        json!({ "type": "FeatureCollection", "features": features }).to_string()
    }
}

/// Compresses a file with gzip. The header has no name and no time, so that equal requests give equal bytes.
fn gzipped(file: &[u8]) -> io::Result<Vec<u8>> {
    let mut gzip = GzEncoder::new(Vec::new(), Compression::default());
    gzip.write_all(file)?;
    gzip.finish()
}

/// Parses a comma-separated list of isovalues.
///
/// # Errors
/// An item that is not a number.
pub fn isovalues(list: &str) -> Result<Vec<f32>, BadSlice> {
    let texts = list.split(',').map(str::trim).filter(|text| !text.is_empty());
    texts
        .map(|text| {
            let refuse = |_| BadSlice(format!("iso: {text:?}, expected a number"));
            text.parse().map_err(refuse)
        })
        .collect()
}

/// Returns the samples of a plane, and the range of the field's values. The range is `[0.0; 2]` unless the options need it.
///
/// # Errors
/// Errors of the device, or of reading the volume.
pub async fn load_slice(
    worker: &DeviceWorker,
    volume: &VolumeStep,
    plane: &Plane,
    options: &SliceOptions,
) -> Result<(Slice, [f32; 2]), WorkError> {
    let field = &plane.field.name;
    let slice = worker.slice(volume, field, plane.axis as usize, plane.index).await?;
    let needs_range = options.format == SliceFormat::Png && (options.window.is_none() || options.level.is_none());
    let range = match needs_range {
        true => worker.histogram(volume, field, &FeatureName::None).await?.range,
        false => [0.0; 2],
    };
    Ok((slice, range))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use isopeel_kernels::SampleType;
    use isopeel_volumes::testing;

    use super::*;

    fn plane(frame: Frame) -> Plane {
        let mut dataset = testing::dataset("head", [5, 4, 3], &["t1"]);
        dataset.geometry.spacing = [0.5, 2.0, 3.0];
        dataset.geometry.origin = [10.0, 20.0, 30.0];
        dataset.geometry.unit = Some(LengthUnit::Millimetre);
        dataset.geometry.frame = frame;
        let field = dataset.fields[0].clone();
        Plane::new(&VolumeStep::new(Arc::new(dataset), 0).unwrap(), field, Axis::Y, 1).unwrap()
    }

    fn options(format: SliceFormat, isovalues: &[f32]) -> SliceOptions {
        SliceOptions {
            format,
            isovalues: isovalues.to_vec(),
            window: None,
            level: None,
        }
    }

    /// The sample's place along rows, in a plane of five by three.
    fn ramp() -> Slice {
        Slice {
            sample_type: SampleType::U8,
            bytes: (0..15).map(|i| i % 5).collect(),
        }
    }

    #[test]
    fn files_say_where_samples_and_contours_are() {
        let text =
            |plane: &Plane, options| String::from_utf8(plane.file(ramp(), &options, [0.0, 4.0]).unwrap()).unwrap();
        let lps = plane(Frame::Lps);
        let nrrd = text(&lps, options(SliceFormat::Nrrd, &[]));
        for line in [
            "type: uint8\n",
            "dimension: 2\n",
            "space: left-posterior-superior\n",
            "sizes: 5 3\n",
            "space directions: (0.5,0,0) (0,0,3)\n",
            "space origin: (10,22,30)\n",
        ] {
            assert!(nrrd.contains(line), "{line:?} in {nrrd}");
        }
        assert!(nrrd.as_bytes().ends_with(&ramp().bytes));
        let nifti = lps.file(ramp(), &options(SliceFormat::Nii, &[]), [0.0, 4.0]).unwrap();
        let short = |at: usize| i16::from_le_bytes([nifti[at], nifti[at + 1]]);
        let float = |at: usize| f32::from_le_bytes(std::array::from_fn(|i| nifti[at + i]));
        assert_eq!([0, 1, 2, 3].map(|i| short(40 + 2 * i)), [3, 5, 3, 1]);
        assert_eq!((short(70), short(72), short(254), nifti[123]), (2, 8, 1, 2));
        // From LPS to RAS, with the axis across the plane third.
        let rows = [280, 296, 312].map(|at| [0, 4, 8, 12].map(|i| float(at + i)));
        let expected = [[-0.5, 0.0, 0.0, -10.0], [0.0, 0.0, -2.0, -22.0], [0.0, 3.0, 0.0, 30.0]];
        assert_eq!(rows.map(|row| row.map(|x| x + 0.0)), expected);
        assert_eq!([80, 84, 88, 108].map(float), [0.5, 3.0, 2.0, 352.0]);
        assert!(nifti[344..348] == *b"n+1\0" && nifti[352..] == ramp().bytes[..]);
        let packed = lps.file(ramp(), &options(SliceFormat::NiiGz, &[]), [0.0, 4.0]).unwrap();
        let mut unpacked = Vec::new();
        io::Read::read_to_end(&mut flate2::read::GzDecoder::new(&packed[..]), &mut unpacked).unwrap();
        assert_eq!(unpacked, nifti);
        let svg = text(&lps, options(SliceFormat::Svg, &[1.5, 9.0]));
        assert!(
            svg.contains("width=\"2mm\" height=\"6mm\" viewBox=\"0 0 2 6\""),
            "{svg}"
        );
        assert!(
            svg.contains("data-isovalue=\"1.5\"") && svg.contains("data-isovalue=\"9\""),
            "{svg}"
        );
        assert_eq!(svg.matches("<path").count(), 1, "{svg}");
        let geojson: serde_json::Value =
            serde_json::from_str(&text(&plane(Frame::World), options(SliceFormat::Geojson, &[1.5]))).unwrap();
        let feature = &geojson["features"][0];
        assert_eq!(feature["properties"]["isovalue"], 1.5);
        let line = feature["geometry"]["coordinates"][0].as_array().unwrap();
        assert_eq!(line.len(), 3);
        for point in line {
            assert_eq!((&point[0], &point[1]), (&10.75.into(), &22.0.into()));
        }
    }

    #[test]
    fn names_say_the_format() {
        let format = |name: &str| SliceFormat::from_path(Path::new(name));
        for (name, expected) in [
            ("a.PNG", SliceFormat::Png),
            ("a.b.nii", SliceFormat::Nii),
            ("folder/a.nii.gz", SliceFormat::NiiGz),
            ("a.geojson", SliceFormat::Geojson),
        ] {
            assert_eq!(format(name), Some(expected), "{name}");
        }
        assert_eq!([format("png"), format("a.gz"), format("a.tiff")], [None; 3]);
    }

    #[test]
    fn what_a_slice_cannot_be_is_named() {
        let plane = plane(Frame::World);
        for (options, expected) in [
            (options(SliceFormat::Svg, &[]), "iso: isovalues are of contours"),
            (options(SliceFormat::Png, &[1.0]), "iso: isovalues are of contours"),
            (options(SliceFormat::Geojson, &[f32::NAN]), "iso: NaN"),
            (options(SliceFormat::Geojson, &[1.0; 65]), "iso: 65 isovalues"),
        ] {
            let error = plane.check(&options).unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
        assert!(plane.check(&options(SliceFormat::Svg, &[1.0])).is_ok());
    }
}
