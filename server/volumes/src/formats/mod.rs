//! File formats: one header parser a file, and the list of all.
//!
//! | name | format |
//! |---|---|
//! | `.nrrd`, `.nhdr` | [NRRD](nrrd) |
//! | `.mha`, `.mhd` | [MetaImage](metaimage) |
//! | `.nii`, `.hdr` with `.img` | [NIfTI](nifti), [Analyze](analyze) |
//! | `.mgh`, `.mgz` | [MGH](mgh) of FreeSurfer |
//! | `.mrc`, `.map`, `.ccp4`, `.rec`, `.mrcs`, `.st`, `.ali` | [MRC, CCP4](mrc) |
//! | `.npy`, `.npz` | [NumPy](npy), [several arrays](npz) |
//! | `.dcm`, `.dicom`, a folder | [DICOM](dicom) |
//! | `.h5`, `.hdf5`, `.he5`, `.nc`, `.nc4`, `.cdf`, `.hdf`, `.mat`, `.ims`, `.vtkhdf` | [HDF5, NetCDF](variables), VTKHDF, openPMD, Imaris, BigDataViewer |
//! | `.xml` | [BigDataViewer](big_data_viewer): the HDF5 file or N5 folder that it names |
//! | `.vti`, `.vtr`, `.pvti`, `.pvtr`, `.pvd` | [VTK image data and rectilinear grids](vtk::xml), [in pieces](vtk::pieces), [several times of it](vtk::collection) |
//! | `.vtk` | [VTK legacy](vtk::legacy) |
//! | `.tif`, `.tiff`, `.btf`, `.tf8` | [TIFF](tiff), with ImageJ's and OME's descriptions; folders of numbered slices |
//! | a folder `.zarr`, an address | [Zarr and OME-Zarr](zarr) |
//! | a folder with `info`, `precomputed://…` | [Neuroglancer precomputed](precomputed) |
//! | `.json`, or `.raw` with a `.json` beside it | [raw samples](raw) |
//!
//! The first bytes of a file decide its format ([`format_of`]); if they do not, the ending of the name does. A file may be compressed as
//! a whole: `.gz`, `.bz2` or `.zst` behind its ending.
//!
//! A new format is a file here and an entry of [`FORMATS`]. Its parser turns the header into a
//! [`StoredSamples`](super::stored::StoredSamples), which reads the samples of all formats; `header` has what parsers share.

pub(super) mod ahead;
mod analyze;
pub mod big_data_viewer;
mod blosc;
mod content;
pub mod dicom;
pub(super) mod header;
mod jpeg;
pub(super) mod label_table;
pub mod metaimage;
pub mod mgh;
pub mod mrc;
pub(super) mod named_axes;
pub mod nifti;
pub mod npy;
pub mod npz;
pub mod nrrd;
mod pair;
pub mod precomputed;
pub mod raw;
mod spim_data;
mod store;
pub mod tiff;
pub mod variables;
pub mod vtk;
pub mod zarr;

use std::path::Path;

pub use content::format_of;

use super::remote::Address;
use super::unpacked::packing;
use super::{FileLocation, OpenedFile, ReadError};

/// A file format.
pub struct Format {
    /// Endings of the names of its files, in lower case.
    pub endings: &'static [&'static str],
    /// Reads the header of a file.
    pub open: fn(&FileLocation) -> Result<OpenedFile, ReadError>,
    /// Whether a file is of this format by its first bytes; always false if the format has no mark.
    pub is_content: fn(&[u8]) -> bool,
    /// Whether a file with such a name is listed as a volume of its folder.
    pub is_volume: fn(&FileLocation) -> bool,
    /// Whether such a file may hold several volumes, so that a location may name one of them.
    pub has_parts: bool,
}

/// A format whose volumes are folders.
pub struct FolderFormat {
    /// Name for display.
    pub name: &'static str,
    /// Whether this folder, or file, is one, judged by the names in it and the first bytes of its files.
    pub holds: fn(&Path) -> bool,
    /// Whether an address of a store over a network names one.
    pub is_at: fn(&Address) -> bool,
    /// Opens the volumes in it, or the one that the location names.
    pub open: fn(&FileLocation) -> Result<Vec<FolderVolume>, ReadError>,
}

/// A volume in a folder.
pub struct FolderVolume {
    /// Name for display. For patients' data it contains no value of a tag of the patient.
    pub title: String,
    /// Grid and fields.
    pub file: OpenedFile,
}

/// The formats of folders, in the order in which they are tried.
pub const FOLDERS: [FolderFormat; 4] = [
    FolderFormat {
        name: "DICOM",
        holds: dicom::holds,
        is_at: |_| false,
        open: dicom::open_all,
    },
    FolderFormat {
        name: "Zarr",
        holds: zarr::holds,
        is_at: |address| !address.is_precomputed(),
        open: zarr::open,
    },
    FolderFormat {
        name: "Neuroglancer precomputed",
        holds: precomputed::holds,
        is_at: Address::is_precomputed,
        open: precomputed::open,
    },
    FolderFormat {
        name: "numbered TIFF slices",
        holds: tiff::folder::holds,
        is_at: |_| false,
        open: tiff::folder::open,
    },
];

