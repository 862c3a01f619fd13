//! From a surface that was extracted to the bytes of a file: the same for a request, a batch job and the command line.

use std::io::Write;

use serde_json::Value;
use tokio_util::sync::CancellationToken;

use super::field_values::FieldSamples;
use super::topology::{Topology, split_pinched, volume};
use super::{ExportError, FileDigest, FileOptions, FileRequest, Format, Mesh, digest, extras, stl, why_empty, write};
use crate::extraction::{Extraction, ExtractionStatistics, Extractor, Shape, WorkError};
use crate::pool::{self, Panicked};
use crate::view::{EditError, Outward, View};
use crate::volumes::{LengthUnit, ReadError, VolumeStep};

/// A file that is made, not written yet.
pub struct MadeFile {
    mesh: Mesh,
    format: Format,
    stem: String,
    extras: Value,
    /// Of its surface.
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
    /// The surface has no triangles, and the request does not allow that.
    #[error("{0}")]
    Empty(String),
    /// The samples of a field cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The work panicked.
    #[error(transparent)]
    Panicked(#[from] Panicked),
}

/// Extracts a surface and makes a file of it. The work ends at its next look at the token where that is cancelled; what it does on
/// processors has threads of low priority.
///
/// # Errors
/// [`MakeError`].
pub async fn make(
    extractor: &Extractor,
    volume: VolumeStep,
    request: &FileRequest,
    token: &CancellationToken,
) -> Result<MadeFile, MakeError> {
    let device = extractor.worker().ready().await?;
    let view = request.view(volume.dataset())?;
    let extraction = extractor.extract(&volume, &view, token).await?;
    if !request.options.allow_empty && extraction.surface.statistics.triangles == 0 {
        let statistics = extraction.statistics(&volume, &device.name);
        let why = why_empty(extractor, &volume, &extraction.view, &statistics).await?;
        return Err(MakeError::Empty(why.unwrap_or_default()));
    }
    let (token, request) = (token.clone(), request.clone());
    let made =
        pool::run_export(move || MadeFile::new(extraction, &volume, &request, &device.name, &|| token.is_cancelled()));
    made.await?
}

/// The unit of a file's positions: millimetres in an STL, else what was asked for, else the volume's own. A volume without a unit has the one that
/// was asked for. Returns what the volume's numbers are in, and what the file's are; `None` if that is not known.
fn unit_of_file(format: Format, own: Option<LengthUnit>, asked: Option<LengthUnit>) -> [Option<LengthUnit>; 2] {
    let from = own.filter(|unit| unit.metres().is_some()).or(asked);
    let to = match format {
        Format::Stl => from.map(|_| LengthUnit::Millimetre),
        Format::Glb => from,
        Format::Ply | Format::Vtp => asked.or(from),
    };
    [from, to]
}

/// Turns a mesh so that its outside is the side that was asked for.
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
    }
}

/// What a format does not keep of a mesh.
fn notices(mesh: &Mesh, format: Format, options: &FileOptions) -> Vec<String> {
    if format != Format::Stl {
        return Vec::new();
    }
    let no_unit = mesh.unit.is_none().then(|| {
        "the volume declares no unit, and programs that print take the numbers of an STL for millimetres: name its unit (--unit, unit)".to_owned()
    });
    let no_values = (!options.field_values.is_empty()).then(|| "an STL holds no values of fields".to_owned());
    stl::rounding(mesh)
        .into_iter()
        .chain(no_unit)
        .chain(no_values)
        .collect()
}

/// What a surface is, for people.
fn name(volume: &VolumeStep, view: &View) -> String {
    let iso = view.iso.map_or(String::new(), |iso| format!(" = {}", iso.get()));
    let mask = view
        .mask
        .as_ref()
        .map_or(String::new(), |mask| format!(", {}", mask.as_str()));
    format!("{}: {}{iso}{mask}", volume.dataset().id, view.field)
}

/// The name of a file without its extension.
fn stem(volume: &str, request: &FileRequest, view: &View) -> String {
    let what = match (&request.options.label, view.iso) {
        (Some(labels), _) => format!("-{labels}"),
        (None, Some(iso)) => format!("-{}", iso.get()),
        (None, None) => String::new(),
    };
    safe_name(&format!("{volume}{what}"))
}

