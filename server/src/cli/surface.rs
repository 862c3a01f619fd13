//! Options of a surface and of its file, shared by all commands that make files.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use isopeel_kernels::MAX_LEVEL;
use isopeel_view::quality::{ErrorLimit, MaxError, MesherName, TopologyName, TriangleBudget};
use isopeel_view::{
    CameraJson, ChosenPartsJson, Detail, Edit, InterestJson, Outward, TransferFunctionJson, arguments, parse_position,
};

use crate::bounded_read::read_bounded;
use crate::export::{Compress, FileOptions, FileRequest, Format, SurfaceOptions};

/// Maximum bytes of the file of a transfer function. 64 points take about 4 KiB.
const MAX_TRANSFER_FUNCTION_BYTES: usize = 1 << 20;

/// Vertical field of view of a camera, in degrees: that of the viewer.
const DEFAULT_FOV: f64 = 32.0;

/// Options of a surface and of its file. What is left out has the default of all exports.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct SurfaceArgs {
    /// Isovalue, in the field's units [default: the one that the field opens with in a viewer, which isopeel info explains]
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    pub(super) iso: Option<f32>,

    /// Labels of a segmentation whose surface is extracted, instead of one at an isovalue: by numbers or names, `7`, `3,Hippocampus`. They are of
    /// --field, else of the first field with names of labels
    #[arg(long, value_name = "LABELS", conflicts_with = "iso", allow_hyphen_values = true)]
    pub(super) label: Option<String>,

    /// Smooths the surface around labels: standard deviation of a Gaussian, in samples, 0.1 to 10, as 0.8; details thinner than about two of it vanish
    #[arg(long, value_name = "SAMPLES", default_value_t = 0.0)]
    label_smoothing: f32,

    /// Field whose isosurface is extracted, or an expression over fields, as `log(rho)` [default: the main one]
    #[arg(long, value_name = "NAME")]
    field: Option<String>,

    /// Where the surface may be: at samples where a field has certain values, `labels==3`, also with !=, <, <=, >, >=; behind == and != also
    /// ranges and lists, `labels==1,4..7` [default: everywhere]
    #[arg(long, value_name = "FIELD==V")]
    mask: Option<String>,

    /// Feature that matters beside smoothness: the name of a field; `gradient-magnitude`, `mean-curvature`, `gaussian-curvature` or
    /// `local-variance` of the field that is extracted; or `vector-magnitude(X,Y,Z)`, `divergence(X,Y,Z)`, `vorticity-magnitude(X,Y,Z)`,
    /// `q-criterion(X,Y,Z)`, `lambda2(X,Y,Z)` or `helicity(X,Y,Z)` of three fields or expressions; or an expression over fields, as
    /// `magnitude(u,v,w)`; or `distance(CONDITION)`, how far it is to where a mask or an expression holds, as `distance(labels==3)`
    /// [default: none]
    #[arg(long, value_name = "NAME")]
    feature: Option<String>,

    /// Feature values that become 0 and 1, in the feature's units [default: the feature's minimum and maximum]
    #[arg(long, num_args = 2, value_names = ["LO", "HI"], allow_negative_numbers = true, requires = "feature")]
    pub(super) feature_range: Option<Vec<f32>>,

    /// Weight of the feature against smoothness, 0 to 1 [default: 0.3 with --feature, else 0]
    #[arg(long, value_name = "A", allow_negative_numbers = true)]
    alpha: Option<f32>,

    /// Importance up to which the surface is decimated, 0 to 1; below 0 gives the full surface. Given, it means exactly
    /// that cut of the paper: the guards --max-error and --topology are off unless they are given too [default: 0.02,
    /// guards on]
    #[arg(long, value_name = "B", allow_negative_numbers = true, conflicts_with_all = ["error", "triangles", "bytes"])]
    pub(super) beta: Option<f32>,

    /// Error up to which parts are merged, instead of --beta, in world units, as multiples of the smallest spacing (0.1vx), or in pixels of the
    /// picture of --camera (1px). It counts over a weight, which is 1 where importance is 0 and falls as importance grows
    #[arg(long, value_name = "E", allow_hyphen_values = true)]
    error: Option<ErrorLimit>,

    /// Camera for which the surface is made: what it sees from near is finer. World coordinates of its position, of the place that it looks at,
    /// and of the direction that is up if that is not z: PX,PY,PZ,TX,TY,TZ[,UX,UY,UZ]. With --error, --triangles or --bytes
    #[arg(
        long,
        value_name = "NUMBERS",
        allow_hyphen_values = true,
        requires = "viewport",
        conflicts_with = "beta"
    )]
    camera: Option<CameraJson>,

    /// Width and height of the camera's picture, in pixels
    #[arg(long, value_name = "WxH", requires = "camera", value_parser = parse_viewport)]
    viewport: Option<[u32; 2]>,

    /// Vertical field of view of the camera, in degrees [default: 32]
    #[arg(long, value_name = "DEGREES", requires = "camera", conflicts_with = "view_height")]
    fov: Option<f64>,

    /// Height of the camera's picture in world units; then its rays are parallel
    #[arg(long, value_name = "H", requires = "camera")]
    view_height: Option<f64>,

    /// Whether what the camera sees from near is finer [default: view]
    #[arg(long, value_name = "DETAIL")]
    detail: Option<Detail>,

    /// Maximum triangles, a number or a share of the full surface (25%), instead of --beta: the smallest error that keeps
    /// it is found (`tolerance` in --stats). With --error the greater of both decides
    #[arg(long, value_name = "N", allow_hyphen_values = true, conflicts_with = "bytes")]
    triangles: Option<TriangleBudget>,

    /// Maximum bytes that the surface may take on the wire of `isopeel serve`, as --triangles; files are larger
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    bytes: Option<u64>,

    /// Parts of the surface with a smaller area, in world units, are removed first; with --error, --triangles or --bytes. Budgets
    /// and guards then are about what is left [default: none are removed]
    #[arg(long, value_name = "AREA", allow_negative_numbers = true)]
    pub(super) min_part: Option<f64>,

    /// Part of the surface that is removed: the one next to this position, in world coordinates. As --min-part. May be given up to
    /// 64 times
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_position)]
    hide_part: Vec<[f64; 3]>,

    /// Part of the surface that is kept while all others are removed, as --hide-part. May be given up to 64 times
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_position, conflicts_with = "hide_part")]
    keep_part: Vec<[f64; 3]>,

    /// Guard: farthest that a decimated part may be from the surface it stands for, in world units or as multiples of the
    /// smallest spacing (0.25vx), or `none`. `auto` is 0.25vx beside --beta's default, and gives way to an error or a
    /// budget; a guard that is set does not [default: auto; with --beta: none]
    #[arg(long, value_name = "E", allow_hyphen_values = true)]
    max_error: Option<MaxError>,

    /// Guard: whether decimation may change the topology [default: auto; with --beta: free]
    #[arg(long, value_name = "TOPOLOGY")]
    topology: Option<TopologyName>,

    /// Which mesher turns the cut into triangles [default: dual]
    #[arg(long, value_name = "MESHER")]
    mesher: Option<MesherName>,

    /// Close surfaces that leave the volume on its faces; the dual mesher alone can
    #[arg(long)]
    cap: bool,

    /// Transfer function, JSON as `{"points":[{"x":0,"importance":0,"color":"#3465a4"}, …]}`, x and importance 0 to 1; a
    /// GLB gets its colours [default: importance is the blended feature itself]
    #[arg(long, value_name = "FILE.json")]
    transfer_function: Option<PathBuf>,

    /// Region of interest, in world coordinates: `sphere:X,Y,Z:R=I` (centre, radius) or `box:X,Y,Z:X,Y,Z=I` (minimum, maximum).
    /// Inside, importance is at least I, 0 to 1. May be given up to 64 times
    #[arg(long, value_name = "REGION=I")]
    interest: Vec<InterestJson>,

    /// Coarsest level, 0 to 5: cubes of up to 2^L cells per axis [default: 5]
    #[arg(long, value_name = "L", value_parser = clap::value_parser!(u8).range(..=i64::from(MAX_LEVEL.get())))]
    max_level: Option<u8>,

    /// Which side of the surface is its outside: that of high values, that of low values, or of a closed surface the side away from the volume
    /// that it encloses, else the side of low values
    /// [default: auto]
    #[arg(long, value_name = "SIDE")]
    outward: Option<Outward>,

    /// Unit of positions in a PLY, VTP, OBJ or USDZ, and of those of a volume that declares none: m, mm, cm, um, nm, km or angstrom. A GLB is always in
    /// metres, STL, 3MF and GIFTI are in millimetres, precomputed meshes in nanometres [default: the volume's]
    #[arg(long, value_name = "UNIT")]
    unit: Option<String>,

    /// Fields, and expressions over fields, whose values become attributes of the vertices, in their own units:
    /// `temperature,magnitude(u,v,w)`; in GLB, PLY, VTP and USDZ
    #[arg(long, value_name = "NAMES")]
    field_values: Option<String>,

    /// Format of the file, or of all files of a batch [default: what the file's name says]
    #[arg(long, value_enum, value_name = "FORMAT")]
    pub(super) format: Option<Format>,

    /// How the file is compressed: zlib for a VTP or 3MF; meshopt for a GLB on a page, with positions of 16 bits, which Blender does not read
    /// [default: none]
    #[arg(long, value_enum, value_name = "HOW")]
    compress: Option<Compress>,

    /// Seconds that measuring the error may take, which takes about as long as all else; after them the file has none [default: no bound]
    #[arg(long, value_name = "SECONDS")]
    measure: Option<f64>,

    /// Do not measure the error
    #[arg(long, conflicts_with = "measure")]
    no_measure: bool,

    /// Write no triangles that intersect, for meshers and printers: the surface is refined at those that do, within the budget, and then vertices
    /// of the rest are moved. --stats says what it cost
    #[arg(long)]
    clean: bool,

    /// One of several surfaces of a GLB, 3MF, OBJ, USDZ or precomputed file, JSON with what differs from the other options: any name of a request, beside `volume` (a
    /// path), `step`, `label`, `name`, `color` and `opacity`, as `{"iso":300,"color":"#d2b48c","opacity":0.4}`. May be given up to 64 times
    #[arg(long = "surface", value_name = "JSON", value_parser = parse_surface)]
    surfaces: Vec<SurfaceOptions>,

    /// Write a surface without triangles too, which otherwise is no file
    #[arg(long, requires = "output")]
    pub(super) allow_empty: bool,
}

