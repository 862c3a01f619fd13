//! From a surface that was extracted to the bytes of a file: the same for a request, a batch job and the command line.

use std::io::Write;

use serde_json::Value;
use tokio_util::sync::CancellationToken;

use super::{ExportError, FileDigest, FileRequest, Format, Mesh, digest, extras, stl, why_empty, write};
use crate::extraction::{Extraction, ExtractionStatistics, Extractor, WorkError};
use crate::pool::{self, Panicked};
use crate::view::EditError;
use crate::volumes::VolumeStep;

/// A file that is made, not written yet.
pub struct MadeFile {
    mesh: Mesh,
    format: Format,
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
    Ok(made.await??)
}

impl MadeFile {
    /// The file of a surface, made on the device of that name.
    ///
    /// # Errors
    /// What the format cannot hold, and [`ExportError::Cancelled`].
    pub fn new(
        extraction: Extraction,
        volume: &VolumeStep,
        request: &FileRequest,
        device: &str,
        is_cancelled: &dyn Fn() -> bool,
    ) -> Result<Self, ExportError> {
        let format = request.options.format;
        let mut statistics = extraction.statistics(volume, device);
        let Extraction { surface, view, .. } = extraction;
        let dataset = volume.dataset();
        let extras = extras(volume, &view.to_edit(), &statistics);
        let (of_view, space) = dataset.index_space(&view);
        let uneven = space.uneven.as_deref().map(|axes| (axes, view.mesher));
        let mut mesh = Mesh::new_unless(&surface, &of_view, uneven, is_cancelled)?;
        let notice = dataset.notice().unwrap_or_default();
        mesh.notices = notice.lines().map(str::to_owned).collect();
        // Before the mesh is copied to its reader: both are large.
        drop(surface);
        if format == Format::Stl {
            statistics.notices.extend(stl::rounding(&mesh));
        }
        if request.is_colored() && format == Format::Glb {
            mesh.colorize(&view.transfer_function, view.alpha);
        }
        Ok(Self {
            mesh,
            format,
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
            extras: serde_json::json!({ "a": 1 }),
            statistics: ExtractionStatistics::default(),
        }
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