/// A text as a part of a file's name: letters, digits and what else no system takes for something else.
pub(crate) fn safe_name(text: &str) -> String {
    let safe = |c: char| match c {
        '.' | '-' | '+' | '_' => c,
        c if c.is_ascii_alphanumeric() => c,
        _ => '_',
    };
    text.chars().map(safe).collect()
}

/// Where a surface comes from.
fn provenance(volume: &VolumeStep, view: &View) -> Vec<(&'static str, String)> {
    let dataset = volume.dataset();
    let view = serde_json::to_string(&view.to_edit()).unwrap_or_default();
    vec![
        ("volume", dataset.id.clone()),
        ("title", dataset.title.clone()),
        ("step", volume.step().to_string()),
        ("view", view),
        ("generator", concat!("isopeel ", env!("CARGO_PKG_VERSION")).to_owned()),
    ]
}

impl MadeFile {
    /// The file of a surface, made on the device of that name.
    ///
    /// # Errors
    /// What the format cannot hold, [`ExportError::Cancelled`], and a field whose samples cannot be read.
    pub fn new(
        extraction: Extraction,
        volume: &VolumeStep,
        request: &FileRequest,
        device: &str,
        is_cancelled: &dyn Fn() -> bool,
    ) -> Result<Self, MakeError> {
        let format = request.options.format;
        let mut statistics = extraction.statistics(volume, device);
        let Extraction { surface, view, .. } = extraction;
        let dataset = volume.dataset();
        let (of_view, space) = dataset.index_space(&view);
        let placed = of_view.in_unit(unit_of_file(format, of_view.unit, request.options.length_unit()));
        let uneven = space.uneven.as_deref().map(|axes| (axes, view.mesher));
        let mut mesh = Mesh::new_unless(&surface, &placed, uneven, is_cancelled)?;
        // Before the mesh is copied to its reader: both are large.
        drop(surface);
        for name in &request.options.field_values {
            if let Some(field) = dataset.field(name) {
                let samples = FieldSamples::read(volume, field)?;
                mesh.fields
                    .push(samples.at(&mesh.index, if view.cap { 1.0 } else { 0.0 }));
            }
        }
        mesh.index = Vec::new();
        let topology = split_pinched(&mut mesh);
        statistics.shape = Some(turn_outward(&mut mesh, topology, request.options.outward));
        statistics.notices = notices(&mesh, format, &request.options);
        let notice = dataset.notice().unwrap_or_default();
        mesh.notices = notice.lines().map(str::to_owned).collect();
        mesh.name = match &request.options.label {
            Some(labels) => format!("{}: {labels}", dataset.id),
            None => name(volume, &view),
        };
        mesh.provenance = provenance(volume, &view);
        if request.is_colored() {
            mesh.colorize(&view.transfer_function, view.alpha);
        }
        let extras = extras(volume, &view.to_edit(), &statistics);
        Ok(Self {
            mesh,
            format,
            stem: stem(&dataset.id, request, &view),
            extras,
            statistics,
        })
    }

    /// A mesh as a file, for tests.
    #[cfg(test)]
    pub(crate) fn of_mesh(mesh: Mesh, format: Format) -> Self {
        Self {
            mesh,
            format,
            stem: "a".to_owned(),
            extras: serde_json::json!({ "a": 1 }),
            statistics: ExtractionStatistics::default(),
        }
    }

    /// A name for its file: volume, and isovalue or labels.
    pub fn file_name(&self) -> String {
        format!("{}.{}", self.stem, self.format.extension())
    }

    /// Its format.
    pub fn format(&self) -> Format {
        self.format
    }

    /// Length and hash of what [`MadeFile::write`] writes.
    ///
    /// # Errors
    /// As [`digest`].
    pub fn digest(&self, is_cancelled: &dyn Fn() -> bool) -> Result<FileDigest, ExportError> {
        digest(&self.mesh, self.format, &self.extras, is_cancelled)
    }

    /// Writes it.
    ///
    /// # Errors
    /// As [`write`].
    pub fn write(&self, out: &mut impl Write) -> Result<(), ExportError> {
        write(&self.mesh, self.format, &self.extras, out)
    }
}
