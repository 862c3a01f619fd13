//! Requests for surfaces and slices as files, and the files that answer them.
//!
//! [`FileRequest`] is a request for surfaces, and [`FileContent`] the resulting file. The crate `isopeel-mesh` converts surfaces to meshes
//! and writes the file formats.

use isopeel_extraction::ExtractionStatistics;
use isopeel_view::Edit;
use isopeel_volumes::{LengthUnit, VolumeStep};

mod contours;
mod empty;
mod field_values;
mod label;
mod made;
mod picture;
mod placed;
mod request;
mod schema;
pub mod slice;
mod surface_options;
mod surfaces;

pub(crate) use empty::why_empty;
pub use isopeel_mesh::{Compress, Content, ExportError, FileDigest, Format, Mesh};
pub(crate) use made::safe_name;
pub use made::{FileContent, MadeSurface, MakeError, make};
pub use request::{FileOptions, FileRequest};
pub(crate) use schema::merged_schema;
pub use surface_options::{SurfaceLook, SurfaceOptions};
pub use surfaces::{FileSurface, OtherVolumes};

/// Returns the metadata of a surface in a GLB. `frame` and `unit` describe the positions before the transform of the node. Equal requests
/// have equal metadata, because the statistics leave out times and memory.
fn extras(volume: &VolumeStep, edit: &Edit, mesh: &Mesh, statistics: &ExtractionStatistics) -> serde_json::Value {
    let dataset = volume.dataset();
    let identity = mesh.provenance.iter().find(|(name, _)| *name == "identity");
    serde_json::json!({
        "volume": dataset.id,
        "title": dataset.title,
        "identity": identity.map(|(_, identity)| identity),
        "step": volume.step(),
        "frame": dataset.geometry.frame.name(),
        "unit": dataset.geometry.unit.map(LengthUnit::symbol),
        "notice": dataset.notice(),
        "view": edit,
        "statistics": statistics.of_surface(),
    })
}
