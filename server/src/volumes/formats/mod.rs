//! File formats: one header parser a file, and the list of all.
//!
//! | name | format |
//! |---|---|
//! | `.nrrd`, `.nhdr` | [NRRD](nrrd) |
//! | `.mha`, `.mhd` | [MetaImage](metaimage) |
//! | `.nii`, `.nii.gz` | [NIfTI-1](nifti) |
//! | `.npy` | [NumPy](npy) |
//! | `.json`, or `.raw` with a `.json` beside it | [raw samples](raw) |
//!
//! A new format is a file here and an entry of [`FORMATS`]. Its parser turns the header into a
//! [`StoredSamples`](super::stored::StoredSamples), which reads the samples of all formats; `header` has what parsers share.

pub(super) mod header;
pub mod metaimage;
pub mod nifti;
pub mod npy;
pub mod nrrd;
pub mod raw;

use std::path::Path;

use super::{FileLocation, OpenedFile, ReadError};

/// A file format.
pub struct Format {
    /// How the names of its files end, in lower case.
    pub endings: &'static [&'static str],
    /// Reads the header of a file.
    pub open: fn(&FileLocation) -> Result<OpenedFile, ReadError>,
    /// Whether a file of such a name is one of the volumes in its folder.
    pub is_volume: fn(&FileLocation) -> bool,
}

/// All formats.
pub const FORMATS: [Format; 6] = [
    Format {
        endings: &[".nrrd", ".nhdr"],
        open: nrrd::open,
        is_volume: |_| true,
    },
    Format {
        endings: &[".mha", ".mhd"],
        open: metaimage::open,
        is_volume: |_| true,
    },
    Format {
        endings: &[".nii", ".nii.gz"],
        open: nifti::open,
        is_volume: |_| true,
    },
    Format {
        endings: &[".npy"],
        open: npy::open,
        is_volume: |_| true,
    },
    Format {
        endings: &[".json"],
        open: raw::open,
        is_volume: raw::is_sidecar,
    },
    // Listed by their sidecar.
    Format {
        endings: &[".raw"],
        open: raw::open_samples,
        is_volume: |_| false,
    },
];

/// The names that a path may have, for messages.
pub const EXPECTED: &str = "expected .nrrd, .nhdr, .mha, .mhd, .nii, .nii.gz, .npy, or .json beside raw samples";

impl Format {
    /// The format that a file's name says.
    pub fn of(path: &Path) -> Option<&'static Self> {
        let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
        let mut formats = FORMATS.iter();
        formats.find(|format| format.endings.iter().any(|ending| name.ends_with(ending)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_name_every_format() {
        for ending in FORMATS
            .iter()
            .flat_map(|format| format.endings)
            .filter(|ending| **ending != ".raw")
        {
            assert!(EXPECTED.contains(ending), "{ending}");
        }
    }

    #[test]
    fn names_are_read_in_any_case() {
        assert!(Format::of(Path::new("a/T1.NII.GZ")).is_some());
        assert!(Format::of(Path::new("a/head.nrrd.gz")).is_none());
    }
}
