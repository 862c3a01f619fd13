//! One header parser a format; `header` holds what they share.

pub(super) mod header;
pub mod metaimage;
pub mod nifti;
pub mod npy;
pub mod nrrd;
pub mod raw;
