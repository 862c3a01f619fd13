//! Makes the bytes of a file from extracted surfaces, in the same way for a request, a batch job and the command line.

use std::io::Write;

use isopeel_extraction::dataset_views::view_space;
use isopeel_extraction::{Cleaned, Extraction, ExtractionStatistics, Measuring, Shape, WorkError};
use isopeel_kernels::RefinementCost;
use isopeel_mesh::caps::{Faces, ToCaps};
use isopeel_mesh::clean::{self, NotClean, RepairError, Scope};
use isopeel_mesh::topology::{Topology, split_pinched, volume};
use isopeel_mesh::{glb, stl};
use isopeel_view::quality::MesherName;
use isopeel_view::{EditError, Outward, View};
use isopeel_volumes::{InputIdentity, LengthUnit, VolumeStep};
use tokio_util::sync::CancellationToken;

use super::field_values::FieldSamples;
use super::{
    Compress, Content, ExportError, FileDigest, FileOptions, FileRequest, FileSurface, Format, Mesh, OtherVolumes,
    extras, why_empty,
};
use crate::pool::{self, Panicked};
use crate::service::{DeviceError, DeviceWorker};

/// Content of a file that is complete, but not written yet.
pub struct FileContent {
    content: Content,
    stem: String,
    /// Statistics of the surface, or of all surfaces together.
    pub statistics: ExtractionStatistics,
}