/// All formats.
pub const FORMATS: [Format; 17] = [
    Format {
        endings: &[".nrrd", ".nhdr"],
        open: nrrd::open,
        is_content: |head| head.starts_with(b"NRRD00"),
        is_volume: |_| true,
        has_parts: false,
    },
    Format {
        endings: &[".mha", ".mhd"],
        open: metaimage::open,
        is_content: content::is_metaimage,
        is_volume: |_| true,
        has_parts: false,
    },
    Format {
        endings: &[".nii", ".hdr", ".img"],
        open: nifti::open,
        is_content: content::is_nifti,
        // Listed by its header file.
        is_volume: |location| !location.stored_name().ends_with(".img"),
        has_parts: false,
    },
    Format {
        endings: &[".mgh", ".mgz"],
        open: mgh::open,
        is_content: mgh::is_content,
        is_volume: |_| true,
        has_parts: false,
    },
    Format {
        endings: &[".mrc", ".map", ".ccp4", ".rec", ".mrcs", ".st", ".ali"],
        open: mrc::open,
        is_content: mrc::is_map,
        is_volume: mrc::is_volume,
        has_parts: false,
    },
    Format {
        endings: &[".npy"],
        open: npy::open,
        is_content: |head| head.starts_with(b"\x93NUMPY"),
        is_volume: |_| true,
        has_parts: false,
    },
    // For a file on disk [`FOLDERS`] comes first and gives it a title.
    Format {
        endings: &[".dcm", ".dicom"],
        open: dicom::open,
        is_content: dicom::is_dicom,
        is_volume: |_| true,
        has_parts: true,
    },
    Format {
        endings: &[
            ".h5", ".hdf5", ".he5", ".nc", ".nc4", ".cdf", ".hdf", ".mat", ".ims", ".vtkhdf",
        ],
        open: variables::open,
        is_content: content::is_variables,
        // Files of other kinds have such names, too.
        is_volume: |location| {
            let name = location.stored_name();
            ![".hdf", ".mat"].iter().any(|end| name.ends_with(end)) || location.begins_as(content::is_variables)
        },
        has_parts: true,
    },
    // The file that the XML names is listed.
    Format {
        endings: &[".xml"],
        open: big_data_viewer::open,
        is_content: |head| String::from_utf8_lossy(&head[..head.len().min(1024)]).contains("<SpimData"),
        is_volume: |_| false,
        has_parts: true,
    },
    Format {
        endings: &[".npz"],
        open: npz::open,
        is_content: |head| head.starts_with(b"PK\x03\x04"),
        is_volume: |_| true,
        has_parts: true,
    },
    Format {
        endings: &[".vti", ".vtr"],
        open: vtk::xml::open,
        is_content: |head| content::is_vtk(head, &["ImageData", "RectilinearGrid"]),
        is_volume: |_| true,
        has_parts: false,
    },
    // Its pieces are in a folder of their own, or are volumes beside it.
    Format {
        endings: &[".pvti", ".pvtr"],
        open: vtk::pieces::open,
        is_content: |head| content::is_vtk(head, &["PImageData", "PRectilinearGrid"]),
        is_volume: |_| true,
        has_parts: false,
    },
    Format {
        endings: &[".pvd"],
        open: vtk::collection::open,
        is_content: |head| content::is_vtk(head, &["Collection"]),
        is_volume: |_| true,
        has_parts: false,
    },
    Format {
        endings: &[".vtk"],
        open: vtk::legacy::open,
        is_content: |head| head.starts_with(b"# vtk DataFile"),
        is_volume: |_| true,
        has_parts: false,
    },
    Format {
        endings: &[".tif", ".tiff", ".btf", ".tf8"],
        open: tiff::open,
        is_content: content::is_tiff,
        is_volume: |_| true,
        has_parts: true,
    },
    Format {
        endings: &[".json"],
        open: raw::open,
        is_content: |_| false,
        is_volume: raw::is_sidecar,
        has_parts: false,
    },
    // Listed by their sidecar.
    Format {
        endings: &[".raw"],
        open: raw::open_samples,
        is_content: |_| false,
        is_volume: |_| false,
        has_parts: false,
    },
];

/// The endings that a path may have, for messages.
pub const EXPECTED: &str = "expected .nrrd, .nhdr, .mha, .mhd, .nii, .hdr, .img, .mgh, .mgz, .mrc, .map, .ccp4, .rec, .mrcs, .st, .ali, .npy, .npz, \
     .dcm, .dicom, .h5, .hdf5, .he5, .nc, .nc4, .cdf, .hdf, .mat, .ims, .vtkhdf, .tif, .tiff, .btf, .tf8, .vti, .vtr, .pvti, .pvtr, .pvd, .vtk, .xml of BigDataViewer, or .json beside raw samples, each also with .gz, .bz2 or .zst; or a folder \
     of Zarr, Neuroglancer precomputed, DICOM images or TIFF slices";

impl Format {
    /// Returns the format for a file's name, also that of a compressed file.
    pub fn of(path: &Path) -> Option<&'static Self> {
        let whole = path.file_name()?.to_string_lossy().to_ascii_lowercase();
        let name = packing(&whole).map_or(whole.as_str(), |(_, name)| name);
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
        assert!(Format::of(Path::new("a/head.nrrd.Gz")).is_some());
    }
}