/// The file of a transfer function cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("transfer function {}", path.display())]
pub struct TransferFunctionError {
    /// Path of the file.
    path: PathBuf,
    /// Error of the system, or of parsing the JSON.
    source: io::Error,
}

impl SurfaceArgs {
    /// Converts the arguments to a request.
    ///
    /// # Errors
    /// The file of the transfer function cannot be read.
    pub(super) fn request(&self, format: Format, step: u32) -> Result<FileRequest, TransferFunctionError> {
        let transfer_function = self.transfer_function.as_deref().map(read_transfer_function);
        let edit = Edit {
            iso: self.iso,
            field: self.field.clone(),
            mask: self.mask.clone().map(Some),
            feature: self.feature.clone(),
            feature_range: self.feature_range.as_deref().and_then(|range| range.try_into().ok()),
            color_field: None,
            alpha: self.alpha,
            beta: self.beta,
            error: self.error,
            triangles: self.triangles,
            bytes: self.bytes,
            min_part: self.min_part,
            parts: self.parts().map(Some),
            max_error: self.max_error,
            topology: self.topology,
            mesher: self.mesher,
            cap: Some(self.cap),
            max_level: self.max_level,
            transfer_function: transfer_function.transpose()?,
            interest: Some(self.interest.clone()),
            detail: self.detail,
            camera: self.camera(),
        };
        let options = FileOptions {
            format,
            allow_empty: self.allow_empty,
            outward: self.outward.unwrap_or_default(),
            unit: self.unit.clone(),
            field_values: self.field_values.as_deref().map(names).unwrap_or_default(),
            label: self.label.clone(),
            label_smoothing: self.label_smoothing,
            compress: self.compress.unwrap_or_default(),
            clean: self.clean,
            measure: if self.no_measure { Some(0.0) } else { self.measure },
            surfaces: self.surfaces.clone(),
        };
        Ok(FileRequest { step, options, edit })
    }