/// Why a file was not made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MakeError {
    /// The surface could not be made.
    #[error(transparent)]
    Work(#[from] WorkError),
    /// A value out of its range, or a field that the volume does not have.
    #[error(transparent)]
    Edit(#[from] EditError),
    /// The surface does not fit its format.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// Triangles intersect, and the request does not allow that.
    #[error(transparent)]
    NotClean(#[from] NotClean),
    /// The surface has no triangles, and the request does not allow that.
    #[error("{0}")]
    Empty(String),
    /// The work panicked.
    #[error(transparent)]
    Panicked(#[from] Panicked),
}

impl DeviceError for MakeError {
    fn work_error(&self) -> Option<&WorkError> {
        match self {
            Self::Work(error) => Some(error),
            _ => None,
        }
    }
}

impl From<RepairError> for MakeError {
    fn from(error: RepairError) -> Self {
        match error {
            RepairError::Cancelled => Self::Export(ExportError::Cancelled),
            RepairError::NotClean(error) => Self::NotClean(error),
        }
    }
}

/// Extracts the surfaces of a request and makes a file of them. Stops soon after the token is cancelled. CPU work runs on the export pool,
/// whose threads have low priority.
///
/// # Errors
/// [`MakeError`].
pub async fn make(
    worker: &DeviceWorker,
    volume: &VolumeStep,
    others: &OtherVolumes,
    request: &FileRequest,
    token: &CancellationToken,
) -> Result<FileContent, MakeError> {
    let device = worker.ready().await?;
    let mut surfaces = Vec::new();
    for surface in request.surfaces(volume, others)? {
        let work = request.options.export_work(&surface.view);
        let extracted = worker.extract_with(&surface.volume, &surface.view, work, token);
        let extraction = extracted.await?;
        if !request.options.allow_empty && extraction.surface.statistics.triangles == 0 {
            let statistics = extraction.statistics(&surface.volume, &device.name);
            let why = why_empty(worker, &surface.volume, &extraction.view, &statistics).await?;
            return Err(MakeError::Empty(why.unwrap_or_default()));
        }
        surfaces.push(MadeSurface::of(worker, extraction, surface, &device.name, token).await?);
    }
    Ok(FileContent::new(volume, request, surfaces))
}

/// Returns two units: of the volume's coordinates, and of the positions in the file. Each is `None` if it is not known.
///
/// A volume that declares no length unit is assumed to have the requested unit. A file has the unit that its format prescribes, else the
/// requested unit, else the unit of the volume.
fn units(format: Format, declared: Option<LengthUnit>, requested: Option<LengthUnit>) -> [Option<LengthUnit>; 2] {
    let from = declared.filter(|unit| unit.metres().is_some()).or(requested);
    let to = match format.unit() {
        Some(unit) => from.map(|_| unit),
        // A GLB keeps the unit, because its node converts to metres.
        None if format == Format::Glb => from,
        None => requested.or(from),
    };
    [from, to]
}

/// Flips the triangles of a mesh if necessary, so that the requested side is outside.
fn turn_outward(mesh: &mut Mesh, topology: Topology, outward: Outward) -> Shape {
    let Topology { split, is_closed } = topology;
    let volume = is_closed.then(|| volume(mesh));
    let shows_high = match outward {
        Outward::Auto => volume.is_some_and(|volume| volume < 0.0),
        Outward::High => true,
        Outward::Low => false,
    };
    if shows_high {
        mesh.flip();
    }
    Shape {
        outward: if shows_high { Outward::High } else { Outward::Low },
        split_vertices: split,
        is_closed,
        volume: volume.map(f64::abs),
        self_intersections: None,
        cleaned: None,
    }
}

/// Returns the edge length, in cells, of the largest cube that a vertex of the surface represents. A cap changes the vertices of all cubes
/// that it cuts. Returns 1 for a cut of the vertex tree, because such a cut is refined near caps.
fn largest_cube_cells(statistics: &ExtractionStatistics) -> f32 {
    let coarsest = statistics.leaves.iter().rposition(|&leaves| leaves > 0);
    match coarsest {
        Some(level) if !statistics.is_tree_cut => (1u32 << level) as f32,
        _ => 1.0,
    }
}

/// Returns notices about a file: which properties of the mesh its format loses, and whether measuring the error exceeded its time limit.
fn notices(mesh: &Mesh, options: &FileOptions, is_measured: bool) -> Vec<String> {
    let format = options.format;
    let title = format.title();
    let rounding = format.rounds().then(|| stl::rounding(mesh, title)).flatten();
    let unit = format.unit().filter(|_| mesh.unit.is_none());
    let no_unit = unit.map(|unit| {
        let unit = unit.symbol();
        format!("the volume declares no unit, and programs take the numbers of a {title} for {unit}: name its unit (--unit, unit)")
    });
    let unmeasured = (options.measure > Some(0.0) && !is_measured).then(|| {
        let seconds = options.measure.unwrap_or_default();
        format!("the error was not measured: it takes longer than {seconds} s (--measure, measure)")
    });
    let packed = (options.compress == Compress::Meshopt && !mesh.positions.is_empty()).then(|| {
        let (rounding, unit) = (glb::packed::rounding(mesh), mesh.unit.map_or("", LengthUnit::ascii_symbol));
        let spacings = rounding / mesh.smallest_spacing;
        format!("positions are rounded by up to {rounding:.1e} {unit}, {spacings:.4} of the smallest spacing (--compress meshopt)")
    });
    let loses_values = !options.field_values.is_empty() && !format.holds_values();
    let no_values = loses_values.then(|| format!("a {title} holds no values of fields"));
    [rounding, no_unit, no_values, unmeasured, packed]
        .into_iter()
        .flatten()
        .collect()
}

/// Returns notices about names, colours and opacities of a surface that its format cannot hold.
fn lost_looks(surface: &FileSurface) -> Vec<String> {
    let (format, material) = (surface.request.options.format, surface.material);
    let title = format.title();
    let lost = [
        (surface.name.is_some() && !format.holds_names(), "name of its surface"),
        (
            material.color.is_some() && !format.holds_color(),
            "colour of its surface",
        ),
        (material.opacity < 1.0 && !format.holds_opacity(), "opacity"),
        (
            surface.request.is_colored() && !format.holds_colors(),
            "colours of a transfer function",
        ),
    ];
    let lost = lost.into_iter().filter(|(is_lost, _)| *is_lost);
    lost.map(|(_, what)| format!("a {title} holds no {what}")).collect()
}

/// Returns notices about changes of the repair, because the measured error does not include them.
fn repair_notices(mesh: &Mesh, cleaned: &Cleaned) -> Vec<String> {
    let mut notices = Vec::new();
    let count = cleaned.moved_vertices;
    if count > 0 {
        let unit = mesh
            .unit
            .map_or(String::new(), |unit| format!(" {}", unit.ascii_symbol()));
        let length = match cleaned.largest_move {
            length @ 0.01..1e6 => format!("{length:.3}{unit}"),
            length => format!("{length:.3e}{unit}"),
        };
        notices.push(format!(
            "{count} vertices were moved by up to {length} where triangles intersected, after the error was measured"
        ));
    }
    let count = cleaned.flipped_edges;
    if count > 0 {
        notices.push(format!(
            "{count} edges between nearly coplanar triangles were flipped, after the error was measured"
        ));
    }
    let count = cleaned.unflipped_edges;
    if count > 0 {
        notices.push(format!(
            "{count} edges between nearly coplanar triangles could not be flipped: TetGen may refuse the surface"
        ));
    }
    notices
}

/// Settings for the repair of a mesh, and for counting the triangles that intersect.
struct Cleaning {
    /// Where the mesh is repaired; `None`: nowhere.
    scope: Option<Scope>,
    measuring: Measuring,
    faces: Faces,
    /// What the refinement of the cut has cost, if the cut was refined.
    refined: Option<RefinementCost>,
}

impl Cleaning {
    /// Repairs a mesh, then counts the pairs of triangles that still intersect. Returns the count and the statistics of the repair. The
    /// count is `None` if it was not requested or took too long.
    fn run(
        &self,
        mesh: &mut Mesh,
        format: Format,
        is_cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<(Option<u64>, Option<Cleaned>), MakeError> {
        let Some(scope) = self.scope else {
            let count = |limit| clean::count(mesh, format, limit, is_cancelled);
            let counted = match self.measuring {
                Measuring::Never => None,
                Measuring::Always => count(None),
                Measuring::Within(limit) => count(Some(limit)),
            };
            return Ok((counted, None));
        };
        let repaired = clean::repair(mesh, format, scope, self.faces, is_cancelled)?;
        let triangles = mesh.triangles.len() as u64;
        let cleaned = Cleaned {
            triangles_before: self.refined.map_or(triangles, |refined| refined.triangles),
            triangles_after: triangles,
            rounds: self.refined.map_or(0, |refined| refined.rounds),
            ..repaired.cleaned
        };
        Ok((Some(repaired.intersections), Some(cleaned)))
    }
}

/// Returns the default name of a surface: volume, field, isovalue and mask.
fn default_name(volume: &VolumeStep, view: &View) -> String {
    let iso = view.iso.map_or(String::new(), |iso| format!(" = {}", iso.get()));
    let mask = view
        .mask
        .as_ref()
        .map_or(String::new(), |mask| format!(", {}", mask.as_str()));
    format!("{}: {}{iso}{mask}", volume.dataset().id, view.field)
}

/// Returns the name of a file of one surface, without its extension.
fn stem(surface: &FileSurface, view: &View) -> String {
    let volume = &surface.volume.dataset().id;
    let what = match (&surface.request.options.label, view.iso) {
        (Some(labels), _) => format!("-{labels}"),
        (None, Some(iso)) => format!("-{}", iso.get()),
        (None, None) => String::new(),
    };
    safe_name(&format!("{volume}{what}"))
}

/// Converts a text to a part of a file name. Replaces all characters that have a special meaning on some system.
pub(crate) fn safe_name(text: &str) -> String {
    let safe = |c: char| match c {
        '.' | '-' | '+' | '_' => c,
        c if c.is_ascii_alphanumeric() => c,
        _ => '_',
    };
    text.chars().map(safe).collect()
}

/// Returns the provenance of a surface: its volume, step and view, and the program that made it.
fn provenance(volume: &VolumeStep, view: &View) -> Vec<(&'static str, String)> {
    let dataset = volume.dataset();
    let view = serde_json::to_string(&view.to_edit()).unwrap_or_default();
    let mut provenance = vec![
        ("volume", dataset.id.clone()),
        ("title", dataset.title.clone()),
        ("step", volume.step().to_string()),
        ("view", view),
        ("generator", concat!("isopeel ", env!("CARGO_PKG_VERSION")).to_owned()),
    ];
    if let Some(times) = dataset.times.as_ref().filter(|_| dataset.steps > 1) {
        provenance.push(("time", times.label(volume.step())));
    }
    provenance.extend(InputIdentity::quick_content(volume).map(|content| ("identity", content)));
    provenance
}

/// A surface of a file, as a mesh.
pub struct MadeSurface {
    mesh: Mesh,
    /// Statistics of the surface.
    pub statistics: ExtractionStatistics,
    extras: serde_json::Value,
    /// Name of a file of this surface alone, without its extension.
    stem: String,
}

impl MadeSurface {
    /// Fetches the values of fields from the device, then runs [`MadeSurface::new`] on the export pool.
    ///
    /// # Errors
    /// As [`MadeSurface::new`], and errors of the device.
    pub async fn of(
        worker: &DeviceWorker,
        extraction: Extraction,
        requested: FileSurface,
        device: &str,
        token: &CancellationToken,
    ) -> Result<Self, MakeError> {
        let fields = FieldSamples::of(worker, &requested.volume, requested.values(), token).await?;
        let (token, device) = (token.clone(), device.to_owned());
        let make = move || Self::new(extraction, fields, &requested, &device, &|| token.is_cancelled());
        pool::run_export(make).await?
    }

    /// Makes the mesh of an extracted surface. `device` is the name of the device, for the statistics.
    ///
    /// # Errors
    /// The format cannot hold the surface, or [`ExportError::Cancelled`].
    fn new(
        extraction: Extraction,
        fields: Vec<FieldSamples>,
        requested: &FileSurface,
        device: &str,
        is_cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<Self, MakeError> {
        let (volume, options) = (&requested.volume, &requested.request.options);
        let mut statistics = extraction.statistics(volume, device);
        let Extraction {
            surface, view, refined, ..
        } = extraction;
        let dataset = volume.dataset();
        let (geometry, space) = view_space(dataset, &view);
        let placed = geometry.in_unit(units(options.format, geometry.unit, options.length_unit()));
        let uneven = space.uneven.as_deref().map(|axes| (axes, view.mesher));
        let mut mesh = Mesh::new_unless(&surface, &placed, uneven, is_cancelled)?;
        // Drops the surface before the mesh is copied, because both are large.
        drop(surface);
        let padding = if view.cap { 1.0 } else { 0.0 };
        mesh.fields = fields.iter().map(|field| field.at(&mesh.index, padding)).collect();
        drop(fields);
        let cells = largest_cube_cells(&statistics);
        if view.cap {
            let to_caps = |&position: &[f32; 3]| ToCaps::of(position, geometry.dims, cells);
            mesh.caps = mesh.index.iter().map(to_caps).collect();
        }
        mesh.index = Vec::new();
        let topology = split_pinched(&mut mesh);
        mesh.is_closed = topology.is_closed;
        let cleaning = Cleaning {
            scope: if options.clean {
                Some(Scope::All)
            } else {
                view.cap.then_some(Scope::AtCaps { cells })
            },
            measuring: options.measuring(),
            faces: Faces::new(&geometry, &mesh.positions, &mesh.caps),
            refined,
        };
        let (self_intersections, cleaned) = cleaning.run(&mut mesh, options.format, is_cancelled)?;
        statistics.shape = Some(Shape {
            self_intersections,
            cleaned,
            ..turn_outward(&mut mesh, topology, options.outward)
        });
        let is_measured = statistics.error.is_some() || view.mesher != MesherName::Dual;
        statistics.notices = notices(&mesh, options, is_measured);
        statistics.notices.extend(lost_looks(requested));
        if let Some(cleaned) = &cleaned {
            statistics.notices.extend(repair_notices(&mesh, cleaned));
        }
        let notice = dataset.notice().unwrap_or_default();
        mesh.notices = notice.lines().map(str::to_owned).collect();
        mesh.name = match (&requested.name, &options.label) {
            (Some(name), _) => name.clone(),
            (None, Some(labels)) => format!("{}: {labels}", dataset.id),
            (None, None) => default_name(volume, &view),
        };
        mesh.material = requested.material;
        mesh.provenance = provenance(volume, &view);
        if requested.request.is_colored() {
            mesh.colorize(&view.transfer_function, view.alpha);
        }
        let extras = extras(volume, &view.to_edit(), &mesh, &statistics);
        Ok(Self {
            mesh,
            statistics,
            extras,
            stem: stem(requested, &view),
        })
    }
}

impl FileContent {
    /// Makes the file of one or more surfaces.
    pub fn new(volume: &VolumeStep, request: &FileRequest, surfaces: Vec<MadeSurface>) -> Self {
        let id = &volume.dataset().id;
        let stem = match &surfaces[..] {
            [surface] => surface.stem.clone(),
            _ => safe_name(id),
        };
        let (mut meshes, mut statistics, mut extras) = (Vec::new(), Vec::new(), Vec::new());
        for surface in surfaces {
            meshes.push(surface.mesh);
            statistics.push(surface.statistics);
            extras.push(surface.extras);
        }
        let extras = match extras.len() {
            1 => extras.remove(0),
            _ => serde_json::json!({ "surfaces": extras }),
        };
        Self {
            content: Content {
                meshes,
                format: request.options.format,
                compress: request.options.compress,
                extras,
            },
            stem,
            statistics: ExtractionStatistics::of_several(statistics),
        }
    }

    /// A mesh as a file, for tests.
    #[cfg(test)]
    pub(crate) fn of_mesh(mesh: Mesh, format: Format) -> Self {
        Self {
            content: Content {
                meshes: vec![mesh],
                format,
                compress: Compress::None,
                extras: serde_json::json!({ "a": 1 }),
            },
            stem: "a".to_owned(),
            statistics: ExtractionStatistics::default(),
        }
    }

    /// Returns a name for the file, from the volume and the isovalue or labels.
    pub fn file_name(&self) -> String {
        format!("{}.{}", self.stem, self.format().extension())
    }

    /// Returns the file format.
    pub fn format(&self) -> Format {
        self.content.format
    }

    /// Returns length and hash of the bytes that [`FileContent::write`] produces.
    ///
    /// # Errors
    /// As [`Content::digest`].
    pub fn digest(&self, is_cancelled: &dyn Fn() -> bool) -> Result<FileDigest, ExportError> {
        self.content.digest(is_cancelled)
    }

    /// Writes the file.
    ///
    /// # Errors
    /// As [`Content::write`].
    pub fn write(&self, out: &mut dyn Write) -> Result<(), ExportError> {
        self.content.write(out)
    }
}
