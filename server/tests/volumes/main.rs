//! The readers from outside: round trips, real files, folders and catalogs, and false files.

mod bounds;
mod catalog;
mod changed;
mod dicom;
mod fixtures;
mod formats;
mod hostile;
mod mrc;
mod mutated;
mod n5;
mod nifti;
mod nrrd;
mod pieces;
mod precomputed;
mod remote;
mod stores;
mod tiff;
mod times;
mod variables;
mod vtk;
mod watch;
mod write;
mod write_mrc;
mod write_vtk;
mod zarr;