    /// Returns the camera, with its projection and viewport.
    fn camera(&self) -> Option<CameraJson> {
        let fov = self.fov.or_else(|| self.view_height.is_none().then_some(DEFAULT_FOV));
        Some(CameraJson {
            fov,
            height: self.view_height,
            viewport: self.viewport?,
            ..self.camera.clone()?
        })
    }

    /// Returns the paths of the other volumes that `--surface` names.
    pub(super) fn other_volumes(&self) -> impl Iterator<Item = &str> {
        self.surfaces
            .iter()
            .filter_map(|surface| surface.look.volume.as_deref())
    }

    /// Returns the positions of `--hide-part` or `--keep-part`.
    pub(super) fn parts(&self) -> Option<ChosenPartsJson> {
        let non_empty = |positions: &Vec<_>| (!positions.is_empty()).then(|| positions.clone());
        let hide = non_empty(&self.hide_part).map(ChosenPartsJson::Hide);
        hide.or_else(|| non_empty(&self.keep_part).map(ChosenPartsJson::Keep))
    }
}

fn parse_viewport(text: &str) -> Result<[u32; 2], String> {
    let sides = text.split_once('x').and_then(|(width, height)| {
        let [width, height] = [width, height].map(|side| side.trim().parse().ok().filter(|&pixels| pixels > 0));
        Some([width?, height?])
    });
    sides.ok_or_else(|| format!("{text:?}, expected pixels as 1280x720"))
}

