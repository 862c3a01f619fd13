//! The volume embedded in the binary, the MNI152 head, so that the first page shows a real surface.

use std::borrow::Cow;
use std::sync::Arc;

use super::location::MemoryFolder;
use super::open::{join, read_file};
use super::{Dataset, FileLocation, ReadError};
use crate::view::{Edit, PointJson, TransferFunctionJson};

/// Copyright of the McConnell Brain Imaging Centre; it must be shown with the data.
const NOTICE: &str = include_str!("../../demo/NOTICE.md");

const FILES: [(&str, &[u8]); 3] = [
    ("t1.nii.gz", include_bytes!("../../demo/t1.nii.gz")),
    ("gm.nii.gz", include_bytes!("../../demo/gm.nii.gz")),
    ("wm.nii.gz", include_bytes!("../../demo/wm.nii.gz")),
];

/// The MNI152 head: T1 (8 bit, skull removed), grey- and white-matter probability (0 to 255), on one grid of 1 mm.
///
/// # Errors
/// None in a built binary: the files are part of it.
pub fn demo() -> Result<Dataset, ReadError> {
    let folder: MemoryFolder = FILES
        .iter()
        .map(|&(name, bytes)| (name.to_owned(), Cow::Borrowed(bytes)))
        .collect();
    let folder = Arc::new(folder);
    let files = FILES
        .iter()
        .map(|&(name, _)| {
            let location = FileLocation::memory(folder.clone(), name);
            read_file(&location).map(|file| (location, file))
        })
        .collect::<Result<Vec<_>, _>>()?;
    let mut dataset = join("MNI152 head", files)?;
    dataset.id = "mni152".into();
    dataset.notices.add(NOTICE.trim());
    dataset.opening = Some(opening());
    Ok(dataset)
}

/// Opening view on the brain's surface: T1 just inside grey matter, at a value that opens the sulci. Warm colours mark high importance
/// (curved regions, or much grey matter), in which more triangles are kept; regions with pale and cool colours are coarser.
fn opening() -> Edit {
    let points = [
        (0.0, 0.0, "#3f6f8c"),
        (0.27, 0.1, "#93b1b5"),
        (0.42, 0.35, "#e9dcc3"),
        (0.52, 0.55, "#e2a57c"),
        (0.66, 0.75, "#c75f47"),
        (1.0, 1.0, "#7d2f35"),
    ];
    let points = points.map(|(x, importance, color)| PointJson {
        x,
        importance,
        color: color.into(),
    });
    Edit {
        iso: Some(140.0),
        field: Some("t1".into()),
        feature: Some("gm".into()),
        feature_range: Some([0.0, 255.0]),
        alpha: Some(0.6),
        transfer_function: Some(TransferFunctionJson { points: points.into() }),
        ..Edit::default()
    }
}
