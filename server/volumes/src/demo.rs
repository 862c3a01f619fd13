//! The volume embedded in the binary, the MNI152 head, so that the first page shows a real surface.

use std::borrow::Cow;
use std::path::Path;
use std::sync::Arc;

use super::location::MemoryFolder;
use super::open::{join, read_file};
use super::{Dataset, FileLocation, ReadError};

/// Copyright of the McConnell Brain Imaging Centre; it must be shown with the data.
const NOTICE: &str = include_str!("../../demo/NOTICE.md");

/// Opening edit: the brain's surface, T1 just inside grey matter, at a value that opens the sulci. Warm colours mark high importance
/// (curved regions, or much grey matter), in which more triangles are kept; regions with pale and cool colours are coarser.
const OPENING: &str = include_str!("../../demo/opening.json");

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
    let opening = serde_json::from_str(OPENING);
    let opening = opening.map_err(|error| ReadError::new(Path::new("opening.json"), "text", error.to_string()))?;
    dataset.opening = Some(opening);
    Ok(dataset)
}