fn parse_surface(text: &str) -> Result<SurfaceOptions, serde_json::Error> {
    serde_json::from_str(text)
}

fn read_transfer_function(path: &Path) -> Result<TransferFunctionJson, TransferFunctionError> {
    let read = || {
        let text = read_bounded(File::open(path)?, MAX_TRANSFER_FUNCTION_BYTES)?;
        let too_long = || {
            let why = format!("more than {MAX_TRANSFER_FUNCTION_BYTES} bytes");
            io::Error::new(io::ErrorKind::FileTooLarge, why)
        };
        Ok(serde_json::from_slice(&text.ok_or_else(too_long)?)?)
    };
    read().map_err(|source| TransferFunctionError {
        path: path.to_owned(),
        source,
    })
}

/// Splits a list of names and expressions at commas outside parentheses.
fn names(list: &str) -> Vec<String> {
    arguments(list).into_iter().map(str::to_owned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_parted_by_commas_outside_of_brackets() {
        assert_eq!(names("temperature"), ["temperature"]);
        assert_eq!(
            names("a, magnitude(u,v,log(w)),`x,y`+1"),
            ["a", "magnitude(u,v,log(w))", "`x,y`+1"]
        );
    }

    #[test]
    fn a_transfer_function_is_read_or_its_file_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.json");
        std::fs::write(&path, r##"{"points":[{"x":0.5,"importance":1,"color":"#ffffff"}]}"##).unwrap();
        assert_eq!(read_transfer_function(&path).unwrap().points.len(), 1);
        std::fs::write(&path, r#"{"points":[{"x":0.5}]}"#).unwrap();
        let error = crate::error::chain(&read_transfer_function(&path).unwrap_err());
        assert!(error.contains("t.json: missing field `importance`"), "{error}");
        let error = crate::error::chain(&read_transfer_function(&folder.path().join("no.json")).unwrap_err());
        assert!(error.contains("no.json: No such file"), "{error}");
    }
}
